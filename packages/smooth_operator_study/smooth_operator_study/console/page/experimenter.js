// The experimenter's page: the step that is due, keys, notes, the log, progress of the operators.

import { ask } from './dialogs.js';
import { clock, h, fill, part } from './dom.js';
import { keep, Link, moment, stored } from './link.js';
import { drawPeople, drawScored } from './lists.js';
import { drawStep } from './step.js';

const link = new Link('/link');
let refusal = '';
let drawn = '';
const PLACE = ['task', 'block', 'trial'];
const REASON = { name: 'reason', label: 'Reason', required: true };
const CODE = '[A-Za-z0-9][A-Za-z0-9_.\\-]*';

/** Time at which the clock of the running trial was stopped on this page; null if it runs. */
const stopped = {
  key() {
    const now = link.state?.now;
    return now?.what === 'trial' ? `${link.state.study.name}/${now.operator}/${now.task}/${now.block}/${now.trial}/${now.since}/${now.paused_ms}` : null;
  },
  get at() {
    const stop = stored('smooth-operator:stopped');
    return stop && stop.key === this.key() ? stop.at : null;
  },
  set at(moment) {
    keep('smooth-operator:stopped', moment === null ? null : { key: this.key(), at: moment });
  },
};

/** Describes how a line of the rubric contradicts the simulation; empty if it does not. */
function contradiction({ now, teleop }, name) {
  const sim = teleop?.trial;
  const line = now.rubric.find((one) => one.name === name);
  if (!sim || !line) return '';
  const score = now.resets > 0 ? Math.min(line.score, now.reset_cap) : line.score;
  if (score === sim.score) return '';
  const so = sim.phase === 'done' ? '' : ' so far';
  return `You score ${line.name}, ${score}. The simulation says${so}: ${sim.line}, ${sim.score} (${sim.reason}).`;
}

/** Commands for the parts of the page. */
const actions = {
  link,
  stopped,
  /** Sends a command for the current operator. */
  send(what, fields = {}, more = {}) {
    const now = link.state.now;
    refusal = '';
    link.command(what, now.operator, fields, { after: now.after, ...more });
  },
  place(...names) {
    return Object.fromEntries(names.map((name) => [name, link.state.now[name]]));
  },
  /** Returns `send` for the operator and the place that are shown now: they may change while a
   * question is open. */
  sender(...names) {
    const { now } = link.state;
    const place = this.place(...names);
    return (what, fields = {}, more = {}) => {
      refusal = '';
      link.command(what, now.operator, { ...place, ...fields }, { after: now.after, ...more });
    };
  },
  choose(operator) {
    refusal = '';
    link.command('choose', operator);
  },
  stop() {
    stopped.at = stopped.at === null ? moment() : null;
    draw();
  },
  async score(line) {
    const since = stopped.at ?? moment(); // the time of the question does not count
    const send = actions.sender('task', 'block', 'trial');
    const doubt = contradiction(link.state, line);
    if (doubt && !await ask('The simulation says something else', doubt, [], 'Score it anyway')) return;
    send('score', { line }, { since });
  },
  /** Asks a question, and sends the answer for the operator and the place at the time of the question. */
  async inquire(what, names, title, text, fields, yes, fieldsOf = (answer) => answer) {
    const send = actions.sender(...names);
    const answer = await ask(title, text, fields, yes);
    if (answer) send(what, fieldsOf(answer));
  },
  voidTrial: () => actions.inquire('void', PLACE, 'Void this trial', 'Use this if the cause is not the operator. The trial will be repeated.', [REASON], 'Void'),
  pause: () => actions.inquire('pause', PLACE, 'Pause the clock',
    'Use this for a fault that is not the operator’s. The time until you resume does not count.', [REASON], 'Pause'),
  endBlock: () => actions.inquire('end_block', PLACE.slice(0, 2), `End block ${link.state.now.block} of ${link.state.now.task} now?`,
    'Its remaining trials and questionnaires are skipped. The next block follows.', [REASON], 'End the block'),
  recalibrate: () => actions.inquire('recalibrate', ['task'], 'Calibrate again', 'Calibrate, then enter the file. It is loaded into the running teleop.',
    [{ name: 'detail', label: 'Calibration file or note', required: true, maxLength: 400 }], 'Calibrated'),
  withdraw: () => actions.inquire('withdraw', [], `Operator ${link.state.now.operator} withdraws`,
    'There are no further steps, and a running trial becomes void. To delete the data, use smooth-operator study erase.', [
      { name: 'keep', label: 'The data so far', type: 'select', options: [
        { value: 'keep', text: 'is kept and may be analysed' }, { value: 'leave', text: 'is left out of the analysis' }] },
      { name: 'reason', label: 'Reason, if given' }], 'Withdraw', ({ keep: choice, reason }) => ({ keep: choice === 'keep', reason })),
  async amend(block, trial) {
    const send = actions.sender();
    const { study } = link.state;
    const { rubric } = study.tasks.find((task) => task.name === block.task);
    const answer = await ask(`Amend trial ${trial.trial} of ${block.task}, block ${block.block}`,
      `It was scored ${trial.line}, ${trial.score}, in ${trial.time_s.toFixed(1)} s. The log keeps this score.`, [
        { name: 'line', label: 'Line of the rubric', type: 'select', options: rubric.map((line) => ({
          value: line.name, text: `${line.name}: ${trial.resets ? Math.min(line.score, study.reset_cap) : line.score}`, selected: line.name === trial.line })) },
        { name: 'time', label: 'Time [s]', type: 'number', min: '0', step: 'any', value: String(trial.time_s), required: true },
        { name: 'reason', label: 'Reason', required: true },
        { name: 'who', label: 'Decided by (initials)', maxLength: 40 }], 'Amend');
    if (!answer) return;
    const time = Number(answer.time);
    send('amend', { task: block.task, block: block.block, trial: trial.trial, line: answer.line,
      ...(time === trial.time_s ? {} : { time_s: time }), reason: answer.reason, who: answer.who });
  },
  endFamiliarisation: () => actions.inquire('end_familiarisation', PLACE.slice(0, 2), 'End free movement now?', 'The planned time is not over yet.', [], 'End it'),
  undo() {
    const last = link.state?.now?.undoable;
    if (!last || !part('undo').matches(':enabled')) return;
    actions.inquire('undo', [], `Undo event ${last.number}?`, `${last.text}. It will no longer count, but stays in the log.`,
      [{ name: 'reason', label: 'Reason (kept in the log)' }], 'Undo', ({ reason }) => ({ number: last.number, reason }));
  },
  async enrol() {
    const tasks = link.state.study.tasks;
    const answer = await ask('Enrol an operator', 'Use a code, never a name. Keep the list of names on paper.', [
      { name: 'code', label: 'Code', required: true, pattern: CODE, maxLength: 64 },
      ...tasks.map((task) => ({ name: `task:${task.name}`, label: `${task.name}: ${task.title}`, type: 'checkbox', checked: true })),
    ], 'Enrol');
    if (!answer) return;
    const chosen = tasks.map((task) => task.name).filter((name) => answer[`task:${name}`]);
    refusal = '';
    link.command('enrol', answer.code, { tasks: chosen });
  },
};

function draw() {
  const { state } = link;
  const chip = part('link');
  chip.textContent = link.connected ? (link.outbox.length ? 'saving …' : 'connected') : link.everConnected ? 'disconnected' : 'connecting';
  chip.dataset.kind = link.connected ? (link.outbox.length ? 'idle' : 'good') : 'bad';
  show('lost', !link.connected && link.everConnected,
    link.pending ? 'Disconnected from the console. What you entered is kept here and will be sent when the connection is back.'
      : 'Disconnected from the console. Reconnecting; the clocks keep running.');
  const trouble = link.trouble || state?.trouble || '';
  show('store', trouble, link.trouble ? `Not saved: ${trouble}. Trying again.` : `Nothing can be saved now: ${trouble}.`);
  part('drop').hidden = !link.trouble;
  show('refused', refusal, refusal);
  if (!state?.study) return;
  drawHead(state);
  const blocked = !link.connected || link.pending;
  const key = JSON.stringify([state.now, state.teleop?.trial, state.links, state.pages, blocked, link.connected, link.pending, stopped.at]);
  if (key !== drawn) {
    drawStep(part('step'), state, actions, blocked);
    drawLog(state.log);
    drawn = key;
  }
  drawPeople(part('people'), state, actions);
  drawScored(part('scored'), state, actions, blocked);
  const last = state.now?.undoable;
  part('undo').disabled = blocked || !last;
  part('undo-what').textContent = last ? `Undo cancels #${last.number}: ${last.text}` : '';
  part('enrol').disabled = !link.connected;
  tick();
}

function drawHead({ study, now, teleop, pages }) {
  part('study').textContent = study.name;
  document.title = now ? `${now.operator}: ${now.words} – ${study.name}` : study.name;
  part('who').textContent = now ? `Operator ${now.operator}${now.task ? ` · ${now.title}` : ''}` : 'No operator is selected';
  part('blind').hidden = !study.blind;
  const there = pages.operator > 0;
  part('tablet').textContent = there ? 'tablet connected' : 'no tablet';
  part('tablet').dataset.kind = there ? 'good' : 'idle';
  const chip = part('teleop');
  chip.hidden = !teleop;
  show('hand', teleop && ['refused', 'gone'].includes(teleop.state),
    teleop?.state === 'gone' ? `teleop does not answer. ${teleop.detail}` : `teleop was not switched: ${teleop?.detail}`);
  if (teleop) {
    const scene = teleop.scene ? ` · ${teleop.scene}` : '';
    chip.textContent = { ready: `robot hand: ${teleop.running ?? 'ready'}${scene}`, switching: 'robot hand: switching …', refused: 'robot hand: not switched',
      gone: 'robot hand: no answer', unknown: 'robot hand: …' }[teleop.state];
    chip.dataset.kind = { ready: 'good', refused: 'bad', gone: 'bad' }[teleop.state] ?? 'idle';
  }
}

function drawLog(log) {
  fill(part('log'), log.map((entry) => h('li', { class: `${entry.undone ? 'undone' : ''} is-${entry.kind}` },
    h('time', {}, new Date(entry.at).toLocaleTimeString([], { hour12: false })),
    h('span', { class: 'text' }, entry.text, entry.author !== 'experimenter' && h('i', {}, ` by ${entry.author === 'system' ? 'the console' : 'the operator'}`)),
    h('span', { class: 'number' }, `#${entry.number}`))));
}

function show(id, when, text) {
  const shown = part(id);
  shown.hidden = !when;
  const place = shown.querySelector('span') ?? shown;
  if (when && place.textContent !== text) place.textContent = text;
}

/** Updates the clocks: elements with data-since count up, those with data-until count down. */
function tick() {
  for (const shown of document.querySelectorAll('[data-since]')) {
    const end = stopped.at === null || !('stoppable' in shown.dataset) ? link.now() : stopped.at + link.offset;
    const seconds = Math.max(0, (end - Number(shown.dataset.since)) / 1000);
    shown.textContent = clock(seconds, 'tenths' in shown.dataset);
    const limit = Number(shown.dataset.limit ?? 0);
    shown.classList.toggle('over', limit > 0 && seconds > limit);
  }
  for (const shown of document.querySelectorAll('[data-until]')) {
    const left = Math.max(0, (Number(shown.dataset.until) - link.now()) / 1000);
    if (shown.tagName === 'PROGRESS') shown.value = shown.max - left;
    else shown.textContent = clock(Math.ceil(left - 1e-6));
  }
}

addEventListener('keydown', (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
  const open = document.querySelector('dialog[open]');
  const typing = event.target.closest?.('input, textarea, select');
  if (event.key === 'Escape' && !open) {
    refusal = '';
    if (typing) typing.blur();
    draw();
    return;
  }
  if (open || typing) {
    if (event.target === part('note') && event.key === 'Enter' && !event.shiftKey) {
      event.preventDefault();
      part('noting').requestSubmit();
    }
    return;
  }
  if (event.key.toLowerCase() === 'n') {
    event.preventDefault();
    part('note').focus();
    return;
  }
  const name = event.key === ' ' ? 'space' : event.key.toLowerCase();
  const pressed = document.querySelector(`[data-press="${CSS.escape(name)}"]:enabled`);
  if (pressed) {
    event.preventDefault(); // a button that has the focus would be pressed as well
    pressed.click();
  } else if (name === 'space' && !event.target.closest?.('button, a, summary')) {
    event.preventDefault();
  }
});

part('noting').addEventListener('submit', (event) => {
  event.preventDefault();
  const text = part('note').value.trim();
  if (!text || !link.state?.now) return;
  actions.send('note', { text });
  part('note').value = '';
  keep('smooth-operator:note', null);
  part('note').blur();
});
part('note').addEventListener('input', () => keep('smooth-operator:note', part('note').value || null));
part('note').value = stored('smooth-operator:note') ?? '';
part('undo').addEventListener('click', actions.undo);
part('enrol').addEventListener('click', actions.enrol);
part('switch').addEventListener('click', () => actions.send('switch'));
part('drop').addEventListener('click', () => link.drop());
part('dismiss').addEventListener('click', () => { refusal = ''; draw(); });
link.addEventListener('refused', ({ detail }) => { refusal = detail.answer.error; });
link.addEventListener('done', ({ detail }) => {
  refusal = '';
  if (['score', 'void'].includes(detail.command.do)) stopped.at = null;
});
link.addEventListener('change', draw);
setInterval(tick, 100);
