// The emergency stop in the immersive view: a red disc straight ahead, above the eyes.
//
// It turns with the head but keeps its height when the head bends down, so a hand finds it without a
// look. Working hands do not touch it, since they are below the eyes.

const UP = 0.12; // m above the eyes
const AHEAD = 0.4; // m
export const RADIUS = 0.06; // m
const HOLD = 0.15; // s for which a fingertip must stay in it
const INDEX_TIP = 9; // WebXR's number of the joint
const VALUES = 8;

export class StopButton {
  /** @param {() => void} press */
  constructor(press) {
    this.press = press;
    this.since = null; // time at which a fingertip came in
    this.pressed = false; // true while a fingertip stays in it after a press
    this.centre = [0, 0, 0];
    /** Its pose for drawing: a column-major matrix, facing the head. */
    this.matrix = new Float32Array(16);
  }

  /**
   * Move it with the head, and press it if a fingertip is in it.
   * @param {XRRigidTransform} head
   * @param {Float32Array[]} hands the visible ones
   * @param {number} now seconds
   */
  update(head, hands, now) {
    const m = head.matrix;
    const length = Math.hypot(m[8], m[10]);
    if (length > 0.05) { // otherwise the head looks straight up or down
      this.back = [m[8] / length, m[10] / length];
    }
    const [x, z] = this.back ?? [0, 1];
    this.centre = [m[12] - AHEAD * x, m[13] + UP, m[14] - AHEAD * z];
    this.matrix.set([z, 0, -x, 0, 0, 1, 0, 0, x, 0, z, 0, ...this.centre, 1]);
    const inside = hands.some((hand) => {
      const tip = hand.subarray(INDEX_TIP * VALUES, INDEX_TIP * VALUES + 3);
      return Math.hypot(...this.centre.map((value, axis) => value - tip[axis])) < RADIUS;
    });
    if (!inside) {
      this.since = null;
      this.pressed = false;
      return;
    }
    this.since ??= now;
    if (!this.pressed && now - this.since >= HOLD) {
      this.pressed = true;
      this.press();
    }
  }
}
