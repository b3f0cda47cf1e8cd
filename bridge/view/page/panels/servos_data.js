// @ts-check
// What is known of the joints of a robot, from the states of joints, their goals and the diagnostics of their servos.

/**
 * @typedef {{ key: string, name: string, position: number, velocity: number, effort: number, goal: number, seenMs: number, id: number,
 *   temperature: number, voltage: number, level: number, message: string, bus: string, missed: number, outages: number, lostMs: number }} Joint
 *   `key`: two arms may have joints of the same names; `missed`: answers; `outages`: how often it was out of service; `lostMs`: when the last
 *   answer was missed
 * @typedef {{ position: number, velocity: number, effort: number, seenMs: number }} State
 * @typedef {{ key: string, label: string, port: string, states: string, commands: string, joints: Map<string, Joint> }} Bus
 *   `states` and `commands` are topics, empty if the diagnostics do not name them; `joints` are in the order of the diagnostics, which is
 *   that of the description
 */

const MOST_JOINTS = 500;
const ROOT_STATES = '/joint_states';

/** A topic as the page names it. @param {string | undefined} name */
const topicOf = (name) => (name ? `/${name.replace(/^\/+/, '')}` : '');

/** @param {string} key @param {string} name @param {number} id @returns {Joint} */
const newJoint = (key, name, id) => ({
  key, name, id, position: NaN, velocity: NaN, effort: NaN, goal: NaN, seenMs: -Infinity, temperature: NaN, voltage: NaN, level: -1, message: '', bus: '',
  missed: NaN, outages: NaN, lostMs: -Infinity,
});

/** The joints of all buses. */
export class Servos {
  constructor() {
    /** @type {Map<string, Bus>} */
    this.buses = new Map();
    /** By topic and joint. @type {Map<string, Map<string, State>>} */
    this.states = new Map();
    /** By topic and joint. @type {Map<string, Map<string, number>>} */
    this.goals = new Map();
    /** Joints of which no diagnostics speak. @type {Map<string, Joint>} */
    this.others = new Map();
  }

  /** @param {string} topic @param {{ name: string[], position: ArrayLike<number>, velocity: ArrayLike<number>, effort: ArrayLike<number> }} message @param {number} nowMs */
  takeStates(topic, { name, position, velocity, effort }, nowMs) {
    const known = this.states.get(topic) ?? new Map();
    this.states.set(topic, known);
    name.forEach((each, i) => {
      if (known.size >= MOST_JOINTS && !known.has(each)) return;
      known.set(each, { position: position[i] ?? NaN, velocity: velocity[i] ?? NaN, effort: effort[i] ?? NaN, seenMs: nowMs });
    });
  }

  /** @param {string} topic @param {{ name: string[], position: ArrayLike<number> }} message */
  takeGoals(topic, { name, position }) {
    const known = this.goals.get(topic) ?? new Map();
    this.goals.set(topic, known);
    name.forEach((each, i) => { if (known.size < MOST_JOINTS || known.has(each)) known.set(each, position[i] ?? NaN); });
  }

  /** @param {{ status: any[] }} message @param {number} nowMs */
  takeDiagnostics({ status }, nowMs) {
    /** The buses of this message: a module reports its own in one. @type {Map<string, Bus>} */
    const reported = new Map();
    const robotOf = (/** @type {any} */ { name, hardware_id: hardware }) => `${hardware} ${name.slice(0, Math.max(0, name.indexOf(':')))}`;
    for (const one of status) {
      const named = /: bus(?: (\S+))?$/.exec(one.name);
      if (!named) continue;
      const value = (/** @type {string} */ key) => one.values.find((/** @type {any} */ each) => each.key === key)?.value;
      // Two arms of one description differ by their ports.
      const bus = this.bus(`${robotOf(one)} ${named[1] ?? ''} ${value('port') ?? ''}`, [one.hardware_id || one.name.split(':')[0], named[1]].filter(Boolean).join(' '));
      Object.assign(bus, { port: value('port') ?? '', states: topicOf(value('joint_states')), commands: topicOf(value('joint_commands')) });
      reported.set(robotOf(one), bus);
    }
    for (const one of status) {
      // `darwin_op: servo 3 head_pan`, or any part whose last word is the name of a joint.
      const [, id, name] = /(?:\bservo (\d+) )?(\S+)$/.exec(one.name) ?? [];
      if (name === undefined || (id === undefined && ![...this.states.values()].some((joints) => joints.has(name)))) continue;
      const bus = reported.get(robotOf(one)) ?? this.bus(robotOf(one), one.hardware_id || one.name.split(':')[0]);
      let joint = bus.joints.get(name);
      if (!joint) {
        if (bus.joints.size >= MOST_JOINTS) continue;
        joint = newJoint(`${bus.key} ${name}`, name, bus.joints.size + 1);
        bus.joints.set(name, joint);
      }
      if (id !== undefined) joint.id = Number(id);
      joint.level = one.level;
      joint.message = one.message;
      for (const { key, value } of one.values) {
        if (/temperature/i.test(key)) joint.temperature = Number(value);
        else if (/voltage/i.test(key)) joint.voltage = Number(value);
        else if (/missed/i.test(key)) {
          if (Number(value) > joint.missed) joint.lostMs = nowMs;
          joint.missed = Number(value);
        } else if (/out of service/i.test(key)) joint.outages = Number(value);
      }
    }
  }

  /** @param {string} key @param {string} label @returns {Bus} */
  bus(key, label) {
    const known = this.buses.get(key);
    if (known) return known;
    const bus = { key, label, port: '', states: '', commands: '', joints: new Map() };
    // More buses than any robot has: the last one takes the rest.
    if (this.buses.size >= MOST_JOINTS) return [...this.buses.values()][this.buses.size - 1];
    this.buses.set(key, bus);
    return bus;
  }

  /**
   * The joints of each bus, in the order of their description, with their states and goals. In the end those of which no diagnostics speak.
   * @returns {{ key: string, label: string, joints: Joint[] }[]}
   */
  groups() {
    const buses = [...this.buses.values()].filter(({ joints }) => joints.size > 0);
    const claimed = new Set(buses.map(({ states }) => states));
    /** Topics that no bus calls its own: of robots that do not say, or in which several are merged. */
    const shared = [...this.states].filter(([topic]) => !claimed.has(topic)).map(([, joints]) => joints);
    const rootGoals = this.goals.get('/joint_goals') ?? this.goals.get('/joint_commands');
    const groups = buses.map((bus) => {
      const labels = buses.filter(({ label }) => label === bus.label).length;
      const label = labels > 1 && bus.port ? `${bus.label}, ${bus.port}` : bus.label;
      const joints = [...bus.joints.values()].map((joint) => {
        const state = this.states.get(bus.states)?.get(joint.name) ?? shared.find((joints) => joints.has(joint.name))?.get(joint.name);
        const goals = bus.commands ? this.goals.get(bus.commands) : rootGoals;
        return Object.assign(joint, state, { bus: label, goal: goals?.get(joint.name) ?? NaN });
      });
      return { key: bus.key, label, joints };
    });
    const isReported = (/** @type {string} */ topic, /** @type {string} */ name) =>
      buses.some((bus) => bus.joints.has(name) && (bus.states === topic || !claimed.has(topic)));
    for (const [topic, states] of this.states) {
      const others = [...states].filter(([name]) => !isReported(topic, name)).map(([name, state], place) => {
        const key = `${topic} ${name}`;
        const joint = this.others.get(key) ?? newJoint(key, name, place + 1);
        this.others.set(key, joint);
        return Object.assign(joint, state, { goal: (topic === ROOT_STATES ? rootGoals : undefined)?.get(name) ?? NaN });
      });
      if (others.length > 0) groups.push({ key: topic, label: topic, joints: others });
    }
    return groups;
  }

  /** Playback jumped: what diagnostics and goals said is of another time. */
  forget() {
    this.goals.clear();
    for (const { joints } of this.buses.values()) {
      for (const joint of joints.values()) Object.assign(joint, { level: -1, message: '', temperature: NaN, voltage: NaN, missed: NaN, outages: NaN, lostMs: -Infinity });
    }
  }
}

/** A servo that has missed an answer in this time is one that misses answers. */
export const LOSS_MS = 10_000;

/**
 * Where a cable is bad: from one servo on, all miss answers. The servos of a bus are in the order in which the robot reports them, which is
 * that of their description.
 * @param {Pick<Joint, 'name' | 'id' | 'bus' | 'level' | 'lostMs'>[]} joints @param {number} nowMs
 */
export function cableTrouble(joints, nowMs) {
  for (const bus of new Set(joints.map((joint) => joint.bus))) {
    const chain = joints.filter((joint) => joint.bus === bus && joint.level >= 0);
    const loses = (/** @type {{ lostMs: number }} */ { lostMs }) => nowMs - lostMs < LOSS_MS;
    const first = chain.findIndex(loses);
    if (chain.length < 2 || first < 0 || !chain.slice(first).every(loses)) continue;
    if (first === 0) return `No servo of ${bus} answers reliably: its power, or the cable to ${chain[0].name}.`;
    if (first < chain.length - 1) return `From ${chain[first].name} (id ${chain[first].id}) on, servos of ${bus} miss answers: look at the cable between ${chain[first - 1].name} and ${chain[first].name}, if the description lists them as the cable does.`;
  }
  return '';
}
