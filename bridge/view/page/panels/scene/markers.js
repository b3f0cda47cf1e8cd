// @ts-check
// visualization_msgs: markers as meshes, lines, points and texts.

import { compose, matrix, poseOf, rotate, turn, add } from './math.js';
import { box, cone, cylinder, flat, sphere } from './meshes.js';

/**
 * @typedef {import('./webgl.js').Item} Item
 * @typedef {{ items: Item[], lines: number[], points: number[], texts: { at: number[], text: string, color: number[] }[] }} Drawn
 */

const MOST_MARKERS = 2000;
const MOST_POINTS = 20_000;
const UNITS = { box: box(), sphere: sphere(), cylinder: cylinder(), cone: cone() };
const ALONG_X = turn([0, 1, 0], Math.PI / 2);

export class Markers {
  constructor() {
    /** @type {Map<string, { marker: any, untilMs: number, triangles?: import('./meshes.js').Mesh }>} */
    this.all = new Map();
  }

  /** @param {string} topic @param {any} marker */
  take(topic, marker) {
    const key = `${topic} ${marker.ns} ${marker.id}`;
    if (marker.action === 3) { for (const other of [...this.all.keys()]) if (other.startsWith(`${topic} `)) this.all.delete(other); return; }
    if (marker.action === 2) { this.all.delete(key); return; }
    if (!this.all.has(key) && this.all.size >= MOST_MARKERS) return;
    const lifeMs = marker.lifetime.sec * 1000 + marker.lifetime.nanosec / 1e6;
    this.all.set(key, { marker, untilMs: lifeMs > 0 ? performance.now() + lifeMs : Infinity });
  }

  clear() { this.all.clear(); }

  /** @param {(frame: string) => import('./math.js').Pose | null} placeOf @param {Drawn} into */
  draw(placeOf, into) {
    const now = performance.now();
    for (const [key, entry] of this.all) {
      if (entry.untilMs < now) { this.all.delete(key); continue; }
      const { marker } = entry;
      const frame = placeOf(marker.header.frame_id);
      if (!frame) continue;
      const pose = compose(frame, poseOf(marker.pose));
      const place = (/** @type {any} */ point) => add(pose.p, rotate(pose.q, [point.x, point.y, point.z]));
      const color = colorOf(marker.color);
      const { x, y, z } = marker.scale;
      const points = marker.points.slice(0, MOST_POINTS);
      const colorAt = (/** @type {number} */ i) => (marker.colors[i] ? colorOf(marker.colors[i]) : color);
      switch (marker.type) {
        case 0: arrow(marker, pose, color, place, into); break;
        case 1: into.items.push({ mesh: UNITS.box, model: matrix(pose, [x, y, z]), color }); break;
        case 2: into.items.push({ mesh: UNITS.sphere, model: matrix(pose, [x / 2, y / 2, z / 2]), color }); break;
        case 3: into.items.push({ mesh: UNITS.cylinder, model: matrix(pose, [x / 2, y / 2, z]), color }); break;
        case 4: for (let i = 0; i + 1 < points.length; i++) into.lines.push(...place(points[i]), ...place(points[i + 1]), ...colorAt(i), 2); break;
        case 5: for (let i = 0; i + 1 < points.length; i += 2) into.lines.push(...place(points[i]), ...place(points[i + 1]), ...colorAt(i), 2); break;
        case 6: case 7: {
          const mesh = marker.type === 6 ? UNITS.box : UNITS.sphere;
          const size = marker.type === 6 ? [x, y, z] : [x / 2, y / 2, z / 2];
          points.slice(0, MOST_MARKERS).forEach((/** @type {any} */ point, /** @type {number} */ i) => into.items.push({ mesh, model: matrix({ p: place(point), q: pose.q }, size), color: colorAt(i) }));
          break;
        }
        case 8: points.forEach((/** @type {any} */ point, /** @type {number} */ i) => into.points.push(...place(point), 0, 0, 0, ...colorAt(i), x)); break;
        case 9: into.texts.push({ at: pose.p, text: marker.text, color }); break;
        case 11: {
          if (!entry.triangles) {
            const positions = Float32Array.from(points.slice(0, points.length - (points.length % 3)).flatMap((/** @type {any} */ p) => [p.x * x, p.y * y, p.z * z]));
            entry.triangles = flat(positions, new Float32Array(positions.length));
          }
          into.items.push({ mesh: entry.triangles, model: matrix(pose), color });
          break;
        }
        default: break;
      }
    }
  }
}

/** @param {any} marker @param {import('./math.js').Pose} pose @param {number[]} color @param {(point: any) => number[]} place @param {Drawn} into */
function arrow(marker, pose, color, place, into) {
  if (marker.points.length >= 2) {
    const [from, to] = [place(marker.points[0]), place(marker.points[1])];
    into.lines.push(...from, ...to, ...color, 4);
    return;
  }
  const { x, y } = marker.scale;
  const along = { p: pose.p, q: compose(pose, { p: [0, 0, 0], q: ALONG_X }).q };
  const at = (/** @type {number} */ z) => compose(along, { p: [0, 0, z], q: [0, 0, 0, 1] });
  into.items.push({ mesh: UNITS.cylinder, model: matrix(at(x * 0.38), [y / 2, y / 2, x * 0.76]), color });
  into.items.push({ mesh: UNITS.cone, model: matrix(at(x * 0.76), [y, y, x * 0.24]), color });
}

/** @param {{ r: number, g: number, b: number, a: number }} color */
const colorOf = ({ r, g, b, a }) => [r, g, b, a];
