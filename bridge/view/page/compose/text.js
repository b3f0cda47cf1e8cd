// @ts-check
// The text of the robot file, which can be edited beside the graph.

import { h } from '../panel.js';

const PAUSE_MS = 500;

/**
 * @param {HTMLElement} root
 * @param {(text: string) => Promise<string | null>} change resolves to what is wrong with the text, or null
 */
export function textView(root, change) {
  const lines = h('pre', { class: 'lines', 'aria-hidden': 'true' });
  const area = h('textarea', { class: 'toml', spellcheck: false, autocomplete: 'off', wrap: 'off', 'aria-label': 'Text of the robot file', 'aria-describedby': 'toml-problem' });
  const problem = h('p', { class: 'notice error', id: 'toml-problem', role: 'alert', hidden: true });
  root.append(h('div', { class: 'toml-box' }, lines, area), problem);
  /** What the editor has. */
  let known = '';
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  let timer;
  /** @type {Map<number, string>} */
  let marks = new Map();

  function number() {
    const count = area.value.split('\n').length;
    lines.replaceChildren(...Array.from({ length: count }, (_, index) => {
      const mark = marks.get(index + 1);
      return h('span', { class: mark ? `line ${mark}` : 'line' }, String(index + 1), '\n');
    }));
    lines.scrollTop = area.scrollTop;
  }
  async function send() {
    clearTimeout(timer);
    timer = undefined;
    if (area.value === known) return;
    const sent = area.value;
    const wrong = await change(sent);
    if (area.value !== sent) return;
    problem.hidden = wrong === null;
    problem.textContent = wrong ?? '';
    if (wrong === null) known = sent;
  }
  area.addEventListener('input', () => { clearTimeout(timer); timer = setTimeout(send, PAUSE_MS); number(); });
  area.addEventListener('blur', () => { if (timer) send(); });
  area.addEventListener('scroll', () => { lines.scrollTop = area.scrollTop; });
  area.addEventListener('keydown', (event) => {
    // Tab leaves the field, as everywhere; Ctrl+Enter applies at once.
    if (event.key === 'Enter' && (event.ctrlKey || event.metaKey)) send();
  });

  return {
    /** @param {string} text @param {import('./asks.js').Problem[]} problems */
    show(text, problems) {
      marks = new Map([...problems].reverse().map((found) => [found.line, found.severity]));
      // What is being typed is not taken away.
      const isTyping = timer !== undefined || !problem.hidden;
      if (!isTyping && area.value !== text) {
        const { scrollTop, selectionStart } = area;
        area.value = text;
        area.selectionStart = area.selectionEnd = Math.min(selectionStart, text.length);
        area.scrollTop = scrollTop;
      }
      known = text;
      number();
    },
    /** @param {number} line from 1 */
    goTo(line) {
      const before = area.value.split('\n').slice(0, line - 1);
      const start = before.reduce((sum, text) => sum + text.length + 1, 0);
      const end = area.value.indexOf('\n', start);
      area.focus();
      area.setSelectionRange(start, end < 0 ? area.value.length : end);
      const height = area.scrollHeight / Math.max(1, area.value.split('\n').length);
      area.scrollTop = Math.max(0, (line - 6) * height);
    },
    /** Drops what was typed and is no TOML. @param {string} text */
    reset(text) {
      clearTimeout(timer);
      timer = undefined;
      problem.hidden = true;
      area.value = text;
      known = text;
      number();
    },
  };
}
