// Lists of the experimenter's page: progress of all operators, scored trials of the current one.

import { fill, h, part } from './dom.js';

let drawnPeople = '';
let drawnScores = '';

/** Draws a row for each operator, with a box for each block. */
export function drawPeople(place, { overview, now }, actions) {
  const key = JSON.stringify([overview, now?.operator, actions.link.connected]);
  if (key === drawnPeople) return;
  drawnPeople = key;
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

/** Scrolls the list, and not the page, to a row. */
function reveal(list, row) {
  const [box, shown] = [row.getBoundingClientRect(), list.getBoundingClientRect()];
  if (box.top < shown.top) list.scrollTop -= shown.top - box.top;
  else if (box.bottom > shown.bottom) list.scrollTop += box.bottom - shown.bottom;
}

function tasks(one) {
  const groups = new Map();
  for (const block of one.blocks) groups.set(block.task, [...(groups.get(block.task) ?? []), block]);
  return h('span', { class: 'tasks' }, [...groups].map(([task, blocks]) =>
    h('span', { class: 'task' }, h('i', {}, task), blocks.map((block) =>
      h('meter', { class: block.state, min: 0, max: block.trials, value: block.scored,
        title: `Task ${task}, block ${block.number}, ${block.condition}: ${block.scored} of ${block.trials} trials`,
        'aria-label': `Task ${task}, block ${block.number}: ${block.scored} of ${block.trials} trials` })))));
}

const SCORES = { 0: 'none', 0.5: 'half', 1: 'full' };

/** Draws the scored trials by block; each can be amended. */
export function drawScored(place, { now }, actions, blocked) {
  const blocks = now?.scored ?? [];
  const key = JSON.stringify([now?.operator, blocks, blocked]);
  part('scored-card').hidden = !blocks.length;
  if (key === drawnScores) return;
  drawnScores = key;
  fill(place, blocks.map((block) => h('div', {},
    h('p', { class: 'soft' }, `${block.task}, block ${block.block}: ${block.condition}`),
    h('ol', { class: 'results', 'aria-label': `Scored trials of ${block.task}, block ${block.block}` }, block.trials.map((trial) => h('li', {},
      h('button', {
        type: 'button', class: `quiet ${SCORES[trial.score]} ${trial.amended ? 'amended' : ''}`, 'data-key': `amend-${block.task}-${block.block}-${trial.trial}`, disabled: blocked,
        title: `Trial ${trial.trial}: ${trial.line}${trial.amended ? ', amended' : ''}. Amend it`, onclick: () => actions.amend(block, trial),
      }, h('b', {}, String(trial.score)), h('span', {}, `${trial.time_s.toFixed(1)} s`))))))));
}
