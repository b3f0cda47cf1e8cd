// How fast the page is, at a running robot with /joint_states: first paint, delay from publish to screen, pictures per second of a full plot.
// It measures and prints; nothing is demanded.
//
// Usage: downbeat run robots/darwin_op.toml --view
//        DOWNBEAT_NODE_MODULES=target/node/node_modules DOWNBEAT_CHROMIUM=/usr/bin/chromium node bridge/view/tests/page/bench.mjs URL

import { launch, open } from './browser.mjs';

const url = process.argv[2] ?? process.env.DOWNBEAT_PAGE;
const [LINES, POINTS, SECONDS] = [20, 12_500, 5];
const quantile = (values, part) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(values.length * part))];
const browser = await launch();

const paints = [];
for (let run = 0; run < 5; run += 1) {
  const seen = await open(browser, url);
  paints.push(await seen.page.evaluate(() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? NaN));
  await seen.close();
}
console.log(`first contentful paint: median ${quantile(paints, 0.5).toFixed(0)} ms, longest ${Math.max(...paints).toFixed(0)} ms of ${paints.length}`);

const { page, close } = await open(browser, `${url}`);
await page.evaluate(() => { location.hash = 'log'; });
const delays = await page.evaluate((seconds) => new Promise((resolve) => {
  /** @type {number[]} */
  const found = [];
  const end = window.robot.subscribe('/joint_states', (_, timeNs) => {
    const published = Number(timeNs) / 1e6;
    // The task after the next frame's drawing: what was changed now is on the screen.
    requestAnimationFrame(() => {
      const { port1, port2 } = new MessageChannel();
      port1.onmessage = () => found.push(performance.timeOrigin + performance.now() - published);
      port2.postMessage(null);
    });
  });
  setTimeout(() => { end(); resolve(found); }, seconds * 1000);
}), SECONDS);
console.log(`from publish to screen: median ${quantile(delays, 0.5).toFixed(1)} ms, p99 ${quantile(delays, 0.99).toFixed(1)} ms of ${delays.length} messages`);

// Processor time does not depend on what else the machine does.
const protocol = await page.context().newCDPSession(page);
await protocol.send('Performance.enable', { timeDomain: 'threadTicks' });
const busy = async () => (await protocol.send('Performance.getMetrics')).metrics.find(({ name }) => name === 'TaskDuration')?.value ?? NaN;
const before = await busy();

// The plot's panel as it is, with a robot that has sent all points and sends one more in each frame.
const drawn = await page.evaluate(async ({ lines, points, seconds }) => {
  const { default: plot } = await import('/panels/plot.js');
  /** @type {((message: any, timeNs: bigint) => void)[]} */
  const listeners = [];
  const robot = Object.assign(new EventTarget(), {
    state: 'open', playback: null, timeNs: 0n, info: null, mayChange: false, isVisible: true, parameters: new Map(), feeds: new Map(),
    channels: new Map([['/numbers', { id: 1, topic: '/numbers', schemaName: 'std_msgs/msg/Float64MultiArray', schema: '', encoding: 'cdr' }]]),
    subscribe(_, listener) { listeners.push(listener); return () => listeners.splice(listeners.indexOf(listener), 1); },
    every() { return () => {}; },
    topicsOf: () => [], latest: () => undefined, ask: async () => { throw new Error('nothing to ask'); },
  });
  const chosen = Array.from({ length: lines }, (_, color) => ({ topic: '/numbers', path: `data[${color}]`, label: `line ${color}`, color }));
  const stage = document.createElement('div');
  Object.assign(stage.style, { position: 'fixed', inset: '0', zIndex: '99', display: 'flex', flexDirection: 'column', background: 'Canvas' });
  document.body.append(stage);
  const header = document.createElement('div');
  const panel = plot.create(stage, robot, { get: () => ({ lines: chosen, window: 120 }), set() {}, setTitle() {}, header });
  const message = (index) => ({ data: Float64Array.from({ length: lines }, (_, line) => Math.sin(index / (40 + line)) + Math.random() * 0.3 + line) });
  const send = (index) => listeners.forEach((listener) => listener(message(index), BigInt(index) * 8_000_000n));
  for (let index = 0; index < points; index += 1) send(index);
  let [pictures, strokes, isNew] = [0, 0, true];
  const { stroke } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.stroke = function (...all) {
    strokes += 1;
    if (isNew) pictures += 1;
    isNew = false;
    return stroke.apply(this, all);
  };
  const begin = performance.now();
  let index = points;
  let frames = 0;
  await new Promise((resolve) => {
    const frame = () => {
      [isNew, frames] = [true, frames + 1];
      send((index += 1));
      if (performance.now() - begin < seconds * 1000) requestAnimationFrame(frame);
      else resolve(null);
    };
    requestAnimationFrame(frame);
  });
  const took = (performance.now() - begin) / 1000;
  CanvasRenderingContext2D.prototype.stroke = stroke;
  panel.destroy();
  stage.remove();
  return { count: pictures, pictures: pictures / took, frames: frames / took, strokes: strokes / Math.max(1, pictures) };
}, { lines: LINES, points: POINTS, seconds: SECONDS });
console.log(`plot of ${LINES} lines with ${POINTS} points: ${drawn.pictures.toFixed(1)} pictures per second of ${drawn.frames.toFixed(1)} frames, ${drawn.strokes.toFixed(0)} strokes each`);
console.log(`processor time of the page for one: ${(((await busy()) - before) * 1000 / Math.max(1, drawn.count)).toFixed(1)} ms, filling included`);
await close();
await browser.close();
