// @ts-check
// A camera that turns about a point: by mouse, touch, pen and keyboard.

import { add, cross, lookAt, perspective, scale, unit } from './math.js';

const FIELD_OF_VIEW = 0.75;

export class Orbit {
  /** @param {HTMLCanvasElement} canvas @param {() => void} changed */
  constructor(canvas, changed) {
    this.changed = changed;
    this.canvas = canvas;
    this.azimuth = this.elevation = this.distance = 0;
    this.target = [0, 0, 0];
    this.home();
    /** @type {Map<number, { x: number, y: number }>} */
    this.fingers = new Map();
    this.isHeld = false;
    /** @type {() => void} Called when the user moves the point himself. */
    this.onPan = () => {};
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      this.isHeld = true;
    });
    for (const type of ['pointerup', 'pointercancel']) {
      canvas.addEventListener(type, (event) => { this.fingers.delete(/** @type {PointerEvent} */ (event).pointerId); this.isHeld = this.fingers.size > 0; });
    }
    canvas.addEventListener('pointermove', (event) => this.move(event));
    canvas.addEventListener('contextmenu', (event) => event.preventDefault());
    canvas.addEventListener('wheel', (event) => { event.preventDefault(); this.zoom(Math.exp(event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.0015))); }, { passive: false });
    canvas.addEventListener('dblclick', () => { this.home(); this.changed(); });
  }

  /** As one sees a robot from in front and above. */
  home() {
    this.azimuth = 0.62;
    this.elevation = 0.28;
    this.distance = 1.5;
    this.target = [0, 0, 0.22];
  }

  /** @param {PointerEvent} event */
  move(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const now = { x: event.clientX, y: event.clientY };
    const [dx, dy] = [now.x - before.x, now.y - before.y];
    if (this.fingers.size === 1) {
      if (event.shiftKey || event.buttons & 6) this.pan(dx, dy);
      else this.rotate(-dx * 0.007, dy * 0.007);
    } else if (this.fingers.size === 2) {
      const other = [...this.fingers].find(([id]) => id !== event.pointerId)?.[1];
      if (other) {
        const apart = (/** @type {{ x: number, y: number }} */ p) => Math.hypot(p.x - other.x, p.y - other.y);
        this.zoom(apart(before) / Math.max(1, apart(now)));
        this.pan(dx / 2, dy / 2);
      }
    }
    this.fingers.set(event.pointerId, now);
  }

  /** @param {number} azimuth @param {number} elevation */
  rotate(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.max(-0.2, Math.min(1.55, this.elevation + elevation));
    this.changed();
  }

  /** @param {number} factor */
  zoom(factor) {
    this.distance = Math.max(0.08, Math.min(60, this.distance * factor));
    this.changed();
  }

  /** @param {number} dx @param {number} dy in pixels */
  pan(dx, dy) {
    const size = (2 * this.distance * Math.tan(FIELD_OF_VIEW / 2)) / Math.max(1, this.canvas.clientHeight);
    const back = this.direction();
    const right = unit(cross([0, 0, 1], back));
    this.target = add(this.target, add(scale(right, -dx * size), scale(cross(back, right), dy * size)));
    this.onPan();
    this.changed();
  }

  direction() {
    const { azimuth, elevation } = this;
    return [Math.cos(azimuth) * Math.cos(elevation), Math.sin(azimuth) * Math.cos(elevation), Math.sin(elevation)];
  }

  camera() {
    const eye = add(this.target, scale(this.direction(), this.distance));
    eye[2] = Math.max(eye[2], 0.01);
    const aspect = this.canvas.width / Math.max(1, this.canvas.height);
    return { eye, focus: this.target, view: lookAt(eye, this.target, [0, 0, 1]), projection: perspective(FIELD_OF_VIEW * (aspect < 0.8 ? 1.25 : 1), aspect, this.distance * 0.02 + 0.005, this.distance * 20 + 60) };
  }

  /** @param {KeyboardEvent} event @returns {boolean} whether the key means something */
  key(event) {
    const step = 0.12;
    if (event.shiftKey && event.key.startsWith('Arrow')) {
      const by = 40;
      this.pan(event.key === 'ArrowLeft' ? by : event.key === 'ArrowRight' ? -by : 0, event.key === 'ArrowUp' ? by : event.key === 'ArrowDown' ? -by : 0);
      return true;
    }
    switch (event.key) {
      case 'ArrowLeft': this.rotate(step, 0); return true;
      case 'ArrowRight': this.rotate(-step, 0); return true;
      case 'ArrowUp': this.rotate(0, step); return true;
      case 'ArrowDown': this.rotate(0, -step); return true;
      case '+': case '=': this.zoom(0.85); return true;
      case '-': case '_': this.zoom(1 / 0.85); return true;
      default: return false;
    }
  }
}
