/* Calls of the random walk: model exchange. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "walk.h"

enum { NX = 4, MOST_INDICATORS = 64 };
static const double MARK = -7.25e77;

/* Time forward and back, also past the end: an integrator may try any time. */
static void set_time(Slave *s) {
    const bool wrong = one_in(6);
    const double time = wrong ? (one_in(2) ? NAN : -INFINITY) : s->life.point + uniform(-0.01, 0.03);
    begin(s);
    if (judge(s, SET_TIME, fmi2.SetTime(s->component, time), wrong ? REFUSED : DONE)) s->life.point = time;
}

static void new_discrete_states(Slave *s) {
    const bool nowhere = one_in(8), tuned = s->life.tuned;
    fmi2EventInfo info;
    memset(&info, 0x55, sizeof info);
    const fmi2EventInfo untouched = info;
    begin(s);
    const fmi2Status status = fmi2.NewDiscreteStates(s->component, nowhere ? NULL : &info);
    if (status != fmi2OK) REQUIRE(memcmp(&info, &untouched, sizeof info) == 0, "fmi2NewDiscreteStates: status %d, and has written", status);
    /* Tuned values may break a relation, or exceed the limits of this run. */
    if (!judge(s, NEW_DISCRETE_STATES, status, nowhere ? REFUSED : DONE | (tuned ? REFUSED | DISCARDED : 0))) return;
    REQUIRE(!info.newDiscreteStatesNeeded && !info.terminateSimulation && !info.nominalsOfContinuousStatesChanged &&
                !info.nextEventTimeDefined && (tuned || !info.valuesOfContinuousStatesChanged),
            "an event asks for more");
    s->life.tuned = false;
}

static void completed_step(Slave *s) {
    const size_t nowhere = below(8);
    fmi2Boolean event = -7, end = -7;
    int possible = nowhere < 2 ? REFUSED : DONE;
    if (nowhere >= 2 && s->life.ends) {
        const double excess = s->life.point - s->life.stop, last = fabs(s->life.stop);
        const double rounding = fmax(fmin(1e-9 * fmax(last, 1.0), 1e-5), 4 * DBL_EPSILON * last);
        if (excess > 0.9 * rounding) possible |= REFUSED;
        if (excess > 1.1 * rounding) possible = REFUSED;
    }
    begin(s);
    const fmi2Status status =
        fmi2.CompletedIntegratorStep(s->component, one_in(2), nowhere == 0 ? NULL : &event, nowhere == 1 ? NULL : &end);
    REQUIRE(status == fmi2OK ? event == fmi2False && end == fmi2False : event == -7 && end == -7,
            "fmi2CompletedIntegratorStep: status %d, %d, %d", status, event, end);
    judge(s, COMPLETED_STEP, status, possible);
}

static void set_states(Slave *s) {
    double x[NX] = {0}, back[NX];
    const bool known = legal(s, SET_CONTINUOUS_STATES) &&
                       fmi2.GetContinuousStates(s->component, x, NX) == fmi2OK;
    size_t n = NX;
    int possible = DONE | DISCARDED;
    for (size_t i = 0; i < NX; i++) x[i] += uniform(-0.05, 0.05);
    if (one_in(8)) x[below(NX)] = one_in(2) ? uniform(-7.0, 7.0) : pow(10.0, uniform(0.0, fmin(largest, 12.0)));
    const bool nowhere = one_in(10);
    if (one_in(10)) n = below(NX);
    if (nowhere || n < NX) possible = REFUSED;
    if (!nowhere && n == NX && one_in(10)) x[below(NX)] = one_in(2) ? NAN : INFINITY, possible = REFUSED;
    begin(s);
    const fmi2Status status = fmi2.SetContinuousStates(s->component, nowhere ? NULL : x, n);
    if (!judge(s, SET_CONTINUOUS_STATES, status, possible)) return;
    REQUIRE(known && fmi2.GetContinuousStates(s->component, back, NX) == fmi2OK && memcmp(back, x, sizeof x) == 0,
            "continuous states are not those that were set");
}

/* The functions that fill an array. */
static void read_array(Slave *s, Call call) {
    double values[MOST_INDICATORS];
    /* As in the model description. */
    const size_t own = call == GET_INDICATORS ? 21 : NX, n = one_in(8) ? below(MOST_INDICATORS) : own;
    const bool nowhere = one_in(8);
    fmi2Status (*function)(fmi2Component, fmi2Real[], size_t) = call == GET_DERIVATIVES         ? fmi2.GetDerivatives
                                                                : call == GET_INDICATORS        ? fmi2.GetEventIndicators
                                                                : call == GET_CONTINUOUS_STATES ? fmi2.GetContinuousStates
                                                                                                : fmi2.GetNominalsOfContinuousStates;
    int possible = call == GET_NOMINALS ? DONE : may_be_computed(s);
    /* States may be no coordinates, as in a direct singularity. */
    if (call == GET_DERIVATIVES) possible |= DISCARDED;
    if (nowhere || n != own) possible = REFUSED;
    for (size_t i = 0; i < MOST_INDICATORS; i++) values[i] = MARK;
    begin(s);
    const fmi2Status status = function(s->component, nowhere ? NULL : values, n);
    for (size_t i = 0; i < MOST_INDICATORS; i++)
        REQUIRE(status == fmi2OK && i < n ? isfinite(values[i]) : values[i] == MARK, "%s: status %d, value %g of %zu", rules[call].name,
                status, values[i], i);
    if (call == GET_NOMINALS && status == fmi2OK) REQUIRE(values[0] == 1 && values[3] == 1, "nominals");
    judge(s, call, status, possible);
}

void exchange(Slave *s, Call call) {
    switch (call) {
    case ENTER_EVENT:
        begin(s);
        if (judge(s, call, fmi2.EnterEventMode(s->component), DONE)) s->life.state = EVENT;
        break;
    case ENTER_CONTINUOUS_TIME:
        begin(s);
        if (judge(s, call, fmi2.EnterContinuousTimeMode(s->component), s->life.tuned ? REFUSED : DONE)) s->life.state = CONTINUOUS;
        break;
    case NEW_DISCRETE_STATES: new_discrete_states(s); break;
    case COMPLETED_STEP: completed_step(s); break;
    case SET_TIME: set_time(s); break;
    case SET_CONTINUOUS_STATES: set_states(s); break;
    default: read_array(s, call); break;
    }
}
