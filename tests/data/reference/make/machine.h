/* The five-bar in Cartesian coordinates: what machine.c gives to midpoint.c. */
#include <quadmath.h>
#include <stdbool.h>

typedef __float128 real;

enum { LINKS = 4, BODIES = 5, MAX_N = 14, MAX_M = 12, BUFFERS = 5, SWITCHES = 3 * BUFFERS };

/* Indices of coordinates; the payload is body 4 and has no angle. */
#define X(body) (3 * (body))
#define Y(body) (3 * (body) + 1)
#define TH(link) (3 * (link) + 2)

/* Number of coordinates and constraints: 14 and 12 with payload, 12 and 10 without. */
extern int n, m;

/* Data of the start, SI units; assembly is +1 for plus, -1 for minus. */
extern real base, length[LINKS], theta_start[2], omega_start[2];
extern int assembly;

/* Whether the scene has servos. */
extern bool servo;

/* How many inputs change with time. */
extern int signals;

/* Reads the scene from standard input, up to its line "signals COUNT". */
void read_scene(void);

/* Reads the next values of the inputs that change; held from now on. */
void read_signals(void);

/* The payload becomes what read_signals has read, and y with it: mass at rest joins in an inelastic impact, other mass joins or leaves
 * without one. */
void join(real *y);

/* Coordinates and velocities y from angles and rates of the links. */
void place(const real theta[LINKS], const real omega[LINKS], real *y);

/* The tip. */
void tip_of(const real *y, real tip[2]);

/* On which piece of its law each buffer is (see switches). A derivative keeps to these pieces. */
extern bool piece[SWITCHES];

/* The functions whose signs say on which piece of its law a buffer is: touching, beyond the ramp, not held back by the damper. */
void switches(const real *y, real g[SWITCHES]);

/* Velocities and accelerations. */
void derivative(const real *y, real *dy);
