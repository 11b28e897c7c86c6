// What is seen inside the headset: the joints as dots, and a small board that says how the link is.

import { FINGER_COLORS } from './colors.js';

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
const BOARD = `#version 300 es
in vec2 corner; uniform mat4 view, lens; out vec2 at;
void main() {
  at = vec2(corner.x + 0.5, 0.5 - corner.y);
  gl_Position = lens * view * vec4(0.56 * corner.x, 0.14 * corner.y - 0.28, -0.9, 1.0);
}`;
const WORDS = `#version 300 es
precision mediump float; in vec2 at; uniform sampler2D words; out vec4 seen;
void main() { seen = texture(words, at); }`;

export class Scene {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.dots = program(gl, DOTS, DOT);
    this.board = program(gl, BOARD, WORDS);
    this.joints = gl.createBuffer();
    this.points = new Float32Array(2 * JOINTS * 7);
    this.corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.bufferData(
      gl.ARRAY_BUFFER, new Float32Array([-0.5, -0.5, 0.5, -0.5, -0.5, 0.5, 0.5, 0.5]), gl.STATIC_DRAW,
    );
    const canvas = document.createElement('canvas');
    canvas.width = 1024;
    canvas.height = 256;
    this.ink = canvas.getContext('2d');
    this.words = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.words);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    this.written = -Infinity;
  }

  /**
   * Draw a moment for each eye.
   * @param {XRWebGLLayer} layer
   * @param {XRViewerPose?} viewer
   * @param {Float32Array[]} hands those that are seen
   * @param {{dark: boolean, good: boolean, lines: () => string[]}} look
   */
  draw(layer, viewer, hands, look) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.clearColor(0.05, 0.07, 0.09, look.dark ? 1 : 0);
    if (!look.dark) gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!viewer) return;
    const count = this.load(hands, look.good);
    this.write(look);
    gl.enable(gl.DEPTH_TEST);
    for (const view of viewer.views) {
      const port = layer.getViewport(view);
      if (!port) continue;
      gl.viewport(port.x, port.y, port.width, port.height);
      const matrix = view.transform.inverse.matrix;
      this.use(this.board, matrix, view.projectionMatrix);
      gl.bindTexture(gl.TEXTURE_2D, this.words);
      feed(gl, this.board, this.corners, [['corner', 2, 0]], 8);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
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

  /** Joints as points; grey while the link is down. */
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

  /** The board, four times a second. */
  write(look) {
    const now = performance.now();
    if (now - this.written < BOARD_EVERY) return;
    this.written = now;
    const { ink, gl } = this;
    ink.fillStyle = look.good ? '#10202b' : '#5a1c0c';
    ink.fillRect(0, 0, 1024, 256);
    ink.fillStyle = '#ffffff';
    look.lines().forEach((line, row) => {
      ink.font = `${row ? 400 : 650} ${row ? 58 : 72}px system-ui, sans-serif`;
      ink.fillText(line, 48, 105 + 90 * row, 930);
    });
    gl.bindTexture(gl.TEXTURE_2D, this.words);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, ink.canvas);
  }
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
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return made;
}
