// The live page: a machine that falls, is dragged and is switched, frame by frame.

import { Library, Refusal } from "./unit.js";
import { part } from "./source.js";
import { Settings } from "./settings.js";
import { Run } from "./run.js";
import { View } from "./view.js";
import { Accuracy } from "./accuracy.js";
import { History, drawAccuracy, drawHistory, drawSymbol, quantity } from "./charts.js";
import { METHODS } from "./effects.js";
import { Controls } from "./controls.js";

const BUDGET = 10; // ms of computing in a frame; beyond it time slows down, so that the page does not stutter
const LONGEST_FRAME = 50; // ms of real time that a frame can catch up
const BESIDE = 1e-6; // rad between the starts of both machines
const PUSH = 1; // N, force of the arrow keys
const COSTS = 120; // frames over which the cost is averaged
const TRACED = 4; // ms between points of the trace
const MEASURED_IN = 2; // ms of each frame spent on accuracy against time

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

const element = (id) => document.getElementById(id);

// Whether a key already has a meaning for the element that has the focus.
function means(target, key) {
  if (target.closest("select, dialog")) return true;
  if (target.closest("[type=range]")) return key.startsWith("Arrow");
  return Boolean(target.closest("button, input, a")) && (key === " " || key === "Enter");
}

class Page {
  constructor(library) {
    this.library = library;
    this.settings = new Settings(library.description);
    this.view = new View(element("canvas"));
    this.energies = new History(4, 400);
    this.distances = new History(8, 400);
    this.pressed = new Set();
    this.controls = new Controls(this);
    this.playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.refused = this.settings.read(location.hash.slice(1));
    this.restyle();
    this.listen();
    this.restart();
    this.frame = this.frame.bind(this);
    requestAnimationFrame(this.frame);
  }

  // Applies the colour scheme of the system.
  restyle() {
    this.view.restyle();
    this.colours = this.view.colours;
    this.controls.show();
    METHODS.forEach(({ name, symbol }) => drawSymbol(element(`symbol-${name}`), symbol, this.colours));
    this.drawnPoints = -1;
  }

  // Restarts from the scene's start.
  restart() {
    this.begin({}, 0);
    this.view.clear();
    this.energies.clear();
    this.distances.clear();
  }

  // Continues from the present posture with a new machine, because a setting has changed that is fixed during a run.
  goOn() {
    if (this.run) this.begin(this.run.pose(), this.run.machine.milliseconds);
    else this.restart();
  }

  // Makes new machines. If the unit refuses, its message is shown.
  begin(values, start) {
    this.sentence(this.refused.splice(0).join(" "));
    [this.fraction, this.costs] = [0, []];
    this.view.describe(this.settings);
    for (const run of [this.run, this.other]) run?.close();
    [this.run, this.other] = [null, null];
    this.attempt(() => {
      this.run = new Run(this.library, this.settings, values, start);
      const beside = (values["init.theta[1]"] ?? this.settings.value("init.theta[1]")) + BESIDE;
      if (this.settings.chaos) this.other = new Run(this.library, this.settings, { ...values, "init.theta[1]": beside }, start);
      this.previous = this.shown(this.run);
      this.passes = this.run.passes();
    });
    if (!this.run) this.forget();
    this.remember();
    this.measure();
    this.controls.show();
  }

  // Clears the numbers of a machine that no longer exists.
  forget() {
    for (const name of ["time", "tipX", "tipY", "energyError", "direct", "inverse"]) delete document.body.dataset[name];
    this.controls.showNothing();
  }

  // Runs an action that the unit may refuse; after a trap the memory is replaced.
  attempt(action) {
    try {
      action();
      return true;
    } catch (error) {
      if (error instanceof Refusal) this.sentence(error.message);
      else if (error instanceof WebAssembly.RuntimeError) this.trapped(error);
      else throw error;
      return false;
    }
  }

  async trapped(error) {
    this.sentence(`The unit has a defect: ${error.message}. Restart to continue.`);
    [this.run, this.other, this.accuracy] = [null, null, null];
    this.forget();
    await this.library.start();
  }

  // Shows an error message; an empty text hides it.
  sentence(text) {
    element("problem").textContent = text;
    element("problem").hidden = !text;
    element("hint").hidden ||= Boolean(text);
  }

  // Measures accuracy against time again, once nothing has changed for a while.
  measure() {
    this.accuracy = null;
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => (this.accuracy = new Accuracy(this.library, this.settings)), 700);
    this.drawnPoints = -1;
  }

  // Changes values. Tunable parameters and inputs are set at once; other values need a new machine, in the same posture or from the start.
  change(values, fromStart = false) {
    const before = Object.keys(this.settings.signals()).length;
    this.settings.set(values);
    const isLive = (name) => this.library.variable(name).variability !== "fixed";
    const live = Object.keys(values).every(isLive) && Object.keys(this.settings.signals()).length === before;
    if (fromStart || !this.run) this.restart();
    else if (!live) this.goOn();
    else {
      const done = this.attempt(() => [this.run, this.other].forEach((run) => run?.machine.set(values)));
      if (done) this.sentence("");
      this.view.describe(this.settings);
      this.remember();
      this.measure();
      this.controls.showShare();
    }
  }

  setPlaying(playing) {
    this.playing = playing;
    this.controls.showPlaying();
  }

  // Writes the settings to the address once nothing has changed for a moment: browsers refuse frequent changes.
  remember() {
    clearTimeout(this.remembering);
    this.remembering = setTimeout(() => history.replaceState(null, "", `#${this.settings.link()}`), 200);
  }

  // Takes steps of a millisecond; returns the number of steps taken.
  advance(count) {
    const begin = performance.now();
    const runs = this.other ? [this.run, this.other] : [this.run];
    let done = 0;
    const fine = this.attempt(() => {
      while (done < count && performance.now() - begin < BUDGET) {
        // Reading the browser's clock takes longer than a step, so it is read only every 8 steps.
        for (let i = 0; i < 8 && done < count; i += 1, done += 1) {
          if (done === count - 1) this.previous = this.shown(this.run, true);
          for (const run of runs) run.step(this.hand);
          this.look();
          if (this.run.machine.milliseconds % TRACED === 0) runs.forEach((run, i) => this.view.trace(i, run.tip()));
        }
      }
    });
    this.costs.push({ spent: performance.now() - begin, steps: done * runs.length });
    if (this.costs.length > COSTS) this.costs.shift();
    if (!fine) this.setPlaying(false);
    return done;
  }

  // Marks the singularities that the last step has passed.
  look() {
    const passes = this.run.passes();
    for (const kind in passes) if (passes[kind] > this.passes[kind]) this.view.mark(kind, this.run.tip());
    this.passes = passes;
  }

  // Positions and force of a run that are drawn.
  shown(run, again = false) {
    const now = again ? run.read() : run.now;
    const point = (name) => [now[`${name}.x`], now[`${name}.y`]];
    return { tip: point("tip"), elbows: [point("elbow[1]"), point("elbow[2]")], force: now.force };
  }

  frame(moment) {
    requestAnimationFrame(this.frame);
    const passed = Math.min(moment - (this.moment ?? moment), LONGEST_FRAME);
    this.moment = moment;
    if (this.run) this.move(passed);
    if (this.run) this.report();
    this.draw();
    this.attempt(() => this.accuracy?.advance(MEASURED_IN));
    this.drawPictures(moment);
  }

  move(passed) {
    if (this.pressed.size) this.hand = { force: [0, 1].map((i) => PUSH * [...this.pressed].reduce((sum, key) => sum + ARROWS[key][i], 0)) };
    else if (this.hand?.force) this.hand = null;
    if (!this.playing) return;
    const due = this.fraction + passed * this.settings.speed;
    const count = Math.floor(due);
    const done = count > 0 ? this.advance(count) : 0;
    this.fraction = done < count ? 0 : due - count;
    this.lag = done < count;
  }

  // Reports the state reached: numbers, marks, histories, and the data of <body>.
  report() {
    if (!this.attempt(() => [this.run, this.other].forEach((run) => run?.read()))) return;
    const { now } = this.run;
    this.energies.add(now.time, ["kinetic", "potential", "dissipated", "input"].map((part) => now[`energy.${part}`]));
    if (this.other) {
      const apart = Math.hypot(now["tip.x"] - this.other.now["tip.x"], now["tip.y"] - this.other.now["tip.y"]);
      this.distances.add(now.time, [apart]);
    }
    const { dataset } = document.body;
    dataset.time = now.time;
    dataset.tipX = now["tip.x"];
    dataset.tipY = now["tip.y"];
    dataset.energyError = now["energy.error"];
    dataset.direct = this.passes.direct;
    dataset.inverse = this.passes.inverse;
    this.controls.showNow(now, this.passes);
  }

  // Draws the machine between its last two milliseconds, so that slow motion is smooth.
  draw() {
    document.body.dataset.scene = this.settings.scene.name;
    document.body.dataset.state = this.run ? "ready" : "refused";
    document.body.dataset.frames = Number(document.body.dataset.frames ?? 0) + 1;
    const state = this.run && this.between(this.previous, this.shown(this.run));
    this.view.draw(state, this.other && this.shown(this.other), this.hand);
  }

  between(from, to) {
    const share = this.playing ? this.fraction : 1;
    const mix = (a, b) => a.map((part, i) => part + share * (b[i] - part));
    return { tip: mix(from.tip, to.tip), elbows: to.elbows.map((elbow, i) => mix(from.elbows[i], elbow)), force: to.force };
  }

  drawPictures(moment) {
    if (moment - (this.pictured ?? 0) < 60) return;
    this.pictured = moment;
    const { colours } = this;
    const curves = [
      { label: "kinetic", colour: colours.accent },
      { label: "potential", colour: colours.ink, dash: [7, 3] },
      { label: "dissipated", colour: colours.muted, dash: [2, 3] },
      { label: "input", colour: colours.ghost, dash: [9, 3, 2, 3] },
    ];
    drawHistory(element("energy"), this.energies, curves, "J", colours);
    if (this.settings.chaos) drawHistory(element("apart"), this.distances, [{ label: this.apart(), colour: colours.ghost }], "m", colours, [-9, 0]);
    this.controls.showCost(this.costs, this.lag);
    const points = this.accuracy?.points.length ?? 0;
    if (points !== this.drawnPoints) {
      drawAccuracy(element("accuracy"), this.accuracy?.points ?? [], this.settings.written("solver.method", this.settings.value("solver.method")), colours);
      this.drawnPoints = points;
    }
    this.controls.showMeasured(this.accuracy);
  }

  apart() {
    const last = this.distances.samples.at(-1);
    return last ? `${quantity(last.values[0], "m")} apart` : "";
  }

  listen() {
    const canvas = element("canvas");
    const follow = (event) => {
      const { left, top } = canvas.getBoundingClientRect();
      this.hand = this.view.from([event.clientX - left, event.clientY - top]);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      canvas.classList.add("held");
      element("hint").hidden = true;
      this.holding = event.pointerId;
      follow(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.pointerId === this.holding) follow(event);
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      canvas.addEventListener(end, (event) => {
        if (event.pointerId !== this.holding) return;
        [this.hand, this.holding] = [null, null];
        canvas.classList.remove("held");
      });
    }
    document.addEventListener("keydown", (event) => this.key(event));
    document.addEventListener("keyup", (event) => this.pressed.delete(event.key));
    window.addEventListener("blur", () => this.pressed.clear());
    window.addEventListener("hashchange", () => {
      if (location.hash.slice(1) === this.settings.link()) return;
      this.settings = new Settings(this.library.description);
      this.refused = this.settings.read(location.hash.slice(1));
      this.restart();
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.restyle());
    window.addEventListener("resize", () => (this.drawnPoints = -1));
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || means(event.target, event.key)) return;
    const action = {
      " ": () => this.setPlaying(!this.playing),
      ".": () => this.stepOnce(1),
      ":": () => this.stepOnce(10),
      ">": () => this.stepOnce(10),
      r: () => this.restart(),
      s: () => this.setSpeed(this.settings.speed === 1 ? 0.1 : 1),
    }[event.key.toLowerCase()];
    if (ARROWS[event.key]) this.pressed.add(event.key);
    else if (action) action();
    else return;
    event.preventDefault();
  }

  // Takes some steps while paused.
  stepOnce(count) {
    this.setPlaying(false);
    this.fraction = 0;
    if (this.run) this.advance(count);
  }

  setSpeed(speed) {
    this.settings.speed = speed;
    this.remember();
    this.controls.showPlaying();
  }

  setChaos(on) {
    this.settings.chaos = on;
    this.distances.clear();
    this.view.traces.length = Math.min(this.view.traces.length, 1);
    this.goOn();
  }
}

async function main() {
  try {
    const [bytes, description] = await Promise.all([
      part("library", "fivebar.wasm").then((response) => response.arrayBuffer()),
      part("unit", "unit.json").then((response) => response.json()),
    ]);
    new Page(await Library.load(bytes, description));
  } catch (error) {
    element("problem").textContent = `The page cannot start: ${error.message}`;
    element("problem").hidden = false;
    document.body.dataset.state = "broken";
    throw error;
  }
}

main();
