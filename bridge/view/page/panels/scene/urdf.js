// @ts-check
// Robot descriptions (wiki.ros.org/urdf/XML): links with their shapes, joints, and forward kinematics.

import { compose, identity, multiply, rollPitchYaw, turn } from './math.js';

/**
 * @typedef {import('./math.js').Pose} Pose
 * @typedef {{ kind: 'box' | 'cylinder' | 'sphere' | 'capsule' | 'mesh', size: number[], uri?: string, origin: Pose, color: number[] }} Shape
 *   `size`: box x, y, z; cylinder and capsule radius and length; sphere radius; mesh scale
 * @typedef {{ name: string, type: string, parent: string, child: string, origin: Pose, axis: number[], lower: number, upper: number,
 *   mimic?: { joint: string, factor: number, offset: number } }} Joint
 * @typedef {{ name: string, root: string, links: Map<string, { visual: Shape[], collision: Shape[] }>, joints: Joint[] }} Description
 */

const GREY = [0.62, 0.64, 0.67, 1];

/** @param {string | null | undefined} text @param {number[]} otherwise */
const numbers = (text, otherwise) => {
  const found = (text ?? '').split(/[\s,]+/).filter((word) => word).map(Number).slice(0, otherwise.length);
  return found.length === otherwise.length && found.every(Number.isFinite) ? found : otherwise;
};
/** @param {number[]} vector */
const unit = (vector) => {
  const length = Math.hypot(...vector);
  return length > 0 ? vector.map((part) => part / length) : [1, 0, 0];
};
/** @param {Element} element @param {string} name */
const childrenOf = (element, name) => [...element.children].filter(({ localName }) => localName === name);
/** @param {Element} element @param {string} name */
const childOf = (element, name) => childrenOf(element, name)[0];

/** @param {Element} element @returns {Pose} */
function originOf(element) {
  const origin = childOf(element, 'origin');
  if (!origin) return identity();
  const [roll, pitch, yaw] = numbers(origin.getAttribute('rpy'), [0, 0, 0]);
  return { p: numbers(origin.getAttribute('xyz'), [0, 0, 0]), q: rollPitchYaw(roll, pitch, yaw) };
}

/** @param {Element} element @param {Map<string, number[]>} materials @returns {Shape | null} */
function shapeOf(element, materials) {
  const geometry = childOf(element, 'geometry')?.children[0];
  if (!geometry) return null;
  const number = (/** @type {string} */ name) => Number(geometry.getAttribute(name)) || 0;
  const material = childOf(element, 'material');
  const color = (material && (colorOf(material) ?? materials.get(material.getAttribute('name') ?? ''))) ?? GREY;
  const shape = { origin: originOf(element), color };
  switch (geometry.localName) {
    case 'box': return { ...shape, kind: 'box', size: numbers(geometry.getAttribute('size'), [0, 0, 0]) };
    case 'sphere': return { ...shape, kind: 'sphere', size: [number('radius')] };
    case 'cylinder': return { ...shape, kind: 'cylinder', size: [number('radius'), number('length')] };
    case 'capsule': return { ...shape, kind: 'capsule', size: [number('radius'), number('length')] };
    case 'mesh': return { ...shape, kind: 'mesh', size: numbers(geometry.getAttribute('scale'), [1, 1, 1]), uri: geometry.getAttribute('filename') ?? '' };
    default: return null;
  }
}

/** @param {Element} material */
function colorOf(material) {
  const color = childOf(material, 'color');
  return color ? numbers(color.getAttribute('rgba'), GREY) : undefined;
}

/** @param {string} text @returns {Description} @throws {Error} in words, if it is no robot description */
export function parseUrdf(text) {
  // A declaration that is not at the start, or zero bytes at the end, are no XML, but other readers accept them.
  const start = text.indexOf('<?xml ');
  const xml = (start > 0 && !text.slice(0, start).includes('<robot') ? text.slice(start) : text).replace(/[\s\0]+$/, '');
  const root = new DOMParser().parseFromString(xml, 'text/xml').documentElement;
  if (root.localName !== 'robot') throw new Error('the robot description is no URDF: <robot> is missing, or the XML is damaged');
  /** @type {Map<string, number[]>} */
  const materials = new Map();
  for (const material of root.querySelectorAll('material')) {
    const color = colorOf(material);
    if (color) materials.set(material.getAttribute('name') ?? '', color);
  }
  const links = new Map(childrenOf(root, 'link').map((link) => {
    const shapes = (/** @type {string} */ name) =>
      childrenOf(link, name).map((element) => shapeOf(element, materials)).filter((shape) => shape !== null);
    return [link.getAttribute('name') ?? '', { visual: shapes('visual'), collision: shapes('collision') }];
  }));
  const joints = childrenOf(root, 'joint').map((joint) => {
    const [limit, mimic] = [childOf(joint, 'limit'), childOf(joint, 'mimic')];
    return {
      name: joint.getAttribute('name') ?? '',
      type: joint.getAttribute('type') ?? 'fixed',
      parent: childOf(joint, 'parent')?.getAttribute('link') ?? '',
      child: childOf(joint, 'child')?.getAttribute('link') ?? '',
      origin: originOf(joint),
      axis: unit(numbers(childOf(joint, 'axis')?.getAttribute('xyz'), [1, 0, 0])),
      lower: Number(limit?.getAttribute('lower') ?? -Math.PI),
      upper: Number(limit?.getAttribute('upper') ?? Math.PI),
      mimic: mimic
        ? { joint: mimic.getAttribute('joint') ?? '', factor: Number(mimic.getAttribute('multiplier') ?? 1), offset: Number(mimic.getAttribute('offset') ?? 0) }
        : undefined,
    };
  });
  const children = new Set(joints.map(({ child }) => child));
  const top = [...links.keys()].find((name) => !children.has(name));
  if (top === undefined) throw new Error('the robot description has no root link');
  return { name: root.getAttribute('name') ?? '', root: top, links, joints: inOrder(joints, top) };
}

/** Parents before children; joints that hang on nothing are left out. @param {Joint[]} joints @param {string} root */
function inOrder(joints, root) {
  /** @type {Joint[]} */
  const sorted = [];
  const reached = [root];
  const seen = new Set(reached);
  for (let i = 0; i < reached.length; i++) {
    for (const joint of joints) {
      if (joint.parent !== reached[i] || seen.has(joint.child)) continue;
      seen.add(joint.child);
      sorted.push(joint);
      reached.push(joint.child);
    }
  }
  return sorted;
}

/**
 * `root_from_link` of all links.
 * @param {Description} description @param {(joint: string) => number | undefined} positionOf @returns {Map<string, Pose>}
 */
export function forward(description, positionOf) {
  const poses = new Map([[description.root, identity()]]);
  for (const { name, type, parent, child, origin, axis, mimic } of description.joints) {
    const parentPose = poses.get(parent) ?? identity();
    const own = positionOf(name); // of a joint that mimics another, too: what was measured has precedence
    const position = own ?? (mimic ? (positionOf(mimic.joint) ?? 0) * mimic.factor + mimic.offset : 0);
    let local = origin;
    if (type === 'revolute' || type === 'continuous') local = { p: origin.p, q: multiply(origin.q, turn(axis, position)) };
    else if (type === 'prismatic') local = compose(origin, { p: axis.map((a) => a * position), q: [0, 0, 0, 1] });
    poses.set(child, compose(parentPose, local));
  }
  return poses;
}
