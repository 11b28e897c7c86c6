// Everybody's progress: a row for each operator, a box for each block.

import { fill, h } from './dom.js';

let drawn = '';

export function drawPeople(place, { overview, now }, actions) {
  const key = JSON.stringify([overview, now?.operator, actions.link.connected]);
  if (key === drawn) return;
  drawn = key;
  const before = place.querySelector('.person.on')?.dataset.key;
  fill(place, overview.map((one) => {
    const on = one.operator === now?.operator;
    return h('button', {
      type: 'button', class: `person ${on ? 'on' : ''} ${one.begun ? 'begun' : ''}`, 'data-key': `person-${one.operator}`, disabled: !actions.link.connected,
      'aria-pressed': String(on), onclick: () => on || actions.choose(one.operator),
    }, h('b', {}, one.operator), tasks(one),
    h('span', { class: 'soft' }, one.begun || one.what === 'done' ? one.step : 'not begun'));
  }));
  const on = place.querySelector('.person.on');
  if (on && on.dataset.key !== before) reveal(place, on);
}

/** Scrolls the list, and not the page, until a row can be seen. */
function reveal(list, row) {
  const [box, shown] = [row.getBoundingClientRect(), list.getBoundingClientRect()];
  if (box.top < shown.top) list.scrollTop -= shown.top - box.top;
  else if (box.bottom > shown.bottom) list.scrollTop += box.bottom - shown.bottom;
}

function tasks(one) {
  const groups = Map.groupBy ? Map.groupBy(one.blocks, (block) => block.task) : grouped(one.blocks);
  return h('span', { class: 'tasks' }, [...groups].map(([task, blocks]) =>
    h('span', { class: 'task' }, h('i', {}, task), blocks.map((block) =>
      h('meter', { class: block.state, min: 0, max: block.trials, value: block.scored,
        title: `Task ${task}, block ${block.number}, ${block.condition}: ${block.scored} of ${block.trials} trials`,
        'aria-label': `Task ${task}, block ${block.number}: ${block.scored} of ${block.trials} trials` })))));
}

function grouped(blocks) {
  const found = new Map();
  for (const block of blocks) found.set(block.task, [...(found.get(block.task) ?? []), block]);
  return found;
}
