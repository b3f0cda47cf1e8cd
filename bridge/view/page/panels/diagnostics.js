// @ts-check
// diagnostic_msgs: what each part of the robot says of itself, as a tree by name.

import { empty, h, replace, setText } from '../panel.js';

/**
 * @typedef {{ level: number, name: string, message: string, values: { key: string, value: string }[] }} Status
 * @typedef {{ status: Status, timeNs: bigint, seenMs: number, periodMs: number, row: Row }} Part  `periodMs`: between its last two reports
 * @typedef {ReturnType<typeof rowOf>} Row
 */

const LEVELS = [['ok', 'OK'], ['warn', 'Warning'], ['error', 'Error'], ['stale', 'Stale']];
/** As diagnostic_aggregator: who has not reported for so long is stale; who reports seldom has three of its periods. */
const STALE_MS = 5000;
const SELDOM_MS = 20_000;
const MOST_PARTS = 2000;

/** @type {import('../panel.js').Panel} */
export default {
  id: 'diagnostics',
  title: 'Diagnostics',
  create(root, robot, view) {
    /** @type {{ worse: boolean }} */
    const options = { worse: false, ...view.get() };
    /** @type {Map<string, Part>} */
    const parts = new Map();
    /** @type {Map<string, ReturnType<typeof groupOf>>} */
    const groups = new Map();
    const summary = h('div', { class: 'row', role: 'status' });
    const worse = h('button', { type: 'button', class: 'button', 'aria-pressed': String(options.worse), onclick: () => {
      options.worse = !options.worse;
      worse.setAttribute('aria-pressed', String(options.worse));
      worse.classList.toggle('primary', options.worse);
      view.set(options);
      show();
    } }, 'Only problems');
    worse.classList.toggle('primary', options.worse);
    const list = h('div', { class: 'tree scroll', 'data-testid': 'diagnostics' });
    const nothing = empty('Nothing reported yet.', 'diagnostic_msgs/DiagnosticArray and DiagnosticStatus are shown here.');
    root.append(h('div', { class: 'bar-row' }, summary, h('span', { class: 'spacer' }), worse), list);

    /** @param {Status} status @param {bigint} timeNs @param {number} [periodMs] expected before the second report */
    function take(status, timeNs, periodMs = 0) {
      let part = parts.get(status.name);
      if (!part) {
        if (parts.size >= MOST_PARTS) return;
        part = { status, timeNs, seenMs: 0, periodMs, row: rowOf(status.name) };
        parts.set(status.name, part);
      }
      const now = performance.now();
      if (part.seenMs > 0) part.periodMs = now - part.seenMs;
      Object.assign(part, { status, timeNs, seenMs: now });
    }

    function show() {
      const now = performance.now();
      const counts = [0, 0, 0, 0];
      /** @type {Map<string, Part[]>} */
      const sorted = new Map();
      const names = [...parts.keys()].sort((a, b) => a.localeCompare(b, 'en', { numeric: true }));
      for (const name of names) {
        const part = /** @type {Part} */ (parts.get(name));
        const level = levelOf(part, now);
        counts[level]++;
        if (options.worse && level === 0) continue;
        const group = groupName(name, robot.info?.name);
        sorted.set(group, [...(sorted.get(group) ?? []), part]);
      }
      replace(summary, counts.map((count, level) => [count, level]).filter(([count]) => count > 0).reverse()
        .map(([count, level]) => h('span', { class: `chip ${LEVELS[level][0]}` }, `${count} ${LEVELS[level][1]}`)));
      const worstOf = (/** @type {Part[]} */ members) => Math.max(...members.map((part) => rank(levelOf(part, now))));
      const elements = [...sorted].sort(([a, x], [b, y]) => worstOf(y) - worstOf(x) || order(a) - order(b) || a.localeCompare(b)).map(([name, members]) => {
        let group = groups.get(name);
        if (!group) { group = groupOf(name); groups.set(name, group); }
        const worst = members.reduce((most, part) => (rank(levelOf(part, now)) > rank(most) ? levelOf(part, now) : most), 0);
        group.dot.className = `dot ${LEVELS[worst][0]}`;
        setText(group.count, String(members.length));
        for (const part of members) showPart(part, levelOf(part, now));
        replace(group.body, members.map(({ row }) => row.element));
        return group.element;
      });
      replace(list, elements.length > 0 ? elements : [parts.size > 0 ? empty('No problems.') : nothing]);
    }

    /** @type {Set<string>} */
    const watched = new Set();
    function watch() {
      for (const { topic, schemaName } of robot.channels.values()) {
        if (watched.has(topic) || topic === '/diagnostics_agg') continue;
        if (schemaName === 'diagnostic_msgs/msg/DiagnosticArray') robot.subscribe(topic, (message, time) => message.status.forEach((/** @type {Status} */ status) => take(status, time)));
        else if (schemaName === 'diagnostic_msgs/msg/DiagnosticStatus') robot.subscribe(topic, (message, time) => take(message, time, SELDOM_MS));
        else continue;
        watched.add(topic);
      }
    }
    watch();
    robot.addEventListener('channels', watch);
    robot.every(500, show);
    return { destroy() {}, seeked() { parts.clear(); groups.clear(); show(); } };
  },
};

/** @param {Part} part @param {number} now */
const levelOf = ({ status, seenMs, periodMs }, now) => (now - seenMs > Math.max(STALE_MS, 3 * periodMs) ? 3 : Math.min(3, status.level));
/** An error weighs more than what is only stale. @param {number} level */
const rank = (level) => [0, 2, 3, 1][level];

/** `darwin_op: servo 3 head` belongs to the servos of `darwin_op`, `darwin_op: /tf` to its topics, `/arm/motor` to `/arm`. @param {string} name @param {string} [robotName] */
function groupName(name, robotName) {
  const [, owner = '', part] = /^(?:(.*?): )?(.*)$/s.exec(name) ?? ['', '', name];
  const kind = /^(servo|module|motor|device)\b./.exec(part)?.[1];
  const slash = part.lastIndexOf('/');
  const group = kind ? `${kind}s` : owner && part.startsWith('/') ? 'topics' : slash > 0 ? part.slice(0, slash) : owner ? 'robot' : part;
  return owner && owner !== robotName ? `${group} · ${owner}` : group;
}

/** What people look for first is above what is many and dull. @param {string} group */
const order = (group) => {
  const kind = group.split(' ')[0];
  return kind === 'topics' ? 2 : kind === 'modules' ? 1 : 0;
};

/** @param {string} name */
function groupOf(name) {
  const dot = h('span', { class: 'dot' });
  const count = h('span', { class: 'muted number' });
  const body = h('div', null);
  const element = h('details', { open: true }, h('summary', null, dot, h('b', { style: { fontWeight: '600' } }, name), count), body);
  return { dot, count, body, element };
}

/** @param {string} name */
function rowOf(name) {
  const dot = h('span', { class: 'dot' });
  const chip = h('span', { class: 'sr' });
  const message = h('span', { class: 'muted' });
  const values = h('div', null);
  const short = name.replace(/^.*?: /, '').replace(/^(servo|module) /, '');
  const element = h('details', null, h('summary', { title: name }, dot, h('span', null, short), chip, message), values);
  return { dot, chip, message, values, element };
}

/** @param {Part} part @param {number} level */
function showPart({ status, row }, level) {
  row.dot.className = `dot ${LEVELS[level][0]}`;
  setText(row.chip, LEVELS[level][1]);
  setText(row.message, level === 3 && status.level !== 3 ? `stale: ${status.message}` : status.message);
  // What is not unfolded costs nothing.
  if (!row.element.open) return;
  const { values } = row;
  while (values.children.length > status.values.length) values.lastElementChild?.remove();
  status.values.slice(0, 200).forEach(({ key, value }, i) => {
    const leaf = values.children[i] ?? values.appendChild(h('div', { class: 'leaf' }, h('span', null), h('span', { class: 'mono' })));
    setText(leaf.children[0], key);
    setText(leaf.children[1], value);
  });
}
