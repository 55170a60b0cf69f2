// SUNDIALS as a peer of `cargo xtask peers`: CVODE on the equations in the four link angles with the multipliers eliminated, IDA on
// the same equations with both multipliers as unknowns (index 1). machine.py has the same formulas.
//
//     peer-sundials METHOD TOLERANCE LOADS ANGLE ANGLE ANGLE ANGLE
//
// METHOD `adams` or `bdf` (CVODE), `ida`; LOADS `bare`, or `loaded` with the servos and the friction of machine.py. Reads times,
// one per line; answers each with the processor time so far, s, four angles and four rates.
#include <cvode/cvode.h>
#include <ida/ida.h>
#include <math.h>
#include <nvector/nvector_serial.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sunlinsol/sunlinsol_dense.h>
#include <sunmatrix/sunmatrix_dense.h>
#include <sunnonlinsol/sunnonlinsol_fixedpoint.h>
#include <time.h>

static const double LENGTH = 0.21, COM = 0.105, MASS = 0.017, INERTIA = 6.23e-5, GRAVITY = 9.81;
#define NEAR (INERTIA + MASS * COM * COM + MASS * LENGTH * LENGTH)
#define FAR (INERTIA + MASS * COM * COM)
#define COUPLING (MASS * COM * LENGTH)
// Indices of each leg's proximal and distal link angle.
static const int LEGS[2][2] = {{0, 1}, {3, 2}};

// Servos on links 1 and 4, friction in all joints.
static int loaded;
static const double REFERENCES[2] = {1.2, 2.4}, KP = 0.2, KD = 5e-4, LIMIT = 0.1;
static const double COULOMB = 1e-3, BREAKAWAY = 1.2e-3, BREAKAWAY_RATE = 0.1, VISCOUS = 1e-4;
static const int JOINTS[5][2] = {{0, -1}, {1, 0}, {1, 2}, {2, 3}, {3, -1}};

static double friction(double rate) {
    const double u = rate / (sqrt(2) * BREAKAWAY_RATE);
    const double stribeck = sqrt(2 * exp(1)) * (BREAKAWAY - COULOMB) * u * exp(-u * u);
    return -(stribeck + COULOMB * tanh(rate / (BREAKAWAY_RATE / 10)) + VISCOUS * rate);
}

static void add_loads(const double *y, double *f) {
    for (int j = 0; j < 5; ++j) {
        const int first = JOINTS[j][0], second = JOINTS[j][1];
        const double torque = friction(y[4 + first] - (second < 0 ? 0 : y[4 + second]));
        f[first] += torque;
        if (second >= 0) f[second] -= torque;
    }
    for (int motor = 0; motor < 2; ++motor) {
        const int link = 3 * motor;
        f[link] += LIMIT * tanh((KP * (REFERENCES[motor] - y[link]) - KD * y[4 + link]) / LIMIT);
    }
}

// Off-diagonal masses of the legs, forces with centrifugal terms, closure Jacobian by x and y, right sides of J a = c.
typedef struct {
    double b[2], f[4], jx[4], jy[4], c[2];
} Terms;

static void terms(const double *y, Terms *t) {
    double s[4], k[4];
    t->c[0] = t->c[1] = 0;
    for (int i = 0; i < 4; ++i) {
        const double sign = i < 2 ? LENGTH : -LENGTH, w2 = y[4 + i] * y[4 + i];
        s[i] = sin(y[i]);
        k[i] = cos(y[i]);
        t->jx[i] = -sign * s[i];
        t->jy[i] = sign * k[i];
        t->c[0] += sign * k[i] * w2;
        t->c[1] += sign * s[i] * w2;
    }
    for (int leg = 0; leg < 2; ++leg) {
        const int near = LEGS[leg][0], far = LEGS[leg][1];
        const double turn = COUPLING * (s[near] * k[far] - k[near] * s[far]);
        t->b[leg] = COUPLING * (k[near] * k[far] + s[near] * s[far]);
        t->f[near] = -turn * y[4 + far] * y[4 + far] - MASS * GRAVITY * (COM + LENGTH) * k[near];
        t->f[far] = turn * y[4 + near] * y[4 + near] - MASS * GRAVITY * COM * k[far];
    }
    if (loaded) add_loads(y, t->f);
}

static void by_mass(const Terms *t, const double *f, double *out) {
    for (int leg = 0; leg < 2; ++leg) {
        const int near = LEGS[leg][0], far = LEGS[leg][1];
        const double over = 1 / (NEAR * FAR - t->b[leg] * t->b[leg]);
        out[near] = (FAR * f[near] - t->b[leg] * f[far]) * over;
        out[far] = (NEAR * f[far] - t->b[leg] * f[near]) * over;
    }
}

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]; }

// Accelerations, and the two forces at the tip that keep the loop closed.
static void solve(const double *y, double *a, double *force) {
    Terms t;
    double free[4], by_x[4], by_y[4];
    terms(y, &t);
    by_mass(&t, t.f, free);
    by_mass(&t, t.jx, by_x);
    by_mass(&t, t.jy, by_y);
    const double xx = dot(t.jx, by_x), xy = dot(t.jx, by_y), yy = dot(t.jy, by_y);
    const double rx = t.c[0] - dot(t.jx, free), ry = t.c[1] - dot(t.jy, free), det = xx * yy - xy * xy;
    force[0] = (yy * rx - xy * ry) / det;
    force[1] = (xx * ry - xy * rx) / det;
    for (int i = 0; i < 4; ++i) a[i] = free[i] + force[0] * by_x[i] + force[1] * by_y[i];
}

static int right_side(realtype time, N_Vector state, N_Vector rates, void *none) {
    const double *y = N_VGetArrayPointer(state);
    double *out = N_VGetArrayPointer(rates), force[2];
    (void)time, (void)none;
    memcpy(out, y + 4, 4 * sizeof *y);
    solve(y, out + 4, force);
    return 0;
}

static int residual(realtype time, N_Vector state, N_Vector rates, N_Vector result, void *none) {
    const double *y = N_VGetArrayPointer(state), *yp = N_VGetArrayPointer(rates);
    double *out = N_VGetArrayPointer(result);
    Terms t;
    (void)time, (void)none;
    terms(y, &t);
    for (int i = 0; i < 4; ++i) out[i] = yp[i] - y[4 + i];
    for (int leg = 0; leg < 2; ++leg) {
        const int near = LEGS[leg][0], far = LEGS[leg][1];
        out[4 + near] = NEAR * yp[4 + near] + t.b[leg] * yp[4 + far] - t.f[near];
        out[4 + far] = FAR * yp[4 + far] + t.b[leg] * yp[4 + near] - t.f[far];
    }
    for (int i = 0; i < 4; ++i) out[4 + i] -= y[8] * t.jx[i] + y[9] * t.jy[i];
    out[8] = dot(t.jx, yp + 4) - t.c[0];
    out[9] = dot(t.jy, yp + 4) - t.c[1];
    return 0;
}

static double processor_time(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

// Exits with the name of the function that failed.
static void check(int flag, const char *function) {
    if (flag < 0) fprintf(stderr, "%s failed with %d\n", function, flag), exit(1);
}

int main(int argc, char **argv) {
    if (argc != 8) return fprintf(stderr, "seven arguments are needed\n"), 2;
    const int with_ida = !strcmp(argv[1], "ida"), bdf = !strcmp(argv[1], "bdf"), size = with_ida ? 10 : 8;
    const double tolerance = atof(argv[2]);
    loaded = !strcmp(argv[3], "loaded");
    const long no_limit = 1000000000;
    SUNContext context;
    check(SUNContext_Create(NULL, &context), "SUNContext_Create");
    N_Vector state = N_VNew_Serial(size, context), rates = N_VClone(state);
    double *y = N_VGetArrayPointer(state), *yp = N_VGetArrayPointer(rates), spent = 0, until, reached;
    memset(y, 0, size * sizeof *y);
    memset(yp, 0, size * sizeof *yp);
    for (int i = 0; i < 4; ++i) y[i] = atof(argv[4 + i]);
    void *solver;
    if (with_ida) {
        solve(y, yp + 4, y + 8);
        solver = IDACreate(context);
        check(IDAInit(solver, residual, 0, state, rates), "IDAInit");
        check(IDASStolerances(solver, tolerance, tolerance), "IDASStolerances");
        SUNMatrix matrix = SUNDenseMatrix(size, size, context);
        check(IDASetLinearSolver(solver, SUNLinSol_Dense(state, matrix, context), matrix), "IDASetLinearSolver");
        // Multipliers are only as accurate as the accelerations, so their errors do not control the step.
        N_Vector kind = N_VClone(state);
        N_VConst(1, kind);
        N_VGetArrayPointer(kind)[8] = N_VGetArrayPointer(kind)[9] = 0;
        check(IDASetId(solver, kind), "IDASetId");
        check(IDASetSuppressAlg(solver, 1), "IDASetSuppressAlg");
        check(IDASetMaxNumSteps(solver, no_limit), "IDASetMaxNumSteps");
    } else {
        solver = CVodeCreate(bdf ? CV_BDF : CV_ADAMS, context);
        check(CVodeInit(solver, right_side, 0, state), "CVodeInit");
        check(CVodeSStolerances(solver, tolerance, tolerance), "CVodeSStolerances");
        if (bdf) {
            SUNMatrix matrix = SUNDenseMatrix(size, size, context);
            check(CVodeSetLinearSolver(solver, SUNLinSol_Dense(state, matrix, context), matrix), "CVodeSetLinearSolver");
        } else {
            check(CVodeSetNonlinearSolver(solver, SUNNonlinSol_FixedPoint(state, 0, context)), "CVodeSetNonlinearSolver");
        }
        check(CVodeSetMaxNumSteps(solver, no_limit), "CVodeSetMaxNumSteps");
    }
    while (scanf("%lf", &until) == 1) {
        const double clock = processor_time();
        if (with_ida) {
            check(IDASolve(solver, until, &reached, state, rates, IDA_NORMAL), "IDASolve");
        } else {
            check(CVode(solver, until, state, &reached, CV_NORMAL), "CVode");
        }
        spent += processor_time() - clock;
        printf("%.17g", spent);
        for (int i = 0; i < 8; ++i) printf(" %.17g", y[i]);
        puts("");
        fflush(stdout);
    }
    return 0;
}
