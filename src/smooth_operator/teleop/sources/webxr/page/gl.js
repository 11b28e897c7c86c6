// WebGL programs, textures, signs and column-major matrices.

export function program(gl, vertex, fragment) {
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

/** Location of a uniform; asked for once, since an answer takes long. */
export function where(gl, what, name) {
  what.places ??= {};
  return (what.places[name] ??= gl.getUniformLocation(what, name));
}

export function use(gl, what, view, lens) {
  gl.useProgram(what);
  gl.uniformMatrix4fv(where(gl, what, 'view'), false, view);
  gl.uniformMatrix4fv(where(gl, what, 'lens'), false, lens);
}

export function feed(gl, what, buffer, attributes, stride) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  for (let place = 0; place < 4; place++) gl.disableVertexAttribArray(place);
  for (const [name, size, offset] of attributes) {
    const place = gl.getAttribLocation(what, name);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, stride, offset);
  }
}

/** A canvas and its texture. */
export function picture(gl, width, height, paint = () => {}) {
  const canvas = document.createElement('canvas');
  canvas.width = width;
  canvas.height = height;
  const ink = canvas.getContext('2d');
  paint(ink);
  const texture = gl.createTexture();
  fill(gl, texture, canvas);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  return [ink, texture];
}

/** Load an image into a texture. */
export function fill(gl, texture, image) {
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
}

const SIGN = `#version 300 es
in vec2 corner; uniform mat4 view, lens, place; uniform vec2 size; out vec2 at;
void main() {
  at = vec2(corner.x + 0.5, 0.5 - corner.y);
  gl_Position = lens * view * place * vec4(size * corner, 0.0, 1.0);
}`;
const WORDS = `#version 300 es
precision mediump float; in vec2 at; uniform sampler2D words; uniform float light; out vec4 seen;
void main() { seen = texture(words, at); if (seen.a < 0.5) discard; seen.rgb *= light; }`;

/** Flat rectangles with a texture. */
export class Signs {
  constructor(gl) {
    this.gl = gl;
    this.program = program(gl, SIGN, WORDS);
    this.corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.bufferData(
      gl.ARRAY_BUFFER, new Float32Array([-0.5, -0.5, 0.5, -0.5, -0.5, 0.5, 0.5, 0.5]), gl.STATIC_DRAW,
    );
  }

  use(view, lens) {
    use(this.gl, this.program, view, lens);
    feed(this.gl, this.program, this.corners, [['corner', 2, 0]], 8);
  }

  /** Draw a texture at a pose, with a width and height [m]; light 1 draws it as it is. */
  show(texture, place, size, light = 1) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.uniformMatrix4fv(where(gl, this.program, 'place'), false, place);
    gl.uniform2fv(where(gl, this.program, 'size'), size);
    gl.uniform1f(where(gl, this.program, 'light'), light);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }
}

/** Product of two matrices. */
export function times(a, b) {
  const out = new Float32Array(16);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      for (let k = 0; k < 4; k++) out[4 * column + row] += a[4 * k + row] * b[4 * column + k];
    }
  }
  return out;
}

/** Matrix of a position, a quaternion w x y z, and a scale. */
export function pose([px, py, pz, w, x, y, z], scale = 1) {
  const m = [
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), 0,
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), 0,
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), 0,
    px, py, pz, 1,
  ];
  return Float32Array.from(m, (value, at) => (at < 12 ? scale * value : value));
}

/** Matrix of a move. */
export function move([x, y, z]) {
  return Float32Array.of(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1);
}
