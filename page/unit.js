// The unit in WebAssembly: FMI 2.0 functions, called as by a master in C, with variables by name.

const STATUS = ["OK", "Warning", "Discard", "Error", "Fatal"];
const CO_SIMULATION = 1;
const MILLISECOND = 1e-3;

// Layout of the memory page for arguments, bytes: strings first, then lists of references and values.
const PAGE = 65536;
const STRINGS = 1024;

// A WebAssembly module that imports a function of six integers, the unit's logger, and exports it: a function table accepts no JavaScript
// function directly.
const TRAMPOLINE = new Uint8Array([
  0, 97, 115, 109, 1, 0, 0, 0,
  1, 10, 1, 96, 6, 127, 127, 127, 127, 127, 127, 0,
  2, 7, 1, 1, 109, 1, 102, 0, 0,
  7, 5, 1, 1, 102, 0, 0,
]);

// The unit's message when it refuses a call.
export class Refusal extends Error {
  constructor(call, status, sentence) {
    super(sentence);
    this.call = call;
    this.status = status;
  }
}

// The library and the description of its variables.
export class Library {
  // Loads the bytes of the library and the content of unit.json.
  static async load(bytes, description) {
    const library = new Library();
    library.description = description;
    library.module = await WebAssembly.compile(bytes);
    library.trampoline = await WebAssembly.compile(TRAMPOLINE);
    await library.start();
    return library;
  }

  // Makes a new memory, at first use and after a trap, which leaves the memory in an unknown state.
  async start() {
    this.lines = [];
    const { exports } = await WebAssembly.instantiate(this.module, {});
    const logger = (_environment, _name, status, _category, message) => this.lines.push({ status, text: this.text(message) });
    const trampoline = await WebAssembly.instantiate(this.trampoline, { m: { f: logger } });
    this.exports = exports;
    const table = exports.__indirect_function_table;
    const slot = table.grow(1);
    table.set(slot, trampoline.exports.f);
    // Rust's allocator only uses pages that its own calls of memory.grow return, so this page is ours.
    this.arguments = exports.memory.grow(1) * PAGE;
    this.free = this.arguments + STRINGS;
    this.callbacks = this.reserve(20);
    new Uint32Array(exports.memory.buffer, this.callbacks, 5).set([slot, 0, 0, 0, 0]);
    this.guid = this.string(this.description.guid, 0);
    this.name = this.string("page", 128);
  }

  // Reserves memory for arguments; it is never freed.
  reserve(bytes) {
    const at = this.free;
    this.free += Math.ceil(bytes / 8) * 8;
    if (this.free > this.arguments + PAGE) throw new Error("the page of memory for arguments is full");
    return at;
  }

  string(text, offset) {
    const bytes = new TextEncoder().encode(text + "\0");
    new Uint8Array(this.exports.memory.buffer, this.arguments + offset, bytes.length).set(bytes);
    return this.arguments + offset;
  }

  text(at) {
    const bytes = new Uint8Array(this.exports.memory.buffer);
    // Percent signs are doubled, because FMI defines the text as a printf format.
    return new TextDecoder().decode(bytes.slice(at, bytes.indexOf(0, at))).replaceAll("%%", "%");
  }

  // Calls a function; throws the unit's message if the status is above `allowed`.
  call(name, allowed, ...args) {
    const status = this.exports[name](...args);
    if (status > allowed) throw this.refusal(name, status);
    return status;
  }

  refusal(name, status) {
    const said = this.lines.findLast((line) => line.status >= 1);
    this.lines.length = 0;
    return new Refusal(name, status, said ? said.text : `${name} returned fmi2${STATUS[status]}.`);
  }

  variable(name) {
    const variable = this.description.variables[name];
    if (!variable) throw new Error(`there is no variable ${name}`);
    return variable;
  }

  // A list of variables of one type, with memory to read or set them repeatedly.
  reader(names) {
    const kinds = { Real: "Real", Integer: "Integer", Enumeration: "Integer", Boolean: "Boolean" };
    const variables = names.map((name) => this.variable(name));
    const kind = kinds[variables[0].kind];
    const references = this.reserve(4 * names.length);
    const values = this.reserve(8 * names.length);
    const buffer = this.exports.memory.buffer;
    new Uint32Array(buffer, references, names.length).set(variables.map((variable) => variable.reference));
    return { kind, names, references, values, array: kind === "Real" ? Float64Array : Int32Array, view: null };
  }

  // The reader for a list of names; made once per list and memory.
  readerOf(names) {
    this.readers ??= new Map();
    if (this.readersOf !== this.exports) [this.readers, this.readersOf] = [new Map(), this.exports];
    if (!this.readers.has(names)) this.readers.set(names, this.reader(names));
    return this.readers.get(names);
  }
}

// A machine: an instance of the unit.
export class Machine {
  // Makes an instance with these start values and inputs, by name, at a time, ms; ready for its first step.
  constructor(library, values, start = 0) {
    this.library = library;
    this.exports = library.exports;
    this.milliseconds = start;
    this.component = this.exports.fmi2Instantiate(library.name, CO_SIMULATION, library.guid, 0, library.callbacks, 0, 0);
    if (!this.component) throw library.refusal("fmi2Instantiate", 3);
    try {
      this.set(values);
      const call = (name, ...args) => library.call(name, 1, this.component, ...args);
      call("fmi2SetupExperiment", 0, 0, this.time, 0, 0);
      call("fmi2EnterInitializationMode");
      call("fmi2ExitInitializationMode");
    } catch (error) {
      if (error instanceof Refusal) this.close();
      throw error;
    }
  }

  // Sets variables by name.
  set(values) {
    for (const [name, value] of Object.entries(values)) this.put(listed([name]), [value]);
  }

  // Sets variables of one type to a list of values.
  put(names, values) {
    const reader = this.library.readerOf(names);
    this.view(reader).set(values);
    this.call("Set", reader);
  }

  // Reads variables of one type; the values are valid until the next use of this list.
  get(names) {
    const reader = this.library.readerOf(names);
    this.call("Get", reader);
    return this.view(reader);
  }

  call(way, { kind, references, names, values }) {
    this.library.call(`fmi2${way}${kind}`, 1, this.component, references, names.length, values);
  }

  // View of the values of a list; renewed if the memory has grown.
  view(reader) {
    const { buffer } = this.exports.memory;
    if (reader.view?.buffer !== buffer) reader.view = new reader.array(buffer, reader.values, reader.names.length);
    return reader.view;
  }

  // Time reached, s: a product, because a sum of milliseconds drifts.
  get time() {
    return this.milliseconds * MILLISECOND;
  }

  // Takes one communication step of a millisecond.
  step() {
    this.library.call("fmi2DoStep", 1, this.component, this.time, MILLISECOND, 1);
    this.milliseconds += 1;
  }

  // Frees the instance.
  close() {
    if (this.component && this.exports === this.library.exports) this.exports.fmi2FreeInstance(this.component);
    this.component = 0;
  }
}

// Always returns the same list for the same names, because `readerOf` reserves memory for each list.
const lists = new Map();
export function listed(names) {
  const key = names.join(" ");
  if (!lists.has(key)) lists.set(key, names);
  return lists.get(key);
}
