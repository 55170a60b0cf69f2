/* `allocation LIBRARY GUID VARIABLES STEPS`: this program defines malloc and its family, which count and replace the C library's. During a
 * run nothing may call them: no step, no setting of inputs, input derivatives and tunable parameters, no reading, no storing of a state over an
 * old one, and no restoring. */
#include <stdio.h>
#include <stdlib.h>
#include <errno.h>
#include <string.h>

#include "master.h"

/* The C library's allocator, under its names for such programs. */
extern void *__libc_malloc(size_t size);
extern void *__libc_calloc(size_t number, size_t size);
extern void *__libc_realloc(void *old, size_t size);
extern void *__libc_memalign(size_t alignment, size_t size);
extern void __libc_free(void *old);

static unsigned long allocations;

void *malloc(size_t size) {
    allocations++;
    return __libc_malloc(size);
}

void *calloc(size_t number, size_t size) {
    allocations++;
    return __libc_calloc(number, size);
}

void *realloc(void *old, size_t size) {
    allocations++;
    return __libc_realloc(old, size);
}

void *aligned_alloc(size_t alignment, size_t size) {
    allocations++;
    return __libc_memalign(alignment, size);
}

int posix_memalign(void **place, size_t alignment, size_t size) {
    allocations++;
    *place = __libc_memalign(alignment, size);
    return *place ? 0 : ENOMEM;
}

void free(void *old) { __libc_free(old); }

static void run(const char *guid, const Scene *scene, int steps) {
    Log log = {.name = "machine"};
    fmi2FMUstate state = NULL;
    const unsigned long at_first = allocations;
    fmi2Component c = instantiate(&log, guid, false);
    REQUIRE(c, "fmi2Instantiate: %s", log.text);
    REQUIRE(allocations > at_first, "the counter does not count");
    start(c, scene);
    REQUIRE(fmi2.GetFMUstate(c, &state) == fmi2OK, "fmi2GetFMUstate: %s", log.text);

    const unsigned long before = allocations;
    for (int step = 0; step < steps; step++) {
        drive(c, scene, step);
        fingerprint(c);
        const fmi2Status stored = fmi2.GetFMUstate(c, &state), restored = fmi2.SetFMUstate(c, state);
        REQUIRE(stored == fmi2OK && restored == fmi2OK, "%s: stored states: %s", scene->title, log.text);
        REQUIRE(allocations == before, "%s: %lu allocations in step %d", scene->title, allocations - before, step);
    }
    REQUIRE(fmi2.FreeFMUstate(c, &state) == fmi2OK, "fmi2FreeFMUstate: %s", log.text);
    fmi2.FreeInstance(c);
}

int main(int count, char **arguments) {
    REQUIRE(count == 5, "usage: allocation LIBRARY GUID VARIABLES STEPS");
    read_variables(arguments[3]);
    void *library = load(arguments[1]);
    REQUIRE(library, "the library cannot be loaded: %s", arguments[1]);
    for (size_t i = 0; i < scene_count; i++) run(arguments[2], &scenes[i], atoi(arguments[4]));
    unload(library);
    printf("%zu scenes, %s steps each: no allocation\n", scene_count, arguments[4]);
    return 0;
}
