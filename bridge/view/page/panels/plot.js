// @ts-check
// Numeric fields over time: of a running robot as they come, of a bag over its whole length.

import { getter, isNumeric, isPrimitive, numericPaths } from '../cdr.js';
import { clock, duration, fitCanvas, h, iconButton, number, onTheme, painter, seriesColor, setText, token } from '../panel.js';
import { words } from '../connection.js';
import { Series, ticks } from './plot/series.js';

/**
 * @typedef {{ topic: string, path: string, label: string, color: number }} Chosen  a field that is shown, as it is stored
 * @typedef {Chosen & { series: Series, read: (message: any) => number, isHidden: boolean, chip: ReturnType<typeof chipOf> }} Line
 * @typedef {{ lines: Chosen[] | null, window: number }} Options
 */

const WINDOWS = [5, 10, 30, 60, 120, 300];
const MOST_LINES = 40;
const PERIOD_MS = 28;
const DENSE = 10_000;
const BAG_POINTS = 6000;
const LEFT = 52;
const BOTTOM = 22;

/** @type {import('../panel.js').Panel} */
export default {
  id: 'plot',
  title: 'Plot',
  create(root, robot, view) {
    /** @type {Options} */
    const options = { lines: null, window: 10, ...view.get() };
    /** @type {Line[]} */
    let lines = [];
    /** @type {Map<string, () => void>} */
    const followed = new Map();
    /** Times are in seconds since this. @type {bigint | null} */
    let origin = null;
    let newest = 0;
    /** What is looked at: nothing for the newest seconds. @type {{ from: number, to: number } | null} */
    let looked = null;
    /** @type {{ low: number, high: number } | null} */
    let fixedRange = null;
    /** @type {number | null} The time under the pointer. */
    let cursor = null;
    let isDirty = true;
    let lastMs = 0;
    let shownRange = { low: -1, high: 1 };

    const canvas = h('canvas', { tabIndex: 0, role: 'img', 'aria-label': 'Plot. Arrow keys move in time, plus and minus zoom, End shows the newest.', 'data-testid': 'plot' });
    const legend = h('div', { class: 'legend', 'data-testid': 'plot-legend' });
    const hint = h('span', { class: 'glass', hidden: true });
    root.append(legend, h('div', { class: 'stage' }, canvas, h('div', { class: 'hud top-left' }, hint)));
    const ink = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
    const pause = iconButton('pause', 'Hold the picture', () => (looked ? live() : hold()), { 'aria-pressed': 'false', 'data-testid': 'plot-pause' });
    const span = h('select', { 'aria-label': 'Seconds shown', onchange: () => { options.window = Number(span.value); view.set(options); live(); } },
      WINDOWS.map((seconds) => h('option', { value: String(seconds), selected: seconds === options.window }, seconds < 60 ? `${seconds} s` : `${seconds / 60} min`)));
    const add = iconButton('plus', 'Choose fields', () => pick(), { 'data-testid': 'plot-fields' });
    span.hidden = Boolean(robot.playback);
    view.header.append(span, pause, add);

    const bag = () => robot.playback;
    const bagLength = () => { const { playback } = robot; return playback ? Number(playback.endNs - playback.startNs) / 1e9 : 0; };
    /** @param {bigint} timeNs */
    const seconds = (timeNs) => { origin ??= robot.playback?.startNs ?? timeNs; return Number(timeNs - origin) / 1e9; };
    const changed = () => { isDirty = true; paint.request(); };
    const paint = painter((now) => {
      if (!isDirty) return;
      if (now - lastMs < PERIOD_MS) { paint.request(); return; }
      lastMs = now;
      isDirty = false;
      draw();
    });

    // ---- lines

    /** @param {Chosen} chosen */
    function addLine(chosen) {
      if (lines.length >= MOST_LINES || lines.some(({ topic, path }) => topic === chosen.topic && path === chosen.path)) return;
      const chip = chipOf(chosen, () => removeLine(line), () => { line.isHidden = !line.isHidden; chip.element.style.opacity = line.isHidden ? '0.45' : ''; changed(); });
      /** @type {Line} */
      const line = { ...chosen, series: new Series(), read: getter(chosen.path), isHidden: false, chip };
      lines.push(line);
      legend.append(chip.element);
      follow(chosen.topic);
      changed();
    }
    /** @param {Line} line */
    function removeLine(line) {
      lines = lines.filter((other) => other !== line);
      line.chip.element.remove();
      if (!lines.some(({ topic }) => topic === line.topic)) { followed.get(line.topic)?.(); followed.delete(line.topic); }
      keep();
      changed();
    }
    const keep = () => { options.lines = lines.map(({ topic, path, label, color }) => ({ topic, path, label, color })); view.set(options); };

    /** @param {string} topic */
    function follow(topic) {
      if (bag()) { askSeries(topic); return; }
      if (followed.has(topic)) return;
      followed.set(topic, robot.subscribe(topic, (message, timeNs) => {
        const time = seconds(timeNs);
        newest = time < newest - 1 ? time : Math.max(newest, time);
        for (const line of lines) if (line.topic === topic) line.series.push(time, line.read(message));
        changed();
      }));
    }

    /** The whole bag at once, decimated where it is read. @param {string} topic */
    async function askSeries(topic) {
      await Promise.resolve();
      const missing = lines.filter((line) => line.topic === topic && line.series.length === 0);
      if (missing.length === 0) return;
      try {
        const { fields } = await robot.ask('series', { topic, fields: missing.map(({ path }) => path), points: BAG_POINTS });
        const start = Number(robot.playback?.startNs ?? 0n) / 1e9;
        missing.forEach(({ series }, i) => {
          series.clear();
          // Since the bag's start, or since 1970.
          const offset = fields[i].t[0] > 1e8 ? start : 0;
          fields[i].t.forEach((/** @type {number} */ t, /** @type {number} */ k) => series.push(t - offset, fields[i].v[k] ?? NaN));
        });
        hint.hidden = true;
      } catch (error) { say(`${topic}: ${words(error)}`); }
      changed();
    }
    /** @param {string} text */
    function say(text) { hint.textContent = text; hint.hidden = !text; }

    /** Joints first, then whatever has numbers. */
    function chooseFirst() {
      const topic = ['/joint_states', '/odom', '/imu/data', '/imu/data_raw', '/cmd_vel'].find((name) => robot.channels.has(name));
      if (!topic) { say('Choose fields with the plus.'); return; }
      // A bag may have none before the time that is shown.
      if (bag()) say(`Waits for a message of ${topic}; go on in the bag, or choose fields with the plus.`);
      const end = robot.subscribe(topic, (message) => {
        end();
        if (lines.length > 0) return;
        const paths = topic === '/joint_states' ? jointPaths(message) : numericPaths(message).filter((path) => !/header|covariance/.test(path)).slice(0, 6);
        paths.forEach((path, color) => addLine({ topic, path, label: labelOf(message, topic, path), color }));
        say('');
      }, { latest: true });
    }

    // ---- picture

    function range() {
      if (looked) return looked;
      if (bag()) return { from: 0, to: Math.max(0.1, bagLength()) };
      return { from: newest - options.window, to: newest };
    }
    function hold() { looked = { ...range() }; showHeld(); changed(); }
    function live() { looked = null; fixedRange = null; showHeld(); changed(); }
    function showHeld() { pause.setAttribute('aria-pressed', String(looked !== null)); pause.title = looked ? 'Show the newest' : 'Hold the picture'; pause.setAttribute('aria-label', pause.title); }

    function draw() {
      const density = canvas.width / Math.max(1, canvas.clientWidth);
      const [width, height] = [canvas.clientWidth, canvas.clientHeight];
      const { from, to } = range();
      const shown = lines.filter(({ isHidden }) => !isHidden);
      let [low, high] = [Infinity, -Infinity];
      if (fixedRange) ({ low, high } = fixedRange);
      else {
        for (const { series } of shown) { const [a, b] = series.range(from, to); low = Math.min(low, a); high = Math.max(high, b); }
        if (!Number.isFinite(low) || !Number.isFinite(high)) [low, high] = [-1, 1];
        const margin = (high - low) * 0.06 || Math.abs(high) * 0.1 || 1;
        low -= margin;
        high += margin;
      }
      shownRange = { low, high };
      const [right, bottom] = [width - 8, height - BOTTOM];
      const x = (/** @type {number} */ time) => LEFT + ((time - from) / (to - from)) * (right - LEFT);
      const y = (/** @type {number} */ value) => bottom - ((value - low) / (high - low)) * (bottom - 6);
      ink.setTransform(density, 0, 0, density, 0, 0);
      ink.clearRect(0, 0, width, height);
      ink.font = '11px system-ui, sans-serif';
      ink.lineWidth = 1;
      ink.strokeStyle = token('--line');
      ink.fillStyle = token('--muted');
      ink.textAlign = 'right';
      ink.textBaseline = 'middle';
      const vertical = ticks(low, high, Math.max(2, height / 44));
      for (const at of vertical.at) {
        const place = Math.round(y(at)) + 0.5;
        ink.beginPath(); ink.moveTo(LEFT, place); ink.lineTo(right, place); ink.stroke();
        ink.fillText(tick(at, vertical.step), LEFT - 7, place);
      }
      ink.textAlign = 'center';
      ink.textBaseline = 'alphabetic';
      // The newest seconds are counted back from now, so that the marks stand still.
      const zero = looked || bag() ? 0 : to;
      const horizontal = ticks(from - zero, to - zero, Math.max(2, (right - LEFT) / 86));
      for (const at of horizontal.at) {
        const place = Math.round(x(at + zero)) + 0.5;
        ink.beginPath(); ink.moveTo(place, 6); ink.lineTo(place, bottom); ink.stroke();
        const text = bag() ? duration(Math.max(0, at)) : zero ? (Math.abs(at) < horizontal.step / 2 ? 'now' : `${tick(at, horizontal.step)} s`) : clock((origin ?? 0n) + BigInt(Math.round(at * 1e9)), horizontal.step < 1 ? 2 : 0);
        ink.fillText(text, Math.max(LEFT + 14, Math.min(right - 16, place)), height - 6);
      }
      ink.save();
      ink.beginPath();
      ink.rect(LEFT, 0, right - LEFT, bottom);
      ink.clip();
      // Lines one pixel of the screen wide are drawn many times faster, and dense ones look the same.
      const points = shown.reduce((sum, { series }) => sum + series.indexAt(to) - series.indexAt(from), 0);
      ink.lineWidth = points < DENSE ? 1.6 : 1 / density;
      ink.lineJoin = 'bevel';
      const columns = Math.max(1, Math.round(right - LEFT));
      for (const { series, color } of shown) {
        ink.strokeStyle = seriesColor(color);
        ink.beginPath();
        let isUp = true;
        series.visit(from, to, columns, (time, value) => {
          if (value !== value) { isUp = true; return; }
          if (isUp) ink.moveTo(x(time), y(value));
          else ink.lineTo(x(time), y(value));
          isUp = false;
        });
        ink.stroke();
      }
      const now = bag() ? seconds(robot.timeNs) : NaN;
      if (now >= from && now <= to) { ink.strokeStyle = token('--accent'); ink.lineWidth = 1.5; ink.beginPath(); ink.moveTo(x(now), 0); ink.lineTo(x(now), bottom); ink.stroke(); }
      if (cursor !== null && cursor >= from && cursor <= to) {
        ink.strokeStyle = token('--muted');
        ink.lineWidth = 1;
        ink.setLineDash([4, 3]);
        ink.beginPath(); ink.moveTo(x(cursor), 0); ink.lineTo(x(cursor), bottom); ink.stroke();
        ink.setLineDash([]);
        for (const { series, color } of shown) {
          const value = series.valueAt(cursor);
          if (Number.isNaN(value)) continue;
          ink.fillStyle = seriesColor(color);
          ink.beginPath(); ink.arc(x(cursor), y(value), 3.5, 0, 2 * Math.PI); ink.fill();
        }
      }
      ink.restore();
      const at = cursor ?? (bag() ? now : to);
      for (const { series, chip } of lines) setText(chip.value, number(series.valueAt(at)));
      view.setTitle(cursor !== null && origin !== null ? (bag() ? duration(cursor) : clock(origin + BigInt(Math.round(cursor * 1e9)))) : looked && !bag() ? 'held' : '');
    }

    // ---- hand

    /** @type {Map<number, { x: number, y: number }>} */
    const fingers = new Map();
    let hasMoved = false;
    const timeAt = (/** @type {number} */ px) => { const { from, to } = range(); return from + ((px - LEFT) / Math.max(1, canvas.clientWidth - 8 - LEFT)) * (to - from); };
    const place = (/** @type {PointerEvent | WheelEvent} */ event) => { const box = canvas.getBoundingClientRect(); return { x: event.clientX - box.left, y: event.clientY - box.top }; };
    /** @param {number} factor @param {number | null} [around] */
    function zoom(factor, around = null) {
      const { from, to } = range();
      const center = around ?? (looked || bag() ? (from + to) / 2 : to);
      const next = { from: center - (center - from) * factor, to: center + (to - center) * factor };
      if (next.to - next.from < 0.002 || next.to - next.from > 86_400) return;
      if (!looked && !bag()) { options.window = Math.max(0.05, Math.min(600, options.window * factor)); changed(); return; }
      looked = next;
      showHeld();
      changed();
    }
    /** @param {number} by in seconds */
    function shift(by) {
      const { from, to } = range();
      looked = { from: from + by, to: to + by };
      if (!bag() && looked.to > newest) { live(); return; }
      showHeld();
      changed();
    }
    canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      const factor = Math.exp((event.deltaY || event.deltaX) * (event.deltaMode === 1 ? 0.05 : 0.0015));
      const at = place(event);
      if (event.shiftKey || at.x < LEFT) {
        const { low, high } = shownRange;
        const center = high - ((at.y - 6) / Math.max(1, canvas.clientHeight - BOTTOM - 6)) * (high - low);
        fixedRange = { low: center - (center - low) * factor, high: center + (high - center) * factor };
        changed();
      } else zoom(factor, looked || bag() ? timeAt(at.x) : null);
    }, { passive: false });
    canvas.addEventListener('pointerdown', (event) => { canvas.setPointerCapture(event.pointerId); fingers.set(event.pointerId, place(event)); hasMoved = false; });
    canvas.addEventListener('pointermove', (event) => {
      const now = place(event);
      const before = fingers.get(event.pointerId);
      if (!before) { if (event.pointerType !== 'touch') { cursor = now.x >= LEFT ? timeAt(now.x) : null; changed(); } return; }
      if (Math.abs(now.x - before.x) + Math.abs(now.y - before.y) < 3 && !hasMoved) return;
      hasMoved = true;
      if (fingers.size === 1) shift(timeAt(before.x) - timeAt(now.x));
      else {
        const other = [...fingers].find(([id]) => id !== event.pointerId)?.[1];
        if (other) zoom(Math.abs(before.x - other.x) / Math.max(8, Math.abs(now.x - other.x)), timeAt(other.x));
      }
      fingers.set(event.pointerId, now);
    });
    canvas.addEventListener('pointerup', (event) => {
      const { playback } = robot;
      if (!hasMoved && fingers.size === 1) {
        const at = timeAt(place(event).x);
        // A tap shows the values there; in a bag it goes there.
        if (playback) robot.control({ seekNs: playback.startNs + BigInt(Math.max(0, Math.round(Math.min(at, bagLength()) * 1e9))) });
        else if (event.pointerType === 'touch') { if (!looked) hold(); cursor = at; }
        changed();
      }
      fingers.delete(event.pointerId);
    });
    canvas.addEventListener('pointercancel', (event) => fingers.delete(event.pointerId));
    canvas.addEventListener('pointerleave', (event) => { if (event.pointerType !== 'touch') { cursor = null; changed(); } });
    canvas.addEventListener('dblclick', live);
    canvas.addEventListener('keydown', (event) => {
      const { from, to } = range();
      const step = (to - from) / 10;
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key === 'ArrowLeft') shift(-step);
      else if (event.key === 'ArrowRight') shift(step);
      else if (event.key === '+' || event.key === '=') zoom(0.8);
      else if (event.key === '-') zoom(1.25);
      else if (event.key === 'End' || event.key === 'Home') live();
      else return;
      event.preventDefault();
      event.stopPropagation();
    });

    // ---- choosing fields

    function pick() {
      const list = h('div', { class: 'scroll tree' });
      const find = h('input', { type: 'search', placeholder: 'Topic or field', 'aria-label': 'Topic or field', oninput: () => offer() });
      const menu = h('div', { class: 'menu picker', popover: 'auto', role: 'dialog', 'aria-label': 'Fields of the plot', 'data-testid': 'plot-picker' }, find, list);
      /** @type {Map<string, { element: HTMLDetailsElement, fields: HTMLElement, paths: string[], message: any, end?: () => void }>} */
      const entries = new Map();
      for (const topic of [...robot.channels.keys()].sort()) {
        const fields = h('div', null);
        const element = h('details', null, h('summary', null, topic), fields);
        /** @type {{ element: HTMLDetailsElement, fields: HTMLElement, paths: string[], message: any, end?: () => void }} */
        const entry = { element, fields, paths: schemaPaths(robot, topic), message: null };
        entries.set(topic, entry);
        element.addEventListener('toggle', () => {
          if (!element.open || entry.end) return;
          showFields(topic, entry);
          entry.end = robot.subscribe(topic, (message) => {
            const paths = numericPaths(message, 200);
            entry.message = message;
            if (paths.join() !== entry.paths.join() || !fields.dataset.sampled) { entry.paths = paths; fields.dataset.sampled = ''; showFields(topic, entry); }
          }, { latest: true });
        });
      }
      /** @param {string} topic @param {{ fields: HTMLElement, paths: string[], message: any }} entry */
      function showFields(topic, { fields, paths, message }) {
        const text = find.value.toLowerCase();
        const named = paths.map((path) => [path, labelOf(message, topic, path, true)]);
        const wanted = topic.toLowerCase().includes(text) ? named : named.filter(([path, label]) => `${path} ${label}`.toLowerCase().includes(text));
        fields.replaceChildren(...wanted.slice(0, 300).map(([path, label]) => h('label', null, h('input', {
          type: 'checkbox', checked: lines.some((line) => line.topic === topic && line.path === path), onchange: (/** @type {any} */ event) => {
            const line = lines.find((other) => other.topic === topic && other.path === path);
            if (event.target.checked) addLine({ topic, path, label: labelOf(message, topic, path), color: freeColor() });
            else if (line) removeLine(line);
            keep();
            say('');
          } }), h('span', null, label), label === path ? null : h('span', { class: 'muted mono' }, path))));
      }
      function offer() {
        const text = find.value.toLowerCase();
        const shown = [...entries].filter(([topic, { paths, message }]) => paths.length > 0 && (topic.toLowerCase().includes(text) || paths.some((path) => labelOf(message, topic, path).toLowerCase().includes(text))));
        list.replaceChildren(...shown.map(([, { element }]) => element));
        for (const [topic, entry] of shown) if (entry.element.open) showFields(topic, entry);
      }
      offer();
      menu.addEventListener('toggle', (event) => { if (/** @type {ToggleEvent} */ (event).newState === 'closed') { for (const { end } of entries.values()) end?.(); menu.remove(); add.focus({ preventScroll: true }); } });
      document.body.append(menu);
      menu.showPopover();
      const box = add.getBoundingClientRect();
      menu.style.left = `${Math.max(8, Math.min(box.right - menu.offsetWidth, innerWidth - menu.offsetWidth - 8))}px`;
      menu.style.top = `${Math.max(8, Math.min(box.bottom + 4, innerHeight - menu.offsetHeight - 8))}px`;
      find.focus();
    }
    function freeColor() {
      for (let color = 0; color < 10; color++) if (!lines.some((line) => line.color === color)) return color;
      return lines.length;
    }

    const endFit = fitCanvas(canvas, changed);
    const endTheme = onTheme(() => { for (const { chip, color } of lines) chip.swatch.style.background = seriesColor(color); changed(); });
    if (options.lines) options.lines.slice(0, MOST_LINES).forEach(addLine);
    else chooseFirst();
    if (bag()) robot.every(100, changed);
    return {
      destroy() { paint.stop(); endFit(); endTheme(); },
      seeked() { if (!bag()) { for (const { series } of lines) series.clear(); newest = seconds(robot.timeNs); } changed(); },
    };
  },
};

/** @param {Chosen} chosen @param {() => void} remove @param {() => void} toggle */
function chipOf({ topic, path, label, color }, remove, toggle) {
  const swatch = h('i', { style: { background: seriesColor(color) } });
  const value = h('b', null, '–');
  const name = h('button', { type: 'button', onclick: toggle, title: `${topic} ${path}` }, label);
  return { swatch, value, element: h('span', { class: 'series' }, swatch, h('span', null, name), value, iconButton('close', `Remove ${label}`, remove)) };
}

/** `head_pan position` for `position[18]` of a message that names its elements. @param {any} message @param {string} topic @param {string} path @param {boolean} [isInTopic] */
function labelOf(message, topic, path, isInTopic = false) {
  const match = /^(\w+)\[(\d+)\]$/.exec(path);
  const name = match && Array.isArray(message?.name) ? message.name[Number(match[2])] : undefined;
  if (match && typeof name === 'string') return match[1] === 'position' && !isInTopic ? name : `${name} ${match[1]}`;
  return isInTopic ? path : `${topic.replace(/^\//, '')} ${path}`;
}

/** Those that show how a robot walks, else the first. @param {any} message */
function jointPaths({ name, position }) {
  const all = Array.from(position, (_, i) => i);
  const legs = all.filter((i) => /knee|hip_pitch|ank(le)?_pitch/.test(name[i]));
  return (legs.length >= 2 ? legs : all).slice(0, 6).map((i) => `position[${i}]`);
}

/** The fields that a definition names; those of arrays are known when a message arrives. @param {import('../panel.js').PanelRobot} robot @param {string} topic */
function schemaPaths(robot, topic) {
  /** @type {string[]} */
  const paths = [];
  try {
    const schema = robot.schema(topic);
    const walk = (/** @type {string} */ type, /** @type {string} */ prefix, /** @type {number} */ depth) => {
      for (const field of schema.types.get(type)?.fields ?? []) {
        if (depth > 8 || paths.length > 300) return;
        if (isPrimitive(field.type)) { if (isNumeric(field.type)) paths.push(`${prefix}${field.name}${field.isArray ? '[0]' : ''}`); }
        else walk(field.type, `${prefix}${field.name}${field.isArray ? '[0]' : ''}.`, depth + 1);
      }
    };
    walk(schema.root.name, '', 0);
  } catch { /* a topic that cannot be read has no fields */ }
  return paths;
}

/** @param {number} value @param {number} step */
function tick(value, step) {
  const decimals = Math.max(0, Math.min(8, -Math.floor(Math.log10(step) + 1e-9)));
  return Math.abs(value) >= 1e6 ? value.toExponential(1) : (Math.abs(value) < step * 1e-6 ? 0 : value).toFixed(decimals).replace('-', '−');
}
