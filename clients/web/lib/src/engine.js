// The engine in WebAssembly (drape/engine/source): its memory, the records in it, and its calls.
//
// Memory is handed out from one end and never given back: an instance is that of one garment. A record lies there as 64-bit
// words, which the table of records.js names; an array is in it as its address and the number of its elements.
import { LAYOUT, RECORDS } from "./records.js";
import { KIND, MAGIC, WIRE_VERSION } from "./wire.js";

const PAGE = 65536; // bytes of WebAssembly's pages
const MORE = 64; // pages by which memory grows at least
const ALIGNED = 64;
const SPARE = 64; // bytes behind an array: rows of sixteen numbers and points are read beyond its end
const FIRST_SCRATCH = 4 << 20;
const HEADER = 20; // bytes of a FOLDS message
const KINDS = {
  numbers: Float32Array, float32s: Float32Array, float64s: Float64Array, int32s: Int32Array, uint32s: Uint32Array, uint16s: Uint16Array, bytes: Uint8Array,
};
const HUNG = { faces: "int32s", asked: "int32s", corner: "int32s", weight: "numbers", offset: "numbers", kind: "bytes" };
const NOTHING = { at: 0, count: 0 };

const wordsOf = (kind) =>
  kind in RECORDS ? Object.values(RECORDS[kind]).reduce((sum, part) => sum + wordsOf(part), 0) : kind === "number" || kind === "count" ? 1 : 2;

export class Engine {
  // module: the compiled engine (folds.js).
  static async make(module) {
    const memory = new WebAssembly.Memory({ initial: MORE });
    const { exports } = await WebAssembly.instantiate(module, { env: { memory } });
    return new Engine(memory, exports);
  }

  constructor(memory, exports) {
    this.memory = memory;
    this.exports = exports;
    const layout = BigInt.asUintN(64, exports.drape_records_hash()).toString(16).padStart(16, "0");
    if (layout !== LAYOUT) throw new Error(`expected an engine of the layout ${LAYOUT}, got ${layout}: build the page again`);
    this.end = exports.__heap_base.value;
    this.scratch = this.#take(32);
    this.#enlarge(FIRST_SCRATCH);
  }

  #take(bytes) {
    const at = Math.ceil(this.end / ALIGNED) * ALIGNED;
    this.end = at + bytes + SPARE;
    const missing = this.end - this.memory.buffer.byteLength;
    if (missing > 0) this.memory.grow(Math.max(MORE, Math.ceil(missing / PAGE)));
    return at;
  }

  // Scratch memory of so many bytes: struct Scratch of arrays.hpp.
  #enlarge(bytes) {
    this.scratchBytes = bytes;
    const begin = this.#take(bytes);
    const words = new DataView(this.memory.buffer, this.scratch);
    words.setBigUint64(0, BigInt(begin), true);
    words.setBigInt64(8, BigInt(bytes), true);
  }

  // An array of zeros, of one of the kinds that records have.
  array(kind, count) {
    return { at: this.#take(count * KINDS[kind].BYTES_PER_ELEMENT), count, kind };
  }

  // The numbers of an array, until memory grows.
  view({ at, count, kind }) {
    return new KINDS[kind](this.memory.buffer, at, count);
  }

  // The record name with fields: numbers, arrays, the fields of records in it, and lists of these. What is left out is zero
  // or empty.
  record(name, fields = {}) {
    const at = this.#take(8 * wordsOf(name));
    this.#write(name, fields, at);
    return { at, name, ...fields };
  }

  // Writes numbers into a record.
  set(record, numbers) {
    let at = record.at;
    for (const [field, kind] of Object.entries(RECORDS[record.name])) {
      if (field in numbers) this.#writeOne(kind, numbers[field], at);
      at += 8 * wordsOf(kind);
    }
  }

  #write(name, fields, at) {
    for (const [field, kind] of Object.entries(RECORDS[name])) {
      this.#writeOne(kind, fields[field], at);
      at += 8 * wordsOf(kind);
    }
  }

  #writeOne(kind, value, at) {
    if (kind in RECORDS) {
      this.#write(kind, value ?? {}, at);
      return;
    }
    let own = value ?? NOTHING;
    if (kind.endsWith("[]")) own = this.#list(kind.slice(0, -2), value ?? []);
    const words = new DataView(this.memory.buffer, at);
    if (kind === "number") words.setFloat64(0, value ?? 0, true);
    else if (kind === "count") words.setBigInt64(0, BigInt(value ?? 0), true);
    else {
      words.setBigUint64(0, BigInt(own.at), true);
      words.setBigInt64(8, BigInt(own.count), true);
    }
  }

  #list(name, all) {
    const bytes = 8 * wordsOf(name);
    const at = this.#take(bytes * all.length);
    all.forEach((fields, i) => this.#write(name, fields, at + bytes * i));
    return { at, count: all.length };
  }

  // Copies the arrays of a FOLDS message here; returns the fields of its records by their names, and as "hung" the
  // arrays by which a drawn mesh hangs on the cloth, null where none came.
  lay(message) {
    const view = new DataView(message);
    if (view.getUint32(0, true) !== MAGIC || view.getUint8(4) !== WIRE_VERSION || view.getUint8(5) !== KIND.FOLDS) {
      throw new Error("not a FOLDS message of this wire version: reload the page");
    }
    let from = HEADER + view.getUint32(16, true);
    const { layout, records, hung = null } = JSON.parse(new TextDecoder().decode(new Uint8Array(message, HEADER, from - HEADER)));
    if (layout !== LAYOUT) throw new Error(`expected a FOLDS message of the layout ${LAYOUT}, got ${layout}: reload the page`);
    const fieldsOf = (name, told) =>
      Object.fromEntries(Object.entries(RECORDS[name]).map(([field, kind]) => [field, read(kind, told[field])]));
    const read = (kind, told) => {
      if (kind in RECORDS) return fieldsOf(kind, told);
      if (kind.endsWith("[]")) return told.map((one) => fieldsOf(kind.slice(0, -2), one));
      if (!(kind in KINDS)) return told;
      const array = this.array(kind, told);
      const width = KINDS[kind].BYTES_PER_ELEMENT; // bytes of an element, which stand apart in the message
      const [own, given] = [new Uint8Array(this.memory.buffer, array.at, width * told), new Uint8Array(message, from, width * told)];
      for (let byte = 0, i = 0; byte < width; byte++) for (let at = byte; at < own.length; at += width) own[at] = given[i++];
      from += given.length + (-given.length & 3);
      return array;
    };
    const laid = Object.fromEntries(Object.entries(records).map(([name, told]) => [name, fieldsOf(name, told)]));
    const drawn = hung && Object.fromEntries(Object.entries(HUNG).map(([field, kind], i) => [field, read(kind, hung[i])]));
    return { ...laid, hung: drawn };
  }

  // Calls a function of float32 that takes scratch: records, arrays and numbers, whole ones as BigInt. Returns a whole number.
  call(name, ...given) {
    const words = given.map((one) => one.at ?? one);
    for (;;) {
      const scratch = new DataView(this.memory.buffer, this.scratch, 32);
      scratch.setBigInt64(16, 0n, true);
      scratch.setUint8(24, 0);
      const found = this.exports[`drape_${name}_f32`](...words, this.scratch);
      if (!scratch.getUint8(24)) return Number(found);
      this.#enlarge(2 * this.scratchBytes);
    }
  }
}
