// Settings of the user: scene, values, speed. They can be written as a link, as a scene file and as a command.

export const SPEEDS = [0.01, 0.1, 0.25, 1, 4];

// Booleans in links.
const SWITCHED = { true: true, false: false };

// The value of a word; undefined for unknown words.
const item = (items, word) => (Object.hasOwn(items, word) ? items[word] : undefined);

export class Settings {
  constructor(description) {
    this.description = description;
    this.scene = this.find("fall_90_120") ?? description.scenes[0];
    this.values = {};
    this.speed = 1;
    this.chaos = false;
  }

  find(name) {
    return this.description.scenes.find((scene) => scene.name === name);
  }

  // Chooses a scene and drops changed values.
  choose(name) {
    this.scene = this.find(name);
    this.values = {};
  }

  // Present value of a parameter or input.
  value(name) {
    return this.values[name] ?? this.scene.values[name] ?? this.description.variables[name].start;
  }

  // Sets values. A value equal to the scene's own is not stored, unless it replaces a signal.
  set(values) {
    for (const [name, value] of Object.entries(values)) {
      const usual = this.scene.values[name] ?? this.description.variables[name].start;
      if (value === usual && !(name in this.scene.signals)) delete this.values[name];
      else this.values[name] = value;
    }
  }

  // All values that a new machine starts with.
  all() {
    return { ...this.scene.values, ...this.values };
  }

  // The scene's signals, without those replaced by a value.
  signals() {
    const silenced = (name) => name in this.values;
    const kept = ([name, signal]) => !silenced(name) && !(signal.rateOf && silenced(signal.rateOf));
    return Object.fromEntries(Object.entries(this.scene.signals).filter(kept));
  }

  // Enumeration items by name, as in files and commands.
  written(name, value) {
    const { items } = this.description.variables[name];
    return items ? Object.keys(items).find((item) => items[item] === value) : value;
  }

  // The part of a link after #.
  link() {
    const entries = Object.entries(this.values).map(([name, value]) => [name, this.written(name, value)]);
    const speed = this.speed === 1 ? [] : [["speed", this.speed]];
    const chaos = this.chaos ? [["chaos", true]] : [];
    return String(new URLSearchParams([["scene", this.scene.name], ...speed, ...chaos, ...entries]));
  }

  // Applies the settings of a link; returns a sentence for each part that is refused.
  read(link) {
    const refused = [];
    const given = new URLSearchParams(link);
    if (given.has("scene")) {
      if (this.find(given.get("scene"))) this.choose(given.get("scene"));
      else refused.push(`The link names the scene '${given.get("scene")}', which does not exist.`);
    }
    for (const [name, text] of given) {
      if (name === "scene") continue;
      if (name === "chaos" && item(SWITCHED, text) !== undefined) {
        this.chaos = item(SWITCHED, text);
        continue;
      }
      if (name === "speed") {
        if (SPEEDS.includes(Number(text))) this.speed = Number(text);
        else refused.push(`The link's speed is ${text}, must be one of ${SPEEDS.join(", ")}.`);
        continue;
      }
      const value = this.parse(name, text);
      if (value === undefined) refused.push(`The link sets '${name}' to '${text}', which is not a value of a parameter or an input.`);
      else this.set({ [name]: value });
    }
    return refused;
  }

  parse(name, text) {
    const variables = this.description.variables;
    if (!Object.hasOwn(variables, name)) return undefined;
    const { kind, role, items } = variables[name];
    if (role !== "parameter" && role !== "input") return undefined;
    if (items) return item(items, text);
    if (kind === "Boolean") return item(SWITCHED, text);
    const value = text.trim() === "" ? NaN : Number(text);
    return Number.isFinite(value) && (kind === "Real" || Number.isInteger(value)) ? value : undefined;
  }

  // The content of a scene file, as in scenes/.
  file() {
    const { name, description, stopTime } = this.scene;
    // A scene without a method would run by a different method elsewhere.
    const values = Object.entries({ "solver.method": this.value("solver.method"), ...this.all() }).map(([variable, value]) => [variable, this.written(variable, value)]);
    const own = Object.keys(this.values).length ? `${description} Changed on the live page.` : description;
    const scene = { description: own, experiment: { stopTime, stepSize: 0.001 }, ...Object.fromEntries(values) };
    const signals = this.signals();
    if (Object.keys(signals).length) scene.signals = signals;
    return { name: `${name}.json`, text: `${JSON.stringify(scene, null, 2)}\n` };
  }

  // The command for the same run. Only a file can replace a signal by a value.
  command() {
    if (Object.keys(this.signals()).length < Object.keys(this.scene.signals).length) return `fivebar run ${this.file().name}  # the saved scene`;
    const sets = Object.entries(this.values)
      .filter(([name]) => name !== "solver.method")
      .map(([name, value]) => {
        const assignment = `${name}=${this.written(name, value)}`;
        // Double quotes work in every shell.
        return ` --set ${/[^\w.=+-]/.test(assignment) ? `"${assignment}"` : assignment}`;
      });
    const named = "solver.method" in this.scene.values && !("solver.method" in this.values);
    const method = named ? "" : ` --method ${this.written("solver.method", this.value("solver.method"))}`;
    return `fivebar run ${this.scene.name}${sets.join("")}${method}`;
  }
}
