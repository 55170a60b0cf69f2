"""A reference trajectory of the five-bar: four link angles, Taylor's method, quadruple precision, through the library heyoka.

Reads "name value" lines (hexadecimal floats) from standard input and prints rows as midpoint.c does; shares no code with it.

    python taylor.py TENTHS < scene

Each leg is a double pendulum (Siciliano et al., Robotics, 2009, section 7.3.2), a payload hangs on the left one, and the two closure
equations hold them together by two multipliers, which are eliminated in closed form. Stop and contact change their piece in events.
"""

import sys

import heyoka as hy
import mpmath
import numpy as np

FP = hy.real128
# Twice the needed digits: paper scenes start at a direct singularity, where the elbow's angle keeps only half of the digits.
mpmath.mp.dps = 80
JOINTS = ((0, None), (1, 0), (1, 2), (2, 3), (3, None))


def quad(x) -> FP:
    """Converts a number of mpmath, or a double, to quadruple precision."""
    return FP(mpmath.nstr(mpmath.mpf(x), 37))


class Scene(dict):
    """Values by variable name, as exact mpmath numbers of doubles, and the changing inputs for each millisecond."""

    def __init__(self, lines):
        pairs = [(name, mpmath.mpf(float.fromhex(value))) for name, value in map(str.split, lines)]
        last = [name for name, _ in pairs].index("signals")
        super().__init__(pairs[:last])
        count, rest = int(pairs[last][1]), pairs[last + 1 :]
        self.changing = [name for name, _ in rest[:count]]
        self.held = [[quad(value) for _, value in rest[i : i + count]] for i in range(0, len(rest), count or 1)]

    def input(self, name: str):
        """The expression of an input: a parameter of the integrator if the input changes."""
        return hy.par[self.changing.index(name)] if name in self.changing else hy.expression(quad(self[name]))

    def row(self, pattern: str, count: int) -> list[mpmath.mpf]:
        """Expressions for `pattern` with 1 .. count in place of #."""
        return [self[pattern.replace("#", str(i + 1))] for i in range(count)]

    def on(self, effect: str) -> bool:
        return self[f"{effect}.enabled"] != 0


def start(scene: Scene) -> list[mpmath.mpf]:
    """Angles and rates of the four links, from the proximal ones."""
    lengths, base = scene.row("link[#].length", 4), scene["base.distance"]
    proximal, rates = scene.row("init.theta[#]", 2), scene.row("init.omega[#]", 2)
    turn = lambda angle: mpmath.expj(angle)
    left = lengths[0] * turn(proximal[0])
    right = base + lengths[3] * turn(proximal[1])
    gap = abs(right - left)
    # Angle at the left elbow between the line to the other elbow and the distal link, by the cosine law.
    angle = mpmath.acos(min(mpmath.mpf(1), (gap**2 + lengths[1] ** 2 - lengths[2] ** 2) / (2 * gap * lengths[1])))
    side = 1 if scene["init.assembly"] == 1 else -1
    first = mpmath.arg(right - left) + side * angle
    tip = left + lengths[1] * turn(first)
    first, second = mpmath.arg(tip - left), mpmath.arg(tip - right)
    # i (w1 left + w2 (tip - left)) = i (w4 (right - base) + w3 (tip - right)); at rest without division, because the start may be singular
    a, b, c = tip - left, right - tip, rates[1] * (right - base) - rates[0] * left
    solution = (
        mpmath.lu_solve(mpmath.matrix([[a.real, b.real], [a.imag, b.imag]]), mpmath.matrix([c.real, c.imag]))
        if c
        else (0, 0)
    )
    return [proximal[0], first, second, proximal[1], rates[0], solution[0], solution[1], rates[1]]


def leg_constants(scene: Scene, near: int, far: int) -> list[mpmath.mpf]:
    """For the leg of links near, far: mass matrix entries a and c, the factor of cos(th_near - th_far) in b, and the moments of its links."""
    m1, m2 = scene[f"link[{near + 1}].mass"], scene[f"link[{far + 1}].mass"]
    c1, c2 = scene[f"link[{near + 1}].com"], scene[f"link[{far + 1}].com"]
    l1, l2 = scene[f"link[{near + 1}].length"], scene[f"link[{far + 1}].length"]
    i1, i2 = scene[f"link[{near + 1}].inertia"], scene[f"link[{far + 1}].inertia"]
    carried = scene["payload.mass"] if scene.on("payload") and far == 1 else mpmath.mpf(0)
    if scene.on("rotor"):
        motor = 1 if near == 0 else 2
        i1 += scene[f"rotor.gearRatio[{motor}]"] ** 2 * scene[f"rotor.inertia[{motor}]"]
    first, second = m1 * c1 + (m2 + carried) * l1, m2 * c2 + carried * l2
    return [i1 + m1 * c1**2 + (m2 + carried) * l1**2, i2 + m2 * c2**2 + carried * l2**2, l1 * second, first, second]


def mass_matrix(scene: Scene, theta: list[mpmath.mpf]) -> mpmath.matrix:
    """Mass matrix of the four angles."""
    matrix = mpmath.zeros(4)
    for near, far in ((0, 1), (3, 2)):
        matrix[near, near], matrix[far, far], coupling, *_ = leg_constants(scene, near, far)
        matrix[near, far] = matrix[far, near] = coupling * mpmath.cos(theta[near] - theta[far])
    return matrix


def after_impact(scene: Scene, mass: mpmath.mpf, state: list[mpmath.mpf]) -> list[mpmath.mpf]:
    """Angles and rates after a mass at rest has joined the tip: M' w' + J^T l = M w, J w' = 0."""
    theta, lengths = state[:4], scene.row("link[#].length", 4)
    momentum = mass_matrix(scene, theta) * mpmath.matrix(state[4:])
    scene["payload.mass"] = mass
    system = mpmath.zeros(6)
    system[:4, :4] = mass_matrix(scene, theta)
    for i, sign in enumerate((1, 1, -1, -1)):
        system[4, i] = system[i, 4] = -sign * lengths[i] * mpmath.sin(theta[i])
        system[5, i] = system[i, 5] = sign * lengths[i] * mpmath.cos(theta[i])
    return [*theta, *mpmath.lu_solve(system, mpmath.matrix([*momentum, 0, 0]))[:4]]


class Machine:
    """Symbolic equations of motion."""

    def __init__(self, scene: Scene):
        self.scene = scene
        self.theta = hy.make_vars("th1", "th2", "th3", "th4")
        self.omega = hy.make_vars("w1", "w2", "w3", "w4")
        self.lengths = [quad(x) for x in scene.row("link[#].length", 4)]
        self.cos = [hy.cos(x) for x in self.theta]
        self.sin = [hy.sin(x) for x in self.theta]
        self.switches: list = []  # functions whose signs choose the piece of a law; par[i] = 1 if positive

    def tip(self):
        """Tip position and velocity by the left leg."""
        (l1, l2), (c1, c2), (s1, s2), (w1, w2) = self.lengths[:2], self.cos[:2], self.sin[:2], self.omega[:2]
        x, y = l1 * c1 + l2 * c2, l1 * s1 + l2 * s2
        return (x, y), (-l1 * s1 * w1 - l2 * s2 * w2, l1 * c1 * w1 + l2 * c2 * w2)

    def leg(self, near: int, far: int):
        """Mass matrix entries [[a, b], [b, c]], Coriolis coupling and weight of the leg of links near, far."""
        scene = self.scene
        *constants, first, second = leg_constants(scene, near, far)
        a, c, coupling = map(quad, constants)
        between = self.theta[near] - self.theta[far]
        b, turn = coupling * hy.cos(between), coupling * hy.sin(between)
        # d/dt dT/dw - dT/dth: + turn w_far^2 on the near link, - turn w_near^2 on the far one.
        force = [-turn * self.omega[far] ** 2, turn * self.omega[near] ** 2]
        if scene.on("gravity"):
            g = scene["gravity.g"] * mpmath.sin(scene["gravity.tilt"])
            gx, gy = g * mpmath.cos(scene["gravity.direction"]), g * mpmath.sin(scene["gravity.direction"])
            for k, (link, moment) in enumerate(((near, first), (far, second))):
                force[k] = force[k] + quad(moment * gy) * self.cos[link] - quad(moment * gx) * self.sin[link]
        return a, b, c, force

    def piece(self, function):
        """The parameter that is 1 if `function` is positive, else 0."""
        self.switches.append(function)
        return hy.par[len(self.scene.changing) + len(self.switches) - 1]

    def buffer(self, effect: str, depth, rate):
        """Force of a one-sided spring and damper."""
        k, d, width = (quad(self.scene[f"{effect}.{x}"]) for x in ("k", "d", "width"))
        touching, beyond = self.piece(depth), self.piece(depth - width)
        push = k * depth + d * rate
        pushing = self.piece(push)
        u = depth / width
        ramp = u * u * u * (FP(10) + u * (FP(-15) + FP(6) * u))
        return touching * pushing * (beyond + (FP(1) - beyond) * ramp) * push

    def loads(self):
        """Generalised forces of the angles except weight."""
        scene, q = self.scene, [hy.expression(FP(0))] * 4
        for j, (first, second) in enumerate(JOINTS):
            w = self.omega[first] - (self.omega[second] if second is not None else FP(0))
            torque = hy.expression(FP(0))
            if scene.on("viscous"):
                torque = torque + quad(scene[f"viscous.b[{j + 1}]"]) * w
            if scene.on("friction"):
                dry, rest, rate = (
                    scene[f"friction.{x}"] for x in (f"coulomb[{j + 1}]", f"breakaway[{j + 1}]", "breakawayVelocity")
                )
                u = w / quad(mpmath.sqrt(2) * rate)
                torque = (
                    torque
                    + quad(mpmath.sqrt(2 * mpmath.e) * (rest - dry)) * u * hy.exp(-u * u)
                    + quad(dry) * hy.tanh(w / quad(rate / 10))
                )
            q[first] = q[first] - torque
            if second is not None:
                q[second] = q[second] + torque
        for i, link in enumerate((0, 3)):
            th, w, name = self.theta[link], self.omega[link], lambda stem, i=i: quad(scene[f"{stem}[{i + 1}]"])
            at = lambda stem, i=i: scene.input(f"{stem}[{i + 1}]")
            q[link] = q[link] + at("tau")
            if scene.on("spring"):
                q[link] = q[link] - name("spring.k") * (th - name("spring.theta0"))
            if scene.on("servo"):
                aim = name("servo.kp") * (at("servo.theta") - th) + name("servo.kd") * (at("servo.omega") - w)
                q[link] = q[link] + name("servo.limit") * hy.tanh(aim / name("servo.limit"))
            if scene.on("stop"):
                q[link] = (
                    q[link]
                    + self.buffer("stop", name("stop.lower") - th, -w)
                    - self.buffer("stop", th - name("stop.upper"), w)
                )
        fx, fy = scene.input("tip.fx"), scene.input("tip.fy")
        if scene.on("contact"):
            norm = mpmath.hypot(scene["contact.nx"], scene["contact.ny"])
            nx, ny = quad(scene["contact.nx"] / norm), quad(scene["contact.ny"] / norm)
            (x, y), (vx, vy) = self.tip()
            pressure = self.buffer("contact", quad(scene["contact.offset"]) - nx * x - ny * y, -nx * vx - ny * vy)
            drag = quad(scene["contact.mu"]) * hy.tanh((nx * vy - ny * vx) / quad(scene["contact.slipVelocity"]))
            fx, fy = fx + pressure * (nx + drag * ny), fy + pressure * (ny - drag * nx)
        for link in (0, 1):
            q[link] = q[link] + self.lengths[link] * (self.cos[link] * fy - self.sin[link] * fx)
        return q

    def accelerations(self):
        """Angular accelerations of links 1 to 4."""
        q = self.loads()
        legs = (self.leg(0, 1), self.leg(3, 2))
        # Closure: end of the left leg minus end of the right leg. The Jacobian has a column per link.
        sign = (FP(1), FP(1), FP(-1), FP(-1))
        jx = [-s * l * sin for s, l, sin in zip(sign, self.lengths, self.sin)]
        jy = [s * l * cos for s, l, cos in zip(sign, self.lengths, self.cos)]
        inverse = lambda leg, f, g: (
            (leg[2] * f - leg[1] * g) / (leg[0] * leg[2] - leg[1] * leg[1]),
            (leg[0] * g - leg[1] * f) / (leg[0] * leg[2] - leg[1] * leg[1]),
        )

        def by_mass(vector):
            """M^-1 times a vector."""
            near, far = inverse(legs[0], vector[0], vector[1])
            last, third = inverse(legs[1], vector[3], vector[2])
            return [near, far, third, last]

        weight = [legs[0][3][0], legs[0][3][1], legs[1][3][1], legs[1][3][0]]
        free = by_mass([a + b for a, b in zip(q, weight)])
        dot = lambda a, b: hy.sum([x * y for x, y in zip(a, b)])
        # J a = -(dJ/dt) w
        cx = dot([s * l * cos for s, l, cos in zip(sign, self.lengths, self.cos)], [w * w for w in self.omega]) - dot(
            jx, free
        )
        cy = dot([s * l * sin for s, l, sin in zip(sign, self.lengths, self.sin)], [w * w for w in self.omega]) - dot(
            jy, free
        )
        by_x, by_y = by_mass(jx), by_mass(jy)
        xx, xy, yy = dot(jx, by_x), dot(jx, by_y), dot(jy, by_y)
        det = xx * yy - xy * xy
        lx, ly = (yy * cx - xy * cy) / det, (xx * cy - xy * cx) / det
        return [a + lx * x + ly * y for a, x, y in zip(free, by_x, by_y)]


def events(switches, first):
    """One event per switch: it flips the parameter that selects the piece; `first` is the index of the first parameter."""

    def turn(index):
        def callback(ta, _direction):
            ta.pars[index] = FP(1) - ta.pars[index]
            return True

        return callback

    return [hy.t_event(function, callback=turn(i), fp_type=FP) for i, function in enumerate(switches, first)]


def integrator(scene: Scene, state: list[mpmath.mpf], held: list, time):
    """The integrator from a state on, with the first values of changing inputs; and a function for the tip."""
    machine = Machine(scene)
    accelerations = machine.accelerations()
    system = list(zip(machine.theta, machine.omega)) + list(zip(machine.omega, accelerations))
    # The side of each switch in double precision; no scene starts on a switch.
    names = dict(zip((*map(str, machine.theta), *map(str, machine.omega)), map(float, state)))
    sides = [
        float(hy.cfunc([g], [*machine.theta, *machine.omega])(np.array(list(names.values())))[0])
        for g in machine.switches
    ]
    inputs = len(scene.changing)
    pars = np.array([*held, *(FP(1 if g > 0 else 0) for g in sides)], dtype=FP)
    kwargs = ({"pars": pars} if len(pars) else {}) | (
        {"t_events": events(machine.switches, inputs)} if machine.switches else {}
    )
    start = np.array([quad(x) for x in state], dtype=FP)
    ta = hy.taylor_adaptive(system, start, time=time, fp_type=FP, tol=FP("1e-30"), compact_mode=True, **kwargs)
    return ta, hy.cfunc(list(machine.tip()[0]), [*machine.theta, *machine.omega], fp_type=FP)


def main() -> None:
    tenths = int(sys.argv[1])
    scene = Scene(sys.stdin)
    inputs, mass = len(scene.changing), "payload.mass"
    if mass in scene.changing:
        scene[mass] = mpmath.mpf(str(scene.held[0][scene.changing.index(mass)]))
    ta, tip = integrator(scene, start(scene), scene.held[0] if inputs else [], FP(0))
    # A saturated servo is constant to the last digit: longer steps would pass over the time at which it changes.
    longest = FP("2e-4" if scene.on("servo") else "2e-3")
    holds = 100 if inputs else 1  # pieces of a tenth of a second: changing inputs are constant for 1 ms
    for point in range(holds * tenths + 1):
        goal = FP(point) / FP(10 * holds)
        if inputs and point > 0:
            held = scene.held[point - 1]
            carried = mpmath.mpf(str(held[scene.changing.index(mass)])) if mass in scene.changing else scene[mass]
            if carried != scene[mass]:
                state = [mpmath.mpf(str(x)) for x in ta.state]
                if carried > scene[mass] and scene["payload.join"] == 1:
                    state = after_impact(scene, carried, state)
                scene[mass] = carried
                ta, tip = integrator(scene, state, held, ta.time)
            ta.pars[:inputs] = held
        while ta.time < goal:
            ta.propagate_until(goal, max_delta_t=longest)
        if point % holds == 0:
            numbers = [*tip(ta.state), *ta.state]
            print(f"{point // (10 * holds)}.{point // holds % 10}", *(str(x) for x in numbers), sep=",", flush=True)


if __name__ == "__main__":
    main()
