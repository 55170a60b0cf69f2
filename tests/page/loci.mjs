// Compares the page's singular loci with the unit: when a singularity is passed, the tip is on a locus of its kind.
//
//     node loci.mjs SITE

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [site] = process.argv.slice(2);
const module = (name) => import(pathToFileURL(join(site, name)));
const { Library } = await module("unit.js");
const { Settings } = await module("settings.js");
const { Run } = await module("run.js");
const { annuli, directLoci, geometry } = await module("loci.js");

const description = JSON.parse(readFileSync(join(site, "unit.json")));
const library = await Library.load(readFileSync(join(site, "fivebar.wasm")), description);

// The plain machine, a machine with a narrow base, and a machine with all links different.
const MACHINES = [
  {},
  { "base.distance": 0.1, "init.theta[1]": 2.2, "init.theta[2]": 0.9 },
  { "base.distance": 0.3, "link[1].length": 0.15, "link[2].length": 0.25, "link[3].length": 0.2, "link[4].length": 0.18 },
];

// Distance of a point from a curve of points.
function distance([x, y], curve) {
  let least = Infinity;
  for (let i = 1; i < curve.length; i += 1) {
    const [[ax, ay], [bx, by]] = [curve[i - 1], curve[i]];
    const [dx, dy] = [bx - ax, by - ay];
    const along = dx || dy ? Math.min(Math.max(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0), 1) : 0;
    least = Math.min(least, Math.hypot(x - ax - along * dx, y - ay - along * dy));
  }
  return least;
}

const count = { direct: 0, inverse: 0 };
for (const values of MACHINES) {
  const settings = new Settings(description);
  settings.set(values);
  const machine = geometry((name) => settings.value(name));
  const loci = directLoci(machine);
  const circles = annuli(machine).flatMap(({ centre, inner, outer }) => [inner, outer].map((radius) => ({ centre, radius })));
  const off = {
    direct: (tip) => Math.min(...loci.map((curve) => distance(tip, curve))),
    inverse: ([x, y]) => Math.min(...circles.map(({ centre, radius }) => Math.abs(Math.hypot(x - centre[0], y - centre[1]) - radius))),
  };
  const run = new Run(library, settings);
  let before = run.passes();
  for (let i = 0; i < 3000; i += 1) {
    const from = run.tip();
    run.step(null);
    const [to, passes] = [run.tip(), run.passes()];
    for (const kind in passes) {
      if (passes[kind] === before[kind]) continue;
      count[kind] += 1;
      // Tolerance: the path of this millisecond, and the error of the chords of a locus.
      const allowed = Math.hypot(to[0] - from[0], to[1] - from[1]) + 1e-4;
      const found = off[kind](to);
      if (!(found <= allowed)) throw new Error(`${kind} at ${i} ms of ${JSON.stringify(values)}: ${found} m off, ${allowed} m allowed`);
    }
    before = passes;
  }
}
if (!(count.direct >= 10 && count.inverse >= 10)) throw new Error(`too few singularities are passed: ${JSON.stringify(count)}`);

// If distal links differ a little, their folded loci differ in proportion from the circles of equal lengths: here by 3 times as much at
// most, and by 1e-5 m for the chords.
for (const more of [5.6e-17, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3, -1e-9, -1e-5]) {
  const [alike, made] = [0, more].map((by) => directLoci({ d: 0.1, l: [0.21, 0.3 + by, 0.3, 0.21] }));
  if (alike.length !== 2 || made.length !== 2) throw new Error(`${made.length} loci instead of ${alike.length} at a difference of ${more} m`);
  for (const point of made.flat()) {
    const found = Math.min(...alike.map((curve) => distance(point, curve)));
    if (!(found <= 3 * Math.abs(more) + 1e-5)) throw new Error(`folded locus at a difference of ${more} m: ${found} m off`);
  }
}
console.log(JSON.stringify(count));
