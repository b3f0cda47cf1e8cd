// @ts-check
// A robot in 3D in a pose that is given, not measured.

import { surroundings } from './colors.js';
import { compose, identity } from './math.js';
import { Orbit } from './orbit.js';
import { Shapes, standing } from './shapes.js';
import { forward, parseUrdf } from './urdf.js';
import { Renderer } from './webgl.js';
import { fitCanvas, h, onTheme, painter } from '../../panel.js';
import { words } from '../../connection.js';

/** From which the whole robot is seen, in m. */
const CLOSE = 1;

export class PoseView {
  /**
   * @param {import('../../panel.js').PanelRobot} robot @param {string} label for screen readers
   * @param {(problem: string) => void} tell called when something cannot be shown
   */
  constructor(robot, label, tell) {
    this.element = h('canvas', { tabIndex: 0, role: 'application', 'aria-label': label });
    /** @type {import('./urdf.js').Description | null} */
    this.description = null;
    /** @type {(joint: string) => number | undefined} */
    this.positionOf = () => undefined;
    this.tell = tell;
    const paint = painter(() => this.draw());
    this.request = () => paint.request();
    this.shapes = new Shapes(robot, this.request, tell);
    this.orbit = new Orbit(this.element, this.request);
    this.orbit.distance = CLOSE;
    this.element.addEventListener('keydown', (event) => {
      if (!event.ctrlKey && !event.metaKey && !event.altKey && this.orbit.key(event)) event.preventDefault();
    });
    /** @type {Renderer | null} */
    this.renderer = null;
    try { this.renderer = new Renderer(this.element); } catch (error) { tell(words(error)); }
    this.ends = [fitCanvas(this.element, this.request), onTheme(this.request), () => paint.stop(), () => this.renderer?.destroy()];
    robot.subscribe('/robot_description', ({ data }) => {
      try { this.description = parseUrdf(data); } catch (error) { tell(words(error)); }
      this.request();
    }, { latest: true });
  }

  /** @param {(joint: string) => number | undefined} positionOf */
  show(positionOf) {
    this.positionOf = positionOf;
    this.request();
  }

  draw() {
    if (!this.renderer) return;
    /** @type {import('./webgl.js').Item[]} */
    const items = [];
    if (this.description) {
      const links = forward(this.description, this.positionOf);
      const base = standing(this.description, links);
      for (const [name, { visual }] of this.description.links) {
        for (const shape of visual) {
          const item = this.shapes.item(shape, compose(base, links.get(name) ?? identity()), shape.color);
          if (item) items.push(item);
        }
      }
    }
    this.renderer.draw(this.orbit.camera(), surroundings(), { items, lines: [], points: [], field: null, hasGrid: true, reach: Math.max(8, this.orbit.distance * 7) });
  }

  destroy() { this.ends.forEach((end) => end()); }
}
