// Reach and singular loci of a five-bar, in closed form. Points are [x, y] in m; the left motor is the origin.

const TAU = 2 * Math.PI;
const LOCUS_POINTS = 720;

// Distance of the elbows, as a share of the machine's size, below which they count as near each other.
const SHORT = 1e-2;

// Lengths from the values of variables: base distance, then links 1 to 4.
export function geometry(value) {
  return { d: value("base.distance"), l: [1, 2, 3, 4].map((i) => value(`link[${i}].length`)) };
}

// Inner and outer radius of the tip's reach about each motor: leg folded and leg stretched. These circles are the inverse singularities.
export function annuli({ d, l }) {
  return [
    { centre: [0, 0], inner: Math.abs(l[0] - l[1]), outer: l[0] + l[1] },
    { centre: [d, 0], inner: Math.abs(l[3] - l[2]), outer: l[3] + l[2] },
  ];
}

// The smallest box that contains all postures: { x: [from, to], y: [from, to] }.
export function box(machine) {
  const [left, right] = annuli(machine);
  const { d, l } = machine;
  const half = Math.max(l[0], l[3], tallest(left, right, d));
  return {
    x: [Math.min(-l[0], d - l[3], Math.max(-left.outer, d - right.outer)), Math.max(d + l[3], l[0], Math.min(left.outer, d + right.outer))],
    y: [-half, half],
  };
}

// Largest height of the reach: the intersection of the outer circles, or the top of the smaller circle if it is inside the other.
function tallest(left, right, d) {
  const x = d > 0 ? (d * d + left.outer ** 2 - right.outer ** 2) / (2 * d) : 0;
  if (x <= 0 || x >= d) return Math.min(left.outer, right.outer);
  return Math.sqrt(Math.max(left.outer ** 2 - x * x, 0));
}

// Curves of direct singularities (distal links in line), as a list of lists of points. The left elbow moves around its circle; the right
// elbow is the intersection of its circle with a circle about the left elbow, of radius l2 + l3 or |l2 - l3|. If the elbows are near each
// other, the line between them turns instead, because round-off would destroy its direction.
export function directLoci({ d, l }) {
  const curves = [];
  const size = d + l[0] + l[1] + l[2] + l[3];
  for (const coupler of [l[1] + l[2], l[1] - l[2]]) {
    const apart = Math.abs(coupler);
    const short = apart < SHORT * size && Math.abs(apart - d) >= apart / 2;
    for (const side of [1, -1]) {
      curves.push(...pieces((angle) => {
        const [x, y] = [Math.cos(angle), Math.sin(angle)];
        if (short) {
          const left = meeting([0, 0], l[0], [d - coupler * x, -coupler * y], l[3], side);
          return left && [left[0] + l[1] * x, left[1] + l[1] * y];
        }
        const left = [l[0] * x, l[0] * y];
        const right = meeting(left, apart, [d, 0], l[3], side);
        const share = l[1] / coupler;
        return right && [left[0] + share * (right[0] - left[0]), left[1] + share * (right[1] - left[1])];
      }));
    }
  }
  return curves;
}

// Pieces of a curve over an angle. The curve exists only for some angles; each piece extends to its exact ends.
function pieces(point) {
  const curves = [];
  let curve = [];
  for (let i = 0; i <= LOCUS_POINTS; i += 1) {
    const [angle, before] = [i, i - 1].map((count) => (TAU * count) / LOCUS_POINTS);
    const here = point(angle);
    if (i > 0 && Boolean(here) !== curve.length > 0) curve.push(point(end(point, here ? angle : before, here ? before : angle)));
    if (here) curve.push(here);
    else if (curve.length) {
      curves.push(curve);
      curve = [];
    }
  }
  return curve.length ? [...curves, curve] : curves;
}

// The last angle with a point, between an angle with a point and one without.
function end(point, inside, outside) {
  for (let i = 0; i < 40; i += 1) {
    const middle = (inside + outside) / 2;
    if (point(middle)) inside = middle;
    else outside = middle;
  }
  return inside;
}

// One of the intersections of two circles.
function meeting(a, ra, b, rb, side) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const apart = Math.hypot(dx, dy);
  if (apart === 0) return null;
  const along = (apart * apart + ra * ra - rb * rb) / (2 * apart);
  const square = ra * ra - along * along;
  if (square < 0) return null;
  const across = side * Math.sqrt(square);
  return [a[0] + (along * dx - across * dy) / apart, a[1] + (along * dy + across * dx) / apart];
}
