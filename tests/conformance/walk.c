/* `walk LIBRARY GUID VARIABLES CALLS SEED LARGEST`: a random walk over legal and illegal calls, with right and wrong arguments, over several
 * instances and stored states. The standard's table gives the allowed outcome of each call; a call that is not carried out must leave
 * the instance unchanged, byte for byte, with one sentence in the log. At the end every call must have been tried in every state.
 *
 * LARGEST bounds absurd values, as a power of ten. */
#include "walk.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

Stored stored[STORED];
Bytes fresh[2];
const char *guid;
double largest;
static Slave slaves[SLAVES];

/* How often each call was tried and carried out, by state. */
static struct {
    unsigned long tried, done;
} seen[CALLS][2][STATES];
static unsigned long calls, discarded, reset_after_refusal;

bool legal(const Slave *s, Call call) { return rules[call].allowed[s->life.kind][s->life.state] != '-'; }

bool same(const Bytes *one, const Bytes *other) {
    return one->size == other->size && memcmp(one->bytes, other->bytes, one->size) == 0;
}

void serialize(Slave *s, Bytes *bytes) {
    fmi2FMUstate state = NULL;
    REQUIRE(fmi2.GetFMUstate(s->component, &state) == fmi2OK, "fmi2GetFMUstate: %s", s->log.text);
    REQUIRE(fmi2.SerializedFMUstateSize(s->component, state, &bytes->size) == fmi2OK, "fmi2SerializedFMUstateSize: %s", s->log.text);
    REQUIRE(bytes->size <= MOST_BYTES, "a state of %zu bytes", bytes->size);
    REQUIRE(fmi2.SerializeFMUstate(s->component, state, bytes->bytes, bytes->size) == fmi2OK, "fmi2SerializeFMUstate: %s", s->log.text);
    REQUIRE(fmi2.FreeFMUstate(s->component, &state) == fmi2OK && !state, "fmi2FreeFMUstate: %s", s->log.text);
}

void begin(Slave *s) {
    s->log.lines = 0;
    s->log.text[0] = '\0';
}

/* The sentence that must come with a status: begins with the function, ends with a full stop, has no line break. */
static void judge_sentence(const Slave *s, Call call, fmi2Status status, bool allowed) {
    static const char *const categories[] = {"logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError"};
    const char *text = s->log.text, *name = rules[call].name;
    const size_t length = strlen(text);
    if (!(s->wanted & 1u << status)) return;
    REQUIRE(s->log.lines == 1, "%s: status %d with %d lines: %s", name, status, s->log.lines, text);
    REQUIRE(s->log.status == status, "%s: status %d, that of the line is %d: %s", name, status, s->log.status, text);
    REQUIRE(strcmp(s->log.category, categories[status]) == 0, "%s: category %s: %s", name, s->log.category, text);
    REQUIRE(strncmp(text, name, strlen(name)) == 0 && text[strlen(name)] == ':', "%s: begins with another name: %s", name, text);
    REQUIRE(length > 0 && text[length - 1] == '.' && !strpbrk(text, "\n\r\t"), "%s: no sentence: %s", name, text);
    if (!allowed && (call != CANCEL_STEP || s->life.kind == fmi2ModelExchange)) {
        char expected[64];
        const char *other = rules[call].allowed[s->life.kind];
        if (strcmp(other, "-----") == 0)
            snprintf(expected, sizeof expected, "the instance is for %s", kind_names[s->life.kind]);
        else
            snprintf(expected, sizeof expected, "the state is \"%s\"", state_names[s->life.kind][s->life.state]);
        REQUIRE(strstr(text, expected), "%s: expected %s: %s", name, expected, text);
    }
}

/* Calls that must not change the instance even if they are carried out. */
static bool only_looks(Call call) {
    switch (call) {
    case SET_DEBUG_LOGGING:
    case GET_REAL:
    case GET_INTEGER:
    case GET_BOOLEAN:
    case GET_STRING:
    case SET_STRING:
    case GET_STATE:
    case FREE_STATE:
    case SERIALIZED_SIZE:
    case SERIALIZE:
    case DESERIALIZE:
    case GET_DIRECTIONAL_DERIVATIVE:
    case GET_OUTPUT_DERIVATIVES:
    case GET_STATUS:
    case GET_REAL_STATUS:
    case GET_INTEGER_STATUS:
    case GET_BOOLEAN_STATUS:
    case GET_STRING_STATUS:
    case GET_DERIVATIVES:
    case GET_INDICATORS:
    case GET_CONTINUOUS_STATES:
    case GET_NOMINALS:
        return true;
    default:
        return false;
    }
}

bool judge(Slave *s, Call call, fmi2Status status, int possible) {
    static Bytes after;
    const bool allowed = legal(s, call), done = status == fmi2OK;
    const char *name = rules[call].name, *state = state_names[s->life.kind][s->life.state];
    if (!allowed) possible = REFUSED;
    REQUIRE((unsigned)status <= fmi2Error && (possible & 1 << status), "call %lu, %s in %s: status %d, possible were %#x: %s", calls, name,
            state, status, (unsigned)possible, s->log.text);
    if (!done) judge_sentence(s, call, status, allowed);
    REQUIRE(!done || s->log.lines == 0 || s->log.status < fmi2Discard, "%s: fmi2OK, but: %s", name, s->log.text);
    calls++;
    seen[call][s->life.kind][s->life.state].tried++;
    seen[call][s->life.kind][s->life.state].done += done;
    serialize(s, &after);
    /* A discarded step leads to another state of life; do_step() judges the rest. */
    if (call == DO_STEP && status == fmi2Discard)
        discarded++;
    else if (!done || only_looks(call))
        REQUIRE(same(&s->now, &after), "call %lu, %s in %s: status %d, and the instance has changed: %s", calls, name, state, status,
                s->log.text);
    s->now = after;
    if (!done && one_in(16)) {
        reset_after_refusal++;
        make(s, RESET);
    }
    return done;
}

/* The call that usually leads to the next state. */
static Call onwards(Slave *s) {
    static const Call events[] = {NEW_DISCRETE_STATES, NEW_DISCRETE_STATES, ENTER_CONTINUOUS_TIME, SET_REAL, SET_TIME};
    static const Call steps[] = {SET_CONTINUOUS_STATES, SET_CONTINUOUS_STATES, GET_DERIVATIVES, COMPLETED_STEP, SET_TIME, ENTER_EVENT};
    if (s->life.kind == fmi2ModelExchange && s->life.state == EVENT) return events[below(5)];
    if (s->life.kind == fmi2ModelExchange && s->life.state == CONTINUOUS) return steps[below(6)];
    switch (s->life.state) {
    case INSTANTIATED:
        return one_in(3) ? (one_in(2) ? SET_REAL : SET_BOOLEAN) : s->life.experiment ? ENTER_INITIALIZATION : SETUP_EXPERIMENT;
    case INITIALIZATION:
        if (one_in(8) && s->life.kind == fmi2CoSimulation) despair(s);
        return one_in(2) ? EXIT_INITIALIZATION : one_in(2) ? SET_REAL : SET_INTEGER;
    case COMPLETE:
    case FAILED:
        return one_in(3) ? SET_REAL : DO_STEP;
    default:
        return one_in(4) ? RESET : (Call)below(CALLS);
    }
}

static void visit(Slave *s) {
    if (!s->component)
        appear(s);
    else if (one_in(400))
        disappear(s);
    else
        make(s, one_in(2) ? onwards(s) : (Call)below(CALLS));
}

/* Every call in every state; carried out at least once in each state that allows it. */
static void judge_coverage(void) {
    for (Call call = 0; call < CALLS; call++)
        for (int column = 0; column < 2 * STATES; column++) {
            const int kind = column / STATES, state = column % STATES;
            const bool answered = call == GET_STATUS || call == GET_INTEGER_STATUS || call == GET_STRING_STATUS;
            REQUIRE(seen[call][kind][state].tried > 0, "%s was never tried in %s", rules[call].name, state_names[kind][state]);
            /* Three status functions never have a result. */
            REQUIRE(rules[call].allowed[kind][state] == '-' || answered || seen[call][kind][state].done > 0, "%s was never done in %s",
                    rules[call].name, state_names[kind][state]);
        }
}

int main(int count, char **arguments) {
    REQUIRE(count == 7, "usage: walk LIBRARY GUID VARIABLES CALLS SEED LARGEST");
    guid = arguments[2];
    read_variables(arguments[3]);
    const unsigned long wanted = strtoul(arguments[4], NULL, 10);
    seed = strtoull(arguments[5], NULL, 10);
    largest = strtod(arguments[6], NULL);
    void *library = load(arguments[1]);
    REQUIRE(library, "the library cannot be loaded: %s", arguments[1]);

    Slave *first = &slaves[0];
    while (calls < wanted) visit(&slaves[below(SLAVES)]);

    /* The remaining instances free the stored states. */
    while (!first->component) appear(first);
    for (size_t i = 0; i < STORED; i++) REQUIRE(fmi2.FreeFMUstate(first->component, &stored[i].state) == fmi2OK, "freeing");
    for (size_t i = 0; i < SLAVES; i++) disappear(&slaves[i]);
    unload(library);

    unsigned long done = 0;
    for (Call call = 0; call < CALLS; call++)
        for (int column = 0; column < 2 * STATES; column++) done += seen[call][column / STATES][column % STATES].done;
    if (calls >= 50000) judge_coverage();
    printf("%lu calls, seed %s: %lu carried out, %lu steps discarded, the rest refused; %lu resets after a refusal\n", calls,
           arguments[5], done, discarded, reset_after_refusal);
    return 0;
}
