// The step that is due, and its buttons.

import { button, clock, fill, h } from './dom.js';

const SCORES = { 1: 'full', 0.5: 'half', 0: 'none' };
const POINTS = { initial: 'after the first trial', midpoint: 'in the middle', final: 'after the last trial' };

let typed = { name: '', text: '' }; // text of the calibration, for redraws

/** Draws the step of the current operator. blocked: whether all buttons are disabled. */
export function drawStep(card, state, actions, blocked) {
  const { now } = state;
  if (!now) {
    delete card.dataset.what;
    fill(card, h('h2', {}, 'Who takes part?'), h('p', {}, 'Choose an operator from the list, or enrol one.'));
    return;
  }
  fill(card, where(now), rest(now, state), ...(STEPS[now.what] ?? (() => []))(now, state, actions, blocked), aside(now, actions, blocked));
  card.dataset.what = now.what;
}

const STEPS = {
  calibrate(now, state, actions, blocked) {
    const name = `${now.operator}/${now.task}`;
    const detail = h('input', { id: 'detail', maxLength: 400, autocomplete: 'off', 'data-key': 'detail',
      placeholder: 'file of the calibration, e.g. P03.json', value: typed.name === name ? typed.text : '',
      oninput: () => { typed = { name, text: detail.value }; } });
    const send = (text) => actions.send('calibrated', { ...actions.place('task'), detail: text });
    return [
      h('h2', {}, 'Calibration'),
      h('p', {}, 'Calibrate tracker and hand to the operator, with the live page or smooth-operator calibrate. ',
        state.teleop && 'If you give a file, it is loaded into the running teleop.'),
      h('p', {}, h('label', { for: 'detail' }, 'Calibration file or note'), detail),
      h('div', { class: 'row' },
        main('Calibrated', 'Space', blocked, () => send(detail.value.trim())),
        button('Skip', { id: 'left-out', kind: 'quiet', disabled: blocked, onclick: () => send('left out') })),
    ];
  },
  start_block(now, state, actions, blocked) {
    return [
      h('h2', {}, `Block ${now.block} of ${now.blocks}`),
      h('p', { class: 'condition' }, now.condition),
      h('p', {}, state.teleop ? 'Starting the block sets the running robot to this method.'
        : 'Set the robot to this method, then start the block.',
        state.study.rate_hz && ` It gets ${state.study.rate_hz} commands per second.`),
      h('div', { class: 'row' }, main('Start block', 'Space', blocked,
        () => actions.send('start_block', actions.place('task', 'block')))),
    ];
  },
  start_familiarisation(now, state, actions, blocked) {
    return [
      h('h2', {}, 'Free movement'),
      h('p', {}, `The operator moves the hand for ${seconds(state.study.familiarisation_s)}, without the object.`),
      h('div', { class: 'row' }, main('Start free movement', 'Space', blocked,
        () => actions.send('start_familiarisation', actions.place('task', 'block')))),
    ];
  },
  familiarise(now, state, actions, blocked) {
    const until = now.since + 1000 * state.study.familiarisation_s;
    return [
      h('h2', {}, 'Free movement'),
      h('p', { class: 'clock', role: 'timer', 'data-until': String(until) }),
      h('progress', { 'aria-label': 'Free movement', max: state.study.familiarisation_s, value: 0, 'data-until': String(until) }),
      h('p', { class: 'soft' }, 'It ends automatically.'),
      h('div', { class: 'row' }, button('End now', { key: 'E', id: 'end', kind: 'quiet', disabled: blocked, onclick: actions.endFamiliarisation })),
    ];
  },
  start_trial(now, state, actions, blocked) {
    return [
      h('h2', {}, `Trial ${now.trial} of ${now.trials}`),
      now.instruction && h('p', {}, now.instruction),
      h('div', { class: 'row' }, main(`Start trial ${now.trial}`, 'Space', blocked,
        () => actions.send('start_trial', actions.place('task', 'block', 'trial')))),
      rubric(now, actions, true),
    ];
  },
  trial(now, state, actions) {
    const waiting = actions.link.pending;
    const sim = state.teleop?.trial;
    const over = sim?.phase === 'done';
    const fixed = now.undone_time_s ?? (over ? sim.time_s : null); // already measured
    const stopped = actions.stopped.at !== null;
    const limit = now.limit_s ?? state.teleop?.limit_s ?? null;
    return [
      h('h2', {}, `Trial ${now.trial} of ${now.trials}`),
      h('p', { class: `clock ${stopped || fixed !== null ? 'stopped' : ''}`, role: 'timer', 'aria-live': 'off',
        ...(fixed !== null ? {} : { 'data-since': String(now.since + now.paused_ms), 'data-tenths': '', 'data-stoppable': '', 'data-limit': String(limit ?? 0) }) },
      fixed === null ? '' : clock(fixed, true)),
      h('p', { class: 'soft' }, now.undone_time_s !== null ? 'The measured time stays; score the trial again.'
        : stopped ? 'The clock is stopped. Choose a line of the rubric.'
          : limit ? `Time limit ${seconds(limit)}${now.limit_s ? '' : ', of the simulation'}.` : 'No time limit.'),
      now.resets > 0 && h('p', { class: 'notice' }, `The object was reset, so the score is at most ${now.reset_cap}.`),
      sim && proposal(now, sim, actions, waiting),
      h('div', { class: 'row' },
        fixed === null && button(stopped ? 'Resume the clock' : 'Stop the clock', { key: 'Space', id: 'stop', kind: stopped ? 'quiet' : 'main', disabled: waiting, onclick: actions.stop }),
        button('Object reset', { key: 'R', id: 'reset', kind: 'quiet', disabled: waiting || !actions.link.connected || now.resets_left === 0,
          onclick: () => actions.send('reset', actions.place('task', 'block', 'trial')) }),
        button('Pause', { key: 'P', id: 'pause', kind: 'quiet', disabled: waiting || !actions.link.connected, onclick: actions.pause }),
        button('Void', { key: 'V', id: 'void', kind: 'quiet', disabled: waiting || !actions.link.connected, onclick: actions.voidTrial })),
      rubric(now, actions, waiting),
    ];
  },
  paused(now, state, actions, blocked) {
    return [
      h('h2', {}, `Trial ${now.trial} of ${now.trials}: paused`),
      h('p', { class: 'clock stopped', role: 'timer' }, clock((now.since - now.started - now.paused_ms) / 1000, true)),
      h('p', { class: 'soft' }, 'Paused for ', h('span', { role: 'timer', 'data-since': String(now.since) }), '. This time does not count.'),
      h('div', { class: 'row' },
        main('Resume the clock', 'Space', blocked, () => actions.send('resume', actions.place('task', 'block', 'trial'))),
        button('Object reset', { key: 'R', id: 'reset', kind: 'quiet', disabled: blocked || now.resets_left === 0,
          onclick: () => actions.send('reset', actions.place('task', 'block', 'trial')) }),
        button('Void', { key: 'V', id: 'void', kind: 'quiet', disabled: blocked, onclick: actions.voidTrial })),
    ];
  },
  form(now, state) {
    return [h('h2', {}, `Form: ${now.form}`),
      h('p', {}, 'The operator fills it in on the tablet. This page continues automatically.'), ...tablet(state)];
  },
  refused(now) {
    return [h('h2', {}, 'Consent refused'),
      h('p', {}, `Operator ${now.operator} did not agree to take part, so nothing can start. If this was a mistake, undo it; the form is then shown again.`)];
  },
  withdrawn(now) {
    return [h('h2', {}, 'Withdrawn'),
      h('p', {}, `Operator ${now.operator} has withdrawn; the data is ${now.withdrawn.keep ? 'kept' : 'left out of the analysis, and its rows are free for the next operator to enrol'}. ${now.withdrawn.reason}`)];
  },
  questionnaire(now, state) {
    return [h('h2', {}, 'Questionnaire'),
      h('p', {}, `The operator fills in NASA-TLX (${POINTS[now.point] ?? now.point}) on the tablet. This page continues automatically.`),
      ...tablet(state)];
  },
  break(now, state, actions, blocked) {
    return [
      h('h2', {}, 'Break'),
      h('p', { class: 'clock', role: 'timer', 'aria-live': 'off', 'data-since': String(now.since), 'data-limit': String(state.study.break_s) }),
      h('p', { class: 'soft' }, `Planned: ${seconds(state.study.break_s)}. Next: ${now.task ? `block ${now.block} of ${now.blocks}` : 'the end'}.`),
      h('div', { class: 'row' }, main('Continue', 'Space', blocked, () => actions.send('end_break'))),
    ];
  },
  done(now) {
    return [h('h2', {}, 'Done'), h('p', {}, `Operator ${now.operator} has finished. All data is saved.`)];
  },
};

function where(now) {
  if (!now.task) return h('p', { class: 'where' }, `Operator ${now.operator}`);
  return h('p', { class: 'where' }, h('b', {}, now.operator), ` Task ${now.task} `, h('span', {}, `block ${now.block} of ${now.blocks}`),
    now.what === 'calibrate' ? '' : h('span', { class: 'label' }, now.condition));
}

function main(text, key, disabled, onclick) {
  return button(text, { key, id: 'main', kind: 'main', disabled, onclick });
}

/** Shows the proposal of the simulation, which the experimenter may accept. */
function proposal(now, sim, actions, waiting) {
  if (sim.phase !== 'done') return h('p', { class: 'soft' }, `In the simulation: ${sim.reason}.`);
  const match = now.rubric.find(({ name }) => name === sim.line);
  const line = match?.possible ? match : null;
  const says = `The simulation says: ${sim.line}, ${sim.score} (${sim.reason})`;
  return h('p', { class: 'notice good proposal' }, h('span', {}, line ? says
    : `${says}. ${match ? 'That line is not possible now' : 'The rubric of the plan has no such line'}; choose one.`),
    line && button(`Score it ${line.name}`, { key: 'Enter', id: 'take', kind: 'main', disabled: waiting, onclick: () => actions.score(line.name) }));
}

function rubric(now, actions, off) {
  return h('div', { class: 'rubric', role: 'group', 'aria-label': 'Rubric' }, now.rubric.map((line, k) =>
    h('button', {
      type: 'button', 'data-key': line.name, 'data-press': off ? null : String(k + 1), class: `line ${SCORES[line.score]}`,
      disabled: off || !line.possible, onclick: () => actions.score(line.name),
    }, h('kbd', {}, String(k + 1)), h('b', { class: 'score' }, String(line.score)),
    h('span', {}, h('strong', {}, line.name), h('span', {}, line.text)))));
}

/** Offers a break if the plan has one here. */
function rest(now, state) {
  return now.break_due && h('p', { class: 'notice' }, `Offer a break of ${seconds(state.study.break_s)} (B).`);
}

function aside(now, actions, blocked) {
  const quiet = (text, id, onclick, key) => button(text, { key, id, kind: 'quiet', disabled: blocked, onclick });
  return h('div', { class: 'row foot' },
    now.break_possible && quiet('Break', 'break', () => actions.send('start_break'), 'B'),
    now.can_calibrate && quiet('Calibrate again', 'recalibrate', actions.recalibrate),
    now.can_end_block && quiet('End block', 'end-block', actions.endBlock),
    !now.withdrawn && quiet('Withdraw', 'withdraw', actions.withdraw),
    now.minutes_left > 0 && h('span', { class: 'soft left' }, `About ${now.minutes_left} min left`));
}

function tablet({ links, pages }) {
  const there = pages.operator > 0;
  return [
    h('p', { class: there ? 'notice good' : 'notice' }, there ? 'The operator’s page is open.' : 'The operator’s page is not open yet.'),
    h('div', { class: 'tablet' },
      links.qr && h('img', { src: '/operator.svg', alt: 'QR code of the operator’s page', width: '180', height: '180' }),
      h('p', {}, h('a', { href: links.operator, target: '_blank', rel: 'noopener' }, links.operator.replace(/\?.*/, '')),
        h('br'), h('span', { class: 'soft' }, links.qr ? 'Scan this code with the tablet. The link opens only the questionnaires.'
          : 'Only this machine can open it; start with --host 0.0.0.0 to use a tablet.'))),
  ];
}

function seconds(value) {
  return value >= 60 && value % 60 === 0 ? `${value / 60} min` : `${value} s`;
}
