// @ts-check
// The joints of the robot: position, goal, load, and what the diagnostics say of their servos.

import { empty, h, number, replace, setText } from '../panel.js';

/**
 * @typedef {{ name: string, position: number, velocity: number, effort: number, goal: number, seenMs: number, id: number,
 *   temperature: number, voltage: number, level: number, message: string, bus: string, missed: number, outages: number, lostMs: number }} Joint
 *   `missed`: answers; `outages`: how often it was out of service; `lostMs`: when the last answer was missed
 */

const STALE_MS = 2000;
const MOST_JOINTS = 500;
const HOT = 60;
/** A servo that has missed an answer in this time is one that misses answers. */
const LOSS_MS = 10_000;
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
    /** @type {{ degrees: boolean, sort: number, down: boolean }} */
    const options = { degrees: true, sort: 0, down: false, ...view.get() };
    /** @type {Map<string, Joint>} */
    const joints = new Map();
    /** @type {Map<string, ReturnType<typeof rowOf>>} */
    const rows = new Map();
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

    /** @param {string} name */
    const jointOf = (name) => {
      let joint = joints.get(name);
      if (!joint && joints.size < MOST_JOINTS) {
        joint = { name, position: NaN, velocity: NaN, effort: NaN, goal: NaN, seenMs: 0, id: joints.size + 1, temperature: NaN, voltage: NaN, level: -1, message: '', bus: '', missed: NaN, outages: NaN, lostMs: -Infinity };
        joints.set(name, joint);
      }
      return joint;
    };
    robot.subscribe('/joint_states', ({ name, position, velocity, effort }) => {
      const now = performance.now();
      name.forEach((/** @type {string} */ each, /** @type {number} */ i) => {
        const joint = jointOf(each);
        if (joint) Object.assign(joint, { position: position[i] ?? NaN, velocity: velocity[i] ?? NaN, effort: effort[i] ?? NaN, seenMs: now });
      });
    }, { latest: true });
    const goals = robot.channels.has('/joint_goals') ? '/joint_goals' : '/joint_commands';
    robot.subscribe(goals, ({ name, position }) => {
      name.forEach((/** @type {string} */ each, /** @type {number} */ i) => { const joint = joints.get(each); if (joint) joint.goal = position[i] ?? NaN; });
    });
    robot.subscribe('/robot_description', ({ data }) => {
      for (const joint of new DOMParser().parseFromString(data, 'text/xml').querySelectorAll('robot > joint')) {
        const limit = joint.querySelector('limit');
        const range = [Number(limit?.getAttribute('lower') ?? NaN), Number(limit?.getAttribute('upper') ?? NaN)];
        if (range[1] > range[0]) limits.set(joint.getAttribute('name') ?? '', /** @type {[number, number]} */ (range));
      }
    }, { latest: true });
    robot.subscribe('/diagnostics', ({ status }) => {
      for (const { name, level, message, values } of status) {
        // `darwin_op: servo 3 head_pan`, or any part whose last word is the name of a joint.
        const joint = joints.get(/(\S+)$/.exec(name)?.[1] ?? '');
        if (!joint) continue;
        const id = /\b(\d+)\s+\S+$/.exec(name);
        if (id) joint.id = Number(id[1]);
        Object.assign(joint, { level, message, bus: name.slice(0, Math.max(0, name.indexOf(':'))) });
        for (const { key, value } of values) {
          if (/temperature/i.test(key)) joint.temperature = Number(value);
          else if (/voltage/i.test(key)) joint.voltage = Number(value);
          else if (/missed/i.test(key)) {
            if (Number(value) > joint.missed) joint.lostMs = performance.now();
            joint.missed = Number(value);
          } else if (/out of service/i.test(key)) joint.outages = Number(value);
        }
      }
    });

    function show() {
      if (joints.size === 0) { replace(root, [nothing]); return; }
      replace(root, [cable, table]);
      const now = performance.now();
      const trouble = cableTrouble([...joints.values()], now);
      cable.hidden = trouble === '';
      setText(cable, trouble);
      heads.forEach((head, i) => (i === options.sort ? head.setAttribute('aria-sort', options.down ? 'descending' : 'ascending') : head.removeAttribute('aria-sort')));
      const key = COLUMNS[options.sort]?.[2] ?? COLUMNS[0][2];
      const sign = options.down ? -1 : 1;
      const sorted = [...joints.values()].sort((a, b) => {
        const [x, y] = [key(a), key(b)];
        return sign * (typeof x === 'string' ? x.localeCompare(String(y)) : (Number.isNaN(x) ? Infinity : x) - (Number.isNaN(Number(y)) ? Infinity : Number(y))) || a.id - b.id;
      });
      const faults = sorted.filter(({ level }) => level > 0).length;
      const hottest = Math.max(...sorted.map(({ temperature }) => (Number.isNaN(temperature) ? -Infinity : temperature)));
      view.setTitle(`${sorted.length}${faults > 0 ? `, ${faults} with faults` : ''}${Number.isFinite(hottest) ? `, up to ${hottest} °C` : ''}`);
      replace(body, sorted.map((joint) => {
        let row = rows.get(joint.name);
        if (!row) { row = rowOf(joint.name); rows.set(joint.name, row); }
        row.show(joint, options.degrees, limits.get(joint.name) ?? [-Math.PI, Math.PI], now - joint.seenMs > STALE_MS);
        return row.element;
      }));
    }
    robot.every(100, show);
    return { destroy() {}, seeked() { for (const joint of joints.values()) Object.assign(joint, { goal: NaN, level: -1, message: '', temperature: NaN, voltage: NaN, missed: NaN, outages: NaN, lostMs: -Infinity }); } };
  },
};

/**
 * Where a cable is bad: from one servo on, all miss answers. The servos of a bus are in the order in which the robot reports them, which is
 * that of their description.
 * @param {Joint[]} joints @param {number} nowMs
 */
export function cableTrouble(joints, nowMs) {
  for (const bus of new Set(joints.map((joint) => joint.bus))) {
    const chain = joints.filter((joint) => joint.bus === bus && joint.level >= 0);
    const loses = (/** @type {Joint} */ { lostMs }) => nowMs - lostMs < LOSS_MS;
    const first = chain.findIndex(loses);
    if (chain.length < 2 || first < 0 || !chain.slice(first).every(loses)) continue;
    if (first === 0) return `No servo of ${bus} answers reliably: its power, or the cable to ${chain[0].name}.`;
    if (first < chain.length - 1) return `From ${chain[first].name} (id ${chain[first].id}) on, servos of ${bus} miss answers: look at the cable between ${chain[first - 1].name} and ${chain[first].name}, if the description lists them as the cable does.`;
  }
  return '';
}

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
