// The panel and the buttons: they show the settings and pass the user's changes to the page.

import { EFFECTS, GEOMETRY, KNOBS, METHODS } from "./effects.js";
import { part } from "./source.js";
import { SPEEDS } from "./settings.js";

const SPEED_NAMES = { 0.01: "1/100", 0.1: "1/10", 0.25: "1/4", 1: "1×", 4: "4×" };

// An element with properties and children.
function make(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

const by = (id) => document.getElementById(id);

// A number with three digits.
function short(value) {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-3) return powerOfTen(value);
  return minus(String(Number(value.toPrecision(3))));
}

// Two digits and a power of ten: −6.0·10⁻⁷.
function powerOfTen(value) {
  if (value === 0) return "0";
  const [digits, power] = value.toExponential(1).split("e");
  const raised = [...power.replace("+", "")].map((sign) => (sign === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[sign])).join("");
  return `${minus(digits)}·10${raised}`;
}

const minus = (text) => text.replace("-", "−");

export class Controls {
  constructor(page) {
    this.page = page;
    this.shows = [];
    const { settings } = page;
    by("scene").append(...settings.description.scenes.map(({ name }) => make("option", { value: name, textContent: name.replaceAll("_", " ") })));
    by("version").textContent = settings.description.version;
    by("method").append(...METHODS.map(({ name, label }) => make("option", { value: name, textContent: label })));
    by("methods").append(...METHODS.map(({ name }) => make("li", {}, make("canvas", { id: `symbol-${name}` }), name)));
    by("speed").append(...SPEEDS.map((speed) => this.speedButton(speed)));
    by("effects").append(...EFFECTS.map((effect) => this.effect(effect)));
    by("geometry").append(...GEOMETRY.map((parameter) => this.slider({ ...parameter, fromStart: true })));
    for (const [name, knob] of Object.entries(KNOBS)) by("knob").append(this.slider({ ...knob, names: [name], log: true }));
    this.listen();
  }

  speedButton(speed) {
    const button = make("button", { textContent: SPEED_NAMES[speed], onclick: () => this.page.setSpeed(speed) });
    button.setAttribute("role", "radio");
    button.setAttribute("aria-label", `Speed ${speed}`);
    button.dataset.speed = speed;
    return button;
  }

  // A switch, and its parameters, which are visible while it is on.
  effect({ name, label, parameters, first, hold }) {
    const enabled = `${name}.enabled`;
    const box = make("input", { type: "checkbox", id: `effect-${name}` });
    box.onchange = () => {
      const values = { [enabled]: box.checked };
      const { settings, run } = this.page;
      if (box.checked) {
        for (const [variable, value] of Object.entries(first ?? {})) if (!(variable in settings.all())) values[variable] = value;
        // Servos start by keeping the present posture.
        if (hold && run) for (const i of [1, 2]) values[`servo.theta[${i}]`] = run.now[`theta[${i}]`];
      }
      this.page.change(values);
    };
    const inner = make("div", {}, ...parameters.map((parameter) => (parameter.options ? this.choice(parameter) : this.slider(parameter))));
    this.shows.push((settings) => {
      box.checked = settings.value(enabled);
      inner.hidden = !box.checked;
    });
    return make("div", { className: "effect" }, make("label", { className: "switch" }, box, label), inner);
  }

  choice({ name, label, options }) {
    const select = make("select", {}, ...options.map((option) => make("option", { value: option, textContent: option })));
    select.onchange = () => this.page.change({ [name]: this.page.library.variable(name).items[select.value] });
    this.shows.push((settings) => (select.value = settings.written(name, settings.value(name))));
    return make("label", { className: "parameter" }, make("span", { textContent: label }), select);
  }

  slider({ names, label, min, max, log, scale = 1, unit, also, fromStart }) {
    const [to, back] = log ? [Math.log10, (x) => 10 ** x] : [(x) => x, (x) => x];
    const input = make("input", { type: "range", min: to(min), max: to(max), step: "any" });
    input.setAttribute("aria-label", label);
    input.dataset.name = names[0];
    const output = make("output");
    const say = (value, signal) => {
      output.textContent = signal ? "by the scene" : `${short(value * scale)} ${unit}`.trim();
      input.setAttribute("aria-valuetext", output.textContent);
    };
    input.oninput = () => {
      // Three digits, as links and commands contain.
      const value = Number((back(Number(input.value)) * scale).toPrecision(3)) / scale;
      const rounded = Number(value.toPrecision(12));
      say(rounded);
      this.page.change({ ...Object.fromEntries(names.map((name) => [name, rounded])), ...also?.(rounded) }, fromStart);
    };
    const row = make("label", { className: "parameter" }, make("span", { textContent: label }), input, output);
    row.dataset.knob = names[0];
    this.shows.push((settings) => {
      const value = settings.value(names[0]);
      if (document.activeElement !== input) input.value = to(Math.max(value, log ? min : -Infinity));
      say(value, names[0] in settings.signals());
    });
    return row;
  }

  listen() {
    const { page } = this;
    by("scene").onchange = () => {
      page.settings.choose(by("scene").value);
      page.restart();
      page.setPlaying(true);
    };
    by("method").onchange = () => page.change({ "solver.method": page.library.variable("solver.method").items[by("method").value] });
    by("restart").onclick = () => page.restart();
    by("play").onclick = () => page.setPlaying(!page.playing);
    by("step").onclick = (event) => page.stepOnce(event.shiftKey ? 10 : 1);
    by("chaos").onchange = () => page.setChaos(by("chaos").checked);
    by("here").onclick = () => {
      if (page.run) page.change(page.run.pose(), true);
    };
    by("original").onclick = () => {
      page.settings.choose(page.settings.scene.name);
      page.restart();
    };
    by("copy-command").onclick = () => this.copy(page.settings.command(), "Command copied");
    by("copy-link").onclick = () => this.copy(`${location.href.split("#")[0]}#${page.settings.link()}`, "Link copied");
    by("save").onclick = () => this.save(page.settings.file());
    by("show-licenses").onclick = async () => {
      by("licenses").querySelector("pre").textContent = await (await part("licenses", "licenses.txt")).text();
      by("licenses").showModal();
    };
  }

  async copy(text, said) {
    try {
      await navigator.clipboard.writeText(text);
      this.say(said);
    } catch {
      window.prompt("Copy:", text);
    }
  }

  save({ name, text }) {
    const link = make("a", { download: name, href: URL.createObjectURL(new Blob([text], { type: "application/json" })) });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    this.say(`${name} saved`);
  }

  say(text) {
    by("said").textContent = text;
    by("said").classList.add("shown");
    clearTimeout(this.saying);
    this.saying = setTimeout(() => by("said").classList.remove("shown"), 1800);
  }

  // Shows all settings.
  show() {
    const { settings } = this.page;
    by("scene").value = settings.scene.name;
    by("description").textContent = settings.scene.description;
    const method = settings.written("solver.method", settings.value("solver.method"));
    by("method").value = method;
    const { knob } = METHODS.find(({ name }) => name === method);
    for (const row of by("knob").children) row.hidden = row.dataset.knob !== knob;
    for (const show of this.shows) show(settings);
    by("chaos").checked = settings.chaos;
    by("apart").hidden = !settings.chaos;
    this.showPlaying();
    this.showShare();
  }

  showPlaying() {
    const { page } = this;
    document.body.dataset.playing = page.playing;
    by("play").setAttribute("aria-label", page.playing ? "Pause" : "Play");
    for (const button of by("speed").children) button.setAttribute("aria-checked", Number(button.dataset.speed) === page.settings.speed);
    this.showShare();
  }

  showShare() {
    by("command").textContent = this.page.settings.command();
  }

  // Shows the numbers of a frame.
  showNow(now, counts) {
    const { settings } = this.page;
    by("time").textContent = now.time.toFixed(3);
    by("error").textContent = `${powerOfTen(now["energy.error"])} J`;
    by("assembly").textContent = settings.written("mode.assembly", now["mode.assembly"]);
    by("working").textContent = settings.written("mode.working", now["mode.working"]);
    by("direct").textContent = counts.direct;
    by("inverse").textContent = counts.inverse;
  }

  // Shows dashes when there is no machine.
  showNothing() {
    for (const id of ["time", "error", "cost", "assembly", "working", "direct", "inverse"]) by(id).textContent = "–";
  }

  // Shows the cost of the method over the last frames. The slowest tenth is left out: the computer was busy with other work.
  showCost(costs, lag) {
    const { page } = this;
    const slow = page.settings.speed < 1 ? `slow motion ${SPEED_NAMES[page.settings.speed]}` : "";
    const pace = !page.playing ? "paused" : lag ? "slower than set: computing lags behind" : slow;
    if (by("pace").textContent !== pace) by("pace").textContent = pace;
    const usual = costs.toSorted((a, b) => a.spent * b.steps - b.spent * a.steps).slice(0, Math.ceil(0.9 * costs.length));
    const [spent, steps] = usual.reduce(([time, count], frame) => [time + frame.spent, count + frame.steps], [0, 0]);
    if (steps >= 100) by("cost").textContent = `${short((1e3 * spent) / steps)} µs per ms`;
  }

  showMeasured(accuracy) {
    const text = !accuracy ? "" : accuracy.done ? "Largest error of the tip in the first 0.5 s, against a run at 10⁻¹³ rad." : "Measuring …";
    if (by("measured").textContent !== text) by("measured").textContent = text;
  }
}
