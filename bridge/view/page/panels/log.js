// @ts-check
// What the program logs, and what nodes publish as rcl_interfaces/Log.

import { clock, h, setText } from '../panel.js';
import { words } from '../connection.js';

/** @typedef {{ time: bigint, level: number, source: string, text: string }} Line */

const LEVELS = ['trace', 'debug', 'info', 'warn', 'error'];
/** Lines that are kept, and those that are on the page. */
const MOST_LINES = 5000;
const MOST_SHOWN = 1000;
const PERIOD_MS = 400;

/** @type {import('../panel.js').Panel} */
export default {
  id: 'log',
  title: 'Log',
  create(root, robot, view) {
    /** @type {{ level: number }} */
    const options = { level: 2, ...view.get() };
    /** @type {Line[]} */
    let lines = [];
    let after = -1;
    let dropped = 0;
    let isAsking = false;
    let follows = true;
    let search = '';
    let isDirty = true;

    const level = h('select', { 'aria-label': 'Least level', 'data-testid': 'log-level', onchange: () => { options.level = Number(level.value); view.set(options); again(); } },
      LEVELS.map((name, i) => h('option', { value: String(i), selected: i === options.level }, i === 4 ? 'errors' : `${name} and above`)));
    const find = h('input', { type: 'search', placeholder: 'Search', 'aria-label': 'Search in the log', 'data-testid': 'log-search', oninput: () => { search = find.value.toLowerCase(); again(); } });
    const newest = h('button', { type: 'button', class: 'button', hidden: true, onclick: () => { follows = true; list.scrollTop = list.scrollHeight; newest.hidden = true; } }, 'To the newest');
    const notice = h('div', { class: 'notice', hidden: true });
    const list = h('div', { class: 'log', role: 'log', 'aria-label': 'Log', 'aria-live': 'off', tabIndex: 0, 'data-testid': 'log', onscroll: () => {
      follows = list.scrollHeight - list.scrollTop - list.clientHeight < 30;
      newest.hidden = follows;
    } });
    root.append(h('div', { class: 'bar-row' }, find, level, newest), notice, list);

    /** @param {Line} line */
    const isWanted = (line) => line.level >= options.level && (!search || line.text.toLowerCase().includes(search) || line.source.toLowerCase().includes(search));
    /** @type {Line[]} */
    let waiting = [];
    function again() { list.replaceChildren(); waiting = lines.filter(isWanted).slice(-MOST_SHOWN); isDirty = true; show(); }
    /** @param {Line} line */
    function take(line) {
      lines.push(line);
      if (lines.length > MOST_LINES) lines = lines.slice(-MOST_LINES * 0.8);
      if (isWanted(line)) { waiting.push(line); if (waiting.length > MOST_SHOWN) waiting.shift(); isDirty = true; }
    }

    function show() {
      if (!isDirty) return;
      isDirty = false;
      list.append(...waiting.map(elementOf));
      waiting = [];
      while (list.children.length > MOST_SHOWN) list.firstElementChild?.remove();
      if (follows) list.scrollTop = list.scrollHeight;
      view.setTitle(dropped > 0 ? `${lines.length} lines, ${dropped} older ones are gone` : `${lines.length} lines`);
    }

    /** @param {Line} line */
    function elementOf({ time, level: rank, source, text }) {
      const name = LEVELS[rank];
      return h('div', { class: `log-line ${name}` }, h('span', null, clock(time)), h('span', { class: 'level' }, name), h('p', null, source ? h('span', { class: 'muted' }, `${source}: `) : null, marked(text)));
    }

    /** @param {string} text */
    function marked(text) {
      if (!search) return [text];
      const at = text.toLowerCase().indexOf(search);
      return at < 0 ? [text] : [text.slice(0, at), h('mark', null, text.slice(at, at + search.length)), text.slice(at + search.length)];
    }

    async function ask() {
      if (isAsking || robot.state !== 'open') return;
      isAsking = true;
      try {
        const answer = await robot.ask('log', after >= 0 ? { after } : {});
        for (const { sequence, time_ns: time, level: name, module: source, text } of answer.lines) {
          after = Math.max(after, sequence);
          take({ time: BigInt(Math.round(Number(time))), level: Math.max(0, LEVELS.indexOf(String(name).toLowerCase())), source: source ?? '', text });
        }
        dropped = answer.dropped ?? 0;
        notice.hidden = true;
      } catch (error) {
        if (lines.length === 0) { setText(notice, `The program’s log is not here: ${words(error)}`); notice.hidden = false; }
      } finally { isAsking = false; }
      show();
    }
    robot.addEventListener('state', () => { if (robot.state !== 'open') { after = -1; lines = []; again(); } });
    function watch() {
      for (const topic of robot.topicsOf('rcl_interfaces/msg/Log')) {
        if (watched.has(topic)) continue;
        watched.add(topic);
        robot.subscribe(topic, ({ level: rank, name, msg }, time) => take({ time, level: Math.max(0, Math.min(4, Math.floor(rank / 10) - (rank >= 50 ? 1 : 0))), source: name, text: msg }));
      }
    }
    /** @type {Set<string>} */
    const watched = new Set();
    watch();
    robot.addEventListener('channels', watch);
    robot.every(PERIOD_MS, () => { ask(); show(); });
    return { destroy() {}, seeked() { lines = lines.filter(({ time }) => time <= robot.timeNs); again(); } };
  },
};
