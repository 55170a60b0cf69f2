/* Knowledge of the random walk about an instance, and its judgement of a call. */
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

/* State of an instance in its life, as the standard has it. */
typedef struct {
    fmi2Type kind;
    State state;
    bool experiment, ends;
    double point, stop;
    /* A tunable parameter has been set since the last step: the next one may refuse it. */
    bool tuned;
    /* Something larger than FAR has been set: steps may take seconds until they are given up, and few are made. */
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

/* A stored state, which belongs to the walk and not to an instance. */
typedef struct {
    fmi2FMUstate state;
    Life life;
    Bytes bytes;
} Stored;

/* Sets of statuses. */
enum { DONE = 1 << fmi2OK, DISCARDED = 1 << fmi2Discard, REFUSED = 1 << fmi2Error };

extern Stored stored[STORED];
/* Those of a new instance, by fmi2Type. */
extern Bytes fresh[2];
extern const char *guid;
extern double largest;

/* Whether the call is allowed in the present state, by the table. */
bool legal(const Slave *s, Call call);
/* Before a call: forgets the log. */
void begin(Slave *s);
/* After it: fails unless the status is one of `possible` (of REFUSED where the state does not allow the call), the log has the line that
 * it must have, and nothing has changed where the call has not been carried out or only looks. True where it has been carried out. */
bool judge(Slave *s, Call call, fmi2Status status, int possible);
/* The bytes of the present state. */
void serialize(Slave *s, Bytes *bytes);
bool same(const Bytes *one, const Bytes *other);

/* A call with arguments that chance chooses, right ones and wrong ones. */
void make(Slave *s, Call call);
/* Puts an instance into an empty place, or tries to in a way that must be refused. */
void appear(Slave *s);
/* Frees an instance. */
void disappear(Slave *s);

/* In initialization mode: makes a scene whose steps are discarded: one iteration is not enough for a tenth of a second. */
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

/* Statuses allowed when computed values are asked for. */
int may_be_computed(const Slave *s);
/* Whether nothing but fmi2Discard for want of coordinates can keep a continuous state from being set by fmi2SetReal. */
bool may_set_states(const Slave *s);

#endif
