// Controls and texts of the page.

import { Link } from './link.js';
import { loopState, supportedModes, Tracking, Trouble } from './tracking.js';

const SHOW_EVERY = 250; // ms
const part = (id) => document.getElementById(id);
const link = new Link();
const tracking = new Tracking(link);
let modes = [];
let trouble = ''; // of the headset; linkTrouble has that of the link

const STATES = {
  idle: ['not paired', 'idle'],
  connecting: ['connecting', 'idle'],
  linked: ['linked', 'good'],
  lost: ['link lost', 'bad'],
  refused: ['refused', 'bad'],
};

const REFUSALS = {
  4401: 'That pairing code is not the one in the terminal.',
  4409: 'Another headset took over. Pair again to take it back.',
  4429: 'Too many wrong codes: wait a minute, then pair again.',
};

function linkTrouble() {
  if (link.state === 'refused') {
    return REFUSALS[link.refusal.code] ?? `The program refused this page: ${link.refusal.reason}. Reload the page.`;
  }
  if (link.state === 'lost' && !link.everOpened && link.tries > 1) {
    return 'The browser blocks the link. On a Vision Pro, first install and trust the certificate: see below.';
  }
  if (link.state === 'lost' && link.tries > 3) {
    return 'No link. Check that smooth-operator is running and that both are on the same network. The page tries again.';
  }
  return '';
}

function show() {
  const [level, headline, remedy] = (link.state === 'linked' && loopState(link)) || [];
  const [words, kind] = level ? [headline, level === 'bad' ? 'bad' : 'idle'] : STATES[link.state];
  document.body.dataset.mode = link.state === 'linked' ? link.mode : '';
  part('stop').disabled = link.state !== 'linked';
  part('state').textContent = words;
  part('state').dataset.kind = kind;
  part('pairing').hidden = !['idle', 'refused'].includes(link.state);
  const running = tracking.session !== null;
  part('start').disabled = !running && (!modes.length || link.state !== 'linked');
  part('start').textContent = running ? 'End tracking' : 'Start';
  part('hint').textContent = level
    ? `${headline}: ${remedy}.`
    : running
    ? 'The page sends your hands. The robot holds when you end tracking.'
    : link.state === 'linked' ? 'Press Start, then show your hands or hold the controllers.' : 'Pair first.';
  part('mode').hidden = running || modes.length < 2;
  part('rate').textContent = running ? link.rate : '–';
  part('arrived').textContent = link.arrived === null ? '–' : Math.round(link.arrived);
  part('trip').textContent = link.lastTrip === null ? '–' : (1000 * link.lastTrip).toFixed(1);
  part('skipped').textContent = link.skipped;
  for (const side of ['left', 'right']) {
    const seen = tracking.hands[side] !== null;
    const name = tracking.hands.held[side] ? tracking.controllers.preset(side) : 'seen';
    part(side).textContent = !running ? '–' : seen ? name : 'not seen';
    part(side).dataset.kind = !running ? 'idle' : seen ? 'good' : 'bad';
  }
  const text = [trouble, linkTrouble()].filter(Boolean).join(' ');
  if (part('trouble').textContent !== text) part('trouble').textContent = text;
  part('trouble').hidden = !text;
}

part('pairing').addEventListener('submit', (event) => {
  event.preventDefault();
  link.pair(part('code').value);
});

part('start').addEventListener('click', async () => {
  if (tracking.session) {
    await tracking.stop();
    return;
  }
  trouble = '';
  try {
    await tracking.start(modes.length > 1 ? part('mode').value : modes[0]);
  } catch (error) {
    trouble = error instanceof Trouble ? error.message : `The session did not start: ${error.message}`;
  }
  show();
});

part('place').addEventListener('change', () => { tracking.robot.place = part('place').value; });
part('stop').addEventListener('click', () => link.stop());
link.addEventListener('change', show);
tracking.addEventListener('end', show);
setInterval(show, SHOW_EVERY);
addEventListener('pagehide', () => link.close());

// A code in the address (https://...#123456): a browser does not send this part to the server.
const code = decodeURIComponent(location.hash.slice(1));
if (code) {
  history.replaceState(null, '', location.pathname);
  part('code').value = code;
  link.pair(code);
}

try {
  modes = await supportedModes();
} catch (error) {
  trouble = error.message;
}
show();
