// @ts-check
// Pictures of a camera, with what was detected drawn over them.

import { empty, fitCanvas, h, iconButton, painter, rate, seriesColor } from '../panel.js';
import { words } from '../connection.js';
import { pixels } from './camera/pixels.js';
import { overlayOf } from './camera/overlays.js';

/** @typedef {{ topic: string, overlays: Record<string, boolean> }} Options */

const RAW = 'sensor_msgs/msg/Image';
const COMPRESSED = 'sensor_msgs/msg/CompressedImage';

/** @type {import('../panel.js').Panel} */
export default {
  id: 'camera',
  title: 'Camera',
  create(root, robot, view) {
    /** @type {Options} */
    const options = { topic: '', overlays: {}, ...view.get() };
    const canvas = h('canvas', { role: 'img', 'aria-label': 'Picture of the camera', 'data-testid': 'camera' });
    const facts = h('span', { class: 'glass mono', hidden: true, 'data-testid': 'camera-facts' });
    const problem = h('span', { class: 'glass', hidden: true });
    const stage = h('div', { class: 'stage' }, canvas, h('div', { class: 'hud' }, facts, problem));
    const chooser = h('select', { 'aria-label': 'Picture', onchange: () => { options.topic = chooser.value; view.set(options); follow(); } });
    const layers = iconButton('layers', 'Drawn over the picture', () => showOverlays(), { 'aria-haspopup': 'true' });
    view.header.append(chooser, layers);

    const ink = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
    /** @type {CanvasImageSource | null} */
    let picture = null;
    let [width, height] = [0, 0];
    /** @type {(() => void)[]} */
    let endings = [];
    /** @type {Map<string, import('./camera/overlays.js').Shape[]>} */
    const overlays = new Map();
    /** How many pictures had come, and when: more come than are drawn. @type {{ atMs: number, count: number }[]} */
    let arrivals = [];
    let isDecoding = false;
    let generation = 0;
    const buffer = document.createElement('canvas');
    /** @type {ImageData | null} */
    let frame = null;

    const paint = painter(draw);
    function draw() {
      const density = canvas.width / Math.max(1, canvas.clientWidth);
      ink.setTransform(1, 0, 0, 1, 0, 0);
      ink.clearRect(0, 0, canvas.width, canvas.height);
      if (!picture || !width || !height) return;
      const zoom = Math.min(canvas.width / width, canvas.height / height);
      ink.imageSmoothingEnabled = zoom < 3;
      ink.setTransform(zoom, 0, 0, zoom, (canvas.width - width * zoom) / 2, (canvas.height - height * zoom) / 2);
      ink.drawImage(picture, 0, 0);
      let index = 0;
      for (const [topic, shapes] of overlays) {
        if (options.overlays[topic] === false) continue;
        const color = seriesColor(index++ + 1);
        for (const shape of shapes) drawShape(ink, shape, color, density / zoom);
      }
    }

    /** @param {any} message @param {string} topic */
    function takeRaw(message, topic) {
      try {
        if (!frame || frame.width !== message.width || frame.height !== message.height) {
          if (message.width * message.height > 64e6 || message.width === 0 || message.height === 0) throw new Error(`a picture of ${message.width} × ${message.height} is not shown`);
          frame = new ImageData(message.width, message.height);
          [buffer.width, buffer.height] = [message.width, message.height];
        }
        pixels(message, new Uint32Array(frame.data.buffer));
        /** @type {CanvasRenderingContext2D} */ (buffer.getContext('2d')).putImageData(frame, 0, 0);
        show(buffer, message.width, message.height, message.encoding);
      } catch (error) { fail(topic, error); }
    }

    /** @param {any} message @param {string} topic */
    async function takeCompressed(message, topic) {
      // The browser decodes beside us; while it is busy, pictures are left out.
      if (isDecoding) return;
      isDecoding = true;
      const mine = generation;
      try {
        const bitmap = await createImageBitmap(new Blob([message.data.slice()]));
        if (mine !== generation) { bitmap.close(); return; }
        if (picture instanceof ImageBitmap) picture.close();
        show(bitmap, bitmap.width, bitmap.height, /png/i.test(message.format) ? 'png' : 'jpeg');
      } catch { fail(topic, new Error(`the browser cannot decode "${message.format}"`)); } finally { isDecoding = false; }
    }

    /** @param {CanvasImageSource} source @param {number} w @param {number} h_ @param {string} encoding */
    function show(source, w, h_, encoding) {
      const now = performance.now();
      [picture, width, height] = [source, w, h_];
      arrivals.push({ atMs: now, count: robot.feeds.get(options.topic)?.count ?? 0 });
      while (arrivals.length > 200 || arrivals[0].atMs < now - 2000) arrivals.shift();
      const [{ atMs, count }] = arrivals;
      const hz = now > atMs + 200 ? ((arrivals[arrivals.length - 1].count - count) * 1000) / (now - atMs) : 0;
      const text = `${w} × ${h_}  ${encoding}  ${rate(hz)} Hz`;
      if (facts.textContent !== text) facts.textContent = text;
      facts.hidden = false;
      problem.hidden = true;
      paint.request();
    }

    /** @param {string} topic @param {unknown} error */
    function fail(topic, error) { problem.textContent = `${topic}: ${words(error)}`; problem.hidden = false; }

    const topics = () => robot.topicsOf(RAW, COMPRESSED);
    function offer() {
      const found = topics();
      chooser.replaceChildren(...found.map((topic) => h('option', { value: topic, selected: topic === options.topic }, topic)));
      chooser.hidden = found.length < 2;
      const [first] = found;
      const isMissing = first === undefined;
      if (isMissing !== (stage.parentElement === null)) root.replaceChildren(isMissing ? empty('No camera here.', 'No topic carries sensor_msgs/Image or CompressedImage.') : stage);
      if (!found.includes(options.topic) && first !== undefined) { options.topic = first; follow(); }
      else followOverlays();
    }

    function follow() {
      endings.forEach((end) => end());
      endings = [];
      generation++;
      [picture, arrivals] = [null, []];
      facts.hidden = problem.hidden = true;
      chooser.value = options.topic;
      view.setTitle(chooser.hidden ? options.topic : '');
      const { topic } = options;
      const isRaw = robot.channels.get(topic)?.schemaName === RAW;
      endings.push(robot.subscribe(topic, (message) => (isRaw ? takeRaw(message, topic) : takeCompressed(message, topic)), { latest: true }));
      followOverlays();
      paint.request();
    }

    /** @type {Map<string, () => void>} */
    const followed = new Map();
    function followOverlays() {
      for (const { topic, schemaName } of robot.channels.values()) {
        const reader = overlayOf(schemaName);
        if (!reader || followed.has(topic) || options.overlays[topic] === false) continue;
        followed.set(topic, robot.subscribe(topic, (message) => {
          const shapes = reader(message, width, height);
          if (schemaName.endsWith('ImageMarker') && overlays.has(topic)) overlays.set(topic, [...(overlays.get(topic) ?? []), ...shapes].slice(-200));
          else overlays.set(topic, shapes);
          paint.request();
        }, { latest: true }));
      }
      layers.hidden = ![...robot.channels.values()].some(({ schemaName }) => overlayOf(schemaName));
    }

    function showOverlays() {
      const found = [...robot.channels.values()].filter(({ schemaName }) => overlayOf(schemaName)).map(({ topic }) => topic);
      const menu = h('div', { class: 'menu', popover: 'auto', role: 'group', 'aria-label': 'Drawn over the picture' }, found.map((topic) => h('label', null,
        h('input', { type: 'checkbox', checked: options.overlays[topic] !== false, onchange: (/** @type {any} */ event) => {
          options.overlays[topic] = event.target.checked;
          if (!event.target.checked) { followed.get(topic)?.(); followed.delete(topic); overlays.delete(topic); }
          view.set(options);
          followOverlays();
          paint.request();
        } }), topic)));
      menu.addEventListener('toggle', (event) => { if (/** @type {ToggleEvent} */ (event).newState === 'closed') menu.remove(); });
      document.body.append(menu);
      menu.showPopover();
      const [box, size] = [layers.getBoundingClientRect(), menu.getBoundingClientRect()];
      menu.style.left = `${Math.max(8, box.right - size.width)}px`;
      menu.style.top = `${box.bottom + 4}px`;
    }

    const endFit = fitCanvas(canvas, () => paint.request());
    robot.addEventListener('channels', offer);
    root.append(stage);
    offer();
    if (options.topic && endings.length === 0) follow();
    return {
      destroy() { generation++; paint.stop(); endFit(); },
      seeked() { overlays.clear(); arrivals = []; paint.request(); },
    };
  },
};

/** @param {CanvasRenderingContext2D} ink @param {import('./camera/overlays.js').Shape} shape @param {string} color @param {number} pixel */
function drawShape(ink, shape, color, pixel) {
  ink.strokeStyle = ink.fillStyle = shape.color ?? color;
  ink.lineWidth = 2 * pixel;
  const [x, y] = shape.points[0] ?? [0, 0];
  ink.beginPath();
  if (shape.kind === 'circle') ink.arc(x, y, Math.max(shape.radius ?? 0, 2 * pixel), 0, 2 * Math.PI);
  else {
    shape.points.forEach(([px, py], i) => (i === 0 ? ink.moveTo(px, py) : ink.lineTo(px, py)));
    if (shape.kind === 'polygon') ink.closePath();
  }
  if (shape.kind === 'points') {
    for (const [px, py] of shape.points) ink.fillRect(px - 2 * pixel, py - 2 * pixel, 4 * pixel, 4 * pixel);
  } else if (shape.kind !== 'text') ink.stroke();
  if (!shape.text) return;
  ink.font = `${12 * pixel}px system-ui, sans-serif`;
  const size = ink.measureText(shape.text);
  const [left, base] = [Math.min(...shape.points.map(([px]) => px)) - (shape.kind === 'circle' ? (shape.radius ?? 0) : 0), Math.min(...shape.points.map(([, py]) => py)) - (shape.kind === 'circle' ? (shape.radius ?? 0) : 0)];
  ink.fillRect(left - pixel, base - 17 * pixel, size.width + 8 * pixel, 16 * pixel);
  ink.fillStyle = '#000';
  ink.fillText(shape.text, left + 3 * pixel, base - 5 * pixel);
}
