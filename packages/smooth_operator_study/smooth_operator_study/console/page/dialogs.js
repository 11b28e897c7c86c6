// Dialog of the experimenter's page for all questions.

import { fill, h, part } from './dom.js';

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
