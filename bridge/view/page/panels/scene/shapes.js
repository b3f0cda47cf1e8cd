// @ts-check
// The shapes of a robot as meshes, in their places.

import { compose, identity, matrix, rotate, scale } from './math.js';
import { box, capsule, cylinder, parseStl, sphere } from './meshes.js';
import { words } from '../../connection.js';

/**
 * @typedef {import('./math.js').Pose} Pose
 * @typedef {import('./meshes.js').Mesh} Mesh
 */

export const UNITS = { box: box(), sphere: sphere(), cylinder: cylinder() };

export class Shapes {
  /**
   * @param {{ asset(uri: string): Promise<ArrayBuffer> }} robot who has the files of meshes
   * @param {() => void} changed called when a mesh has come @param {(text: string) => void} tell called when one cannot be shown
   */
  constructor(robot, changed, tell) {
    this.robot = robot;
    this.changed = changed;
    this.tell = tell;
    /** @type {Map<string, Mesh | null>} By URI; `null` while it loads or if that failed. */
    this.files = new Map();
    /** @type {Map<string, Mesh>} */
    this.capsules = new Map();
  }

  /** Forgets the meshes of files: they may be those of another robot. */
  clear() { this.files.clear(); }

  /** @param {string} uri @returns {Mesh | null} */
  file(uri) {
    const known = this.files.get(uri);
    if (known !== undefined) return known;
    this.files.set(uri, null);
    if (!/\.stl$/i.test(uri)) { this.tell(`only STL meshes are shown: ${uri}`); return null; }
    this.robot.asset(uri).then((data) => { this.files.set(uri, parseStl(data)); this.changed(); }, (error) => this.tell(words(error)));
    return null;
  }

  /** @param {import('./urdf.js').Shape} shape @param {Pose} link @param {number[]} color @returns {import('./webgl.js').Item | null} */
  item({ kind, size, origin, uri }, link, color) {
    const pose = compose(link, origin);
    switch (kind) {
      case 'box': return { mesh: UNITS.box, model: matrix(pose, size), color };
      case 'sphere': return { mesh: UNITS.sphere, model: matrix(pose, [size[0], size[0], size[0]]), color };
      case 'cylinder': return { mesh: UNITS.cylinder, model: matrix(pose, [size[0], size[0], size[1]]), color };
      case 'capsule': {
        const key = size.join();
        if (!this.capsules.has(key)) this.capsules.set(key, capsule(size[0], size[1]));
        return { mesh: /** @type {any} */ (this.capsules.get(key)), model: matrix(pose), color };
      }
      default: {
        const mesh = uri ? this.file(uri) : null;
        return mesh && { mesh, model: matrix(pose, size), color };
      }
    }
  }
}

/**
 * Where the root is of a robot without odometry: its lowest shape is on the ground.
 * @param {import('./urdf.js').Description} description @param {Map<string, Pose>} links @returns {Pose}
 */
export function standing(description, links) {
  let low = 0;
  for (const [name, { visual, collision }] of description.links) {
    for (const { kind, size, origin } of [...visual, ...collision]) {
      if (kind === 'mesh') continue;
      const pose = compose(links.get(name) ?? identity(), origin);
      const [x, y, z] = kind === 'box' ? scale(size, 0.5) : kind === 'sphere' ? [size[0], size[0], size[0]] : [size[0], size[0], size[1] / 2];
      for (const corner of [[x, y, z], [x, y, -z], [x, -y, z], [x, -y, -z], [-x, y, z], [-x, y, -z], [-x, -y, z], [-x, -y, -z]]) {
        low = Math.min(low, pose.p[2] + rotate(pose.q, corner)[2]);
      }
    }
  }
  return { p: [0, 0, -low], q: [0, 0, 0, 1] };
}
