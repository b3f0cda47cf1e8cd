// Makes key-frame motions: poses taken from the robot, or set by hand, one after another; seen in 3D, played, and saved.
import { empty, h, replace, setText } from '/panel.js';
import { words } from '/connection.js';
import { PoseView } from '/panels/scene/pose.js';

const SLOW = 0.3;
const FIRST_FRAME_S = 2;
const FRAME_S = 1;
const degrees = (/** @type {number} */ angle) => (angle * 180) / Math.PI;
const radians = (/** @type {number} */ angle) => (angle * Math.PI) / 180;
const isNumber = (/** @type {number} */ value) => !Number.isNaN(value);

export default {
  create(root, robot, view) {
    const own = import.meta.url.split('/').at(-2);
    const panel = robot.info?.panels?.find(({ name }) => name === own);
    const [play, playing, states] = panel?.topics ?? [];
    const service = (name) => play.replace(/play$/, name);
    /** Names and limits of the joints, in the order of positions. */
    let joints = [];
    let motions = [];
    let file = '';
    let motion = null;
    let selected = 0;
    /** What the module made of the motion: the text of the file, and poses of the preview. */
    let made = null;
    let isSaved = true;
    const measured = new Map();
    let previewTimer = 0;

    // ---- what is shown

    const problem = h('output', { role: 'status', 'data-testid': 'motion-problem', style: { color: 'var(--error)' } });
    const note = h('output', { role: 'status', 'data-testid': 'motion-note', style: { color: 'var(--muted)' } });
    const tell = (text) => setText(problem, text);
    const picture = new PoseView(robot, 'The robot in the selected frame, in 3D', tell);
    picture.element.dataset.testid = 'motion-picture';
    const stage = h('div', { class: 'stage', style: { height: '18rem', flex: 'none' } }, picture.element);
    const button = (text, onclick, attributes = {}) => h('button', { type: 'button', class: 'button', onclick, ...attributes }, text);
    const chosen = h('select', { 'aria-label': 'Motion', 'data-testid': 'motion-chosen', onchange: () => choose(chosen.value) });
    const name = h('input', { type: 'text', 'aria-label': 'Name', size: 14, 'data-testid': 'motion-name', onchange: () => { motion.name = name.value.trim(); touch(); } });
    const about = h('input', { type: 'text', 'aria-label': 'What it does', size: 28, placeholder: 'what it does', onchange: () => { motion.about = about.value; touch(); } });
    const interpolation = h('select', { 'aria-label': 'Between frames', onchange: () => { motion.interpolation = interpolation.value; touch(); } },
      ['smooth', 'through', 'linear'].map((value) => h('option', { value }, value)));
    const speed = h('input', { type: 'number', min: '5', max: '100', step: '5', value: String(SLOW * 100), 'aria-label': 'Speed in percent', 'data-testid': 'motion-speed', style: { width: '4.5em' } });
    const frames = h('tbody');
    const sliders = h('tbody');
    const saves = button('Save', save, { 'data-testid': 'motion-save' });
    const plays = button('Play', start, { class: 'button primary', 'data-testid': 'motion-play' });
    const row = (...children) => h('div', { style: { display: 'flex', flexWrap: 'wrap', gap: '0.4rem', alignItems: 'center' } }, children);
    const nothing = empty('No motions here.', 'The module does not answer.');
    const all = h('div', { style: { padding: '0.6rem 0.8rem', display: 'grid', gap: '0.6rem' } },
      row(chosen, name, about, interpolation, saves),
      stage,
      row(
        button('Limp', () => torque(0), { title: 'The joints of the motion lose their torque, to be moved by hand: hold the robot', 'data-testid': 'motion-limp' }),
        button('Hold', () => torque(1), { title: 'They hold where they are', 'data-testid': 'motion-hold' }),
        button('Take pose', take, { title: 'A new frame with the pose of the robot', 'data-testid': 'motion-take' }),
        button('Copy frame', copy, { 'data-testid': 'motion-copy' }),
        button('Preview', preview, { title: 'In 3D; the robot does not move', 'data-testid': 'motion-preview' }),
        plays, h('label', null, speed, ' %'),
        button('Stop', () => robot.publish(play, 'std_msgs/msg/String', { data: '' }), { 'data-testid': 'motion-stop' }),
      ),
      problem, note,
      h('div', { style: { display: 'flex', flexWrap: 'wrap', gap: '1.2rem', alignItems: 'flex-start' } },
        h('table', { 'data-testid': 'motion-frames', style: { width: 'auto' } }, h('thead', null, h('tr', null, ['Frame', 'Way, s', 'Pause, s', ''].map((title) => h('th', { scope: 'col' }, title)))), frames),
        h('table', { 'data-testid': 'motion-joints', style: { width: 'auto' } }, h('thead', null, h('tr', null, ['Moves', 'Joint', 'Angle', '°'].map((title) => h('th', { scope: 'col' }, title)))), sliders)));
    root.append(nothing);

    // ---- frames

    const isMirror = () => motion.mirror_of !== '';
    const frame = () => motion.frames[selected];
    const moves = (/** @type {number} */ joint) => isNumber(motion.frames[0]?.positions[joint] ?? NaN);

    /** Something has changed that the module does not know. */
    function touch() {
      made = null;
      isSaved = false;
      tell('');
      show();
    }

    function show() {
      name.value = motion.name;
      about.value = motion.about;
      interpolation.value = motion.interpolation || 'smooth';
      setText(note, isMirror() ? `The mirror image of ${motion.mirror_of}: change that one.` : isSaved ? '' : `Not saved${file ? '' : ': the motions of this robot are built in'}.`);
      for (const input of [name, about, interpolation, saves]) input.disabled = isMirror();
      saves.disabled ||= isSaved || !robot.mayChange || file === '';
      replace(frames, motion.frames.map((each, index) => {
        const time = (key, least) => h('input', {
          type: 'number', min: String(least), max: '600', step: '0.05', value: String(Math.round(each[key] * 1000) / 1000), disabled: isMirror(), style: { width: '5.5em' },
          'aria-label': `${key === 'duration' ? 'Way' : 'Pause'} of frame ${index + 1}, s`, onchange: (event) => { each[key] = Number(event.target.value); touch(); },
        });
        return h('tr', { 'aria-selected': String(index === selected), style: { background: index === selected ? 'var(--accent-soft)' : '' } },
          h('td', null, button(String(index + 1), () => select(index), { 'aria-label': `Frame ${index + 1}`, 'data-testid': `motion-frame-${index + 1}` })),
          h('td', null, time('duration', 0.01)), h('td', null, time('pause', 0)),
          h('td', null, button('Delete', () => remove(index), { disabled: isMirror() || motion.frames.length < 2 })));
      }));
      replace(sliders, joints.map(({ name: joint, lower, upper }, index) => {
        const angle = frame()?.positions[index] ?? NaN;
        const [low, high] = [degrees(lower), degrees(upper)];
        const turn = (value) => {
          frame().positions[index] = radians(Math.max(low, Math.min(high, value)));
          touch();
        };
        const value = isNumber(angle) ? String(Math.round(degrees(angle) * 10) / 10) : '';
        const attributes = { min: String(low), max: String(high), step: 'any', value: value || '0', disabled: isMirror() || !isNumber(angle) };
        return h('tr', null,
          h('td', null, h('input', { type: 'checkbox', checked: moves(index), disabled: isMirror() || !frame(), 'aria-label': `${joint} moves`, onchange: (event) => include(index, event.target.checked) })),
          h('td', null, joint),
          h('td', null, h('input', { ...attributes, type: 'range', 'aria-label': joint, onchange: (event) => turn(Number(event.target.value)), oninput: (event) => look(index, radians(Number(event.target.value))) })),
          h('td', null, h('input', { ...attributes, type: 'number', value, 'aria-label': `${joint}, degrees`, style: { width: '5.5em' }, onchange: (event) => turn(Number(event.target.value)) })));
      }));
      look();
    }

    /** The selected frame in 3D, with one joint elsewhere. Joints that the motion does not move are where they are. */
    function look(joint = -1, angle = NaN) {
      clearInterval(previewTimer);
      const positions = new Map(measured);
      joints.forEach(({ name: each }, index) => {
        const position = index === joint ? angle : frame()?.positions[index] ?? NaN;
        if (isNumber(position)) positions.set(each, position);
      });
      picture.show((each) => positions.get(each));
    }

    function select(index) {
      selected = index;
      show();
    }

    function remove(index) {
      motion.frames.splice(index, 1);
      selected = Math.min(selected, motion.frames.length - 1);
      touch();
    }

    function include(joint, isMoved) {
      for (const each of motion.frames) each.positions[joint] = isMoved ? measured.get(joints[joint].name) ?? 0 : NaN;
      touch();
    }

    /** A frame after the selected one. */
    function insert(positions) {
      motion.frames.splice(selected + 1, 0, { duration: motion.frames.length === 0 ? FIRST_FRAME_S : FRAME_S, pause: 0, positions });
      selected = Math.min(selected + 1, motion.frames.length - 1);
      touch();
    }

    function take() {
      if (isMirror()) return;
      const isFirst = motion.frames.length === 0;
      insert(joints.map(({ name: joint, lower, upper }, index) => {
        const position = measured.get(joint) ?? NaN;
        return isFirst || moves(index) ? Math.max(lower, Math.min(upper, position)) : NaN;
      }));
    }

    function copy() {
      if (frame() && !isMirror()) insert([...frame().positions]);
    }

    // ---- the robot

    async function check() {
      if (made || isMirror()) return true;
      const answer = await robot.call(service('set'), { motion });
      tell(answer.message);
      if (answer.success) {
        made = answer;
        const { name: known } = motion;
        motions = [...motions.filter((each) => each.name !== known), structuredClone(motion)].sort((a, b) => a.name.localeCompare(b.name));
        list();
      }
      return answer.success;
    }

    const safely = async (act) => { try { await act(); } catch (error) { tell(words(error)); } };

    function preview() {
      safely(async () => {
        if (!await check() || !made) return;
        const { poses, period } = made;
        const begin = performance.now();
        clearInterval(previewTimer);
        previewTimer = window.setInterval(() => {
          const count = poses.length / joints.length;
          const at = Math.min(count - 1, Math.floor((performance.now() - begin) / 1000 / period));
          picture.show((each) => {
            const index = joints.findIndex(({ name: joint }) => joint === each);
            return index < 0 || !moves(index) ? measured.get(each) : poses[at * joints.length + index];
          });
          setText(note, `Preview: ${(at * period).toFixed(1)} s of ${((count - 1) * period).toFixed(1)} s`);
          if (at === count - 1) clearInterval(previewTimer);
        }, 33);
      });
    }

    function start() {
      safely(async () => {
        if (!await check()) return;
        const wanted = Math.max(5, Math.min(100, Number(speed.value) || 0)) / 100;
        await robot.ask('set', { module: panel.module, name: 'speed', value: wanted });
        robot.publish(play, 'std_msgs/msg/String', { data: motion.name });
      });
    }

    function torque(share) {
      safely(async () => {
        const topic = states.replace(/joint_states$/, 'joint_torque');
        const moved = joints.filter((_, index) => motion.frames.length === 0 || moves(index)).map(({ name: joint }) => joint);
        robot.publish(topic, 'sensor_msgs/msg/JointState', { header: { stamp: { sec: 0, nanosec: 0 }, frame_id: '' }, name: moved, position: [], velocity: [], effort: moved.map(() => share) });
      });
    }

    function save() {
      safely(async () => {
        if (!await check() || !made) return;
        const { path } = await robot.ask('save_file', { module: panel.module, setting: 'file', text: made.text });
        isSaved = true;
        show();
        setText(note, `Saved in ${path}.`);
      });
    }

    // ---- all motions

    const NEW = '';
    function list() {
      replace(chosen, [h('option', { value: NEW }, 'New motion …'), ...motions.map((each) => h('option', { value: each.name, selected: each.name === motion?.name }, each.name))]);
    }

    function choose(wanted) {
      const known = motions.find((each) => each.name === wanted);
      const fresh = () => {
        let number = 1;
        while (motions.some((each) => each.name === `motion_${number}`)) number++;
        return { name: `motion_${number}`, about: '', mirror_of: '', interpolation: 'smooth', stiffness: 1, balance_tilt: 0, balance_rate: 0, frames: [] };
      };
      motion = known ? structuredClone(known) : fresh();
      made = null;
      isSaved = true;
      selected = 0;
      view.setTitle(motion.name);
      tell('');
      show();
    }

    if (play) {
      robot.subscribe(states, ({ name: names, position }) => {
        names.forEach((joint, index) => { if (Number.isFinite(position[index])) measured.set(joint, position[index]); });
      }, { latest: true });
      robot.subscribe(playing, ({ data }) => { plays.disabled = data !== ''; view.setTitle(data ? `plays ${data}` : motion?.name ?? ''); });
      safely(async () => {
        const known = await robot.call(service('get'), {});
        joints = known.joints.map((joint, index) => ({ name: joint, lower: known.lower[index], upper: known.upper[index] }));
        ({ motions, file } = known);
        replace(root, [all]);
        choose(motions[0]?.name ?? NEW);
        list();
      });
    }
    return { destroy() { clearInterval(previewTimer); picture.destroy(); } };
  },
};
