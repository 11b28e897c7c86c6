// NASA-TLX: six scales. A scale has no mark until the operator touches it.

import { fill, h } from './dom.js';
import { keep, stored } from './link.js';

/** Draws the six scales; marks are stored on the device until they are sent. */
export function scales(place, state, { name, sending, send }) {
  const draft = stored(name);
  const ratings = draft?.key === state.key ? draft.ratings : {};
  const { texts } = state;
  const left = h('p', { class: 'soft', role: 'status' });
  const submit = h('button', { type: 'submit', class: 'main wide', 'data-key': 'submit' }, sending ? texts.sending : texts.send);
  const show = () => {
    const missing = state.scales.filter((scale) => !(scale.name in ratings));
    left.textContent = missing.length ? `${texts.missing} ${missing.map((scale) => scale.title).join(', ')}` : texts.complete;
    submit.disabled = sending || missing.length > 0;
  };
  fill(place, h('form', {
    class: 'tlx',
    onsubmit: (event) => {
      event.preventDefault();
      if (!submit.disabled) send(Object.fromEntries(state.scales.map((scale) => [scale.name, ratings[scale.name]])));
    },
  },
  h('section', { class: 'card intro' }, h('h2', {}, texts.heading),
    h('p', {}, `${texts[state.point] ?? ''} ${texts.instruction}`)),
  state.scales.map((scale, k) => oneScale(scale, k, state, ratings, sending, () => {
    keep(name, { key: state.key, ratings });
    show();
  })),
  h('section', { class: 'card send' }, left, submit)));
  show();
}

function oneScale(scale, k, state, ratings, sending, changed) {
  const { highest, step_of_scale: step } = state;
  const id = `scale-${scale.name}`;
  const ticks = h('div', { class: 'ticks', 'aria-hidden': 'true' }, Array.from({ length: highest / step + 1 }, () => h('i')));
  const input = h('input', {
    type: 'range', id, min: '0', max: String(highest), step: String(step), 'data-key': id, disabled: sending,
    'aria-describedby': `${id}-ends`, value: String(ratings[scale.name] ?? highest / 2),
  });
  const card = h('section', { class: 'card scale' },
    h('label', { for: id }, h('b', {}, `${k + 1}. ${scale.title}`), h('span', {}, scale.question)),
    h('div', { class: 'line' }, ticks, input),
    h('p', { class: 'ends', id: `${id}-ends` }, h('span', {}, scale.low), h('span', {}, scale.high)));
  const show = () => {
    const touched = scale.name in ratings;
    card.classList.toggle('touched', touched);
    input.setAttribute('aria-valuetext', touched ? `${ratings[scale.name]} of ${highest}, from ${scale.low} to ${scale.high}` : 'not marked yet');
  };
  const touch = () => {
    ratings[scale.name] = Number(input.value);
    show();
    changed();
  };
  input.addEventListener('input', touch);
  input.addEventListener('change', touch);
  input.addEventListener('click', touch); // a click at the place of the hidden mark
  input.addEventListener('keydown', (event) => {
    if (event.key === ' ' || event.key === 'Enter') {
      event.preventDefault();
      touch();
    }
  });
  show();
  return card;
}
