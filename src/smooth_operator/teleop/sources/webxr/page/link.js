// WebSocket of the page: pairing, pings, offset of the clocks, and a new try after a loss; see link.py.

const PROTOCOL = 1;
const PING_EVERY = 200; // ms; also the delay of a stop that was pressed elsewhere
const UNANSWERED = 20; // pings without an answer, after which the link is lost
const PATIENCE = 4000; // ms for a connection
const ROUNDS = 50; // last pings, of which the fastest gives the offset
const BACKOFF = [250, 500, 1000, 2000, 4000]; // ms
const FINAL = new Set([4400, 4401, 4409, 4429]); // codes after which a new try is useless

/** Events: "change" after each change of its state; "pulse" for the controllers, "view" and "picture" for the
 * scene. */
export class Link extends EventTarget {
  constructor() {
    super();
    /** "idle", "connecting", "linked", "lost" or "refused". */
    this.state = 'idle';
    /** Reason of a refusal: {code, reason}. */
    this.refusal = null;
    this.everOpened = false;
    this.offset = null; // s, clock of the host minus clock of the page
    this.lastTrip = null; // s
    this.arrived = null; // Hz
    this.mode = ''; // of the loop
    this.stopping = false; // true from a stop on this page until the loop confirms it
    this.tracking = false;
    this.pulses = false; // true if the host will send pulses
    this.buttons = {}; // name -> action of those of controllers
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
      socket.send(JSON.stringify({ type: 'hello', protocol: PROTOCOL, code: this.code }));
    };
    socket.onmessage = (event) => {
      if (typeof event.data === 'string') this.hear(JSON.parse(event.data));
      else this.dispatchEvent(new CustomEvent('picture', { detail: event.data }));
    };
    socket.onclose = (event) => {
      if (this.socket === socket) this.end(event);
    };
    this.guard = setTimeout(() => this.state === 'connecting' && socket.close(), PATIENCE);
  }

  /** Close without an event. */
  close() {
    clearTimeout(this.guard);
    clearTimeout(this.again);
    clearInterval(this.pinging);
    const socket = this.socket;
    this.socket = null;
    if (socket) socket.close();
  }

  hear(message) {
    this.unanswered = 0;
    if (message.type === 'welcome') {
      this.tries = 0;
      this.pulses = message.pulses;
      this.buttons = message.buttons;
      this.become('linked');
      this.pinging = setInterval(() => this.ping(), PING_EVERY);
      this.ping();
    } else if (message.type === 'pong') {
      const now = performance.now() / 1000;
      const trip = now - message.at;
      this.rounds.push({ trip, offset: message.host - (message.at + now) / 2 });
      if (this.rounds.length > ROUNDS) this.rounds.shift();
      this.offset = this.rounds.reduce((a, b) => (a.trip < b.trip ? a : b)).offset;
      this.lastTrip = trip;
      this.arrived = message.rate;
      this.mode = message.mode;
      if (this.mode === 'stopped') this.stopping = false;
      this.dispatchEvent(new Event('change'));
    } else if (['pulse', 'view'].includes(message.type)) {
      this.dispatchEvent(new CustomEvent(message.type, { detail: message }));
    }
  }

  /** Emergency stop: sent now and with each ping until the loop confirms it, also after a loss. */
  stop() {
    this.stopping = true;
    if (this.state === 'linked') this.socket.send(JSON.stringify({ type: 'stop' }));
    this.dispatchEvent(new Event('change'));
  }

  /** A button of a controller was pressed. */
  press(name) {
    if (this.buttons[name] === 'stop') this.stop();
    else if (name in this.buttons && this.state === 'linked') this.socket.send(JSON.stringify({ type: 'button', name }));
  }

  ping() {
    // Pings are counted, since their time proves nothing: a headset that was busy for seconds runs
    // this timer before it reads the answers that have come meanwhile.
    if (this.unanswered++ >= UNANSWERED) {
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
    this.lastTrip = this.offset = this.arrived = null;
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

  /** Send a request, whose answer becomes an event. */
  ask(request) {
    if (this.state === 'linked') this.socket.send(JSON.stringify(request));
  }

  /** Send a moment, unless the last one is still on its way. */
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
