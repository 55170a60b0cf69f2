/* The random walk's model of an instance, and its check of a call. */
#ifndef WALK_H
#define WALK_H

#include "master.h"
#include "rules.h"

enum { SLAVES = 3, STORED = 4, MOST_BYTES = 1 << 15 };

static const double FAR = 1e12;

/* A serialised state. */
typedef struct {
    size_t size;
    char bytes[MOST_BYTES];
} Bytes;

/* Stage of the life of an instance, by the standard. */
typedef struct {
    fmi2Type kind;
    State state;
    bool experiment, ends;
    double point, stop;
    /* A tunable parameter has been set since the last step: the next one may refuse it. */
    bool tuned;
    /* A value larger than FAR has been set: steps may take seconds until they fail, so few are made. */
    bool far;
} Life;

/* An instance under test. */
typedef struct {
    fmi2Component component;
    Life life;
    Log log;
    /* Statuses that reach the logger: a bit for each. */
    unsigned wanted;
    /* The state after the last call. */
    Bytes now;
} Slave;

/* A stored state; the walk owns it, not an instance. */
typedef struct {
    fmi2FMUstate state;
    Life life;
    Bytes bytes;
} Stored;

/* Sets of statuses. */
enum { DONE = 1 << fmi2OK, DISCARDED = 1 << fmi2Discard, REFUSED = 1 << fmi2Error };

extern Stored stored[STORED];
/* Statuses allowed for a new instance, by fmi2Type. */
extern Bytes fresh[2];
extern const char *guid;
extern double largest;

/* Whether the call is allowed in the present state, by the table. */
bool legal(const Slave *s, Call call);
/* Before a call: forgets the log. */
void begin(Slave *s);
/* After the call: fails unless the status is in `possible` (in REFUSED if the state does not allow the call), the log has the required line,
 * and a call that was not carried out, or only reads, has changed nothing. True if the call was carried out. */
bool judge(Slave *s, Call call, fmi2Status status, int possible);
/* The bytes of the present state. */
void serialize(Slave *s, Bytes *bytes);
bool same(const Bytes *one, const Bytes *other);

/* A call with random arguments, right and wrong ones. */
void make(Slave *s, Call call);
/* Instantiates into an empty place, or tries with arguments that must be refused. */
void appear(Slave *s);
/* Frees an instance. */
void disappear(Slave *s);

/* In initialization mode: sets a scene with failing steps (one iteration is not enough for a tenth of a second). */
void despair(Slave *s);

/* Calls by kind; see their files. */
void set_values(Slave *s, Call call, Type type);
void get_values(Slave *s, Call call, Type type);
void strings(Slave *s, Call call);
void differentiate(Slave *s);
void derivatives(Slave *s, Call call);
void states(Slave *s, Call call);
void do_step(Slave *s);
void ask_status(Slave *s, Call call);
void exchange(Slave *s, Call call);

/* Statuses allowed when computed values are read. */
int may_be_computed(const Slave *s);
/* Whether fmi2SetReal may set continuous states; it then can only fail with fmi2Discard, if they are no coordinates. */
bool may_set_states(const Slave *s);

#endif
