// Forms of the operator who is on: which are filled in, and one opened to read it or to type it in.

import { fill, h, part } from './dom.js';
import { form } from './form.js';
import { keep } from './link.js';

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
    h('span', {}, h('b', {}, one.title), h('span', { class: 'soft' }, ` ${said(one)}`)),
    (one.can || one.answers) && h('button', { type: 'button', class: 'quiet', 'data-key': `form-${one.form}`, disabled: blocked,
      onclick: () => open(one, now, study, actions) }, one.answers ? 'Open' : 'Type in'))));
}

function said({ state, at, who }) {
  if (state in STATES) return STATES[state];
  const time = new Date(at).toLocaleTimeString([], { hour12: false });
  if (state === 'paper') return `on paper (${who}), to be typed in`;
  return who ? `typed in by ${who}, ${time}` : `filled in by the operator, ${time}`;
}

/** A form to read, or to type in what stands on paper; answers that are there are replaced with a reason only. */
function open(one, now, study, actions) {
  const dialog = part('paper');
  const name = `smooth-operator:paper:${study.name}/${now.operator}/${one.form}`;
  const own = (id, label, required) => h('input', { id, maxLength: 400, autocomplete: 'off', required, 'aria-label': label, placeholder: label });
  const who = own('paper-who', 'Typed in by (initials)', true);
  const reason = one.answers && own('paper-reason', 'Why the answers are replaced', true);
  form(part('paper-form'), { ...one, key: `${now.operator}/${one.form}/${one.at}`, texts: TEXTS }, {
    name, sending: false, answers: one.answers ?? {},
    more: h('section', { class: 'card field' }, h('p', { class: 'soft' }, `Operator ${now.operator}, ${said(one)}.`), who, reason),
    send: (answers) => {
      dialog.close();
      keep(name, null);
      actions.typeIn(now.operator, { form: one.form, answers, who: who.value.trim(), ...(reason ? { reason: reason.value.trim() } : {}) });
    },
  });
  dialog.showModal();
}

part('paper-close').addEventListener('click', () => part('paper').close());
