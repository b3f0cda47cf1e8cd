// @ts-check
// The graph of modules and topics, live.

import { numericPaths } from '../cdr.js';
import { words } from '../connection.js';
import { GraphView, loadStyle } from '../graph/view.js';
import { bytes, empty, h, icon, iconButton, rate, setText } from '../panel.js';
import { ChainTable, Chains, drawnOf, wayBetween } from './graph_chains.js';
import { History, count, edgesOf, isDebug, ms, summary } from './graph_data.js';

/**
 * @typedef {import('./graph_data.js').Graph} Graph
 * @typedef {import('./graph_data.js').Shown} Shown
 * @typedef {{ mode: 'nodes' | 'labels', debug: boolean, outlets: boolean, services: boolean, group: boolean | null, bar: boolean,
 *   chain: string | null }} Options  `chain`: the name of the chain that is marked
 */

const PERIOD_MS = 500;
/** Every so many looks, the chains are asked for too. */
const CHAIN_PERIOD = 2;
/** The graph is asked for again when the snapshot names others, and now and then. */
const GRAPH_PERIOD = 20;
/** More topics than this are grouped unless one says otherwise. */
const MANY_TOPICS = 40;
const LONGEST_PREVIEW = 6000;
/** How many fields of a topic are plotted at first. */
const MOST_LINES = 8;
/** @type {Options} */
const DEFAULTS = { mode: 'nodes', debug: false, outlets: true, services: false, group: null, bar: false, chain: null };

/** @type {import('../panel.js').Panel} */
export default {
  id: 'graph',
  title: 'Graph',
  create(root, robot, view) {
    loadStyle(new URL('./graph.css', import.meta.url));
    const panel = new GraphPanel(root, robot, view);
    return { destroy: () => panel.destroy() };
  },
};

class GraphPanel {
  /** @param {HTMLElement} root @param {import('../panel.js').PanelRobot} robot @param {import('../panel.js').View} view */
  constructor(root, robot, view) {
    this.robot = robot;
    this.view = view;
    /** @type {Options} */
    this.options = { ...DEFAULTS, ...view.get() };
    this.history = new History();
    /** @type {Graph | null} */
    this.graph = null;
    this.graphText = '';
    this.looks = 0;
    this.chains = new Chains();
    /** Robots without chains are asked once. */
    this.hasChains = true;
    /** What shows the chosen chain. @type {ReturnType<typeof drawnOf> | null} */
    this.chain = null;
    /** @type {Shown | null} */
    this.shown = null;
    /** @type {(() => void) | null} */
    this.endDetail = null;
    /** @type {any[] | null} */
    this.settings = null;
    this.isAsking = false;
    this.hasEnded = false;

    this.search = h('input', { type: 'search', placeholder: 'Find a module or topic', 'aria-label': 'Find a module or topic', 'data-testid': 'graph-search',
      oninput: () => this.find(),
      onkeydown: (/** @type {KeyboardEvent} */ event) => { if (event.key === 'Enter') this.goToFirst(); } });
    const check = (/** @type {'debug' | 'outlets' | 'services' | 'group'} */ name, /** @type {string} */ label) => {
      const input = h('input', { type: 'checkbox', 'data-testid': `graph-${name}`, onchange: () => this.set({ [name]: input.checked }) });
      this.checks = { ...this.checks, [name]: input };
      return h('label', null, input, label);
    };
    /** @type {Record<string, HTMLInputElement>} */
    this.checks = {};
    this.modes = h('div', { class: 'segments', role: 'group', 'aria-label': 'Topics are drawn as' },
      [['nodes', 'Nodes'], ['labels', 'Labels']].map(([mode, label]) =>
        h('button', { type: 'button', 'aria-pressed': 'false', dataset: { mode }, onclick: () => this.set({ mode: /** @type {any} */ (mode) }) }, label)));
    this.bar = h('div', { class: 'bar-row' }, this.search, this.modes, check('group', 'Group topics'), check('debug', 'Debug'),
      check('services', 'Services'), check('outlets', 'Outlets'));
    this.barButton = iconButton('search', 'Find and filter', () => this.set({ bar: !this.options.bar }), { 'aria-expanded': 'false', 'data-testid': 'graph-filter' });
    view.header.append(this.barButton);
    this.place = h('div', { class: 'graph-place' });
    this.detail = h('aside', { class: 'graph-detail', hidden: true, tabIndex: 0, 'aria-label': 'Selected', 'data-testid': 'graph-detail' });
    this.chainTable = new ChainTable((name) => this.chooseChain(name));
    this.body = h('div', { class: 'graph-panel' }, this.bar, h('div', { class: 'graph-rest' }, this.place, this.detail), this.chainTable.element);
    root.append(this.body);
    this.drawing = new GraphView(this.place, {
      label: 'Modules and topics of the robot',
      direction: 'fitting',
      onSelect: (id) => this.select(id),
      onSelectEdge: (id) => { if (id) this.selectEdge(id); else if (!this.drawing.selected) this.closeDetail(); },
    });
    this.showOptions();
    robot.addEventListener('state', () => {
      if (robot.state !== 'open') return;
      this.history = new History();
      this.chains = new Chains();
      [this.looks, this.settings, this.hasChains] = [0, null, true];
      this.look();
    });
    robot.every(PERIOD_MS, () => this.look());
  }

  /** @param {Partial<Options>} changes */
  set(changes) {
    this.options = { ...this.options, ...changes };
    this.view.set(this.options);
    this.showOptions();
    if (Object.keys(changes).some((name) => name !== 'bar')) this.draw(false);
    else if (changes.bar) this.search.focus();
  }

  isGrouping() {
    return this.options.group ?? (this.graph ? this.graph.topics.filter(({ name }) => this.options.debug || !isDebug(name)).length > MANY_TOPICS : false);
  }

  showOptions() {
    const { mode, bar } = this.options;
    this.bar.hidden = !bar;
    this.barButton.setAttribute('aria-expanded', String(bar));
    this.barButton.setAttribute('aria-pressed', String(bar));
    for (const button of this.modes.querySelectorAll('button')) button.setAttribute('aria-pressed', String(button.dataset.mode === mode));
    for (const [name, input] of Object.entries(this.checks)) input.checked = name === 'group' ? this.isGrouping() : Boolean(this.options[/** @type {'debug'} */ (name)]);
    this.checks.group.disabled = mode === 'labels';
  }

  async look() {
    const { robot } = this;
    if (robot.state !== 'open' || this.isAsking) return;
    this.isAsking = true;
    try {
      const snapshot = await robot.ask('snapshot');
      if (this.hasEnded) return;
      this.history.add(snapshot);
      const names = new Set([...(this.graph?.modules ?? []), ...(this.graph?.topics ?? [])].map(({ name }) => name));
      const hasNews = [...snapshot.modules, ...snapshot.topics].some(({ name }) => !names.has(name));
      if (!this.graph || hasNews || this.looks % GRAPH_PERIOD === 0) await this.lookAtGraph();
      if (this.hasChains && this.looks % CHAIN_PERIOD === 0) await this.lookAtChains();
      this.looks += 1;
      if (!this.hasEnded) this.update();
    } catch (error) {
      if (!this.hasEnded && !this.graph) this.showProblem(words(error));
    } finally {
      this.isAsking = false;
    }
  }

  async lookAtChains() {
    const reports = await this.robot.ask('latencies');
    if (this.hasEnded) return;
    this.hasChains = reports.length > 0;
    const isFirst = this.chains.reports.length === 0;
    this.chains.add(reports, performance.now());
    if (isFirst) this.markChain();
  }

  async lookAtGraph() {
    const graph = await this.robot.ask('graph');
    const text = JSON.stringify(graph);
    if (this.hasEnded || text === this.graphText) return;
    const isFirst = this.graph === null;
    [this.graph, this.graphText] = [graph, text];
    this.problem?.remove();
    this.place.hidden = false;
    this.showOptions();
    this.draw(!isFirst);
  }

  /** @param {string} text */
  showProblem(text) {
    this.problem?.remove();
    this.problem = empty('There is no graph to show.', text);
    this.place.hidden = true;
    this.body.append(this.problem);
  }

  /** @param {boolean} keepPlaces */
  draw(keepPlaces) {
    if (!this.graph) return;
    this.shown = edgesOf(this.graph, { ...this.options, group: this.isGrouping() });
    const { modules, topics } = this.shown;
    this.view.setTitle(`${modules} modules, ${topics} topics`);
    const nodes = this.shown.nodes.map((node) => ({ ...node, ...this.values(node) }));
    this.drawing.show({ nodes, edges: this.shown.edges }, { keepPlaces });
    this.markChain();
  }

  /** @param {string | null} name */
  chooseChain(name) {
    this.options = { ...this.options, chain: name };
    this.view.set(this.options);
    this.drawing.select(null);
    this.markChain();
  }

  /** Marks the chosen chain in what is drawn. */
  markChain() {
    const chain = this.options.chain === null ? undefined : this.chains.named(this.options.chain);
    this.chain = chain && this.graph && this.shown ? drawnOf(this.shown, wayBetween(this.graph, chain)) : null;
    this.update();
    this.find();
  }

  /** What a node shows now. @param {import('./graph_data.js').ShownNode} node */
  values(node) {
    if (node.kind === 'module') {
      const now = this.history.module(node.title);
      if (!now) return {};
      const { text, badge, tone } = summary(now);
      return { lines: text, badge, tone, meter: now.share, isFaint: now.hz === 0 && !tone };
    }
    if (node.kind === 'topic' || node.kind === 'topics') {
      const now = (node.topics ?? []).map((name) => this.history.topic(name)).filter((each) => each !== null);
      const hz = now.reduce((sum, each) => sum + each.hz, 0);
      const drops = now.reduce((sum, each) => sum + each.dropsPerSecond, 0);
      const tone = drops > 0 ? /** @type {const} */ ('late') : undefined;
      // The end of the chosen chain shows the age of its messages.
      const chain = this.options.chain === null ? undefined : this.chains.named(this.options.chain);
      if (chain && chain.messages > 0 && node.topics?.includes(chain.to)) {
        return { value: ms(chain.p50_ns), tone: this.chains.isAbove(chain.name, performance.now()) ? /** @type {const} */ ('late') : tone, isFaint: hz === 0 };
      }
      return { value: drops > 0 ? `drops ${rate(drops)}/s` : hz > 0 ? `${rate(hz)} Hz` : '–', tone, isFaint: hz === 0 };
    }
    if (node.kind === 'outlet') {
      const now = this.history.outlet(node.title);
      if (!now) return {};
      const drops = now.dropsPerSecond > 0;
      return { value: drops ? `drops ${rate(now.dropsPerSecond)}/s` : now.inbox > 0 ? `queue ${now.inbox}` : '', tone: drops ? /** @type {const} */ ('late') : undefined };
    }
    return {};
  }

  update() {
    if (!this.shown) return;
    const [now, { chain }] = [performance.now(), this.options];
    const isAbove = chain !== null && this.chains.isAbove(chain, now);
    for (const node of this.shown.nodes) this.drawing.update(node.id, this.values(node));
    for (const edge of this.shown.edges) {
      const hz = edge.topics.reduce((sum, name) => sum + (this.history.topic(name)?.hz ?? 0), 0);
      this.drawing.updateEdge(edge.id, { weight: Math.round((1.1 + Math.log10(1 + hz) * 0.45) * 10) / 10, isFaint: hz === 0 && edge.topics.length > 0,
        tone: isAbove && this.chain?.edges.has(edge.id) ? 'late' : undefined });
    }
    this.chainTable.show(this.chains, chain, now);
    this.refreshDetail?.();
  }

  find() {
    const wanted = this.search.value.trim().toLowerCase();
    this.found = wanted === '' || !this.shown ? null : this.shown.nodes.filter(({ title, topics }) =>
      title.toLowerCase().includes(wanted) || (topics ?? []).some((name) => name.toLowerCase().includes(wanted)));
    // What is searched for goes before the chosen chain.
    if (this.found) this.drawing.highlight(new Set(this.found.map(({ id }) => id)));
    else this.drawing.highlight(this.chain?.nodes ?? null, this.chain?.edges);
  }

  goToFirst() {
    const first = this.found?.[0];
    if (!first) return;
    this.drawing.focus(first.id);
    this.drawing.select(first.id);
  }

  // What is selected

  closeDetail() {
    this.endDetail?.();
    this.endDetail = null;
    this.refreshDetail = undefined;
    this.detail.hidden = true;
  }

  /** @param {string} title @param {HTMLElement | null} chip @param {(HTMLElement | SVGElement | null)[]} content */
  openDetail(title, chip, content) {
    this.closeDetail();
    this.detail.replaceChildren(
      h('div', { class: 'graph-detail-head' }, h('h3', { 'data-testid': 'graph-detail-title' }, title), chip,
        iconButton('close', 'Close', () => { this.drawing.select(null); this.drawing.selectEdge(null); this.closeDetail(); })),
      ...content.filter((each) => each !== null));
    this.detail.hidden = false;
    this.detail.scrollTop = 0;
    requestAnimationFrame(() => { if (this.drawing.selected) this.drawing.reveal(this.drawing.selected); });
  }

  /** @param {string | null} id */
  select(id) {
    const node = this.shown?.nodes.find((each) => each.id === id);
    if (!node) this.closeDetail();
    else if (node.kind === 'module') this.openModule(node.title);
    else if (node.kind === 'topic') this.openTopic(node.title);
    else if (node.kind === 'topics') this.openTopics(node.topics ?? []);
    else if (node.kind === 'service') this.openService(node.title);
    else this.openOutlet(node.title);
  }

  /** @param {string} id */
  selectEdge(id) {
    const edge = this.shown?.edges.find((each) => each.id === id);
    if (edge?.topics.length === 1) this.openTopic(edge.topics[0]);
    else if (edge && edge.topics.length > 1) this.openTopics(edge.topics);
  }

  /** Goes to the node of a module or topic, also if it is not drawn as one. @param {'module' | 'topic'} kind @param {string} name */
  goTo(kind, name) {
    const node = this.shown?.nodes.find((each) => each.kind === kind && each.title === name);
    if (node) {
      this.drawing.select(node.id);
      this.drawing.reveal(node.id);
    } else if (kind === 'topic') this.openTopic(name);
  }

  /** @param {string} name @param {'module' | 'topic'} kind */
  link(name, kind) {
    const value = h('span', null);
    const update = () => {
      const now = kind === 'topic' ? this.history.topic(name) : this.history.module(name);
      setText(value, now && now.hz > 0 ? `${rate(now.hz)} Hz` : '–');
    };
    update();
    return { element: h('li', null, h('button', { type: 'button', onclick: () => this.goTo(kind, name) }, h('span', null, name), value)), update };
  }

  /** @param {string} title @param {string[]} names @param {'module' | 'topic'} kind */
  links(title, names, kind) {
    const links = names.map((name) => this.link(name, kind));
    return { elements: names.length === 0 ? [] : [h('h4', null, title), h('ul', null, links.map(({ element }) => element))],
      update: () => links.forEach((each) => each.update()) };
  }

  /** Which modules publish and subscribe. @param {string} topic */
  endsOf(topic) {
    const { modules = [], topics = [], edges = [], outlets = [] } = this.graph ?? {};
    const index = topics.findIndex(({ name }) => name === topic);
    const named = (/** @type {'publishes' | 'subscribes'} */ kind) => edges.flatMap((edge) => (edge[kind]?.topic === index ? [modules[edge[kind].module].name] : []));
    return { publishers: [...new Set(named('publishes'))], subscribers: [...new Set(named('subscribes'))],
      outlets: [...new Set(edges.flatMap(({ leaves }) => (leaves?.topic === index ? [outlets[leaves.outlet].name] : [])))] };
  }

  /** @param {string} name */
  openModule(name) {
    const about = this.robot.info?.modules?.[name];
    const { modules = [], topics = [], services = [], edges = [] } = this.graph ?? {};
    const index = modules.findIndex((each) => each.name === name);
    const of = (/** @type {'publishes' | 'subscribes'} */ kind) => edges.flatMap((edge) => (edge[kind]?.module === index ? [topics[edge[kind].topic].name] : []));
    const servicesOf = (/** @type {'calls' | 'serves'} */ kind) => edges.flatMap((edge) => (edge[kind]?.module === index ? [services[edge[kind].service].name] : []));
    const published = this.links('Publishes', of('publishes'), 'topic');
    const subscribed = this.links('Subscribes', of('subscribes'), 'topic');
    const chip = h('span', { class: 'chip' });
    const facts = h('dl', { 'data-testid': 'graph-facts' });
    const spark = sparkline('Share of a core over the last minute');
    const settings = h('div', { 'data-testid': 'graph-settings' });
    const source = about ? [h('h4', null, 'Made from'), h('p', null, `kind ${about.kind}`), about.source ? h('p', { class: 'mono muted' }, about.source) : null] : [];
    const serviceLines = /** @type {const} */ (['serves', 'calls']).flatMap((kind) => {
      const names = servicesOf(kind);
      return names.length === 0 ? [] : [h('h4', null, kind === 'serves' ? 'Serves' : 'Calls'), ...names.map((each) => h('p', null, each))];
    });
    this.openDetail(name, chip, [facts, spark.element, ...source, settings, ...published.elements, ...subscribed.elements, ...serviceLines]);
    this.refreshDetail = () => {
      const now = this.history.module(name);
      if (!now) return;
      const { tone, badge } = summary(now);
      chip.className = `chip ${tone === 'failed' || tone === 'restarting' ? 'error' : tone === 'late' ? 'warn' : now.state === 'active' ? 'ok' : ''}`;
      setText(chip, tone === 'late' ? badge ?? '' : now.state);
      chip.dataset.testid = 'graph-state';
      showFacts(facts, [
        ['Rate', `${rate(now.hz)} Hz`],
        ['Run time, median', ms(now.p50)], ['99th percentile', ms(now.p99), now.isLong], ['Longest', ms(now.longest)],
        ['Share of a core', `${(now.share * 100).toFixed(1)} %`],
        ['Runs', count(now.runs)], ['Received', count(now.received)], ['Published', count(now.published)],
        ['Past its deadline', count(now.overruns), now.isOverrunning],
        now.isDetached ? ['Waiting in its queue', count(now.inbox)] : null, now.isDetached || now.dropped > 0 ? ['Dropped', count(now.dropped), now.dropsPerSecond > 0] : null,
        now.panics > 0 ? ['Panicked', count(now.panics), true] : null, now.restarts > 0 ? ['Started again', count(now.restarts)] : null,
        ['Pace', now.isDetached ? 'its own, detached' : 'that of the cycles'],
      ]);
      spark.draw(this.history.shares(name));
      published.update();
      subscribed.update();
    };
    this.refreshDetail();
    this.showSettings(name, settings);
  }

  /** @param {string} name @param {HTMLElement} place */
  async showSettings(name, place) {
    try {
      this.settings ??= await this.robot.ask('settings');
    } catch (error) {
      place.replaceChildren(h('h4', null, 'Settings'), h('p', { class: 'muted' }, words(error)));
      return;
    }
    const own = (this.settings ?? []).filter((/** @type {any} */ setting) => setting.module === name);
    if (own.length === 0) return;
    place.replaceChildren(h('h4', null, 'Settings'),
      h('dl', null, own.flatMap((/** @type {any} */ setting) => [h('dt', { title: setting.description }, setting.name), h('dd', null, JSON.stringify(setting.value))])),
      h('div', { class: 'row' }, h('button', { type: 'button', class: 'button', onclick: () => openPanel('parameters', { search: `${name}.` }) }, icon('parameters'), 'Change')));
    // What is shown next time may have been changed by others.
    this.settings = null;
  }

  /** @param {string} name */
  openTopic(name) {
    const { publishers, subscribers, outlets } = this.endsOf(name);
    const topic = `/${name}`;
    const published = this.links('Published by', publishers, 'module');
    const subscribed = this.links('Goes to', subscribers, 'module');
    const facts = h('dl', { 'data-testid': 'graph-facts' });
    const message = h('pre', { tabIndex: 0, 'aria-label': 'Last message', 'data-testid': 'graph-message' }, 'No message yet.');
    const channel = this.robot.channels.get(topic);
    const type = channel?.schemaName ?? this.graph?.topics.find((each) => each.name === name)?.message_type ?? '';
    let size = 0;
    let last = 0n;
    let isStale = false;
    const buttons = h('div', { class: 'row' },
      h('button', { type: 'button', class: 'button', disabled: !channel, 'data-testid': 'graph-plot', onclick: () => openPanel('plot', { lines: linesOf(topic, this.robot.latest(topic)) }) }, icon('plot'), 'Plot'),
      h('button', { type: 'button', class: 'button', disabled: !channel, 'data-testid': 'graph-raw', onclick: () => openPanel('topics', { topic }) }, icon('topics'), 'Raw'));
    const leaves = outlets.length === 0 ? [] : [h('h4', null, 'Leaves through'), ...outlets.map((each) => h('p', null, each))];
    this.openDetail(name, null, [h('p', { class: 'mono muted', 'data-testid': 'graph-type' }, type), facts, buttons, h('h4', null, channel ? 'Last message' : 'Not visible here: its type has no ROS schema'),
      channel ? message : null, ...published.elements, ...subscribed.elements, ...leaves]);
    const unsubscribe = channel ? this.robot.subscribe(topic, (_, timeNs, raw) => {
      if (raw.length > 0) size = size === 0 ? raw.length : size * 0.8 + raw.length * 0.2;
      last = timeNs;
      isStale = true;
    }, { latest: true }) : null;
    this.endDetail = unsubscribe;
    this.refreshDetail = () => {
      const now = this.history.topic(name);
      if (now) {
        showFacts(facts, [
          ['Rate', `${rate(now.hz)} Hz`], ['Bandwidth', size > 0 ? `${bytes(size * now.hz)}/s` : '–'], ['Messages', count(now.messages)],
          ['Subscribers', count(now.subscribers)], ['Most in one cycle', count(now.largestBatch)], ['Dropped', count(now.dropped), now.dropsPerSecond > 0],
        ]);
      }
      if (isStale && last > 0n) {
        isStale = false;
        setText(message, preview(this.robot.latest(topic)));
      }
      published.update();
      subscribed.update();
    };
    this.refreshDetail();
  }

  /** @param {string[]} names */
  openTopics(names) {
    const links = this.links('Topics between the same modules', names, 'topic');
    this.openDetail(`${names.length} topics`, null, links.elements);
    // They may not be drawn on their own.
    this.refreshDetail = () => links.update();
  }

  /** @param {string} name */
  openService(name) {
    const { modules = [], services = [], edges = [] } = this.graph ?? {};
    const index = services.findIndex((each) => each.name === name);
    const ends = (/** @type {'calls' | 'serves'} */ kind) => edges.flatMap((edge) => (edge[kind]?.service === index ? [modules[edge[kind].module].name] : []));
    const [servers, callers] = [this.links('Served by', ends('serves'), 'module'), this.links('Called by', ends('calls'), 'module')];
    const { request_type: request = '', response_type: response = '' } = services[index] ?? {};
    this.openDetail(name, null, [h('p', { class: 'mono muted' }, `${request} → ${response}`), ...servers.elements, ...callers.elements]);
    this.refreshDetail = () => { servers.update(); callers.update(); };
  }

  /** @param {string} name */
  openOutlet(name) {
    const { topics = [], outlets = [], edges = [] } = this.graph ?? {};
    const index = outlets.findIndex((each) => each.name === name);
    const leaving = this.links('Takes', edges.flatMap(({ leaves }) => (leaves?.outlet === index ? [topics[leaves.topic].name] : [])), 'topic');
    const facts = h('dl', { 'data-testid': 'graph-facts' });
    this.openDetail(name, null, [facts, ...leaving.elements]);
    this.refreshDetail = () => {
      const now = this.history.outlet(name);
      if (now) {
        showFacts(facts, [['Rate', `${rate(now.hz)} Hz`], ['Taken', count(now.received)], ['Waiting in its queue', count(now.inbox)],
          ['Dropped', count(now.dropped), now.dropsPerSecond > 0], now.failed > 0 ? ['Failed', count(now.failed), true] : null]);
      }
      leaving.update();
    };
    this.refreshDetail();
  }

  destroy() {
    this.hasEnded = true;
    this.closeDetail();
    this.drawing.destroy();
    this.barButton.remove();
    this.body.remove();
  }
}

/** Asks the shell to show another panel. @param {string} panel @param {any} options */
function openPanel(panel, options) {
  document.dispatchEvent(new CustomEvent('downbeat:open', { detail: { panel, options } }));
}

/** The first numbers of a message, as lines of the plot. @param {string} topic @param {any} message */
function linesOf(topic, message) {
  const paths = numericPaths(message).filter((path) => !/header|covariance/.test(path)).slice(0, MOST_LINES);
  return paths.map((path, color) => ({ topic, path, label: `${topic.slice(1)}.${path}`, color }));
}

/** @param {HTMLElement} list @param {([string, string, boolean?] | null)[]} facts the third: it needs attention */
function showFacts(list, facts) {
  const known = facts.filter((fact) => fact !== null);
  if (list.children.length !== known.length * 2) list.replaceChildren(...known.flatMap(() => [h('dt', null), h('dd', null)]));
  known.forEach(([name, value, isWrong], index) => {
    setText(list.children[2 * index], name);
    setText(list.children[2 * index + 1], value);
    list.children[2 * index + 1].classList.toggle('warn', Boolean(isWrong));
  });
}

/** @param {string} label */
function sparkline(label) {
  const space = 'http://www.w3.org/2000/svg';
  const element = document.createElementNS(space, 'svg');
  element.setAttribute('class', 'graph-spark');
  element.setAttribute('viewBox', '0 0 100 40');
  element.setAttribute('preserveAspectRatio', 'none');
  element.setAttribute('role', 'img');
  const [area, line] = [document.createElementNS(space, 'path'), document.createElementNS(space, 'path')];
  area.setAttribute('class', 'area');
  element.append(area, line);
  return {
    element,
    draw(/** @type {number[]} */ values) {
      const most = Math.max(1e-6, ...values);
      element.setAttribute('aria-label', `${label}: at most ${(most * 100).toFixed(1)} %`);
      const points = values.map((value, index) => `${((index / Math.max(1, values.length - 1)) * 100).toFixed(1)},${(38 - (value / most) * 34).toFixed(1)}`);
      line.setAttribute('d', points.length > 1 ? `M${points.join('L')}` : '');
      area.setAttribute('d', points.length > 1 ? `M0,40L${points.join('L')}L100,40Z` : '');
    },
  };
}

/** A message as text, not longer than one looks at. @param {any} message */
function preview(message) {
  const text = JSON.stringify(message, (_, value) => {
    if (typeof value === 'bigint') return Number(value);
    if (ArrayBuffer.isView(value)) {
      const list = Array.from(/** @type {any} */ (value).subarray(0, 32), (each) => (typeof each === 'bigint' ? Number(each) : typeof each === 'number' && !Number.isInteger(each) ? Number(each.toPrecision(6)) : each));
      return /** @type {any} */ (value).length > 32 ? [...list, `… ${/** @type {any} */ (value).length} values`] : list;
    }
    if (Array.isArray(value) && value.length > 32) return [...value.slice(0, 32), `… ${value.length} values`];
    return typeof value === 'number' && !Number.isInteger(value) ? Number(value.toPrecision(6)) : value;
  }, 1) ?? '';
  // Lists of numbers on one line.
  const folded = text.replace(/\[[^[\]{}]*\]/g, (list) => list.replace(/\s+/g, ' ')).replace(/"([A-Za-z_]\w*)":/g, '$1:');
  return folded.length > LONGEST_PREVIEW ? `${folded.slice(0, LONGEST_PREVIEW)} …` : folded;
}
