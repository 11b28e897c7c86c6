// Picture inside the headset: the joints as dots, a board with the state, and the stop button.

import { FINGER_COLORS } from './colors.js';
import { feed, fill, move, picture, program, Signs, times, use, where } from './gl.js';
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
const BOARD_SIZE = [0.56, 0.14]; // m
const BOARD_PLACE = [0, -0.28, -0.9]; // in front of the head [m]
const STAY = 0.7; // angle by which the operator turns before the scene follows [rad]
const STEP = 0.5; // distance in the same sense [m]
const COLORS = { good: '#10202b', warn: '#6b4e00', bad: '#a01414' };

export class Scene {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {import('./robot.js').Robot} robot
   * @param {import('./panels.js').Panels} panels
   */
  constructor(gl, robot, panels) {
    this.gl = gl;
    this.dots = program(gl, DOTS, DOT);
    this.signs = new Signs(gl);
    this.robot = robot;
    this.panels = panels;
    robot.open(gl);
    panels.open(gl);
    this.joints = gl.createBuffer();
    this.points = new Float32Array(2 * JOINTS * 7);
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
   * @param {{dark: boolean, good: boolean, sides: import('./hands.js').Hands,
   *   board: () => {kind: string, lines: string[]}}} look
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
    const head = viewer.transform.matrix;
    const board = times(head, move(BOARD_PLACE));
    const desk = this.settle(head);
    const drawn = this.robot.settle(look.sides, head, desk);
    gl.enable(gl.DEPTH_TEST);
    for (const view of viewer.views) {
      const port = layer.getViewport(view);
      if (!port) continue;
      gl.viewport(port.x, port.y, port.width, port.height);
      const matrix = view.transform.inverse.matrix;
      const lens = view.projectionMatrix;
      if (drawn) this.robot.draw(matrix, lens);
      this.signs.use(matrix, lens);
      this.panels.draw(this.signs, desk);
      if (drawn) this.robot.label(this.signs, head);
      this.signs.show(this.words, board, BOARD_SIZE);
      this.signs.show(this.disc, button, [2 * RADIUS, 2 * RADIUS]);
      use(gl, this.dots, matrix, lens);
      gl.uniform1f(where(gl, this.dots, 'height'), port.height);
      feed(gl, this.dots, this.joints, [['joint', 4, 0], ['colour', 3, 16]], 28);
      gl.drawArrays(gl.POINTS, 0, count);
    }
  }

  /** Level frame of the operator's view; it moves only if the operator turns or walks away. */
  settle(head) {
    const length = Math.hypot(head[8], head[10]);
    const [x, z] = length > 0.05 ? [head[8] / length, head[10] / length] : [0, 1];
    const here = Float32Array.of(z, 0, -x, 0, 0, 1, 0, 0, x, 0, z, 0, ...head.subarray(12, 15), 1);
    const { desk } = this;
    const turned = desk && desk[8] * x + desk[10] * z < Math.cos(STAY);
    const away = desk && Math.hypot(...[12, 13, 14].map((at) => desk[at] - here[at])) > STEP;
    if (!desk || turned || away) this.desk = here;
    return this.desk;
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
    fill(gl, this.words, ink.canvas);
  }
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
