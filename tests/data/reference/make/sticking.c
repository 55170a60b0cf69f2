/* A reference trajectory of the five-bar with sticking friction: link angles, extrapolated midpoint rule, quadruple precision.
 *
 * Usage: sticking TENTHS TOLERANCE < scene      (make.py calls it; README.md says more; input and output as in midpoint.c)
 *
 * Friction is set-valued: a slipping place has a torque or force against the motion; a sticking place has a multiplier that keeps its rate
 * 0, up to its bound. A step ends at a zero rate, at a multiplier's bound, or at a border of the contact law. There the program tries all
 * states that the laws allow, and continues with the confirmed one. Supports gravity, viscous and dry friction, rotors, payload, servos and
 * contact.
 */
#include <quadmath.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef __float128 real;

enum { LINKS = 4, STATE = 8, COLUMNS = 13, GRIPS = 6, TIP = 5, MOST = 512, EVENTS = GRIPS + 3 };

/* ---- the scene ---- */

static struct { char name[64]; real value; } table[MOST];
static int entries, changing;

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

static bool next_line(char name[64], real *value) {
    double number;
    if (scanf("%63s %la", name, &number) != 2) return false;
    *value = number;
    return true;
}

static real base, length[LINKS], com[LINKS], mass[LINKS], inertia[LINKS], payload;
static real weight[2], tau[2], tip_force[2], viscous[5], dry[5], rest[5], fall_rate;
static bool servo, contact;
static real kp[2], kd[2], limit[2], servo_theta[2], servo_omega[2], normal[2], offset, stiffness, damping, width, mu;

static void take_inputs(void) {
    tip_force[0] = get("tip.fx");
    tip_force[1] = get("tip.fy");
    for (int i = 0; i < 2; i++) {
        tau[i] = get_i("tau", i, "");
        servo_theta[i] = get_i("servo.theta", i, "");
        servo_omega[i] = get_i("servo.omega", i, "");
    }
}

static void read_inputs(void) {
    char name[64];
    real value;
    for (int i = 0; i < changing && next_line(name, &value); i++) *find(name) = value;
    take_inputs();
}

static void read_scene(void) {
    while (entries < MOST && next_line(table[entries].name, &table[entries].value)) {
        if (!strcmp(table[entries].name, "signals")) {
            changing = (int)table[entries].value;
            break;
        }
        entries++;
    }
    base = get("base.distance");
    for (int i = 0; i < LINKS; i++) {
        length[i] = get_i("link", i, ".length");
        com[i] = get_i("link", i, ".com");
        mass[i] = get_i("link", i, ".mass");
        inertia[i] = get_i("link", i, ".inertia");
    }
    for (int i = 0; i < 2 && get("rotor.enabled") != 0; i++) {
        real ratio = get_i("rotor.gearRatio", i, "");
        inertia[i ? 3 : 0] += ratio * ratio * get_i("rotor.inertia", i, "");
    }
    payload = get("payload.enabled") != 0 ? get("payload.mass") : 0;
    if (get("gravity.enabled") != 0) {
        real g = get("gravity.g") * sinq(get("gravity.tilt")), direction = get("gravity.direction");
        weight[0] = g * cosq(direction);
        weight[1] = g * sinq(direction);
    }
    for (int j = 0; j < 5; j++) {
        if (get("viscous.enabled") != 0) viscous[j] = get_i("viscous.b", j, "");
        if (get("friction.enabled") != 0) {
            dry[j] = get_i("friction.coulomb", j, "");
            rest[j] = get_i("friction.breakaway", j, "");
        }
    }
    fall_rate = sqrtq(2) * get("friction.breakawayVelocity");
    servo = get("servo.enabled") != 0;
    for (int i = 0; i < 2; i++) {
        kp[i] = get_i("servo.kp", i, "");
        kd[i] = get_i("servo.kd", i, "");
        limit[i] = get_i("servo.limit", i, "");
    }
    contact = get("contact.enabled") != 0;
    normal[0] = get("contact.nx");
    normal[1] = get("contact.ny");
    real norm = hypotq(normal[0], normal[1]);
    normal[0] /= norm;
    normal[1] /= norm;
    offset = get("contact.offset");
    stiffness = get("contact.k");
    damping = get("contact.d");
    width = get("contact.width");
    mu = get("contact.mu");
    take_inputs();
}

/* ---- the machine: state is angles and rates of links 1 to 4 ---- */

static const int first_of[5] = {0, 1, 1, 2, 3}, second_of[5] = {-1, 0, 2, 3, -1};

/* State of each friction place: 0: open, +1 or -1: slipping in this direction, HELD: sticking. */
enum { HELD = 2 };
static int grip[GRIPS];

/* Phase of the tip: free, on the ramp, beyond it, or separating from either. */
enum { FREE, RAMP, FULL, RAMP_OFF, FULL_OFF };
static int place = FREE;

static void tip_of(const real *y, real p[2], real v[2]) {
    p[0] = p[1] = v[0] = v[1] = 0;
    for (int i = 0; i < 2; i++) {
        real x = length[i] * cosq(y[i]), z = length[i] * sinq(y[i]);
        p[0] += x;
        p[1] += z;
        v[0] -= z * y[4 + i];
        v[1] += x * y[4 + i];
    }
}

/* Depth, its rate, and the push of the plane without separation, by the piece of its law. */
static void press(const real *y, real out[3]) {
    real p[2], v[2];
    tip_of(y, p, v);
    out[0] = offset - normal[0] * p[0] - normal[1] * p[1];
    out[1] = -normal[0] * v[0] - normal[1] * v[1];
    out[2] = stiffness * out[0] + damping * out[1];
}

static real pressure(const real *y) {
    if (place != RAMP && place != FULL) return 0;
    real at[3];
    press(y, at);
    real u = place == RAMP ? at[0] / width : 1;
    return u * u * u * (10 - 15 * u + 6 * u * u) * at[2];
}

/* A grip as a row over the rates: its rate, and its acceleration minus row . a. */
static void row_of(int g, const real *y, real row[LINKS], real *rate, real *drift) {
    memset(row, 0, sizeof(real) * LINKS);
    *rate = *drift = 0;
    if (g == TIP) {
        for (int i = 0; i < 2; i++) {
            real x = length[i] * cosq(y[i]), z = length[i] * sinq(y[i]), w = y[4 + i];
            row[i] = normal[1] * z + normal[0] * x; /* along (-ny, nx) */
            *drift += (normal[1] * x - normal[0] * z) * w * w;
        }
    } else {
        row[first_of[g]] = 1;
        if (second_of[g] >= 0) row[second_of[g]] = -1;
    }
    for (int i = 0; i < LINKS; i++) *rate += row[i] * y[4 + i];
}

/* Bound of a friction place, and its friction when it slips. */
static real bound(int g, const real *y, real rate) {
    if (g == TIP) return mu * pressure(y);
    real u = rate / fall_rate;
    return dry[g] + (rest[g] - dry[g]) * expq(-u * u);
}

/* Accelerations, and the torques and the force of sticking places. */
static void accelerate(const real *y, real a[LINKS], real held[GRIPS]) {
    real m[12][13];
    int size = 6, who[GRIPS], holders = 0;
    memset(m, 0, sizeof m);
    for (int leg = 0; leg < 2; leg++) {
        int p = leg ? 3 : 0, d = leg ? 2 : 1, sign = leg ? -1 : 1;
        real carried = leg ? 0 : payload, difference = y[p] - y[d];
        real couple = length[p] * (mass[d] * com[d] + carried * length[d]);
        real arm_p = mass[p] * com[p] + (mass[d] + carried) * length[p], arm_d = mass[d] * com[d] + carried * length[d];
        m[p][p] = inertia[p] + mass[p] * com[p] * com[p] + (mass[d] + carried) * length[p] * length[p];
        m[d][d] = inertia[d] + mass[d] * com[d] * com[d] + carried * length[d] * length[d];
        m[p][d] = m[d][p] = couple * cosq(difference);
        m[p][12] = arm_p * (weight[1] * cosq(y[p]) - weight[0] * sinq(y[p])) - couple * sinq(difference) * y[4 + d] * y[4 + d];
        m[d][12] = arm_d * (weight[1] * cosq(y[d]) - weight[0] * sinq(y[d])) + couple * sinq(difference) * y[4 + p] * y[4 + p];
        m[p][12] += tau[leg];
        if (servo) {
            real pull = kp[leg] * (servo_theta[leg] - y[p]) + kd[leg] * (servo_omega[leg] - y[4 + p]);
            m[p][12] += limit[leg] * tanhq(pull / limit[leg]);
        }
        for (int k = 0; k < 2; k++) {
            int i = k ? d : p;
            real x = sign * length[i] * cosq(y[i]), z = sign * length[i] * sinq(y[i]);
            m[4][i] = m[i][4] = -z;
            m[5][i] = m[i][5] = x;
            m[4][12] += x * y[4 + i] * y[4 + i];
            m[5][12] += z * y[4 + i] * y[4 + i];
        }
    }
    real force[2] = {tip_force[0], tip_force[1]}, push = pressure(y);
    for (int k = 0; k < 2; k++) force[k] += push * normal[k];
    for (int i = 0; i < 2; i++) m[i][12] += length[i] * (cosq(y[i]) * force[1] - sinq(y[i]) * force[0]);
    for (int g = 0; g < GRIPS; g++) {
        real row[LINKS], rate, drift;
        row_of(g, y, row, &rate, &drift);
        real torque = g < 5 ? -viscous[g] * rate : 0;
        if (grip[g] == 1 || grip[g] == -1) torque -= grip[g] * bound(g, y, rate);
        for (int i = 0; i < LINKS; i++) m[i][12] += torque * row[i];
        held[g] = 0;
        if (grip[g] == HELD) {
            for (int i = 0; i < LINKS; i++) {
                m[size][i] = row[i];
                m[i][size] = -row[i];
            }
            m[size][12] = -drift;
            who[holders++] = g;
            size++;
        }
    }
    /* Gauss and Jordan, with the largest pivot of each column. */
    for (int c = 0; c < size; c++) {
        int best = c;
        for (int i = c; i < size; i++)
            if (fabsq(m[i][c]) > fabsq(m[best][c])) best = i;
        for (int j = 0; j < 13; j++) {
            real t = m[c][j];
            m[c][j] = m[best][j];
            m[best][j] = t;
        }
        for (int i = 0; i < size; i++) {
            if (i == c) continue;
            real f = m[i][c] / m[c][c];
            for (int j = c; j < 13; j++) m[i][j] -= f * m[c][j];
        }
    }
    for (int i = 0; i < LINKS; i++) a[i] = m[i][12] / m[i][i];
    for (int k = 0; k < holders; k++) held[who[k]] = m[6 + k][12] / m[6 + k][6 + k];
}

static void derivative(const real *y, real *dy) {
    real held[GRIPS];
    memcpy(dy, y + 4, sizeof(real) * LINKS);
    accelerate(y, dy + 4, held);
}

/* ---- steps ---- */

static real tolerance;

static real step(const real *y, real h, real *out) {
    static real former[COLUMNS][STATE], row[COLUMNS][STATE];
    real slope[STATE], d[STATE], old[STATE], error = 0;
    derivative(y, slope);
    for (int j = 0; j < COLUMNS; j++) {
        int count = 2 * (j + 1);
        real part = h / count;
        memcpy(former, row, sizeof row);
        memcpy(old, y, sizeof old);
        for (int i = 0; i < STATE; i++) row[0][i] = y[i] + part * slope[i];
        for (int s = 1; s < count; s++) {
            derivative(row[0], d);
            for (int i = 0; i < STATE; i++) {
                real next = old[i] + 2 * part * d[i];
                old[i] = row[0][i];
                row[0][i] = next;
            }
        }
        for (int k = 1; k <= j; k++) {
            real ratio = (real)(j + 1) / (j + 1 - k);
            for (int i = 0; i < STATE; i++) row[k][i] = row[k - 1][i] + (row[k - 1][i] - former[k - 1][i]) / (ratio * ratio - 1);
        }
    }
    for (int i = 0; i < STATE; i++) {
        out[i] = row[COLUMNS - 1][i];
        real difference = fabsq(out[i] - row[COLUMNS - 2][i]) / (1 + fabsq(out[i]));
        if (!finiteq(difference)) return HUGE_VALQ;
        error = fmaxq(error, difference);
    }
    return error;
}

/* Margins: a step ends when one falls below 0; HUGE_VALQ if there is none. */
static void margins(const real *y, real g[EVENTS]) {
    real a[LINKS], held[GRIPS], at[3];
    accelerate(y, a, held);
    for (int i = 0; i < EVENTS; i++) g[i] = HUGE_VALQ;
    for (int i = 0; i < GRIPS; i++) {
        real row[LINKS], rate, drift;
        row_of(i, y, row, &rate, &drift);
        if (grip[i] == HELD) g[i] = bound(i, y, 0) - fabsq(held[i]);
        else if (grip[i]) g[i] = grip[i] * rate;
    }
    if (!contact) return;
    press(y, at);
    if (place == FREE) g[GRIPS] = -at[0];
    else g[GRIPS] = place == RAMP || place == RAMP_OFF ? at[0] : at[0] - width;
    if (place == RAMP || place == RAMP_OFF) g[GRIPS + 1] = width - at[0];
    if (place != FREE && damping > 0) g[GRIPS + 2] = place == RAMP || place == FULL ? at[2] : -at[2];
}

/* Index of the least margin below 0, each in its own unit; -1 if there is none. */
static int crossed(const real *y, real *value) {
    real g[EVENTS];
    int least = -1;
    margins(y, g);
    *value = 0;
    for (int i = 0; i < EVENTS; i++)
        if (g[i] < *value - 1e-26Q) {
            least = i;
            *value = g[i];
        }
    return least;
}

static bool resting;

/* At this state, with these grips at rate 0: tries all states that the laws allow and keeps the confirmed one. */
static bool agree(const real *y, const int zero[], int count, int holds) {
    int most = 1;
    for (int i = 0; i < count; i++) most *= 3;
    real best = HUGE_VALQ;
    int chosen = -1;
    for (int code = 0; code < most; code++) {
        int held = 0;
        for (int i = 0, c = code; i < count; i++, c /= 3) {
            grip[zero[i]] = c % 3 == 0 ? HELD : c % 3 == 1 ? 1 : -1;
            held += c % 3 == 0;
        }
        if (resting ? held != holds : held > holds) continue;
        real a[LINKS], torque[GRIPS], worst = 0;
        accelerate(y, a, torque);
        for (int i = 0; i < count; i++) {
            real row[LINKS], rate, drift;
            row_of(zero[i], y, row, &rate, &drift);
            for (int k = 0; k < LINKS; k++) drift += row[k] * a[k];
            real violation = grip[zero[i]] == HELD ? fabsq(torque[zero[i]]) / bound(zero[i], y, 0) - 1 : -grip[zero[i]] * drift;
            worst = finiteq(violation) ? fmaxq(worst, violation) : HUGE_VALQ;
        }
        if (resting)
            for (int k = 0; k < LINKS; k++) worst = fmaxq(worst, fabsq(a[k]));
        if (worst < best) {
            best = worst;
            chosen = code;
        }
    }
    for (int i = 0, c = chosen; i < count && chosen >= 0; i++, c /= 3) grip[zero[i]] = c % 3 == 0 ? HELD : c % 3 == 1 ? 1 : -1;
    return best < 1e-15Q;
}

/* Decides the states of the friction places from here on. */
static void decide(real *y) {
    const real slow = 1e-12Q;
    int zero[GRIPS], count = 0;
    real fastest = 0;
    for (int i = 0; i < LINKS; i++) fastest = fmaxq(fastest, fabsq(y[4 + i]));
    resting = fastest < slow;
    for (int g = 0; g < GRIPS; g++) {
        real row[LINKS], rate, drift;
        row_of(g, y, row, &rate, &drift);
        bool held = grip[g] == HELD;
        grip[g] = 0;
        if (!(bound(g, y, 0) > 0)) continue;
        if (resting || held || fabsq(rate) < slow) zero[count++] = g;
        else grip[g] = rate > 0 ? 1 : -1;
    }
    if (resting) {
        real before[LINKS];
        memcpy(before, y + 4, sizeof before);
        memset(y + 4, 0, sizeof before);
        if (agree(y, zero, count, 2)) return;
        resting = false;
        memcpy(y + 4, before, sizeof before);
    }
    if (count) agree(y, zero, count, 1);
    for (int g = 0; g < GRIPS; g++) { /* sticking places are exactly at rest */
        if (grip[g] != HELD) continue;
        real row[LINKS], rate, drift, square = 0;
        row_of(g, y, row, &rate, &drift);
        for (int k = 0; k < LINKS; k++) square += row[k] * row[k];
        if (fabsq(rate) > 1e-10Q) fprintf(stderr, "a grip is held at a rate of %.3g\n", (double)rate);
    }
}

/* Changes to the next piece of the contact's law. */
static void turn(const real *y, int event) {
    real at[3];
    press(y, at);
    bool pushes = at[2] > 0;
    if (event == GRIPS) place = place == FREE ? RAMP : place == RAMP || place == RAMP_OFF ? FREE : pushes ? RAMP : RAMP_OFF;
    else if (event == GRIPS + 1) place = pushes ? FULL : FULL_OFF;
    else if (event == GRIPS + 2) place = place == RAMP ? RAMP_OFF : place == FULL ? FULL_OFF : place == RAMP_OFF ? RAMP : FULL;
}

static real wanted = 1e-3Q;

static void advance(real *y, real duration) {
    const real longest = 1e-3Q;
    real gone = 0;
    while (!resting && gone < duration * (1 - 1e-30Q)) {
        real h = fminq(fminq(wanted, longest), duration - gone), out[STATE], value;
        real error = step(y, h, out);
        if (!(error <= tolerance)) {
            wanted = h * (finiteq(error) ? fmaxq(0.1Q, 0.8Q * powq(tolerance / error, 1.0Q / 25)) : 0.2Q);
            continue;
        }
        int event = crossed(out, &value);
        if (event >= 0) {
            /* The first time at which any margin is 0: halves, then false position on the least. */
            real low = 0, high = h, at_high = value, at_low = HUGE_VALQ;
            for (int turns = 0; turns < 200 && high - low > 1e-30Q; turns++) {
                real middle = (low + high) / 2;
                if (at_low < HUGE_VALQ && turns % 4) middle = low + (high - low) * at_low / (at_low - at_high);
                step(y, middle, out);
                real g[EVENTS];
                int there = crossed(out, &value);
                margins(out, g);
                if (there >= 0) {
                    high = middle;
                    at_high = value;
                    event = there;
                } else {
                    low = middle;
                    at_low = g[event] < HUGE_VALQ ? fmaxq(g[event], 1e-33Q) : HUGE_VALQ;
                }
                if (there == event && fabsq(value) < 1e-24Q) break;
            }
            step(y, high, out);
            h = high;
            event = crossed(out, &value);
        }
        memcpy(y, out, sizeof out);
        gone += h;
        if (event >= 0) {
            if (event >= GRIPS) turn(y, event);
            int crossing = event < GRIPS && grip[event] != HELD ? event : -1;
            if (crossing >= 0 || event >= GRIPS || grip[event] == HELD) decide(y);
            wanted = 1e-4Q;
        } else wanted = h * fminq(2, error > 0 ? 0.8Q * powq(tolerance / error, 1.0Q / 25) : 2);
    }
}

static void print(int tenth, const real *y) {
    char text[64];
    real p[2], v[2];
    tip_of(y, p, v);
    printf("%d.%d", tenth / 10, tenth % 10);
    for (int i = 0; i < 10; i++) {
        quadmath_snprintf(text, sizeof text, "%.33Qg", i < 2 ? p[i] : y[i - 2]);
        printf(",%s", text);
    }
    printf("\n");
    fflush(stdout);
}

/* Angles and rates of all links from the proximal ones: the tip is an intersection of two circles. */
static void start(real *y) {
    real a = get_i("init.theta", 0, ""), d = get_i("init.theta", 1, ""), wa = get_i("init.omega", 0, ""), wd = get_i("init.omega", 1, "");
    real p[2] = {length[0] * cosq(a), length[0] * sinq(a)}, r[2] = {length[3] * cosq(d), length[3] * sinq(d)};
    real dx = base + r[0] - p[0], dz = r[1] - p[1], distance = hypotq(dx, dz);
    real foot = (distance * distance + length[1] * length[1] - length[2] * length[2]) / (2 * distance);
    real height = sqrtq(length[1] * length[1] - foot * foot) * (get("init.assembly") == 1 ? 1 : -1);
    real b[2] = {(foot * dx - height * dz) / distance, (foot * dz + height * dx) / distance};
    real c[2] = {p[0] + b[0] - base - r[0], p[1] + b[1] - r[1]};
    real right[2] = {p[1] * wa - r[1] * wd, -p[0] * wa + r[0] * wd};
    real determinant = -b[1] * -c[0] - c[1] * b[0];
    real state[STATE] = {a, atan2q(b[1], b[0]), atan2q(c[1], c[0]), d, wa,
                         (right[0] * -c[0] - c[1] * right[1]) / determinant, (-b[1] * right[1] - b[0] * right[0]) / determinant, wd};
    memcpy(y, state, sizeof state);
}

int main(int argc, char **argv) {
    if (argc != 3) return 1;
    int tenths = atoi(argv[1]);
    tolerance = strtoflt128(argv[2], NULL);
    real y[STATE];
    read_scene();
    start(y);
    if (changing && tenths) read_inputs();
    decide(y);
    print(0, y);
    for (int tenth = 1; tenth <= tenths; tenth++) {
        int holds = changing ? 100 : 1;
        for (int i = 0; i < holds; i++) {
            if (changing && !(tenth == 1 && i == 0)) {
                read_inputs();
                if (resting || servo) decide(y);
                else decide(y);
            }
            advance(y, 0.1Q / holds);
        }
        print(tenth, y);
    }
    return 0;
}
