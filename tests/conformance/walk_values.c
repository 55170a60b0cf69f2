/* Calls of the random walk: variables and derivatives. */
#include <math.h>
#include <string.h>

#include "walk.h"

enum { MOST = 6 };
/* Content of places that must not be written. */
static const double REAL_MARK = -7.25e77;
static const int WHOLE_MARK = -7;

/* References for one call. */
typedef struct {
    size_t n;
    const Variable *variables[MOST];
    fmi2ValueReference references[MOST];
} Pick;

/* Fault of a call; NOTHING in half of the calls. */
typedef enum { NOTHING, UNKNOWN, WRONG_TYPE, NO_REFERENCES, NO_VALUES, WRONG_VALUE, NOT_SETTABLE, FLAWS } Flaw;
static Flaw any_flaw(Flaw last) { return one_in(2) ? NOTHING : (Flaw)below((size_t)last + 1); }

/* Whether a variable is a continuous state. */
static bool is_state(const Variable *v) { return strncmp(v->name, "theta[", 6) == 0 || strncmp(v->name, "omega[", 6) == 0; }

bool may_set_states(const Slave *s) {
    return s->life.kind == fmi2ModelExchange && (s->life.state == EVENT || s->life.state == CONTINUOUS);
}

/* Whether a variable may be set in a state that allows setting (FMI 2.0.4, section 2.2.7 and the footnotes of the table). */
static bool settable(const Slave *s, const Variable *v) {
    const bool integrated = s->life.kind == fmi2ModelExchange && s->life.state == CONTINUOUS;
    return v->role == INPUT || v->role == SAMPLE || (v->role == TUNABLE && !integrated) || (v->role == FIXED && s->life.state <= INITIALIZATION) ||
           (is_state(v) && may_set_states(s));
}

static bool is_computed(const Variable *v) { return v->role == OUTPUT || v->role == LOCAL; }

/* A variable of this type, settable or not; NULL if there is none. */
static const Variable *any(const Slave *s, Type type, bool to_set) {
    for (int tries = 0; tries < 2000; tries++) {
        const Variable *v = &variables[below(variable_count)];
        if (v->type == type && (!to_set || settable(s, v))) return v;
    }
    return NULL;
}

/* A few variables of this type; none if the type has none. */
static Pick pick(const Slave *s, Type type, bool to_set, size_t n) {
    Pick p = {0};
    while (p.n < n) {
        const Variable *v = any(s, type, to_set);
        if (!v) break;
        p.variables[p.n] = v;
        p.references[p.n++] = v->reference;
    }
    return p;
}

/* Damages the last reference; false if that is impossible. */
static bool spoil(Pick *p, Type type, Flaw flaw) {
    if (flaw == NOTHING || flaw >= WRONG_VALUE) return true;
    if (p->n == 0) return false;
    if (flaw == UNKNOWN) p->references[p->n - 1] = one_in(2) ? 99999 : 0xffffffffu;
    while (flaw == WRONG_TYPE && p->variables[p->n - 1]->type == type) p->variables[p->n - 1] = &variables[below(variable_count)];
    if (flaw == WRONG_TYPE) p->references[p->n - 1] = p->variables[p->n - 1]->reference;
    return true;
}

static bool finite_within(const Variable *v, double value) { return isfinite(value) && value >= v->min && value <= v->max; }

/* An allowed value of a variable: its start, a value near it, rarely a far one. */
static double allowed_value(const Variable *v) {
    if (v->type == BOOLEAN) return (double)below(2);
    if (v->role == SAMPLE && one_in(10)) return one_in(2) ? NAN : INFINITY;
    if (v->type == INTEGER) return floor(uniform(v->min, fmin(v->max, v->min + 10) + 0.999));
    double value = v->start;
    if (one_in(2)) value = isnan(v->start) || v->start == 0.0 ? uniform(-0.5, 0.5) : v->start * uniform(0.8, 1.25);
    if (one_in(40)) value = (one_in(2) ? 1 : -1) * pow(10.0, uniform(-largest, largest));
    if (one_in(40)) value = one_in(2) ? v->min : v->max;
    if (fabs(value) > pow(10.0, largest)) value = v->start;
    return finite_within(v, value) ? value : v->start;
}

/* A forbidden value; NAN if every finite value is allowed. */
static double wrong_value(const Variable *v) {
    if (v->type == INTEGER) return one_in(2) ? v->min - 1 : v->max + 1;
    if (isfinite(v->min) && one_in(3)) return nextafter(v->min, -INFINITY);
    if (isfinite(v->max) && one_in(3)) return nextafter(v->max, INFINITY);
    return one_in(2) ? NAN : one_in(2) ? INFINITY : -INFINITY;
}

/* A continuous state near its present value, sometimes anywhere. */
static double near_state(const Slave *s, const Variable *v) {
    const double value = get(s->component, v->name) + uniform(-0.1, 0.1);
    return one_in(10) ? uniform(-7.0, 7.0) : one_in(40) ? pow(10.0, uniform(0.0, fmin(largest, 12.0))) : value;
}

/* Statuses allowed when computed values are read: before the run, the values may give an impossible machine; values may be so large that
 * no result is finite. */
int may_be_computed(const Slave *s) {
    return DONE | (s->life.state == INITIALIZATION ? REFUSED : 0) | (largest > 100 ? DISCARDED : 0);
}

static fmi2Status get_typed(const Slave *s, Type type, const fmi2ValueReference *references, size_t n, double *reals, int *wholes) {
    return type == REAL      ? fmi2.GetReal(s->component, references, n, reals)
           : type == INTEGER ? fmi2.GetInteger(s->component, references, n, wholes)
                             : fmi2.GetBoolean(s->component, references, n, wholes);
}

void get_values(Slave *s, Call call, Type type) {
    double reals[MOST];
    int wholes[MOST];
    Flaw flaw = any_flaw(NO_VALUES);
    Pick p = pick(s, type, false, below(MOST + 1));
    if (!spoil(&p, type, flaw)) flaw = NOTHING;
    for (size_t i = 0; i < MOST; i++) reals[i] = REAL_MARK, wholes[i] = WHOLE_MARK;
    bool computed = false;
    for (size_t i = 0; i < p.n; i++) computed |= is_computed(p.variables[i]);
    const fmi2ValueReference *references = flaw == NO_REFERENCES || p.n == 0 ? NULL : p.references;
    const bool nowhere = flaw == NO_VALUES || p.n == 0;
    begin(s);
    const fmi2Status status = get_typed(s, type, references, p.n, nowhere ? NULL : reals, nowhere ? NULL : wholes);
    for (size_t i = 0; i < MOST; i++) {
        if (status != fmi2OK || i >= p.n) {
            REQUIRE(reals[i] == REAL_MARK && wholes[i] == WHOLE_MARK, "%s: status %d, %zu asked for, and has written", rules[call].name,
                    status, p.n);
            continue;
        }
        const Variable *v = p.variables[i];
        const double value = type == REAL ? reals[i] : wholes[i];
        REQUIRE(isfinite(value) || v->role == SAMPLE, "%s is %g and the status fmi2OK", v->name, value);
        REQUIRE(type != INTEGER || (value >= v->min && value <= v->max), "%s is %g, must be from %g to %g", v->name, value, v->min, v->max);
        REQUIRE(type != BOOLEAN || value == fmi2False || value == fmi2True, "%s is %g", v->name, value);
    }
    judge(s, call, status, flaw == NOTHING ? computed ? may_be_computed(s) : DONE : REFUSED);
}

void set_values(Slave *s, Call call, Type type) {
    double reals[MOST] = {0}, back[MOST];
    int wholes[MOST] = {0}, whole_back[MOST];
    Flaw flaw = any_flaw(NOT_SETTABLE);
    Pick p = pick(s, type, true, below(4));
    if (!spoil(&p, type, flaw)) flaw = NOTHING;
    if (flaw == NOT_SETTABLE) {
        const Variable *v = any(s, type, false);
        if (!v || settable(s, v))
            flaw = NOTHING;
        else
            p.variables[p.n] = v, p.references[p.n++] = v->reference;
    }
    if (flaw == WRONG_VALUE && (p.n == 0 || type == BOOLEAN || p.variables[p.n - 1]->role == SAMPLE)) flaw = NOTHING;
    bool tunes = false, far = false, moves = false;
    for (size_t i = 0; i < p.n; i++) {
        const bool wrong = flaw == WRONG_VALUE && i == p.n - 1;
        const bool state = is_state(p.variables[i]) && may_set_states(s), none = is_computed(p.variables[i]) && !state;
        const double value = wrong ? wrong_value(p.variables[i]) : none ? 0.0 : state ? near_state(s, p.variables[i]) : allowed_value(p.variables[i]);
        moves |= state;
        tunes |= p.variables[i]->role == TUNABLE;
        reals[i] = value;
        far |= fabs(value) > FAR;
        if (type != REAL) wholes[i] = (int)value;
    }
    const fmi2ValueReference *references = flaw == NO_REFERENCES || p.n == 0 ? NULL : p.references;
    const bool nowhere = flaw == NO_VALUES || p.n == 0;
    begin(s);
    const fmi2Status status = type == REAL      ? fmi2.SetReal(s->component, references, p.n, nowhere ? NULL : reals)
                              : type == INTEGER ? fmi2.SetInteger(s->component, references, p.n, nowhere ? NULL : wholes)
                                                : fmi2.SetBoolean(s->component, references, p.n, nowhere ? NULL : wholes);
    if (flaw >= WRONG_VALUE && legal(s, call) && s->wanted & REFUSED) {
        const char *name = p.variables[p.n - 1]->name;
        REQUIRE(strstr(s->log.text, name), "%s refuses %s without its name: %s", rules[call].name, name, s->log.text);
    }
    if (!judge(s, call, status, flaw != NOTHING ? REFUSED : moves ? DONE | DISCARDED : DONE)) return;
    s->life.tuned |= tunes, s->life.far |= far;
    if (!legal(s, type == REAL ? GET_REAL : GET_INTEGER) || p.n == 0) return;
    REQUIRE(get_typed(s, type, p.references, p.n, back, whole_back) == fmi2OK, "reading what was set: %s", s->log.text);
    for (size_t i = 0; i < p.n; i++) {
        bool again = false;
        for (size_t later = i + 1; later < p.n; later++) again |= p.references[later] == p.references[i];
        const double value = type == REAL ? back[i] : whole_back[i];
        REQUIRE(again || value == reals[i] || (isnan(value) && isnan(reals[i])), "%s was set to %.17g and is %.17g", p.variables[i]->name, reals[i], value);
    }
}

/* There are no String variables. */
void strings(Slave *s, Call call) {
    const size_t n = below(2);
    const fmi2ValueReference reference = variables[below(variable_count)].reference;
    fmi2String value = "untouched";
    begin(s);
    const fmi2Status status = call == GET_STRING ? fmi2.GetString(s->component, n ? &reference : NULL, n, n ? &value : NULL)
                                                 : fmi2.SetString(s->component, n ? &reference : NULL, n, n ? &value : NULL);
    REQUIRE(strcmp(value, "untouched") == 0, "%s has written", rules[call].name);
    judge(s, call, status, n ? REFUSED : DONE);
}

/* A Real variable with this role; if `state`, also a continuous state. */
static const Variable *real_of(Role role, bool state) {
    for (;;) {
        const Variable *v = &variables[below(variable_count)];
        if (v->type == REAL && (v->role == role || (state && is_state(v)))) return v;
    }
}

void differentiate(Slave *s) {
    fmi2ValueReference unknowns[MOST], knowns[MOST];
    double changes[MOST], found[MOST];
    size_t n = below(4), m = below(4);
    const Flaw flaw = any_flaw(WRONG_VALUE);
    if (flaw != NOTHING) n += n == 0, m += m == 0;
    for (size_t i = 0; i < MOST; i++) {
        unknowns[i] = real_of(one_in(2) ? OUTPUT : LOCAL, false)->reference, knowns[i] = real_of(INPUT, true)->reference;
        changes[i] = uniform(-1.0, 1.0), found[i] = REAL_MARK;
    }
    if (flaw == UNKNOWN) *(one_in(2) ? &unknowns[n - 1] : &knowns[m - 1]) = 99999;
    if (flaw == WRONG_TYPE) *(one_in(2) ? &unknowns[n - 1] : &knowns[m - 1]) = real_of(FIXED, false)->reference;
    if (flaw == WRONG_VALUE) changes[m - 1] = one_in(2) ? NAN : INFINITY;
    begin(s);
    const fmi2Status status =
        fmi2.GetDirectionalDerivative(s->component, flaw == NO_REFERENCES ? NULL : unknowns, n, knowns, m, changes, flaw == NO_VALUES ? NULL : found);
    for (size_t i = 0; i < MOST; i++)
        REQUIRE(status == fmi2OK && i < n ? isfinite(found[i]) : found[i] == REAL_MARK,
                "fmi2GetDirectionalDerivative: status %d, value %g of %u", status, found[i], unknowns[i]);
    /* Refused by name in singular postures. */
    judge(s, GET_DIRECTIONAL_DERIVATIVE, status, flaw == NOTHING ? may_be_computed(s) | REFUSED : REFUSED);
}

/* First and second derivatives: set for inputs, read for outputs. */
void derivatives(Slave *s, Call call) {
    static const char *const differentiable[] = {"theta[1]", "theta[2]", "tip.x", "tip.y"};
    const bool set = call == SET_INPUT_DERIVATIVES;
    fmi2ValueReference references[MOST];
    int orders[MOST];
    double values[MOST];
    size_t n = below(4);
    const Flaw flaw = any_flaw(WRONG_VALUE);
    if (flaw != NOTHING) n += n == 0;
    for (size_t i = 0; i < MOST; i++) {
        references[i] = (set ? real_of(INPUT, false) : variable(differentiable[below(4)]))->reference;
        orders[i] = 1 + (int)below(2), values[i] = set ? uniform(-1.0, 1.0) : REAL_MARK;
    }
    if (flaw == UNKNOWN) references[n - 1] = 99999;
    if (flaw == WRONG_TYPE) references[n - 1] = real_of(one_in(2) ? LOCAL : one_in(2) ? FIXED : set ? OUTPUT : INPUT, false)->reference;
    if (flaw == WRONG_VALUE && set && one_in(2))
        values[n - 1] = one_in(2) ? NAN : -INFINITY;
    else if (flaw == WRONG_VALUE)
        orders[n - 1] = one_in(2) ? 0 : 3;
    const fmi2ValueReference *whose = flaw == NO_REFERENCES ? NULL : references;
    double *place = flaw == NO_VALUES ? NULL : values;
    begin(s);
    const fmi2Status status = set ? fmi2.SetRealInputDerivatives(s->component, whose, n, orders, place)
                                  : fmi2.GetRealOutputDerivatives(s->component, whose, n, orders, place);
    for (size_t i = 0; !set && i < MOST; i++)
        REQUIRE(status == fmi2OK && i < n ? isfinite(values[i]) : values[i] == REAL_MARK, "%s: status %d, value %g of %u", rules[call].name,
                status, values[i], references[i]);
    judge(s, call, status, flaw != NOTHING ? REFUSED : set ? DONE : may_be_computed(s));
}
