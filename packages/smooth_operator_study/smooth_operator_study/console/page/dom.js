// Elements without a library. Text is never parsed as HTML.

/** Finds an element of the page by its id. */
export const part = (id) => document.getElementById(id);

/** Makes an element: h('button', { class: 'main', onclick }, 'Start', h('kbd', {}, 'S')). */
export function h(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === false || value === null || value === undefined) continue;
    if (key.startsWith('on')) element.addEventListener(key.slice(2), value);
    else if (key in element && typeof value !== 'string') element[key] = value;
    else element.setAttribute(key, value === true ? '' : value);
  }
  element.append(...children.flat().filter(there));
  return element;
}

/** True for a child; false for the value of `condition && element` without the condition. */
function there(child) {
  return child !== null && child !== undefined && child !== false && child !== '';
}

/** Replaces the children of an element; the focus stays on the same key. */
export function fill(parent, ...children) {
  const key = parent.contains(document.activeElement) ? document.activeElement.dataset.key : null;
  parent.replaceChildren(...children.flat().filter(there));
  if (key) parent.querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus({ preventScroll: true });
}

/** 83.4 -> "1:23"; with tenths "1:23.4". */
export function clock(seconds, tenths = false) {
  const sign = seconds < 0 ? '−' : '';
  const value = Math.abs(seconds);
  const whole = tenths ? Math.floor(value * 10 + 1e-6) / 10 : Math.floor(value + 1e-6);
  const minutes = Math.floor(whole / 60);
  const rest = tenths ? (whole % 60).toFixed(1).padStart(4, '0') : String(whole % 60).padStart(2, '0');
  return `${sign}${minutes}:${rest}`;
}

/** Makes a button that shows its key. */
export function button(text, { key, id, kind = '', ...rest }) {
  return h('button', { type: 'button', class: kind, 'data-key': id, 'data-press': key?.toLowerCase(), ...rest },
    h('span', {}, text), key && h('kbd', {}, key));
}
