// Hands in place of controllers: trigger and grip close fingers, the thumbstick changes the preset.

import { POSES } from './poses.js';

const NAMES = Object.keys(POSES.presets);
const FINGERS = ['thumb', 'index', 'middle', 'ring', 'pinky'];
const FIRST = [1, 5, 10, 15, 20, 25]; // first joint of each finger, in WebXR's order
const VALUES = 8;
const RADIUS = 0.008; // m
const CHANGE = 0.4; // s in which the fingers move to another preset
const [FLICK, BACK] = [0.7, 0.3]; // deflections of the thumbstick
// Buttons of the xr-standard mapping (WebXR Gamepads Module, section 3.3).
const [TRIGGER, GRIP, STICK] = [0, 1, 3];
const BUTTONS = {
  left: { 3: 'left-stick', 4: 'x', 5: 'y' },
  right: { 3: 'right-stick', 4: 'a', 5: 'b' },
};
// The grip space has -z towards the thumb along a rod in the fist, x out of the back of a right hand
// (into that of a left one), and y towards the arm (WebXR Device API, XRInputSource.gripSpace). A
// wrist joint has -z to the fingers and y out of the back (WebXR Hand Input). So the axes of the wrist
// are z, x, y of the grip for a right hand, and -z, -x, y for a left one.
const TURN = { right: [-0.5, -0.5, -0.5, 0.5], left: [-0.5, 0.5, 0.5, 0.5] };

export class Controllers {
  /** @param {(name: string) => void} press called with the name of each pressed button */
  constructor(press) {
    this.press = press;
    this.states = { left: new State(), right: new State() };
  }

  /**
   * Read buttons and thumbstick of a controller.
   * @param {XRInputSource} source
   * @param {number} now seconds
   */
  update({ handedness, gamepad }, now) {
    const state = this.states[handedness];
    for (const [number, name] of Object.entries(BUTTONS[handedness])) {
      const down = gamepad.buttons[number]?.pressed ?? false;
      if (down && !state.down[name]) this.press(name);
      state.down[name] = down;
    }
    const push = gamepad.axes[2] ?? 0;
    if (Math.abs(push) > FLICK && !state.flicked) state.change(Math.sign(push), now);
    state.flicked = Math.abs(push) > (state.flicked ? BACK : FLICK);
  }

  /**
   * Write the joints of the hand that a controller stands for; false if its pose is not measured.
   * @param {Float32Array} values
   * @param {XRFrame} frame
   * @param {XRInputSource} source
   * @param {XRReferenceSpace} space
   * @param {number} now seconds
   */
  fill(values, frame, { handedness, gamepad, gripSpace }, space, now) {
    const grip = frame.getPose(gripSpace, space);
    if (!grip || grip.emulatedPosition) return false;
    const closed = [TRIGGER, GRIP].map((number) => gamepad.buttons[number]?.value ?? 0);
    const joints = this.states[handedness].joints(closed, now);
    const { position: p, orientation: o } = grip.transform;
    const turn = times([o.x, o.y, o.z, o.w], TURN[handedness]);
    const side = handedness === 'left' ? -1 : 1; // the poses are those of a right hand
    const place = ([x, y, z]) => rotate(turn, [side * x, y, z]);
    const middle = place(POSES.grip);
    const wrist = [p.x, p.y, p.z].map((value, axis) => value - middle[axis]);
    joints.forEach((joint, number) => {
      const at = place(joint).map((value, axis) => value + wrist[axis]);
      values.set([...at, NaN, NaN, NaN, NaN, RADIUS], number * VALUES);
    });
    values.set(turn, 3);
    return true;
  }

  /** Name of the preset of a side. */
  preset(side) {
    return NAMES[this.states[side].preset];
  }
}

/** Preset and fingers of one controller. */
class State {
  constructor() {
    this.preset = 0;
    this.down = {};
    this.flicked = false;
    this.changed = -Infinity;
    this.last = POSES.presets[NAMES[0]].poses[0]; // joints in the frame of the wrist
  }

  change(by, now) {
    this.preset = (this.preset + by + NAMES.length) % NAMES.length;
    this.changed = now;
    this.before = this.last;
  }

  joints([trigger, grip], now) {
    const { trigger: fingers, poses } = POSES.presets[NAMES[this.preset]];
    const joints = [poses[0][0]];
    FINGERS.forEach((finger, number) => {
      const step = (fingers.includes(finger) ? trigger : grip) * (poses.length - 1);
      const below = Math.min(Math.floor(step), poses.length - 2);
      for (let joint = FIRST[number]; joint < FIRST[number + 1]; joint++) {
        joints.push(mix(poses[below][joint], poses[below + 1][joint], step - below));
      }
    });
    const share = (now - this.changed) / CHANGE;
    this.last = share < 1 ? joints.map((to, number) => mix(this.before[number], to, share)) : joints;
    return this.last;
  }
}

function mix(from, to, share) {
  return from.map((value, axis) => value + share * (to[axis] - value));
}

/** Product of two quaternions x, y, z, w. */
function times([x, y, z, w], [a, b, c, d]) {
  return [
    w * a + x * d + y * c - z * b,
    w * b - x * c + y * d + z * a,
    w * c + x * b - y * a + z * d,
    w * d - x * a - y * b - z * c,
  ];
}

/** A vector turned by a quaternion. */
function rotate(turn, vector) {
  const [x, y, z, w] = turn;
  return times(times(turn, [...vector, 0]), [-x, -y, -z, w]).slice(0, 3);
}
