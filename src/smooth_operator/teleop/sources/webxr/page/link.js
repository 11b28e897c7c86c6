// The WebSocket: pairing, pings, the clocks' offset, and coming back after a loss. See link.py.

const PROTOCOL = 1;
const PING_EVERY = 200; // ms; a stop from elsewhere is shown so much later
const SILENCE = 4000; // ms without an answer: the link is dead
const ROUNDS = 50; // pings that the offset is chosen from
const BACKOFF = [250, 500, 1000, 2000, 4000]; // ms
const FINAL = new Set([4400, 4401, 4409, 4429]); // closed on purpose: coming back would not help

/** Events: "change" whenever something about it is new. */
export class Link extends EventTarget {
  constructor() {
    super();
    /** "idle", "connecting", "linked", "lost" or "refused". */
    this.state = 'idle';
    /** Why it was refused: {code, reason}. */
    this.refusal = null;
    this.everOpened = false;
    this.roundTrip = null; // s, fastest of the last rounds
    this.offset = null; // s, clock over there minus clock here
    this.lastTrip = null; // s
    this.arrived = null; // Hz
    this.mode = ''; // of the loop over there
    this.stopping = false; // a stop was pressed here and is not confirmed yet
    this.tracking = false;
    this.skipped = 0;
    this.sent = [];
    this.rounds = [];
    this.tries = 0;
  }

  /** Connect with a pairing code, and stay connected. */
  pair(code) {
    this.code = code;
    this.tries = 0;
    this.refusal = null;
    this.open();
  }

  open() {
    this.close();
    this.become('connecting');
    const socket = new WebSocket(`wss://${location.host}/link`);
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    this.rounds = [];
    socket.onopen = () => {
      this.everOpened = true;
      this.heard = performance.now();
      socket.send(JSON.stringify({ type: 'hello', protocol: PROTOCOL, code: this.code }));
    };
    socket.onmessage = (event) => this.hear(JSON.parse(event.data));
    socket.onclose = (event) => {
      if (this.socket === socket) this.end(event);
    };
    this.guard = setTimeout(() => this.state === 'connecting' && socket.close(), SILENCE);
  }

  /** Leave without a word to the listeners. */
  close() {
    clearTimeout(this.guard);
    clearTimeout(this.again);
    clearInterval(this.pinging);
    const socket = this.socket;
    this.socket = null;
    if (socket) socket.close();
  }

  hear(said) {
    this.heard = performance.now();
    if (said.type === 'welcome') {
      this.tries = 0;
      this.session = said.session;
      this.become('linked');
      this.pinging = setInterval(() => this.ping(), PING_EVERY);
      this.ping();
    } else if (said.type === 'pong') {
      const now = performance.now() / 1000;
      const trip = now - said.at;
      this.rounds.push({ trip, offset: said.host - (said.at + now) / 2 });
      if (this.rounds.length > ROUNDS) this.rounds.shift();
      const best = this.rounds.reduce((a, b) => (a.trip < b.trip ? a : b));
      this.roundTrip = best.trip;
      this.offset = best.offset;
      this.lastTrip = trip;
      this.arrived = said.rate;
      this.mode = said.mode;
      if (this.mode === 'stopped') this.stopping = false;
      this.dispatchEvent(new Event('change'));
    }
  }

  /** Emergency stop: sent now, and with each ping until it is confirmed, also after a loss. */
  stop() {
    this.stopping = true;
    if (this.state === 'linked') this.socket.send(JSON.stringify({ type: 'stop' }));
    this.dispatchEvent(new Event('change'));
  }

  ping() {
    if (performance.now() - this.heard > SILENCE) {
      this.end({ code: 0, reason: '' });
      return;
    }
    if (this.stopping) this.socket.send(JSON.stringify({ type: 'stop' }));
    this.socket.send(JSON.stringify({
      type: 'ping',
      at: performance.now() / 1000,
      round_trip: this.lastTrip,
      offset: this.offset,
      tracking: this.tracking,
    }));
  }

  end({ code, reason }) {
    this.close();
    this.roundTrip = this.lastTrip = this.offset = this.arrived = null;
    this.mode = '';
    if (FINAL.has(code)) {
      this.refusal = { code, reason };
      this.become('refused');
      return;
    }
    const wait = BACKOFF[Math.min(this.tries++, BACKOFF.length - 1)];
    this.again = setTimeout(() => this.open(), wait);
    this.become('lost');
  }

  /** Send a moment, unless the one before is still on its way: the newest one wins. */
  send(message) {
    if (this.state !== 'linked') return;
    if (this.socket.bufferedAmount > message.byteLength) {
      this.skipped++;
      return;
    }
    this.socket.send(message);
    const now = performance.now();
    this.sent.push(now);
    while (now - this.sent[0] > 1000) this.sent.shift();
  }

  /** Moments sent in the last second. */
  get rate() {
    const since = performance.now() - 1000;
    return this.sent.reduce((count, at) => count + (at > since), 0);
  }

  become(state) {
    this.state = state;
    this.dispatchEvent(new Event('change'));
  }
}
