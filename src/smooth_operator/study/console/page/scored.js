// Scored trials of the operator who is on, by block; each can be amended.

import { fill, h, part } from './dom.js';

const SCORES = { 0: 'none', 0.5: 'half', 1: 'full' };
let drawn = '';

export function drawScored(place, { now }, actions, blocked) {
  const blocks = now?.scored ?? [];
  const key = JSON.stringify([now?.operator, blocks, blocked]);
  part('scored-card').hidden = !blocks.length;
  if (key === drawn) return;
  drawn = key;
  fill(place, blocks.map((block) => h('div', {},
    h('p', { class: 'soft' }, `${block.task}, block ${block.block}: ${block.condition}`),
    h('ol', { class: 'results', 'aria-label': `Scored trials of ${block.task}, block ${block.block}` }, block.trials.map((trial) => h('li', {},
      h('button', {
        type: 'button', class: `quiet ${SCORES[trial.score]} ${trial.amended ? 'amended' : ''}`, 'data-key': `amend-${block.task}-${block.block}-${trial.trial}`, disabled: blocked,
        title: `Trial ${trial.trial}: ${trial.line}${trial.amended ? ', amended' : ''}. Amend it`, onclick: () => actions.amend(block, trial),
      }, h('b', {}, String(trial.score)), h('span', {}, `${trial.time_s.toFixed(1)} s`))))))));
}
