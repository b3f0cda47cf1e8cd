// @ts-check
// The connection to a robot: Foxglove's WebSocket protocol and the asks of our own server.

import { decoder, encode, parseSchema } from './cdr.js';

/**
 * @typedef {{ id: number, topic: string, schemaName: string, schema: string, encoding: string }} Channel
 * @typedef {(message: any, timeNs: bigint, raw: Uint8Array) => void} Listener
 * @typedef {{ latest?: boolean }} SubscribeOptions  `latest`: only the newest message of each frame is decoded and delivered.
 * @typedef {{ listener: Listener, latest: boolean }} Subscriber
 * @typedef {{ name: string, value?: any, type?: string }} Parameter
 * @typedef {{ status: 'playing' | 'paused' | 'buffering' | 'ended', timeNs: bigint, speed: number, startNs: bigint, endNs: bigint }} Playback
 * @typedef {{ id: number, name: string, type: string, request: { schemaName: string, schema: string },
 *   response: { schemaName: string, schema: string } }} Service
 * @typedef {{ name: string, version?: string, mayChange?: boolean, isSimulated?: boolean, isBag?: boolean, canPause?: boolean,
 *   modules?: Record<string, { kind: string, source?: string }>,
 *   panels?: { name: string, title: string, module: string, script: string, topics: string[] }[] }} Info
 */

const SUBPROTOCOL = 'downbeat.view.v1';
/** Messages of one topic that wait for the next frame; a page in the background must not collect without end. */
const MOST_WAITING = 4000;
const ASK_PATIENCE_MS = 15_000;
const LONGEST_PAUSE_MS = 5_000;

/** One topic: who listens, and what waits for the next frame. */
class Feed {
  /** @param {string} topic */
  constructor(topic) {
    this.topic = topic;
    /** @type {Set<Subscriber>} */
    this.subscribers = new Set();
    /** @type {{ time: bigint, bytes: Uint8Array }[]} */
    this.waiting = [];
    /** @type {number | undefined} The number of the subscription at the server. */
    this.id = undefined;
    /** @type {((bytes: Uint8Array) => any) | undefined} */
    this.decode = undefined;
    /** @type {any} */
    this.latest = undefined;
    this.latestTime = 0n;
    this.count = 0;
    this.bytes = 0;
    this.problem = '';
  }
}

/** Opens and keeps the connection, and tells what happens as events. */
export class Robot extends EventTarget {
  /** @param {string} url */
  constructor(url) {
    super();
    this.url = url;
    /** @type {'connecting' | 'open' | 'closed'} */
    this.state = 'connecting';
    this.mayChange = false;
    /** @type {Info | null} */
    this.info = null;
    /** @type {any} */
    this.serverInfo = null;
    /** @type {Map<string, Channel>} */
    this.channels = new Map();
    /** @type {Map<string, Service>} */
    this.services = new Map();
    /** @type {Map<string, Parameter>} */
    this.parameters = new Map();
    /** @type {Playback | null} */
    this.playback = null;
    /** The robot's time as the server or the messages tell it, in nanoseconds. */
    this.timeNs = 0n;
    /** Why there is no connection, in words. */
    this.reason = '';
    /** @type {Map<string, Feed>} */
    this.feeds = new Map();
    /** @type {Map<number, Feed>} */
    this.feedsById = new Map();
    /** @type {Map<string, import('./cdr.js').Schema>} */
    this.schemas = new Map();
    /** @type {Map<number, { resolve: (value: any) => void, reject: (error: Error) => void, timer: any }>} */
    this.asked = new Map();
    /** @type {Map<string, number>} */
    this.advertised = new Map();
    /** @type {Map<string, Promise<ArrayBuffer>>} */
    this.assets = new Map();
    this.lastId = 0;
    this.pauseMs = 500;
    this.isFramePlanned = false;
    this.hasEnded = false;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.connect();
  }

  connect() {
    this.state = 'connecting';
    const socket = new WebSocket(this.url, SUBPROTOCOL);
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    socket.onopen = () => { this.pauseMs = 500; };
    socket.onmessage = ({ data }) => {
      try {
        if (typeof data === 'string') this.takeText(JSON.parse(data));
        else this.takeBytes(new Uint8Array(data));
      } catch (error) {
        this.report('error', `a message of the server cannot be read: ${words(error)}`);
      }
    };
    socket.onclose = ({ reason }) => {
      if (this.socket !== socket) return;
      this.reason = reason || 'the robot does not answer';
      this.reset();
      this.change('closed');
      if (this.hasEnded) return;
      setTimeout(() => this.connect(), this.pauseMs);
      this.pauseMs = Math.min(this.pauseMs * 1.6, LONGEST_PAUSE_MS);
    };
  }

  /** Ends the connection for good. */
  close() {
    this.hasEnded = true;
    this.socket?.close();
  }

  /** @param {'connecting' | 'open' | 'closed'} state */
  change(state) {
    this.state = state;
    this.dispatchEvent(new CustomEvent('state', { detail: state }));
  }

  /** What does not survive a connection. */
  reset() {
    for (const { reject, timer } of this.asked.values()) { clearTimeout(timer); reject(new Error('the connection is lost')); }
    this.asked.clear();
    this.advertised.clear();
    this.assets.clear();
    this.channels.clear();
    this.services.clear();
    this.schemas.clear();
    this.feedsById.clear();
    for (const feed of this.feeds.values()) { feed.id = undefined; feed.decode = undefined; feed.waiting = []; feed.latest = undefined; }
  }

  /** @param {any} message */
  send(message) {
    if (this.socket?.readyState !== WebSocket.OPEN) throw new Error('there is no connection to the robot');
    this.socket.send(message instanceof Uint8Array ? /** @type {any} */ (message) : JSON.stringify(message));
  }

  /** @param {'info' | 'warning' | 'error'} level @param {string} text */
  report(level, text) { this.dispatchEvent(new CustomEvent('status', { detail: { level, text } })); }

  // ---- what the server sends

  /** @param {any} message */
  takeText(message) {
    switch (message.op) {
      case 'serverInfo': this.welcome(message); break;
      case 'advertise':
        for (const channel of message.channels) this.channels.set(channel.topic, channel);
        for (const feed of this.feeds.values()) this.open(feed);
        this.dispatchEvent(new Event('channels'));
        break;
      case 'unadvertise': {
        const gone = new Set(message.channelIds);
        for (const [topic, { id }] of this.channels) {
          if (!gone.has(id)) continue;
          this.channels.delete(topic);
          this.schemas.delete(topic);
          const feed = this.feeds.get(topic);
          if (feed) { if (feed.id !== undefined) this.feedsById.delete(feed.id); feed.id = undefined; feed.decode = undefined; }
        }
        this.dispatchEvent(new Event('channels'));
        break;
      }
      case 'advertiseServices':
        for (const service of message.services) this.services.set(service.name, service);
        this.dispatchEvent(new Event('services'));
        break;
      case 'unadvertiseServices':
        for (const [name, { id }] of this.services) if (message.serviceIds.includes(id)) this.services.delete(name);
        this.dispatchEvent(new Event('services'));
        break;
      case 'parameterValues': {
        const isNew = message.parameters.some((/** @type {Parameter} */ parameter) => !this.parameters.has(parameter.name));
        for (const parameter of message.parameters) this.parameters.set(parameter.name, parameter);
        if (message.id === 'all' || isNew) this.watchParameters();
        this.dispatchEvent(new Event('parameters'));
        break;
      }
      case 'serviceCallFailure': this.answer(message.callId, undefined, message.message); break;
      case 'answer': this.answer(message.id, message.ok, message.error); break;
      case 'status': this.report(message.level === 2 ? 'error' : message.level === 1 ? 'warning' : 'info', message.message); break;
      default: break;
    }
  }

  /** @param {any} info */
  welcome(info) {
    const has = (/** @type {string} */ name) => (info.capabilities ?? []).includes(name);
    this.serverInfo = info;
    this.mayChange = has('clientPublish');
    this.info = { name: info.name };
    this.playback = has('playbackControl')
      ? { status: 'paused', timeNs: nanoseconds(info.dataStartTime), speed: 1, startNs: nanoseconds(info.dataStartTime), endNs: nanoseconds(info.dataEndTime) }
      : null;
    this.parameters.clear();
    if (has('parameters')) this.send({ op: 'getParameters', parameterNames: [], id: 'all' });
    const socket = this.socket;
    // The first list of channels follows; who is told that the connection is open may look at them.
    const channels = new Promise((resolve) => this.addEventListener('channels', resolve, { once: true }));
    const about = this.ask('robot').then((answer) => {
      this.info = answer;
      if (typeof answer.mayChange === 'boolean') this.mayChange = answer.mayChange;
    }, () => {});
    Promise.all([channels, about]).then(() => { if (socket === this.socket && socket?.readyState === WebSocket.OPEN) this.change('open'); });
  }

  watchParameters() {
    this.send({ op: 'subscribeParameterUpdates', parameterNames: [...this.parameters.keys()] });
  }

  /** @param {Uint8Array} bytes */
  takeBytes(bytes) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    switch (bytes[0]) {
      case 1: {
        const feed = this.feedsById.get(view.getUint32(1, true));
        if (!feed) return;
        const time = view.getBigUint64(5, true);
        feed.count++;
        feed.bytes += bytes.length - 13;
        if (feed.waiting.length >= MOST_WAITING) feed.waiting.shift();
        feed.waiting.push({ time, bytes: bytes.subarray(13) });
        this.tell(time);
        this.planFrame();
        break;
      }
      case 2: this.tell(view.getBigUint64(1, true), true); break;
      case 3: {
        const [callId, length] = [view.getUint32(5, true), view.getUint32(9, true)];
        this.answer(callId, bytes.subarray(13 + length));
        break;
      }
      case 4: {
        const [requestId, length] = [view.getUint32(1, true), view.getUint32(6, true)];
        if (bytes[5] === 0) this.answer(requestId, bytes.slice(10 + length).buffer);
        else this.answer(requestId, undefined, new TextDecoder().decode(bytes.subarray(10, 10 + length)));
        break;
      }
      case 5: {
        if (!this.playback) return;
        const status = /** @type {const} */ (['playing', 'paused', 'buffering', 'ended'])[bytes[1]] ?? 'paused';
        const hasJumped = view.getUint8(14) !== 0;
        this.playback = { ...this.playback, status, timeNs: view.getBigUint64(2, true), speed: view.getFloat32(10, true) };
        this.timeNs = this.playback.timeNs;
        this.dispatchEvent(new CustomEvent('playback', { detail: { ...this.playback, hasJumped } }));
        if (hasJumped) this.dispatchEvent(new Event('seeked'));
        break;
      }
      default: break;
    }
  }

  /** @param {bigint} time @param {boolean} [isClock] */
  tell(time, isClock = false) {
    if (!isClock && time <= this.timeNs) return;
    this.timeNs = time;
    if (isClock) this.dispatchEvent(new Event('time'));
  }

  planFrame() {
    if (this.isFramePlanned) return;
    this.isFramePlanned = true;
    // A page in the background gets no frames.
    if (document.hidden) setTimeout(() => this.deliver(), 200);
    else requestAnimationFrame(() => this.deliver());
  }

  /** Gives everybody what has arrived since the last frame. */
  deliver() {
    this.isFramePlanned = false;
    for (const feed of this.feeds.values()) {
      if (feed.waiting.length === 0) continue;
      const { waiting } = feed;
      feed.waiting = [];
      const wantsAll = [...feed.subscribers].some(({ latest }) => !latest);
      const from = wantsAll ? 0 : waiting.length - 1;
      for (let i = from; i < waiting.length; i++) this.deliverOne(feed, waiting[i], i === waiting.length - 1);
    }
  }

  /** @param {Feed} feed @param {{ time: bigint, bytes: Uint8Array }} message @param {boolean} isLast */
  deliverOne(feed, { time, bytes }, isLast) {
    let message;
    try {
      feed.decode ??= decoder(this.schema(feed.topic));
      message = feed.decode(bytes);
    } catch (error) {
      const problem = `${feed.topic}: ${words(error)}`;
      if (feed.problem !== problem) this.report('error', problem);
      feed.problem = problem;
      return;
    }
    feed.latest = message;
    feed.latestTime = time;
    for (const subscriber of feed.subscribers) {
      if (subscriber.latest && !isLast) continue;
      try { subscriber.listener(message, time, bytes); } catch (error) { console.error(feed.topic, error); }
    }
  }

  // ---- what panels use

  /** The definition of a topic's messages. @param {string} topic */
  schema(topic) {
    let schema = this.schemas.get(topic);
    if (!schema) {
      const channel = this.channels.get(topic);
      if (!channel) throw new Error(`there is no topic ${topic}`);
      if (channel.encoding !== 'cdr') throw new Error(`${topic} is encoded as ${channel.encoding}, not as cdr`);
      schema = parseSchema(channel.schemaName, channel.schema);
      this.schemas.set(topic, schema);
    }
    return schema;
  }

  /**
   * Calls `listener` with messages of a topic, also when it appears later, and again after a lost connection. Messages are delivered
   * once per frame of the screen.
   * @param {string} topic @param {Listener} listener @param {SubscribeOptions} [options] @returns {() => void} ends it
   */
  subscribe(topic, listener, options = {}) {
    let feed = this.feeds.get(topic);
    if (!feed) { feed = new Feed(topic); this.feeds.set(topic, feed); }
    const subscriber = { listener, latest: options.latest ?? false };
    feed.subscribers.add(subscriber);
    if (feed.id === undefined) this.open(feed);
    else if (feed.latest !== undefined) {
      // Those who come later see the last message at once, as with a latched topic.
      const [message, time] = [feed.latest, feed.latestTime];
      queueMicrotask(() => { if (feed.subscribers.has(subscriber)) listener(message, time, new Uint8Array()); });
    }
    return () => {
      if (!feed.subscribers.delete(subscriber) || feed.subscribers.size > 0) return;
      this.feeds.delete(topic);
      if (feed.id === undefined) return;
      this.feedsById.delete(feed.id);
      if (this.socket?.readyState === WebSocket.OPEN) this.send({ op: 'unsubscribe', subscriptionIds: [feed.id] });
    };
  }

  /** @param {Feed} feed */
  open(feed) {
    const channel = this.channels.get(feed.topic);
    if (!channel || feed.id !== undefined || this.socket?.readyState !== WebSocket.OPEN) return;
    feed.id = ++this.lastId;
    this.feedsById.set(feed.id, feed);
    this.send({ op: 'subscribe', subscriptions: [{ id: feed.id, channelId: channel.id }] });
  }

  /** The last message received on a subscribed topic. @param {string} topic */
  latest(topic) { return this.feeds.get(topic)?.latest; }

  /** Topics of a type, sorted. @param {...string} schemaNames */
  topicsOf(...schemaNames) {
    const found = [...this.channels.values()].filter(({ schemaName }) => schemaNames.includes(schemaName));
    return found.map(({ topic }) => topic).sort();
  }

  /** @param {string} topic @param {string} schemaName @param {any} message @throws {Error} if a field does not fit */
  publish(topic, schemaName, message) {
    const bytes = encode(this.schema(topic), message);
    let id = this.advertised.get(topic);
    if (id === undefined) {
      id = ++this.lastId;
      this.send({ op: 'advertise', channels: [{ id, topic, encoding: 'cdr', schemaName }] });
      this.advertised.set(topic, id);
    }
    const frame = new Uint8Array(5 + bytes.length);
    frame[0] = 1;
    new DataView(frame.buffer).setUint32(1, id, true);
    frame.set(bytes, 5);
    this.send(frame);
  }

  /** @param {string} name @param {any} request @returns {Promise<any>} the response */
  async call(name, request) {
    const service = this.services.get(name);
    if (!service) throw new Error(`there is no service ${name}`);
    const bytes = encode(parseSchema(service.request.schemaName, service.request.schema), request);
    const frame = new Uint8Array(16 + bytes.length);
    const view = new DataView(frame.buffer);
    const { id, promise } = this.expect();
    frame[0] = 2;
    [service.id, id, 3].forEach((number, i) => view.setUint32(1 + 4 * i, number, true));
    frame.set(new TextEncoder().encode('cdr'), 13);
    frame.set(bytes, 16);
    this.send(frame);
    return decoder(parseSchema(service.response.schemaName, service.response.schema))(await promise);
  }

  /** @param {string} name @param {any} value as JSON has it */
  setParameter(name, value) {
    this.send({ op: 'setParameters', parameters: [{ name, value }], id: `set ${name}` });
  }

  /** @param {string} what @param {Record<string, any>} [args] @returns {Promise<any>} rejects with the server's words */
  ask(what, args = {}) {
    const { id, promise } = this.expect();
    try { this.send({ op: 'ask', id, ask: what, ...args }); } catch (error) { this.answer(id, undefined, words(error)); }
    return promise;
  }

  /** @param {string} uri @returns {Promise<ArrayBuffer>} the file, for example behind `package://robot/mesh.stl` */
  asset(uri) {
    let asset = this.assets.get(uri);
    if (!asset) {
      const { id, promise } = this.expect();
      asset = promise;
      this.assets.set(uri, asset);
      try { this.send({ op: 'fetchAsset', uri, requestId: id }); } catch (error) { this.answer(id, undefined, words(error)); }
    }
    return asset;
  }

  /** Controls the playback of a bag. @param {{ play?: boolean, speed?: number, seekNs?: bigint }} wish */
  control({ play, speed, seekNs }) {
    const { playback } = this;
    if (!playback) throw new Error('only a bag can be played');
    const id = new TextEncoder().encode(String(++this.lastId));
    const frame = new Uint8Array(19 + id.length);
    const view = new DataView(frame.buffer);
    frame[0] = 3;
    frame[1] = (play ?? playback.status === 'playing') ? 0 : 1;
    view.setFloat32(2, speed ?? playback.speed, true);
    frame[6] = seekNs === undefined ? 0 : 1;
    view.setBigUint64(7, seekNs ?? 0n, true);
    view.setUint32(15, id.length, true);
    frame.set(id, 19);
    try { this.send(frame); } catch (error) { this.report('error', words(error)); }
  }

  /** @returns {{ id: number, promise: Promise<any> }} */
  expect() {
    const id = ++this.lastId;
    const promise = new Promise((resolve, reject) => {
      const timer = setTimeout(() => this.answer(id, undefined, 'the robot does not answer'), ASK_PATIENCE_MS);
      this.asked.set(id, { resolve, reject, timer });
    });
    return { id, promise };
  }

  /** @param {number} id @param {any} value @param {string} [error] */
  answer(id, value, error) {
    const asked = this.asked.get(id);
    if (!asked) return;
    this.asked.delete(id);
    clearTimeout(asked.timer);
    if (error === undefined) asked.resolve(value);
    else asked.reject(new Error(error));
  }

  /** The same robot, for one panel: what it subscribes to and listens for is held while the panel is not visible. */
  scope() { return scopeOf(this); }
}

/**
 * What a panel sees of the robot: all members of `Robot`, but subscriptions, listeners and repeated work end with the panel, and
 * subscriptions exist at the server only while it is visible.
 * @param {Robot} robot
 */
function scopeOf(robot) {
  /** @type {Set<{ topic: string, listener: Listener, options?: SubscribeOptions, end: (() => void) | null }>} */
  const subscriptions = new Set();
  /** @type {(() => void)[]} */
  const endings = [];
  let isVisible = true;
  const own = {
    /** @param {string} topic @param {Listener} listener @param {SubscribeOptions} [options] */
    subscribe(topic, listener, options) {
      const entry = { topic, listener, options, end: isVisible ? robot.subscribe(topic, listener, options) : null };
      subscriptions.add(entry);
      return () => { if (subscriptions.delete(entry)) entry.end?.(); };
    },
    /** @param {string} type @param {any} listener @param {any} [options] */
    addEventListener(type, listener, options) {
      robot.addEventListener(type, listener, options);
      endings.push(() => robot.removeEventListener(type, listener, options));
    },
    /** Calls `work` now and then every `periodMs` while the panel is visible. @param {number} periodMs @param {() => void} work */
    every(periodMs, work) {
      const timer = setInterval(() => { if (isVisible && !document.hidden) work(); }, periodMs);
      endings.push(() => clearInterval(timer));
      work();
      return () => clearInterval(timer);
    },
    /** @param {boolean} visible */
    setVisible(visible) {
      if (visible === isVisible) return;
      isVisible = visible;
      for (const entry of subscriptions) {
        entry.end?.();
        entry.end = visible ? robot.subscribe(entry.topic, entry.listener, entry.options) : null;
      }
    },
    get isVisible() { return isVisible; },
    endScope() {
      for (const entry of subscriptions) entry.end?.();
      subscriptions.clear();
      endings.splice(0).forEach((end) => end());
    },
  };
  const all = new Proxy(robot, {
    get(target, key) {
      if (key in own) return /** @type {any} */ (own)[key];
      const value = /** @type {any} */ (target)[key];
      return typeof value === 'function' ? value.bind(target) : value;
    },
  });
  return /** @type {Robot & typeof own} */ (all);
}

/** @param {{ sec: number, nsec: number } | undefined} time */
const nanoseconds = (time) => (time ? BigInt(time.sec) * 1_000_000_000n + BigInt(time.nsec) : 0n);

/** What went wrong, for people. @param {unknown} error */
export const words = (error) => (error instanceof Error ? error.message : String(error));
