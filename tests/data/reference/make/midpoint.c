/* A reference trajectory of the five-bar: Cartesian coordinates, extrapolated midpoint rule, quadruple precision.
 *
 * Usage: midpoint TENTHS TOLERANCE < scene      (make.py calls it; README.md says more)
 *
 * Reads lines "name value" (value is a C99 hexadecimal float: the exact double that the tested unit gets). The last one is
 * "signals COUNT"; COUNT such lines follow for each millisecond: the changing inputs, constant during it. Writes rows
 * t, tip x, y, angles and rates of links 1 to 4, every 0.1 s for TENTHS tenths of a second, in SI units.
 *
 * Method: Gragg's midpoint rule, extrapolated at a fixed order, with step control (Hairer, Norsett, Wanner, Solving ODEs I, II.9).
 * A step ends at a change of the piece of a law (stop, contact), so that the integrand is analytic within each step.
 */
#include "machine.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { COLUMNS = 13, SIZE = 2 * MAX_N };

static real tolerance;

/* Extrapolates over 2, 4, ... substeps in h; returns the difference of the last two columns relative to 1 + |y|. */
static real step(const real *y, real h, real *out) {
    real former[COLUMNS][SIZE], row[COLUMNS][SIZE], slope[SIZE], d[SIZE], old[SIZE], error = 0;
    int size = 2 * n;
    derivative(y, slope);
    for (int j = 0; j < COLUMNS; j++) {
        int count = 2 * (j + 1);
        real part = h / count;
        memcpy(former, row, sizeof row);
        memcpy(old, y, sizeof(real) * size);
        for (int i = 0; i < size; i++) row[0][i] = y[i] + part * slope[i];
        for (int s = 1; s < count; s++) {
            derivative(row[0], d);
            for (int i = 0; i < size; i++) {
                real next = old[i] + 2 * part * d[i];
                old[i] = row[0][i];
                row[0][i] = next;
            }
        }
        for (int k = 1; k <= j; k++) { /* Aitken and Neville */
            real ratio = (real)(j + 1) / (j + 1 - k);
            for (int i = 0; i < size; i++) row[k][i] = row[k - 1][i] + (row[k - 1][i] - former[k - 1][i]) / (ratio * ratio - 1);
        }
    }
    for (int i = 0; i < size; i++) {
        out[i] = row[COLUMNS - 1][i];
        real difference = fabsq(out[i] - row[COLUMNS - 2][i]) / (1 + fabsq(out[i]));
        if (!finiteq(difference)) return HUGE_VALQ;
        error = fmaxq(error, difference);
    }
    return error;
}

/* A switch other than `except` on the wrong side at y for its piece, or -1. */
static int crossed(const real *y, int except) {
    real g[SWITCHES];
    switches(y, g);
    for (int i = 0; i < SWITCHES; i++)
        if (i != except && (g[i] > 0) != piece[i]) return i;
    return -1;
}

static real switch_after(const real *y, real h, int i, real *out) {
    real g[SWITCHES];
    step(y, h, out);
    switches(out, g);
    return g[i];
}

/* The step to the zero of switch i, which is crossed within h, by the Illinois form of regula falsi; writes the state there to out. */
static real to_zero(const real *y, real h, int i, real *out) {
    real g[SWITCHES], low = 0, high = h, at_low, at_high = switch_after(y, h, i, out), middle = h;
    switches(y, g);
    at_low = g[i];
    for (int side = 0, turns = 0; turns < 100; turns++) {
        middle = (low * at_high - high * at_low) / (at_high - at_low);
        real value = switch_after(y, middle, i, out);
        if (fabsq(value) < 1e-28Q) break; /* above the round-off of the stiffest switch, below the required agreement */
        if ((value > 0) == (at_high > 0)) {
            high = middle, at_high = value;
            if (side == 1) at_low /= 2;
            side = 1;
        } else {
            low = middle, at_low = value;
            if (side == -1) at_high /= 2;
            side = -1;
        }
    }
    return middle;
}

/* The step to the first crossing within h; flips its switch, because its sign at the crossing is round-off. */
static real to_crossing(const real *y, real h, real *out) {
    int first = -1;
    for (int i; (i = crossed(out, first)) >= 0; first = i) h = to_zero(y, h, i, out);
    piece[first] = !piece[first];
    return h;
}

/* Advances y by exactly `duration` with constant inputs. */
static void advance(real *y, real duration) {
    static real h = 1e-5Q;
    /* A saturated servo is constant to the last digit: longer steps would pass over the time at which it changes. */
    const real longest = servo ? 2e-4Q : 2e-3Q;
    static long steps;
    real t = 0, out[SIZE];
    while (t < duration) {
        real trial = fminq(fminq(h, longest), duration - t);
        real error = step(y, trial, out);
        real factor = powq(tolerance / fmaxq(error, 1e-3Q * tolerance), 1.0Q / (2 * COLUMNS - 1)) * 0.9Q;
        h = trial < h && factor > 1 && error < tolerance ? h : trial * fmaxq(fminq(factor, 3), 0.2Q);
        if (error > tolerance) continue;
        if (crossed(out, -1) >= 0) {
            trial = to_crossing(y, trial, out);
            t += trial;
        } else {
            t = trial == duration - t ? duration : t + trial;
        }
        memcpy(y, out, sizeof(real) * 2 * n);
        steps++;
    }
    fprintf(stderr, "\r%ld steps", steps);
}

static void print(int tenths, const real *y) {
    real tip[2], row[10];
    char text[64];
    tip_of(y, tip);
    for (int i = 0; i < 2; i++) row[i] = tip[i];
    for (int i = 0; i < LINKS; i++) row[2 + i] = y[TH(i)], row[6 + i] = y[n + TH(i)];
    printf("%d.%d", tenths / 10, tenths % 10);
    for (int i = 0; i < 10; i++) {
        quadmath_snprintf(text, sizeof text, "%.33Qg", row[i]);
        printf(",%s", text);
    }
    printf("\n");
    fflush(stdout);
}

/* The passive angles and rates that close the loop; the tip is to the left (assembly +1) or right of the arrow between the elbows.
 * With both distal links in one line (a direct singularity), where paper scenes start, the tip is on the arrow to the last digit: the
 * difference of squares is written as a product. Such a start must be at rest, because rates are divided by det. */
static void start(real *y) {
    real theta[LINKS] = { theta_start[0], 0, 0, theta_start[1] }, omega[LINKS] = { omega_start[0], 0, 0, omega_start[1] };
    real ax = length[0] * cosq(theta[0]), ay = length[0] * sinq(theta[0]);
    real bx = base + length[3] * cosq(theta[3]), by = length[3] * sinq(theta[3]);
    real dx = bx - ax, dy = by - ay, distance = hypotq(dx, dy);
    real along = distance / 2 + (length[1] - length[2]) * (length[1] + length[2]) / (2 * distance);
    real across = assembly * sqrtq((length[1] - along) * (length[1] + along));
    real x = ax + (along * dx - across * dy) / distance, yy = ay + (along * dy + across * dx) / distance;
    theta[1] = atan2q(yy - ay, x - ax);
    theta[2] = atan2q(yy - by, x - bx);
    /* Elbow velocity plus distal rate times arm, the same for both legs: two equations for two rates. */
    real ux = x - ax, uy = yy - ay, wx = x - bx, wy = yy - by;
    real gx = -omega[3] * by + omega[0] * ay, gy = omega[3] * (bx - base) - omega[0] * ax;
    real det = -uy * wx + ux * wy;
    if (gx != 0 || gy != 0) {
        omega[1] = (gx * wx + gy * wy) / det;
        omega[2] = (gx * ux + gy * uy) / det;
    }
    place(theta, omega, y);
}

int main(int argc, char **argv) {
    real y[SIZE], g[SWITCHES];
    if (argc != 3) {
        fprintf(stderr, "usage: midpoint TENTHS TOLERANCE < scene\n");
        return 2;
    }
    int tenths = atoi(argv[1]);
    tolerance = strtoflt128(argv[2], NULL);
    read_scene();
    start(y);
    switches(y, g);
    for (int i = 0; i < SWITCHES; i++) piece[i] = g[i] > 0;
    print(0, y);
    int holds = signals > 0 ? 100 : 1; /* pieces of a tenth of a second: changing inputs are constant for 1 ms */
    for (int i = 1; i <= tenths; i++) {
        for (int k = 0; k < holds; k++) {
            read_signals();
            join(y);
            advance(y, 0.1Q / holds);
        }
        print(i, y);
    }
    fprintf(stderr, "\n");
    return 0;
}
