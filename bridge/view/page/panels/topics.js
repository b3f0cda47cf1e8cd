// @ts-check
// Topics with their rates; the messages of one; and a form to publish.

import { encode, template } from '../cdr.js';
import { bytes, clock, empty, h, icon, iconButton, rate, replace, setText } from '../panel.js';
import { words } from '../connection.js';
import { json, treeOf } from './topics/tree.js';

/** @typedef {{ messages: number, uptime: number }} Count */

const PERIOD_MS = 1000;
const TREE_MS = 100;

/** @type {import('../panel.js').Panel} */
export default {
  id: 'topics',
  title: 'Topics',
  create(root, robot, view) {
    /** @type {{ topic: string, measure: boolean, sort: string }} */
    const options = { topic: '', measure: false, sort: 'topic', ...view.get() };
    /** @type {Map<string, { element: HTMLElement, cells: HTMLElement[] }>} */
    const rows = new Map();
    /** @type {Map<string, Count>} */
    let counts = new Map();
    /** @type {Map<string, { hz: number, subscribers: number, dropped: number }>} */
    const rates = new Map();
    /** @type {Map<string, { count: number, bytes: number, atMs: number, hz: number, speed: number }>} */
    const measured = new Map();
    /** @type {Map<string, () => void>} */
    const measuring = new Map();

    const find = h('input', { type: 'search', placeholder: 'Topic or type', 'aria-label': 'Search in topics', 'data-testid': 'topics-search', oninput: () => show() });
    const measure = h('button', { type: 'button', class: 'button', 'aria-pressed': String(options.measure), title: 'Receive all topics, to count their bytes', onclick: () => {
      options.measure = !options.measure;
      view.set(options);
      measureAll();
    } }, 'Measure all');
    const body = h('tbody', null);
    const head = ['Topic', 'Type', 'Hz', 'Per second', 'Subs'].map((title, i) => h('th', { scope: 'col', class: i > 1 ? 'number' : i === 1 ? 'type' : '' }, h('button', { type: 'button', onclick: () => { options.sort = title.toLowerCase(); view.set(options); show(); } }, title)));
    const table = h('div', { class: 'scroll' }, h('table', { 'data-testid': 'topics' }, h('thead', null, h('tr', null, head)), body));
    const detail = h('div', { class: 'detail', hidden: true });
    root.append(h('div', { class: 'bar-row' }, find, measure), h('div', { class: 'split' }, table, detail));

    function measureAll() {
      measure.setAttribute('aria-pressed', String(options.measure));
      measure.classList.toggle('primary', options.measure);
      if (!options.measure) { for (const end of measuring.values()) end(); measuring.clear(); return; }
      for (const topic of robot.channels.keys()) if (!measuring.has(topic)) measuring.set(topic, robot.subscribe(topic, () => {}, { latest: true }));
    }

    /** Rates from the robot's own counts, which cost no subscription. */
    async function look() {
      const now = performance.now();
      for (const [topic, feed] of robot.feeds) {
        const before = measured.get(topic);
        if (before && feed.count >= before.count && now > before.atMs) {
          before.hz = ((feed.count - before.count) * 1000) / (now - before.atMs);
          before.speed = ((feed.bytes - before.bytes) * 1000) / (now - before.atMs);
        }
        measured.set(topic, { hz: before?.hz ?? 0, speed: before?.speed ?? 0, count: feed.count, bytes: feed.bytes, atMs: now });
      }
      for (const topic of measured.keys()) if (!robot.feeds.has(topic)) measured.delete(topic);
      if (robot.state === 'open') {
        try {
          const { topics, uptime_ns: uptime } = await robot.ask('snapshot');
          /** @type {Map<string, Count>} */
          const next = new Map();
          for (const { name, messages, subscribers, dropped } of topics) {
            const topic = `/${name}`;
            const before = counts.get(topic);
            next.set(topic, { messages, uptime });
            rates.set(topic, { hz: before && uptime > before.uptime ? ((messages - before.messages) * 1e9) / (uptime - before.uptime) : 0, subscribers, dropped });
          }
          counts = next;
        } catch { /* a bag counts nothing: what is received is counted here */ }
      }
      show();
    }

    function show() {
      const text = find.value.trim().toLowerCase();
      const found = [...robot.channels.values()].filter(({ topic, schemaName }) => !text || `${topic} ${schemaName}`.toLowerCase().includes(text));
      const hzOf = (/** @type {string} */ topic) => rates.get(topic)?.hz ?? measured.get(topic)?.hz ?? 0;
      /** @type {Record<string, (topic: string, type: string) => number | string>} */
      const keys = { hz: (topic) => -hzOf(topic), 'per second': (topic) => -(measured.get(topic)?.speed ?? -1), type: (_, type) => type, subs: (topic) => -(rates.get(topic)?.subscribers ?? 0) };
      const key = keys[options.sort] ?? ((topic) => topic);
      found.sort((a, b) => { const [x, y] = [key(a.topic, a.schemaName), key(b.topic, b.schemaName)]; return (x < y ? -1 : x > y ? 1 : 0) || a.topic.localeCompare(b.topic); });
      view.setTitle(`${robot.channels.size}`);
      replace(body, found.map(({ topic, schemaName }) => {
        let row = rows.get(topic);
        if (!row) {
          const cells = [0, 1, 2, 3, 4].map((i) => h('td', { class: i > 1 ? 'number' : i === 1 ? 'muted type' : '' }));
          cells[0].append(h('button', { type: 'button', class: 'row-button', onclick: () => select(options.topic === topic ? '' : topic) }, topic));
          row = { element: h('tr', null, cells), cells };
          rows.set(topic, row);
        }
        const { cells, element } = row;
        const [statistics, mine] = [rates.get(topic), measured.get(topic)];
        setText(cells[1], schemaName.replace('/msg/', '/'));
        setText(cells[2], rate(hzOf(topic)));
        setText(cells[3], mine ? `${bytes(mine.speed)}` : '–');
        setText(cells[4], statistics ? String(statistics.subscribers) : '–');
        element.setAttribute('aria-selected', String(topic === options.topic));
        return element;
      }));
      if (found.length === 0) replace(body, [h('tr', null, h('td', { colSpan: 5 }, empty(text ? 'Nothing found.' : 'No topics yet.')))]);
    }

    // ---- one topic

    let endDetail = () => {};
    /** @param {string} topic */
    function select(topic) {
      options.topic = topic;
      view.set(options);
      endDetail();
      endDetail = () => {};
      detail.hidden = !topic;
      detail.replaceChildren();
      if (topic) endDetail = showDetail(topic);
      show();
    }

    /** @param {string} topic @returns {() => void} */
    function showDetail(topic) {
      const channel = robot.channels.get(topic);
      const time = h('span', { class: 'muted mono' });
      const holder = h('div', { class: 'tree scroll', tabIndex: 0, role: 'region', 'aria-label': `Message of ${topic}`, 'data-testid': 'message' }, h('p', { class: 'leaf muted' }, 'No message yet.'));
      /** @type {import('./topics/tree.js').Node_ | null} */
      let tree = null;
      let isHeld = false;
      let lastMs = 0;
      /** @type {any} */
      let message = null;
      const hold = iconButton('pause', 'Hold this message', () => { isHeld = !isHeld; hold.setAttribute('aria-pressed', String(isHeld)); }, { 'aria-pressed': 'false' });
      const copy = h('button', { type: 'button', class: 'button', onclick: async () => {
        if (message === null) return;
        try { await navigator.clipboard.writeText(json(message)); setText(copy, 'Copied'); } catch { setText(copy, 'No clipboard'); }
        setTimeout(() => setText(copy, 'Copy'), 1500);
      } }, 'Copy');
      const close = iconButton('close', 'Close', () => select(''));
      const end = robot.subscribe(topic, (received, timeNs) => {
        const now = performance.now();
        if (isHeld || (tree && now - lastMs < TREE_MS)) return;
        lastMs = now;
        message = received;
        setText(time, clock(timeNs));
        if (!tree) { tree = treeOf(topic, received, true); holder.replaceChildren(tree.element); }
        tree.show(received);
      }, { latest: true });
      const form = channel && robot.mayChange ? publishForm(topic, channel.schemaName) : null;
      detail.append(h('div', { class: 'bar-row' }, h('b', null, topic), time, h('span', { class: 'spacer' }), hold, copy, close), holder);
      if (form) detail.append(form.element);
      return () => { end(); form?.end(); };
    }

    /** @param {string} topic @param {string} schemaName */
    function publishForm(topic, schemaName) {
      const problem = h('p', { class: 'problem', role: 'alert', style: { color: 'var(--error)' } });
      const text = h('textarea', { 'aria-label': `Message to publish on ${topic}`, spellcheck: false, 'data-testid': 'publish-text', oninput: () => check() });
      const hz = h('input', { type: 'number', min: '0.1', max: '100', step: 'any', value: '10', 'aria-label': 'Rate in Hz' });
      const once = h('button', { type: 'button', class: 'button primary', 'data-testid': 'publish', onclick: () => send() }, 'Publish');
      const repeat = h('button', { type: 'button', class: 'button', 'aria-pressed': 'false', 'data-testid': 'publish-repeat', onclick: () => (timer ? stop() : start()) }, icon('play'), 'Repeat');
      let timer = 0;
      function read() {
        const message = JSON.parse(text.value);
        encode(robot.schema(topic), message);
        return message;
      }
      function check() {
        try { read(); setText(problem, ''); text.removeAttribute('aria-invalid'); return true; } catch (error) { setText(problem, words(error)); text.setAttribute('aria-invalid', 'true'); return false; }
      }
      function send() {
        if (!check()) { stop(); return; }
        try { robot.publish(topic, schemaName, read()); } catch (error) { setText(problem, words(error)); stop(); }
      }
      function start() {
        const period = 1000 / Math.max(0.1, Math.min(100, Number(hz.value) || 10));
        timer = window.setInterval(send, period);
        repeat.replaceChildren(icon('pause'), 'Stop');
        repeat.setAttribute('aria-pressed', 'true');
        send();
      }
      function stop() {
        clearInterval(timer);
        timer = 0;
        repeat.replaceChildren(icon('play'), 'Repeat');
        repeat.setAttribute('aria-pressed', 'false');
      }
      try { text.value = json(template(robot.schema(topic))); } catch (error) { setText(problem, words(error)); }
      const element = h('details', { class: 'publish' }, h('summary', { class: 'bar-row' }, 'Publish on this topic'),
        h('div', { class: 'form' }, text, problem, h('div', { class: 'row' }, once, repeat, hz, h('span', { class: 'muted' }, 'Hz'))));
      return { element, end: stop };
    }

    robot.addEventListener('channels', () => { show(); if (options.measure) measureAll(); });
    measureAll();
    if (options.topic) select(options.topic);
    robot.every(PERIOD_MS, look);
    return { destroy() { endDetail(); }, seeked() {} };
  },
};
