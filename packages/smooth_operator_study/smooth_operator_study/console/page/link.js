// WebSocket of a page. It reconnects after every loss, and stores commands until they are acknowledged.
//
// A command stays in localStorage until the server answers, so that a closed page or a killed server
// loses nothing. It is sent again with the same token, and the store accepts each token only once.

const SILENCE = 5000; // ms without a message; the server sends one every second
const AGAIN = 2500; // ms until a command that could not be written is sent again
const STALE = 120000; // ms after which a stored command that starts something is dropped
const LASTING = new Set(['score', 'answer', 'void', 'note', 'form', 'amend']); // valid however late they arrive
const BACKOFF = [150, 300, 600, 1000, 2000]; // ms

/** Time of day [ms] from the start of the page; it does not jump when the machine's clock is set. */
export function moment() {
  return performance.timeOrigin + performance.now();
}

/** A unique text. crypto.randomUUID would need HTTPS. */
export function token() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return [...bytes].map((byte) => byte.toString(16).padStart(2, '0')).join('');
}

/** Stores a value beyond the page; without storage the value is lost with the page. */
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

/** [name, value] of stored values whose names begin with a prefix. */
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
    this.flying = null; // token of the command that was sent last and not answered
    this.trouble = '';
    this.offset = 0; // ms, clock of the server minus clock of the page
    this.best = -Infinity;
    this.tries = 0;
    this.open();
    setInterval(() => this.guard(), 1000);
    addEventListener('online', () => this.guard());
    document.addEventListener('visibilitychange', () => document.hidden || this.guard());
  }

  /** The server's clock [ms]. */
  now() {
    return moment() + this.offset;
  }

  /** Sends a command. since: time of the command by the page's clock; by default now. */
  command(what, operator, fields = {}, { after = null, since = moment() } = {}) {
    const entry = { token: token(), do: what, operator, fields, after, since };
    this.outbox.push(entry);
    this.store();
    this.flush();
    this.changed();
    return entry.token;
  }

  /** True while a command other than a note waits for its answer. */
  get pending() {
    return this.outbox.some((entry) => entry.do !== 'note');
  }

  /** Drops the commands that can't be written. */
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

  /** Closes a silent link, which the browser may still take for open. */
  guard() {
    if (!this.socket) return;
    const since = this.connected ? this.heard : this.opened;
    if (performance.now() - since > SILENCE) this.lose();
  }

  hear(message) {
    this.heard = performance.now();
    // The fastest message gives the best estimate of the difference of the clocks.
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

  /** Sends the next waiting command, one at a time. */
  flush() {
    if (!this.connected || this.flying || !this.outbox.length || this.study === undefined) return;
    const { since, ...command } = this.outbox[0];
    this.flying = command.token;
    const waited = Math.min(86400, Math.max(0, (moment() - since) / 1000));
    this.socket.send(JSON.stringify({ type: 'command', ...command, waited_s: waited }));
  }

  /** Stores each command under its own name, so that tabs of one browser do not overwrite others. */
  store() {
    if (!this.name) return;
    for (const entry of this.outbox) keep(`${this.name}/${entry.token}`, entry);
  }

  forget(sent) {
    if (this.name) keep(`${this.name}/${sent}`, null);
  }

  /** Restores commands of an earlier page that were not acknowledged. */
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
