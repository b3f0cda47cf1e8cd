// @ts-check
// Questions to the program behind the page, and what the editor of robot files answers.

/**
 * @typedef {{ name: string, is: 'topic' | 'service' | 'action', does: 'publishes' | 'subscribes' | 'serves' | 'calls', type: string }} Port
 * @typedef {{ name: string, description: string, type: string, default: any, range?: [number, number], choices?: string[],
 *   is_read_only: boolean, is_file: boolean, is_required: boolean }} Setting
 * @typedef {{ kind: string, about: string, is_emulated: boolean, uses_device: boolean, runs: string, periods_s: number[],
 *   keys: { name: string, is_required: boolean }[], settings: Setting[], ports: Port[], needs?: string }} Profile
 * @typedef {{ kind: string, reason: string }} Missing
 * @typedef {{ schema: number, kinds: Profile[], missing: Missing[], launchers: string[], templates: { name: string, title: string, about: string }[],
 *   interfaces: string[] }} Profiles
 * @typedef {Port & { topic: string }} ShownPort
 * @typedef {{ name: string, kind: string, line: number, given: any, profile: Profile | null, ports: ShownPort[] }} Module
 * @typedef {{ name: string, is: Port['is'], type: string, has_source: boolean, has_sink: boolean, list: string, is_exposed: boolean,
 *   by_pattern?: string, is_recorded: boolean }} Topic
 * @typedef {{ module: string, port: string }} PortName
 * @typedef {{ is: Port['is'], topic: string, from: PortName, to: PortName, is_sound: boolean }} Wire
 * @typedef {{ line: number, problem: string, module?: string, key?: string, severity: 'error' | 'warning' }} Problem
 * @typedef {{ revision: number, path: string, name: string, is_new: boolean, is_dirty: boolean, is_changed_on_disk: boolean,
 *   can_undo: boolean, can_redo: boolean, text: string, sections: Record<string, any>,
 *   picture: { modules: Module[], topics: Topic[], wires: Wire[], problems: Problem[] },
 *   layout: Record<string, { x: number, y: number }> }} Doc
 * @typedef {{ is_running: boolean, lines: string[], next: number, url?: string, bag?: string, exit_code?: number | null }} Output
 */

const SUBPROTOCOL = 'downbeat.view.v1';
const LONGEST_PAUSE_MS = 4000;

/** The token of the page's address. It leaves the address bar, so that it is neither shown nor shared. */
function takeToken() {
  const given = /(?:^#|&)token=([^&]+)/.exec(location.hash);
  try {
    if (given) {
      sessionStorage.setItem('downbeat.token', decodeURIComponent(given[1]));
      history.replaceState(null, '', location.pathname + location.search);
    }
    return sessionStorage.getItem('downbeat.token');
  } catch {
    return given ? decodeURIComponent(given[1]) : null;
  }
}

/** The connection to the program: `state` events, and questions that wait for it. */
export class Editor extends EventTarget {
  constructor() {
    super();
    this.isOpen = false;
    this.lastId = 0;
    this.pauseMs = 300;
    /** @type {Map<number, { resolve: (answer: any) => void, reject: (error: Error) => void }>} */
    this.asked = new Map();
    const token = takeToken();
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    this.url = `${scheme}://${location.host}/ws${token ? `?token=${encodeURIComponent(token)}` : ''}`;
    this.connect();
  }

  connect() {
    const socket = new WebSocket(this.url, SUBPROTOCOL);
    this.socket = socket;
    socket.binaryType = 'arraybuffer';
    socket.onopen = () => this.change(true);
    socket.onmessage = ({ data }) => {
      if (typeof data !== 'string') return;
      const message = JSON.parse(data);
      if (message.op !== 'answer') return;
      const waiting = this.asked.get(message.id);
      this.asked.delete(message.id);
      if (message.error !== undefined) waiting?.reject(new Error(message.error));
      else waiting?.resolve(message.ok);
    };
    socket.onclose = () => {
      for (const { reject } of this.asked.values()) reject(new Error('the connection is lost'));
      this.asked.clear();
      this.change(false);
      setTimeout(() => this.connect(), this.pauseMs);
      this.pauseMs = Math.min(this.pauseMs * 1.7, LONGEST_PAUSE_MS);
    };
  }

  /** @param {boolean} isOpen */
  change(isOpen) {
    if (isOpen) this.pauseMs = 300;
    this.isOpen = isOpen;
    this.dispatchEvent(new Event('state'));
  }

  /**
   * @param {string} ask
   * @param {Record<string, any>} [args]
   * @returns {Promise<any>}
   */
  ask(ask, args = {}) {
    return new Promise((resolve, reject) => {
      if (!this.isOpen) {
        reject(new Error('there is no connection: is the program still running?'));
        return;
      }
      this.lastId += 1;
      this.asked.set(this.lastId, { resolve, reject });
      this.socket?.send(JSON.stringify({ ...args, op: 'ask', id: this.lastId, ask }));
    });
  }
}
