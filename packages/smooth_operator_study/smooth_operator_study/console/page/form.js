// A form of the study: texts, numbers, choices, scales, consent, a ranking of blind labels.

import { button, fill, h } from './dom.js';
import { keep, stored } from './link.js';

/** Draws a form; answers are stored on the device until they are sent. */
export function form(place, state, { name, sending, send }) {
  const draft = stored(name);
  const answers = draft?.key === state.key ? draft.answers : {};
  const { texts } = state;
  const begun = new Set(); // incomplete rankings, numbers out of range
  const left = h('p', { class: 'soft', role: 'status' });
  const submit = h('button', { type: 'submit', class: 'main wide', 'data-key': 'submit' }, sending ? texts.sending : texts.send);
  const show = () => {
    const open = state.fields.filter((field) => !(field.name in answers));
    const wrong = open.filter((field) => field.kind === 'number' && begun.has(field.name));
    const missing = open.filter((field) => !wrong.includes(field) && (due(field) || begun.has(field.name)));
    const lines = [
      wrong.length > 0 && `${texts.form_range} ${wrong.map((field) => field.label + (range(field) && ` (${range(field)})`)).join(', ')}.`,
      missing.length > 0 && `${texts.form_missing} ${missing.map((field) => field.label).join(', ')}`,
    ].filter(Boolean);
    left.textContent = lines.join(' ') || texts.form_complete;
    submit.disabled = sending || lines.length > 0;
  };
  const due = (field) => field.required && (field.kind !== 'ranking' || field.ranked.length > 1);
  const set = (field, value, partly = false) => {
    if (partly) begun.add(field.name);
    else begun.delete(field.name);
    if (value === null) delete answers[field.name];
    else answers[field.name] = value;
    keep(name, { key: state.key, answers });
    show();
  };
  fill(place, h('form', {
    class: 'asked',
    onsubmit: (event) => {
      event.preventDefault();
      if (!submit.disabled) send(answers);
    },
  },
  h('section', { class: 'card intro' }, h('h2', {}, state.title), state.text && h('p', {}, state.text)),
  state.fields.map((field) => h('section', { class: 'card field' }, (DRAWN[field.kind] ?? DRAWN.text)(field, answers[field.name], (value, partly) => set(field, value, partly), sending, texts))),
  h('section', { class: 'card send' }, left, submit)));
  show();
}

const DRAWN = {
  text(field, value, set, off) {
    const id = `field-${field.name}`;
    return [label(id, field), h('textarea', { id, rows: '2', maxLength: 4000, disabled: off,
      oninput: (event) => set(event.target.value.trim() ? event.target.value : null) }, value ?? '')];
  },
  number(field, value, set, off) {
    const id = `field-${field.name}`;
    return [label(id, field, range(field)), h('input', { id, type: 'number', inputMode: 'decimal', step: text(field.step) ?? 'any', disabled: off, min: text(field.least), max: text(field.most),
      value: text(value) ?? '', oninput: ({ target }) => {
        const { valid } = target.validity;
        target.setAttribute('aria-invalid', String(!valid));
        set(target.value === '' || !valid ? null : Number(target.value), !valid);
      } })];
  },
  choice(field, value, set, off) {
    return choices(field, field.choices.map((one) => [one, one]), value, set, off);
  },
  scale(field, value, set, off) {
    return [...choices(field, Array.from({ length: field.steps }, (_, k) => [k + 1, String(k + 1)]), value, set, off, 'steps'),
      h('p', { class: 'ends' }, h('span', {}, field.low), h('span', {}, field.high))];
  },
  consent(field, value, set, off, texts) {
    return choices(field, [[true, texts.yes], [false, texts.no]], value, set, off);
  },
  ranking(field, value, set, off, texts) {
    let order = value ?? [];
    const place = h('div', { class: 'ranking' });
    const draw = () => {
      const rest = field.ranked.filter((one) => !order.includes(one.label));
      fill(place, h('ol', {}, order.map((one) => h('li', {}, one))),
        h('div', { class: 'row' }, rest.map((one) => h('button', { type: 'button', class: 'quiet', 'data-key': `rank-${one.label}`, disabled: off, onclick: () => {
          order = [...order, one.label];
          const whole = order.length === field.ranked.length;
          set(whole ? order : null, !whole);
          draw();
        } }, h('span', {}, h('b', {}, one.label), one.where && h('span', { class: 'soft' }, ` ${one.where}`)))),
        order.length > 0 && button(texts.again, { id: 'again', kind: 'quiet', disabled: off, onclick: () => { order = []; set(null); draw(); } })));
    };
    draw();
    return [h('p', { class: 'label' }, field.label), h('p', { class: 'soft' }, texts.ranking), place];
  },
};

function label(id, field, hint = '') {
  return h('label', { for: id }, field.label, hint && `: ${hint}`);
}

/** Numbers that a field accepts, in signs that need no translation; empty without bounds. */
function range({ least, most }) {
  const [low, high] = [text(least), text(most)];
  if (low && high) return `${low} – ${high}`;
  return (low && `≥ ${low}`) || (high && `≤ ${high}`) || '';
}

function text(value) {
  return value === null || value === undefined ? null : String(value);
}

function choices(field, options, value, set, off, kind = '') {
  return [h('fieldset', { class: kind, disabled: off }, h('legend', {}, field.label), options.map(([one, shown]) =>
    h('label', { class: 'check' }, h('input', { type: 'radio', name: field.name, value: String(one), checked: value === one, onchange: () => set(one) }), h('span', {}, shown))))];
}
