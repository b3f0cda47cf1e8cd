// @ts-check
// What the timeline computes from a trace, without drawing.

/**
 * The answer of the ask `trace`.
 * @typedef {{ kind: 'run' | 'step' | 'process' | 'sync', module?: string | null, thread: number, cycle: number, begin_ns: number, end_ns: number,
 *   causes?: string[] }} TraceEvent
 * @typedef {{ threads: string[], events: TraceEvent[] }} Trace
 * @typedef {{ name: string, phases: TraceEvent[], work: TraceEvent[] }} Lane  each in the order of time
 * @typedef {{ event: TraceEvent, cause: TraceEvent, topic: string }} Arrow
 */

const MESSAGE = /^message on (.+)$/;
/** How far a chain of causes is followed. */
const LONGEST_CHAIN = 16;

/** A lane per thread, in the order in which they first did something. */
export class Timeline {
  /** @param {Trace} trace @param {Map<string, string[]>} publishers of each topic */
  constructor({ threads, events }, publishers = new Map()) {
    this.publishers = publishers;
    this.events = [...events].sort((a, b) => a.begin_ns - b.begin_ns || b.end_ns - a.end_ns);
    this.begin = this.events.length > 0 ? this.events[0].begin_ns : 0;
    this.end = this.events.reduce((latest, { end_ns: end }) => Math.max(latest, end), this.begin);
    /** @type {Lane[]} */
    const all = threads.map((name) => ({ name, phases: [], work: [] }));
    /** @type {Map<string, TraceEvent[]>} */
    this.byModule = new Map();
    /** @type {Map<number, { begin: number, end: number }>} */
    this.cycles = new Map();
    for (const event of this.events) {
      const lane = all[event.thread];
      if (!lane) continue;
      (isPhase(event) ? lane.phases : lane.work).push(event);
      if (event.module) {
        const own = this.byModule.get(event.module) ?? [];
        own.push(event);
        this.byModule.set(event.module, own);
      }
      if (event.kind === 'step') continue;
      const cycle = this.cycles.get(event.cycle);
      if (!cycle) this.cycles.set(event.cycle, { begin: event.begin_ns, end: event.end_ns });
      else [cycle.begin, cycle.end] = [Math.min(cycle.begin, event.begin_ns), Math.max(cycle.end, event.end_ns)];
    }
    this.lanes = all.filter(({ phases, work }) => phases.length + work.length > 0)
      .sort((a, b) => first(a) - first(b));
    this.modules = [...this.byModule.keys()].sort();
  }

  /**
   * The run that published the message for which this one ran: the last of a publisher that began before it.
   * @param {TraceEvent} event @returns {Arrow[]}
   */
  causesOf(event) {
    return (event.causes ?? []).flatMap((words) => {
      const topic = MESSAGE.exec(words)?.[1]?.replace(/^\//, '');
      if (!topic) return [];
      let cause = null;
      for (const name of this.publishers.get(topic) ?? []) {
        const runs = this.byModule.get(name) ?? [];
        // A step's outputs join the cycle that it names: what it has not finished cannot be a cause.
        for (let at = before(runs, event.begin_ns); at >= 0; at -= 1) {
          const run = runs[at];
          if (run === event || (run.kind === 'step' && run.end_ns > event.begin_ns)) continue;
          if (!cause || run.end_ns > cause.end_ns) cause = run;
          break;
        }
      }
      return cause ? [{ event, cause, topic }] : [];
    });
  }

  /** The causes of an event, and theirs. @param {TraceEvent} event @returns {Arrow[]} */
  chainOf(event) {
    const arrows = this.causesOf(event);
    const seen = new Set([event]);
    for (let at = 0; at < arrows.length && arrows.length < LONGEST_CHAIN; at += 1) {
      const { cause } = arrows[at];
      if (seen.has(cause)) continue;
      seen.add(cause);
      arrows.push(...this.causesOf(cause));
    }
    return arrows;
  }

  /** What overlaps a time, in the order of time. @param {number} begin @param {number} end @param {TraceEvent[]} [events] */
  within(begin, end, events = this.events) {
    return events.slice(0, before(events, end) + 1).filter((event) => event.end_ns >= begin);
  }

  /**
   * Per module: how often and how long it ran within a time, the longest total first.
   * @param {number} begin @param {number} end
   */
  statistics(begin, end) {
    return [...this.byModule].flatMap(([module, runs]) => {
      const times = this.within(begin, end, runs).map((run) => run.end_ns - run.begin_ns).sort((a, b) => a - b);
      if (times.length === 0) return [];
      const total = times.reduce((sum, time) => sum + time, 0);
      return [{ module, runs: times.length, median: times[Math.floor((times.length - 1) / 2)], longest: times[times.length - 1], total, share: total / Math.max(1, end - begin) }];
    }).sort((a, b) => b.total - a.total);
  }

  /** What is at a time in a lane, at most `slack` away; the shortest if several are. @param {TraceEvent[]} events @param {number} time @param {number} slack */
  at(events, time, slack) {
    let best = null;
    let least = Infinity;
    for (let at = before(events, time + slack); at >= 0 && events[at].begin_ns > time - slack - 1e9; at -= 1) {
      const { begin_ns: begin, end_ns: end } = events[at];
      const distance = time < begin ? begin - time : time > end ? time - end : 0;
      const cost = distance * 1e6 + (end - begin);
      if (distance <= slack && cost < least) [best, least] = [events[at], cost];
    }
    return best;
  }
}

/** @param {TraceEvent} event */
export const isPhase = ({ kind }) => kind === 'process' || kind === 'sync';
/** @param {Lane} lane */
const first = ({ phases, work }) => (phases.length > 0 ? -1 : 0) || (work[0]?.begin_ns ?? 0);

/** The index of the last event that begins at or before a time, or -1. @param {TraceEvent[]} events @param {number} time */
function before(events, time) {
  let [low, high] = [0, events.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (events[middle].begin_ns <= time) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** Which modules publish each topic. @param {import('./graph_data.js').Graph} graph @returns {Map<string, string[]>} */
export function publishersOf({ modules, topics, edges }) {
  /** @type {Map<string, string[]>} */
  const publishers = new Map();
  for (const { publishes } of edges) {
    if (!publishes) continue;
    const { name } = topics[publishes.topic];
    const list = publishers.get(name) ?? [];
    list.push(modules[publishes.module].name);
    publishers.set(name, list);
  }
  return publishers;
}

/** Steps of an axis: 1, 2 or 5 times a power of ten. @param {number} span @param {number} most how many */
export function niceStep(span, most) {
  const rough = span / Math.max(1, most);
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= rough) ?? 10 * power;
}
