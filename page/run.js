// A running machine: signals, the hand that drags the tip, and communication steps of one millisecond.

import { Machine, listed } from "./unit.js";
import { signals, repeats } from "./signals.js";

const REALS = [
  "tip.x", "tip.y", "tip.vx", "tip.vy", "elbow[1].x", "elbow[1].y", "elbow[2].x", "elbow[2].y", "theta[1]", "theta[2]", "omega[1]", "omega[2]",
  "energy.kinetic", "energy.potential", "energy.input", "energy.dissipated", "energy.error", "contact.fx", "contact.fy",
];
const MODES = ["mode.assembly", "mode.working"];
const PASSES = ["singular.passes.direct", "singular.passes.inverse[1]", "singular.passes.inverse[2]"];
const TIP = ["tip.x", "tip.y", "tip.vx", "tip.vy"];
const FORCE = ["tip.fx", "tip.fy"];

// The hand: a spring with a damper between tip and pointer, and its largest force. With the machines of the scenes, 30 to 80 g at the tip,
// the tip reaches the pointer within 0.2 s and hardly overshoots.
const HAND = { stiffness: 60, damping: 2, most: 15 };

// Force of the hand on the tip.
function pull(hand, [x, y, vx, vy]) {
  if (hand.force) return hand.force;
  const fx = HAND.stiffness * (hand.x - x) - HAND.damping * vx;
  const fy = HAND.stiffness * (hand.y - y) - HAND.damping * vy;
  const share = Math.min(1, HAND.most / Math.hypot(fx, fy));
  return [share * fx, share * fy];
}

export class Run {
  // Starts a machine at a time, ms, with the values of `settings`, replaced by `values`.
  constructor(library, settings, values = {}, start = 0) {
    const given = settings.signals();
    const levels = signals(given);
    this.moves = Object.keys(given).length > 0;
    this.period = repeats(given) ? settings.scene.stopTime : Infinity;
    this.force = [0, 0];
    // The tip force first, then the other variables that the scene changes.
    this.driven = listed([...FORCE, ...Object.keys(given).filter((name) => !FORCE.includes(name))]);
    this.levels = this.driven.map((name) => levels[name] ?? (() => settings.value(name)));
    const driven = Object.fromEntries(this.inputs(start * 1e-3).map((value, i) => [this.driven[i], value]));
    this.machine = new Machine(library, { ...settings.all(), ...driven, ...values }, start);
    this.read();
  }

  // Driven values at a time, s: signals, with the force of the hand added to the scene's tip force.
  inputs(time) {
    const values = this.levels.map((level) => level(time % this.period));
    this.force.forEach((part, i) => (values[i] += part));
    return values;
  }

  // Takes one step of a millisecond, with the hand.
  step(hand) {
    const { machine } = this;
    if (hand || this.pulled || this.moves) {
      this.force = hand ? pull(hand, machine.get(TIP)) : [0, 0];
      this.pulled = Boolean(hand);
      machine.put(this.driven, this.inputs(machine.time));
    }
    machine.step();
  }

  // Position of the tip.
  tip() {
    const [x, y] = this.machine.get(TIP);
    return [x, y];
  }

  // Numbers of singularities passed since the start: direct, and inverse of both legs.
  passes() {
    const [direct, left, right] = this.machine.get(PASSES);
    return { direct, inverse: left + right };
  }

  // Reads all displayed values.
  read() {
    const now = { time: this.machine.time, force: this.force };
    for (const names of [REALS, MODES]) {
      const values = this.machine.get(names);
      names.forEach((name, i) => (now[name] = values[i]));
    }
    this.now = now;
    return now;
  }

  // Start values for a new machine in the present posture.
  pose() {
    const { now } = this;
    const pose = { "init.assembly": now["mode.assembly"] };
    for (const i of [1, 2]) [pose[`init.theta[${i}]`], pose[`init.omega[${i}]`]] = [now[`theta[${i}]`], now[`omega[${i}]`]];
    return pose;
  }

  close() {
    this.machine.close();
  }
}
