// @ts-check
// What is written into a bag: start, stop, pause, and snapshots of the last seconds.

import { bytes, empty, h, icon, replace, setText } from '../panel.js';
import { words } from '../connection.js';

/** @typedef {{ path: string, messages: number, bytes: number, lost: number, is_recording: boolean, is_paused: boolean, takes_snapshots: boolean, failure?: string }} Recording */

/** @type {import('../panel.js').Panel} */
export default {
  id: 'recording',
  title: 'Recording',
  create(root, robot) {
    const chip = h('span', { class: 'chip', role: 'status' });
    const path = h('span', { class: 'mono' });
    const facts = ['Messages', 'Size', 'Per second', 'Lost'].map((title) => h('div', { class: 'fact' }, h('span', null, title), h('b', null, '–')));
    const problem = h('div', { class: 'notice error', role: 'alert', hidden: true });
    const done = h('p', { class: 'muted', role: 'status' });
    const name = h('input', { type: 'text', placeholder: 'Name of the bag (optional)', 'aria-label': 'Name of the bag' });
    const button = (/** @type {string} */ text, /** @type {string} */ iconName, /** @type {string} */ ask, kind = '') =>
      h('button', { type: 'button', class: `button ${kind}`, 'data-testid': ask, onclick: () => act(ask) }, icon(iconName), text);
    const [start, stop, pause, resume, snapshot] = [button('Record', 'recording', 'record', 'primary'), button('Stop', 'close', 'stop_recording', 'danger'),
      button('Pause', 'pause', 'pause_recording'), button('Go on', 'play', 'resume_recording'), button('Write snapshot', 'camera', 'record_snapshot')];
    const idle = h('div', { class: 'row' }, name, start);
    name.addEventListener('keydown', ({ key }) => { if (key === 'Enter') act('record'); });
    const sheet = h('div', { class: 'sheet', 'data-testid': 'recording' }, h('div', { class: 'row' }, chip, path), h('div', { class: 'facts' }, facts), problem, idle, h('div', { class: 'row' }, pause, resume, snapshot, stop), done);
    /** @type {{ atMs: number, bytes: number } | null} */
    let before = null;

    /** @param {string} ask */
    async function act(ask) {
      try {
        const before = path.textContent;
        const answer = await robot.ask(ask, ask === 'record' && name.value.trim() ? { name: name.value.trim() } : {});
        problem.hidden = true;
        setText(done, ask === 'record' ? `Writes to ${answer}.` : ask === 'record_snapshot' ? 'The snapshot is written.' : ask === 'stop_recording' ? `${before} is complete.` : '');
      } catch (error) { setText(problem, words(error)); problem.hidden = false; }
      await look();
    }

    async function look() {
      if (robot.state !== 'open') return;
      try {
        /** @type {Recording | null} */
        const recording = await robot.ask('recording');
        replace(root, [sheet]);
        show(recording);
      } catch (error) { replace(root, [empty('Nothing is recorded here.', words(error))]); }
    }

    /** @param {Recording | null} recording */
    function show(recording) {
      const isRecording = recording?.is_recording ?? false;
      const isPaused = isRecording && (recording?.is_paused ?? false);
      const kind = recording?.failure ? 'error' : isRecording ? (isPaused ? 'warn' : 'error live') : '';
      chip.className = `chip ${kind}`;
      setText(chip, recording?.failure ? 'Failed' : isRecording ? (isPaused ? 'Paused' : 'Recording') : 'Not recording');
      setText(path, recording?.path ?? '');
      const now = performance.now();
      const speed = before && recording && isRecording && now > before.atMs ? Math.max(0, ((recording.bytes - before.bytes) * 1000) / (now - before.atMs)) : NaN;
      before = recording ? { atMs: now, bytes: recording.bytes } : null;
      const values = recording ? [recording.messages.toLocaleString('en'), bytes(recording.bytes), Number.isNaN(speed) ? '–' : bytes(speed), String(recording.lost)] : ['–', '–', '–', '–'];
      facts.forEach((fact, i) => setText(/** @type {Element} */ (fact.lastElementChild), values[i]));
      if (recording?.failure) { setText(problem, recording.failure); problem.hidden = false; }
      idle.hidden = isRecording;
      stop.hidden = !isRecording;
      pause.hidden = !isRecording || isPaused;
      resume.hidden = !isPaused;
      snapshot.hidden = !isRecording || !recording?.takes_snapshots;
      for (const each of [start, stop, pause, resume, snapshot]) each.disabled = !robot.mayChange;
    }
    robot.every(1000, look);
    return { destroy() {} };
  },
};
