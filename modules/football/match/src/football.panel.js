// A football match from above: the robots and the ball with their ways, kicks and a heat map, the beliefs of each robot, the states of its
// state machine, and what it did so far.
import { h, replace, setText } from '/panel.js';

const PHASES = ['initial', 'ready', 'set', 'playing', 'finished', 'standby'];
const TEAM_COLORS = { blue: '#2f6fe0', red: '#d23b3b' };
const CARPET = '#2e7d43';
const LINE = 'rgba(255, 255, 255, 0.85)';
const BALL = '#ff8c1a';
/** As in football_interfaces/Kick. */
const [PASS, SHOT, GOAL] = [1, 3, 5];
/** m */
const ROBOT_RADIUS = 0.13;
const SHOWN_EVENTS = 12;
/** A belief that is older than this is drawn faintly, in s. */
const OLD_S = 2;
/** For how long ways and kicks are shown, in s. */
const SHOWN_S = 60;
/** Points of a way that are nearer to each other are one, and those that are farther from each other are not joined, in m. */
const [POINT, JUMP] = [0.05, 0.5];
/** The size of a cell of the heat map, in m. */
const CELL = 0.2;

/** @param {{ x: number, y: number, z: number, w: number }} q */
const headingOf = ({ x, y, z, w }) => Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
/** @param {{ x: number, y: number, z: number, w: number }} q The z axis of the trunk points up. */
const isUpright = ({ x, y }) => 1 - 2 * (x * x + y * y) > 0.5;
/** @param {{ sec: number, nanosec: number }} stamp */
const secondsOf = (stamp) => stamp.sec + stamp.nanosec / 1e9;
const teamOf = (name) => (name.startsWith('red') ? 'red' : 'blue');

export default {
  create(root, robot, view) {
    const own = import.meta.url.split('/').at(-2);
    const [stateTopic, fieldTopic, eventTopic, kickTopic, statisticsTopic] = robot.info?.panels?.find((panel) => panel.name === own)?.topics ?? [];
    const options = { beliefs: true, tracks: true, kicks: true, heat: '', ...view.get() };
    let field = null;
    let state = null;
    /** Where each robot and the ball were lately, with times. */
    const tracks = new Map();
    /** How often each robot and the ball were in each cell: arrays of columns, and the largest number. */
    const heat = new Map();
    let kicks = [];
    /** The beliefs of each robot: pose and ball in the frame of its team, with the times of the messages. */
    const beliefs = new Map();
    const rows = new Map();

    const score = h('output', { role: 'status', 'data-testid': 'match-score', style: { fontSize: '1.4em', fontWeight: '600' } });
    const canvas = h('canvas', { role: 'img', 'aria-label': 'The field from above', 'data-testid': 'match-field', style: { display: 'block', margin: '0.4rem auto', borderRadius: '0.4rem' } });
    const choice = (option, text) => {
      const box = h('input', { type: 'checkbox', checked: options[option], onchange: () => { options[option] = box.checked; view.set(options); draw(); } });
      return h('label', { style: { marginRight: '1em' } }, box, ` ${text}`);
    };
    const heatOf = h('select', { 'data-testid': 'match-heat', onchange: () => { options.heat = heatOf.value; view.set(options); draw(); } });
    const possession = h('div', { role: 'img', 'aria-label': 'Possession of the ball', 'data-testid': 'match-possession', style: { display: 'flex', margin: '0.4rem 0', borderRadius: '0.3rem', overflow: 'hidden', color: 'white', fontWeight: '600' } });
    const body = h('tbody');
    const events = h('ol', { 'aria-label': 'Events', 'data-testid': 'match-events' });
    root.append(h('div', { style: { padding: '0.6rem 0.8rem' } },
      score,
      canvas,
      possession,
      h('div', null,
        choice('beliefs', 'beliefs of the robots (rings: own positions; dots: the ball)'),
        choice('tracks', 'ways of the last minute'),
        choice('kicks', 'kicks (yellow: goals, wide: shots, dashed: passes)'),
        h('label', null, 'heat map of ', heatOf)),
      h('div', { style: { overflowX: 'auto' } }, h('table', { 'data-testid': 'match-robots' },
        h('thead', null, h('tr', null, ['Robot', 'Automaton', 'Off by', 'Ball off by', '', 'Kicks', 'Shots', 'Passes', 'Walked', 'Falls', 'Up again'].map((title) => h('th', { scope: 'col' }, title)))), body)),
      events,
    ));
    const ink = canvas.getContext('2d');

    /** Converts from the frame of a robot's team to the frame of the world. */
    const toWorld = (name, { x, y }) => ((teamOf(name) === 'blue') === state.blue_defends_right ? { x: -x, y: -y } : { x, y });

    function follow(name) {
      const belief = { pose: null, ball: null, poseAt: 0, ballAt: 0, heading: 0 };
      beliefs.set(name, belief);
      robot.subscribe(`/${name}/pose`, ({ header, pose }) => {
        belief.pose = pose.pose.position;
        belief.heading = headingOf(pose.pose.orientation);
        belief.poseAt = secondsOf(header.stamp);
      });
      robot.subscribe(`/${name}/ball`, ({ header, point }) => { belief.ball = point.point; belief.ballAt = secondsOf(header.stamp); });
      const cells = Array.from({ length: 11 }, () => h('td'));
      rows.set(name, cells);
      const key = h('span', { 'aria-hidden': 'true', style: { color: TEAM_COLORS[teamOf(name)] } }, '● ');
      cells[0].append(key, name);
      body.append(h('tr', null, cells));
      const chart = [...robot.channels.values()].find(({ topic, schemaName }) => topic.startsWith(`/${name}/`) && schemaName.endsWith('/StateMachineState'));
      if (chart) robot.subscribe(chart.topic, ({ active }) => setText(cells[1], active.join(' · ')));
    }

    /** What is seen of a robot or the ball: its way, and the cell in which it is. */
    function collect(name, { x, y }, now) {
      const track = tracks.get(name) ?? [];
      tracks.set(name, track);
      const last = track.at(-1);
      const way = last ? Math.hypot(x - last.x, y - last.y) : JUMP;
      if (way >= POINT) track.push({ x, y, at: now, isJoined: way < JUMP });
      while (track.length > 0 && now - track[0].at > SHOWN_S) track.shift();
      if (!field) return;
      const [columns, rows] = [field.length, field.width].map((size) => Math.ceil((size + 2 * field.margin) / CELL));
      const map = heat.get(name) ?? { columns, most: 0, counts: new Uint32Array(columns * rows) };
      heat.set(name, map);
      const [column, row] = [Math.floor(x / CELL + columns / 2), Math.floor(y / CELL + rows / 2)];
      if (column < 0 || column >= columns || row < 0 || row >= rows) return;
      map.most = Math.max(map.most, ++map.counts[row * columns + column]);
    }

    /** What the players did so far, and who had the ball. */
    function showStatistics({ players }) {
      const of = (team) => players.filter((player) => teamOf(player.robot) === team).reduce((sum, player) => sum + player.possession, 0);
      const [blue, red] = [of('blue'), of('red')];
      const share = (part) => `${blue + red > 0 ? ((100 * part) / (blue + red)).toFixed(0) : '–'} %`;
      possession.setAttribute('aria-label', `Possession of the ball: blue ${share(blue)}, red ${share(red)}`);
      const bar = (team, part) => h('span', { style: { flex: `${part} 1 3em`, background: TEAM_COLORS[team], padding: '0 0.5em', textAlign: team === 'red' ? 'right' : 'left' } }, share(part));
      possession.replaceChildren(bar('blue', blue), bar('red', red));
      for (const player of players) {
        const cells = rows.get(player.robot)?.slice(5);
        const { kicks: count, shots, shots_on_goal: onGoal, passes, distance, falls, get_ups: ups } = player;
        const texts = [count, onGoal > 0 ? `${shots} (${onGoal} on goal)` : shots, passes, `${distance.toFixed(1)} m`, falls, ups];
        cells?.forEach((cell, index) => setText(cell, String(texts[index])));
      }
    }

    /** Forgets what was collected. */
    function forget() {
      tracks.clear();
      heat.clear();
      kicks = [];
    }

    /** Offers the ball and the robots for the heat map. */
    function offerHeat(names) {
      if (heatOf.childElementCount === names.length + 2) return;
      const option = (value, text) => h('option', { value, selected: value === options.heat }, text);
      heatOf.replaceChildren(option('', 'nothing'), ...['ball', ...names].map((name) => option(name, name)));
    }

    function show() {
      if (!state) return;
      const minutes = Math.floor(Math.max(0, state.seconds_remaining) / 60);
      const seconds = String(Math.floor(Math.max(0, state.seconds_remaining) % 60)).padStart(2, '0');
      setText(score, `blue ${state.blue_score} : ${state.red_score} red   ${PHASES[state.phase] ?? ''}, ${state.is_first_half ? 'first' : 'second'} half, ${minutes}:${seconds} left`);
      const now = secondsOf(state.header.stamp);
      offerHeat(state.robots);
      collect('ball', state.ball, now);
      state.robots.forEach((name, index) => {
        if (!beliefs.has(name)) follow(name);
        collect(name, state.poses[index].position, now);
        const [, , off, ballOff, note] = rows.get(name);
        const { pose, ball, poseAt, ballAt } = beliefs.get(name);
        const distance = (from, to) => Math.hypot(from.x - to.x, from.y - to.y);
        const metres = (belief, at, truth) => (belief && now - at < OLD_S ? `${(distance(toWorld(name, belief), truth) * 100).toFixed(0)} cm` : '–');
        setText(off, metres(pose, poseAt, state.poses[index].position));
        setText(ballOff, metres(ball, ballAt, state.ball));
        setText(note, state.is_penalised[index] ? 'penalised' : isUpright(state.poses[index].orientation) ? '' : 'lies');
      });
      draw();
    }

    function draw() {
      if (!field || !state) return;
      const [length, width] = [field.length + 2 * field.margin, field.width + 2 * field.margin];
      const ratio = length / width;
      canvas.style.aspectRatio = String(ratio);
      // Leaves space for the table below.
      canvas.style.width = `min(100%, ${60 * ratio}vh)`;
      const density = globalThis.devicePixelRatio || 1;
      const across = canvas.clientWidth || 600;
      const scale = across / length;
      const pixels = [Math.round(across * density), Math.round(width * scale * density)];
      if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) [canvas.width, canvas.height] = pixels;
      // x to the right, y up, in m, from the centre.
      ink.setTransform(scale * density, 0, 0, -scale * density, pixels[0] / 2, pixels[1] / 2);
      ink.fillStyle = CARPET;
      ink.fillRect(-length / 2, -width / 2, length, width);
      ink.strokeStyle = LINE;
      ink.lineWidth = Math.max(field.line_width, 1.5 / scale);
      ink.beginPath();
      for (const [[x, y], [toX, toY]] of field.lines) { ink.moveTo(x, y); ink.lineTo(toX, toY); }
      ink.stroke();
      if (field.circle_diameter > 0) circle(0, 0, field.circle_diameter / 2);
      for (const [x, y] of field.marks) disc(x, y, field.line_width, LINE);
      for (const side of [1, -1]) {
        const posts = field.posts.filter(([x]) => x * side > 0);
        const [[x, y], [, otherY]] = posts;
        ink.strokeRect(Math.min(x, x + side * field.goal_depth), Math.min(y, otherY), field.goal_depth, Math.abs(y - otherY));
      }
      for (const [x, y] of field.posts) disc(x, y, 0.06, '#ffe14d');
      const now = secondsOf(state.header.stamp);
      const colorOf = (name) => (name === 'ball' ? BALL : TEAM_COLORS[teamOf(name)]);
      if (heat.has(options.heat)) drawHeat(heat.get(options.heat), colorOf(options.heat));
      if (options.tracks) for (const [name, track] of tracks) drawTrack(track, colorOf(name));
      if (options.kicks) for (const kick of kicks) drawKick(kick, now);
      if (options.beliefs) for (const [name, belief] of beliefs) drawBelief(name, belief, now);
      state.robots.forEach((name, index) => {
        const { position: { x, y }, orientation } = state.poses[index];
        ink.globalAlpha = state.is_penalised[index] ? 0.45 : 1;
        disc(x, y, ROBOT_RADIUS, TEAM_COLORS[teamOf(name)]);
        ink.strokeStyle = isUpright(orientation) ? 'white' : 'black';
        ink.lineWidth = 0.04;
        const heading = headingOf(orientation);
        ink.beginPath(); ink.moveTo(x, y); ink.lineTo(x + 1.6 * ROBOT_RADIUS * Math.cos(heading), y + 1.6 * ROBOT_RADIUS * Math.sin(heading)); ink.stroke();
        label(name.split('_').at(-1), x, y);
        ink.globalAlpha = 1;
      });
      disc(state.ball.x, state.ball.y, Math.max(field.ball_diameter / 2, 3.5 / scale), BALL);

      function circle(x, y, radius) { ink.beginPath(); ink.arc(x, y, radius, 0, 2 * Math.PI); ink.stroke(); }
      function disc(x, y, radius, color) { ink.fillStyle = color; ink.beginPath(); ink.arc(x, y, radius, 0, 2 * Math.PI); ink.fill(); }
      function label(text, x, y) {
        ink.save();
        ink.translate(x, y);
        ink.scale(1, -1);
        ink.font = `700 ${Math.max(0.17, 11 / scale)}px system-ui, sans-serif`;
        ink.fillStyle = 'white';
        ink.textAlign = 'center';
        ink.textBaseline = 'middle';
        ink.fillText(text, 0, 0);
        ink.restore();
      }
      function drawHeat({ columns, most, counts }, color) {
        ink.fillStyle = color;
        counts.forEach((count, index) => {
          if (count === 0) return;
          // The root, so that ways are seen beside places where something lay for long.
          ink.globalAlpha = 0.15 + 0.75 * Math.sqrt(count / most);
          const [column, row] = [index % columns, Math.floor(index / columns)];
          ink.fillRect((column - columns / 2) * CELL, (row - counts.length / columns / 2) * CELL, CELL, CELL);
        });
        ink.globalAlpha = 1;
      }
      function drawTrack(track, color) {
        ink.strokeStyle = color;
        ink.lineWidth = 1.5 / scale;
        ink.globalAlpha = 0.6;
        ink.beginPath();
        for (const { x, y, isJoined } of track) { if (isJoined) ink.lineTo(x, y); else ink.moveTo(x, y); }
        ink.stroke();
        ink.globalAlpha = 1;
      }
      function drawKick({ header, from, to, outcome, robot: kicker }, time) {
        const age = time - secondsOf(header.stamp);
        if (age > SHOWN_S) return;
        ink.globalAlpha = 1 - (0.8 * Math.max(0, age)) / SHOWN_S;
        ink.strokeStyle = outcome === GOAL ? '#ffd400' : 'white';
        ink.lineWidth = (outcome >= SHOT ? 3 : 1.5) / scale;
        ink.setLineDash(outcome === PASS ? [0.1, 0.07] : []);
        ink.beginPath(); ink.moveTo(from.x, from.y); ink.lineTo(to.x, to.y); ink.stroke();
        ink.setLineDash([]);
        disc(to.x, to.y, 3 / scale, TEAM_COLORS[teamOf(kicker)]);
        ink.globalAlpha = 1;
      }
      function drawBelief(name, { pose, ball, poseAt, ballAt, heading }, time) {
        ink.strokeStyle = TEAM_COLORS[teamOf(name)];
        ink.lineWidth = 2 / scale;
        if (pose) {
          const { x, y } = toWorld(name, pose);
          const turned = heading + (toWorld(name, { x: 1, y: 0 }).x < 0 ? Math.PI : 0);
          ink.globalAlpha = time - poseAt > OLD_S ? 0.35 : 1;
          circle(x, y, 1.7 * ROBOT_RADIUS);
          ink.beginPath(); ink.moveTo(x, y); ink.lineTo(x + 2.4 * ROBOT_RADIUS * Math.cos(turned), y + 2.4 * ROBOT_RADIUS * Math.sin(turned)); ink.stroke();
        }
        if (ball) {
          const { x, y } = toWorld(name, ball);
          ink.globalAlpha = time - ballAt > OLD_S ? 0.35 : 1;
          disc(x, y, 3 / scale, TEAM_COLORS[teamOf(name)]);
          ink.lineWidth = 1 / scale;
          circle(x, y, 6 / scale);
        }
        ink.globalAlpha = 1;
      }
    }

    if (fieldTopic) robot.subscribe(fieldTopic, ({ data }) => { field = JSON.parse(data); draw(); });
    if (stateTopic) robot.subscribe(stateTopic, (message) => { state = message; show(); });
    if (kickTopic) robot.subscribe(kickTopic, (kick) => { kicks = [...kicks, kick].slice(-200); draw(); });
    if (statisticsTopic) robot.subscribe(statisticsTopic, showStatistics);
    if (eventTopic) {
      robot.subscribe(eventTopic, ({ data }) => {
        events.prepend(h('li', null, data));
        while (events.childElementCount > SHOWN_EVENTS) events.lastElementChild?.remove();
      });
    }
    const resized = new ResizeObserver(draw);
    resized.observe(root);
    return { destroy() { resized.disconnect(); }, seeked() { replace(events, []); forget(); } };
  },
};
