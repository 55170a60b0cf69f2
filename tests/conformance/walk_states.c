/* Calls of the random walk: stored states, which outlive instances. */
#include <string.h>

#include "walk.h"

static void get_state(Slave *s) {
    Stored *place = &stored[below(STORED)];
    const bool nowhere = one_in(8);
    begin(s);
    const fmi2Status status = fmi2.GetFMUstate(s->component, nowhere ? NULL : &place->state);
    if (!judge(s, GET_STATE, status, nowhere ? REFUSED : DONE)) return;
    REQUIRE(place->state, "fmi2GetFMUstate gave null");
    place->life = s->life;
    place->bytes = s->now;
}

static void set_state(Slave *s) {
    const Stored *from = &stored[below(STORED)];
    begin(s);
    const bool fits = from->state && from->life.kind == s->life.kind;
    if (!judge(s, SET_STATE, fmi2.SetFMUstate(s->component, from->state), fits ? DONE : REFUSED)) return;
    s->life = from->life;
    REQUIRE(same(&s->now, &from->bytes), "an instance is not in the state that it was put into");
}

static void free_state(Slave *s) {
    Stored *place = &stored[below(STORED)];
    begin(s);
    judge(s, FREE_STATE, fmi2.FreeFMUstate(s->component, one_in(8) ? NULL : &place->state), DONE);
    if (one_in(2)) REQUIRE(fmi2.FreeFMUstate(s->component, &place->state) == fmi2OK && !place->state, "a state is freed twice");
}

static void serialized_size(Slave *s) {
    const Stored *from = &stored[below(STORED)];
    const bool nowhere = one_in(8);
    size_t size = 0;
    begin(s);
    const fmi2Status status = fmi2.SerializedFMUstateSize(s->component, from->state, nowhere ? NULL : &size);
    REQUIRE(size == (status == fmi2OK ? from->bytes.size : 0), "fmi2SerializedFMUstateSize: status %d, %zu", status, size);
    judge(s, SERIALIZED_SIZE, status, from->state && !nowhere ? DONE : REFUSED);
}

static void serialize_stored(Slave *s) {
    static char bytes[MOST_BYTES];
    const Stored *from = &stored[below(STORED)];
    const bool nowhere = one_in(8);
    size_t size = from->bytes.size;
    int possible = from->state && !nowhere ? DONE : REFUSED;
    memset(bytes, 0x55, sizeof bytes);
    if (size > 0 && one_in(4)) {
        size = one_in(2) ? size - 1 : below(size);
        possible = REFUSED;
    }
    begin(s);
    const fmi2Status status = fmi2.SerializeFMUstate(s->component, from->state, nowhere ? NULL : bytes, size);
    const size_t written = status == fmi2OK ? size : 0;
    REQUIRE(written == 0 || memcmp(bytes, from->bytes.bytes, written) == 0, "a stored state has changed");
    REQUIRE(bytes[written] == 0x55, "fmi2SerializeFMUstate has written past the end");
    judge(s, SERIALIZE, status, possible);
}

/* Restores the bytes of an instance or of a stored state, intact or damaged, over an old state or into an empty place. */
static void deserialize(Slave *s) {
    static Bytes bytes;
    Stored *place = &stored[below(STORED)], *from = &stored[below(STORED)];
    const bool own = one_in(2) || !from->state;
    const Life life = own ? s->life : from->life;
    bytes = own ? s->now : from->bytes;
    bool right = true, nothing = false, nowhere = false;
    switch (below(8)) {
    case 0: right = false, bytes.bytes[below(bytes.size)] ^= (char)(1 << below(8)); break;
    case 1: right = false, bytes.size = below(bytes.size); break;
    case 2: right = false, bytes.bytes[bytes.size++] = 0; break;
    case 3: right = false, nothing = true; break;
    case 4: right = false, nowhere = true; break;
    default: break;
    }
    begin(s);
    const fmi2FMUstate old = place->state;
    const fmi2Status status = fmi2.DeSerializeFMUstate(s->component, nothing ? NULL : bytes.bytes, bytes.size, nowhere ? NULL : &place->state);
    REQUIRE(status == fmi2OK || place->state == old, "bytes that are refused make a state");
    if (!judge(s, DESERIALIZE, status, right ? DONE : REFUSED)) return;
    place->life = life;
    place->bytes = bytes;
}

void states(Slave *s, Call call) {
    switch (call) {
    case GET_STATE: get_state(s); break;
    case SET_STATE: set_state(s); break;
    case FREE_STATE: free_state(s); break;
    case SERIALIZED_SIZE: serialized_size(s); break;
    case SERIALIZE: serialize_stored(s); break;
    default: deserialize(s); break;
    }
}
