// The robot hands, their arms and tasks, as the host describes them; see "view" in link.py.

import { feed, fill, move, picture, pose, program, times, use, where } from './gl.js';

const LOOK_EVERY = 33; // ms
const GIVE_UP = 2000; // ms without an answer, after which the page asks again
const INSTANCE = 13; // values: position, quaternion w x y z, scales, colour
const BESIDE = 0.15; // m from the operator's hand to the robot's
const FRONT = [0, -0.3, -0.6]; // middle of the scene, in front of the operator [m]
const UPRIGHT = Float32Array.of(1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1); // from z up
const SEE_THROUGH = 0.55; // opacity of a robot over the operator's hand
const LABEL = [0.14, 0.028]; // m
const LABEL_DOWN = 0.045; // m from the palm

/** Linear colour and share of the tint, and words, for a robot that does not follow. */
const MODES = {
  waiting: [[0.4, 0.4, 0.4, 0.6], 'waiting for your hand'],
  holding: [[1, 0.4, 0, 0.6], 'hand lost: holding'],
  easing: [[1, 0.4, 0, 0.6], 'hand lost: moving to safe pose'],
  paused: [[0.1, 0.3, 1, 0.6], 'paused'],
  stopped: [[1, 0, 0, 0.9], 'STOPPED'],
  unlinked: [[1, 0.4, 0, 0.6], 'no link: holding'],
};
const CLEAR = [0, 0, 0, 0];

const VERTEX = `#version 300 es
in vec3 place, normal; uniform mat4 view, lens, frame; uniform vec3 at, size; uniform vec4 turn;
out vec3 seen, facing;
vec3 turned(vec3 v) { return v + 2.0 * cross(turn.yzw, cross(turn.yzw, v) + turn.x * v); }
void main() {
  vec4 there = view * frame * vec4(at + turned(size * place), 1.0);
  seen = there.xyz;
  facing = mat3(view) * mat3(frame) * turned(normal / max(size, vec3(1e-9)));
  gl_Position = lens * there;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 seen, facing; uniform vec4 ink, tint; uniform bool facets; out vec4 shown;
void main() {
  vec3 n = normalize(facets ? cross(dFdx(seen), dFdy(seen)) : facing);
  float light = 0.2 + 0.8 * abs(dot(n, normalize(vec3(0.3, 0.6, 1.0))));
  shown = vec4(pow(light * mix(ink.rgb, tint.rgb, tint.a), vec3(1.0 / 2.2)), ink.a);
}`;

export class Robot {
  /** @param {import('./link.js').Link} link */
  constructor(link) {
    this.link = link;
    this.number = 0;
    this.nodes = [];
    this.hands = {};
    this.asked = -Infinity;
    this.waiting = false;
    this.last = {}; // last pose of each wrist of the operator and of the robot's palm in it
    this.labels = {};
    /** "beside" or "over" the operator's hands, in "front" of the operator, or "hidden". */
    this.place = 'beside';
    link.addEventListener('view', (event) => this.hear(event.detail));
  }

  /** Ask for the state, at most thirty times a second, and once the last answer has come. */
  ask() {
    const { link } = this;
    if (link.state !== 'linked') this.number = 0; // the next host may count anew
    const now = performance.now();
    const due = now - this.asked > (this.waiting ? GIVE_UP : LOOK_EVERY);
    if (!due || link.state !== 'linked') return;
    this.asked = now;
    this.waiting = true;
    link.ask({ type: 'look', number: this.number });
  }

  hear(message) {
    this.waiting = false;
    this.number = message.number;
    if (message.nodes) {
      this.nodes = message.nodes;
      this.middle = message.middle;
    }
    if (!message.number) this.nodes = [];
    this.hands = message.hands ?? {};
    if (!this.nodes.length) return;
    const values = new Float32Array(decoded(message.values).buffer);
    let at = 0;
    for (const index of message.changed) {
      const node = this.nodes[index];
      node.values = values.subarray(at, at + node.count);
      at += node.count;
    }
  }

  /** Prepare to draw in another context. */
  open(gl) {
    this.gl = gl;
    this.program = program(gl, VERTEX, FRAGMENT);
    this.labels = {};
    for (const node of this.nodes) node.buffers = null;
  }

  /**
   * Place the frames for a picture.
   * @param {{left: Float32Array?, right: Float32Array?}} hands the operator's
   * @param {Float32Array} head its pose
   * @param {Float32Array} desk level frame in front of which the scene is drawn
   * @returns {boolean} false if there is no robot to draw
   */
  settle(hands, head, desk) {
    if (!this.nodes.length || this.place === 'hidden') return false;
    const front = times(times(desk, move(FRONT)), UPRIGHT);
    const root = times(front, move(this.middle.map((value) => -value)));
    const placed = {};
    for (const [side, { node, palm, size }] of Object.entries(this.hands)) {
      const last = (this.last[side] ??= {});
      if (palm !== undefined) Object.assign(last, { palm, size }); // null: it is drawn in front
      const hand = hands[side];
      if (hand && !Number.isNaN(hand[0] + hand[3])) {
        const [x, y, z, qx, qy, qz, qw] = hand;
        last.wrist = pose([x, y, z, qw, qx, qy, qz]);
      }
      if (this.place === 'front' || !last.palm || !last.wrist) continue;
      const over = this.place === 'over';
      const at = times(last.wrist, pose(last.palm, over ? 1 / last.size : 1));
      const aside = over ? 0 : side === 'right' ? BESIDE : -BESIDE;
      placed[node] = times(move([0, 1, 2].map((axis) => aside * head[axis])), at);
    }
    this.nodes.forEach((node, index) => {
      if (node.vertices) return;
      const parent = this.nodes[node.parent]?.matrix ?? root;
      node.matrix = placed[index] ?? times(parent, pose(node.values));
    });
    return true;
  }

  /** Draw the bodies for one eye. */
  draw(view, lens) {
    const { gl } = this;
    use(gl, this.program, view, lens);
    const at = (name) => where(gl, this.program, name);
    const solid = (node) => this.opacity(node) === 1;
    const meshes = this.nodes.filter((node) => node.vertices);
    for (const pass of [meshes.filter(solid), meshes.filter((node) => !solid(node))]) {
      for (const node of pass) {
        node.buffers ??= load(gl, node);
        feed(gl, this.program, node.buffers.points, [['place', 3, 0], ['normal', 3, 12]], 24);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, node.buffers.faces);
        gl.uniformMatrix4fv(at('frame'), false, this.nodes[node.parent].matrix);
        gl.uniform4fv(at('tint'), this.state(node.side)?.[0] ?? CLEAR);
        gl.uniform1i(at('facets'), node.flat);
        for (let first = 0; first < node.count; first += INSTANCE) {
          const one = node.values.subarray(first, first + INSTANCE);
          if (Number.isNaN(one[0])) continue;
          gl.uniform3fv(at('at'), one.subarray(0, 3));
          gl.uniform4fv(at('turn'), one.subarray(3, 7));
          gl.uniform3fv(at('size'), one.subarray(7, 10));
          gl.uniform4f(at('ink'), one[10], one[11], one[12], this.opacity(node));
          gl.drawElements(gl.TRIANGLES, node.buffers.count, gl.UNSIGNED_INT, 0);
        }
      }
      gl.enable(gl.BLEND);
      gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    }
    gl.disable(gl.BLEND);
  }

  /** Draw the state of each hand below it. */
  label(signs, head) {
    for (const [side, { node, latched }] of Object.entries(this.hands)) {
      const words = this.state(side)?.[1] ?? (latched.length ? `pinch: ${latched.join(', ')}` : '');
      if (!words) continue;
      const label = (this.labels[side] ??= { sign: picture(this.gl, 512, 102) });
      if (label.words !== words) {
        label.words = words;
        write(label.sign[0], words);
        fill(this.gl, label.sign[1], label.sign[0].canvas);
      }
      const at = Float32Array.from(head); // turned as the head
      at.set(this.nodes[node].matrix.subarray(12, 15), 12);
      at[13] -= LABEL_DOWN;
      signs.show(label.sign[1], at, LABEL);
    }
  }

  opacity(node) {
    return node.side && this.place === 'over' ? SEE_THROUGH * node.opacity : node.opacity;
  }

  /** Tint and words of a side; nothing while its robot follows. */
  state(side) {
    if (!this.hands[side]) return undefined;
    return MODES[this.link.state === 'linked' ? this.hands[side].mode : 'unlinked'];
  }
}

function decoded(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/** Load a mesh, with the mean normal of the faces around each vertex. */
function load(gl, node) {
  const vertices = new Float32Array(decoded(node.vertices).buffer);
  const faces = new Uint32Array(decoded(node.faces).buffer);
  const points = new Float32Array(2 * vertices.length);
  for (let at = 0; at < vertices.length; at += 3) points.set(vertices.subarray(at, at + 3), 2 * at);
  for (let at = 0; at < faces.length; at += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => vertices.subarray(3 * faces[at + k], 3 * faces[at + k] + 3));
    const [u, v] = [b, c].map((end) => end.map((value, axis) => value - a[axis]));
    for (let axis = 0; axis < 3; axis++) {
      const [next, after] = [(axis + 1) % 3, (axis + 2) % 3];
      const normal = u[next] * v[after] - u[after] * v[next]; // longer for a larger face
      for (let k = 0; k < 3; k++) points[6 * faces[at + k] + 3 + axis] += normal;
    }
  }
  const buffers = { points: gl.createBuffer(), faces: gl.createBuffer(), count: faces.length };
  gl.bindBuffer(gl.ARRAY_BUFFER, buffers.points);
  gl.bufferData(gl.ARRAY_BUFFER, points, gl.STATIC_DRAW);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.faces);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  return buffers;
}

function write(ink, words) {
  ink.fillStyle = '#10202b';
  ink.fillRect(0, 0, 512, 102);
  ink.fillStyle = '#ffffff';
  ink.textAlign = 'center';
  ink.font = '600 42px system-ui, sans-serif';
  ink.fillText(words, 256, 66, 490);
}
