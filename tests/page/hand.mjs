// Checks the page's hand: the tip soon reaches the pointer, does not swing about it, and stays there.
//
//     node hand.mjs SITE

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [site] = process.argv.slice(2);
const module = (name) => import(pathToFileURL(join(site, name)));
const { Library } = await module("unit.js");
const { Settings } = await module("settings.js");
const { Run } = await module("run.js");

const description = JSON.parse(readFileSync(join(site, "unit.json")));
const library = await Library.load(readFileSync(join(site, "fivebar.wasm")), description);

const NEAR = 0.03; // m, the width of a finger
const SOON = 200; // ms
const SCENES = ["fall_90_120", "flat_table", "friction_fall", "spring_payload", "swing"];

for (const scene of SCENES) {
  const settings = new Settings(description);
  settings.choose(scene);
  const run = new Run(library, settings);
  const hand = { x: settings.value("base.distance") / 2 + 0.03, y: 0.22 };
  const off = () => Math.hypot(run.tip()[0] - hand.x, run.tip()[1] - hand.y);
  let last = 0;
  for (let i = 1; i <= 2000; i += 1) {
    run.step(hand);
    if (off() > NEAR) last = i;
  }
  console.log(`${scene}: within ${NEAR} m after ${last} ms`);
  if (!(last <= SOON)) throw new Error(`${scene}: the tip is ${NEAR} m from the pointer after ${last} ms, ${SOON} ms are allowed`);
  run.step(null);
  if (run.force.some((part) => part !== 0)) throw new Error(`${scene}: the hand still pulls when it has let go`);
  run.close();
}
