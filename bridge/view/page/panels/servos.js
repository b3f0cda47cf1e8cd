// @ts-check
// The joints of the robot: position, goal, load, and what the diagnostics say of their servos.

import { empty, h, number, replace, setText } from '../panel.js';
import { LOSS_MS, Servos, cableTrouble } from './servos_data.js';

/** @typedef {import('./servos_data.js').Joint} Joint */

const STALE_MS = 2000;
const HOT = 60;
const COLUMNS = /** @type {[string, string, (joint: Joint) => string | number][]} */ ([
  ['ID', 'number lesser', ({ id }) => id], ['Joint', '', ({ name }) => name], ['Position', 'number', ({ position }) => position], ['', '', ({ position }) => position],
  ['Goal', 'number minor', ({ goal }) => goal], ['Velocity', 'number minor', ({ velocity }) => velocity], ['Load', 'number lesser', ({ effort }) => Math.abs(effort)],
  ['Temp.', 'number', ({ temperature }) => temperature], ['Voltage', 'number minor', ({ voltage }) => voltage], ['Missed', 'number minor', ({ missed }) => missed], ['Outages', 'number minor', ({ outages }) => outages], ['Status', 'lesser', ({ level, message }) => `${9 - level} ${message}`],
]);

/** @type {import('../panel.js').Panel} */
export default {
  id: 'servos',
  title: 'Servos',
  create(root, robot, view) {
    /** Without a column to sort by, joints are in the order of the cable. @type {{ degrees: boolean, sort: number, down: boolean }} */
    const options = { degrees: true, sort: -1, down: false, ...view.get() };
    const servos = new Servos();
    /** @type {Map<string, ReturnType<typeof rowOf>>} */
    const rows = new Map();
    /** @type {Map<string, HTMLTableRowElement>} */
    const titles = new Map();
    /** @type {Map<string, [number, number]>} */
    const limits = new Map();
    const body = h('tbody', null);
    const heads = COLUMNS.map(([title, kind], i) => h('th', { scope: 'col', class: kind }, title
      ? h('button', { type: 'button', onclick: () => { options.down = options.sort === i ? !options.down : false; options.sort = i; view.set(options); show(); } }, title)
      : h('span', { class: 'sr' }, 'Position in its range')));
    const units = h('div', { class: 'segments', role: 'group', 'aria-label': 'Unit' }, ['°', 'rad'].map((text, i) => h('button', {
      type: 'button', 'aria-pressed': String(options.degrees === (i === 0)), onclick: () => {
        options.degrees = i === 0;
        [...units.children].forEach((button, k) => button.setAttribute('aria-pressed', String(k === i)));
        view.set(options);
        show();
      } }, text)));
    view.header.append(units);
    const cable = h('output', { role: 'status', class: 'notice', 'data-testid': 'servos-cable', hidden: true });
    const table = h('div', { class: 'scroll' }, h('table', { 'data-testid': 'servos' }, h('thead', null, h('tr', null, heads)), body));
    const nothing = empty('No joints here.', 'No topic carries sensor_msgs/JointState.');

    /** @type {Set<string>} */
    const subscribed = new Set();
    const listen = () => {
      for (const { topic, schemaName } of robot.channels.values()) {
        if (schemaName !== 'sensor_msgs/msg/JointState' || subscribed.has(topic)) continue;
        const isOf = (/** @type {string[]} */ ...names) => names.includes(topic.slice(topic.lastIndexOf('/') + 1));
        if (isOf('joint_states')) robot.subscribe(topic, (message) => servos.takeStates(topic, message, performance.now()), { latest: true });
        else if (isOf('joint_goals', 'joint_commands')) robot.subscribe(topic, (message) => servos.takeGoals(topic, message));
        else continue;
        subscribed.add(topic);
      }
    };
    robot.addEventListener('channels', listen);
    listen();
    robot.subscribe('/robot_description', ({ data }) => {
      for (const joint of new DOMParser().parseFromString(data, 'text/xml').querySelectorAll('robot > joint')) {
        const limit = joint.querySelector('limit');
        const range = [Number(limit?.getAttribute('lower') ?? NaN), Number(limit?.getAttribute('upper') ?? NaN)];
        if (range[1] > range[0]) limits.set(joint.getAttribute('name') ?? '', /** @type {[number, number]} */ (range));
      }
    }, { latest: true });
    robot.subscribe('/diagnostics', (message) => servos.takeDiagnostics(message, performance.now()));

    function show() {
      const groups = servos.groups();
      const joints = groups.flatMap((group) => group.joints);
      if (joints.length === 0) { replace(root, [nothing]); return; }
      replace(root, [cable, table]);
      const now = performance.now();
      const trouble = cableTrouble(joints, now);
      cable.hidden = trouble === '';
      setText(cable, trouble);
      heads.forEach((head, i) => (i === options.sort ? head.setAttribute('aria-sort', options.down ? 'descending' : 'ascending') : head.removeAttribute('aria-sort')));
      const key = COLUMNS[options.sort]?.[2];
      const sign = options.down ? -1 : 1;
      const sorted = (/** @type {Joint[]} */ all) => (key === undefined ? all : [...all].sort((a, b) => {
        const [x, y] = [key(a), key(b)];
        return sign * (typeof x === 'string' ? x.localeCompare(String(y)) : (Number.isNaN(x) ? Infinity : x) - (Number.isNaN(Number(y)) ? Infinity : Number(y))) || a.id - b.id;
      }));
      const faults = joints.filter(({ level }) => level > 0).length;
      const hottest = Math.max(...joints.map(({ temperature }) => (Number.isNaN(temperature) ? -Infinity : temperature)));
      view.setTitle(`${joints.length}${faults > 0 ? `, ${faults} with faults` : ''}${Number.isFinite(hottest) ? `, up to ${hottest} °C` : ''}`);
      replace(body, groups.flatMap((group) => {
        const lines = sorted(group.joints).map((joint) => {
          let row = rows.get(joint.key);
          if (!row) { row = rowOf(joint.name); rows.set(joint.key, row); }
          row.show(joint, options.degrees, limits.get(joint.name) ?? [-Math.PI, Math.PI], joint.seenMs === -Infinity ? joint.level < 0 : now - joint.seenMs > STALE_MS);
          return row.element;
        });
        if (groups.length === 1) return lines;
        let title = titles.get(group.key);
        if (!title) { title = h('tr', { 'data-testid': 'servos-bus' }, h('th', { scope: 'rowgroup', colSpan: COLUMNS.length })); titles.set(group.key, title); }
        setText(/** @type {HTMLElement} */ (title.firstElementChild), group.label);
        return [title, ...lines];
      }));
    }
    robot.every(100, show);
    return { destroy() {}, seeked() { servos.forget(); } };
  },
};

/** Without the sign of a zero. @param {number} value @param {number} decimals */
const fixed = (value, decimals) => value.toFixed(decimals).replace(/^-(0(\.0*)?)$/, '$1').replace('-', '−');

/** @param {string} name */
function rowOf(name) {
  const cells = COLUMNS.map(([, kind]) => h('td', { class: kind }));
  const [id, title, position, range, goal, velocity, load, temperature, voltage, missed, outages, status] = cells;
  const [mark, goalMark] = [h('i', null), h('i', { class: 'goal' })];
  range.append(h('div', { class: 'position-meter' }, goalMark, mark));
  title.textContent = name;
  const element = h('tr', null, cells);
  return {
    element,
    /** @param {Joint} joint @param {boolean} degrees @param {[number, number]} limits @param {boolean} isStale */
    show(joint, degrees, [low, high], isStale) {
      const angle = (/** @type {number} */ value) => (Number.isNaN(value) ? '–' : degrees ? `${fixed((value * 180) / Math.PI, 1)}°` : number(value));
      const part = (/** @type {number} */ value) => `${Math.max(0, Math.min(100, ((value - low) / (high - low)) * 100))}%`;
      setText(id, String(joint.id));
      setText(position, angle(joint.position));
      setText(goal, angle(joint.goal));
      setText(velocity, angle(joint.velocity));
      setText(load, Number.isNaN(joint.effort) ? '–' : fixed(joint.effort, 2));
      setText(temperature, Number.isNaN(joint.temperature) ? '–' : `${joint.temperature} °C`);
      temperature.style.color = joint.temperature >= HOT ? 'var(--error)' : joint.temperature >= HOT - 10 ? 'var(--warn)' : '';
      setText(voltage, Number.isNaN(joint.voltage) ? '–' : `${joint.voltage} V`);
      setText(missed, Number.isNaN(joint.missed) ? '–' : String(joint.missed));
      missed.style.color = performance.now() - joint.lostMs < LOSS_MS ? 'var(--warn)' : '';
      setText(outages, Number.isNaN(joint.outages) ? '–' : String(joint.outages));
      setText(status, isStale ? 'no news' : joint.message || (joint.level === 0 ? 'OK' : '–'));
      element.className = isStale ? 'stale' : joint.level === 1 ? 'warn' : joint.level >= 2 ? 'error' : '';
      mark.style.left = part(joint.position);
      mark.hidden = Number.isNaN(joint.position);
      goalMark.style.left = part(joint.goal);
      goalMark.hidden = Number.isNaN(joint.goal);
    },
  };
}
