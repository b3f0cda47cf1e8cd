// @ts-check
// A message as a tree that stays unfolded while its values change.

import { h, setText } from '../../panel.js';

const MOST_CHILDREN = 200;
const PREVIEW = 6;

/** @typedef {{ element: HTMLElement, show(value: any): void }} Node_ */

/** @param {any} value */
const isBranch = (value) => value !== null && typeof value === 'object';

/** @param {any} value */
const isTime = (value) => isBranch(value) && 'sec' in value && 'nanosec' in value;
/** @param {{ sec: number, nanosec: number }} time */
const timeText = ({ sec, nanosec }) => `${sec}.${String(nanosec).padStart(9, '0')}`;

/** @param {any} value */
function leafText(value) {
  if (typeof value === 'number') return Number.isFinite(value) ? String(Number(value.toPrecision(7))) : String(value);
  return typeof value === 'string' ? JSON.stringify(value) : String(value);
}

/** What stands beside a name that is folded. @param {any} value */
function preview(value) {
  if (Array.isArray(value) || ArrayBuffer.isView(value)) {
    const items = /** @type {any[]} */ (value);
    const inside = Array.from(items.slice(0, PREVIEW), (item) => (isBranch(item) ? '…' : typeof item === 'string' ? item.slice(0, 20) : leafText(item))).join(', ');
    return `[${items.length}]  ${inside}${items.length > PREVIEW ? ', …' : ''}`;
  }
  if (isTime(value)) return timeText(value);
  const text = (/** @type {[string, any]} */ [key, inner]) => (isTime(inner) ? timeText(inner) : isBranch(inner) ? key : `${key} ${leafText(inner)}`);
  return Object.entries(value).slice(0, 4).map(text).join('  ');
}

/** @param {string} key @param {any} first @param {boolean} [isOpen] @returns {Node_} */
export function treeOf(key, first, isOpen = false) {
  if (!isBranch(first)) {
    const text = h('span', { class: 'mono' });
    return { element: h('div', { class: 'leaf' }, h('span', null, key), text), show: (value) => setText(text, leafText(value)) };
  }
  const summary = h('span', { class: 'muted mono', style: { overflow: 'hidden', textOverflow: 'ellipsis', whiteSpace: 'nowrap' } });
  const body = h('div', null);
  const element = h('details', { open: isOpen }, h('summary', null, h('span', { class: 'key' }, key), summary), body);
  /** @type {Map<string, Node_ & { isBranch: boolean }>} */
  const children = new Map();
  const more = h('div', { class: 'leaf muted' });
  let present = first;
  function fill() {
    const entries = Array.isArray(present) || ArrayBuffer.isView(present)
      ? Array.from(/** @type {any[]} */ (present).slice(0, MOST_CHILDREN), (value, i) => /** @type {[string, any]} */ ([String(i), value]))
      : Object.entries(present);
    const names = new Set(entries.map(([name]) => name));
    for (const [name, child] of children) if (!names.has(name)) { child.element.remove(); children.delete(name); }
    for (const [name, value] of entries) {
      let child = children.get(name);
      if (child && child.isBranch !== isBranch(value)) { child.element.remove(); child = undefined; }
      if (!child) {
        child = { ...treeOf(name, value), isBranch: isBranch(value) };
        children.set(name, child);
        body.insertBefore(child.element, more.parentElement === body ? more : null);
      }
      child.show(value);
    }
    const left = (present.length ?? 0) - MOST_CHILDREN;
    if (left > 0) { setText(more, `… ${left} more`); body.append(more); } else more.remove();
  }
  element.addEventListener('toggle', () => { if (element.open) fill(); });
  return {
    element,
    show(value) {
      present = value;
      setText(summary, preview(value));
      if (element.open) fill();
    },
  };
}

/** A message as JSON: typed arrays as lists, numbers that JSON has not as text. @param {any} message */
export const json = (message) => JSON.stringify(message, (_, value) => {
  if (typeof value === 'bigint') return String(value);
  if (typeof value === 'number' && !Number.isFinite(value)) return String(value);
  return ArrayBuffer.isView(value) ? Array.from(/** @type {any} */ (value)) : value;
}, 2);
