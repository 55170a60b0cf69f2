// Small pictures: curves over time, and accuracy against time.

import { METHODS } from "./effects.js";

const FONT = "11px system-ui, sans-serif";

// Prepares a canvas for a picture: its context, scaled to CSS pixels, and its size.
function sheet(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = FONT;
  context.lineJoin = "round";
  return { context, width, height };
}

// Values over the last seconds, as a queue of samples.
export class History {
  constructor(seconds, count) {
    [this.seconds, this.count, this.samples] = [seconds, count, []];
  }

  // Adds a sample, unless it follows the last one too closely.
  add(time, values) {
    const last = this.samples.at(-1);
    if (last && time < last.time) this.clear();
    if (last && time - last.time < this.seconds / this.count) return;
    this.samples.push({ time, values });
    while (this.samples[0].time < time - this.seconds) this.samples.shift();
  }

  clear() {
    this.samples = [];
  }
}

// Draws curves over time: `curves` has colour, dashes and label of each value; `log` is the smallest and largest power of ten.
export function drawHistory(canvas, history, curves, unit, colours, log) {
  const { context, width, height } = sheet(canvas);
  const { samples, seconds } = history;
  const [left, right, top, bottom] = [48, 82, 6, height - 6];
  const end = Math.max(samples.at(-1)?.time ?? 0, seconds);
  const x = (time) => left + ((time - end + seconds) / seconds) * (width - left - right);
  let [low, high] = log ?? [Infinity, -Infinity];
  if (!log) {
    for (const { values } of samples) for (const value of values) [low, high] = [Math.min(low, value), Math.max(high, value)];
    if (!(high - low > 1e-9)) [low, high] = [low - 0.5, low + 0.5];
  }
  const level = (value) => (log ? Math.min(Math.max(Math.log10(value), low), high) : value);
  const y = (value) => bottom - ((level(value) - low) / (high - low)) * (bottom - top);
  context.strokeStyle = colours.grid;
  context.lineWidth = 1;
  context.textBaseline = "middle";
  const powers = () => Array.from({ length: Math.floor((high - low) / 3) + 1 }, (_, i) => 10 ** (low + 3 * i));
  for (const level of log ? powers() : round(low, high)) {
    line(context, left, y(level), width - right, y(level));
    text(context, quantity(level, unit), left - 6, y(level), colours.muted, "right");
  }
  if (!samples.length) return;
  const ends = [];
  curves.forEach(({ label, colour, dash }, i) => {
    context.strokeStyle = colour;
    context.lineWidth = 1.75;
    context.setLineDash(dash ?? []);
    context.beginPath();
    for (const { time, values } of samples) context.lineTo(x(time), y(values[i]));
    context.stroke();
    ends.push({ label, colour, at: y(samples.at(-1).values[i]) });
  });
  context.setLineDash([]);
  // Labels are at the ends of their curves, without overlap.
  ends.sort((a, b) => a.at - b.at);
  let free = top + 4;
  ends.forEach((label, i) => {
    label.at = Math.min(Math.max(label.at, free), bottom - 13 * (ends.length - 1 - i) - 4);
    free = label.at + 13;
    text(context, label.label, width - right + 6, label.at, label.colour, "left");
  });
}

function text(context, words, x, y, colour, align) {
  [context.fillStyle, context.textAlign, context.textBaseline] = [colour, align, "middle"];
  context.fillText(words, x, y);
}

// Two to four round values in a range: multiples of 1, 2 or 5 times a power of ten.
function round(low, high) {
  const rough = (high - low) / 3;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, i) => (first + i) * step);
}

// A quantity with an SI prefix: 0.2 mJ, 3 nm.
export function quantity(value, unit) {
  const prefixes = [[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"], [1e-12, "p"], [1e-15, "f"]];
  const [size, prefix] = prefixes.find(([size]) => Math.abs(value) >= 0.9995 * size) ?? (value ? prefixes.at(-1) : prefixes[0]);
  return `${Number((value / size).toPrecision(2))} ${prefix}${unit}`.replace("-", "−");
}

// Draws a symbol.
function mark(context, { form, colour }, colours, x, y, size) {
  [context.fillStyle, context.strokeStyle, context.lineWidth] = [colours[colour], colours[colour], 1.75];
  context.beginPath();
  if (form === "disc" || form === "ring") context.arc(x, y, size, 0, 2 * Math.PI);
  const corners = {
    square: [[-1, -1], [1, -1], [1, 1], [-1, 1]],
    triangle: [[0, -1.2], [1.2, 1], [-1.2, 1]],
    diamond: [[0, -1.4], [1.4, 0], [0, 1.4], [-1.4, 0]],
  };
  for (const [dx, dy] of corners[form] ?? []) context.lineTo(x + 0.9 * size * dx, y + 0.9 * size * dy);
  context.closePath();
  if (form === "cross") {
    for (const side of [1, -1]) {
      context.moveTo(x - size, y - side * size);
      context.lineTo(x + size, y + side * size);
    }
  }
  if (form === "ring" || form === "cross") context.stroke();
  else context.fill();
}

// Draws the error of the tip against cost, both logarithmic; the method in use is larger.
export function drawAccuracy(canvas, points, method, colours) {
  const { context, width, height } = sheet(canvas);
  const [left, right, top, bottom] = [44, 8, 8, height - 32];
  const log = (point) => [Math.log10(point.cost), Math.log10(Math.max(point.error, 1e-16))];
  const range = (i, least) => {
    const all = points.map((point) => log(point)[i]);
    const [low, high] = [Math.floor(Math.min(...least, ...all)), Math.ceil(Math.max(...least, ...all))];
    return [low, Math.max(high, low + 1)];
  };
  const [[x0, x1], [y0, y1]] = [range(0, [-1, 1]), range(1, [-10, -3])];
  const x = (power) => left + ((power - x0) / (x1 - x0)) * (width - left - right);
  const y = (power) => bottom - ((power - y0) / (y1 - y0)) * (bottom - top);
  [context.strokeStyle, context.lineWidth] = [colours.grid, 1];
  for (let power = x0; power <= x1; power += 1) {
    line(context, x(power), top, x(power), bottom);
    text(context, `${Number((10 ** power).toPrecision(1))}`, Math.min(x(power), width - 14), bottom + 10, colours.muted, "center");
  }
  for (let power = Math.ceil(y0 / 3) * 3; power <= y1; power += 3) {
    line(context, left, y(power), width - right, y(power));
    text(context, quantity(10 ** power, "m"), left - 5, y(power), colours.muted, "right");
  }
  text(context, "computing time, µs per simulated ms", (left + width - right) / 2, bottom + 25, colours.muted, "center");
  for (const { name, symbol } of METHODS) {
    const own = points.filter((point) => point.method === name);
    const chosen = name === method;
    [context.strokeStyle, context.lineWidth] = [colours[symbol.colour], chosen ? 2 : 1];
    context.globalAlpha = chosen ? 1 : 0.7;
    context.beginPath();
    for (const point of own) context.lineTo(x(log(point)[0]), y(log(point)[1]));
    context.stroke();
    for (const point of own) mark(context, symbol, colours, x(log(point)[0]), y(log(point)[1]), chosen ? 5 : 3);
  }
  context.globalAlpha = 1;
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

// Draws a symbol on its small canvas in the legend.
export function drawSymbol(canvas, symbol, colours) {
  const { context, width, height } = sheet(canvas);
  mark(context, symbol, colours, width / 2, height / 2, 4);
}
