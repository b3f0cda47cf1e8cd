// Begins, keeps and discards episodes of demonstrations.
import { h, setText } from '/panel.js';
import { words } from '/connection.js';

const STARTED = 1;
const KEPT = 2;

export default {
  create(root, robot) {
    const own = import.meta.url.split('/').at(-2);
    const [topic] = robot.info?.panels?.find(({ name }) => name === own)?.topics ?? [];
    let isUnderWay = false;
    let began = 0;

    const state = h('output', { role: 'status', 'data-testid': 'episode-state', style: { fontSize: '1.6rem' } });
    const task = h('output', { 'data-testid': 'episode-task', style: { color: 'var(--muted)' } });
    const problem = h('output', { role: 'status', 'data-testid': 'episode-problem', style: { color: 'var(--error)' } });
    const button = (/** @type {string} */ name, /** @type {string} */ text, /** @type {string} */ key) =>
      h('button', { type: 'button', class: 'button', 'data-testid': `episode-${name}`, title: key, onclick: () => ask(name) }, text);
    const start = button('start', 'Start', 'Space');
    const keep = button('keep', 'Keep', 'Right arrow');
    const discard = button('discard', 'Discard', 'Left arrow');
    const all = h('div', { style: { padding: '0.8rem', display: 'grid', gap: '0.8rem', justifyItems: 'start' } },
      state, task, h('div', { style: { display: 'flex', gap: '0.6rem' } }, start, keep, discard), problem,
      h('p', { style: { color: 'var(--muted)' } }, 'Keys: space starts, the right arrow keeps, the left one discards.'));
    root.append(all);

    async function ask(/** @type {string} */ what) {
      try {
        const { success, message } = await robot.call(`${topic}/${what}`, {});
        setText(problem, success ? '' : message);
      } catch (error) {
        setText(problem, words(error));
      }
    }

    let text = 'No episode yet';
    function show() {
      const seconds = isUnderWay ? ` · ${((Date.now() - began) / 1000).toFixed(1)} s` : '';
      setText(state, text + seconds);
      keep.disabled = !isUnderWay;
      discard.disabled = !isUnderWay;
    }

    robot.subscribe(topic, (/** @type {any} */ episode) => {
      isUnderWay = episode.state === STARTED;
      if (isUnderWay) began = Date.now();
      const what = isUnderWay ? 'is recorded' : episode.state === KEPT ? 'is kept' : 'is discarded';
      text = `Episode ${episode.number} ${what}`;
      setText(task, episode.task);
      show();
    });
    robot.every(100, show);
    show();

    const KEYS = { ' ': 'start', ArrowRight: 'keep', ArrowLeft: 'discard' };
    function pressed(/** @type {KeyboardEvent} */ event) {
      const what = KEYS[event.key];
      const isElsewhere = event.target instanceof Element && event.target.closest('input, textarea, select, button, [contenteditable], dialog, [popover]');
      if (!what || isElsewhere || event.repeat || event.ctrlKey || event.metaKey || event.altKey || root.offsetParent === null) return;
      // Before the page, for which space is a pause.
      event.preventDefault();
      event.stopPropagation();
      ask(what);
    }
    addEventListener('keydown', pressed, { capture: true });
    return { destroy() { removeEventListener('keydown', pressed, { capture: true }); } };
  },
};
