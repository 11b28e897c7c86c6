// The operator's page: shows the form or questionnaire that is due, or asks the operator to wait.

import { fill, h, part } from './dom.js';
import { form } from './form.js';
import { keep, Link } from './link.js';
import { scales } from './tlx.js';

const THANKS = 6000; // ms
const link = new Link('/operator/link');
let shown = null; // key of the content of the page
let thanked = 0;
let refusal = '';

function draw() {
  const { state } = link;
  const chip = part('link');
  chip.textContent = link.connected ? 'connected' : link.everConnected ? 'disconnected' : 'connecting';
  chip.dataset.kind = link.connected ? 'good' : link.everConnected ? 'bad' : 'idle';
  part('lost').hidden = link.connected || !link.everConnected;
  const trouble = link.trouble ? 'Your answers could not be saved yet. Please tell the experimenter. This page will try again.' : refusal;
  part('refused').hidden = !trouble;
  if (part('refused').textContent !== trouble) part('refused').textContent = trouble;
  if (!state?.what) return;
  part('study').textContent = state.study;
  part('who').textContent = state.operator ? `Participant ${state.operator}` : '';
  const asked = ['form', 'questionnaire'].includes(state.what);
  const sending = link.pending;
  const key = asked ? `${state.key}/${sending}` : `${state.what}/${state.step}/${performance.now() < thanked}`;
  if (key === shown) return;
  const moved = shown !== null && !(asked && shown?.startsWith(state.key));
  shown = key;
  const name = `${link.name}:draft`;
  const send = (what, fields) => {
    refusal = '';
    link.command(what, state.operator, fields);
  };
  const at = { task: state.task, block: state.block };
  const place = part('main');
  if (state.what === 'questionnaire') {
    thanked = 0;
    scales(place, state, { name, sending, send: (ratings) => send('answer', { ...at, point: state.point, ratings }) });
  } else if (state.what === 'form') {
    thanked = 0;
    form(place, state, { name, sending, send: (answers) => send('form', { form: state.form, answers }) });
  } else {
    fill(place, waiting(state));
  }
  if (moved) {
    scrollTo({ top: 0 });
    place.focus({ preventScroll: true });
  }
}

function waiting(state) {
  const { texts } = state;
  const [title, text] = performance.now() < thanked ? [texts.thanks, texts.saved]
    : state.what === 'done' ? [texts.done, texts.done_text]
      : state.what === 'break' ? [texts.break, texts.break_text]
        : [texts.wait, texts.wait_text];
  return h('section', { class: 'card wait' }, h('h2', {}, title), h('p', {}, text));
}

link.addEventListener('done', () => {
  keep(`${link.name}:draft`, null);
  thanked = performance.now() + THANKS;
  setTimeout(draw, THANKS + 50);
});
link.addEventListener('refused', ({ detail }) => {
  refusal = `Not accepted: ${detail.answer.error}`;
});
link.addEventListener('change', draw);
