// The mechanism on its canvas: reach and singular loci in the background, then trace, links and hand.

import { annuli, box, directLoci, geometry } from "./loci.js";

const TRACE = 1000; // points
const MARKS = 60;
const MARGIN = 26; // px

export class View {
  constructor(canvas) {
    [this.canvas, this.context] = [canvas, canvas.getContext("2d")];
    this.background = document.createElement("canvas");
    this.traces = [];
    this.marks = [];
    this.stale = true;
  }

  // Takes lengths and effects from the settings.
  describe(settings) {
    this.settings = settings;
    this.machine = geometry((name) => settings.value(name));
    this.loci = directLoci(this.machine);
    this.stale = true;
  }

  // Clears trace and marks.
  clear() {
    this.traces = [];
    this.marks = [];
  }

  // Adds a point to the trace of machine 0 or 1.
  trace(which, point) {
    const trace = (this.traces[which] ??= []);
    trace.push(point);
    if (trace.length > TRACE) trace.splice(0, TRACE / 4);
  }

  // Marks a singularity passed at a point.
  mark(kind, point) {
    this.marks.push({ kind, point });
    if (this.marks.length > MARKS) this.marks.shift();
  }

  // Fits the canvas to its size on the screen.
  resize() {
    const { canvas } = this;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width === width && canvas.height === height && this.ratio === ratio) return;
    [canvas.width, canvas.height, this.ratio] = [width, height, ratio];
    this.stale = true;
  }

  fit() {
    const { x, y } = box(this.machine);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    this.scale = Math.min((width - 2 * MARGIN) / (x[1] - x[0]), (height - 2 * MARGIN) / (y[1] - y[0]));
    this.origin = [width / 2 - (this.scale * (x[0] + x[1])) / 2, height / 2 + (this.scale * (y[0] + y[1])) / 2];
  }

  // Converts metres to pixels; `from` converts back.
  to([x, y]) {
    return [this.origin[0] + this.scale * x, this.origin[1] - this.scale * y];
  }

  from([px, py]) {
    return { x: (px - this.origin[0]) / this.scale, y: (this.origin[1] - py) / this.scale };
  }

  colour(name) {
    return this.colours[name];
  }

  restyle() {
    const style = getComputedStyle(document.documentElement);
    const names = ["paper", "reach", "grid", "ink", "muted", "left", "right", "tip", "direct", "inverse", "hand", "ghost", "solid", "accent"];
    this.colours = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    this.stale = true;
  }

  // Draws the state of the machine, and of the second machine if there is one.
  draw(state, other, hand) {
    this.resize();
    if (this.stale) this.paint();
    const { context, canvas, ratio } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.background, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.lineJoin = context.lineCap = "round";
    this.drawTraces();
    this.drawMarks();
    if (other) this.drawLinks(other, true);
    if (state) {
      this.drawLinks(state, false);
      if (hand && !hand.force) this.drawHand(state.tip, hand, state.force);
    }
    canvas.dataset.drawn = state ? "machine" : "empty";
  }

  // Paints the static parts.
  paint() {
    this.fit();
    this.stale = false;
    const { background, canvas, ratio } = this;
    [background.width, background.height] = [canvas.width, canvas.height];
    const context = background.getContext("2d");
    context.fillStyle = this.colour("paper");
    context.fillRect(0, 0, background.width, background.height);
    context.scale(ratio, ratio);
    this.paintReach(context);
    this.paintLoci(context);
    this.paintEffects(context);
    this.paintBase(context);
  }

  paintReach(context) {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const circle = (path, { centre }, radius) => {
      const [x, y] = this.to(centre);
      path.moveTo(x + this.scale * radius, y);
      path.arc(x, y, this.scale * radius, 0, 2 * Math.PI);
      return path;
    };
    const rings = annuli(this.machine);
    context.save();
    for (const ring of rings) context.clip(circle(new Path2D(), ring, ring.outer));
    for (const ring of rings) {
      const outside = new Path2D();
      outside.rect(0, 0, width, height);
      context.clip(circle(outside, ring, ring.inner), "evenodd");
    }
    context.fillStyle = this.colour("reach");
    context.fillRect(0, 0, width, height);
    context.restore();
    // The circles of stretched and folded legs, within the reach of the other leg.
    context.strokeStyle = this.colour("inverse");
    context.lineWidth = 1.5;
    context.setLineDash([2, 5]);
    rings.forEach((ring, i) => {
      const other = rings[1 - i];
      context.save();
      context.clip(circle(new Path2D(), other, other.outer + 1e-3));
      for (const radius of [ring.outer, ring.inner]) if (radius > 0) context.stroke(circle(new Path2D(), ring, radius));
      context.restore();
    });
    context.setLineDash([]);
  }

  paintLoci(context) {
    context.strokeStyle = this.colour("direct");
    context.lineWidth = 1.25;
    context.globalAlpha = 0.8;
    // All in one path, so that coinciding curves are not darker.
    context.beginPath();
    for (const curve of this.loci) curve.forEach((point, i) => (i ? context.lineTo(...this.to(point)) : context.moveTo(...this.to(point))));
    context.stroke();
    context.globalAlpha = 1;
  }

  // Paints floor, end stops and the direction of gravity.
  paintEffects(context) {
    const value = (name) => this.settings.value(name);
    if (value("contact.enabled")) this.paintFloor(context, [value("contact.nx"), value("contact.ny")], value("contact.offset"));
    if (value("stop.enabled")) {
      for (const i of [1, 2]) {
        const length = 0.45 * this.machine.l[i === 1 ? 0 : 3];
        const [x, y] = this.to([i === 1 ? 0 : this.machine.d, 0]);
        const [lower, upper] = [value(`stop.lower[${i}]`), value(`stop.upper[${i}]`)];
        context.strokeStyle = this.colour(i === 1 ? "left" : "right");
        context.lineWidth = 2;
        context.globalAlpha = 0.55;
        context.beginPath();
        if (upper - lower < 2 * Math.PI) context.arc(x, y, this.scale * length * (i === 1 ? 1 : 0.86), -lower, -upper, true);
        for (const angle of [lower, upper]) {
          context.moveTo(x, y);
          context.lineTo(x + this.scale * length * Math.cos(angle), y - this.scale * length * Math.sin(angle));
        }
        context.stroke();
        context.globalAlpha = 1;
      }
    }
    if (value("gravity.enabled") && value("gravity.g") * Math.sin(value("gravity.tilt")) > 0.01) {
      const angle = value("gravity.direction");
      const [x, y] = [this.canvas.clientWidth - 30, 34];
      const [dx, dy] = [18 * Math.cos(angle), -18 * Math.sin(angle)];
      this.arrow(context, [x - dx, y - dy], [x + dx, y + dy], this.colour("muted"));
      context.fillStyle = this.colour("muted");
      context.font = "italic 13px system-ui, sans-serif";
      context.fillText("g", x - 16, y + 4);
    }
  }

  paintFloor(context, normal, offset) {
    const length = Math.hypot(...normal) || 1;
    const [nx, ny] = normal.map((part) => part / length);
    const far = 10;
    const [ax, ay] = [offset * nx, offset * ny];
    const corners = [[ax - far * ny, ay + far * nx], [ax + far * ny, ay - far * nx]];
    const deep = corners.map(([x, y]) => [x - far * nx, y - far * ny]);
    context.beginPath();
    for (const corner of [...corners, ...deep.reverse()]) context.lineTo(...this.to(corner));
    context.closePath();
    context.fillStyle = this.colour("grid");
    context.globalAlpha = 0.45;
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = this.colour("muted");
    context.lineWidth = 2;
    context.beginPath();
    for (const corner of corners) context.lineTo(...this.to(corner));
    context.stroke();
  }

  // Paints both motors on their frame.
  paintBase(context) {
    context.strokeStyle = this.colour("muted");
    context.lineWidth = 1.5;
    for (const x of new Set([0, this.machine.d])) {
      const [px, py] = this.to([x, 0]);
      context.beginPath();
      context.moveTo(px - 11, py + 17);
      context.lineTo(px, py);
      context.lineTo(px + 11, py + 17);
      context.closePath();
      context.fillStyle = this.colour("paper");
      context.fill();
      context.stroke();
      for (let i = -2; i <= 2; i += 1) {
        context.beginPath();
        context.moveTo(px + 5 * i, py + 17);
        context.lineTo(px + 5 * i - 4, py + 22);
        context.stroke();
      }
    }
  }

  drawTraces() {
    const { context } = this;
    this.traces.forEach((trace, which) => {
      context.strokeStyle = this.colour(which ? "ghost" : "tip");
      context.lineWidth = which ? 1.25 : 1.75;
      // Older parts are fainter: a few pieces, each in one colour.
      const pieces = 8;
      for (let piece = 0; piece < pieces; piece += 1) {
        const [from, to] = [piece, piece + 1].map((i) => Math.floor((i * trace.length) / pieces));
        if (to - from < 1) continue;
        context.globalAlpha = 0.12 + (0.75 * (piece + 1)) / pieces;
        context.beginPath();
        for (let i = Math.max(from - 1, 0); i < to; i += 1) context.lineTo(...this.to(trace[i]));
        context.stroke();
      }
      context.globalAlpha = 1;
    });
  }

  // Draws direct singularities as diamonds and inverse singularities as rings.
  drawMarks() {
    const { context } = this;
    for (const { kind, point } of this.marks) {
      const [x, y] = this.to(point);
      context.beginPath();
      if (kind === "direct") {
        for (const [dx, dy] of [[0, -6], [6, 0], [0, 6], [-6, 0]]) context.lineTo(x + dx, y + dy);
        context.closePath();
        context.fillStyle = this.colour("direct");
        context.fill();
      } else {
        context.arc(x, y, 4.5, 0, 2 * Math.PI);
        context.lineWidth = 2;
        context.strokeStyle = this.colour("inverse");
        context.stroke();
      }
    }
  }

  drawLinks({ elbows, tip }, faint) {
    const { context } = this;
    const motors = [[0, 0], [this.machine.d, 0]];
    const width = Math.min(12, Math.max(6, 0.035 * this.scale * Math.max(...this.machine.l)));
    context.globalAlpha = faint ? 0.4 : 1;
    elbows.forEach((elbow, leg) => {
      const colour = this.colour(faint ? "ghost" : leg === 0 ? "left" : "right");
      for (const [from, to, thick] of [[motors[leg], elbow, width], [elbow, tip, 0.72 * width]]) {
        context.beginPath();
        context.moveTo(...this.to(from));
        context.lineTo(...this.to(to));
        [context.strokeStyle, context.lineWidth] = [this.colour("paper"), thick + 3];
        if (!faint) context.stroke();
        [context.strokeStyle, context.lineWidth] = [colour, thick];
        context.stroke();
      }
    });
    const joint = (point, radius, fill) => {
      context.beginPath();
      context.arc(...this.to(point), radius, 0, 2 * Math.PI);
      [context.fillStyle, context.strokeStyle, context.lineWidth] = [fill, this.colour(faint ? "ghost" : "solid"), 2];
      context.fill();
      context.stroke();
    };
    for (const motor of motors) joint(motor, 0.62 * width, this.colour("paper"));
    for (const elbow of elbows) joint(elbow, 0.5 * width, this.colour("paper"));
    const mass = this.settings.value("payload.enabled") ? this.settings.value("payload.mass") : 0;
    joint(tip, 0.7 * width + 22 * Math.sqrt(Math.min(mass, 1)), this.colour(faint ? "ghost" : "tip"));
    context.globalAlpha = 1;
  }

  // Draws the spring of the hand and its force.
  drawHand(tip, hand, force) {
    const { context } = this;
    const [from, to] = [this.to(tip), this.to([hand.x, hand.y])];
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    const length = Math.hypot(dx, dy) || 1;
    context.strokeStyle = context.fillStyle = this.colour("hand");
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(...from);
    for (let i = 1; i < 16; i += 1) {
      const [along, across] = [i / 16, (i % 2 ? 5 : -5) * Math.min(1, length / 60)];
      context.lineTo(from[0] + along * dx - (across * dy) / length, from[1] + along * dy + (across * dx) / length);
    }
    context.lineTo(...to);
    context.stroke();
    context.beginPath();
    context.arc(...to, 7, 0, 2 * Math.PI);
    context.stroke();
    context.font = "600 13px system-ui, sans-serif";
    const text = `${Math.hypot(...force).toFixed(1)} N`;
    const [x, y] = [Math.min(to[0] + 14, this.canvas.clientWidth - 52), Math.max(to[1] - 12, 16)];
    [context.lineWidth, context.strokeStyle] = [4, this.colour("paper")];
    context.strokeText(text, x, y);
    context.fillText(text, x, y);
  }

  arrow(context, from, to, colour) {
    const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
    [context.strokeStyle, context.lineWidth, context.lineCap] = [colour, 2, "round"];
    context.beginPath();
    context.moveTo(...from);
    context.lineTo(...to);
    for (const turn of [2.6, -2.6]) {
      context.moveTo(...to);
      context.lineTo(to[0] + 8 * Math.cos(angle + turn), to[1] + 8 * Math.sin(angle + turn));
    }
    context.stroke();
  }
}
