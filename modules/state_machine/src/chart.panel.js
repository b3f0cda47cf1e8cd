// The chart of a state machine: its states as nested boxes, the active ones marked, with the last transitions.
import { h, replace, setText } from '/panel.js';

/** The last transitions that are shown. */
const SHOWN = 20;

/**
 * Reads the chart that the module writes for Mermaid: nested states by their numbers.
 * @param {string} text
 */
export function states(text) {
  const whole = { number: '', title: '', children: [], transitions: [] };
  const known = new Map();
  const open = [whole];
  const active = new Set();
  for (const line of text.split('\n').map((line) => line.trim())) {
    const here = open[open.length - 1];
    let found;
    if ((found = /^state "(.*)" as (s\d+)$/.exec(line))) {
      const state = { number: found[2], title: found[1], children: [], transitions: [] };
      known.set(state.number, state);
      here.children.push(state);
    } else if ((found = /^state (s\d+) \{$/.exec(line))) {
      open.push(known.get(found[1]) ?? here);
    } else if (line === '}') {
      if (open.length > 1) open.pop();
    } else if ((found = /^class (s\d+) active$/.exec(line))) {
      active.add(found[1]);
    } else if ((found = /^(s\d+) --> (s\d+)(?: : (.*))?$/.exec(line))) {
      const [source, target] = [known.get(found[1]), known.get(found[2])];
      if (source && target) source.transitions.push(`${found[3] ?? ''} → ${target.title}`);
    }
  }
  return { whole, active };
}

export default {
  create(root, robot) {
    const name = import.meta.url.split('/').at(-2);
    const panel = robot.info?.panels?.find((panel) => panel.name === name);
    const [mermaid, state] = panel?.topics ?? [];
    const chart = h('div', { style: { display: 'flex', flexWrap: 'wrap', gap: '0.5rem', alignItems: 'flex-start' } });
    const fault = h('output', { role: 'status', style: { color: 'var(--error, crimson)' } });
    const list = h('ol', { 'aria-label': 'Last transitions' });
    root.append(chart, fault, list);

    const box = (state, active) => {
      const isActive = active.has(state.number);
      return h('section', {
        'aria-current': isActive ? 'true' : undefined,
        style: {
          border: `2px solid ${isActive ? 'var(--accent)' : 'var(--border, currentColor)'}`,
          borderRadius: '0.5rem',
          padding: '0.4rem 0.6rem',
          background: isActive ? 'var(--surface)' : 'transparent',
        },
      },
      h('strong', null, state.title),
      state.transitions.map((text) => h('div', { style: { opacity: '0.7', fontSize: '0.85em' } }, text)),
      state.children.length > 0 && h('div', { style: { display: 'flex', flexWrap: 'wrap', gap: '0.4rem', marginTop: '0.3rem' } },
        ...state.children.map((child) => box(child, active))));
    };
    if (mermaid) {
      robot.subscribe(mermaid, (message) => {
        const { whole, active } = states(message.data);
        replace(chart, whole.children.map((child) => box(child, active)));
      });
    }
    if (state) {
      robot.subscribe(state, (message) => {
        setText(fault, message.fault ? `line ${message.fault}` : '');
        const time = `${message.stamp.sec}.${String(message.stamp.nanosec).padStart(9, '0').slice(0, 3)}`;
        list.prepend(h('li', null, `${time} s: ${message.source || 'start'} → ${message.targets.join(', ') || 'stays'} ${message.event && `(${message.event})`}`));
        while (list.childElementCount > SHOWN) list.lastElementChild?.remove();
      });
    }
    return { destroy() {} };
  },
};
