// @ts-check
// The tree of frames, from `tf2_msgs/TFMessage`: the newest transform of each frame.

import { compose, identity, inverse } from './math.js';

/** @typedef {import('./math.js').Pose} Pose */

/** More frames than any robot has; a damaged topic must not fill the memory. */
const MOST_FRAMES = 5000;
const DEEPEST = 200;

export class Transforms {
  constructor() {
    /** @type {Map<string, { parent: string, pose: Pose, timeNs: bigint, isStatic?: boolean, isJoined?: boolean }>} By child. */
    this.frames = new Map();
  }

  /** @param {string} parent @param {string} child @param {Pose} pose `parent_from_child` @param {bigint} timeNs @param {boolean} [isStatic] */
  set(parent, child, pose, timeNs, isStatic = false) {
    if (parent === child || !child || (!this.frames.has(child) && this.frames.size >= MOST_FRAMES)) return;
    this.frames.set(child, { parent, pose, timeNs, isStatic });
  }

  /**
   * Hangs the tree of `child` into `parent`, as the true pose of a simulated robot does with the tree of its odometry.
   * @param {string} parent @param {string} child @param {Pose} pose `parent_from_child` @param {bigint} timeNs
   */
  join(parent, child, pose, timeNs) {
    let [top, fromChild] = [child, identity()];
    for (let depth = 0; depth < DEEPEST; depth++) {
      const edge = this.frames.get(top);
      if (!edge || edge.isJoined) break;
      fromChild = compose(edge.pose, fromChild);
      top = edge.parent;
    }
    if (top !== parent) this.frames.set(top, { parent, pose: compose(pose, inverse(fromChild)), timeNs, isJoined: true });
  }

  /** @param {any} message @param {bigint} timeNs @param {boolean} [isStatic] */
  take(message, timeNs, isStatic = false) {
    for (const { header, child_frame_id: child, transform: { translation: t, rotation: r } } of message.transforms) {
      this.set(plain(header.frame_id), plain(child), { p: [t.x, t.y, t.z], q: [r.x, r.y, r.z, r.w] }, timeNs, isStatic);
    }
  }

  /** The frame that all frames above lead to, and the pose in it. @param {string} frame @returns {[string, Pose]} */
  root(frame) {
    let pose = identity();
    for (let depth = 0; depth < DEEPEST; depth++) {
      const edge = this.frames.get(frame);
      if (!edge) break;
      pose = compose(edge.pose, pose);
      frame = edge.parent;
    }
    return [frame, pose];
  }

  /** `a_from_b`, or nothing if they have no frame in common. @param {string} a @param {string} b @returns {Pose | null} */
  lookup(a, b) {
    const [[rootA, fromA], [rootB, fromB]] = [this.root(plain(a)), this.root(plain(b))];
    return rootA === rootB ? compose(inverse(fromA), fromB) : null;
  }

  /** All names, sorted. */
  names() {
    const names = new Set(this.frames.keys());
    for (const { parent } of this.frames.values()) names.add(parent);
    return [...names].sort();
  }

  clear() { this.frames.clear(); }
}

/** Names of ROS 1 begin with a slash. @param {string} name */
export const plain = (name) => name.replace(/^\//, '');
