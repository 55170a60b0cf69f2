// Inputs of a scene that change with time. scenes/src/signal.rs defines them; the order of operations here is the same.

// Lead of a step before its knot, s: the sum of step sizes may be slightly below the time of a knot.
const EARLY = 1e-9;

const SHAPES = {
  linear: { way: (u) => u, slope: () => 1 },
  steps: { way: (u) => (u < 1 ? 0 : 1), slope: () => 0 },
  minimumJerk: {
    way: (u) => u * u * u * (10 - 15 * u + 6 * u * u),
    slope: (u) => 30 * u * u * (1 - u) * (1 - u),
  },
};

// Functions of time, by variable.
export function signals(given) {
  const shapeOf = (name) => {
    const [[kind, value]] = Object.entries(given[name]);
    if (kind === "rateOf") return { ...shapeOf(value), rate: true };
    const early = kind === "steps" ? EARLY : 0;
    return { shape: SHAPES[kind], knots: value.map(([time, level]) => [time - early, level]), rate: false };
  };
  return Object.fromEntries(Object.keys(given).map((name) => [name, at(shapeOf(name))]));
}

function at({ shape, knots, rate }) {
  return (time) => {
    let i = knots.length - 2;
    while (i > 0 && knots[i][0] > time) i -= 1;
    const [[from, before], [to, after]] = [knots[i], knots[i + 1]];
    const duration = to - from;
    const change = after - before;
    const u = (time - from) / duration;
    if (!rate) return before + change * shape.way(Math.min(Math.max(u, 0), 1));
    return u >= 0 && u < 1 ? (change / duration) * shape.slope(u) : 0;
  };
}

// Whether all signals end with their first value, so that they can be repeated.
export function repeats(given) {
  const kinds = Object.values(given).map((signal) => Object.entries(signal)[0]);
  return kinds.length > 0 && kinds.every(([kind, value]) => kind === "rateOf" || value[0][1] === value.at(-1)[1]);
}
