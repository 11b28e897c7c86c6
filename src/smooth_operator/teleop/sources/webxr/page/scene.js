// Picture inside the headset: the joints as dots, a board with the state, and the stop button.

import { FINGER_COLORS } from './colors.js';
import { RADIUS } from './stop_button.js';

const WRIST = [205, 205, 212];
const VALUES = 8;
const JOINTS = 25;
const BOARD_EVERY = 250; // ms

const DOTS = `#version 300 es
in vec4 joint; in vec3 colour; uniform mat4 view, lens; uniform float height; out vec3 ink;
void main() {
  gl_Position = lens * view * vec4(joint.xyz, 1.0);
  gl_PointSize = max(2.0, joint.w * lens[1][1] * height / gl_Position.w);
  ink = colour;
}`;
const DOT = `#version 300 es
precision mediump float; in vec3 ink; out vec4 seen;
void main() {
  vec2 from = 2.0 * gl_PointCoord - 1.0; float far = dot(from, from);
  if (far > 1.0) discard;
  seen = vec4(ink * (1.0 - 0.45 * far), 1.0);
}`;
const SIGN = `#version 300 es
in vec2 corner; uniform mat4 view, lens, place; uniform vec2 size; out vec2 at;
void main() {
  at = vec2(corner.x + 0.5, 0.5 - corner.y);
  gl_Position = lens * view * place * vec4(size * corner, 0.0, 1.0);
}`;
const WORDS = `#version 300 es
precision mediump float; in vec2 at; uniform sampler2D words; out vec4 seen;
void main() { seen = texture(words, at); if (seen.a < 0.5) discard; }`;
const BOARD_SIZE = [0.56, 0.14]; // m
const BOARD_PLACE = [0, -0.28, -0.9]; // in front of the head [m]
const COLORS = { good: '#10202b', warn: '#6b4e00', bad: '#a01414' };

export class Scene {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.dots = program(gl, DOTS, DOT);
    this.sign = program(gl, SIGN, WORDS);
    this.joints = gl.createBuffer();
    this.points = new Float32Array(2 * JOINTS * 7);
    this.corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.bufferData(
      gl.ARRAY_BUFFER, new Float32Array([-0.5, -0.5, 0.5, -0.5, -0.5, 0.5, 0.5, 0.5]), gl.STATIC_DRAW,
    );
    [this.ink, this.words] = picture(gl, 1024, 256);
    [, this.disc] = picture(gl, 256, 256, paintButton);
    this.written = -Infinity;
  }

  /**
   * Draw a frame for each eye.
   * @param {XRWebGLLayer} layer
   * @param {XRViewerPose?} viewer
   * @param {Float32Array[]} hands the visible ones
   * @param {Float32Array} button pose of the stop button
   * @param {{dark: boolean, good: boolean, board: () => {kind: string, lines: string[]}}} look
   */
  draw(layer, viewer, hands, button, look) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.clearColor(0.05, 0.07, 0.09, look.dark ? 1 : 0);
    if (!look.dark) gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!viewer) return;
    const count = this.load(hands, look.good);
    this.write(look.board);
    const board = ahead(viewer.transform.matrix, BOARD_PLACE);
    gl.enable(gl.DEPTH_TEST);
    for (const view of viewer.views) {
      const port = layer.getViewport(view);
      if (!port) continue;
      gl.viewport(port.x, port.y, port.width, port.height);
      const matrix = view.transform.inverse.matrix;
      this.use(this.sign, matrix, view.projectionMatrix);
      feed(gl, this.sign, this.corners, [['corner', 2, 0]], 8);
      this.show(this.words, board, BOARD_SIZE);
      this.show(this.disc, button, [2 * RADIUS, 2 * RADIUS]);
      this.use(this.dots, matrix, view.projectionMatrix);
      gl.uniform1f(gl.getUniformLocation(this.dots, 'height'), port.height);
      feed(gl, this.dots, this.joints, [['joint', 4, 0], ['colour', 3, 16]], 28);
      gl.drawArrays(gl.POINTS, 0, count);
    }
  }

  use(what, view, lens) {
    const { gl } = this;
    gl.useProgram(what);
    gl.uniformMatrix4fv(gl.getUniformLocation(what, 'view'), false, view);
    gl.uniformMatrix4fv(gl.getUniformLocation(what, 'lens'), false, lens);
  }

  show(texture, place, size) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.uniformMatrix4fv(gl.getUniformLocation(this.sign, 'place'), false, place);
    gl.uniform2fv(gl.getUniformLocation(this.sign, 'size'), size);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  /** Load the joints as points, grey without a link. */
  load(hands, good) {
    let count = 0;
    for (const hand of hands) {
      for (let joint = 0; joint < JOINTS; joint++) {
        const at = joint * VALUES;
        if (Number.isNaN(hand[at])) continue;
        const finger = joint === 0 ? -1 : Math.floor((joint - (joint < 5 ? 1 : 0)) / 5);
        const colour = !good || finger < 0 ? WRIST : FINGER_COLORS[finger];
        this.points.set([
          hand[at], hand[at + 1], hand[at + 2], hand[at + 7] || 0.008,
          colour[0] / 255, colour[1] / 255, colour[2] / 255,
        ], 7 * count++);
      }
    }
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.joints);
    gl.bufferData(gl.ARRAY_BUFFER, this.points, gl.DYNAMIC_DRAW);
    return count;
  }

  /** Write the board, four times a second. */
  write(board) {
    const now = performance.now();
    if (now - this.written < BOARD_EVERY) return;
    this.written = now;
    const { ink, gl } = this;
    const { kind, lines } = board();
    ink.fillStyle = COLORS[kind];
    ink.fillRect(0, 0, 1024, 256);
    ink.fillStyle = '#ffffff';
    lines.forEach((line, row) => {
      ink.font = `${row ? 400 : 650} ${row ? 58 : 72}px system-ui, sans-serif`;
      ink.fillText(line, 48, 105 + 90 * row, 930);
    });
    gl.bindTexture(gl.TEXTURE_2D, this.words);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, ink.canvas);
  }
}

/** A canvas and its texture. */
function picture(gl, width, height, paint = () => {}) {
  const canvas = document.createElement('canvas');
  canvas.width = width;
  canvas.height = height;
  const ink = canvas.getContext('2d');
  paint(ink);
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, canvas);
  return [ink, texture];
}

/** Paint a red disc with the word STOP, 256 pixels wide. */
function paintButton(ink) {
  ink.fillStyle = '#e02020';
  ink.beginPath();
  ink.arc(128, 128, 126, 0, 2 * Math.PI);
  ink.fill();
  ink.fillStyle = '#ffffff';
  ink.textAlign = 'center';
  ink.font = '700 76px system-ui, sans-serif';
  ink.fillText('STOP', 128, 138);
  ink.font = '500 34px system-ui, sans-serif';
  ink.fillText('touch', 128, 186);
}

/** Pose of an object at a place in front of the head; both are column-major matrices. */
function ahead(head, [x, y, z]) {
  const pose = Float32Array.from(head);
  for (let row = 0; row < 3; row++) {
    pose[12 + row] += head[row] * x + head[4 + row] * y + head[8 + row] * z;
  }
  return pose;
}

function feed(gl, what, buffer, attributes, stride) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  for (let place = 0; place < 4; place++) gl.disableVertexAttribArray(place);
  for (const [name, size, offset] of attributes) {
    const place = gl.getAttribLocation(what, name);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, stride, offset);
  }
}

function program(gl, vertex, fragment) {
  const linked = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(linked, shader);
  }
  gl.linkProgram(linked);
  if (!gl.getProgramParameter(linked, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(linked));
  return linked;
}
