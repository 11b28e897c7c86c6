// The immersive session: start, frames, end.

import { Controllers } from './controllers.js';
import { Hands } from './hands.js';
import { Panels } from './panels.js';
import { Robot } from './robot.js';
import { Scene } from './scene.js';
import { StopButton } from './stop_button.js';

const MODES = ['immersive-ar', 'immersive-vr'];

/** An error that a person can mend. */
export class Trouble extends Error {}

/** The kinds of session of this browser, that with the room around first. */
export async function supportedModes() {
  if (!window.isSecureContext) {
    throw new Trouble('The browser allows WebXR on secure pages only. Open this page with https://.');
  }
  if (!navigator.xr) {
    throw new Trouble("This browser has no WebXR. Open the page in the headset's own browser: Meta Quest Browser, Safari on Vision Pro, PICO Browser. On a Vision Pro, switch WebXR on under Settings › Apps › Safari › Advanced › Feature Flags.");
  }
  const there = await Promise.all(
    MODES.map((mode) => navigator.xr.isSessionSupported(mode).catch(() => false)),
  );
  const modes = MODES.filter((_, place) => there[place]);
  if (!modes.length) {
    throw new Trouble('This browser has WebXR, but no headset. Open the page on the headset itself.');
  }
  return modes;
}

/** Events: "end". One session at a time. */
export class Tracking extends EventTarget {
  /** @param {import('./link.js').Link} link */
  constructor(link) {
    super();
    this.link = link;
    this.robot = new Robot(link);
    this.controllers = new Controllers((name) => link.press(name));
    this.hands = new Hands(this.controllers);
    this.panels = new Panels(link);
    this.session = null;
    this.since = 0;
    this.lastSeen = 0;
    link.addEventListener('pulse', (event) => this.pulse(event.detail));
  }

  /** The controllers, also those beside tracked hands. */
  get sources() {
    const { inputSources = [], trackedSources = [] } = this.session ?? {};
    return [...inputSources, ...trackedSources].filter(
      ({ gamepad, handedness, hand }) => gamepad && !hand && handedness !== 'none',
    );
  }

  /** Let the controllers of a side vibrate. */
  pulse({ side, strength, seconds }) {
    for (const { handedness, gamepad } of this.sources) {
      if (handedness !== side) continue;
      for (const actuator of gamepad.hapticActuators ?? []) {
        Promise.resolve(actuator.pulse(strength, 1000 * seconds)).catch(() => {});
      }
    }
  }

  /** Start; browsers allow it in a click only. */
  async start(mode) {
    // Controllers beside tracked hands cost power (immersive-web/webxr, issue 1430).
    const useful = this.link.pulses || Object.keys(this.link.buttons).length;
    const beside = useful ? ['tracked-sources'] : [];
    let session;
    try {
      session = await navigator.xr.requestSession(mode, {
        optionalFeatures: ['hand-tracking', 'local-floor', ...beside],
      });
    } catch (error) {
      throw new Trouble(`The headset does not start (${error.message || error.name}). Allow immersive mode and hand tracking when the browser asks, and press Start again.`);
    }
    try {
      const gl = document.createElement('canvas').getContext('webgl2', { xrCompatible: true, alpha: true });
      if (!gl) throw new Trouble('This browser has no WebGL 2, which an immersive session needs.');
      await gl.makeXRCompatible();
      this.scene = new Scene(gl, this.robot, this.panels);
      this.button = new StopButton(() => this.link.stop());
      this.layer = new XRWebGLLayer(session, gl);
      session.updateRenderState({ baseLayer: this.layer });
      this.floor = true;
      this.space = await session.requestReferenceSpace('local-floor').catch(() => {
        this.floor = false; // the headset does not know the floor
        return session.requestReferenceSpace('local');
      });
    } catch (error) {
      session.end().catch(() => {});
      throw error;
    }
    this.session = session;
    this.dark = mode !== 'immersive-ar';
    this.since = performance.now();
    this.link.tracking = true;
    session.addEventListener('end', () => {
      this.session = null;
      this.hands.left = this.hands.right = null;
      this.link.tracking = false;
      this.dispatchEvent(new Event('end'));
    });
    const step = (_, frame) => {
      session.requestAnimationFrame(step);
      this.step(frame);
    };
    session.requestAnimationFrame(step);
  }

  stop() {
    return this.session?.end();
  }

  step(frame) {
    // Hands first: drawing must not delay them.
    const now = performance.now() / 1000;
    this.link.send(this.hands.read(frame, this.space, now, this.floor));
    for (const source of this.sources) this.controllers.update(source, now);
    this.robot.ask();
    const seen = [this.hands.left, this.hands.right].filter(Boolean);
    if (seen.length) this.lastSeen = performance.now();
    const viewer = frame.getViewerPose(this.space);
    if (viewer) this.button.update(viewer.transform, seen, performance.now() / 1000);
    this.scene.draw(this.layer, viewer, seen, this.button.matrix, {
      dark: this.dark,
      sides: this.hands,
      good: this.link.state === 'linked',
      board: () => this.board(),
    });
  }

  /** Kind and lines of the board. */
  board() {
    const { link } = this;
    if (link.state !== 'linked') {
      const first = link.stopping ? 'STOP NOT SENT: no link' : 'No link: the robot holds';
      return { kind: 'bad', lines: [first, link.refusal?.reason ?? 'connecting again'] };
    }
    const [kind, ...lines] = loopState(link) ?? [];
    if (kind) return { kind, lines };
    if (performance.now() - Math.max(this.lastSeen, this.since) > 2000) {
      return { kind: 'warn', lines: ['No hands', 'hold your hands or the controllers in view'] };
    }
    const trip = link.lastTrip === null ? '–' : (1000 * link.lastTrip).toFixed(0);
    const held = ['left', 'right'].filter((side) => this.hands.held[side]);
    const presets = held.map((side) => `${side} ${this.controllers.preset(side)}`);
    return { kind: 'good', lines: [presets.join(' · ') || 'Linked', `${link.rate} Hz · round trip ${trip} ms`] };
  }
}

/** [kind, headline, remedy] while the loop holds the robot on purpose, else null. */
export function loopState(link) {
  if (link.mode === 'stopped') return ['bad', 'STOPPED', 'release it at the computer'];
  if (link.stopping) return ['bad', 'Stopping …', 'not confirmed yet'];
  if (link.mode === 'paused') return ['warn', 'Paused', 'the robot holds'];
  if (link.mode === 'compiling') return ['warn', 'Compiling the method', 'the robot holds'];
  return null;
}
