// @ts-check
// What the graph panel computes from snapshots and the graph, without drawing.

/**
 * The answers of the asks `snapshot` and `graph`, as far as they are used here.
 * @typedef {{ count: number, sum_ns: number, p50_ns: number, p99_ns: number, max_ns: number }} Times
 * @typedef {'unconfigured' | 'inactive' | 'active' | 'paused' | 'restarting' | 'failed' | 'finalized'} State
 * @typedef {{ name: string, state: State, is_detached: boolean, runs: number, received: number, published: number, overruns: number,
 *   panics: number, restarts: number, inbox: number, dropped: number, run_time: Times }} ModuleStatistics
 * @typedef {{ name: string, message_type: string, subscribers: number, messages: number, dropped: number, largest_batch: number }} TopicStatistics
 * @typedef {{ name: string, received: number, inbox: number, dropped: number, failed: number }} OutletStatistics
 * @typedef {{ uptime_ns: number, cycle: number, is_paused: boolean, modules: ModuleStatistics[], topics: TopicStatistics[],
 *   outlets: OutletStatistics[], before?: Snapshot }} Snapshot  a run that stands still brings what it had some time before
 * @typedef {{ publishes?: { module: number, topic: number }, subscribes?: { module: number, topic: number },
 *   calls?: { module: number, service: number }, serves?: { module: number, service: number },
 *   leaves?: { topic: number, outlet: number } }} GraphEdge
 * @typedef {{ modules: { name: string, is_detached: boolean }[], topics: { name: string, message_type: string }[],
 *   services: { name: string, request_type: string, response_type: string }[], outlets: { name: string }[], edges: GraphEdge[] }} Graph
 */
/**
 * @typedef {{ id: string, kind: 'module' | 'topic' | 'topics' | 'service' | 'outlet', title: string, topics?: string[], isDouble?: boolean,
 *   width?: number, value?: string, lines?: string[], meter?: number }} ShownNode
 * @typedef {{ id: string, from: string, to: string, topics: string[], label?: string, isDashed?: boolean }} ShownEdge
 * @typedef {{ nodes: ShownNode[], edges: ShownEdge[], modules: number, topics: number }} Shown
 */
/**
 * A module now.
 * @typedef {{ name: string, state: State, isDetached: boolean, hz: number, share: number, p50: number, p99: number, longest: number, runs: number,
 *   received: number, published: number, overruns: number, panics: number, restarts: number, inbox: number, dropped: number,
 *   dropsPerSecond: number, isOverrunning: boolean, isLong: boolean }} ModuleNow  times in nanoseconds
 */

/** Rates are of the last two seconds; what went wrong is remembered for ten. */
const [WINDOW_NS, MEMORY_NS] = [2e9, 10e9];
const MOST_SHARES = 120;

/** Topics about the program itself and not about the robot. @param {string} name */
export const isDebug = (name) => /^(executor|bridge|record)\/|(^|\/)(rosout|parameter_events)$|^(cycle_messages|cycle_times|module_steps|module_settings|module_events|module_runs)$/.test(name);
/** Modules that the program adds to each robot. @param {string} name */
export const isOwn = (name) => /^((cycle|step|settings|event|run)_journal|bridge_services|latency_watch|process_diagnostics)$/.test(name);

/** A time as people read it. @param {number} ns */
export const ms = (ns) => (ns < 1e6 ? `${(ns / 1e3).toFixed(ns < 1e4 ? 1 : 0)} µs` : `${(ns / 1e6).toFixed(2)} ms`);
/** @param {number} value */
export const count = (value) => value.toLocaleString('en');

/** The last seconds of snapshots. */
export class History {
  constructor() {
    /** @type {{ at: number, modules: Map<string, ModuleStatistics>, topics: Map<string, TopicStatistics>, outlets: Map<string, OutletStatistics> }[]} */
    this.looks = [];
    /** @type {Map<string, number[]>} */
    this.shareHistory = new Map();
  }

  /** @param {Snapshot} snapshot */
  add(snapshot) {
    const last = this.looks[this.looks.length - 1];
    // The robot was started again, or the run stands elsewhere.
    if (snapshot.before || (last && snapshot.uptime_ns < last.at)) this.looks = [];
    if (snapshot.before) this.add(snapshot.before);
    const named = (/** @type {any[]} */ list) => new Map(list.map((each) => [each.name, each]));
    this.looks.push({ at: snapshot.uptime_ns, modules: named(snapshot.modules), topics: named(snapshot.topics), outlets: named(snapshot.outlets ?? []) });
    while (this.looks.length > 2 && snapshot.uptime_ns - this.looks[1].at > MEMORY_NS) this.looks.shift();
    for (const name of [...this.shareHistory.keys()]) if (!snapshot.modules.some((each) => each.name === name)) this.shareHistory.delete(name);
    for (const { name } of snapshot.modules) {
      if (this.looks.length < 2) continue;
      const shares = this.shareHistory.get(name) ?? [];
      shares.push(this.module(name)?.share ?? 0);
      if (shares.length > MOST_SHARES) shares.shift();
      this.shareHistory.set(name, shares);
    }
  }

  /** The newest look and the one some time before. @param {number} [windowNs] */
  pair(windowNs = WINDOW_NS) {
    const now = this.looks[this.looks.length - 1];
    if (!now) return null;
    const before = [...this.looks].reverse().find(({ at }) => now.at - at >= windowNs) ?? this.looks[0];
    return { now, before, seconds: (now.at - before.at) / 1e9 };
  }

  /** @param {string} name @returns {number[]} */
  shares(name) { return this.shareHistory.get(name) ?? []; }

  /** @param {string} name @returns {ModuleNow | null} */
  module(name) {
    const pair = this.pair();
    const module = pair?.now.modules.get(name);
    if (!pair || !module) return null;
    const before = pair.before.modules.get(name);
    const old = this.looks[0].modules.get(name);
    const since = (/** @type {number} */ now, /** @type {number | undefined} */ then) => (then === undefined ? 0 : Math.max(0, now - then));
    const runs = since(module.runs, before?.runs);
    const measured = since(module.run_time.count, before?.run_time.count);
    const spent = since(module.run_time.sum_ns, before?.run_time.sum_ns);
    const hz = pair.seconds > 0 ? runs / pair.seconds : 0;
    // Only some runs are measured: the others take as long on average.
    const share = measured > 0 && pair.seconds > 0 ? ((spent / measured) * runs) / (pair.seconds * 1e9) : 0;
    return {
      name, state: module.state, isDetached: module.is_detached, hz, share, p50: module.run_time.p50_ns, p99: module.run_time.p99_ns,
      longest: module.run_time.max_ns, runs: module.runs, received: module.received, published: module.published, overruns: module.overruns,
      panics: module.panics, restarts: module.restarts, inbox: module.inbox, dropped: module.dropped,
      dropsPerSecond: pair.seconds > 0 ? since(module.dropped, before?.dropped) / pair.seconds : 0,
      isOverrunning: since(module.overruns, old?.overruns) > 0,
      isLong: hz > 0 && module.run_time.p99_ns > 1e9 / hz,
    };
  }

  /** @param {string} name */
  topic(name) {
    const pair = this.pair();
    const topic = pair?.now.topics.get(name);
    if (!pair || !topic) return null;
    const before = pair.before.topics.get(name) ?? topic;
    const per = (/** @type {number} */ difference) => (pair.seconds > 0 ? Math.max(0, difference) / pair.seconds : 0);
    return { hz: per(topic.messages - before.messages), dropsPerSecond: per(topic.dropped - before.dropped), messages: topic.messages, dropped: topic.dropped,
      subscribers: topic.subscribers, largestBatch: topic.largest_batch };
  }

  /** @param {string} name */
  outlet(name) {
    const pair = this.pair();
    const outlet = pair?.now.outlets.get(name);
    if (!pair || !outlet) return null;
    const before = pair.before.outlets.get(name) ?? outlet;
    const per = (/** @type {number} */ difference) => (pair.seconds > 0 ? Math.max(0, difference) / pair.seconds : 0);
    return { hz: per(outlet.received - before.received), dropsPerSecond: per(outlet.dropped - before.dropped), received: outlet.received, inbox: outlet.inbox,
      dropped: outlet.dropped, failed: outlet.failed };
  }
}

/** What a module's node says. @param {ModuleNow} now */
export function summary(now) {
  const time = (/** @type {number} */ ns) => (ns / 1e6 < 0.1 ? (ns / 1e6).toFixed(3) : (ns / 1e6).toFixed(2));
  const rest = now.inbox > 0 ? ` · queue ${now.inbox}` : now.dropsPerSecond > 0 ? ` · drops ${now.dropsPerSecond.toFixed(1)}/s` : ' core';
  const hz = now.hz >= 10 ? now.hz.toFixed(0) : now.hz.toFixed(1);
  const text = [`${hz} Hz · ${(now.share * 100).toFixed(1)} %${rest}`, `p50 ${time(now.p50)} · p99 ${time(now.p99)} ms`];
  /** @type {'failed' | 'restarting' | 'held' | 'late' | undefined} */
  let tone;
  let badge;
  if (now.state === 'failed') [tone, badge] = ['failed', 'failed'];
  else if (now.state === 'restarting') [tone, badge] = ['restarting', 'restarting'];
  else if (now.state === 'paused') [tone, badge] = ['held', 'held'];
  else if (now.state !== 'active') [tone, badge] = ['held', now.state];
  else if (now.isOverrunning || now.isLong) [tone, badge] = ['late', 'late'];
  else if (now.dropsPerSecond > 0) [tone, badge] = ['late', 'drops'];
  return { text, tone, badge };
}

/**
 * What is drawn of a graph.
 * @param {Graph} graph
 * @param {{ mode: 'nodes' | 'labels', debug: boolean, outlets: boolean, services: boolean, group: boolean }} options
 * @returns {Shown}
 */
export function edgesOf(graph, options) {
  /** @type {ShownNode[]} */
  const nodes = graph.modules.filter(({ name }) => options.debug || !isOwn(name)).map(({ name, is_detached: isDouble }) =>
    ({ id: `m:${name}`, kind: 'module', title: name, isDouble, lines: ['–', '–'], meter: 0, width: 168 }));
  const modules = nodes.length;
  /** @type {ShownEdge[]} */
  const edges = [];
  /** @type {Map<string, ShownEdge>} */
  const known = new Map();
  const connect = (/** @type {string} */ from, /** @type {string} */ to, /** @type {string[]} */ topics, isDashed = false) => {
    const id = `${from}→${to}${isDashed ? ' service' : ''}`;
    const before = known.get(id);
    if (before) {
      before.topics.push(...topics.filter((topic) => !before.topics.includes(topic)));
      return;
    }
    const edge = { id, from, to, topics: [...topics], isDashed };
    known.set(id, edge);
    edges.push(edge);
  };
  const ends = graph.topics.map(({ name }) => ({ name, from: /** @type {string[]} */ ([]), to: /** @type {string[]} */ ([]) }));
  for (const { publishes, subscribes, leaves } of graph.edges) {
    if (publishes) ends[publishes.topic].from.push(`m:${graph.modules[publishes.module].name}`);
    if (subscribes) ends[subscribes.topic].to.push(`m:${graph.modules[subscribes.module].name}`);
    if (leaves && options.outlets) ends[leaves.topic].to.push(`o:${graph.outlets[leaves.outlet].name}`);
  }
  const ids = new Set(nodes.map(({ id }) => id));
  const visible = ends.filter(({ name }) => options.debug || !isDebug(name));
  for (const end of visible) {
    end.from = end.from.filter((id) => ids.has(id));
    end.to = end.to.filter((id) => ids.has(id) || id.startsWith('o:'));
  }
  /** @type {Map<string, { names: string[], from: string[], to: string[] }>} */
  const groups = new Map();
  for (const { name, from, to } of visible) {
    const isBetween = options.mode === 'labels' && from.length > 0 && to.length > 0;
    if (isBetween) {
      for (const a of from) for (const b of to) connect(a, b, [name]);
      continue;
    }
    const key = options.group && options.mode === 'nodes' ? `${[...from].sort().join()} → ${[...to].sort().join()}` : name;
    const group = groups.get(key) ?? { names: [], from, to };
    group.names.push(name);
    groups.set(key, group);
  }
  for (const [key, { names, from, to }] of groups) {
    const isOne = names.length < 3;
    for (const some of isOne ? names.map((name) => [name]) : [names]) {
      const id = isOne ? `t:${some[0]}` : `T:${key}`;
      nodes.push({ id, kind: isOne ? 'topic' : 'topics', title: isOne ? some[0] : `${some.length} topics`, topics: some, value: '–' });
      for (const a of from) connect(a, id, some);
      for (const b of to) connect(id, b, some);
    }
  }
  for (const edge of edges) {
    if (options.mode !== 'labels' || !edge.from.startsWith('m:') || edge.to.startsWith('t:')) continue;
    edge.label = edge.topics.length === 1 ? edge.topics[0] : `${edge.topics.length} topics`;
  }
  if (options.services) {
    for (const { name } of graph.services) nodes.push({ id: `s:${name}`, kind: 'service', title: name });
    for (const { calls, serves } of graph.edges) {
      if (calls && ids.has(`m:${graph.modules[calls.module].name}`)) connect(`m:${graph.modules[calls.module].name}`, `s:${graph.services[calls.service].name}`, [], true);
      if (serves && ids.has(`m:${graph.modules[serves.module].name}`)) connect(`s:${graph.services[serves.service].name}`, `m:${graph.modules[serves.module].name}`, [], true);
    }
  }
  if (options.outlets) {
    const used = new Set(edges.map(({ to }) => to));
    for (const { name } of graph.outlets) if (used.has(`o:${name}`)) nodes.push({ id: `o:${name}`, kind: 'outlet', title: name, value: '' });
  }
  return { nodes, edges, modules, topics: visible.length };
}
