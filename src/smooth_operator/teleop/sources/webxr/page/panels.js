// Pictures of the host's cameras as panels in front of the operator.

import { fill, move, picture, times } from './gl.js';

const GIVE_UP = 2000; // ms without an answer, after which the page asks again
const HEAD = 16; // bytes before the JPEG: camera, number, time; see PICTURE of link.py
const PLACE = [0, 0.02, -1.2]; // middle of the panels, in front of the operator [m]
const WIDTH = 0.6; // m
const GAP = 0.04; // m
const LINE = [WIDTH, 0.05]; // size of the line below a picture [m]
const DIMMED = 0.25; // light of a late picture
const WRITE_EVERY = 100; // ms

export class Panels {
  /** @param {import('./link.js').Link} link */
  constructor(link) {
    this.link = link;
    this.cameras = [];
    this.asked = -Infinity;
    this.waiting = false;
    link.addEventListener('view', (event) => this.hear(event.detail));
    link.addEventListener('picture', (event) => this.take(event.detail));
  }

  hear({ cameras = [], late_s: late }) {
    this.late = late;
    this.cameras.length = cameras.length;
    cameras.forEach((state, at) => {
      this.cameras[at] = { ...this.cameras[at], ...state };
    });
    this.ask();
  }

  /** Ask for one new picture, once the last one has come. */
  ask() {
    const now = performance.now();
    if (this.waiting && now - this.asked < GIVE_UP) return;
    const there = this.cameras.length;
    for (let k = 1; k <= there; k++) { // in turn
      const at = ((this.last ?? -1) + k) % there;
      const camera = this.cameras[at];
      if (camera.number === (camera.shown ?? 0)) continue;
      this.waiting = true;
      this.asked = now;
      this.last = at;
      this.link.ask({ type: 'picture', camera: at });
      return;
    }
  }

  async take(message) {
    const head = new DataView(message);
    const camera = head.getUint32(0, true);
    const [shown, time] = [head.getUint32(4, true), head.getFloat64(8, true)];
    const image = await createImageBitmap(new Blob([new Uint8Array(message, HEAD)])).catch(() => null);
    this.waiting = false;
    if (this.cameras[camera]) Object.assign(this.cameras[camera], { shown, taken: time }, image && { image, fresh: true });
    this.ask();
  }

  /** Prepare to draw in another context. */
  open(gl) {
    this.gl = gl;
    for (const camera of this.cameras) {
      camera.panel = camera.line = null;
      camera.fresh = true;
    }
  }

  /** Draw the pictures, late ones dimmed, with a line below each. */
  draw(signs, desk) {
    const { gl } = this;
    this.cameras.forEach((camera, at) => {
      if (!camera.image) return;
      camera.panel ??= picture(gl, 2, 2)[1];
      camera.line ??= picture(gl, 720, 60);
      if (camera.fresh) fill(gl, camera.panel, camera.image);
      camera.fresh = false;
      const age = this.age(camera);
      const late = !(age < this.late);
      const aside = (at - (this.cameras.length - 1) / 2) * (WIDTH + GAP);
      const [x, y, z] = PLACE;
      const height = (WIDTH * camera.image.height) / camera.image.width;
      const place = (up) => times(desk, move([x + aside, y + up, z]));
      signs.show(camera.panel, place(0), [WIDTH, height], late ? DIMMED : 1);
      this.write(camera, age, late);
      signs.show(camera.line[1], place(-(height + LINE[1]) / 2), LINE);
    });
  }

  /** Age of a picture by the clock of the host [s]; it also grows without a link. */
  age(camera) {
    this.offset = this.link.offset ?? this.offset ?? NaN;
    return performance.now() / 1000 + this.offset - camera.taken;
  }

  write(camera, age, late) {
    const now = performance.now();
    if (late === camera.late && now - camera.written < WRITE_EVERY) return;
    Object.assign(camera, { late, written: now });
    const [ink] = camera.line;
    ink.fillStyle = late ? '#a01414' : '#10202b';
    ink.fillRect(0, 0, 720, 60);
    ink.fillStyle = '#ffffff';
    ink.font = '500 34px system-ui, sans-serif';
    const lost = camera.lost ? ', camera lost' : '';
    ink.fillText(`${camera.name}: ${late ? 'late, ' : ''}${age.toFixed(1)} s old${lost}`, 16, 42, 690);
    fill(this.gl, camera.line[1], ink.canvas);
  }
}
