// The operator's page: waits, and shows a questionnaire when the protocol comes to one.

import { fill, h, part } from './dom.js';
import { keep, Link } from './link.js';
import { pairs } from './pairs.js';
import { scales } from './scales.js';

const THANKS = 6000; // ms
const link = new Link('/operator/link');
let shown = null; // key of what stands on the page
let thanked = 0;
let refusal = '';

function draw() {
  const { state } = link;
  const chip = part('link');
  chip.textContent = link.connected ? 'connected' : link.everConnected ? 'cut off' : 'connecting';
  chip.dataset.kind = link.connected ? 'good' : link.everConnected ? 'bad' : 'idle';
  part('lost').hidden = link.connected || !link.everConnected;
  const trouble = link.trouble ? 'Your answers could not be saved yet. Please tell the experimenter; this page tries again.' : refusal;
  part('refused').hidden = !trouble;
  if (part('refused').textContent !== trouble) part('refused').textContent = trouble;
  if (!state?.what) return;
  part('study').textContent = state.study;
  part('who').textContent = state.operator ? `Participant ${state.operator}` : '';
  const asked = ['questionnaire', 'weights'].includes(state.what);
  const sending = link.pending;
  const key = asked ? `${state.key}/${sending}` : `${state.what}/${state.step}/${performance.now() < thanked}`;
  if (key === shown) return;
  const moved = shown !== null && !(asked && shown?.startsWith(state.key));
  shown = key;
  const name = `${link.name}:draft`;
  const send = (what, fields) => {
    refusal = '';
    link.command(what, state.operator, { task: state.task, block: state.block, ...fields });
  };
  const place = part('main');
  if (state.what === 'questionnaire') {
    thanked = 0;
    scales(place, state, { name, sending, send: (ratings) => send('answer', { point: state.point, ratings }) });
  } else if (state.what === 'weights') {
    thanked = 0;
    pairs(place, state, { name, sending, send: (winners) => send('weigh', { winners }) });
  } else {
    fill(place, waiting(state));
  }
  if (moved) {
    scrollTo({ top: 0 });
    place.focus({ preventScroll: true });
  }
}

function waiting(state) {
  const [title, text] = performance.now() < thanked ? ['Thank you', 'Your answers are saved.']
    : state.what === 'done' ? ['That was all', 'Thank you for taking part.']
      : state.what === 'break' ? ['Break', 'Rest your hand. The experimenter goes on when you are ready.']
        : ['Please follow the experimenter', 'The next questions appear here by themselves.'];
  return h('section', { class: 'card wait' }, h('h2', {}, title), h('p', {}, text));
}

link.addEventListener('done', () => {
  keep(`${link.name}:draft`, null);
  thanked = performance.now() + THANKS;
  setTimeout(draw, THANKS + 50);
});
link.addEventListener('refused', ({ detail }) => {
  refusal = `Not taken: ${detail.answer.error}`;
});
link.addEventListener('change', draw);
