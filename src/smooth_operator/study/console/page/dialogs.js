// Dialogs of the experimenter's page: one for all questions, and one for what stands on paper.

import { fill, h, part } from './dom.js';
import { form } from './form.js';
import { keep } from './link.js';

let answer = null;

/** Asks; resolves to {name: value}, or to null if it was cancelled. */
export function ask(title, text, fields, yes) {
  const dialog = part('ask');
  if (dialog.open) return Promise.resolve(null);
  part('ask-title').textContent = title;
  part('ask-text').textContent = text;
  part('ask-yes').textContent = yes;
  fill(part('ask-fields'), fields.map(({ name, label, type = 'text', options = [], ...rest }) => {
    const id = `ask-${name}`;
    if (type === 'select') {
      return h('p', {}, h('label', { for: id }, label), h('select', { id, name }, options.map(({ value, text, selected }) =>
        h('option', { value, selected }, text))));
    }
    const input = h('input', { id, name, type, autocomplete: 'off', ...rest });
    return type === 'checkbox' ? h('label', { class: 'check', for: id }, input, h('span', {}, label))
      : h('p', {}, h('label', { for: id }, label), input);
  }));
  dialog.showModal();
  (dialog.querySelector('#ask-fields :is(input, select)') ?? part('ask-yes')).focus();
  return new Promise((resolve) => {
    answer = resolve;
  });
}

function finish(values) {
  const resolve = answer;
  answer = null;
  part('ask').close();
  if (resolve) resolve(values);
}

part('ask').querySelector('form').addEventListener('submit', (event) => {
  event.preventDefault();
  finish(Object.fromEntries([...event.target.querySelectorAll('input, select')]
    .map((input) => [input.name, input.type === 'checkbox' ? input.checked : input.value.trim()])));
});
part('ask-no').addEventListener('click', () => finish(null));
part('ask').addEventListener('cancel', (event) => {
  event.preventDefault();
  finish(null);
});

const TEXTS = {
  send: 'Save', sending: 'Saving …', form_missing: 'Still to answer:', form_complete: 'Nothing is missing.', yes: 'Yes', no: 'No',
  ranking: 'Click them in the operator’s order, the best one first.', again: 'Start again',
};
const STATES = { due: 'on the tablet now', later: 'not due yet' };
let drawn = '';

export function drawForms(place, { study, now }, actions, blocked) {
  const forms = now?.forms ?? [];
  const key = JSON.stringify([now?.operator, forms, blocked]);
  part('forms-card').hidden = !forms.length;
  if (key === drawn) return;
  drawn = key;
  fill(place, forms.map((one) => h('li', { class: one.state },
    h('span', {}, h('b', {}, one.title), h('span', { class: 'soft' }, ` ${source(one)}`)),
    (one.can || one.answers) && h('button', { type: 'button', class: 'quiet', 'data-key': `form-${one.form}`, disabled: blocked,
      onclick: () => open(one, now, study, actions) }, one.answers ? 'Open' : 'Type in'))));
}

function source({ state, at, who }) {
  if (state in STATES) return STATES[state];
  const time = new Date(at).toLocaleTimeString([], { hour12: false });
  if (state === 'paper') return `on paper (${who}), to be typed in`;
  return who ? `typed in by ${who}, ${time}` : `filled in by the operator, ${time}`;
}

/** A form to read, or to type in what stands on paper; answers that are there are replaced with a reason only. */
function open(one, now, study, actions) {
  typeIn({ ...one, key: `${now.operator}/${one.form}/${one.at}` }, {
    name: `${study.name}/${now.operator}/${one.form}`, about: `Operator ${now.operator}, ${source(one)}.`, answers: one.answers,
    send: (answers, more) => actions.typeIn(now.operator, { form: one.form, answers, ...more }),
  });
}

/** Opens the dialog in which somebody types in what stands on paper, and says who. name: of the draft. */
function typeIn(asked, { name, about, answers = null, send }) {
  const dialog = part('paper');
  const draft = `smooth-operator:paper:${name}`;
  const own = (id, label) => h('input', { id, maxLength: 400, autocomplete: 'off', required: true, 'aria-label': label, placeholder: label });
  const who = own('paper-who', 'Typed in by (initials)');
  const reason = answers && own('paper-reason', 'Why the answers are replaced');
  form(part('paper-form'), { ...asked, texts: TEXTS }, {
    name: draft, sending: false, answers: answers ?? {},
    more: h('section', { class: 'card field' }, h('p', { class: 'soft' }, about), who, reason),
    send: (values) => {
      dialog.close();
      keep(draft, null);
      send(values, { who: who.value.trim(), ...(reason ? { reason: reason.value.trim() } : {}) });
    },
  });
  dialog.showModal();
}

part('paper-close').addEventListener('click', () => part('paper').close());

/** Asks for what is due, and sends it with the initials of who typed it in. */
export function typeTlx({ study, now }, actions) {
  const { asked } = now;
  const send = actions.asked('task', 'block', ...(now.what === 'questionnaire' ? ['point'] : []));
  const about = `Operator ${now.operator}, ${now.words}. Nobody sees the workload before the block is over.`;
  const draft = { name: `${study.name}/${asked.key}`, about };
  if (now.what === 'questionnaire') {
    const fields = asked.scales.map(({ name, title, low, high }) => ({
      name, kind: 'number', label: `${title}: 0 (${low}) to ${asked.highest} (${high})`, required: true,
      least: 0, most: asked.highest, step: asked.step_of_scale,
    }));
    const text = `The place of each mark, in steps of ${asked.step_of_scale}.`;
    typeIn({ title: 'NASA-TLX from paper', text, fields, key: asked.key }, { ...draft, send: (ratings, more) => send('answer', { ratings, ...more }) });
    return;
  }
  const named = ({ scales }) => scales.map(({ name }) => name).join('-');
  const fields = asked.pairs.map((pair, k) => ({ name: named(pair), kind: 'choice', label: `Pair ${k + 1}`, choices: pair.scales.map(({ title }) => title), required: true }));
  const winner = (pair, title) => pair.scales.find((scale) => scale.title === title).name;
  typeIn({ title: 'Pairs of scales from paper', text: 'Of each pair, the scale that contributed more to the workload.', fields, key: asked.key }, {
    ...draft, send: (titles, more) => send('weigh', { winners: asked.pairs.map((pair) => winner(pair, titles[named(pair)])), ...more }),
  });
}
