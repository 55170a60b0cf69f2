/* Calls of the random walk: instantiation, modes, log, steps, status. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "walk.h"

static const unsigned PROBLEMS = 1u << fmi2Warning | 1u << fmi2Discard | 1u << fmi2Error | 1u << fmi2Fatal;
static const unsigned EVENTS = 1u << fmi2OK;

void appear(Slave *s) {
    const bool logging_on = one_in(2);
    fmi2CallbackFunctions functions = callbacks(&s->log);
    memset(s, 0, sizeof *s);
    s->log.name = "walker";
    switch (below(12)) {
    case 0:
        REQUIRE(!fmi2.Instantiate("walker", fmi2CoSimulation, guid, "", NULL, fmi2False, fmi2True), "null callbacks accepted");
        return;
    case 1:
        REQUIRE(!fmi2.Instantiate("walker", (fmi2Type)(one_in(2) ? 2 : -1), guid, NULL, &functions, fmi2False, fmi2True),
                "another kind accepted");
        break;
    case 2:
        REQUIRE(!fmi2.Instantiate("walker", fmi2CoSimulation, "{of another unit}", "", &functions, fmi2True, fmi2True), "GUID accepted");
        break;
    case 3:
        REQUIRE(!fmi2.Instantiate("walker", fmi2CoSimulation, NULL, "", &functions, fmi2False, fmi2True), "null GUID accepted");
        break;
    case 4:
        s->log.name = "";
        REQUIRE(!fmi2.Instantiate(one_in(2) ? "" : NULL, fmi2CoSimulation, guid, "", &functions, fmi2False, fmi2True), "no name accepted");
        break;
    default:
        s->life.kind = one_in(2) ? fmi2ModelExchange : fmi2CoSimulation;
        s->component = instantiate_as(s->life.kind, &s->log, guid, logging_on);
        REQUIRE(s->component && s->log.lines == 0, "fmi2Instantiate: %s", s->log.text);
        s->wanted = PROBLEMS | (logging_on ? EVENTS : 0);
        serialize(s, &s->now);
        if (fresh[s->life.kind].size == 0) fresh[s->life.kind] = s->now;
        REQUIRE(same(&s->now, &fresh[s->life.kind]), "a new instance differs from the first one");
        return;
    }
    REQUIRE(s->log.lines == 1 && s->log.status == fmi2Error && strncmp(s->log.text, "fmi2Instantiate: ", 17) == 0,
            "a refused instantiation: %d lines: %s", s->log.lines, s->log.text);
}

void disappear(Slave *s) {
    begin(s);
    fmi2.FreeInstance(s->component);
    REQUIRE(s->log.lines == 0, "fmi2FreeInstance: %s", s->log.text);
    s->component = NULL;
}

static void set_debug_logging(Slave *s) {
    static const fmi2String names[] = {"logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal"};
    const fmi2String unknown[] = {"logEvents", "logSql 100%s"}, nothing[] = {NULL};
    const bool on = !one_in(4);
    const size_t n = below(3), from = below(4);
    begin(s);
    switch (below(6)) {
    case 0:
        judge(s, SET_DEBUG_LOGGING, fmi2.SetDebugLogging(s->component, on, 2, unknown), REFUSED);
        return;
    case 1:
        judge(s, SET_DEBUG_LOGGING, fmi2.SetDebugLogging(s->component, on, 1, one_in(2) ? nothing : NULL), REFUSED);
        return;
    default:
        break;
    }
    const fmi2Status status = fmi2.SetDebugLogging(s->component, on, n, n ? &names[from] : NULL);
    /* The categories stand in the order of the statuses. */
    s->wanted = !on ? 0 : n == 0 ? PROBLEMS | EVENTS : ((1u << n) - 1) << from;
    judge(s, SET_DEBUG_LOGGING, status, DONE);
}

static void setup_experiment(Slave *s) {
    static const double starts[] = {0.0, 0.0, 0.0, 1.5, -3.0, 1e6};
    double begins = starts[below(6)], stop = begins + uniform(0.0, 0.2);
    bool ends = one_in(3);
    const bool wrong = one_in(4), tolerance = one_in(4);
    if (wrong) {
        switch (below(3)) {
        case 0: begins = one_in(2) ? NAN : INFINITY; break;
        case 1: ends = true, stop = begins - 0.1; break;
        default: ends = true, stop = one_in(2) ? NAN : -INFINITY; break;
        }
    }
    begin(s);
    const fmi2Status status = fmi2.SetupExperiment(s->component, tolerance, 1e-6, begins, ends, ends ? stop : NAN);
    if (judge(s, SETUP_EXPERIMENT, status, wrong ? REFUSED : DONE)) {
        s->life.experiment = true, s->life.ends = ends, s->life.point = begins, s->life.stop = stop;
    }
}

void despair(Slave *s) {
    set(s->component, "solver.method", one_in(2) ? 1 : 2);
    set(s->component, "solver.adaptive", fmi2False);
    set(s->component, "solver.maxIterations", 1);
    set(s->component, "friction.enabled", one_in(2));
    set(s->component, "solver.stepSize", 0.1);
    set(s->component, "init.theta[2]", 2.0);
    set(s->component, "init.omega[1]", 5.0);
    serialize(s, &s->now);
}

static void change_mode(Slave *s, Call call) {
    fmi2Status (*function)(fmi2Component) = call == ENTER_INITIALIZATION  ? fmi2.EnterInitializationMode
                                            : call == EXIT_INITIALIZATION ? fmi2.ExitInitializationMode
                                            : call == TERMINATE           ? fmi2.Terminate
                                                                          : fmi2.CancelStep;
    static const State next[] = {[ENTER_INITIALIZATION] = INITIALIZATION, [EXIT_INITIALIZATION] = COMPLETE, [TERMINATE] = TERMINATED};
    int possible = DONE;
    if (call == ENTER_INITIALIZATION && !s->life.experiment) possible = REFUSED;
    /* The set values may give an impossible machine. */
    if (call == EXIT_INITIALIZATION) possible = DONE | REFUSED;
    begin(s);
    if (judge(s, call, function(s->component), possible)) {
        s->life.state = next[call];
        if (call == EXIT_INITIALIZATION) s->life.tuned = false;
    }
}

static void reset(Slave *s) {
    begin(s);
    if (judge(s, RESET, fmi2.Reset(s->component), DONE)) {
        REQUIRE(same(&s->now, &fresh[s->life.kind]), "a reset instance is not a fresh one, byte for byte");
        s->life = (Life){.kind = s->life.kind};
    }
}

/* The time from the status function. */
static void judge_time(Slave *s) {
    double time = NAN;
    REQUIRE(fmi2.GetRealStatus(s->component, fmi2LastSuccessfulTime, &time) == fmi2OK && time == s->life.point,
            "fmi2LastSuccessfulTime is %.17g, must be %.17g", time, s->life.point);
}

/* A step from a stored state into `bytes`. */
static fmi2Status step_from(Slave *s, fmi2FMUstate from, double size, Bytes *bytes) {
    REQUIRE(fmi2.SetFMUstate(s->component, from) == fmi2OK, "fmi2SetFMUstate: %s", s->log.text);
    const fmi2Status status = fmi2.DoStep(s->component, s->life.point, size, fmi2True);
    serialize(s, bytes);
    return status;
}

/* A discarded step leaves the state from before it: a short next step from either state gives the same bytes. */
static void judge_rollback(Slave *s, fmi2FMUstate before, double size) {
    static Bytes from_here, from_before;
    fmi2FMUstate here = NULL;
    REQUIRE(fmi2.GetFMUstate(s->component, &here) == fmi2OK, "fmi2GetFMUstate: %s", s->log.text);
    const fmi2Status first = step_from(s, here, size, &from_here), second = step_from(s, before, size, &from_before);
    REQUIRE(first == second && same(&from_here, &from_before), "a discarded step has left its traces");
    REQUIRE(fmi2.SetFMUstate(s->component, here) == fmi2OK, "fmi2SetFMUstate: %s", s->log.text);
    REQUIRE(fmi2.FreeFMUstate(s->component, &here) == fmi2OK, "fmi2FreeFMUstate: %s", s->log.text);
}

void do_step(Slave *s) {
    static Bytes again;
    double point = s->life.point, size = 1e-3;
    /* At most ten macro steps, and at most 20 ms: the walk is about calls, not about long motions. */
    if (legal(s, DO_STEP)) {
        static const double multiples[] = {1, 1, 1, 2, 3, 10, 0.3, 1.7};
        size = fmin(get(s->component, "solver.stepSize") * multiples[below(8)], one_in(3) ? 0.2 : 0.02);
    }
    int possible = DONE | DISCARDED | (s->life.tuned ? REFUSED : 0);
    if (s->life.ends) {
        /* At the end, rounding is accepted: up to 1e-9 of the clock, but at most a hundredth of the step or the rounding of doubles there. Near this
         * limit either answer is right. */
        const double excess = point + size - s->life.stop, last = fabs(s->life.stop);
        const double part = fmin(1e-9 * fmax(last, size), 0.01 * size), rounding = fmin(fmax(part, 4 * DBL_EPSILON * last), 0.5 * size);
        if (excess > 0.0) possible |= REFUSED;
        if (excess > 1.1 * rounding) possible = REFUSED;
    }
    /* Too short for the clock. */
    if (!(point + size > point)) possible = REFUSED;
    if (one_in(5) || (s->life.far && !one_in(100))) {
        static const double sizes[] = {0.0, -1e-3, NAN, INFINITY, -INFINITY, 1e300};
        if (one_in(2))
            size = sizes[below(6)];
        else
            point = one_in(2) ? NAN : point + fmax(3 * size, 1.0) * (one_in(2) ? 1 : -1);
        possible = REFUSED;
    }
    fmi2FMUstate before = NULL;
    REQUIRE(fmi2.GetFMUstate(s->component, &before) == fmi2OK, "fmi2GetFMUstate: %s", s->log.text);
    begin(s);
    const fmi2Status status = fmi2.DoStep(s->component, point, size, one_in(2));
    const State state = s->life.state;
    if (status == fmi2OK && legal(s, DO_STEP)) s->life.point += size;
    const bool done = judge(s, DO_STEP, status, possible);
    if (done) {
        s->life.state = COMPLETE, s->life.tuned = false;
        judge_time(s);
        if (one_in(4)) {
            s->life.point = point;
            REQUIRE(step_from(s, before, size, &again) == fmi2OK && same(&s->now, &again), "the same step again ends elsewhere");
            s->life.point += size;
        }
    } else if (status == fmi2Discard && s->life.state == state && legal(s, DO_STEP)) {
        /* Unless judge() has reset the instance since. */
        s->life.state = FAILED;
        judge_time(s);
        judge_rollback(s, before, size / 1024);
    }
    REQUIRE(fmi2.FreeFMUstate(s->component, &before) == fmi2OK, "fmi2FreeFMUstate: %s", s->log.text);
}

void ask_status(Slave *s, Call call) {
    static const int kinds[] = {fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated, -1, 4};
    const int kind = kinds[below(6)];
    const bool known = kind >= fmi2DoStepStatus && kind <= fmi2Terminated, nowhere = one_in(8);
    double real = -7;
    int whole = -7;
    fmi2Status status = fmi2Pending, last = fmi2Pending;
    fmi2String text = "untouched";
    int possible = known ? DISCARDED : REFUSED;
    begin(s);
    switch (call) {
    case GET_STATUS: status = fmi2.GetStatus(s->component, (fmi2StatusKind)kind, &last); break;
    case GET_INTEGER_STATUS: status = fmi2.GetIntegerStatus(s->component, (fmi2StatusKind)kind, &whole); break;
    case GET_STRING_STATUS: status = fmi2.GetStringStatus(s->component, (fmi2StatusKind)kind, &text); break;
    case GET_REAL_STATUS:
        status = fmi2.GetRealStatus(s->component, (fmi2StatusKind)kind, nowhere ? NULL : &real);
        if (kind == fmi2LastSuccessfulTime) possible = DONE;
        if (nowhere) possible = REFUSED;
        REQUIRE(status != fmi2OK || real == s->life.point, "fmi2LastSuccessfulTime is %.17g, must be %.17g", real, s->life.point);
        break;
    default:
        status = fmi2.GetBooleanStatus(s->component, (fmi2StatusKind)kind, nowhere ? NULL : &whole);
        if (kind == fmi2Terminated) possible = DONE;
        if (nowhere) possible = REFUSED;
        REQUIRE(status != fmi2OK || whole == fmi2False, "fmi2Terminated is %d", whole);
        whole = -7;
        break;
    }
    REQUIRE(whole == -7 && last == fmi2Pending && strcmp(text, "untouched") == 0, "%s has written, status %d", rules[call].name, status);
    REQUIRE(status == fmi2OK || real == -7, "%s has written, status %d", rules[call].name, status);
    judge(s, call, status, possible);
}

/* Calls with an invalid instance. */
static void call_nobody(void) {
    double value = 0;
    const Variable *v = variable("tau[1]");
    REQUIRE(fmi2.DoStep(NULL, 0, 1e-3, fmi2True) == fmi2Error && fmi2.Reset(NULL) == fmi2Error &&
                fmi2.SetReal(NULL, &v->reference, 1, &value) == fmi2Error && fmi2.GetFMUstate(NULL, NULL) == fmi2Error &&
                fmi2.CancelStep(NULL) == fmi2Error,
            "a null component is accepted");
    fmi2.FreeInstance(NULL);
    REQUIRE(strcmp(fmi2.GetVersion(), "2.0") == 0 && strcmp(fmi2.GetTypesPlatform(), "default") == 0, "version or platform");
}

void make(Slave *s, Call call) {
    if (one_in(100)) call_nobody();
    switch (call) {
    case SET_DEBUG_LOGGING: set_debug_logging(s); break;
    case SETUP_EXPERIMENT: setup_experiment(s); break;
    case ENTER_INITIALIZATION:
    case EXIT_INITIALIZATION:
    case TERMINATE:
    case CANCEL_STEP: change_mode(s, call); break;
    case RESET: reset(s); break;
    case GET_REAL: get_values(s, call, REAL); break;
    case GET_INTEGER: get_values(s, call, INTEGER); break;
    case GET_BOOLEAN: get_values(s, call, BOOLEAN); break;
    case SET_REAL: set_values(s, call, REAL); break;
    case SET_INTEGER: set_values(s, call, INTEGER); break;
    case SET_BOOLEAN: set_values(s, call, BOOLEAN); break;
    case GET_STRING:
    case SET_STRING: strings(s, call); break;
    case GET_STATE:
    case SET_STATE:
    case FREE_STATE:
    case SERIALIZED_SIZE:
    case SERIALIZE:
    case DESERIALIZE: states(s, call); break;
    case GET_DIRECTIONAL_DERIVATIVE: differentiate(s); break;
    case SET_INPUT_DERIVATIVES:
    case GET_OUTPUT_DERIVATIVES: derivatives(s, call); break;
    case DO_STEP: do_step(s); break;
    case ENTER_EVENT:
    case NEW_DISCRETE_STATES:
    case ENTER_CONTINUOUS_TIME:
    case COMPLETED_STEP:
    case SET_TIME:
    case SET_CONTINUOUS_STATES:
    case GET_DERIVATIVES:
    case GET_INDICATORS:
    case GET_CONTINUOUS_STATES:
    case GET_NOMINALS: exchange(s, call); break;
    default: ask_status(s, call); break;
    }
}
