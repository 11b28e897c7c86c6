// What a person sees on the pages of a study. One object; its functions give null for "not yet".
({
  shown() {
    const one = (where) => document.querySelector(where);
    const text = (where) => one(where)?.textContent ?? '';
    const free = (where) => [...document.querySelectorAll(where)].filter((each) => !each.disabled);
    const step = one('#step');
    if (!step.dataset.what && !text('#step h2')) return null;
    return {
      what: step.dataset.what ?? '',
      where: [...(one('#step .where')?.childNodes ?? [])].map((node) => node.textContent).join(' '),
      heading: text('#step h2'),
      link: text('#link'),
      who: text('#who'),
      dialog: one('#ask').open ? text('#ask-title') : '',
      refused: one('#refused').hidden ? '' : text('#refused span'),
      gone: one('#hand').hidden ? '' : text('#hand span'),
      stopped: Boolean(one('#step .clock.stopped')),
      lines: free('.rubric button').map((each) => [each.dataset.press, each.dataset.key]),
      keys: free('[data-press]').map((each) => each.dataset.press),
      buttons: free('[data-key]').map((each) => each.dataset.key),
      log: text('#log li .number'),
    };
  },
  // Nothing is under way, or a question is open; another step than the one seen, if one is given.
  settled(seen) {
    const quiet = document.querySelector('#link').textContent === 'connected';
    if (!quiet && !document.querySelector('#ask').open) return null; // the rest costs more
    const shown = this.shown();
    if (!shown) return null;
    return seen && JSON.stringify([shown.what, shown.where, shown.heading]) === seen ? null : shown;
  },
  // A form or NASA-TLX that can be filled in.
  asked() {
    const form = document.querySelector('form.asked, form.tlx');
    if (!form || document.querySelector('#link').textContent !== 'connected') return null;
    if ([...form.querySelectorAll('input, textarea')].some((each) => each.disabled)) return null;
    return { tlx: form.classList.contains('tlx'), title: form.querySelector('h2').textContent };
  },
  sliders(names) {
    return names.map((name) => {
      const slider = document.querySelector(`#scale-${name}`);
      slider.scrollIntoView({ block: 'center' });
      const box = slider.getBoundingClientRect();
      const value = Number(slider.value);
      return { left: box.left, y: box.top + box.height / 2, width: box.width, value };
    });
  },
  // Labels that are still to be ranked; empty where all are.
  labels() {
    return [...document.querySelectorAll('[data-key^="rank-"]')].map((b) => b.dataset.key.slice(5));
  },
  // Lines by which a trial may be amended.
  otherLines() {
    const lines = [...document.querySelectorAll('#ask-line option')].filter((o) => !o.selected);
    return lines.map((line) => line.value).filter((name) => !name.endsWith('after-reset'));
  },
})
