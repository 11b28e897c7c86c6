// The WebSocket of a page: comes back after every loss, and keeps what was not acknowledged.
//
// A command lies in localStorage until the server answers: a page that is closed, or a server that is
// killed, loses nothing. It is sent again with the same token, and the store takes a token once.

const SILENCE = 5000; // ms without a word: the server says something every second
const AGAIN = 2500; // ms until a command is tried again that could not be written
const STALE = 120000; // ms after which a page that is opened again starts nothing of before
const LASTING = new Set(['score', 'answer', 'void', 'note', 'form', 'amend']); // what has happened, however late it arrives
const BACKOFF = [150, 300, 600, 1000, 2000]; // ms

/** This machine's time of day, ms, as of the page's beginning: it goes on if that clock is set. */
export function moment() {
  return performance.timeOrigin + performance.now();
}

/** A text that nothing else is called by. crypto.randomUUID would need HTTPS. */
export function token() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return [...bytes].map((byte) => byte.toString(16).padStart(2, '0')).join('');
}

/** A value that outlives the page; where there is no storage, it lives as long as the page. */
export function keep(name, value) {
  try {
    if (value === null) localStorage.removeItem(name);
    else localStorage.setItem(name, JSON.stringify(value));
  } catch { /* private mode, or full */ }
}

export function stored(name) {
  try {
    return JSON.parse(localStorage.getItem(name));
  } catch {
    return null;
  }
}

/** Values whose names begin so, by name. */
function storedBy(prefix) {
  try {
    return Object.keys(localStorage).filter((name) => name.startsWith(prefix)).map((name) => [name, stored(name)]);
  } catch {
    return [];
  }
}

/** Events: "state", "change" (of the link), "done" and "refused" (detail: {command, answer}). */
export class Link extends EventTarget {
  /** path: path of the WebSocket. */
  constructor(path) {
    super();
    this.path = path;
    this.connected = false;
    this.everConnected = false;
    this.state = null;
    this.outbox = [];
    this.flying = null; // token of the command that is on its way
    this.trouble = '';
    this.offset = 0; // ms, clock over there minus clock here
    this.best = -Infinity;
    this.tries = 0;
    this.open();
    setInterval(() => this.guard(), 1000);
    addEventListener('online', () => this.guard());
    document.addEventListener('visibilitychange', () => document.hidden || this.guard());
  }

  /** The server's clock now, ms. */
  now() {
    return moment() + this.offset;
  }

  /** Ask for something. since: when it was meant, by this clock; now if left out. */
  command(what, operator, fields = {}, { after = null, since = moment() } = {}) {
    const entry = { token: token(), do: what, operator, fields, after, since };
    this.outbox.push(entry);
    this.store();
    this.flush();
    this.changed();
    return entry.token;
  }

  /** Says something that must not wait for what is under way, and is lost if nobody hears it. */
  urge(what, operator) {
    if (!this.connected) return;
    const command = { token: token(), do: what, operator, fields: {}, after: null, waited_s: 0 };
    this.socket.send(JSON.stringify({ type: 'command', ...command }));
  }

  /** Something is asked for and not yet answered. */
  get pending() {
    return this.outbox.some((entry) => entry.do !== 'note');
  }

  /** Gives up what can't be written. */
  drop() {
    for (const entry of this.outbox) this.forget(entry.token);
    this.outbox = [];
    this.flying = null;
    this.trouble = '';
    this.changed();
  }

  open() {
    const socket = new WebSocket(`${location.origin.replace('http', 'ws')}${this.path}`);
    this.socket = socket;
    this.opened = performance.now();
    socket.onopen = () => {
      if (this.socket !== socket) return;
      this.heard = performance.now();
      this.connected = this.everConnected = true;
      this.flying = null;
      this.best = -Infinity;
      this.changed();
    };
    socket.onmessage = (event) => this.socket === socket && this.hear(JSON.parse(event.data));
    socket.onclose = () => this.socket === socket && this.lose();
  }

  lose() {
    const old = this.socket;
    this.socket = null;
    this.connected = false;
    this.flying = null;
    if (old) old.close();
    clearTimeout(this.returning);
    this.returning = setTimeout(() => this.open(), BACKOFF[Math.min(this.tries++, BACKOFF.length - 1)]);
    this.changed();
  }

  /** A link that is silent is dead, whatever the browser thinks of it. */
  guard() {
    if (!this.socket) return;
    const since = this.connected ? this.heard : this.opened;
    if (performance.now() - since > SILENCE) this.lose();
  }

  hear(message) {
    this.heard = performance.now();
    // The message that was fastest tells best how the clocks differ.
    this.best = Math.max(this.best, message.sent - moment());
    this.offset = this.best;
    if (message.type === 'state') {
      this.tries = 0;
      const study = message.study?.name ?? message.study ?? '';
      if (this.study !== study) {
        this.study = study;
        this.name = `smooth-operator:${study}:${this.path}`;
        this.recall();
        this.store();
      }
      this.state = message;
      this.dispatchEvent(new Event('state'));
      this.flush();
    } else if (message.type === 'done' || message.type === 'refused') {
      this.answered(message);
    }
    this.changed();
  }

  answered(answer) {
    if (this.flying === answer.token) this.flying = null;
    const command = this.outbox.find((entry) => entry.token === answer.token);
    if (!command) return;
    if (answer.again) {
      this.trouble = answer.error;
      setTimeout(() => this.flush(), AGAIN);
      return;
    }
    this.trouble = '';
    this.outbox = this.outbox.filter((entry) => entry.token !== answer.token);
    this.forget(answer.token);
    this.dispatchEvent(new CustomEvent(answer.type, { detail: { command, answer } }));
    this.flush();
  }

  /** Sends what waits, one after the other. */
  flush() {
    if (!this.connected || this.flying || !this.outbox.length || this.study === undefined) return;
    const { since, ...command } = this.outbox[0];
    this.flying = command.token;
    const waited = Math.min(86400, Math.max(0, (moment() - since) / 1000));
    this.socket.send(JSON.stringify({ type: 'command', ...command, waited_s: waited }));
  }

  /** Each command has a place of its own: tabs of one browser leave each other's alone. */
  store() {
    if (!this.name) return;
    for (const entry of this.outbox) keep(`${this.name}/${entry.token}`, entry);
  }

  forget(sent) {
    if (this.name) keep(`${this.name}/${sent}`, null);
  }

  /** What a page of before did not see acknowledged. */
  recall() {
    const tokens = new Set(this.outbox.map((entry) => entry.token));
    const entries = [];
    for (const [name, entry] of storedBy(`${this.name}/`)) {
      if (entry && tokens.has(entry.token)) continue;
      if (entry && (LASTING.has(entry.do) || Math.abs(moment() - entry.since) < STALE)) entries.push(entry);
      else keep(name, null);
    }
    entries.sort((a, b) => a.since - b.since);
    this.outbox.unshift(...entries);
  }

  changed() {
    this.dispatchEvent(new Event('change'));
  }
}
