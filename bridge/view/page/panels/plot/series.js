// @ts-check
// Numbers over time: a bounded buffer, and what of it a picture needs.

const FIRST_CAPACITY = 1024;
/** The newest points that are kept: 5 minutes at 125 Hz. */
export const MOST_POINTS = 40_000;

/** Points in the order of time. When it is full, the oldest are forgotten. */
export class Series {
  /** @param {number} [most] */
  constructor(most = MOST_POINTS) {
    this.most = most;
    this.times = new Float64Array(Math.min(FIRST_CAPACITY, most));
    this.values = new Float64Array(this.times.length);
    this.start = 0;
    this.length = 0;
  }

  /** @param {number} time @param {number} value */
  push(time, value) {
    // Time that runs backward is another run, or a jump of playback.
    if (this.length > 0 && time < this.time(this.length - 1)) this.clear();
    if (this.length === this.times.length) {
      if (this.length < this.most) this.grow();
      else { this.start = (this.start + 1) % this.times.length; this.length--; }
    }
    const at = (this.start + this.length) % this.times.length;
    this.times[at] = time;
    this.values[at] = value;
    this.length++;
  }

  grow() {
    const capacity = Math.min(this.times.length * 2, this.most);
    const [times, values] = [new Float64Array(capacity), new Float64Array(capacity)];
    for (let i = 0; i < this.length; i++) { times[i] = this.time(i); values[i] = this.value(i); }
    Object.assign(this, { times, values, start: 0 });
  }

  clear() { this.start = this.length = 0; }
  /** @param {number} index */
  time(index) { return this.times[(this.start + index) % this.times.length]; }
  /** @param {number} index */
  value(index) { return this.values[(this.start + index) % this.times.length]; }

  /** The first index whose time is not before `time`. @param {number} time */
  indexAt(time) {
    let [low, high] = [0, this.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time(middle) < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** The value of the last point at or before `time`; NaN before the first. @param {number} time */
  valueAt(time) {
    const index = this.indexAt(time);
    if (index < this.length && this.time(index) === time) return this.value(index);
    return index > 0 ? this.value(index - 1) : NaN;
  }

  /** Least and most between two times, one point beyond each included. @param {number} from @param {number} to */
  range(from, to) {
    let [least, most] = [Infinity, -Infinity];
    const end = Math.min(this.length, this.indexAt(to) + 1);
    const first = Math.max(0, this.indexAt(from) - 1);
    const { values } = this;
    // The place in the ring is counted on: a division for each of many points would take most of the time.
    for (let i = first, at = (this.start + first) % values.length; i < end; i++) {
      const value = values[at];
      if (++at === values.length) at = 0;
      if (value < least) least = value;
      if (value > most) most = value;
    }
    return [least, most];
  }

  /**
   * The points of a line between two times, for a picture `columns` wide: all of them where there are few, else per column the first,
   * the least, the most and the last, so that no peak is lost. A NaN is a gap.
   * @param {number} from @param {number} to @param {number} columns
   * @param {(time: number, value: number) => void} visit
   */
  visit(from, to, columns, visit) {
    const first = Math.max(0, this.indexAt(from) - 1);
    const end = Math.min(this.length, this.indexAt(to) + 1);
    if (end - first <= columns * 2) {
      for (let i = first; i < end; i++) visit(this.time(i), this.value(i));
      return;
    }
    const width = (to - from) / columns;
    let column = NaN;
    let [low, high, open, last] = [0, 0, 0, 0];
    let [lowest, highest] = [0, 0];
    let hasGap = false;
    const { times, values } = this;
    const flush = () => {
      const [a, b] = low < high ? [low, high] : [high, low];
      visit(this.time(open), this.value(open));
      if (a > open && a < last) visit(this.time(a), this.value(a));
      if (b > a && b < last) visit(this.time(b), this.value(b));
      if (last > open) visit(this.time(last), this.value(last));
    };
    for (let i = first, at = (this.start + first) % times.length; i < end; i++) {
      const [value, time] = [values[at], times[at]];
      if (++at === times.length) at = 0;
      if (Number.isNaN(value)) { if (!Number.isNaN(column)) flush(); column = NaN; if (!hasGap) visit(this.time(i), NaN); hasGap = true; continue; }
      hasGap = false;
      const here = Math.floor((time - from) / width);
      if (here !== column) {
        if (!Number.isNaN(column)) flush();
        column = here;
        low = high = open = i;
        lowest = highest = value;
        last = i;
      } else {
        if (value < lowest) { low = i; lowest = value; }
        if (value > highest) { high = i; highest = value; }
        last = i;
      }
    }
    if (!Number.isNaN(column)) flush();
  }
}

/** Round places for marks on an axis: about `count` of them. @param {number} from @param {number} to @param {number} count */
export function ticks(from, to, count) {
  const span = to - from;
  if (!(span > 0) || !Number.isFinite(span)) return { step: 1, at: [from] };
  const raw = span / Math.max(1, count);
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * ([1, 2, 5, 10].find((factor) => factor * power >= raw) ?? 10);
  const at = [];
  for (let i = Math.ceil(from / step); i * step <= to + step * 1e-9 && at.length < 200; i++) at.push(i * step);
  return { step, at };
}
