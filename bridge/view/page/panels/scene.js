// @ts-check
// The robot in 3D: URDF and joint states, frames, trails, markers, and the simulated world.

import { rgb, surroundings } from './scene/colors.js';
import { Markers } from './scene/markers.js';
import { add, compose, identity, matrix, poseOf, product, project, rotate, sub, turn } from './scene/math.js';
import { Orbit } from './scene/orbit.js';
import { Shapes, UNITS, standing } from './scene/shapes.js';
import { Transforms, plain } from './scene/transforms.js';
import { forward, parseUrdf } from './scene/urdf.js';
import { Renderer } from './scene/webgl.js';
import { empty, fitCanvas, h, iconButton, onTheme, painter, token } from '../panel.js';
import { words } from '../connection.js';

/**
 * @typedef {import('./scene/math.js').Pose} Pose
 * @typedef {{ frame: string, follow: boolean, robot: boolean, collision: boolean, frames: boolean, names: boolean, trail: boolean, grid: boolean,
 *   world: boolean, field: 'auto' | 'on' | 'off', camera?: { azimuth: number, elevation: number, distance: number, target: number[] } }} Options
 */

/** @type {Options} */
const DEFAULTS = { frame: '', follow: true, robot: true, collision: false, frames: false, names: false, trail: true, grid: true, world: true, field: 'auto' };
const BALL = { radius: 0.05, color: [0.92, 0.38, 0.1, 1] };
/** As `world.field` of the simulator has it by default (docs/physics.md). */
const FIELD = { length: 9, width: 6, line: 0.05, mark: 1.8, circle: 1.5, area: [0.6, 3.45], goal: 2.25, height: 1.1 };
const POST = { radius: 0.05, color: [0.9, 0.82, 0.14, 1] };
const TRAIL_POINTS = 3000;
const TRAIL_STEP = 0.004;
/** Pictures for new data; the hand on the camera gets all that the screen has. */
const DATA_PERIOD_MS = 30;

/** @type {import('../panel.js').Panel} */
export default {
  id: 'scene',
  title: '3D',
  create(root, robot, view) {
    /** @type {Options} */
    const options = { ...DEFAULTS, ...view.get() };
    const canvas = h('canvas', { tabIndex: 0, role: 'application', 'aria-label': 'The robot in 3D. Arrow keys turn, plus and minus zoom, F follows the robot, R looks from the start.', 'data-testid': 'scene' });
    const over = h('canvas', { class: 'over', 'aria-hidden': 'true' });
    const problem = h('span', { class: 'glass', hidden: true });
    const place = h('span', { class: 'glass mono', hidden: true, 'data-testid': 'scene-place' });
    const stage = h('div', { class: 'stage' }, canvas, over, h('div', { class: 'hud' }, place, problem));
    root.append(stage);
    const ink = /** @type {CanvasRenderingContext2D} */ (over.getContext('2d'));

    /** @type {Renderer} */
    let renderer;
    try { renderer = new Renderer(canvas); } catch (error) { root.replaceChildren(empty('No 3D here.', words(error))); return { destroy() {} }; }

    const transforms = new Transforms();
    const markers = new Markers();
    /** @type {import('./scene/urdf.js').Description | null} */
    let description = null;
    let descriptionText = '';
    /** @type {Map<string, number>} */
    const positions = new Map();
    /** @type {Map<string, { pose: Pose, frame: string, isBall: boolean }>} */
    const entities = new Map();
    const shapes = new Shapes(robot, () => changed(), (text) => tell(text));
    /** @type {number[][]} */
    let trail = [];
    /** @type {number[] | null} Where the robot was in the last picture. */
    let lastBase = null;
    let lastDrawnMs = 0;
    let isDirty = true;

    const orbit = new Orbit(canvas, () => { isDirty = true; paint.request(); keepCamera(); });
    if (options.camera) Object.assign(orbit, options.camera);
    const save = () => view.set(options);
    let keepTimer = 0;
    const keepCamera = () => {
      clearTimeout(keepTimer);
      const { azimuth, elevation, distance, target } = orbit;
      keepTimer = window.setTimeout(() => { options.camera = { azimuth, elevation, distance, target: target.map((v) => Math.round(v * 1e3) / 1e3) }; save(); }, 800);
    };
    orbit.onPan = () => { if (options.follow) setFollow(false); };

    // ---- controls

    const followButton = iconButton('follow', 'Follow the robot', () => setFollow(!options.follow), { 'aria-pressed': String(options.follow), 'data-testid': 'scene-follow' });
    const homeButton = iconButton('home', 'Look from the start', () => home());
    const layersButton = iconButton('layers', 'What is shown', () => showLayers(), { 'aria-haspopup': 'true', 'data-testid': 'scene-layers' });
    view.header.append(followButton, homeButton, layersButton);
    /** @param {boolean} follow */
    function setFollow(follow) {
      options.follow = follow;
      followButton.setAttribute('aria-pressed', String(follow));
      lastBase = null;
      save();
      changed();
    }
    function home() {
      orbit.home();
      lastBase = null;
      setFollow(true);
      keepCamera();
    }
    canvas.addEventListener('keydown', (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key === 'f') setFollow(!options.follow);
      else if (event.key === 'r') home();
      else if (!orbit.key(event)) return;
      event.preventDefault();
      event.stopPropagation();
    });
    function showLayers() {
      const check = (/** @type {keyof Options} */ key, /** @type {string} */ text) => h('label', null,
        h('input', { type: 'checkbox', checked: Boolean(options[key]), onchange: (/** @type {any} */ event) => { /** @type {any} */ (options)[key] = event.target.checked; save(); changed(); } }), text);
      const frames = h('select', { 'aria-label': 'Fixed frame', onchange: () => { options.frame = frames.value; trail = []; lastBase = null; save(); changed(); } },
        h('option', { value: '' }, 'Fixed frame: by itself'), transforms.names().map((name) => h('option', { value: name, selected: name === options.frame }, name)));
      const field = h('label', null, h('input', { type: 'checkbox', checked: showsField(), onchange: (/** @type {any} */ event) => { options.field = event.target.checked ? 'on' : 'off'; save(); changed(); } }), 'Football field');
      const menu = h('div', { class: 'menu', popover: 'auto', role: 'group', 'aria-label': 'What is shown' },
        check('robot', 'Robot'), check('collision', 'Collision shapes'), check('frames', 'Frames'), check('names', 'Names of frames'), check('trail', 'Trail'),
        check('world', 'World and markers'), check('grid', 'Grid'), field, h('hr'), frames);
      menu.addEventListener('toggle', (event) => { if (/** @type {ToggleEvent} */ (event).newState === 'closed') menu.remove(); });
      document.body.append(menu);
      menu.showPopover();
      const [anchor, size] = [layersButton.getBoundingClientRect(), menu.getBoundingClientRect()];
      menu.style.left = `${Math.max(8, Math.min(anchor.right - size.width, innerWidth - size.width - 8))}px`;
      menu.style.top = `${Math.min(anchor.bottom + 4, innerHeight - size.height - 8)}px`;
      menu.querySelector('input')?.focus();
    }

    // ---- data

    const changed = () => { isDirty = true; paint.request(); };
    robot.subscribe('/tf', (message, time) => { transforms.take(message, time); changed(); });
    robot.subscribe('/tf_static', (message, time) => { transforms.take(message, time, true); changed(); });
    robot.subscribe('/robot_description', ({ data }) => {
      if (data === descriptionText) return;
      descriptionText = data;
      try { description = parseUrdf(data); problem.hidden = true; } catch (error) { description = null; tell(words(error)); }
      shapes.clear();
      changed();
    }, { latest: true });
    robot.subscribe('/joint_states', ({ name, position }) => {
      for (let i = 0; i < name.length; i++) if (Number.isFinite(position[i])) positions.set(name[i], position[i]);
      changed();
    });
    /** @param {string} text */
    function tell(text) { problem.textContent = text; problem.hidden = false; }

    /** Topics of these types are shown wherever they are. @type {Set<string>} */
    const watched = new Set();
    function watch() {
      for (const { topic, schemaName } of robot.channels.values()) {
        if (watched.has(topic)) continue;
        const isTruth = /(^|\/)ground_truth\//.test(topic);
        if (schemaName === 'visualization_msgs/msg/MarkerArray') robot.subscribe(topic, (message) => { for (const marker of message.markers) markers.take(topic, marker); changed(); });
        else if (schemaName === 'visualization_msgs/msg/Marker') robot.subscribe(topic, (marker) => { markers.take(topic, marker); changed(); });
        else if (isTruth && schemaName === 'nav_msgs/msg/Odometry') {
          robot.subscribe(topic, ({ header, child_frame_id: child, pose }, time) => {
            transforms.join(plain(header.frame_id), plain(child), poseOf(pose.pose), time);
            changed();
          }, { latest: true });
        } else if (isTruth && schemaName === 'geometry_msgs/msg/PoseStamped') {
          robot.subscribe(topic, ({ header, pose }) => { entities.set(topic, { pose: poseOf(pose), frame: plain(header.frame_id), isBall: /ball/i.test(topic) }); changed(); }, { latest: true });
        } else continue;
        watched.add(topic);
      }
    }
    watch();
    robot.addEventListener('channels', watch);

    // ---- pictures

    function showsField() {
      if (options.field !== 'auto') return options.field === 'on';
      return [...robot.parameters.values()].some(({ name, value }) => name.endsWith('.world') && /field/i.test(String(value))) || [...entities.values()].some(({ isBall }) => isBall);
    }

    /** The frame in which everything is shown. */
    function fixedFrame() {
      if (options.frame) return options.frame;
      return transforms.root(description?.root ?? transforms.frames.keys().next().value ?? '')[0];
    }

    const paint = painter((now) => {
      if (!isDirty) return;
      if (renderer.isBusy() || (!orbit.isHeld && now - lastDrawnMs < Math.max(DATA_PERIOD_MS, renderer.tookMs * 2))) { paint.request(); return; }
      adapt();
      resize(quality);
      lastDrawnMs = now;
      isDirty = false;
      draw();
    });

    let trailFrame = '';
    function draw() {
      const fixed = fixedFrame();
      // Places in another frame are another way: at the start the frames arrive one by one.
      if (fixed !== trailFrame) { trail = []; lastBase = null; trailFrame = fixed; }
      /** @type {import('./scene/markers.js').Drawn} */
      const drawn = { items: [], lines: [], points: [], texts: [] };
      const placeOf = (/** @type {string} */ frame) => (plain(frame) === fixed ? identity() : transforms.lookup(fixed, frame));
      const links = description ? forward(description, (joint) => positions.get(joint)) : new Map();
      /** @type {Pose | null} */
      let base = null;
      if (description) {
        const hasPlace = transforms.names().includes(description.root) && transforms.root(description.root)[0] !== description.root;
        base = (hasPlace && placeOf(description.root)) || standing(description, links);
      }
      const worldOf = (/** @type {string} */ link) => compose(/** @type {Pose} */ (base), links.get(link) ?? identity());
      if (description && base) {
        for (const [name, { visual, collision }] of description.links) {
          const pose = worldOf(name);
          if (options.robot) for (const shape of visual) { const item = shapes.item(shape, pose, shape.color); if (item) drawn.items.push(item); }
          if (options.collision) for (const shape of collision) { const item = shapes.item(shape, pose, [0.25, 0.75, 1, 0.35]); if (item) drawn.items.push(item); }
        }
        // The way on the ground, under the robot.
        const at = [base.p[0], base.p[1], 0.004];
        const last = trail[trail.length - 1];
        if (!last || Math.hypot(...sub(at, last)) > TRAIL_STEP) {
          if (last && Math.hypot(...sub(at, last)) > 0.5) trail = [];
          trail.push(at);
          if (trail.length > TRAIL_POINTS) trail.splice(0, TRAIL_POINTS / 4);
        }
        if (options.follow) {
          orbit.target = lastBase ? add(orbit.target, [base.p[0] - lastBase[0], base.p[1] - lastBase[1], 0]) : [base.p[0], base.p[1], Math.max(0.1, base.p[2])];
          lastBase = base.p;
        }
        const yaw = Math.atan2(2 * (base.q[3] * base.q[2] + base.q[0] * base.q[1]), 1 - 2 * (base.q[1] ** 2 + base.q[2] ** 2));
        place.hidden = !fixed;
        place.textContent = `${fixed}  x ${base.p[0].toFixed(2)}  y ${base.p[1].toFixed(2)} m  ${((yaw * 180) / Math.PI).toFixed(0)}°`.replaceAll('-', '−');
      }
      if (options.trail) {
        const color = rgb('--accent');
        for (let i = 1; i < trail.length; i++) drawn.lines.push(...trail[i - 1], ...trail[i], ...color, 0.25 + (0.7 * i) / trail.length, 2.5);
      }
      if (options.world) {
        for (const { pose, frame, isBall } of entities.values()) {
          const parent = placeOf(frame);
          if (!parent) continue;
          const at = compose(parent, pose);
          if (isBall) drawn.items.push({ mesh: UNITS.sphere, model: matrix(at, [BALL.radius, BALL.radius, BALL.radius]), color: BALL.color });
          else axes(at, 0.15, drawn.lines);
        }
        markers.draw(placeOf, drawn);
      }
      const field = options.world && showsField() ? FIELD : null;
      if (field) goals(field, drawn.items);
      if (options.frames || options.names) {
        const size = Math.min(0.12, orbit.distance * 0.045);
        for (const name of transforms.names()) {
          const pose = links.has(name) && base ? worldOf(name) : placeOf(name);
          if (!pose) continue;
          if (options.frames) axes(pose, size, drawn.lines);
          if (options.names) drawn.texts.push({ at: pose.p, text: name, color: [] });
        }
      }
      const camera = orbit.camera();
      renderer.draw(camera, surroundings(), { ...drawn, field, hasGrid: options.grid, reach: Math.max(8, orbit.distance * 7) });
      write(product(camera.projection, camera.view), drawn.texts);
    }

    let hasTexts = false;
    /** @param {Float32Array} both @param {import('./scene/markers.js').Drawn['texts']} texts */
    function write(both, texts) {
      if (!hasTexts && texts.length === 0) return;
      hasTexts = texts.length > 0;
      const density = over.width / Math.max(1, over.clientWidth);
      ink.setTransform(density, 0, 0, density, 0, 0);
      ink.clearRect(0, 0, over.clientWidth, over.clientHeight);
      ink.font = '11px system-ui, sans-serif';
      const [plainColor, halo] = [token('--text'), token('--surface')];
      for (const { at, text, color } of texts.slice(0, 500)) {
        const found = project(both, at);
        if (!found) continue;
        const [x, y] = [((found[0] + 1) / 2) * over.clientWidth + 6, ((1 - found[1]) / 2) * over.clientHeight - 4];
        ink.lineWidth = 3;
        ink.strokeStyle = halo;
        ink.strokeText(text, x, y);
        ink.fillStyle = color.length ? `rgb(${color.slice(0, 3).map((part) => Math.round(part * 255)).join(' ')})` : plainColor;
        ink.fillText(text, x, y);
      }
    }

    /** The share of the screen's resolution: a slow graphics card, or none, draws fewer pixels while things move. */
    let quality = 1;
    let restTimer = 0;
    function adapt() {
      const wanted = renderer.tookMs > 70 ? Math.max(0.5, quality * 0.8) : renderer.tookMs < 14 ? Math.min(1, quality * 1.25) : quality;
      if (wanted !== quality) renderer.tookMs = 30;
      quality = wanted;
      clearTimeout(restTimer);
      if (quality < 1) restTimer = window.setTimeout(() => { resize(1); draw(); }, 350);
    }
    /** @param {number} share */
    function resize(share) {
      const density = Math.min(window.devicePixelRatio || 1, 2) * share;
      const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((length) => Math.max(1, Math.round(length * density)));
      if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    }
    const sizes = new ResizeObserver(changed);
    sizes.observe(canvas);
    const endFit = fitCanvas(over, changed);
    const endTheme = onTheme(changed);
    canvas.addEventListener('webglcontextlost', (event) => event.preventDefault());
    canvas.addEventListener('webglcontextrestored', () => { renderer = new Renderer(canvas); changed(); });
    return {
      destroy() {
        paint.stop();
        clearTimeout(keepTimer);
        clearTimeout(restTimer);
        sizes.disconnect();
        endFit();
        endTheme();
        renderer.destroy();
      },
      seeked() {
        // Transforms and markers of another time may be gone by now; latched ones come again.
        for (const [child, { isStatic }] of transforms.frames) if (!isStatic) transforms.frames.delete(child);
        markers.clear();
        entities.clear();
        trail = [];
        lastBase = null;
        changed();
      },
    };
  },
};

/** @param {Pose} pose @param {number} size @param {number[]} lines */
function axes(pose, size, lines) {
  [[0.95, 0.3, 0.3], [0.3, 0.8, 0.4], [0.35, 0.55, 1]].forEach((color, axis) => {
    const end = [0, 0, 0];
    end[axis] = size;
    lines.push(...pose.p, ...add(pose.p, rotate(pose.q, end)), ...color, 1, 2);
  });
}

/** @param {typeof FIELD} field @param {import('./scene/webgl.js').Item[]} items */
function goals({ length, goal, height }, items) {
  const { radius, color } = POST;
  for (const end of [-1, 1]) {
    const x = (end * length) / 2;
    for (const side of [-1, 1]) {
      const y = side * (goal / 2 + radius);
      items.push({ mesh: UNITS.cylinder, model: matrix({ p: [x, y, height / 2], q: [0, 0, 0, 1] }, [radius, radius, height]), color });
    }
    items.push({ mesh: UNITS.cylinder, model: matrix({ p: [x, 0, height], q: turn([1, 0, 0], Math.PI / 2) }, [radius, radius, goal + 4 * radius]), color });
  }
}
