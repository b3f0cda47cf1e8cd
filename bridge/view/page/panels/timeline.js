// @ts-check
// Cycles as a timeline: which module ran when, on which thread, and for which message.

import { words } from '../connection.js';
import { loadStyle } from '../graph/view.js';
import { empty, fitCanvas, h, iconButton, onTheme, painter, seriesColor, setText, token } from '../panel.js';
import { Timeline, isPhase, niceStep, publishersOf } from './timeline_data.js';

/** @typedef {import('./timeline_data.js').TraceEvent} TraceEvent */
/** @typedef {{ cycles: number, arrows: boolean, table: boolean }} Options */

const PERIOD_MS = 1000;
const CHOICES = [1, 5, 20, 100, 500];
/** @type {Options} */
const DEFAULTS = { cycles: 20, arrows: true, table: false };
const [AXIS, PHASE, BAR, LANE_NAME, LANE_GAP] = [24, 9, 22, 15, 8];
const LANE = LANE_NAME + PHASE + BAR + LANE_GAP + 4;
/** More arrows than this are not drawn at once, and more rows are not listed. */
const [MOST_ARROWS, MOST_ROWS] = [250, 400];
const SHORTEST_NS = 500;

/** @type {import('../panel.js').Panel} */
export default {
  id: 'timeline',
  title: 'Timeline',
  create(root, robot, view) {
    loadStyle(new URL('./timeline.css', import.meta.url));
    const panel = new TimelinePanel(root, robot, view);
    return { destroy: () => panel.destroy() };
  },
};

class TimelinePanel {
  /** @param {HTMLElement} root @param {import('../panel.js').PanelRobot} robot @param {import('../panel.js').View} view */
  constructor(root, robot, view) {
    this.robot = robot;
    this.view = view;
    /** @type {Options} */
    this.options = { ...DEFAULTS, ...view.get() };
    /** @type {Timeline | null} */
    this.timeline = null;
    /** @type {Map<string, string[]>} */
    this.publishers = new Map();
    this.hasGraph = false;
    this.isLive = true;
    this.isPaused = false;
    /** What a step has shown, while the robot stays paused. */
    this.stepped = '';
    this.isAsking = false;
    this.hasEnded = false;
    /** What is in view, in nanoseconds; null shows all. @type {{ begin: number, end: number } | null} */
    this.range = null;
    /** @type {TraceEvent | null} */
    this.focused = null;
    /** @type {TraceEvent | null} */
    this.hovered = null;
    this.scrolled = 0;
    this.tableTimer = 0;
    /** @type {Map<number, { x: number, y: number }>} */
    this.pointers = new Map();

    const choice = h('select', { 'aria-label': 'How many cycles are traced', 'data-testid': 'timeline-cycles',
      onchange: () => { this.set({ cycles: Number(choice.value) }); this.range = null; this.look(true); } },
    CHOICES.map((cycles) => h('option', { value: String(cycles), selected: cycles === this.options.cycles }, cycles === 1 ? '1 cycle' : `${cycles} cycles`)));
    this.liveButton = h('button', { type: 'button', class: 'button', 'data-testid': 'timeline-live', onclick: () => this.setLive(!this.isLive) }, 'Hold');
    this.pauseButton = iconButton('pause', 'Pause the robot’s cycles', () => this.act(this.isPaused ? 'resume' : 'pause'), { 'data-testid': 'timeline-pause' });
    this.stepButton = iconButton('step', 'Run one cycle and show it', () => this.step(), { 'data-testid': 'timeline-step' });
    this.arrowsButton = h('button', { type: 'button', class: 'button', onclick: () => this.set({ arrows: !this.options.arrows }) }, 'Causes');
    this.tableButton = h('button', { type: 'button', class: 'button', 'data-testid': 'timeline-table', onclick: () => this.set({ table: !this.options.table }) }, 'Table');
    const all = h('button', { type: 'button', class: 'button', onclick: () => { this.range = null; this.changed(); } }, 'Show all');
    this.note = h('p', { class: 'notice', hidden: true, role: 'status' });
    this.canvas = h('canvas', { tabIndex: 0, role: 'application', 'aria-label': 'Timeline of the cycles. Arrows go from run to run, plus and minus zoom, the table lists all.', 'data-testid': 'timeline-canvas' });
    this.tip = h('div', { class: 'timeline-tip', hidden: true });
    this.spoken = h('div', { class: 'sr', role: 'status', 'data-testid': 'timeline-focused' });
    this.stage = h('div', { class: 'timeline-stage' }, this.canvas, this.tip, this.spoken);
    this.tables = h('div', { class: 'timeline-table', tabIndex: 0, role: 'region', 'aria-label': 'Runs in view' });
    this.body = h('div', { class: 'timeline' },
      h('div', { class: 'bar-row' }, this.pauseButton, this.stepButton, this.liveButton, choice, all, this.arrowsButton, this.tableButton),
      this.note, this.stage, this.tables);
    root.append(this.body);
    this.showOptions();

    this.painter = painter(() => this.draw());
    this.endings = [fitCanvas(this.canvas, () => this.painter.request()), onTheme(() => this.painter.request())];
    this.canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) this.pan((event.deltaX || event.deltaY) / this.width());
      else this.zoom(Math.exp(event.deltaY * (event.ctrlKey ? 0.01 : 0.0016)), event.offsetX / this.width());
    }, { passive: false });
    this.canvas.addEventListener('pointerdown', (event) => this.pointerDown(event));
    this.canvas.addEventListener('pointermove', (event) => { if (this.pointers.size === 0) this.hover(event); });
    this.canvas.addEventListener('pointerleave', () => { this.hovered = null; this.tip.hidden = true; this.painter.request(); });
    this.canvas.addEventListener('dblclick', (event) => { const hit = this.eventAt(event.offsetX, event.offsetY); if (hit) this.showCycle(hit.cycle); });
    this.canvas.addEventListener('keydown', (event) => {
      if (!this.press(event)) return;
      event.preventDefault();
      event.stopPropagation();
    });
    robot.addEventListener('state', () => { this.hasGraph = false; if (robot.state === 'open') this.look(); });
    robot.every(PERIOD_MS, () => this.look());
  }

  /** @param {Partial<Options>} changes */
  set(changes) {
    this.options = { ...this.options, ...changes };
    this.view.set(this.options);
    this.showOptions();
    this.changed();
  }

  showOptions() {
    this.arrowsButton.setAttribute('aria-pressed', String(this.options.arrows));
    this.tableButton.setAttribute('aria-pressed', String(this.options.table));
    this.body.classList.toggle('is-table', this.options.table);
    setText(this.liveButton, this.isLive ? 'Hold' : 'Live');
    this.liveButton.title = this.isLive ? 'Keep what is shown' : 'Show what runs now';
    const { mayChange, info } = this.robot;
    const may = mayChange && Boolean(info?.canPause);
    const why = !info?.canPause ? 'The clock of this robot cannot be stopped.' : 'Open the link with the token to pause the robot.';
    this.pauseButton.disabled = !may;
    this.stepButton.disabled = !may || !this.isPaused;
    const label = this.isPaused ? 'Let the robot’s cycles run' : 'Pause the robot’s cycles';
    this.pauseButton.setAttribute('aria-label', label);
    this.pauseButton.title = may ? label : why;
    this.stepButton.title = may ? (this.isPaused ? 'Run one cycle and show it' : 'Pause first') : why;
    if (this.pauseButton.dataset.shows !== String(this.isPaused)) {
      this.pauseButton.dataset.shows = String(this.isPaused);
      const fresh = iconButton(this.isPaused ? 'play' : 'pause', label, () => {});
      this.pauseButton.replaceChildren(...fresh.childNodes);
    }
  }

  /** @param {boolean} isLive */
  setLive(isLive) {
    this.isLive = isLive;
    if (isLive) this.range = null;
    this.showOptions();
    if (isLive) this.look();
  }

  /** Asks for the newest cycles, unless one holds. @param {boolean} [isWanted] also then */
  async look(isWanted = false) {
    const { robot } = this;
    if (robot.state !== 'open' || this.isAsking || this.hasEnded) return;
    this.isAsking = true;
    try {
      const { is_paused: isPaused } = await robot.ask('snapshot');
      this.isPaused = isPaused;
      this.showOptions();
      if ((this.isLive || isWanted) && !isPaused && this.pointers.size === 0) this.show(await this.trace(this.options.cycles));
      if (!isPaused) this.stepped = '';
      this.say(isPaused ? this.stepped || 'The robot is paused: step runs one cycle.' : '');
    } catch (error) {
      this.say(words(error));
    } finally {
      this.isAsking = false;
    }
  }

  /** @param {number} cycles @returns {Promise<import('./timeline_data.js').Trace>} */
  async trace(cycles) {
    if (!this.hasGraph) {
      this.publishers = publishersOf(await this.robot.ask('graph'));
      this.hasGraph = true;
    }
    return this.robot.ask('trace', { cycles });
  }

  /** @param {import('./timeline_data.js').Trace} trace */
  show(trace) {
    if (this.hasEnded) return;
    const before = this.timeline;
    this.timeline = new Timeline(trace, this.publishers);
    if (this.range && before && this.isLive) {
      // The same part of the newer cycles, seen from the end.
      const shift = this.timeline.end - before.end;
      this.range = { begin: this.range.begin + shift, end: this.range.end + shift };
    }
    [this.focused, this.hovered] = [null, null];
    this.tip.hidden = true;
    this.stage.style.height = `${AXIS + 6 + Math.max(1, this.timeline.lanes.length) * LANE + 24}px`;
    this.changed();
  }

  /** @param {string} what */
  async act(what) {
    try {
      await this.robot.ask(what);
      this.isPaused = what === 'pause';
      this.say('');
    } catch (error) {
      this.say(words(error));
    }
    this.showOptions();
    await this.look();
  }

  /** One cycle, and what happened in it. */
  async step() {
    try {
      if (!this.hasGraph) this.publishers = publishersOf(await this.robot.ask('graph'));
      this.hasGraph = true;
      this.stepButton.disabled = true;
      const trace = await this.robot.ask('step', { trace: true });
      this.range = null;
      this.show(trace);
      const cycle = this.timeline ? Math.max(...this.timeline.cycles.keys()) : 0;
      this.stepped = Number.isFinite(cycle) ? `The robot is paused. This is cycle ${cycle}.` : '';
      this.say(this.stepped);
    } catch (error) {
      this.say(words(error));
    }
    this.showOptions();
  }

  /** @param {string} text */
  say(text) {
    this.note.hidden = text === '';
    setText(this.note, text);
  }

  /** @param {number} cycle */
  showCycle(cycle) {
    const found = this.timeline?.cycles.get(cycle);
    if (!found) return;
    const margin = (found.end - found.begin) * 0.04;
    this.range = { begin: found.begin - margin, end: found.end + margin };
    this.isLive = false;
    this.showOptions();
    this.changed();
  }

  changed() {
    this.painter.request();
    // While one drags, the tables follow a few times per second.
    this.tableTimer ||= window.setTimeout(() => {
      this.tableTimer = 0;
      if (!this.hasEnded) this.showTables();
    }, 120);
  }

  // Time and pixels

  width() { return Math.max(1, this.canvas.clientWidth); }

  window() {
    const { begin, end } = this.range ?? { begin: this.timeline?.begin ?? 0, end: this.timeline?.end ?? 1 };
    if (this.range) return { begin, end, span: Math.max(1, end - begin) };
    const margin = Math.max(1, end - begin) * 0.01;
    return { begin: begin - margin, end: end + margin, span: Math.max(1, end - begin + 2 * margin) };
  }

  /** @param {number} factor of the time in view @param {number} at 0 to 1 from the left */
  zoom(factor, at = 0.5) {
    if (!this.timeline) return;
    const { begin, span } = this.window();
    const all = this.timeline.end - this.timeline.begin;
    const next = Math.min(Math.max(all * 1.5, SHORTEST_NS), Math.max(SHORTEST_NS, span * factor));
    const middle = begin + span * at;
    this.range = { begin: middle - next * at, end: middle + next * (1 - at) };
    this.changed();
  }

  /** @param {number} by part of what is in view */
  pan(by) {
    if (!this.timeline) return;
    const { begin, span } = this.window();
    const wanted = Math.min(this.timeline.end - span * 0.1, Math.max(this.timeline.begin - span * 0.9, begin + by * span));
    this.range = { begin: wanted, end: wanted + span };
    this.changed();
  }

  /** Brings an event into view. @param {TraceEvent} event */
  reveal({ begin_ns: begin, end_ns: end }) {
    const view = this.window();
    if (begin >= view.begin && end <= view.end) return;
    const middle = (begin + end) / 2;
    const span = Math.max(view.span, (end - begin) * 1.5);
    this.range = { begin: middle - span / 2, end: middle + span / 2 };
  }

  /** @param {number} index of the lane */
  laneTop(index) { return AXIS + 6 + index * LANE - this.scrolled; }

  /** @param {number} x @param {number} y @returns {TraceEvent | null} */
  eventAt(x, y) {
    const { timeline } = this;
    if (!timeline) return null;
    const lane = timeline.lanes[Math.floor((y - this.laneTop(0)) / LANE)];
    if (!lane) return null;
    const { begin, span } = this.window();
    const inside = (y - this.laneTop(0)) % LANE;
    const time = begin + (x / this.width()) * span;
    const slack = (3 / this.width()) * span;
    return timeline.at(inside < LANE_NAME + PHASE && lane.phases.length > 0 ? lane.phases : lane.work, time, slack) ?? timeline.at(lane.work, time, slack);
  }

  // Drawing

  draw() {
    const context = this.canvas.getContext('2d');
    if (!context) return;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const scale = this.canvas.width / Math.max(1, width);
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, width, height);
    const { timeline } = this;
    if (!timeline || timeline.events.length === 0) return;
    this.scrolled = Math.max(0, Math.min(this.scrolled, timeline.lanes.length * LANE + AXIS + 6 - height));
    const { begin, end, span } = this.window();
    const x = (/** @type {number} */ time) => ((time - begin) / span) * width;
    const [surface, muted, line, text] = ['--surface', '--muted', '--line', '--text'].map(token);
    context.font = '11px system-ui, sans-serif';
    context.textBaseline = 'alphabetic';

    // Cycles as stripes, and where they begin.
    let last = -Infinity;
    for (const [cycle, { begin: from, end: to }] of timeline.cycles) {
      if (to < begin || from > end) continue;
      context.fillStyle = token('--raised');
      context.fillRect(x(from), AXIS, Math.max(1, x(to) - x(from)), height);
      context.fillStyle = line;
      context.fillRect(Math.round(x(from)), AXIS, 1, height);
      if (x(from) - last < 74) continue;
      last = x(from);
      context.fillStyle = muted;
      context.fillText(`cycle ${cycle}`, x(from) + 4, height - 6);
    }
    this.drawAxis(context, width, begin, span, muted, line);
    context.save();
    context.beginPath();
    context.rect(0, AXIS, width, height - AXIS);
    context.clip();
    timeline.lanes.forEach((lane, index) => {
      const top = this.laneTop(index);
      if (top > height || top + LANE < 0) return;
      context.fillStyle = line;
      context.fillRect(0, top + LANE - 3, width, 1);
      this.drawEvents(context, lane.phases, top + LANE_NAME, PHASE - 2, x, begin, end, (event) => token(event.kind === 'sync' ? '--line-strong' : '--stale'), null);
      this.drawEvents(context, lane.work, top + LANE_NAME + PHASE, BAR, x, begin, end, (event) => this.color(event), surface);
      context.font = '600 11px system-ui, sans-serif';
      const name = lane.name || `thread ${index + 1}`;
      context.fillStyle = surface;
      context.globalAlpha = 0.8;
      context.fillRect(2, top, context.measureText(name).width + 10, LANE_NAME - 2);
      context.globalAlpha = 1;
      context.fillStyle = text;
      context.fillText(name, 7, top + 10);
    });
    this.drawArrows(context, x, begin, end);
    for (const event of [this.hovered, this.focused]) if (event) this.outline(context, event, x, text);
    context.restore();
  }

  /** @param {CanvasRenderingContext2D} context @param {number} width @param {number} begin @param {number} span @param {string} muted @param {string} line */
  drawAxis(context, width, begin, span, muted, line) {
    const origin = this.timeline?.begin ?? 0;
    const step = niceStep(span, width / 90);
    context.fillStyle = muted;
    for (let tick = Math.ceil((begin - origin) / step) * step; tick <= begin - origin + span; tick += step) {
      const at = ((tick + origin - begin) / span) * width;
      context.fillStyle = line;
      context.fillRect(Math.round(at), AXIS - 5, 1, 5);
      context.fillStyle = muted;
      context.fillText(time(tick, step), at + 4, 15);
    }
    context.fillStyle = line;
    context.fillRect(0, AXIS, width, 1);
  }

  /**
   * @param {CanvasRenderingContext2D} context @param {TraceEvent[]} events @param {number} top @param {number} height
   * @param {(time: number) => number} x @param {number} begin @param {number} end @param {(event: TraceEvent) => string} color @param {string | null} label
   */
  drawEvents(context, events, top, height, x, begin, end, color, label) {
    let drawn = -Infinity;
    context.font = '11px system-ui, sans-serif';
    for (const event of events) {
      if (event.begin_ns > end) break;
      if (event.end_ns < begin) continue;
      const [left, right] = [x(event.begin_ns), x(event.end_ns)];
      // What lies within a pixel that is drawn already adds nothing.
      if (right < drawn + 0.6) continue;
      const width = Math.max(1.2, right - left);
      drawn = left + width;
      context.fillStyle = color(event);
      context.fillRect(left, top, width, height);
      if (!label || width < 26 || !event.module) continue;
      context.save();
      context.beginPath();
      context.rect(left, top, width - 3, height);
      context.clip();
      context.fillStyle = label;
      context.fillText(event.module, Math.max(left, 0) + 4, top + 15);
      context.restore();
    }
  }

  /** @param {TraceEvent} event */
  color(event) { return seriesColor(this.timeline?.modules.indexOf(event.module ?? '') ?? 0); }

  /** @param {TraceEvent} event */
  rowOf(event) {
    const lane = this.timeline?.lanes.findIndex(({ phases, work }) => (isPhase(event) ? phases : work).includes(event)) ?? -1;
    return this.laneTop(lane) + LANE_NAME + (isPhase(event) ? 0 : PHASE);
  }

  /** @param {CanvasRenderingContext2D} context @param {(time: number) => number} x @param {number} begin @param {number} end */
  drawArrows(context, x, begin, end) {
    const { timeline } = this;
    if (!timeline) return;
    const chosen = this.hovered ?? this.focused;
    const strong = chosen ? timeline.chainOf(chosen) : [];
    const events = this.options.arrows ? timeline.within(begin, end) : [];
    const faint = events.length > MOST_ARROWS ? [] : events.flatMap((event) => timeline.causesOf(event));
    for (const [arrows, color, width, alpha] of /** @type {const} */ ([[faint, token('--muted'), 1, 0.55], [strong, token('--accent'), 2, 1]])) {
      context.strokeStyle = color;
      context.fillStyle = color;
      context.lineWidth = width;
      context.globalAlpha = alpha;
      for (const { event, cause } of arrows) {
        // Both ends are to be seen.
        if (cause.end_ns < begin || cause.end_ns > end || event.begin_ns < begin || event.begin_ns > end) continue;
        const [x1, y1, x2, y2] = [x(cause.end_ns), this.rowOf(cause) + BAR / 2, x(event.begin_ns), this.rowOf(event) + BAR / 2];
        const isSame = Math.abs(y1 - y2) < 1;
        const bow = isSame ? BAR / 2 + 5 : 0;
        context.beginPath();
        context.moveTo(x1, isSame ? y1 + BAR / 2 : y1);
        const reach = Math.max(6, Math.abs(x2 - x1) / 2);
        if (isSame) context.bezierCurveTo(x1, y1 + bow + 6, x2, y2 + bow + 6, x2, y2 + BAR / 2);
        else context.bezierCurveTo(x1 + reach, y1, x2 - reach, y2, x2, y2);
        context.stroke();
        context.beginPath();
        if (isSame) { context.moveTo(x2, y2 + BAR / 2 - 1); context.lineTo(x2 - 3.5, y2 + BAR / 2 + 5); context.lineTo(x2 + 3.5, y2 + BAR / 2 + 5); }
        else { context.moveTo(x2 + 1, y2); context.lineTo(x2 - 6, y2 - 3.5); context.lineTo(x2 - 6, y2 + 3.5); }
        context.fill();
      }
      context.globalAlpha = 1;
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {TraceEvent} event @param {(time: number) => number} x @param {string} color */
  outline(context, event, x, color) {
    context.strokeStyle = color;
    context.lineWidth = 2;
    context.strokeRect(x(event.begin_ns) - 1, this.rowOf(event) - 1, Math.max(2, x(event.end_ns) - x(event.begin_ns)) + 2, (isPhase(event) ? PHASE - 2 : BAR) + 2);
  }

  // Pointers and keys

  /** @param {PointerEvent} event */
  pointerDown(event) {
    if (event.button !== 0) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    this.tip.hidden = true;
    let hasMoved = false;
    const start = { x: event.offsetX, y: event.offsetY };
    const move = (/** @type {PointerEvent} */ moved) => {
      const last = this.pointers.get(moved.pointerId);
      if (!last) return;
      const now = { x: moved.offsetX, y: moved.offsetY };
      if (!hasMoved && Math.hypot(now.x - start.x, now.y - start.y) < 4) return;
      hasMoved = true;
      const other = [...this.pointers].find(([id]) => id !== moved.pointerId)?.[1];
      if (other) {
        const [before, after] = [Math.abs(last.x - other.x), Math.abs(now.x - other.x)];
        if (before > 5 && after > 5) this.zoom(before / after, (now.x + other.x) / 2 / this.width());
      } else {
        this.pan((last.x - now.x) / this.width());
        this.scrolled += last.y - now.y;
      }
      this.pointers.set(moved.pointerId, now);
    };
    const end = (/** @type {PointerEvent} */ ended) => {
      if (ended.pointerId !== event.pointerId) return;
      this.pointers.delete(event.pointerId);
      this.canvas.removeEventListener('pointermove', move);
      this.canvas.removeEventListener('pointerup', end);
      this.canvas.removeEventListener('pointercancel', end);
      if (!hasMoved && ended.type === 'pointerup') this.focusOn(this.eventAt(ended.offsetX, ended.offsetY));
    };
    this.canvas.addEventListener('pointermove', move);
    this.canvas.addEventListener('pointerup', end);
    this.canvas.addEventListener('pointercancel', end);
  }

  /** @param {PointerEvent} event */
  hover(event) {
    const found = this.eventAt(event.offsetX, event.offsetY);
    if (found !== this.hovered) this.painter.request();
    this.hovered = found;
    this.showTip(found, event.offsetX, event.offsetY);
  }

  /** @param {TraceEvent | null} event @param {number} x @param {number} y */
  showTip(event, x, y) {
    this.tip.hidden = event === null;
    if (!event) return;
    this.tip.replaceChildren(h('b', null, nameOf(event)), ...this.facts(event).map((fact) => h('p', null, fact)));
    const [width, height] = [this.tip.offsetWidth, this.tip.offsetHeight];
    this.tip.style.left = `${Math.max(4, Math.min(x + 14, this.stage.clientWidth - width - 4))}px`;
    this.tip.style.top = `${y + 18 + height > this.stage.clientHeight ? Math.max(2, y - height - 10) : y + 18}px`;
  }

  /** @param {TraceEvent} event */
  facts(event) {
    const causes = (event.causes ?? []).map((cause) => {
      const arrow = this.timeline?.causesOf(event).find(({ topic }) => cause.endsWith(topic));
      return arrow ? `${cause}, from ${arrow.cause.module}` : cause;
    });
    return [`${lasting(event.end_ns - event.begin_ns)} · cycle ${event.cycle}${event.kind === 'step' ? ' · detached' : ''}`, ...(causes.length > 0 ? [`because of ${causes.join(', ')}`] : [])];
  }

  /** @param {TraceEvent | null} event */
  focusOn(event) {
    this.focused = event;
    if (event) {
      // What one looks at stays.
      if (this.isLive) {
        this.range = this.window();
        this.setLive(false);
      }
      this.reveal(event);
      setText(this.spoken, `${nameOf(event)}, ${this.facts(event).join(', ')}`);
      const { begin, span } = this.window();
      this.showTip(event, ((event.begin_ns - begin) / span) * this.width(), this.rowOf(event) + BAR);
    } else {
      this.tip.hidden = true;
    }
    this.changed();
  }

  /** @param {KeyboardEvent} event */
  press(event) {
    const { timeline } = this;
    if (!timeline || event.ctrlKey || event.metaKey || event.altKey) return false;
    const step = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -1, ArrowDown: 1 }[event.key];
    const isAlong = event.key === 'ArrowLeft' || event.key === 'ArrowRight';
    if (event.key === '+' || event.key === '=') return this.zoom(0.6), true;
    if (event.key === '-') return this.zoom(1 / 0.6), true;
    if (event.key === '0') return this.range = null, this.changed(), true;
    if (event.key === 'Escape' && this.focused) return this.focusOn(null), true;
    if (event.key === 'Enter' && this.focused) return this.showCycle(this.focused.cycle), true;
    if (step === undefined) return false;
    if (event.shiftKey && isAlong) return this.pan(step * 0.2), true;
    const { begin, end } = this.window();
    const lane = timeline.lanes.findIndex(({ work }) => this.focused !== null && work.includes(this.focused));
    if (lane < 0) return this.focusOn(timeline.within(begin, end).find((each) => !isPhase(each)) ?? null), true;
    if (isAlong) {
      const { work } = timeline.lanes[lane];
      const next = work[work.indexOf(/** @type {TraceEvent} */ (this.focused)) + step];
      if (next) this.focusOn(next);
      return true;
    }
    for (let at = lane + step; at >= 0 && at < timeline.lanes.length; at += step) {
      const { work } = timeline.lanes[at];
      const time = this.focused?.begin_ns ?? 0;
      const near = [...work].sort((a, b) => Math.abs(a.begin_ns - time) - Math.abs(b.begin_ns - time))[0];
      if (near) return this.focusOn(near), true;
    }
    return true;
  }

  // Tables

  showTables() {
    const { timeline } = this;
    if (!timeline || timeline.events.length === 0) {
      this.tables.replaceChildren(...(timeline ? [empty('No cycle ran.')] : []));
      return;
    }
    const { begin, end } = this.range ?? timeline;
    const rows = timeline.statistics(begin, end).map(({ module, runs, median, longest, share }) => h('tr', { dataset: { module } },
      h('th', { scope: 'row' }, h('i', { class: 'swatch', style: { background: seriesColor(timeline.modules.indexOf(module)) } }), module),
      h('td', { class: 'number' }, String(runs)), h('td', { class: 'number' }, lasting(median)), h('td', { class: 'number' }, lasting(longest)),
      h('td', { class: 'number wide' }, `${(share * 100).toFixed(1)} %`)));
    const heads = (/** @type {[string, string][]} */ ...names) => h('thead', null, h('tr', null, names.map(([name, kind]) => h('th', { scope: 'col', class: kind }, name))));
    const statistics = h('table', { 'data-testid': 'timeline-statistics' }, h('caption', null, `Runs within ${lasting(end - begin)} in view`),
      heads(['Module', ''], ['Runs', 'number'], ['Median', 'number'], ['Longest', 'number'], ['Share of the time', 'number wide']), h('tbody', null, rows));
    this.view.setTitle(`${timeline.cycles.size} ${timeline.cycles.size === 1 ? 'cycle' : 'cycles'} in ${lasting(timeline.end - timeline.begin)}`);
    if (!this.options.table) {
      this.tables.replaceChildren(statistics);
      return;
    }
    const events = timeline.within(begin, end);
    const list = h('table', { 'data-testid': 'timeline-events' },
      h('caption', null, events.length > MOST_ROWS ? `The first ${MOST_ROWS} of ${events.length}` : 'In the order of time'),
      heads(['What', ''], ['Begins', 'number'], ['Lasts', 'number'], ['Cycle', 'number'], ['Thread', 'wide'], ['Cause', '']),
      h('tbody', null, events.slice(0, MOST_ROWS).map((event) => h('tr', null, h('td', null, nameOf(event)), h('td', { class: 'number' }, lasting(event.begin_ns - timeline.begin)),
        h('td', { class: 'number' }, lasting(event.end_ns - event.begin_ns)), h('td', { class: 'number' }, String(event.cycle)),
        h('td', { class: 'wide' }, timeline.lanes.find(({ phases, work }) => (isPhase(event) ? phases : work).includes(event))?.name ?? ''), h('td', null, (event.causes ?? []).join(', '))))));
    this.tables.replaceChildren(statistics, list);
  }

  destroy() {
    this.hasEnded = true;
    clearTimeout(this.tableTimer);
    this.painter.stop();
    for (const end of this.endings) end();
    this.body.remove();
  }
}

/** @param {TraceEvent} event */
function nameOf({ kind, module }) {
  return module ?? (kind === 'process' ? 'Process phase' : kind === 'sync' ? 'Sync phase' : kind);
}

/** @param {number} ns */
function lasting(ns) {
  if (ns < 1e3) return `${ns.toFixed(0)} ns`;
  if (ns < 1e6) return `${(ns / 1e3).toFixed(ns < 1e4 ? 1 : 0)} µs`;
  if (ns < 1e9) return `${(ns / 1e6).toFixed(ns < 1e7 ? 2 : 1)} ms`;
  return `${(ns / 1e9).toFixed(2)} s`;
}

/** A time on the axis. @param {number} ns @param {number} step */
function time(ns, step) {
  const [unit, size] = step >= 1e8 ? ['s', 1e9] : step >= 1e4 ? ['ms', 1e6] : ['µs', 1e3];
  const digits = Math.max(0, Math.min(3, -Math.floor(Math.log10(step / size))));
  return `${(ns / size).toFixed(digits).replace('-', '−')} ${unit}`;
}
