// @ts-check
// The shell: connection, top bar, navigation, and the dashboard of panels.

import { Robot, words } from './connection.js';
import { clock, duration, empty, h, icon, iconButton, setText } from './panel.js';

/**
 * @typedef {{ id: string, title: string, script: string, width: number, height: number, isOwn?: boolean }} Entry
 *   a kind of panel, with the columns of twelve and the rows of two that it takes
 * @typedef {{ key: string, kind: string, width: number, height: number }} Placed  a panel on the dashboard
 * @typedef {{ cards: Placed[], options: Record<string, any> }} Layout
 */

/** @type {Entry[]} */
const PANELS = [
  { id: 'scene', title: '3D', script: './panels/scene.js', width: 5, height: 2 },
  { id: 'camera', title: 'Camera', script: './panels/camera.js', width: 3, height: 1 },
  { id: 'graph', title: 'Graph', script: './panels/graph.js', width: 4, height: 1 },
  { id: 'timeline', title: 'Timeline', script: './panels/timeline.js', width: 6, height: 1 },
  { id: 'servos', title: 'Servos', script: './panels/servos.js', width: 6, height: 1 },
  { id: 'plot', title: 'Plot', script: './panels/plot.js', width: 4, height: 1 },
  { id: 'log', title: 'Log', script: './panels/log.js', width: 6, height: 1 },
  { id: 'diagnostics', title: 'Diagnostics', script: './panels/diagnostics.js', width: 3, height: 1 },
  { id: 'parameters', title: 'Parameters', script: './panels/parameters.js', width: 4, height: 1 },
  { id: 'topics', title: 'Topics', script: './panels/topics.js', width: 6, height: 1 },
  { id: 'lifecycle', title: 'Lifecycle', script: './panels/lifecycle.js', width: 3, height: 1 },
  { id: 'recording', title: 'Recording', script: './panels/recording.js', width: 3, height: 1 },
];
const WIDTHS = [3, 4, 5, 6, 8, 12];
const MOST_CARDS = 24;
const DASHBOARD = 'dashboard';
/** What the address names after its `#` or `#/`. */
const named = () => { try { return decodeURIComponent(location.hash.slice(1)).replace(/^\//, ''); } catch { return DASHBOARD; } };
/** @param {string} view */
const show = (view) => { location.hash = `/${view}`; };

/** @param {string} id @returns {HTMLElement} */
const byId = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
const [top_, rail, main, playbackBar, toasts] = ['top', 'rail', 'main', 'playback', 'toasts'].map(byId);

// ---- storage

const stored = {
  /** @param {string} key @returns {any} */
  get(key) { try { return JSON.parse(localStorage.getItem(`downbeat.${key}`) ?? 'null'); } catch { return null; } },
  /** @param {string} key @param {any} value */
  set(key, value) { try { localStorage.setItem(`downbeat.${key}`, JSON.stringify(value)); } catch { /* private windows keep nothing */ } },
};

/** The token of the page's URL. It leaves the address bar, so that it is neither shown nor shared. */
function takeToken() {
  const given = /(?:^#|&)token=([^&]+)/.exec(location.hash);
  try {
    if (given) {
      sessionStorage.setItem('downbeat.token', decodeURIComponent(given[1]));
      history.replaceState(null, '', location.pathname + location.search + location.hash.replace(given[0], '').replace(/^&/, '#'));
    }
    return sessionStorage.getItem('downbeat.token');
  } catch { return given ? decodeURIComponent(given[1]) : null; }
}

// ---- theme

const THEMES = /** @type {const} */ (['auto', 'light', 'dark']);
let theme = THEMES.find((name) => name === stored.get('theme')) ?? 'auto';
function applyTheme() {
  if (theme === 'auto') delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
  window.dispatchEvent(new Event('theme'));
}
applyTheme();

// ---- robot

function address() {
  const token = takeToken();
  return `${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/ws${token ? `?token=${encodeURIComponent(token)}` : ''}`;
}
const robot = new Robot(address());
/** For tests and the curious. */
/** @type {any} */ (window).robot = robot;

/** @param {string} text @param {'info' | 'warning' | 'error' | 'done'} [level] */
function toast(text, level = 'info') {
  const same = [...toasts.children].find((child) => child.querySelector('p')?.textContent === text);
  same?.remove();
  const element = h('div', { class: `toast ${level}`, 'data-testid': 'toast' }, h('p', null, text),
    iconButton('close', 'Dismiss', () => element.remove()));
  toasts.append(element);
  while (toasts.children.length > 4) toasts.firstElementChild?.remove();
  setTimeout(() => element.remove(), level === 'error' ? 15_000 : 7_000);
}
robot.addEventListener('status', (event) => { const { level, text } = /** @type {CustomEvent} */ (event).detail; toast(text, level); });

// ---- top bar

const nameLine = h('h1', { 'data-testid': 'robot-name' }, 'downbeat');
const stateChip = h('span', { class: 'chip', role: 'status', 'data-testid': 'connection' }, 'Connecting');
const kindChip = h('span', { class: 'chip plain accent wide', hidden: true });
const lookChip = h('span', { class: 'chip plain wide', hidden: true, title: 'Open the link that the program printed at its start: it carries the token that lets this page change the robot.' }, 'Look only');
const timeLine = h('span', { class: 'time number wide', 'data-testid': 'time', title: 'The robot’s time' });
const pauseButton = iconButton('pause', 'Pause the robot’s cycles', () => togglePause(), { 'data-testid': 'pause' });
const stepButton = iconButton('step', 'Run one cycle', () => act('step'), { 'data-testid': 'step' });
const clockGroup = h('div', { class: 'group', hidden: true, role: 'group', 'aria-label': 'Time of the robot' }, pauseButton, stepButton);
const recordMark = h('a', { class: 'chip error live', href: '#/recording', hidden: true, 'data-testid': 'recording-mark' }, 'REC');
const themeButton = iconButton('auto', 'Theme', () => {
  theme = THEMES[(THEMES.indexOf(theme) + 1) % THEMES.length];
  stored.set('theme', theme);
  applyTheme();
  showTheme();
}, { 'data-testid': 'theme' });
function showTheme() {
  const name = `Theme: ${theme === 'auto' ? 'as the system' : theme}`;
  themeButton.replaceChildren(icon(theme === 'auto' ? 'auto' : theme === 'light' ? 'sun' : 'moon'));
  themeButton.title = name;
  themeButton.setAttribute('aria-label', name);
}
showTheme();
const addButton = iconButton('plus', 'Add a panel', (event) => addMenu(/** @type {HTMLElement} */ (event.currentTarget)), { 'data-testid': 'add-panel' });
top_.append(
  h('span', { class: 'brand' }, h('img', { src: 'icon.svg', alt: 'downbeat', width: 30, height: 30 })),
  nameLine, stateChip, kindChip, lookChip, h('span', { class: 'spacer' }), recordMark, timeLine, clockGroup, addButton, themeButton,
);

let isPaused = false;
/** @param {string} what */
async function act(what) {
  try { await robot.ask(what); } catch (error) { toast(words(error), 'error'); }
}
async function togglePause() {
  if (robot.playback) { robot.control({ play: robot.playback.status !== 'playing' }); return; }
  await act(isPaused ? 'resume' : 'pause');
  await lookAtClock();
}
async function lookAtClock() {
  if (robot.state !== 'open' || robot.playback || document.hidden) return;
  try {
    const { is_paused: paused, time_ns: timeNs } = await robot.ask('snapshot');
    robot.tell(BigInt(Math.round(timeNs)));
    if (!robot.info?.canPause) return;
    isPaused = paused;
    pauseButton.replaceChildren(icon(paused ? 'play' : 'pause'));
    const label = paused ? 'Let the robot’s cycles run' : 'Pause the robot’s cycles';
    pauseButton.title = label;
    pauseButton.setAttribute('aria-label', label);
    stepButton.disabled = !paused;
    showState();
  } catch { /* the connection's state says it */ }
}
async function lookAtRecording() {
  if (robot.state !== 'open' || document.hidden) return;
  try {
    const recording = await robot.ask('recording');
    recordMark.hidden = !recording?.is_recording;
    setText(recordMark, recording?.is_paused ? 'REC paused' : 'REC');
    recordMark.classList.toggle('live', !recording?.is_paused);
  } catch { recordMark.hidden = true; }
}
setInterval(lookAtClock, 1000);
setInterval(lookAtRecording, 2000);
setInterval(() => {
  if (robot.timeNs > 0n && robot.state === 'open') setText(timeLine, clock(robot.timeNs, 1));
}, 200);

function showState() {
  const { state, info } = robot;
  const paused = state === 'open' && (robot.playback ? robot.playback.status !== 'playing' : isPaused);
  setText(stateChip, state === 'open' ? (paused ? 'Paused' : robot.playback ? 'Playing' : 'Live') : state === 'connecting' ? 'Connecting' : 'Offline');
  stateChip.className = `chip ${state === 'open' ? (paused ? 'warn' : 'ok live') : 'error'}`;
  stateChip.title = state === 'closed' ? robot.reason : '';
  setText(nameLine, info?.name ?? 'downbeat');
  document.title = info?.name ? `${info.name} · downbeat` : 'downbeat';
  kindChip.hidden = !(info?.isSimulated || info?.isBag || robot.playback);
  setText(kindChip, info?.isBag || robot.playback ? 'Bag' : 'Simulated');
  lookChip.hidden = state !== 'open' || robot.mayChange || Boolean(info?.isBag);
  clockGroup.hidden = !(info?.canPause && robot.mayChange && !robot.playback);
}

// ---- playback of a bag

const playButton = iconButton('play', 'Play', () => togglePause(), { 'data-testid': 'play' });
const seekBar = h('input', { type: 'range', min: '0', max: '1000', step: '1', value: '0', 'aria-label': 'Time in the bag', 'data-testid': 'seek' });
const positionLine = h('span', { class: 'number', 'data-testid': 'position' });
const speedChoice = h('select', { 'aria-label': 'Speed', 'data-testid': 'speed', onchange: () => robot.control({ speed: Number(speedChoice.value) }) },
  ['0.1', '0.25', '0.5', '1', '2', '5', '10', '20'].map((speed) => h('option', { value: speed, selected: speed === '1' }, `${speed}×`)));
playbackBar.append(playButton, positionLine, seekBar, speedChoice);
let isSeeking = false;
seekBar.addEventListener('input', () => {
  const { playback } = robot;
  if (!playback) return;
  isSeeking = true;
  const length = Number(playback.endNs - playback.startNs);
  seekSoon(playback.startNs + BigInt(Math.round(length * Number(seekBar.value) / Number(seekBar.max))));
});
seekBar.addEventListener('change', () => { isSeeking = false; });
/** @type {bigint | null} */
let wishedNs = null;
/** While one drags, ten seeks per second are enough. @param {bigint} timeNs */
function seekSoon(timeNs) {
  if (wishedNs === null) {
    setTimeout(() => {
      if (wishedNs !== null) robot.control({ seekNs: wishedNs });
      wishedNs = null;
    }, 100);
  }
  wishedNs = timeNs;
  showPosition(timeNs);
}
/** @param {bigint} timeNs */
function showPosition(timeNs) {
  const { playback } = robot;
  if (!playback) return;
  const [at, length] = [Number(timeNs - playback.startNs) / 1e9, Number(playback.endNs - playback.startNs) / 1e9];
  setText(positionLine, `${duration(Math.max(0, at))} / ${duration(length)}`);
  seekBar.setAttribute('aria-valuetext', duration(Math.max(0, at)));
  if (!isSeeking) { seekBar.max = String(Math.max(1, Math.round(length * 100))); seekBar.value = String(Math.round(at * 100)); }
}
function showPlayback() {
  const { playback } = robot;
  playbackBar.hidden = !playback;
  if (!playback) return;
  const plays = playback.status === 'playing';
  playButton.replaceChildren(icon(plays ? 'pause' : 'play'));
  playButton.setAttribute('aria-label', plays ? 'Pause' : 'Play');
  playButton.title = plays ? 'Pause' : 'Play';
  speedChoice.value = String(Number(playback.speed.toFixed(2)));
  showPosition(wishedNs ?? playback.timeNs);
}
robot.addEventListener('playback', () => { showPlayback(); showState(); });
setInterval(() => { if (robot.playback?.status === 'playing' && wishedNs === null && !isSeeking) showPosition(robot.timeNs); }, 200);

// ---- panels

/** @type {Entry[]} */
let entries = PANELS;
/** @type {Layout} */
let layout = { cards: [], options: {} };
/** @type {Map<string, Card>} */
const shown = new Map();

const layoutKey = () => `layout.${robot.info?.name ?? ''}`;
/** A link such as `#/scene+camera` names its panels: they stay in the address, and one's own dashboard stays as it was. */
let isLinked = false;
/** Whether somebody has placed panels. Until then the dashboard shows what suits the topics of the robot, each time anew. */
let isEdited = false;
function save() {
  if (!isLinked) stored.set(layoutKey(), isEdited ? layout : { options: layout.options });
  else if (named().includes('+')) history.replaceState(null, '', `#/${layout.cards.map(({ kind }) => kind).join('+')}`);
}
/** @param {string} kind */
const entryOf = (kind) => entries.find(({ id }) => id === kind);

/** A panel with its head, alive while it is on the page. */
class Card {
  /** @param {Placed} placed @param {boolean} isAlone */
  constructor(placed, isAlone) {
    this.placed = placed;
    this.isAlone = isAlone;
    const entry = entryOf(placed.kind);
    this.title = entry?.title ?? placed.kind;
    this.about = h('span', { class: 'about' });
    this.controls = h('div', { class: 'controls' });
    this.body = h('div', { class: 'card-body' });
    const heading = h('h2', { id: `title-${placed.key}` }, this.title);
    const tools = isAlone
      ? [iconButton('shrink', 'Back to the dashboard', () => { show(DASHBOARD); })]
      : [iconButton('expand', `${this.title} alone`, () => { show(placed.kind === placed.key ? placed.kind : placed.key); }),
        iconButton('menu', `Place ${this.title}`, (event) => this.menu(/** @type {HTMLElement} */ (event.currentTarget)), { 'aria-haspopup': 'menu' })];
    this.head = h('header', { class: 'card-head', draggable: !isAlone }, heading, this.about, this.controls, tools);
    this.element = h('section', { class: isAlone ? 'card alone' : 'card', 'aria-labelledby': heading.id, 'data-testid': `panel-${placed.kind}`, dataset: { key: placed.key } }, this.head, this.body);
    this.place();
    if (!isAlone) this.makeDraggable();
    this.robot = robot.scope();
    /** @type {import('./panel.js').Instance | null} */
    this.instance = null;
    this.hasEnded = false;
    this.isSeen = true;
    this.watcher = new IntersectionObserver(([seen]) => { this.isSeen = seen.isIntersecting; this.showOrHide(); }, { rootMargin: '80px' });
    this.watcher.observe(this.element);
    this.load(entry);
  }

  /** @param {Entry | undefined} entry */
  async load(entry) {
    try {
      if (!entry) throw new Error(`there is no panel "${this.placed.kind}"`);
      const { default: panel } = await import(entry.script);
      if (this.hasEnded) return;
      const view = {
        get: () => layout.options[this.placed.key] ?? {},
        set: (/** @type {any} */ options) => { layout.options[this.placed.key] = options; save(); },
        setTitle: (/** @type {string} */ text) => setText(this.about, text),
        header: this.controls,
      };
      this.instance = panel.create(this.body, this.robot, view);
    } catch (error) {
      this.body.replaceChildren(empty('This panel cannot be shown.', words(error)));
      console.error(error);
    }
  }

  showOrHide() { this.robot.setVisible(this.isSeen && !isAway); }

  place() {
    const { width, height } = this.placed;
    this.element.style.setProperty('--w', String(width));
    this.element.style.setProperty('--h', String(height));
    if (width > 4) this.element.dataset.wide = '';
    else delete this.element.dataset.wide;
  }

  makeDraggable() {
    this.head.addEventListener('dragstart', (event) => {
      if (event.target !== this.head) return;
      event.dataTransfer?.setData('text/x-downbeat-panel', this.placed.key);
      if (event.dataTransfer) event.dataTransfer.effectAllowed = 'move';
    });
    this.element.addEventListener('dragover', (event) => {
      if (!event.dataTransfer?.types.includes('text/x-downbeat-panel')) return;
      event.preventDefault();
      this.element.classList.add('dropping');
    });
    this.element.addEventListener('dragleave', () => this.element.classList.remove('dropping'));
    this.element.addEventListener('drop', (event) => {
      this.element.classList.remove('dropping');
      const key = event.dataTransfer?.getData('text/x-downbeat-panel');
      const from = layout.cards.findIndex((card) => card.key === key);
      const to = layout.cards.indexOf(this.placed);
      if (from < 0 || to < 0 || from === to) return;
      event.preventDefault();
      layout.cards.splice(to, 0, ...layout.cards.splice(from, 1));
      rearrange();
    });
  }

  /** @param {HTMLElement} anchor */
  menu(anchor) {
    const { placed } = this;
    const at = layout.cards.indexOf(placed);
    const move = (/** @type {number} */ by) => () => {
      layout.cards.splice(at, 1);
      layout.cards.splice(Math.max(0, Math.min(layout.cards.length, at + by)), 0, placed);
      rearrange();
    };
    const resize = (/** @type {number} */ by) => () => {
      const next = WIDTHS[Math.max(0, Math.min(WIDTHS.length - 1, WIDTHS.indexOf(placed.width) + by))];
      placed.width = next ?? 4;
      this.place();
      isEdited = true;
      save();
    };
    openMenu(anchor, `Place ${this.title}`, [
      menuItem('right', 'Wider', resize(1)), menuItem('left', 'Narrower', resize(-1)),
      menuItem('wider', placed.height > 1 ? 'Less high' : 'Higher', () => { placed.height = placed.height > 1 ? 1 : 2; this.place(); isEdited = true; save(); }),
      h('hr'), menuItem('left', 'Move forward', move(-1)), menuItem('right', 'Move back', move(1)),
      h('hr'), menuItem('trash', 'Remove', () => { layout.cards.splice(at, 1); delete layout.options[placed.key]; rearrange(); }),
    ]);
  }

  end() {
    this.hasEnded = true;
    this.watcher.disconnect();
    try { this.instance?.destroy(); } catch (error) { console.error(error); }
    this.robot.endScope();
    this.element.remove();
  }
}

/** A page that was left for a moment keeps its subscriptions. */
let isAway = false;
let awayTimer = 0;
document.addEventListener('visibilitychange', () => {
  clearTimeout(awayTimer);
  awayTimer = window.setTimeout(() => {
    isAway = document.hidden;
    for (const card of shown.values()) card.showOrHide();
  }, document.hidden ? 3000 : 0);
});
robot.addEventListener('seeked', () => { for (const card of shown.values()) card.instance?.seeked?.(); });

// ---- menus

/** @param {string} iconName @param {string} label @param {() => void} action */
const menuItem = (iconName, label, action) => h('button', { type: 'button', role: 'menuitem', onclick: action }, icon(iconName), label);

/** @param {HTMLElement} anchor @param {string} name @param {HTMLElement[]} items */
function openMenu(anchor, name, items) {
  const menu = h('div', { class: 'menu', role: 'menu', popover: 'auto', 'aria-label': name }, items);
  document.body.append(menu);
  menu.addEventListener('toggle', (event) => { if (/** @type {ToggleEvent} */ (event).newState === 'closed') { menu.remove(); anchor.focus({ preventScroll: true }); } });
  menu.addEventListener('click', (event) => { if (/** @type {Element} */ (event.target).closest('[role=menuitem]')) menu.hidePopover(); });
  menu.addEventListener('keydown', (event) => {
    const buttons = [...menu.querySelectorAll('button')];
    const step = event.key === 'ArrowDown' ? 1 : event.key === 'ArrowUp' ? -1 : 0;
    if (!step) return;
    event.preventDefault();
    buttons[(buttons.indexOf(/** @type {any} */ (document.activeElement)) + step + buttons.length) % buttons.length].focus();
  });
  menu.showPopover();
  const [box, size] = [anchor.getBoundingClientRect(), menu.getBoundingClientRect()];
  menu.style.left = `${Math.max(8, Math.min(box.right - size.width, innerWidth - size.width - 8))}px`;
  menu.style.top = `${Math.max(8, Math.min(box.bottom + 4, innerHeight - size.height - 8))}px`;
  menu.querySelector('button')?.focus();
}

/** @param {HTMLElement} anchor */
function addMenu(anchor) {
  openMenu(anchor, 'Add to the dashboard', [
    ...entries.map((entry) => menuItem(entry.isOwn ? 'panel' : entry.id, entry.title, () => add(entry))),
    h('hr'),
    menuItem('home', 'Panels as at first', () => { isEdited = false; layout = { cards: defaultCards(), options: {} }; for (const card of shown.values()) card.end(); shown.clear(); arrange(); }),
  ]);
}

/** @param {Entry} entry */
function add(entry) {
  if (layout.cards.length >= MOST_CARDS) { toast(`At most ${MOST_CARDS} panels.`, 'warning'); return; }
  const taken = new Set(layout.cards.map(({ key }) => key));
  let key = entry.id;
  for (let i = 2; taken.has(key); i++) key = `${entry.id}-${i}`;
  layout.cards.push({ key, kind: entry.id, width: entry.width, height: entry.height });
  show(DASHBOARD);
  rearrange();
  shown.get(key)?.element.scrollIntoView({ block: 'nearest' });
}

/**
 * A panel asks for another one: the one on the dashboard shows it, or one alone.
 * @param {string} kind @param {any} options
 */
function open(kind, options) {
  if (!entryOf(kind)) return;
  const key = layout.cards.find((placed) => placed.kind === kind)?.key ?? kind;
  layout.options[key] = { ...layout.options[key], ...options };
  save();
  shown.get(key)?.end();
  shown.delete(key);
  const isBeside = layout.cards.some((placed) => placed.key === key) && grid.classList.contains('dashboard');
  if (isBeside) { arrange(); shown.get(key)?.element.scrollIntoView({ block: 'nearest' }); }
  else location.hash = key;
}
document.addEventListener('downbeat:open', (event) => {
  const { panel, options } = /** @type {CustomEvent} */ (event).detail;
  open(panel, options);
});

/** What one wants to see first of this robot. @returns {Placed[]} */
function defaultCards() {
  const types = new Set([...robot.channels.values()].map(({ schemaName }) => schemaName));
  const has = (/** @type {string[]} */ ...names) => names.some((name) => types.has(name));
  const hasScene = has('tf2_msgs/msg/TFMessage', 'visualization_msgs/msg/MarkerArray', 'visualization_msgs/msg/Marker') || robot.channels.has('/robot_description');
  const hasCamera = has('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage');
  const isBag = Boolean(robot.info?.isBag || robot.playback);
  /** @type {[string, number, number][]} */
  const places = hasScene && hasCamera
    ? [['scene', 5, 2], ['camera', 3, 1], [isBag ? 'topics' : 'graph', 4, 1], ['plot', 4, 1], ['diagnostics', 3, 1]]
    : hasScene || hasCamera
      ? [[hasScene ? 'scene' : 'camera', 5, 2], [isBag ? 'topics' : 'graph', 7, 1], ['plot', 4, 1], ['diagnostics', 3, 1]]
      : [[isBag ? 'topics' : 'graph', 6, 1], ['plot', 6, 1], ['servos', 8, 1], ['diagnostics', 4, 1]];
  // A match is seen in its own panel: in 3D there would be a ball without players, who have their descriptions elsewhere.
  const own = entries.find(({ isOwn }) => isOwn);
  if (own && !robot.channels.has('/robot_description')) {
    const scene = places.findIndex(([kind]) => kind === 'scene');
    places.splice(Math.max(0, scene), scene < 0 ? 0 : 1, [own.id, scene < 0 ? 6 : places[scene][1], 2]);
  }
  if (!has('diagnostic_msgs/msg/DiagnosticArray')) places[places.length - 1][0] = 'log';
  return places.map(([kind, width, height]) => ({ key: kind, kind, width, height }));
}

const grid = h('div', { 'data-testid': 'dashboard' });

/** Somebody has placed a panel. */
function rearrange() {
  isEdited = true;
  arrange();
}

/** Shows what the address names: the dashboard, one panel, or a dashboard of the named panels. */
function arrange() {
  save();
  const wanted = named();
  const alone = layout.cards.find(({ key }) => key === wanted) ?? (entryOf(wanted) ? { key: wanted, kind: wanted, width: 12, height: 2 } : null);
  const cards = alone ? [alone] : layout.cards;
  for (const [key, card] of shown) {
    const stays = cards.some((placed) => placed.key === key) && card.isAlone === Boolean(alone);
    if (!stays) { card.end(); shown.delete(key); }
  }
  if (grid.parentElement !== main) main.replaceChildren(grid);
  grid.classList.toggle('dashboard', !alone);
  grid.querySelector(':scope > .empty')?.remove();
  cards.forEach((placed, index) => {
    const card = shown.get(placed.key) ?? new Card(placed, Boolean(alone));
    shown.set(placed.key, card);
    if (grid.children[index] !== card.element) grid.insertBefore(card.element, grid.children[index] ?? null);
  });
  if (cards.length === 0) grid.append(empty('Nothing here.', 'Add a panel with the plus at the top.'));
  for (const link of rail.querySelectorAll('a')) {
    const isHere = link.dataset.view === (alone ? alone.kind : DASHBOARD);
    if (isHere) link.setAttribute('aria-current', 'page');
    else link.removeAttribute('aria-current');
    if (isHere) link.scrollIntoView({ block: 'nearest', inline: 'center' });
  }
}

function buildRail() {
  const link = (/** @type {string} */ id, /** @type {string} */ title, /** @type {string} */ iconName) =>
    h('a', { href: `#/${id}`, dataset: { view: id }, 'data-testid': `nav-${id}` }, icon(iconName), title);
  rail.replaceChildren(link(DASHBOARD, 'Dashboard', 'dashboard'), h('hr'), ...entries.map((entry) => link(entry.id, entry.title, entry.isOwn ? 'panel' : entry.id)));
}

let builtFor = '';
function build() {
  const name = robot.info?.name ?? '';
  const brought = (robot.info?.panels ?? []).filter(({ script }) => script.startsWith('/panels/'));
  entries = [...PANELS, ...brought.map(({ name: id, title, script }) => ({ id, title, script, width: 4, height: 1, isOwn: true }))];
  buildRail();
  if (builtFor !== name || layout.cards.length === 0) {
    const known = stored.get(layoutKey());
    isEdited = Array.isArray(known?.cards);
    layout = { cards: isEdited ? known.cards.slice(0, MOST_CARDS) : defaultCards(), options: known?.options ?? {} };
    // A link with several panels is a dashboard to share: `#scene+camera`.
    const several = named().split('+').map(entryOf).filter((entry) => entry !== undefined);
    isLinked = several.length > 1;
    if (isLinked) layout = { cards: several.map(({ id, width, height }) => ({ key: id, kind: id, width, height })), options: layout.options };
    builtFor = name;
  }
  arrange();
}
// Topics may appear after the page was opened: a camera, a description of the robot.
robot.addEventListener('channels', () => {
  if (isEdited || isLinked || builtFor !== robot.info?.name || layout.cards.length === 0) return;
  const cards = defaultCards();
  const kinds = (/** @type {Placed[]} */ placed) => placed.map(({ kind, width, height }) => `${kind} ${width} ${height}`).join();
  if (kinds(cards) === kinds(layout.cards)) return;
  layout.cards = cards;
  for (const placed of cards) {
    const card = shown.get(placed.key);
    if (card) { card.placed = placed; card.place(); }
  }
  arrange();
});
window.addEventListener('hashchange', () => {
  // A link with a token opened in this page: the connection needs it from its start.
  if (/token=/.test(location.hash)) { takeToken(); location.reload(); }
  else if (robot.info) arrange();
});

// The first list of channels follows the welcome: the default dashboard needs it.
robot.addEventListener('state', () => {
  showState();
  showPlayback();
  if (robot.state === 'open') { build(); lookAtRecording(); lookAtClock(); }
  else if (shown.size === 0) main.replaceChildren(h('p', { class: 'first', 'data-testid': 'offline' }, `No robot here: ${robot.reason || 'waiting for an answer'}. Trying again…`));
});
showState();

// ---- keyboard

document.querySelector('.skip')?.addEventListener('click', (event) => { event.preventDefault(); main.focus(); });

/** @type {[string, string][]} */
const KEYS = [['0', 'dashboard'], ['1 … 9', 'one panel, in the order of the list'], ['Space', 'pause or play'], ['.', 'one cycle while paused'], ['?', 'this list'],
  ['← → ↑ ↓', '3D: turn; plot: move in time'], ['+ −', '3D, plot: zoom'], ['F, R', '3D: follow the robot, look from the start']];
function showKeys() {
  const dialog = h('dialog', { 'aria-label': 'Keys' }, h('h2', null, 'Keys'),
    h('table', null, h('tbody', null, KEYS.map(([key, meaning]) => h('tr', null, h('td', null, h('kbd', null, key)), h('td', null, meaning))))),
    h('button', { type: 'button', class: 'button', onclick: () => dialog.close() }, 'Close'));
  dialog.addEventListener('close', () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}
document.addEventListener('keydown', (event) => {
  const target = /** @type {HTMLElement} */ (event.target);
  if (event.ctrlKey || event.metaKey || event.altKey || target.closest('input, textarea, select, button, [contenteditable], dialog, [popover]')) return;
  if (event.key === '?') showKeys();
  else if (event.key === '0') show(DASHBOARD);
  else if (/^[1-9]$/.test(event.key)) { const entry = entries[Number(event.key) - 1]; if (entry) show(entry.id); }
  else if (event.key === ' ' && (robot.playback || (robot.info?.canPause && robot.mayChange))) { event.preventDefault(); togglePause(); }
  else if (event.key === '.' && isPaused) act('step');
});
