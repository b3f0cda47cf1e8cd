// @ts-check
// Message definitions (`ros2msg` text), and messages of such types in CDR: reading and writing.
//
// Sources: OMG DDS-XTypes 1.3, 7.4 (CDR, encapsulation headers), the ROS 2 interface definition
// (design.ros2.org/articles/legacy_interface_definition.html).

/**
 * @typedef {{ name: string, type: string, isArray: boolean, length?: number, bound?: number, default?: any,
 *   comment?: string }} Field  `length` is that of a fixed array, `bound` the most elements of a bounded one.
 * @typedef {{ name: string, value: any, type: string }} Constant
 * @typedef {{ name: string, fields: Field[], constants: Constant[] }} Definition
 * @typedef {{ root: Definition, types: Map<string, Definition> }} Schema
 */

const SIZES = /** @type {Record<string, number>} */ ({
  bool: 1, byte: 1, char: 1, int8: 1, uint8: 1, int16: 2, uint16: 2, int32: 4, uint32: 4,
  int64: 8, uint64: 8, float32: 4, float64: 8,
});
const ARRAYS = /** @type {Record<string, any>} */ ({
  byte: Uint8Array, char: Uint8Array, int8: Int8Array, uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array,
  int32: Int32Array, uint32: Uint32Array, float32: Float32Array, float64: Float64Array,
});
const RANGES = /** @type {Record<string, [number | bigint, number | bigint]>} */ ({
  byte: [0, 255], char: [0, 255], int8: [-128, 127], uint8: [0, 255], int16: [-32768, 32767], uint16: [0, 65535],
  int32: [-2147483648, 2147483647], uint32: [0, 4294967295], int64: [-(2n ** 63n), 2n ** 63n - 1n], uint64: [0n, 2n ** 64n - 1n],
});
const TIME = ['int32 sec', 'uint32 nanosec'];
/** Nobody nests deeper, and a definition that names itself would never end. */
const DEEPEST = 32;

/** @param {string} type */
export const isPrimitive = (type) => type in SIZES || type === 'string' || type === 'wstring';
/** @param {string} type */
export const isNumeric = (type) => type in SIZES;

/** `std_msgs/Header` for `std_msgs/msg/Header`: definitions are written both ways. @param {string} name */
const short = (name) => {
  const parts = name.split('/');
  return parts.length > 2 ? `${parts[0]}/${parts[parts.length - 1]}` : name;
};

/** Cuts a comment off, but not inside quotes. @param {string} line @returns {[string, string]} */
function withoutComment(line) {
  let quote = '';
  for (let at = 0; at < line.length; at++) {
    const c = line[at];
    if (quote) { if (c === '\\') at++; else if (c === quote) quote = ''; }
    else if (c === '"' || (c === "'" && /[=\s]/.test(line[at - 1] ?? ' '))) quote = c;
    else if (c === '#') return [line.slice(0, at).trim(), line.slice(at + 1).trim()];
  }
  return [line.trim(), ''];
}

/** @param {string} text @param {string} type @returns {any} */
function literal(text, type) {
  text = text.trim();
  if (text.startsWith('[')) {
    const inner = text.slice(1, -1).trim();
    return inner ? inner.split(',').map((part) => literal(part, type)) : [];
  }
  if (type === 'string' || type === 'wstring') return text.replace(/^(['"])([\s\S]*)\1$/, '$2').replace(/\\(.)/g, '$1');
  if (type === 'bool') return /^(true|1)$/i.test(text);
  if (type === 'int64' || type === 'uint64') { try { return small(BigInt(text)); } catch { return 0; } }
  return Number(text);
}

/** @param {bigint} value */
const small = (value) => (value >= -9007199254740991n && value <= 9007199254740991n ? Number(value) : value);

/** @param {string} line @param {string} comment @param {Definition} into */
function parseLine(line, comment, into) {
  const match = /^([\w/]+)(<=(\d+))?(\[(<=)?(\d*)\])?\s+(\w+)\s*(.*)$/.exec(line);
  if (!match) throw new Error(`${into.name}: "${line}" is no field`);
  const [, rawType, , , brackets, atMost, count, name, rest] = match;
  let type = rawType;
  if (rest.startsWith('=')) {
    into.constants.push({ name, type, value: literal(rest.slice(1), type) });
    return;
  }
  if (type === 'time' || type === 'duration') type = `builtin_interfaces/${type === 'time' ? 'Time' : 'Duration'}`;
  if (type === 'Header') type = 'std_msgs/Header';
  /** @type {Field} */
  const field = { name, type: short(type), isArray: Boolean(brackets) };
  if (brackets && count && !atMost) field.length = Number(count);
  if (brackets && count && atMost) field.bound = Number(count);
  if (rest) field.default = literal(rest, type);
  if (comment) field.comment = comment;
  into.fields.push(field);
}

/**
 * Reads a definition with those of the types that it uses, separated by lines of `=`.
 * @param {string} name @param {string} text @returns {Schema}
 */
export function parseSchema(name, text) {
  /** @type {Map<string, Definition>} */
  const types = new Map();
  const root = { name: short(name), fields: [], constants: [] };
  types.set(root.name, root);
  /** @type {Definition} */
  let current = root;
  for (const raw of text.split(/\r?\n/)) {
    if (/^={10,}\s*$/.test(raw)) continue;
    const header = /^MSG:\s*(\S+)/.exec(raw);
    if (header) {
      current = { name: short(header[1]), fields: [], constants: [] };
      types.set(current.name, current);
      continue;
    }
    const [line, comment] = withoutComment(raw);
    if (line) parseLine(line, comment, current);
  }
  for (const builtin of ['builtin_interfaces/Time', 'builtin_interfaces/Duration']) {
    if (types.has(builtin)) continue;
    const definition = { name: builtin, fields: [], constants: [] };
    TIME.forEach((line) => parseLine(line, '', definition));
    types.set(builtin, definition);
  }
  // Types are named in full, or without package inside their own package.
  for (const definition of types.values()) {
    const home = definition.name.split('/')[0];
    for (const field of definition.fields) {
      if (isPrimitive(field.type)) continue;
      const found = [field.type, `${home}/${field.type}`, `${root.name.split('/')[0]}/${field.type}`].find((known) => types.has(known))
        ?? [...types.keys()].find((known) => !field.type.includes('/') && known.endsWith(`/${field.type}`));
      if (!found) throw new Error(`${definition.name}: the type ${field.type} of ${field.name} is not defined`);
      field.type = found;
    }
  }
  return { root, types };
}

const text = new TextDecoder();

/** A position in the bytes of a message. */
class Cursor {
  /** @param {Uint8Array} bytes */
  constructor(bytes) {
    if (bytes.length < 4) throw new Error('the message is shorter than its header');
    const kind = (bytes[0] << 8) | bytes[1];
    if (kind !== 0 && kind !== 1 && kind !== 6 && kind !== 7) throw new Error(`the encapsulation ${kind} is not supported`);
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.little = (kind & 1) === 1;
    this.widest = kind >= 6 ? 4 : 8;
    this.at = 4;
  }

  /** Skips to the alignment of `size`, and past it. @param {number} size */
  take(size, count = 1) {
    const step = Math.min(size, this.widest);
    const start = 4 + Math.ceil((this.at - 4) / step) * step;
    this.at = start + size * count;
    if (this.at > this.bytes.length) throw new Error('the message ends too early');
    return start;
  }

  /** How many elements follow, each of at least `least` bytes. @param {number} least */
  count(least) {
    const count = this.view.getUint32(this.take(4), this.little);
    if (count * least > this.bytes.length - this.at) throw new Error('the message ends too early');
    return count;
  }

  /** @param {string} type @returns {any} */
  primitive(type) {
    const { view, little } = this;
    switch (type) {
      case 'float64': return view.getFloat64(this.take(8), little);
      case 'float32': return view.getFloat32(this.take(4), little);
      case 'bool': return view.getUint8(this.take(1)) !== 0;
      case 'byte': case 'char': case 'uint8': return view.getUint8(this.take(1));
      case 'int8': return view.getInt8(this.take(1));
      case 'int16': return view.getInt16(this.take(2), little);
      case 'uint16': return view.getUint16(this.take(2), little);
      case 'int32': return view.getInt32(this.take(4), little);
      case 'uint32': return view.getUint32(this.take(4), little);
      case 'int64': return small(view.getBigInt64(this.take(8), little));
      case 'uint64': return small(view.getBigUint64(this.take(8), little));
      case 'string': {
        const length = this.count(1);
        const start = this.take(1, length);
        const end = length > 0 && this.bytes[start + length - 1] === 0 ? length - 1 : length;
        return text.decode(this.bytes.subarray(start, start + end));
      }
      default: {
        const units = this.primitiveArray('uint16', this.count(2));
        let found = '';
        for (const unit of units) found += String.fromCharCode(unit);
        return found;
      }
    }
  }

  /** @param {string} type @param {number} count @returns {any} */
  primitiveArray(type, count) {
    const Kind = ARRAYS[type];
    if (Kind && count > 0) {
      const size = SIZES[type];
      const start = this.take(size, count);
      // Bytes are shown where they are; wider numbers need an aligned copy.
      if (size === 1) return new Kind(this.bytes.buffer, this.bytes.byteOffset + start, count);
      if (this.little) return new Kind(this.bytes.slice(start, start + size * count).buffer);
      this.at = start;
    } else if (Kind) return new Kind(0);
    const found = [];
    for (let i = 0; i < count; i++) found.push(this.primitive(type));
    return Kind ? Kind.from(found) : found;
  }
}

/**
 * A function that reads messages of a type. Numbers of 64 bits are `number` where that is exact, else `bigint`; arrays of numbers
 * are typed arrays, those of bytes a view of the message.
 * @param {Schema} schema @returns {(bytes: Uint8Array) => any}
 */
export function decoder(schema) {
  /** @type {Map<string, (cursor: Cursor) => any>} */
  const readers = new Map();
  /** @param {string} type @param {number} depth @returns {(cursor: Cursor) => any} */
  const readerOf = (type, depth) => {
    const known = readers.get(type);
    if (known) return known;
    if (depth > DEEPEST) throw new Error(`the type ${type} is nested too deeply`);
    const definition = schema.types.get(type);
    if (!definition) throw new Error(`the type ${type} is not defined`);
    const steps = definition.fields.map((field) => fieldReader(field, depth));
    const isEmpty = definition.fields.length === 0;
    const reader = (/** @type {Cursor} */ cursor) => {
      /** @type {Record<string, any>} */
      const message = {};
      // A struct without fields is one byte in ROS 2.
      if (isEmpty) { if (cursor.at < cursor.bytes.length) cursor.at += 1; return message; }
      for (const step of steps) step(cursor, message);
      return message;
    };
    readers.set(type, reader);
    return reader;
  };
  /** @param {Field} field @param {number} depth @returns {(cursor: Cursor, into: any) => void} */
  const fieldReader = ({ name, type, isArray, length }, depth) => {
    if (isPrimitive(type)) {
      if (!isArray) return (cursor, into) => { into[name] = cursor.primitive(type); };
      const least = SIZES[type] ?? 4;
      return (cursor, into) => { into[name] = cursor.primitiveArray(type, length ?? cursor.count(least)); };
    }
    const reader = readerOf(type, depth + 1);
    if (!isArray) return (cursor, into) => { into[name] = reader(cursor); };
    return (cursor, into) => {
      const count = length ?? cursor.count(1);
      const found = [];
      for (let i = 0; i < count; i++) found.push(reader(cursor));
      into[name] = found;
    };
  };
  const root = readerOf(schema.root.name, 0);
  return (bytes) => root(new Cursor(bytes));
}

/** Bytes that grow. */
class Writer {
  constructor() {
    this.bytes = new Uint8Array(256);
    this.view = new DataView(this.bytes.buffer);
    this.bytes[1] = 1;
    this.at = 4;
  }

  /** @param {number} size @param {number} [count] */
  room(size, count = 1) {
    const start = 4 + Math.ceil((this.at - 4) / size) * size;
    this.at = start + size * count;
    if (this.at > this.bytes.length) {
      const larger = new Uint8Array(Math.max(this.at, this.bytes.length * 2));
      larger.set(this.bytes);
      this.bytes = larger;
      this.view = new DataView(larger.buffer);
    }
    return start;
  }

  /** @param {number} count of elements that follow */
  count(count) {
    // `room` may replace the view: it is read after that.
    const start = this.room(4);
    this.view.setUint32(start, count, true);
  }

  /** @param {string} type @param {any} value @param {string} where */
  primitive(type, value, where) {
    const wrong = (/** @type {string} */ expected) => new Error(`${where}: expected ${expected}, found ${show(value)}`);
    if (type === 'string') {
      if (typeof value !== 'string') throw wrong('text');
      const encoded = new TextEncoder().encode(value);
      this.count(encoded.length + 1);
      const start = this.room(1, encoded.length + 1);
      this.bytes.set(encoded, start);
      return;
    }
    if (type === 'wstring') {
      if (typeof value !== 'string') throw wrong('text');
      this.count(value.length);
      for (let i = 0; i < value.length; i++) this.primitive('uint16', value.charCodeAt(i), where);
      return;
    }
    if (type === 'bool') {
      if (typeof value !== 'boolean') throw wrong('true or false');
      const start = this.room(1);
      this.bytes[start] = value ? 1 : 0;
      return;
    }
    if (type === 'float32' || type === 'float64') {
      // JSON has no NaN or infinities: their names stand for them.
      const number = typeof value === 'string' && /^[-+]?(nan|inf(inity)?)$/i.test(value) ? named(value) : value;
      if (typeof number !== 'number') throw wrong('a number');
      const start = this.room(type === 'float32' ? 4 : 8);
      if (type === 'float32') this.view.setFloat32(start, number, true);
      else this.view.setFloat64(start, number, true);
      return;
    }
    const [least, most] = RANGES[type];
    const isWhole = typeof value === 'bigint' || Number.isInteger(value);
    if (!isWhole || value < least || value > most) throw wrong(`a whole number from ${least} to ${most}`);
    const size = SIZES[type];
    const start = this.room(size);
    if (size === 8) this.view.setBigUint64(start, BigInt.asUintN(64, BigInt(value)), true);
    else if (size === 4) this.view.setUint32(start, Number(value) >>> 0, true);
    else if (size === 2) this.view.setUint16(start, Number(value) & 0xffff, true);
    else this.view.setUint8(start, Number(value) & 0xff);
  }
}

/** @param {string} name */
const named = (name) => (/nan/i.test(name) ? NaN : name.startsWith('-') ? -Infinity : Infinity);
/** @param {any} value */
const show = (value) => (value === undefined ? 'nothing' : typeof value === 'bigint' ? String(value) : JSON.stringify(value));

/**
 * The bytes of a message. Fields that are left out have their defaults.
 * @param {Schema} schema @param {any} message @returns {Uint8Array}
 * @throws {Error} which names the field, if a value does not fit
 */
export function encode(schema, message) {
  const writer = new Writer();
  encodeType(schema, schema.root.name, message ?? {}, writer, '', 0);
  return writer.bytes.subarray(0, writer.at);
}

/** @param {Schema} schema @param {string} type @param {any} value @param {Writer} writer @param {string} where @param {number} depth */
function encodeType(schema, type, value, writer, where, depth) {
  if (isPrimitive(type)) { writer.primitive(type, value, where); return; }
  const definition = schema.types.get(type);
  if (!definition || depth > DEEPEST) throw new Error(`${where}: the type ${type} is not defined, or nested too deeply`);
  if (value === null || typeof value !== 'object' || Array.isArray(value)) throw new Error(`${where || type}: expected an object, found ${show(value)}`);
  const known = new Set(definition.fields.map((field) => field.name));
  const unknown = Object.keys(value).find((key) => !known.has(key));
  if (unknown !== undefined) throw new Error(`${where ? `${where}.` : ''}${unknown}: ${type} has no such field`);
  if (definition.fields.length === 0) { writer.room(1); return; }
  for (const field of definition.fields) {
    const path = where ? `${where}.${field.name}` : field.name;
    const given = value[field.name] === undefined ? initial(schema, field, depth) : value[field.name];
    if (!field.isArray) { encodeType(schema, field.type, given, writer, path, depth + 1); continue; }
    if (!Array.isArray(given) && !ArrayBuffer.isView(given)) throw new Error(`${path}: expected a list, found ${show(given)}`);
    const items = /** @type {any[]} */ (given);
    if (field.length !== undefined && items.length !== field.length) throw new Error(`${path}: expected ${field.length} elements, found ${items.length}`);
    if (field.bound !== undefined && items.length > field.bound) throw new Error(`${path}: at most ${field.bound} elements, found ${items.length}`);
    if (field.length === undefined) writer.count(items.length);
    for (let i = 0; i < items.length; i++) encodeType(schema, field.type, items[i], writer, `${path}[${i}]`, depth + 1);
  }
}

/** @param {Schema} schema @param {Field} field @param {number} depth @returns {any} */
function initial(schema, field, depth) {
  if (field.default !== undefined) return field.default;
  const one = () => {
    if (field.type === 'string' || field.type === 'wstring') return '';
    if (field.type === 'bool') return false;
    return isNumeric(field.type) ? 0 : template(schema, field.type, depth + 1);
  };
  return field.isArray ? Array.from({ length: field.length ?? 0 }, one) : one();
}

/** A message with all fields at their defaults, to be filled in. @param {Schema} schema @param {string} [type] @returns {any} */
export function template(schema, type = schema.root.name, depth = 0) {
  const definition = schema.types.get(type);
  if (!definition || depth > DEEPEST) return {};
  return Object.fromEntries(definition.fields.map((field) => [field.name, initial(schema, field, depth)]));
}

/**
 * The numeric fields of a message: `{ path, value }` for `position[3]`, `pose.pose.position.x`. Bytes are left out, and so are
 * more than `most` elements of an array.
 * @param {any} message @param {number} [most] @returns {string[]}
 */
export function numericPaths(message, most = 64) {
  /** @type {string[]} */
  const found = [];
  /** @param {any} value @param {string} path @param {number} depth */
  const walk = (value, path, depth) => {
    if (depth > DEEPEST || found.length > 2000) return;
    if (typeof value === 'number' || typeof value === 'bigint' || typeof value === 'boolean') found.push(path);
    else if (value instanceof Uint8Array || value === null || typeof value !== 'object') return;
    else if (Array.isArray(value) || ArrayBuffer.isView(value)) {
      const items = /** @type {any[]} */ (value);
      for (let i = 0; i < Math.min(items.length, most); i++) walk(items[i], `${path}[${i}]`, depth + 1);
    } else for (const [key, inner] of Object.entries(value)) walk(inner, path ? `${path}.${key}` : key, depth + 1);
  };
  walk(message, '', 0);
  return found;
}

/** A function that reads the number at a path such as `pose.position[2].x`; NaN where there is none. @param {string} path */
export function getter(path) {
  const keys = path.match(/[^.[\]]+/g) ?? [];
  return (/** @type {any} */ message) => {
    let value = message;
    for (const key of keys) {
      if (value === null || value === undefined) return NaN;
      value = value[key];
    }
    return value === undefined || value === null || typeof value === 'object' || typeof value === 'string' ? NaN : Number(value);
  };
}
