// Runs every scene by every method for at most a second with the page's modules and library, and writes all computed variables.
//
//     node bits.mjs SITE FOLDER
//
// FOLDER/SCENE-METHOD.real and .integer contain the values before the first step and after each millisecond, in the order of
// FOLDER/variables.json; FOLDER/SCENE-METHOD.txt contains the unit's sentence if it refuses to continue.

import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [site, folder] = process.argv.slice(2);
const module = (name) => import(pathToFileURL(join(site, name)));
const { Library, Refusal } = await module("unit.js");
const { Settings } = await module("settings.js");
const { Run } = await module("run.js");
const { METHODS } = await module("effects.js");

const description = JSON.parse(readFileSync(join(site, "unit.json")));
const library = await Library.load(readFileSync(join(site, "fivebar.wasm")), description);

const { items } = description.variables["solver.method"];
const methods = Object.keys(items);
if (METHODS.map(({ name }) => name).sort().join() !== [...methods].sort().join()) throw new Error("the page has other methods than the unit");

const computed = Object.entries(description.variables).filter(([, variable]) => ["output", "local"].includes(variable.role) && !variable.alias);
const names = { real: [], integer: [] };
for (const [name, { kind }] of computed) names[{ Real: "real", Integer: "integer", Enumeration: "integer" }[kind]].push(name);
writeFileSync(join(folder, "variables.json"), JSON.stringify(names));

for (const { name: scene, stopTime } of description.scenes) {
  for (const method of methods) {
    const settings = new Settings(description);
    settings.choose(scene);
    const values = { real: [], integer: [] };
    const keep = (machine) => {
      for (const kind in names) values[kind].push(machine.get(names[kind]).slice());
    };
    let said = "";
    try {
      const run = new Run(library, settings, { "solver.method": items[method] });
      keep(run.machine);
      for (let i = 0; i < Math.min(1000, Math.round(1000 * stopTime)); i += 1) {
        run.step(null);
        keep(run.machine);
      }
      run.close();
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      said = error.message;
    }
    const file = join(folder, `${scene}-${method}`);
    for (const kind in values) {
      writeFileSync(`${file}.${kind}`, Buffer.concat(values[kind].map((row) => Buffer.from(row.buffer, row.byteOffset, row.byteLength))));
    }
    writeFileSync(`${file}.txt`, said);
  }
}
