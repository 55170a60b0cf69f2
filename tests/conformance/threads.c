/* `threads LIBRARY GUID VARIABLES THREADS STEPS`: every scene in its own thread, several at the same time, each with its own instance;
 * the bits after every step must equal a run alone. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "master.h"

enum { MOST_STEPS = 1000, MOST_THREADS = 16 };

static const char *guid;
static int steps;
static pthread_barrier_t all_ready;

/* A run and the hash of its variables at each communication point. */
typedef struct {
    const Scene *scene;
    bool in_company;
    uint64_t seen[MOST_STEPS];
} Run;

static void *run(void *argument) {
    Run *r = argument;
    Log log = {.name = "machine"};
    if (r->in_company) pthread_barrier_wait(&all_ready);
    fmi2Component c = instantiate(&log, guid, true);
    REQUIRE(c, "fmi2Instantiate: %s", log.text);
    start(c, r->scene);
    for (int step = 0; step < steps; step++) {
        drive(c, r->scene, step);
        r->seen[step] = fingerprint(c);
        /* Errors, states and their bytes in between, as in a real master. */
        if (step % 16 == 3) {
            fmi2FMUstate state = NULL;
            REQUIRE(fmi2.DoStep(c, -1.0, 1.0, fmi2True) == fmi2Error, "%s: a wrong point was accepted", r->scene->title);
            REQUIRE(fmi2.GetFMUstate(c, &state) == fmi2OK && fmi2.SetFMUstate(c, state) == fmi2OK &&
                        fmi2.FreeFMUstate(c, &state) == fmi2OK,
                    "%s: stored states: %s", r->scene->title, log.text);
        }
    }
    fmi2.FreeInstance(c);
    return NULL;
}

int main(int count, char **arguments) {
    static Run alone[32], together[MOST_THREADS];
    REQUIRE(count == 6, "usage: threads LIBRARY GUID VARIABLES THREADS STEPS");
    guid = arguments[2];
    read_variables(arguments[3]);
    const int threads = atoi(arguments[4]);
    steps = atoi(arguments[5]);
    REQUIRE(threads > 1 && threads <= MOST_THREADS && steps > 0 && steps <= MOST_STEPS && scene_count <= 32, "too many or too few");
    REQUIRE(load(arguments[1]), "the library cannot be loaded: %s", arguments[1]);

    for (size_t i = 0; i < scene_count; i++) {
        alone[i] = (Run){.scene = &scenes[i]};
        run(&alone[i]);
        for (size_t other = 0; other < i; other++)
            REQUIRE(alone[i].seen[steps - 1] != alone[other].seen[steps - 1], "%s ends like %s", scenes[i].title, scenes[other].title);
    }
    /* Each scene runs beside itself and others. */
    pthread_barrier_init(&all_ready, NULL, (unsigned)threads);
    for (size_t first = 0; first < scene_count; first++) {
        pthread_t handles[MOST_THREADS];
        for (int i = 0; i < threads; i++) {
            together[i] = (Run){.scene = &scenes[(first + (size_t)(i / 2)) % scene_count], .in_company = true};
            REQUIRE(pthread_create(&handles[i], NULL, run, &together[i]) == 0, "no thread");
        }
        for (int i = 0; i < threads; i++) {
            REQUIRE(pthread_join(handles[i], NULL) == 0, "no end");
            const Run *reference = &alone[together[i].scene - scenes];
            for (int step = 0; step < steps; step++)
                REQUIRE(together[i].seen[step] == reference->seen[step], "%s: other bits in company, step %d", together[i].scene->title, step);
        }
    }
    pthread_barrier_destroy(&all_ready);
    printf("%zu scenes, %d threads at a time, %d steps each: the same bits\n", scene_count, threads, steps);
    return 0;
}
