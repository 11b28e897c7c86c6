// Hands of an XR frame as the message that read_packet of link.py reads.

const FINGERS = ['index', 'middle', 'ring', 'pinky'];
const BONES = ['metacarpal', 'phalanx-proximal', 'phalanx-intermediate', 'phalanx-distal', 'tip'];

/** The 25 joints in WebXR's order. */
export const JOINTS = [
  'wrist',
  ...['metacarpal', 'phalanx-proximal', 'phalanx-distal', 'tip'].map((bone) => `thumb-${bone}`),
  ...FINGERS.flatMap((finger) => BONES.map((bone) => `${finger}-finger-${bone}`)),
];

const HEADER = 24;
const VALUES = 8; // x, y, z, quaternion x, y, z, w, radius
const HAND = JOINTS.length * VALUES;
const MAGIC = 0x31485258; // "XRH1", little-endian

/** Reuses its buffers: a message is valid until the next call of read. */
export class Hands {
  /** @param {import('./controllers.js').Controllers} controllers */
  constructor(controllers) {
    this.controllers = controllers;
    this.buffer = new ArrayBuffer(HEADER + 2 * HAND * 4);
    this.header = new DataView(this.buffer);
    this.values = new Float32Array(this.buffer, HEADER);
    this.number = 0;
    /** Joints of each hand in this frame, as [x, y, z, ..., radius] x 25, or null. */
    this.left = null;
    this.right = null;
    /** True if the hand is that of a controller. */
    this.held = { left: false, right: false };
  }

  /**
   * Read the hands of a frame.
   * @param {XRFrame} frame
   * @param {XRReferenceSpace} space
   * @param {number} stamp seconds
   * @param {boolean} floor true if the space has its origin on the floor
   * @returns {Uint8Array} the message
   */
  read(frame, space, stamp, floor) {
    const sources = { left: null, right: null };
    const held = { left: null, right: null }; // controllers
    for (const source of frame.session.inputSources) {
      const { handedness: side, hand, gamepad, gripSpace } = source;
      if (!(side in sources)) continue;
      if (hand) sources[side] = hand;
      else if (gamepad && gripSpace) held[side] = source;
    }
    let mask = 0;
    let at = 0;
    for (const [side, bit] of [['left', 1], ['right', 2]]) {
      this[side] = null;
      this.held[side] = false;
      if (!sources[side] && !held[side]) continue;
      const values = this.values.subarray(at, at + HAND);
      if (sources[side] && fill(values, frame, sources[side], space)) {
        this[side] = values; // a tracked hand comes before a controller
      } else if (held[side] && this.controllers.fill(values, frame, held[side], space, stamp)) {
        this[side] = values;
        this.held[side] = true;
        mask |= 4 * bit;
      } else {
        values.fill(NaN);
      }
      mask |= bit;
      at += HAND;
    }
    this.header.setUint32(0, MAGIC, true);
    this.header.setUint32(4, this.number++, true);
    this.header.setFloat64(8, stamp, true);
    this.header.setUint32(16, mask, true);
    this.header.setUint32(20, floor ? 1 : 0, true);
    return new Uint8Array(this.buffer, 0, HEADER + at * 4);
  }
}

/** Write the joints of a hand; true if any of them is tracked. */
function fill(values, frame, hand, space) {
  let any = false;
  JOINTS.forEach((name, joint) => {
    const at = joint * VALUES;
    const jointSpace = hand.get(name);
    const pose = jointSpace ? frame.getJointPose(jointSpace, space) : null;
    if (!pose) {
      values.fill(NaN, at, at + VALUES);
      return;
    }
    any = true;
    const { position: p, orientation: q } = pose.transform;
    values.set([p.x, p.y, p.z, q.x, q.y, q.z, q.w, pose.radius ?? NaN], at);
  });
  return any;
}
