// @ts-check
// What panels are, and what they share.

/**
 * @typedef {ReturnType<import('./connection.js').Robot['scope']>} PanelRobot
 *   the robot as a panel sees it: subscriptions, listeners and `every` end with the panel and are held while it is hidden
 * @typedef {{ get(): any, set(options: any): void, setTitle(text: string): void, header: HTMLElement }} View
 *   a panel's own options as JSON, kept by the page; the text after its title; the place for its controls in the head of its card
 * @typedef {{ destroy(): void, seeked?(): void }} Instance  `seeked`: playback jumped, what was collected is of another time
 * @typedef {{ id: string, title: string, create(root: HTMLElement, robot: PanelRobot, view: View): Instance }} Panel
 */

/** @typedef {Node | string | number | null | undefined | false} Child */

/**
 * An element. Attributes that begin with `on` are listeners, `dataset` and `style` take objects, others with a value that is not text are
 * properties.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag @param {Record<string, any> | null} [attributes] @param {...(Child | Child[])} children
 * @returns {HTMLElementTagNameMap[T]}
 */
export function h(tag, attributes, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (value === undefined || value === null) continue;
    if (name.startsWith('on')) element.addEventListener(name.slice(2), value);
    else if (name === 'class') element.className = value;
    else if (name === 'style') Object.assign(element.style, value);
    else if (name === 'dataset') Object.assign(element.dataset, value);
    else if (typeof value === 'string') element.setAttribute(name, value);
    else if (name.startsWith('aria-') || name === 'role') element.setAttribute(name, String(value));
    else /** @type {any} */ (element)[name] = value;
  }
  for (const child of children.flat()) {
    if (child !== null && child !== undefined && child !== false) element.append(child instanceof Node ? child : String(child));
  }
  return element;
}

const ICONS = /** @type {Record<string, string>} */ ({
  dashboard: 'M4 4h7v9H4zM13 4h7v5h-7zM13 11h7v9h-7zM4 15h7v5H4z',
  scene: 'M12 3l8 4.5v9L12 21l-8-4.5v-9zM12 12l8-4.5M12 12v9M12 12L4 7.5',
  camera: 'M4 7h4l2-2.5h4L16 7h4v12H4zM12 16.5a3.5 3.5 0 100-7 3.5 3.5 0 000 7z',
  graph: 'M3.5 9h6v6h-6zM14.5 4h6v6h-6zM14.5 14h6v6h-6zM9.5 12h2.5M12 12V7h2.5M12 12v5h2.5',
  timeline: 'M4 6h7M8 12h9M13 18h7M4 4v4M20 16v4',
  servos: 'M12 15a3 3 0 100-6 3 3 0 000 6zM12 3v3M12 18v3M3 12h3M18 12h3M5.6 5.6l2.2 2.2M16.2 16.2l2.2 2.2M5.6 18.4l2.2-2.2M16.2 7.8l2.2-2.2',
  plot: 'M4 4v16h16M7 15l4-5 3 3 5-7',
  log: 'M5 6h14M5 10h14M5 14h9M5 18h6',
  diagnostics: 'M3 12h4l2.5-6 4 12 2.5-6h5',
  parameters: 'M5 7h8M17 7h2M5 12h2M11 12h8M5 17h6M15 17h4M13 5v4M7 10v4M11 15v4',
  topics: 'M12 13a1.5 1.5 0 100-3 1.5 1.5 0 000 3zM8 15.5a5.5 5.5 0 010-8M16 15.5a5.5 5.5 0 000-8M5 18a9 9 0 010-13M19 18a9 9 0 000-13',
  lifecycle: 'M19 12a7 7 0 11-2.2-5.1M19 4v4h-4',
  recording: 'M12 20a8 8 0 100-16 8 8 0 000 16zM12 15a3 3 0 100-6 3 3 0 000 6z',
  panel: 'M4 5h16v14H4zM4 9.5h16',
  play: 'M8 5.5v13l10.5-6.5z',
  pause: 'M8.5 5.5v13M15.5 5.5v13',
  step: 'M6 5.5v13L14.5 12zM18 5.500v13',
  close: 'M6 6l12 12M18 6L6 18',
  expand: 'M14 5h5v5M19 5l-6 6M10 19H5v-5M5 19l6-6',
  shrink: 'M19 10h-5V5M14 10l6-6M5 14h5v5M10 14l-6 6',
  plus: 'M12 5v14M5 12h14',
  wider: 'M8 8l-4 4 4 4M16 8l4 4-4 4M4 12h16',
  sun: 'M12 16a4 4 0 100-8 4 4 0 000 8zM12 3v2M12 19v2M3 12h2M19 12h2M5.6 5.600l1.4 1.400M17 17l1.4 1.400M5.6 18.400L7 17M17 7l1.4-1.4',
  moon: 'M19.5 14.500A8 8 0 019.5 4.500a8 8 0 1010 10z',
  auto: 'M12 20a8 8 0 100-16 8 8 0 000 16zM12 4v16M12 8l5.5-2M12 12h8M12 16l5.5 2',
  follow: 'M12 15a3 3 0 100-6 3 3 0 000 6zM12 3v3M12 18v3M3 12h3M18 12h3',
  home: 'M4 11l8-7 8 7M6.5 9.500V20h11V9.5',
  menu: 'M12 6h.01M12 12h.01M12 18h.01',
  search: 'M10.5 16a5.5 5.5 0 100-11 5.5 5.5 0 000 11zM15 15l5 5',
  left: 'M14 6l-6 6 6 6',
  right: 'M10 6l6 6-6 6',
  layers: 'M12 4l8 4.5-8 4.5-8-4.500zM4 12.500l8 4.5 8-4.5',
  key: 'M8 15a3.5 3.5 0 100-7 3.5 3.5 0 000 7zM11.5 11.500H20V15M16.5 11.500V14',
  trash: 'M5 7h14M10 7V4.500h4V7M7 7l1 13h8l1-13',
});

/** A line icon, hidden from screen readers. @param {string} name @returns {SVGSVGElement} */
export function icon(name) {
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
  const path = document.createElementNS('http://www.w3.org/2000/svg', 'path');
  svg.setAttribute('viewBox', '0 0 24 24');
  svg.setAttribute('class', name === 'menu' ? 'icon menu-icon' : 'icon');
  svg.setAttribute('aria-hidden', 'true');
  path.setAttribute('d', ICONS[name] ?? ICONS.panel);
  svg.append(path);
  return svg;
}

/**
 * A button with an icon.
 * @param {string} name of the icon @param {string} label for screen readers and as a hint @param {(event: MouseEvent) => void} onclick
 * @param {Record<string, any>} [attributes]
 */
export const iconButton = (name, label, onclick, attributes = {}) =>
  h('button', { type: 'button', class: 'icon-button', 'aria-label': label, title: label, onclick, ...attributes }, icon(name));

/** A message in place of content. @param {string} text @param {string} [hint] */
export const empty = (text, hint) => h('div', { class: 'empty' }, h('p', null, text), hint ? h('p', { class: 'muted' }, hint) : null);

/**
 * Calls `draw` in the next frame after each `request()`, at most once per frame.
 * @param {(nowMs: number) => void} draw
 */
export function painter(draw) {
  let planned = 0;
  return {
    request() { planned ||= requestAnimationFrame((now) => { planned = 0; draw(now); }); },
    stop() { cancelAnimationFrame(planned); planned = 0; },
  };
}

/**
 * A canvas that has the size of its parent in pixels of the screen.
 * @param {HTMLCanvasElement} canvas @param {() => void} onResize @returns {() => void} ends it
 */
export function fitCanvas(canvas, onResize) {
  const fit = () => {
    const scale = Math.min(window.devicePixelRatio || 1, 2);
    const { clientWidth, clientHeight } = canvas;
    const [width, height] = [Math.max(1, Math.round(clientWidth * scale)), Math.max(1, Math.round(clientHeight * scale))];
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    onResize();
  };
  const observer = new ResizeObserver(fit);
  observer.observe(canvas);
  return () => observer.disconnect();
}

/** @type {Map<string, string>} */
const tokens = new Map();
for (const [target, type] of /** @type {[EventTarget, string][]} */ (typeof window === 'object' ? [[window, 'theme'], [matchMedia('(prefers-color-scheme: dark)'), 'change']] : [])) {
  target.addEventListener(type, () => tokens.clear());
}

/** The colour of a design token such as `--accent`, as `rgb(…)` of the present theme. @param {string} name */
export function token(name) {
  let value = tokens.get(name);
  if (value === undefined) {
    // A custom property keeps `light-dark(…)` as it stands; a colour is resolved.
    const probe = h('i', { style: { color: `var(${name})`, display: 'none' } });
    document.body.append(probe);
    value = getComputedStyle(probe).color;
    probe.remove();
    tokens.set(name, value);
  }
  return value;
}

/** Calls `listener` when light and dark change. @param {() => void} listener @returns {() => void} ends it */
export function onTheme(listener) {
  const media = matchMedia('(prefers-color-scheme: dark)');
  window.addEventListener('theme', listener);
  media.addEventListener('change', listener);
  return () => { window.removeEventListener('theme', listener); media.removeEventListener('change', listener); };
}

/** The colour of the nth line or series; they differ for the colour-blind too. @param {number} index */
export const seriesColor = (index) => token(`--series-${index % 10}`);

/** A number as people read it: at most `digits` significant. @param {number} value @param {number} [digits] */
export function number(value, digits = 4) {
  if (!Number.isFinite(value)) return Number.isNaN(value) ? '–' : value > 0 ? '∞' : '−∞';
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e7)) return value.toExponential(Math.max(0, digits - 2)).replace('-', '−');
  const decimals = size === 0 ? 0 : Math.max(0, Math.min(6, digits - 1 - Math.floor(Math.log10(size))));
  return value.toFixed(decimals).replace('-', '−');
}

/** @param {number} count of bytes */
export function bytes(count) {
  const units = ['B', 'kB', 'MB', 'GB', 'TB'];
  let unit = 0;
  while (count >= 1000 && unit < units.length - 1) { count /= 1000; unit++; }
  return `${unit === 0 ? Math.round(count) : count >= 100 ? count.toFixed(0) : count.toFixed(1)} ${units[unit]}`;
}

/** A rate in Hz. @param {number} hz */
export const rate = (hz) => (hz <= 0 ? '–' : hz < 10 ? hz.toFixed(1) : hz.toFixed(0));

/** The time of day of a time since 1970, or seconds since the start of simulated time. @param {bigint} timeNs @param {number} [decimals] */
export function clock(timeNs, decimals = 3) {
  const ms = Number(timeNs / 1_000_000n);
  if (ms < 1e11) return `${(ms / 1000).toFixed(decimals)} s`;
  const date = new Date(ms);
  const pad = (/** @type {number} */ value, width = 2) => String(value).padStart(width, '0');
  const fraction = decimals > 0 ? `.${pad(date.getMilliseconds(), 3).slice(0, decimals)}` : '';
  return `${pad(date.getHours())}:${pad(date.getMinutes())}:${pad(date.getSeconds())}${fraction}`;
}

/** How long, as `1:04:09` or `4.2 s`. @param {number} seconds */
export function duration(seconds) {
  if (seconds < 60) return `${seconds.toFixed(1)} s`;
  const [hours, minutes, rest] = [Math.floor(seconds / 3600), Math.floor((seconds % 3600) / 60), Math.floor(seconds % 60)];
  const pad = (/** @type {number} */ value) => String(value).padStart(2, '0');
  return hours > 0 ? `${hours}:${pad(minutes)}:${pad(rest)}` : `${minutes}:${pad(rest)}`;
}

/** Copies children into `root` only where they differ from those there, so that focus and selection stay. @param {Element} root @param {Node[]} children */
export function replace(root, children) {
  const same = root.childNodes.length === children.length && children.every((child, i) => root.childNodes[i] === child);
  if (!same) root.replaceChildren(...children);
}

/** Sets text only where it changed. @param {Element} element @param {string} value */
export function setText(element, value) { if (element.textContent !== value) element.textContent = value; }
