// The live page: shows machine, twin and forecast from the broker's messages, which docs/pipeline.md describes.

import { Validator } from "./json-schema/validator.js";

const byId = (id) => document.getElementById(id);
const SHOWN = 20;        // time range of the charts, s
const STROKE = 10;       // points in each stroke of the tip's path; a stroke has one opacity
const LEVEL = 5.991;     // squared Mahalanobis radius of the 95 % ellipse
const NIS_BOUND = 5.99;  // 95 % of a chi-square distribution with two degrees of freedom
const STALE = 1000;      // age of the newest estimate, ms, beyond which the page is not live
const ANSWERED = 3000;   // time limit for the answer to a command, ms
const EVERY = 4;         // estimates per point of the charts
const CHARTS = 100;      // time between two drawings of the charts, ms
const SKIPPED = ["meas", "est", "forecast"];  // a slow page gets only the newest message of these kinds; the page reports how many it has handled
const KINDS = [...SKIPPED, "alarm", "learned"];
const WITHIN = 1.96;     // half-width of the 95 % band of a normal distribution, in standard deviations
const PANEL = 500;       // time between two drawings of the learned parameters, ms
const KEPT = 400;        // maximum number of points in the history of the learned parameters; then every second one is removed
const GLOW = 0.1;        // a singularity glows if |sin| of the angle between its links is below this limit

const state = { about: null, est: null, newest: null, sample: null, box: null, forecast: null, learned: [], history: [], trail: [], alarms: [], first: 0, arrived: -Infinity, count: 0, made: 0, rate: 0, delays: [], soonest: Infinity, behind: 0, link: ["connecting", ""], order: null, refused: 0, undrawn: 0 };
let client = null, socket = null, colours = {}, view = null, validators = {}, arrived = false, handled = 0;

// --- messages ---------------------------------------------------------------------------------------------------------

const finite = (object, ...names) => names.every((name) => Number.isFinite(object?.[name]));

/** Checks a message by the schema of the package, because other programs on the broker must not break the page. */
function receive(topic, payload) {
  const [, unit, kind] = topic.split("/");
  arrived = true;
  if (SKIPPED.includes(kind)) handled += 1;
  let message;
  try { message = JSON.parse(new TextDecoder().decode(payload)); } catch { return refuse(`${kind} is not JSON`); }
  const found = validators[kind].validate(message);
  if (!found.valid) {
    const { instanceLocation, error } = found.errors.at(-1);
    return refuse(`${kind}: ${decodeURIComponent(instanceLocation)} ${error}`);
  }
  if (message.tags.unit !== unit) return refuse(`${kind} is of another unit`);
  if (kind === "meas" && finite(message.fields, "measured.theta[1]", "measured.theta[2]")) takeSample(message);
  if (kind === "est") takeEstimate(message);
  if (kind === "forecast") state.forecast = message;
  if (kind === "alarm") takeAlarm(message);
  if (kind === "learned") takeLearned(message);
}

/** Reports an invalid message on the page and ignores it. */
function refuse(sentence) {
  state.refused += 1;
  problem("refused", `${state.refused} ${state.refused === 1 ? "message" : "messages"} refused, the last: ${sentence.slice(0, 200)}`);
}

function problem(id, text) {
  byId(id).textContent = text;
  byId(id).hidden = false;
}

/** Stores a sample; its estimate follows directly. */
function takeSample(message) {
  state.newest = message;
}

/** Adds tip positions, [s, m, m], of estimates that this slow page has skipped. */
function takeTrail(places) {
  state.trail.push(...places);
}

function takeEstimate(message) {
  const fields = message.fields, seconds = message.time / 1e9, before = state.est?.seq ?? message.after;
  // A slow page does not get all estimates, but the rate includes the skipped ones.
  state.made += 1 + Math.max(message.after - before, 0);
  // The delay relative to its minimum, because the clocks of machine and page may differ. After the clock was set back, the minimum starts again.
  const delay = Date.now() - message.time / 1e6;
  state.soonest = message.time < state.est?.time ? delay : Math.min(delay, state.soonest);
  state.behind = delay - state.soonest;
  state.est = message;
  state.sample = state.newest?.seq === message.seq ? state.newest : null;
  state.arrived = performance.now();
  state.first ||= seconds;
  state.count += 1;
  state.delays.push(delay);
  if (state.delays.length > 50) state.delays.shift();
  if (state.count % EVERY === 0) remember(message);
  state.trail.push([seconds, fields["tip.x"], fields["tip.y"]]);
  while (state.trail[0][0] < seconds - state.about.trail || state.trail[0][0] > seconds) state.trail.shift();
}

/** Adds a point to the charts. The estimate is for a moment after its sample and is extrapolated back to the sample. This includes the
 * acceleration, because 3.5 m/s² would look like an error of 2 µm after 1 ms. */
function remember(message) {
  const fields = message.fields, { sample } = state, machine = machinePose(sample), seconds = message.time / 1e9;
  const since = sample ? (message.time - sample.time) / 1e9 : 0;
  const back = ["x", "y"].map((axis) => fields[`tip.${axis}`] - since * ((fields[`tip.v${axis}`] ?? 0) - since / 2 * (fields[`tip.a${axis}`] ?? 0)));
  state.history.push({
    t: seconds,
    error: machine ? Math.hypot(machine.tip[0] - back[0], machine.tip[1] - back[1]) : NaN,
    band: halfWidth([1, 2, 3].map((i) => fields[`estimated.tip.cov[${i}]`])),
    tau: [1, 2].map((i) => fields[`estimated.tau[${i}]`]),
    sigma: [1, 2].map((i) => fields[`estimated.tau.sigma[${i}]`]),
    nis: fields["estimated.nis"],
  });
  while (state.history[0].t < seconds - SHOWN || state.history[0].t > seconds) state.history.shift();
}

function takeAlarm(message) {
  state.alarms.unshift(message);
  state.alarms.length = Math.min(state.alarms.length, 50);
  const raised = state.alarms.filter(isRaised).length;
  if (message.order !== undefined && message.order === state.order?.time) answer(message.sentence ?? "the watch has taken note", message.state === "trouble" ? "bad" : "good");
  byId("alarmCount").textContent = raised ? `${raised} raised` : "none";
  byId("acknowledge").disabled = !["anomaly", "calibrating"].includes(message.state);
  byId("alarms").replaceChildren(...state.alarms.map((alarm) => {
    const item = document.createElement("li");
    const figures = Object.entries({ ...alarm.figures, ...alarm.mean, ...(alarm.lasted ? { lasted: alarm.lasted } : {}) });
    const seconds = state.first ? (alarm.time / 1e9 - state.first).toFixed(2) : "?";
    item.textContent = `${seconds} s · ${alarm.state} · ${alarm.cause}${alarm.named ? ` · ${withProbability(alarm.named, alarm.probability)}` : ""}${alarm.sentence ? ` · ${alarm.sentence}` : ""}${alarm.reason ? ` · ${alarm.reason}` : ""}${figures.length ? " · " : ""}${figures.map(([name, value]) => `${name} ${Number(value).toPrecision(3)}`).join(", ")}`;
    item.className = isRaised(alarm) ? "bad" : alarm.state === "listening" ? "good" : "warn";
    return item;
  }));
}

/** Adds a point to the history of the learned parameters, once per second; if there are too many, every second one is removed. */
function takeLearned(message) {
  const seconds = message.time / 1e9;
  // If the machine's clock goes back, a new history begins.
  if (state.learned.at(-1)?.t > seconds) state.learned = [];
  state.learned.push({ t: seconds, fields: message.fields });
  if (state.learned.length > KEPT) state.learned = state.learned.filter((_, i) => i % 2 === 0 || i === KEPT);
  tellLearned(message.fields);
}

const isRaised = (alarm) => ["anomaly", "trouble"].includes(alarm.state);

/** Shows the answer to a command. */
function answer(text, kind) {
  byId("order").textContent = text;
  byId("order").className = kind;
  if (kind) state.order = null;
}

function order(command) {
  const message = { measurement: "cmd", time: Date.now() * 1000000, seq: Math.floor(Date.now() / 1000), tags: { unit: state.about.unit }, fields: {}, command };
  state.order = { time: message.time, sent: performance.now() };
  answer("sent", "");
  client.publish(`fivebar/${state.about.unit}/cmd`, JSON.stringify(message), { qos: 1 });
}

// --- geometry ---------------------------------------------------------------------------------------------------------

/** Angles of links 1 to 4. */
function twinAngles() {
  const f = state.est.fields;
  return [f["theta[1]"], f["passive.theta[1]"], f["passive.theta[2]"], f["theta[2]"]];
}

/** Positions of elbows and tip from the four link angles. */
function twinPose() {
  const f = state.est.fields, { base, lengths: [l1, , , l4] } = state.about;
  const [p1, d1, d2, p2] = twinAngles();
  const left = [l1 * Math.cos(p1), l1 * Math.sin(p1)], right = [base + l4 * Math.cos(p2), l4 * Math.sin(p2)];
  return { left, right, tip: [f["tip.x"], f["tip.y"]], direct: Math.abs(Math.sin(d2 - d1)), inverse: [Math.abs(Math.sin(d1 - p1)), Math.abs(Math.sin(d2 - p2))] };
}

/** Pose of the machine from its encoder angles and the twin's assembly, with the tip from a tracker if there is one. Null without a sample. */
function machinePose(sample) {
  if (!sample) return null;
  const f = sample.fields, { base, lengths: [l1, l2, l3, l4] } = state.about;
  const [p1, p2] = [f["measured.theta[1]"], f["measured.theta[2]"]];
  const left = [l1 * Math.cos(p1), l1 * Math.sin(p1)], right = [base + l4 * Math.cos(p2), l4 * Math.sin(p2)];
  if (finite(f, "tip.x", "tip.y")) return { left, right, tip: [f["tip.x"], f["tip.y"]] };
  const [dx, dy] = [right[0] - left[0], right[1] - left[1]], d = Math.hypot(dx, dy);
  if (d < 1e-9) return null;
  const along = (d * d + l2 * l2 - l3 * l3) / (2 * d), square = l2 * l2 - along * along;
  if (square < 0) return null;
  const side = state.est?.fields["mode.assembly"] === 2 ? -1 : 1, height = side * Math.sqrt(square);
  return { left, right, tip: [left[0] + (along * dx - height * dy) / d, left[1] + (along * dy + height * dx) / d] };
}

/** Major half-axis of the 95 % ellipse, m, for a covariance xx, xy, yy. */
function halfWidth([xx, xy, yy]) {
  return Math.sqrt(LEVEL * Math.max((xx + yy) / 2 + Math.hypot((xx - yy) / 2, xy), 0));
}

// --- the drawing ------------------------------------------------------------------------------------------------------

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["card", "line", "grid", "reach", "ink", "soft", "left", "right", "tip", "direct", "inverse", "bad", "accent"]) colours[name] = style.getPropertyValue("--" + name).trim();
}

/** Scales a canvas to the resolution of the screen; its pen works in CSS pixels. */
function sharp(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas, ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.lineCap = pen.lineJoin = "round";
  return { pen, width, height };
}

function drawStage() {
  const { pen, width, height } = sharp(byId("canvas")), { base } = state.about;
  look(width, height);
  const { scale } = view;
  const at = ([x, y]) => [view.x + scale * x, view.y - scale * y];
  const stroke = (points, colour, thick, alpha = 1, dash = []) => {
    pen.globalAlpha = alpha; pen.strokeStyle = colour; pen.lineWidth = thick; pen.setLineDash(dash); pen.beginPath();
    points.forEach((p, i) => (i ? pen.lineTo(...at(p)) : pen.moveTo(...at(p))));
    pen.stroke(); pen.setLineDash([]); pen.globalAlpha = 1;
  };
  const dot = (p, radius, fill, edge) => {
    pen.beginPath(); pen.arc(...at(p), radius, 0, 2 * Math.PI); pen.fillStyle = fill; pen.fill();
    if (edge) { pen.strokeStyle = edge; pen.lineWidth = 2; pen.stroke(); }
  };

  drawGround(pen, width, height, at, stroke);
  if (!state.est) return;
  // The machine is drawn at the sample of the estimate; a newer sample would show its motion since then, not the twin's error.
  const live = age() < STALE, twin = twinPose(), machine = machinePose(state.sample);
  const size = Math.min(Math.max(scale * 0.02, 5), 9);
  pen.globalAlpha = 1;

  if (live) drawForecast(pen, at, stroke, twin);
  for (let i = 0; i < state.trail.length - 1; i += STROKE) {
    stroke(state.trail.slice(i, i + STROKE + 1).map(([, x, y]) => [x, y]), colours.tip, 2.2, 0.9 * (Math.min(i + STROKE, state.trail.length) / state.trail.length) ** 1.5);
  }
  // A direct singularity glows in dots, an inverse one in a band, because not everybody can distinguish the colours.
  const glow = (points, measure, colour, beads = []) => { if (measure < GLOW) stroke(points, colour, size * 3.2, 0.75 * (1 - measure / GLOW), beads); };
  glow([[0, 0], twin.left, twin.tip], twin.inverse[0], colours.inverse);
  glow([[base, 0], twin.right, twin.tip], twin.inverse[1], colours.inverse);
  glow([twin.left, twin.tip, twin.right], twin.direct, colours.direct, [1, size * 4.5]);
  const strength = live ? 1 : 0.3;
  stroke([[0, 0], twin.left], colours.left, size, strength);
  stroke([[base, 0], twin.right], colours.right, size, strength);
  stroke([twin.left, twin.tip], colours.left, size * 0.62, strength);
  stroke([twin.right, twin.tip], colours.right, size * 0.62, strength);
  // A light core distinguishes the right leg.
  stroke([[base, 0], twin.right, twin.tip], colours.card, size * 0.28, strength);
  // The machine is drawn over the twin: if both agree, its line is inside the twin's line.
  if (machine) stroke([[0, 0], machine.left, machine.tip, machine.right, [base, 0]], colours.card, 2, 0.95, [6, 5]);
  if (machine) stroke([[0, 0], machine.left, machine.tip, machine.right, [base, 0]], colours.ink, 1.2, 0.8, [6, 5]);
  for (const motor of [[0, 0], [base, 0]]) { dot(motor, size * 1.15, colours.ink); dot(motor, size * 0.45, colours.card); }
  dot(twin.left, size * 0.7, colours.card, colours.left);
  dot(twin.right, size * 0.7, colours.card, colours.right);
  dot(twin.tip, size * 0.85, colours.tip, colours.card);
  if (!live) {
    pen.fillStyle = colours.bad; pen.font = "600 15px system-ui, sans-serif"; pen.textAlign = "center";
    pen.fillText("no live data", width / 2, 26); pen.textAlign = "left";
  }
}

/** The visible part of the plane: everything so far with a margin, so that the picture hardly moves. */
function look(width, height) {
  const { base, lengths } = state.about, reach = Math.max(lengths[0] + lengths[1], lengths[2] + lengths[3]);
  state.box ??= { x0: 0, x1: base, y0: 0, y1: 0.5 * reach };
  const box = state.box;
  const path = state.forecast?.path, points = state.est ? Object.values(twinPose()).filter((p) => Array.isArray(p) && p.length === 2).slice(0, 3) : [];
  path?.["tip.x"].forEach((x, i) => points.push([x, path["tip.y"][i]]));
  for (const [x, y] of points) if (Math.hypot(x, y) < 3 * reach + base) Object.assign(box, { x0: Math.min(box.x0, x), x1: Math.max(box.x1, x), y0: Math.min(box.y0, y), y1: Math.max(box.y1, y) });
  const margin = 48, scale = Math.min((width - 2 * margin) / (box.x1 - box.x0), (height - 2 * margin) / (box.y1 - box.y0));
  view = { scale, x: width / 2 - scale * (box.x0 + box.x1) / 2, y: height / 2 + scale * (box.y0 + box.y1) / 2 };
}

function drawGround(pen, width, height, at, stroke) {
  const { base, lengths, plane, stops, outline } = state.about, step = 0.1;
  drawReach(pen, outline, state.est && workingMode(twinAngles()), at, view.scale, width, height, colours);
  pen.strokeStyle = colours.grid; pen.lineWidth = 1; pen.beginPath();
  for (let i = Math.ceil(-view.x / view.scale / step); at([i * step, 0])[0] < width; i++) { pen.moveTo(at([i * step, 0])[0], 0); pen.lineTo(at([i * step, 0])[0], height); }
  for (let i = Math.ceil((view.y - height) / view.scale / step); at([0, i * step])[1] > 0; i++) { pen.moveTo(0, at([0, i * step])[1]); pen.lineTo(width, at([0, i * step])[1]); }
  pen.stroke();
  pen.strokeStyle = pen.fillStyle = colours.soft; pen.beginPath();
  const y = height - 16;
  pen.moveTo(16, y - 4); pen.lineTo(16, y); pen.lineTo(16 + step * view.scale, y); pen.lineTo(16 + step * view.scale, y - 4); pen.stroke();
  pen.font = "12px system-ui, sans-serif"; pen.fillText(`${step} m`, 22 + step * view.scale, y);
  pen.setLineDash([2, 5]); pen.strokeStyle = colours.line;
  for (const [x, length] of [[0, lengths[0]], [base, lengths[3]]]) { pen.beginPath(); pen.arc(...at([x, 0]), length * view.scale, 0, 2 * Math.PI); pen.stroke(); }
  pen.setLineDash([]);
  pen.fillStyle = colours.line; pen.globalAlpha = 0.6;
  if (plane) {
    const [nx, ny] = plane.normal, far = 10, deep = 0.12 * lengths[0];
    const corner = (along, depth) => at([nx * (plane.offset - depth) - ny * along, ny * (plane.offset - depth) + nx * along]);
    pen.beginPath();
    for (const p of [corner(-far, 0), corner(far, 0), corner(far, deep), corner(-far, deep)]) pen.lineTo(...p);
    pen.fill();
  }
  for (const [i, [lower, upper]] of (stops ?? []).entries()) {
    if (upper - lower >= 2 * Math.PI) continue;
    pen.beginPath(); pen.moveTo(...at([i * base, 0])); pen.arc(...at([i * base, 0]), 0.3 * lengths[3 * i] * view.scale, -upper, -lower, true); pen.fill();
  }
  pen.globalAlpha = 1;
  stroke([[0, 0], [base, 0]], colours.line, 2);
}

/** Draws the forecast path of the tip with its 95 % circles. */
function drawForecast(pen, at, stroke, twin) {
  const forecast = state.forecast;
  if (!forecast || Math.abs(state.est.time - forecast.time) > 0.3e9) return;
  const { path } = forecast, points = path["tip.x"].map((x, i) => [x, path["tip.y"][i]]);
  points.forEach((p, i) => {
    const radius = path["estimated.forecast.radius95"]?.[i];
    if (!Number.isFinite(radius)) return;
    pen.beginPath(); pen.arc(...at(p), Math.max(radius * view.scale, 1.5), 0, 2 * Math.PI);
    pen.fillStyle = colours.tip; pen.globalAlpha = 0.13; pen.fill();
    pen.strokeStyle = colours.tip; pen.globalAlpha = 0.45; pen.lineWidth = 1; pen.stroke(); pen.globalAlpha = 1;
  });
  stroke([twin.tip, ...points], colours.tip, 1.6, 0.8, [3, 4]);
}

// --- the charts -------------------------------------------------------------------------------------------------------

/** Draws lines and bands over the last seconds; it uses every nth sample, about one per pixel. */
function chart(id, { lines, bands = [], bound, unit, floor, log = false }) {
  const { pen, width, height } = sharp(byId(id)), history = state.history, right = width - 2, left = 48, bottom = height - 16, top = 6;
  if (history.length < 2) return;
  const end = history[history.length - 1].t, stride = Math.max(1, Math.floor(history.length / (right - left)));
  const kept = history.filter((_, i) => i % stride === 0);
  const usable = (v) => Number.isFinite(v) && Math.abs(v) < 1e20;
  let high = floor, low = lines.some((line) => kept.some((h) => line.of(h) < 0)) ? -floor : 0;
  for (const h of kept) for (const line of lines) { const v = line.of(h); if (usable(v)) { high = Math.max(high, v); low = Math.min(low, v); } }
  if (low < 0) { high = Math.max(high, -low); low = -high; }
  if (log) low = 0.01;
  if (bound) high = Math.max(high, bound * 1.15);
  const scale = log ? (v) => (Math.log(Math.max(v, low)) - Math.log(low)) / (Math.log(high * 1.2) - Math.log(low)) : (v) => (v - low) / ((high - low) * 1.05);
  const x = (t) => left + (right - left) * (1 - (end - t) / SHOWN), y = (v) => bottom - (bottom - top) * Math.min(Math.max(scale(v), -0.02), 1.03);
  pen.font = "11px system-ui, sans-serif"; pen.fillStyle = colours.soft; pen.strokeStyle = colours.grid; pen.lineWidth = 1; pen.textAlign = "right";
  for (const v of log ? [0.01, 0.1, 1, 10, 100].filter((v) => v <= high * 1.2) : [low, (low + high) / 2, high]) {
    pen.beginPath(); pen.moveTo(left, y(v)); pen.lineTo(right, y(v)); pen.stroke();
    pen.fillText(`${+v.toPrecision(2)}`, left - 6, y(v) + 4);
  }
  pen.textAlign = "left"; pen.fillText(`−${SHOWN} s`, left, height - 3); pen.textAlign = "right"; pen.fillText(unit, right, height - 3); pen.textAlign = "left";
  pen.save(); pen.beginPath(); pen.rect(left, 0, right - left, bottom + 2); pen.clip();
  for (const alarm of state.alarms) if (isRaised(alarm)) { pen.fillStyle = colours.bad; pen.globalAlpha = 0.5; pen.fillRect(x(alarm.time / 1e9) - 1, top, 2, bottom - top); pen.globalAlpha = 1; }
  for (const { of, colour } of bands) {
    const edges = kept.map((h) => [x(h.t), of(h)]).filter(([, [a, b]]) => usable(a) && usable(b));
    if (!edges.length) continue;
    pen.fillStyle = colour; pen.globalAlpha = 0.16; pen.beginPath();
    edges.forEach(([px, [, b]]) => pen.lineTo(px, y(b)));
    edges.reverse().forEach(([px, [a]]) => pen.lineTo(px, y(a)));
    pen.fill(); pen.globalAlpha = 1;
  }
  if (bound) { pen.strokeStyle = colours.soft; pen.setLineDash([4, 4]); pen.beginPath(); pen.moveTo(left, y(bound)); pen.lineTo(right, y(bound)); pen.stroke(); pen.setLineDash([]); }
  for (const { of, colour } of lines) {
    pen.strokeStyle = colour; pen.lineWidth = 1.4; pen.beginPath();
    let open = false;
    for (const h of kept) { const v = of(h); if (!usable(v)) { open = false; continue; } if (open) pen.lineTo(x(h.t), y(v)); else pen.moveTo(x(h.t), y(v)); open = true; }
    pen.stroke();
  }
  pen.restore();
}

/** Draws the history of each learned parameter with its band, over the band before the first sample. */
function drawLearned() {
  const course = state.learned;
  if (!course.length) return;
  const begin = course[0].t, span = Math.max(course.at(-1).t - begin, 10);
  for (const { name, sigma, start, width, canvas } of state.about.learned) {
    const { pen, width: right, height } = sharp(canvas), points = course.map(({ t, fields }) => [t, fields[name], WITHIN * fields[sigma]]).filter((p) => p.every(Number.isFinite));
    const prior = WITHIN * width, seen = points.map((p) => p[1]), low = Math.min(start - prior, ...seen), high = Math.max(start + prior, ...seen), room = 0.08 * (high - low);
    const x = (t) => (right * (t - begin)) / span, y = (v) => height * (1 - (v - low + room) / (high - low + 2 * room));
    pen.fillStyle = colours.soft; pen.globalAlpha = 0.16; pen.fillRect(0, y(start + prior), right, y(start - prior) - y(start + prior)); pen.globalAlpha = 1;
    pen.strokeStyle = colours.soft; pen.lineWidth = 1; pen.setLineDash([3, 4]); pen.beginPath(); pen.moveTo(0, y(start)); pen.lineTo(right, y(start)); pen.stroke(); pen.setLineDash([]);
    pen.fillStyle = colours.accent; pen.globalAlpha = 0.4; pen.beginPath();
    for (const [t, value, half] of points) pen.lineTo(x(t), y(value + half));
    for (const [t, value, half] of [...points].reverse()) pen.lineTo(x(t), y(value - half));
    pen.fill(); pen.globalAlpha = 1;
    pen.strokeStyle = colours.accent; pen.lineWidth = 1.6; pen.beginPath();
    for (const [t, value] of points) pen.lineTo(x(t), y(value));
    pen.stroke();
  }
}

function drawCharts() {
  chart("error", { unit: "mm", floor: 0.01, lines: [{ of: (h) => 1e3 * h.error, colour: colours.tip }], bands: [{ of: (h) => [0, 1e3 * h.band], colour: colours.tip }] });
  const torque = (i, colour) => ({ line: { of: (h) => 1e3 * h.tau[i], colour }, band: { of: (h) => [-2, 2].map((k) => 1e3 * (h.tau[i] + k * h.sigma[i])), colour } });
  const both = [torque(0, colours.left), torque(1, colours.right)];
  chart("torque", { unit: "mN·m", floor: 1, lines: both.map((b) => b.line), bands: both.map((b) => b.band) });
  chart("nis", { unit: "", floor: 10, log: true, bound: NIS_BOUND, lines: [{ of: (h) => h.nis, colour: colours.accent }] });
}

// --- the numbers ------------------------------------------------------------------------------------------------------

const ROWS = [
  ["age", "Age of the newest"], ["rate", "Estimates"], ["delay", "Sample to page"], ["tip", "Tip"], ["error", "Machine − twin"], ["ahead", "Forecast, 95 %"],
  ["singular", "Next singularity"], ["stop", "Next end stop"],
];
const cells = Object.fromEntries(ROWS.map(([key, label]) => {
  const term = byId("values").appendChild(document.createElement("dt"));
  term.textContent = label;
  const cell = byId("values").appendChild(document.createElement("dd"));
  cell.id = `value-${key}`;
  cell.textContent = "–";
  return [key, cell];
}));

function show(key, text, kind = "") {
  if (cells[key].textContent !== text) cells[key].textContent = text;
  if (cells[key].className !== kind) cells[key].className = kind;
}

const median = (values) => (values.length ? [...values].sort((a, b) => a - b)[values.length >> 1] : NaN);

/** Time since the arrival of the newest estimate, ms. */
const silence = () => performance.now() - state.arrived;

/** Age of the newest estimate, ms: time since its arrival plus its additional delay. */
const age = () => silence() + state.behind;

/** Shows whether the page is live, and returns it; this depends only on the connection and the age of the newest estimate. */
function tellLife() {
  const [text, kind] = state.link, seconds = (age() / 1000).toFixed(1), connected = kind === "good", live = connected && age() < STALE, late = silence() < STALE;
  const none = state.est ? (late ? `${seconds} s behind` : `no estimate for ${(silence() / 1000).toFixed(1)} s`) : "no estimate yet";
  byId("connection").textContent = connected ? (live ? text : none) : text;
  byId("connection").className = `pill ${live ? "good" : connected && !state.est ? "warn" : kind === "good" ? "bad" : kind}`;
  document.body.classList.toggle("past", state.est !== null && !live);
  byId("restart").disabled = !connected;
  show("age", state.est ? (age() < STALE ? "below 1 s" : `${seconds} s`) : "–", live || !state.est ? "" : "bad");
  if (state.order && performance.now() - state.order.sent > ANSWERED) answer("no answer: is the twin running, and may you send commands?", "bad");
  if (!live && state.est) {
    const why = late ? `What you see is ${seconds} s old` : `The twin has said nothing for ${(silence() / 1000).toFixed(1)} s`;
    byId("status").textContent = connected ? why : "No messages arrive: the picture is not live";
    byId("status").className = "bad";
  }
  return live;
}

const withProbability = (name, probability) => `${name} (${(100 * probability).toFixed(0)} %)`;

/** The cause named by an estimate, in the words of the alarms; "" without one. */
function causeOf(fields, causes) {
  const number = fields["estimated.cause"] ?? 0;
  return number === 0 ? "" : withProbability(causes[number] ?? `cause ${number}`, fields["estimated.cause.probability"]);
}

function tell() {
  const { est, forecast, about } = state, live = tellLife();
  if (silence() >= STALE) return;
  if (!est || !state.history.length) return;
  const f = est.fields, last = state.history[state.history.length - 1], seconds = est.time / 1e9;
  byId("clock").textContent = (seconds - state.first).toFixed(1);
  const name = about.statuses[f["estimated.status"]] ?? `status ${f["estimated.status"]}`;
  const alarm = f["estimated.alarm"] === 1, cause = causeOf(f, about.causes);
  if (live) {
    byId("status").textContent = [name, alarm ? "something acts that the twin does not know" : "", cause].filter(Boolean).join(" · ");
    byId("status").className = alarm ? "bad" : f["estimated.status"] === 2 && !cause ? "good" : "warn";
  }
  show("rate", `${state.rate.toFixed(0)} /s`);
  show("delay", `${median(state.delays).toFixed(0)} ms`);
  show("tip", `${(1e3 * f["tip.x"]).toFixed(1)}, ${(1e3 * f["tip.y"]).toFixed(1)} mm`);
  show("error", Number.isFinite(last.error) ? `${(1e3 * last.error).toFixed(3)} mm` : "–");
  byId("errorValue").textContent = `band ± ${(1e3 * last.band).toFixed(3)} mm`;
  byId("torqueValue").textContent = last.tau.map((t) => (1e3 * t).toFixed(1)).join(", ") + " mN·m";
  byId("nisValue").textContent = Number.isFinite(last.nis) ? last.nis.toFixed(2) : "";
  if (!forecast) return;
  show("ahead", Number.isFinite(forecast.half_width) ? `± ${(1e3 * forecast.half_width).toFixed(1)} mm in ${forecast.ahead} s` : "–");
  const { singular, stop } = forecast, share = (p) => `${(100 * p).toFixed(0)} %`;
  const when = (t) => `in ${Math.max((t - est.time) / 1e9, 0).toFixed(2)} s`;
  show("singular", singular.time ? `${singular.type}, ${when(singular.time)}, ${share(singular.probability)}` : `none seen, ${share(singular.probability)}`, singular.time ? "warn" : "");
  show("stop", !about.stops ? "no stops" : stop.time ? `${when(stop.time)}, ${share(stop.probability)}` : `none seen, ${share(stop.probability)}`, stop.time ? "warn" : "");
}

/** Readable unit and factor for a value in an SI unit: 0.0177 kg is 17.7 g. */
function scaled(unit, amount) {
  if (unit === "1") return [1, ""];
  const [base, factor] = unit === "kg" ? ["g", 1e3] : [unit, 1];
  const [prefix, size] = [["", 1], ["m", 1e-3], ["µ", 1e-6], ["n", 1e-9]].find(([, size]) => amount * factor >= size) ?? ["n", 1e-9];
  return [factor / size, ` ${prefix}${base.replaceAll(".", "·")}`];
}

/** Text of a value and the half-width of its band, with two digits of the half-width. */
function banded(value, half, { unit, start, width }) {
  const [factor, shown] = scaled(unit, Math.max(Math.abs(start), width)), digits = Math.min(Math.max(1 - Math.floor(Math.log10(factor * half)), 0), 6);
  return `${(factor * value).toFixed(digits)} ± ${(factor * half).toFixed(digits)}${shown}`;
}

/** Creates an element for each learned parameter. */
function placeLearned() {
  byId("learned").hidden = !state.about.learned.length;
  for (const parameter of state.about.learned) {
    const item = byId("parameters").appendChild(document.createElement("li"));
    for (const [part, tag] of [["label", "span"], ["value", "b"], ["canvas", "canvas"], ["before", "small"]]) parameter[part === "label" ? "heading" : part] = item.appendChild(document.createElement(tag));
    parameter.heading.textContent = parameter.label;
    parameter.value.textContent = "–";
    parameter.before.textContent = `before: ${banded(parameter.start, WITHIN * parameter.width, parameter)}`;
    parameter.canvas.setAttribute("role", "img");
    parameter.canvas.setAttribute("aria-label", `${parameter.label}: nothing is learned yet`);
  }
}

function tellLearned(fields) {
  const known = state.about.learned.filter(({ name, sigma }) => finite(fields, name, sigma));
  for (const parameter of known) {
    const { name, sigma, label, width, value, canvas } = parameter, text = banded(fields[name], WITHIN * fields[sigma], parameter);
    value.textContent = text;
    canvas.setAttribute("aria-label", `${label}: ${text}, a band ${(100 * fields[sigma] / width).toPrecision(2)} % as wide as before the first sample`);
  }
}

function connection(text, kind) {
  state.link = [text, kind];
  tellLife();
}

// --- the beginning ----------------------------------------------------------------------------------------------------

function connect(user, password) {
  client?.end(true);
  client = mqtt.connect(`ws://${location.host}/mqtt`, { username: user, password, reconnectPeriod: 500, connectTimeout: 5000, clean: true, timerVariant: "native", createWebsocket: opened });
  client.on("connect", () => {
    connection("live", "good");
    client.subscribe(KINDS.map((kind) => `fivebar/${state.about.unit}/${kind}`), { qos: 0 });
  });
  client.on("close", () => connection("no broker, trying again", "bad"));
  client.on("error", (error) => connection(`broker: ${error.message}`, "bad"));
  client.on("message", receive);
}

/** Opens the WebSocket to the broker. The page reports on it how many messages it has drawn, and gets only the newest then: a slow page skips messages instead of falling behind. */
function opened(address, protocols) {
  handled = 0;
  socket = new WebSocket(address, protocols);
  // Text frames are for this page and not MQTT packets.
  socket.addEventListener("message", (event) => {
    if (typeof event.data !== "string") return;
    event.stopImmediatePropagation();
    takeTrail(JSON.parse(event.data));
  });
  return socket;
}

/** Runs a part of a frame. A failure is shown on the page and does not stop the other parts; the next frame tries again. */
function attempt(part) {
  try {
    part();
  } catch (error) {
    state.undrawn += 1;
    problem("undrawn", `${state.undrawn} ${state.undrawn === 1 ? "drawing" : "drawings"} failed, the last: ${error}`);
  }
}

let drawn = 0, drawnPanel = 0;
function frame(moment) {
  attempt(drawStage);
  if (moment - drawn >= CHARTS) { drawn = moment; attempt(tell); attempt(drawCharts); }
  if (moment - drawnPanel >= PANEL) { drawnPanel = moment; attempt(drawLearned); }
  if (arrived && socket?.readyState === WebSocket.OPEN) { arrived = false; socket.send(`drawn ${handled}`); }
  requestAnimationFrame(frame);
}

function legend(label, colour, kind = "") {
  const item = byId("legend").appendChild(document.createElement("li"));
  item.textContent = label;
  item.className = kind;
  item.style.setProperty("--colour", `var(${colour})`);
}

async function begin() {
  const [about, schema] = await Promise.all(["/about.json", "/messages.schema.json"].map(async (path) => (await fetch(path)).json()));
  state.about = about;
  for (const kind of KINDS) validators[kind] = new Validator({ definitions: schema.definitions, allOf: [{ $ref: `#/definitions/${kind}` }] }, "7");
  const { unit, scene, description, horizon } = state.about;
  document.title = `${unit} · five-bar twin`;
  byId("name").textContent = `${unit}: machine and twin`;
  byId("description").textContent = `${scene}: ${description}`;
  byId("note").textContent = `Topics fivebar/${unit}/…; circles and bands hold 95 %; the forecast looks ${horizon} s ahead along the plan of the drives.`;
  legend("Twin, left leg", "--left");
  legend("Twin, right leg", "--right", "core");
  legend("Machine", "--ink", "dash");
  legend("Tip, its path", "--tip");
  legend("Forecast, 95 %", "--tip", "area");
  legend("Direct", "--direct", "beads");
  legend("Inverse", "--inverse");
  legend("Reach", "--line", "area");
  placeLearned();
  readColours();
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readColours);
  byId("acknowledge").addEventListener("click", () => order("acknowledge"));
  byId("restart").addEventListener("click", () => order("restart"));
  setInterval(() => {
    const { est, made, counted } = state, seconds = est && counted ? (est.time - counted) / 1e9 : 0;
    if (seconds > 0) state.rate = made / seconds;
    Object.assign(state, { made: 0, counted: est?.time });
  }, 1000);
  byId("form").addEventListener("submit", (event) => {
    event.preventDefault();
    byId("login").hidden = true;
    connect(byId("user").value, byId("password").value);
  });
  if (state.about.login) byId("login").hidden = false; else connect();
  requestAnimationFrame(frame);
}

begin();
