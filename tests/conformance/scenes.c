#include "master.h"

#include <math.h>

/* Reals, integers and booleans alike; `solver.method`: 1 i3alp, 2 i3alpPrinted, 3 rk4, 4 dop853, 5 i3alpConserving, 6 automatic. */
#define BENT {"init.theta[2]", 2.0944}
#define EVERY_EFFECT                                                                                                         \
    BENT, {"rotor.enabled", 1}, {"payload.enabled", 1}, {"viscous.enabled", 1}, {"friction.enabled", 1}, {"spring.enabled", 1}, \
        {"stop.enabled", 1}, {"contact.enabled", 1}, {"contact.offset", 0.1}, {"servo.enabled", 1}, {"servo.theta[1]", 2.0},   \
        {"servo.theta[2]", 0.7}

const Scene scenes[] = {
    {"i3alp, bare", {BENT}, 1e-3},
    {"i3alp, links without inertia", {BENT, {"link[2].inertia", 1e-9}}, 1e-3},
    {"i3alp, fixed step", {BENT, {"solver.adaptive", 0}}, 1e-3},
    {"i3alp, every effect", {EVERY_EFFECT}, 2e-3},
    {"i3alp, every effect, fixed step", {EVERY_EFFECT, {"solver.adaptive", 0}, {"solver.stepSize", 1e-4}}, 1e-3},
    {"i3alp, tight", {BENT, {"solver.errorTolerance", 1e-11}}, 1e-3},
    {"i3alp, off the grid", {BENT}, 1.0 / 600},
    {"i3alpPrinted", {BENT, {"solver.method", 2}}, 1e-3},
    {"i3alpPrinted, every effect", {EVERY_EFFECT, {"solver.method", 2}}, 1e-3},
    {"rk4", {BENT, {"solver.method", 3}}, 1e-3},
    {"rk4, every effect", {EVERY_EFFECT, {"solver.method", 3}, {"solver.stepSize", 1e-4}}, 1e-3},
    {"dop853", {BENT, {"solver.method", 4}}, 1e-3},
    {"dop853, every effect", {EVERY_EFFECT, {"solver.method", 4}}, 1e-3},
    {"i3alpConserving", {BENT, {"solver.method", 5}}, 1e-3},
    {"i3alpConserving, every effect", {EVERY_EFFECT, {"solver.method", 5}}, 1e-3},
    {"automatic", {BENT, {"solver.method", 6}}, 1e-3},
    {"automatic, every effect", {EVERY_EFFECT, {"solver.method", 6}}, 1e-3},
    {"automatic, stiff", {BENT, {"solver.method", 6}, {"servo.enabled", 1}, {"servo.kp[1]", 2000}, {"servo.kd[1]", 20}, {"servo.theta[1]", 1.6}}, 1e-3},
};
const size_t scene_count = sizeof scenes / sizeof scenes[0];

void start(fmi2Component c, const Scene *scene) {
    for (size_t i = 0; scene->values[i].name; i++) set(c, scene->values[i].name, scene->values[i].value);
    REQUIRE(fmi2.SetupExperiment(c, fmi2False, 0, 0, fmi2False, 0) == fmi2OK, "%s: fmi2SetupExperiment", scene->title);
    REQUIRE(fmi2.EnterInitializationMode(c) == fmi2OK, "%s: fmi2EnterInitializationMode", scene->title);
    REQUIRE(fmi2.ExitInitializationMode(c) == fmi2OK, "%s: fmi2ExitInitializationMode", scene->title);
}

void drive(fmi2Component c, const Scene *scene, int step) {
    if (step % 3 == 1) set(c, "tau[1]", 0.01 * (step % 7));
    if (step % 10 == 5) {
        const int order = 1;
        const double rate = 0.5;
        const fmi2Status status = fmi2.SetRealInputDerivatives(c, &variable("tip.fx")->reference, 1, &order, &rate);
        REQUIRE(status == fmi2OK, "%s: fmi2SetRealInputDerivatives: status %d", scene->title, status);
    }
    if (step % 20 == 15) set(c, "gravity.g", step % 40 == 15 ? 9.0 : 9.81);
    /* A payload gains and loses mass. */
    if (step % 20 == 10) set(c, "payload.mass", step % 40 == 10 ? 0.06 : 0.05);
    const fmi2Status status = fmi2.DoStep(c, step * scene->size, scene->size, fmi2True);
    REQUIRE(status == fmi2OK, "%s: step %d: status %d", scene->title, step, status);
}
