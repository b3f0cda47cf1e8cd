// @ts-check
// The chains of `[[latency]]`: what is computed of them, and the table below the graph.

import { h, replace, setText } from '../panel.js';
import { count, isOwn, ms } from './graph_data.js';

/**
 * One of the answer of the ask `latencies`; quantiles are of the newest messages, the rest of all since the robot began.
 * @typedef {{ name: string, from: string, to: string, limit_ns: number | null, messages: number, without_origin: number, exceeded: number,
 *   p50_ns: number, p90_ns: number, p99_ns: number, max_ns: number, oldest: string }} ChainReport
 * @typedef {{ from: string, to: string, modules: Set<string>, topics: Set<string>, services: Set<string> }} Way
 */

/** How long a chain counts as above its limit after the last message that was. */
const MEMORY_MS = 10_000;

/** The newest reports, and which chains had messages above their limit lately. */
export class Chains {
  constructor() {
    /** @type {ChainReport[]} */
    this.reports = [];
    /** When the last message above the limit was seen, by the chain's name. @type {Map<string, number>} */
    this.exceededAt = new Map();
  }

  /** @param {ChainReport[]} reports @param {number} nowMs */
  add(reports, nowMs) {
    for (const { name, exceeded } of reports) {
      const before = this.reports.find((each) => each.name === name)?.exceeded;
      // What happened before the first look may be long past.
      if (before !== undefined && exceeded > before) this.exceededAt.set(name, nowMs);
    }
    this.reports = reports;
  }

  /** @param {string} name */
  named(name) { return this.reports.find((each) => each.name === name); }

  /** @param {string} name @param {number} nowMs */
  isAbove(name, nowMs) {
    const at = this.exceededAt.get(name);
    return at !== undefined && nowMs - at <= MEMORY_MS;
  }
}

/**
 * What lies between two topics: the modules and topics through which messages of the first one may reach the second one. Services
 * count only where topics alone do not connect the two.
 * @param {import('./graph_data.js').Graph} graph @param {{ from: string, to: string }} chain
 * @returns {Way}
 */
export function wayBetween(graph, { from, to }) {
  const between = (/** @type {boolean} */ withServices) => {
    /** @type {Map<string, string[]>} */
    const ahead = new Map();
    /** @type {Map<string, string[]>} */
    const behind = new Map();
    const link = (/** @type {string} */ a, /** @type {string} */ b) => {
      ahead.set(a, [...(ahead.get(a) ?? []), b]);
      behind.set(b, [...(behind.get(b) ?? []), a]);
    };
    for (const { publishes, subscribes, calls, serves } of graph.edges) {
      const end = publishes ?? subscribes ?? calls ?? serves;
      if (!end || isOwn(graph.modules[end.module].name)) continue;
      const id = `m:${graph.modules[end.module].name}`;
      if (publishes) link(id, `t:${graph.topics[publishes.topic].name}`);
      if (subscribes) link(`t:${graph.topics[subscribes.topic].name}`, id);
      const service = withServices ? calls ?? serves : undefined;
      if (!service) continue;
      // The request goes one way and the response the other.
      link(id, `s:${graph.services[service.service].name}`);
      link(`s:${graph.services[service.service].name}`, id);
    }
    const reached = (/** @type {Map<string, string[]>} */ links, /** @type {string} */ start, /** @type {string} */ end) => {
      const seen = new Set([start]);
      for (const id of seen) if (id !== end) for (const next of links.get(id) ?? []) seen.add(next);
      return seen;
    };
    const [first, last] = [`t:${from}`, `t:${to}`];
    const backward = reached(behind, last, first);
    return new Set([...reached(ahead, first, last)].filter((id) => backward.has(id)));
  };
  let ids = between(false);
  if (ids.size === 0) ids = between(true);
  const named = (/** @type {string} */ kind) => new Set([...ids].filter((id) => id.startsWith(kind)).map((id) => id.slice(2)));
  return { from, to, modules: named('m:'), topics: named('t:').add(from).add(to), services: named('s:') };
}

/**
 * The nodes and edges that show a way.
 * @param {import('./graph_data.js').Shown} shown @param {Way} way
 */
export function drawnOf(shown, way) {
  const moduleOf = (/** @type {string} */ id) => (id.startsWith('m:') ? id.slice(2) : null);
  const nodes = new Set(shown.nodes.filter(({ kind, title, topics = [] }) =>
    (kind === 'module' && way.modules.has(title)) || (kind === 'service' && way.services.has(title)) || topics.some((name) => way.topics.has(name))).map(({ id }) => id));
  const edges = new Set(shown.edges.filter((edge) => {
    if (edge.isDashed) return nodes.has(edge.from) && nodes.has(edge.to);
    const [publisher, subscriber] = [moduleOf(edge.from), moduleOf(edge.to)];
    if (edge.to.startsWith('o:')) return false;
    // Where topics are labels, the edges of the first and last topic have one end outside.
    const isWire = publisher !== null && subscriber !== null;
    return edge.topics.some((topic) => way.topics.has(topic) &&
      (publisher === null || (topic === way.from ? isWire : way.modules.has(publisher))) &&
      (subscriber === null || (topic === way.to ? isWire : way.modules.has(subscriber))));
  }).map(({ id }) => id));
  return { nodes, edges };
}

const COLUMNS = /** @type {const} */ (['Chain', 'From → to', 'Median', '99 %', 'Max', 'Limit', 'Exceeded', 'The oldest message']);

/** The table of chains; hidden while there are none. */
export class ChainTable {
  /** @param {(name: string | null) => void} onSelect */
  constructor(onSelect) {
    this.onSelect = onSelect;
    /** @type {Map<string, ReturnType<ChainTable['row']>>} */
    this.rows = new Map();
    this.body = h('tbody', null);
    const heads = COLUMNS.map((title, index) => h('th', { scope: 'col', class: index === 1 ? 'minor' : index >= 2 && index <= 6 ? 'number' : undefined }, title));
    this.element = h('div', { class: 'graph-chains', hidden: true, role: 'region', 'aria-label': 'Measured chains' },
      h('table', { 'data-testid': 'graph-chains' }, h('caption', { class: 'sr' }, 'How old messages are that depend on others; a chain that is chosen is marked in the graph'),
        h('thead', null, h('tr', null, heads)), this.body));
  }

  /** @param {string} name */
  row(name) {
    const button = h('button', { type: 'button', class: 'row-button', 'aria-pressed': 'false',
      onclick: () => this.onSelect(button.getAttribute('aria-pressed') === 'true' ? null : name) }, name);
    const times = [0, 1, 2, 3].map(() => h('td', { class: 'number' }));
    const way = h('td', { class: 'graph-chain-way minor' });
    const exceeded = h('td', { class: 'number' });
    const mark = h('span', { class: 'chip warn', hidden: true }, 'above the limit');
    const oldest = h('td', { class: 'graph-chain-oldest muted' });
    const element = h('tr', { dataset: { chain: name } }, h('td', { class: 'graph-chain-name' }, button, mark), way, times, exceeded, oldest);
    return { element, button, way, times, exceeded, mark, oldest };
  }

  /** @param {Chains} chains @param {string | null} selected @param {number} nowMs */
  show(chains, selected, nowMs) {
    this.element.hidden = chains.reports.length === 0;
    const elements = chains.reports.map((report) => {
      let row = this.rows.get(report.name);
      if (!row) {
        row = this.row(report.name);
        this.rows.set(report.name, row);
      }
      const isAbove = chains.isAbove(report.name, nowMs);
      row.button.setAttribute('aria-pressed', String(report.name === selected));
      row.element.className = [isAbove && 'warn', report.name === selected && 'is-selected'].filter(Boolean).join(' ');
      const way = `${report.from} → ${report.to}`;
      // Where there is little room, the column is left out.
      row.button.title = way;
      setText(row.way, way);
      const times = report.messages > 0 ? [report.p50_ns, report.p99_ns, report.max_ns].map(ms) : ['–', '–', '–'];
      [...times, report.limit_ns === null ? '–' : ms(report.limit_ns)].forEach((text, index) => setText(/** @type {any} */ (row).times[index], text));
      setText(row.exceeded, report.limit_ns === null ? '–' : count(report.exceeded));
      row.mark.hidden = !isAbove;
      setText(row.oldest, report.oldest || '–');
      return row.element;
    });
    replace(this.body, elements);
  }
}
