// The fifteen pairs of NASA-TLX, one after the other.

import { button, fill, h } from './dom.js';
import { keep, kept } from './link.js';

/** Draws the pair that is next; choices are kept on the device until they are sent. */
export function pairs(place, state, { name, sending, send }) {
  const known = kept(name);
  const winners = known?.key === state.key ? known.winners : [];
  const { texts } = state;
  const count = state.pairs.length;
  // Sent in the order of the instrument, whatever order they are shown in.
  const sorted = () => winners.map((winner, k) => [state.pairs[k].place, winner]).sort(([a], [b]) => a - b).map(([, winner]) => winner);
  const again = () => {
    keep(name, { key: state.key, winners });
    pairs(place, state, { name, sending, send });
  };
  const at = winners.length;
  const back = button(texts.back, { id: 'back', kind: 'quiet', disabled: sending || at === 0, onclick: () => { winners.pop(); again(); } });
  if (at >= count) {
    fill(place, h('section', { class: 'card' }, h('h2', {}, texts.pairs_complete),
      h('div', { class: 'row' }, h('button', { type: 'button', class: 'main wide', 'data-key': 'submit', disabled: sending, onclick: () => send(sorted()) },
        sending ? texts.sending : texts.pairs_send), back)));
    return;
  }
  fill(place, h('section', { class: 'card pair' },
    h('h2', {}, texts.pairs_heading),
    h('p', { class: 'soft', role: 'status' }, `${texts.pair} ${at + 1} / ${count}`),
    h('progress', { max: count, value: at, 'aria-label': 'Pairs' }),
    h('div', { class: 'either' }, state.pairs[at].scales.map((scale, k) => h('button', {
      type: 'button', 'data-key': `pair-${k}`, onclick: () => { winners.push(scale.name); again(); },
    }, h('b', {}, scale.title), h('span', {}, scale.question)))),
    h('div', { class: 'row' }, back)));
}
