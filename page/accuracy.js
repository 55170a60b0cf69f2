// Accuracy against time: runs the scene with every method at several tolerances or steps, and compares each run with a run at a tight
// tolerance.

import { METHODS } from "./effects.js";
import { Run } from "./run.js";

const TRIED = {
  "solver.errorTolerance": [1e-4, 1e-6, 1e-8, 1e-10],
  "solver.stepSize": [1e-3, 5e-4, 2e-4],
};
const TIGHT = 1e-13;
const HORIZON = 500; // ms
const LONGEST = 400; // ms of computing for one run
const SLICE = 2; // ms of computing at a time
const ENOUGH = 4; // ms of computing that a clock can resolve
const BATCHES = 5; // largest number

// Works in small slices of time; `done` when every point is measured.
export class Accuracy {
  constructor(library, settings) {
    [this.library, this.settings, this.points, this.done] = [library, settings, [], false];
    this.work = this.measure();
  }

  // Continues for about `budget` milliseconds of real time.
  advance(budget) {
    const end = performance.now() + budget;
    while (!this.done && performance.now() < end) this.done = this.work.next().done;
  }

  *measure() {
    const number = (name) => this.library.variable("solver.method").items[name];
    const tight = { "solver.method": number("automatic"), "solver.errorTolerance": TIGHT };
    const { tips: reference } = yield* this.run(tight);
    if (!reference) return;
    for (const { name, knob } of METHODS) {
      for (const value of TRIED[knob]) {
        const { tips, cost } = yield* this.run({ "solver.method": number(name), [knob]: value });
        if (!tips) continue;
        const off = tips.map(([x, y], i) => Math.hypot(x - reference[i][0], y - reference[i][1]));
        this.points.push({ method: name, value, cost, error: Math.max(...off) });
      }
    }
  }

  // Tips every 10 ms, and microseconds per simulated millisecond; empty if the unit refuses the run or it takes too long.
  *run(values) {
    const tips = [];
    const first = yield* this.time(values, tips);
    if (first === undefined) return {};
    // The browser's clock is coarse, its compiler warms up, and the computer does other work too: take the best of some batches.
    const batch = Math.max(1, Math.ceil(ENOUGH / Math.max(first, 0.1)));
    let [best, total] = [Infinity, 0];
    for (let i = 0; i < BATCHES && total < BATCHES * ENOUGH; i += 1) {
      let spent = 0;
      for (let k = 0; k < batch; k += 1) spent += (yield* this.time(values, [])) ?? LONGEST;
      best = Math.min(best, spent / batch);
      total += spent;
    }
    return { tips, cost: (1e3 * best) / HORIZON };
  }

  // Milliseconds of one run, measured in slices; undefined if the unit refuses the run or it takes too long.
  *time(values, tips) {
    let run;
    try {
      run = new Run(this.library, this.settings, values);
      let [spent, begin] = [0, performance.now()];
      for (let i = 1; i <= HORIZON; i += 1) {
        run.step(null);
        if (i % 10) continue;
        tips.push(run.tip());
        const slice = performance.now() - begin;
        if (slice < SLICE && i < HORIZON) continue;
        spent += slice;
        if (spent > LONGEST) return undefined;
        yield;
        begin = performance.now();
      }
      return spent;
    } catch (error) {
      if (error instanceof WebAssembly.RuntimeError) throw error;
      return undefined;
    } finally {
      run?.close();
    }
  }
}
