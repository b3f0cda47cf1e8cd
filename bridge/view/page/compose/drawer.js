// @ts-check
// Below the graph: problems, and what the robot that runs prints.

import { h, icon, iconButton } from '../panel.js';

/** @typedef {import('./asks.js').Problem} Problem */
/** @typedef {import('./asks.js').Output} Output */

const MOST_LINES = 2000;

/**
 * @param {HTMLElement} root
 * @param {(problem: Problem) => void} goTo
 */
export function drawer(root, goTo) {
  /** Whether the user has opened or closed it. */
  let isByHand = false;
  const found = h('ul', { class: 'problems' });
  const problems = h('div', { class: 'panel', id: 'tab-problems', role: 'tabpanel', 'aria-label': 'Problems' }, found);
  const output = h('div', { class: 'log', id: 'tab-output', role: 'tabpanel', 'aria-label': 'Output of the robot', tabIndex: 0, hidden: true });
  const count = h('span', { class: 'count' });
  const tab = (/** @type {string} */ text, /** @type {string} */ panel, /** @type {Node[]} */ ...more) => h('button', {
    type: 'button', role: 'tab', 'aria-controls': panel, onclick: () => choose(panel) }, text, ...more);
  const tabs = [tab('Problems', 'tab-problems', count), tab('Output', 'tab-output')];
  const toggle = iconButton('left', 'Hide', () => { isByHand = true; root.classList.toggle('is-closed'); mark(); });
  const bar = h('div', { role: 'tablist', class: 'tabs' }, tabs);
  bar.addEventListener('keydown', (event) => {
    if (event.key !== 'ArrowLeft' && event.key !== 'ArrowRight') return;
    const other = tabs[(tabs.indexOf(/** @type {any} */ (document.activeElement)) + 1) % 2];
    other.click();
    other.focus();
  });
  root.append(h('div', { class: 'drawer-head' }, bar, h('span', { class: 'spacer' }), toggle), problems, output);
  choose('tab-problems');

  /** @param {string} panel */
  function choose(panel) {
    root.classList.remove('is-closed');
    problems.hidden = panel !== 'tab-problems';
    output.hidden = panel !== 'tab-output';
    for (const button of tabs) {
      const isChosen = button.getAttribute('aria-controls') === panel;
      button.setAttribute('aria-selected', String(isChosen));
      button.tabIndex = isChosen ? 0 : -1;
    }
    mark();
  }
  function mark() {
    const isClosed = root.classList.contains('is-closed');
    toggle.setAttribute('aria-label', isClosed ? 'Show' : 'Hide');
    toggle.title = isClosed ? 'Show' : 'Hide';
    toggle.setAttribute('aria-expanded', String(!isClosed));
  }

  return {
    choose,
    /** @param {Problem[]} list */
    show(list) {
      const errors = list.filter(({ severity }) => severity === 'error').length;
      count.textContent = list.length ? String(list.length) : '';
      count.className = `count ${errors ? 'error' : list.length ? 'warn' : ''}`;
      found.replaceChildren(...list.map((problem) => h('li', null,
        h('button', { type: 'button', class: `problem ${problem.severity}`, onclick: () => goTo(problem) },
          h('span', { class: `dot ${problem.severity === 'error' ? 'error' : 'warn'}` }), h('span', { class: 'sr' }, problem.severity),
          h('span', { class: 'where mono' }, problem.line ? `line ${problem.line}` : ''),
          h('span', { class: 'mono place' }, [problem.module, problem.key].filter(Boolean).join(' · ')),
          h('span', { class: 'words' }, problem.problem)))));
      if (!isByHand && !problems.hidden) { root.classList.toggle('is-closed', list.length === 0); mark(); }
      if (list.length === 0) found.append(h('li', { class: 'good' }, icon('follow'), 'No problems: the robot starts as it is.'));
    },
    /** @param {string[]} lines */
    print(lines) {
      if (lines.length === 0) return;
      const isAtEnd = output.scrollTop + output.clientHeight >= output.scrollHeight - 8;
      for (const line of lines) {
        const level = /\bERROR\b|^error/i.test(line) ? 'error' : /\bWARN\b/.test(line) ? 'warn' : '';
        output.append(h('div', { class: `out ${level}` }, line));
      }
      while (output.childElementCount > MOST_LINES) output.firstElementChild?.remove();
      if (isAtEnd) output.scrollTop = output.scrollHeight;
    },
    clear() { output.replaceChildren(); },
  };
}
