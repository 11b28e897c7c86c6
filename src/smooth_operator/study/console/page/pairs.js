// The fifteen pairs of NASA-TLX, one after the other.

import { button, fill, h } from './dom.js';
import { keep, kept } from './link.js';

/** Draws the pair that is next; choices are kept on the device until they are sent. */
export function pairs(place, state, { name, sending, send }) {
  const known = kept(name);
  const winners = known?.key === state.key ? known.winners : [];
  const count = state.pairs.length;
  const again = () => {
    keep(name, { key: state.key, winners });
    pairs(place, state, { name, sending, send });
  };
  const at = winners.length;
  const back = button('Back', { id: 'back', kind: 'quiet', disabled: sending || at === 0, onclick: () => { winners.pop(); again(); } });
  if (at >= count) {
    fill(place, h('section', { class: 'card' }, h('h2', {}, 'All pairs are chosen'),
      h('div', { class: 'row' }, h('button', { type: 'button', class: 'main wide', 'data-key': 'submit', disabled: sending, onclick: () => send(winners) },
        sending ? 'Sending …' : 'Send my choices'), back)));
    return;
  }
  fill(place, h('section', { class: 'card pair' },
    h('h2', {}, 'Which of the two added more to your workload?'),
    h('p', { class: 'soft', role: 'status' }, `Pair ${at + 1} of ${count}`),
    h('progress', { max: count, value: at, 'aria-label': 'Pairs' }),
    h('div', { class: 'either' }, state.pairs[at].map((scale, k) => h('button', {
      type: 'button', 'data-key': `pair-${k}`, onclick: () => { winners.push(scale.name); again(); },
    }, h('b', {}, scale.title), h('span', {}, scale.question)))),
    h('div', { class: 'row' }, back)));
}
