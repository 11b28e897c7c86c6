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
  typeIn({ ...one, key: `${now.operator}/${one.form}/${one.at}` }, {
    name: `${study.name}/${now.operator}/${one.form}`, about: `Operator ${now.operator}, ${said(one)}.`, answers: one.answers,
    send: (answers, more) => actions.typeIn(now.operator, { form: one.form, answers, ...more }),
  });
}

/** Opens the dialog in which somebody types in what stands on paper, and says who. name: of the draft. */
export function typeIn(asked, { name, about, answers = null, send }) {
  const dialog = part('paper');
  const draft = `smooth-operator:paper:${name}`;
  const own = (id, label) => h('input', { id, maxLength: 400, autocomplete: 'off', required: true, 'aria-label': label, placeholder: label });
  const who = own('paper-who', 'Typed in by (initials)');
  const reason = answers && own('paper-reason', 'Why the answers are replaced');
  form(part('paper-form'), { ...asked, texts: TEXTS }, {
    name: draft, sending: false, answers: answers ?? {},
    more: h('section', { class: 'card field' }, h('p', { class: 'soft' }, about), who, reason),
    send: (given) => {
      dialog.close();
      keep(draft, null);
      send(given, { who: who.value.trim(), ...(reason ? { reason: reason.value.trim() } : {}) });
    },
  });
  dialog.showModal();
}

part('paper-close').addEventListener('click', () => part('paper').close());
