// A machine that runs: signals, the hand that drags, one communication step of a millisecond at a time.

import { Machine } from "./unit.js";
import { signals, repeats } from "./signals.js";

const REALS = [
  "tip.x", "tip.y", "tip.vx", "tip.vy", "elbow[1].x", "elbow[1].y", "elbow[2].x", "elbow[2].y", "theta[1]", "theta[2]", "omega[1]", "omega[2]",
  "energy.kinetic", "energy.potential", "energy.input", "energy.dissipated", "energy.error", "contact.fx", "contact.fy",
];
const MODES = ["mode.assembly", "mode.working"];
const PASSES = ["singular.passes.direct", "singular.passes.inverse[1]", "singular.passes.inverse[2]"];
const TIP = ["tip.x", "tip.y", "tip.vx", "tip.vy"];

// The hand: a spring with a damper between tip and pointer, and the largest force of it.
const HAND = { stiffness: 40, damping: 0.4, most: 15 };

// The force that the hand has on the tip.
export function pull(hand, [x, y, vx, vy]) {
  if (!hand) return [0, 0];
  if (hand.force) return hand.force;
  const fx = HAND.stiffness * (hand.x - x) - HAND.damping * vx;
  const fy = HAND.stiffness * (hand.y - y) - HAND.damping * vy;
  const share = Math.min(1, HAND.most / Math.hypot(fx, fy));
  return [share * fx, share * fy];
}

export class Run {
  // With the values of settings, changed by `values`, from a time in milliseconds.
  constructor(library, settings, values = {}, start = 0) {
    const given = settings.signals();
    this.signals = signals(given);
    this.period = repeats(given) ? settings.scene.stopTime : Infinity;
    this.force = [0, 0];
    this.level = (name) => settings.value(name);
    this.machine = new Machine(library, { ...settings.all(), ...this.inputs(start * 1e-3, [0, 0]), ...values }, start);
    this.read();
  }

  // Signals at a time, s, and the force of the hand on top of that of the scene.
  inputs(time, [fx, fy]) {
    const inputs = {};
    for (const name in this.signals) inputs[name] = this.signals[name](time % this.period);
    inputs["tip.fx"] = (inputs["tip.fx"] ?? this.level("tip.fx")) + fx;
    inputs["tip.fy"] = (inputs["tip.fy"] ?? this.level("tip.fy")) + fy;
    return inputs;
  }

  // One millisecond, with the hand.
  step(hand) {
    const { machine } = this;
    if (hand || this.pulled || this.period !== Infinity || Object.keys(this.signals).length) {
      this.force = pull(hand, machine.get(TIP));
      this.pulled = Boolean(hand);
      machine.set(this.inputs(machine.time, this.force));
    }
    machine.step();
  }

  // Where the tip is.
  tip() {
    const [x, y] = this.machine.get(TIP);
    return [x, y];
  }

  // Singularities passed since the start: direct ones, and inverse ones of both legs.
  passes() {
    const [direct, left, right] = this.machine.get(PASSES);
    return { direct, inverse: left + right };
  }

  // Reads everything that is shown.
  read() {
    const now = { time: this.machine.time, force: this.force };
    for (const names of [REALS, MODES]) {
      const values = this.machine.get(names);
      names.forEach((name, i) => (now[name] = values[i]));
    }
    this.now = now;
    return now;
  }

  // Start values that put a new machine where this one is.
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
