// NASA-TLX on paper, typed in on the experimenter's page: the six ratings, or the fifteen pairs.

import { typeIn } from './forms.js';

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
