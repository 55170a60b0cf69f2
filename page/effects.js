// Effects that can be switched on the page, with their parameters. A parameter sets several variables to one value.

const both = (name) => [1, 2].map((i) => `${name}[${i}]`);
const joints = (name) => [1, 2, 3, 4, 5].map((i) => `${name}[${i}]`);
const DEGREES = 180 / Math.PI;

// `scale` converts the unit of the variable to the displayed unit; `log` makes a slider logarithmic.
export const EFFECTS = [
  {
    name: "gravity", label: "Gravity",
    parameters: [
      { names: ["gravity.g"], label: "g", min: 0, max: 25, unit: "m/s²" },
      { names: ["gravity.tilt"], label: "Tilt of the plane", min: 0, max: Math.PI / 2, scale: DEGREES, unit: "°" },
    ],
  },
  { name: "payload", label: "Payload", parameters: [{ names: ["payload.mass"], label: "Mass", min: 0, max: 0.5, scale: 1e3, unit: "g" }] },
  {
    name: "viscous", label: "Viscous friction",
    parameters: [{ names: joints("viscous.b"), label: "Each joint", min: 1e-5, max: 1e-1, log: true, scale: 1e3, unit: "mN·m·s" }],
  },
  {
    name: "friction", label: "Dry friction",
    parameters: [
      {
        names: joints("friction.coulomb"), label: "Each joint", min: 1e-4, max: 1e-1, log: true, scale: 1e3, unit: "mN·m",
        // The breakaway torque of a joint must be at least its Coulomb torque.
        also: (value) => Object.fromEntries(joints("friction.breakaway").map((name) => [name, 1.2 * value])),
      },
      { name: "friction.law", label: "At rest", options: ["smooth", "stick"] },
    ],
  },
  {
    name: "spring", label: "Springs on the motors",
    parameters: [{ names: both("spring.k"), label: "Stiffness", min: 1e-3, max: 2, log: true, unit: "N·m/rad" }],
  },
  {
    name: "stop", label: "End stops",
    parameters: [
      { names: both("stop.lower"), label: "Lower", min: -Math.PI, max: 1.5, scale: DEGREES, unit: "°" },
      { names: both("stop.upper"), label: "Upper", min: 1.6, max: 2 * Math.PI, scale: DEGREES, unit: "°" },
    ],
  },
  {
    name: "contact", label: "Floor", first: { "contact.offset": -0.2 },
    parameters: [
      { names: ["contact.offset"], label: "Height", min: -0.4, max: 0.4, scale: 1e3, unit: "mm" },
      { names: ["contact.mu"], label: "Friction", min: 0, max: 1, unit: "" },
    ],
  },
  {
    name: "servo", label: "Servos", hold: true,
    parameters: [
      { names: ["servo.theta[1]"], label: "Left target", min: -Math.PI, max: 2 * Math.PI, scale: DEGREES, unit: "°" },
      { names: ["servo.theta[2]"], label: "Right target", min: -Math.PI, max: 2 * Math.PI, scale: DEGREES, unit: "°" },
    ],
  },
  {
    name: "rotor", label: "Rotors and gears",
    parameters: [{ names: both("rotor.gearRatio"), label: "Gear ratio", min: 1, max: 50, unit: "" }],
  },
];

// Lengths of the machine.
export const GEOMETRY = [
  { names: ["base.distance"], label: "Between the motors", min: 0, max: 0.6, scale: 1e3, unit: "mm" },
  { names: ["link[1].length", "link[4].length"], label: "Proximal links", min: 0.05, max: 0.4, scale: 1e3, unit: "mm" },
  { names: ["link[2].length", "link[3].length"], label: "Distal links", min: 0.05, max: 0.4, scale: 1e3, unit: "mm" },
];

// Methods in the order of the page, each with the setting that the user chooses, a tolerance or a step, and with its symbol.
export const METHODS = [
  { name: "automatic", label: "Automatic", knob: "solver.errorTolerance", symbol: { form: "disc", colour: "left" } },
  { name: "dop853", label: "DOP853, explicit of order 8", knob: "solver.errorTolerance", symbol: { form: "square", colour: "right" } },
  { name: "i3alp", label: "i3-ALP with sub-steps", knob: "solver.errorTolerance", symbol: { form: "triangle", colour: "tip" } },
  { name: "i3alpConserving", label: "i3-ALP conserving, fixed step", knob: "solver.stepSize", symbol: { form: "diamond", colour: "direct" } },
  { name: "i3alpPrinted", label: "i3-ALP as printed", knob: "solver.stepSize", symbol: { form: "cross", colour: "muted" } },
  { name: "rk4", label: "RK4, fixed step", knob: "solver.stepSize", symbol: { form: "ring", colour: "ink" } },
];

export const KNOBS = {
  "solver.errorTolerance": { label: "Tolerance", min: 1e-12, max: 1e-4, scale: 1, unit: "rad" },
  "solver.stepSize": { label: "Step", min: 1e-5, max: 1e-3, scale: 1e3, unit: "ms" },
};
