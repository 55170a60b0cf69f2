/* The five-bar in Cartesian coordinates and quadruple precision: reads a scene, computes forces and accelerations. See midpoint.c.
 *
 * Coordinates are x, y, angle of each link at its centre of mass, and x, y of the payload, which is a separate body. Accelerations
 * come from M a - J^T l = Q, J a = c (index 1). The laws of src/effects/ are implemented again from their formulas.
 */
#include "machine.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int n, m, signals;
real base, length[LINKS], theta_start[2], omega_start[2];
int assembly;
bool piece[SWITCHES], servo;

/* ---- the scene ---- */

enum { MOST = 512 };

static struct { char name[64]; real value; } table[MOST];
static int entries;

static real *find(const char *name) {
    for (int i = 0; i < entries; i++)
        if (!strcmp(table[i].name, name)) return &table[i].value;
    fprintf(stderr, "the scene has no %s\n", name);
    exit(1);
}

static real get(const char *name) { return *find(name); }

static real get_i(const char *stem, int i, const char *rest) {
    char name[64];
    snprintf(name, sizeof name, "%s[%d]%s", stem, i + 1, rest);
    return get(name);
}

static bool on(const char *effect) {
    char name[64];
    snprintf(name, sizeof name, "%s.enabled", effect);
    return get(name) != 0;
}

typedef struct { real k, d, width; } Buffer;

static real com[LINKS], mass[BODIES], inertia[LINKS];
static real gravity[2], tau[2], tip_force[2];
static real viscous[5], coulomb[5], stribeck[5], stribeck_rate, coulomb_rate;
static real spring_k[2], spring_theta[2];
static real kp[2], kd[2], limit[2], servo_theta[2], servo_omega[2];
static bool stops, contact;
static real stop_limit[2][2], normal[2], offset, mu, slip_velocity;
static Buffer stop_buffer, contact_buffer;

/* The inputs from the table. */
static void take_inputs(void) {
    tip_force[0] = get("tip.fx");
    tip_force[1] = get("tip.fy");
    for (int i = 0; i < 2; i++) {
        tau[i] = get_i("tau", i, "");
        servo_theta[i] = get_i("servo.theta", i, "");
        servo_omega[i] = get_i("servo.omega", i, "");
    }
}

void read_signals(void) {
    char name[64];
    double value;
    for (int i = 0; i < signals; i++) {
        if (scanf("%63s %la", name, &value) != 2) {
            fprintf(stderr, "the signals end too early\n");
            exit(1);
        }
        *find(name) = value;
    }
    take_inputs();
}

/* The payload's body exists if it has a mass. */
static void carry(void) {
    mass[4] = on("payload") ? get("payload.mass") : 0;
    n = mass[4] > 0 ? 14 : 12;
    m = mass[4] > 0 ? 12 : 10;
}

void read_scene(void) {
    double value;
    while (entries < MOST && scanf("%63s %la", table[entries].name, &value) == 2) {
        table[entries++].value = value;
        if (!strcmp(table[entries - 1].name, "signals")) break;
    }
    signals = (int)get("signals");
    take_inputs();
    base = get("base.distance");
    for (int i = 0; i < LINKS; i++) {
        length[i] = get_i("link", i, ".length");
        com[i] = get_i("link", i, ".com");
        mass[i] = get_i("link", i, ".mass");
        inertia[i] = get_i("link", i, ".inertia");
    }
    carry();
    if (on("gravity")) {
        real g = get("gravity.g") * sinq(get("gravity.tilt"));
        gravity[0] = g * cosq(get("gravity.direction"));
        gravity[1] = g * sinq(get("gravity.direction"));
    }
    assembly = get("init.assembly") == 1 ? 1 : -1;
    stops = on("stop");
    contact = on("contact");
    servo = on("servo");
    for (int i = 0; i < 2; i++) {
        int link = i ? 3 : 0;
        theta_start[i] = get_i("init.theta", i, "");
        omega_start[i] = get_i("init.omega", i, "");
        if (on("rotor")) inertia[link] += get_i("rotor.inertia", i, "") * get_i("rotor.gearRatio", i, "") * get_i("rotor.gearRatio", i, "");
        spring_k[i] = on("spring") ? get_i("spring.k", i, "") : 0;
        spring_theta[i] = get_i("spring.theta0", i, "");
        kp[i] = get_i("servo.kp", i, "");
        kd[i] = get_i("servo.kd", i, "");
        limit[i] = get_i("servo.limit", i, "");
        stop_limit[i][0] = get_i("stop.lower", i, "");
        stop_limit[i][1] = get_i("stop.upper", i, "");
    }
    stribeck_rate = sqrtq(2) * get("friction.breakawayVelocity");
    coulomb_rate = get("friction.breakawayVelocity") / 10;
    for (int j = 0; j < 5; j++) {
        viscous[j] = on("viscous") ? get_i("viscous.b", j, "") : 0;
        if (!on("friction")) continue;
        coulomb[j] = get_i("friction.coulomb", j, "");
        stribeck[j] = sqrtq(2 * expq(1)) * (get_i("friction.breakaway", j, "") - coulomb[j]);
    }
    stop_buffer = (Buffer){ get("stop.k"), get("stop.d"), get("stop.width") };
    contact_buffer = (Buffer){ get("contact.k"), get("contact.d"), get("contact.width") };
    real norm = hypotq(get("contact.nx"), get("contact.ny"));
    normal[0] = get("contact.nx") / norm;
    normal[1] = get("contact.ny") / norm;
    offset = get("contact.offset");
    mu = get("contact.mu");
    slip_velocity = get("contact.slipVelocity");
}

/* ---- forces ---- */

/* The point of a link at a distance along it from its base or elbow end, relative to its centre of mass. */
static void arm(const real *q, int link, real along, real *rx, real *ry) {
    *rx = (along - com[link]) * cosq(q[TH(link)]);
    *ry = (along - com[link]) * sinq(q[TH(link)]);
}

/* Depth and its rate for each buffer: stops of motor 1 (lower, upper) and 2, contact. */
static void depths(const real *q, const real *v, real depth[BUFFERS], real rate[BUFFERS]) {
    for (int i = 0; i < 2; i++) {
        int th = TH(i ? 3 : 0);
        depth[2 * i] = stop_limit[i][0] - q[th];
        rate[2 * i] = -v[th];
        depth[2 * i + 1] = q[th] - stop_limit[i][1];
        rate[2 * i + 1] = v[th];
    }
    real rx, ry;
    arm(q, 1, length[1], &rx, &ry);
    real vx = v[X(1)] - v[TH(1)] * ry, vy = v[Y(1)] + v[TH(1)] * rx;
    depth[4] = offset - normal[0] * (q[X(1)] + rx) - normal[1] * (q[Y(1)] + ry);
    rate[4] = -normal[0] * vx - normal[1] * vy;
}

static const Buffer *buffer(int i) { return i < 4 ? &stop_buffer : &contact_buffer; }

void switches(const real *y, real g[SWITCHES]) {
    real depth[BUFFERS], rate[BUFFERS];
    depths(y, y + n, depth, rate);
    for (int i = 0; i < BUFFERS; i++) {
        const Buffer *b = buffer(i);
        bool there = i < 4 ? stops : contact;
        g[3 * i] = there ? depth[i] : -1;
        g[3 * i + 1] = there ? depth[i] - b->width : -1;
        g[3 * i + 2] = there ? b->k * depth[i] + b->d * rate[i] : -1;
    }
}

static real push(int i, real depth, real rate) {
    const Buffer *b = buffer(i);
    if (!piece[3 * i] || !piece[3 * i + 2]) return 0;
    real u = depth / b->width;
    real ramp = piece[3 * i + 1] ? 1 : u * u * u * (10 - 15 * u + 6 * u * u);
    return ramp * (b->k * depth + b->d * rate);
}

static void forces(const real *q, const real *v, real *f) {
    for (int i = 0; i < n; i++) f[i] = 0;
    for (int b = 0; b < (n == 14 ? BODIES : LINKS); b++) {
        f[X(b)] = mass[b] * gravity[0];
        f[Y(b)] = mass[b] * gravity[1];
    }
    static const int first[5] = { 0, 1, 1, 2, 3 }, second[5] = { -1, 0, 2, 3, -1 };
    for (int j = 0; j < 5; j++) {
        real w = v[TH(first[j])] - (second[j] < 0 ? 0 : v[TH(second[j])]);
        real torque = viscous[j] * w;
        if (coulomb[j] != 0 || stribeck[j] != 0) {
            real u = w / stribeck_rate;
            torque += stribeck[j] * expq(-u * u) * u + coulomb[j] * tanhq(w / coulomb_rate);
        }
        f[TH(first[j])] -= torque;
        if (second[j] >= 0) f[TH(second[j])] += torque;
    }
    real depth[BUFFERS], rate[BUFFERS];
    depths(q, v, depth, rate);
    for (int i = 0; i < 2; i++) {
        int th = TH(i ? 3 : 0);
        f[th] += tau[i] - spring_k[i] * (q[th] - spring_theta[i]);
        f[th] += push(2 * i, depth[2 * i], rate[2 * i]) - push(2 * i + 1, depth[2 * i + 1], rate[2 * i + 1]);
        if (servo) f[th] += limit[i] * tanhq((kp[i] * (servo_theta[i] - q[th]) + kd[i] * (servo_omega[i] - v[th])) / limit[i]);
    }
    real rx, ry, fx = tip_force[0], fy = tip_force[1];
    arm(q, 1, length[1], &rx, &ry);
    if (contact) {
        real pressure = push(4, depth[4], rate[4]);
        real slip = -normal[1] * (v[X(1)] - v[TH(1)] * ry) + normal[0] * (v[Y(1)] + v[TH(1)] * rx);
        real drag = mu * tanhq(slip / slip_velocity);
        fx += pressure * (normal[0] + drag * normal[1]);
        fy += pressure * (normal[1] - drag * normal[0]);
    }
    f[X(1)] += fx;
    f[Y(1)] += fy;
    f[TH(1)] += rx * fy - ry * fx;
}

/* ---- accelerations ---- */

static real J[MAX_M][MAX_N], c[MAX_M];

/* Adds a point of a link, with a sign, to constraint rows r and r + 1; c collects the centripetal accelerations. */
static void point(const real *q, const real *v, int r, real sign, int link, real along) {
    real rx, ry, w = v[TH(link)];
    arm(q, link, along, &rx, &ry);
    J[r][X(link)] += sign;
    J[r][TH(link)] -= sign * ry;
    J[r + 1][Y(link)] += sign;
    J[r + 1][TH(link)] += sign * rx;
    c[r] += sign * w * w * rx;
    c[r + 1] += sign * w * w * ry;
}

static void constraints(const real *q, const real *v) {
    memset(J, 0, sizeof J);
    memset(c, 0, sizeof c);
    point(q, v, 0, 1, 0, 0);
    point(q, v, 2, 1, 0, length[0]), point(q, v, 2, -1, 1, 0);
    point(q, v, 4, 1, 1, length[1]), point(q, v, 4, -1, 2, length[2]);
    point(q, v, 6, 1, 2, 0), point(q, v, 6, -1, 3, length[3]);
    point(q, v, 8, 1, 3, 0);
    if (n == 14) {
        point(q, v, 10, 1, 1, length[1]);
        J[10][12] = J[11][13] = -1;
    }
}

/* f becomes a = M^-1 (f + J^T l), with l such that J a = b. */
static void respond(real *f, const real *b) {
    real w[MAX_N], A[MAX_M][MAX_M + 1];
    for (int i = 0; i < n; i++) w[i] = 1 / (i >= 12 ? mass[4] : i % 3 == 2 ? inertia[i / 3] : mass[i / 3]);
    for (int i = 0; i < m; i++) {
        A[i][m] = b[i];
        for (int k = 0; k < m; k++) A[i][k] = 0;
        for (int k = 0; k < n; k++) {
            if (J[i][k] == 0) continue;
            real x = J[i][k] * w[k];
            A[i][m] -= x * f[k];
            for (int l = 0; l < m; l++)
                if (J[l][k] != 0) A[i][l] += x * J[l][k];
        }
    }
    for (int i = 0; i < m; i++) /* positive definite: no pivots */
        for (int k = i + 1; k < m; k++) {
            if (A[k][i] == 0) continue;
            real factor = A[k][i] / A[i][i];
            for (int l = i; l <= m; l++) A[k][l] -= factor * A[i][l];
        }
    for (int i = m - 1; i >= 0; i--) {
        for (int k = i + 1; k < m; k++) A[i][m] -= A[i][k] * A[k][m];
        A[i][m] /= A[i][i];
    }
    for (int k = 0; k < n; k++) {
        for (int i = 0; i < m; i++) f[k] += J[i][k] * A[i][m];
        f[k] *= w[k];
    }
}

void derivative(const real *y, real *dy) {
    const real *q = y, *v = y + n;
    real f[MAX_N];
    constraints(q, v);
    forces(q, v, f);
    respond(f, c);
    for (int k = 0; k < n; k++) dy[k] = v[k], dy[n + k] = f[k];
}

void join(real *y) {
    const real before = mass[4];
    real theta[LINKS], omega[LINKS], momentum[MAX_N], none[MAX_M] = { 0 };
    for (int i = 0; i < LINKS; i++) theta[i] = y[TH(i)], omega[i] = y[n + TH(i)];
    carry();
    if (mass[4] == before) return;
    place(theta, omega, y);
    if (mass[4] < before || get("payload.join") != 1) return;
    /* The payload's body joins the old mass, which moves with the tip, and the new mass at rest: J^T l unites them. */
    real *v = y + n;
    for (int k = 0; k < 12; k++) momentum[k] = (k % 3 == 2 ? inertia[k / 3] : mass[k / 3]) * v[k];
    for (int k = 12; k < 14; k++) momentum[k] = before * v[k];
    constraints(y, v);
    respond(momentum, none);
    for (int k = 0; k < n; k++) v[k] = momentum[k];
}

/* ---- start and tip ---- */

void place(const real theta[LINKS], const real omega[LINKS], real *y) {
    real *q = y, *v = y + n, rx, ry;
    /* Position and motion of each link's base or elbow end. */
    for (int link = 0; link < LINKS; link++) q[TH(link)] = theta[link], v[TH(link)] = omega[link];
    static const int order[LINKS] = { 0, 1, 3, 2 }, before[LINKS] = { -1, 0, -1, 3 };
    for (int i = 0; i < LINKS; i++) {
        int link = order[i], inner = before[i];
        real x = link == 3 ? base : 0, yy = 0, vx = 0, vy = 0;
        if (inner >= 0) {
            arm(q, inner, length[inner], &rx, &ry);
            x = q[X(inner)] + rx, yy = q[Y(inner)] + ry;
            vx = v[X(inner)] - omega[inner] * ry, vy = v[Y(inner)] + omega[inner] * rx;
        }
        arm(q, link, 0, &rx, &ry);
        q[X(link)] = x - rx, q[Y(link)] = yy - ry;
        v[X(link)] = vx + omega[link] * ry, v[Y(link)] = vy - omega[link] * rx;
    }
    if (n == 14) {
        arm(q, 1, length[1], &rx, &ry);
        q[12] = q[X(1)] + rx, q[13] = q[Y(1)] + ry;
        v[12] = v[X(1)] - omega[1] * ry, v[13] = v[Y(1)] + omega[1] * rx;
    }
}

void tip_of(const real *y, real tip[2]) {
    real rx, ry;
    arm(y, 1, length[1], &rx, &ry);
    tip[0] = y[X(1)] + rx;
    tip[1] = y[Y(1)] + ry;
}
