/* `cycles LIBRARY GUID VARIABLES CYCLES`: loads, runs, frees and unloads repeatedly. After a fifth of the cycles nothing may grow: neither
 * the heap, to the byte, nor resident memory, mappings, open files and threads. */
#include <dlfcn.h>
#include <malloc.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <dirent.h>

#include "master.h"

/* Rounding of the allocator, and pages that the kernel frees late; a leak of a kilobyte per cycle would be six times this. */
static const long RESIDENT_SLACK = 200 * 1024;

typedef struct {
    size_t heap;
    long resident, mappings, files, threads;
} Use;

static long lines(const char *file) {
    long count = 0;
    FILE *stream = fopen(file, "r");
    REQUIRE(stream, "%s cannot be read", file);
    for (int c; (c = getc(stream)) != EOF;) count += c == '\n';
    fclose(stream);
    return count;
}

static long entries(const char *folder) {
    long count = 0;
    DIR *directory = opendir(folder);
    REQUIRE(directory, "%s cannot be read", folder);
    while (readdir(directory)) count++;
    closedir(directory);
    return count;
}

static Use use(void) {
    Use u = {.mappings = lines("/proc/self/maps"), .files = entries("/proc/self/fd"), .threads = entries("/proc/self/task")};
    FILE *statm = fopen("/proc/self/statm", "r");
    REQUIRE(statm && fscanf(statm, "%*d %ld", &u.resident) == 1, "/proc/self/statm cannot be read");
    fclose(statm);
    u.resident *= 4096;
    u.heap = mallinfo2().uordblks;
    return u;
}

static void cycle(const char *file, const char *guid, const Scene *scene) {
    Log log = {.name = "machine"};
    fmi2FMUstate state = NULL;
    void *library = load(file);
    REQUIRE(library, "the library cannot be loaded: %s", file);
    fmi2Component c = instantiate(&log, guid, true);
    REQUIRE(c, "fmi2Instantiate: %s", log.text);
    start(c, scene);
    for (int step = 0; step < 3; step++) drive(c, scene, step);
    REQUIRE(fmi2.GetFMUstate(c, &state) == fmi2OK, "fmi2GetFMUstate: %s", log.text);
    drive(c, scene, 3);
    REQUIRE(fmi2.SetFMUstate(c, state) == fmi2OK && fmi2.FreeFMUstate(c, &state) == fmi2OK, "stored states: %s", log.text);
    REQUIRE(fmi2.DoStep(c, -1.0, 1e-3, fmi2True) == fmi2Error, "a wrong point was accepted");
    REQUIRE(fmi2.Reset(c) == fmi2OK && fmi2.Terminate(c) == fmi2Error, "fmi2Reset");
    fmi2.FreeInstance(c);
    unload(library);
    REQUIRE(!dlopen(file, RTLD_NOW | RTLD_NOLOAD), "the library stays loaded");
}

int main(int count, char **arguments) {
    REQUIRE(count == 5, "usage: cycles LIBRARY GUID VARIABLES CYCLES");
    read_variables(arguments[3]);
    const long cycles = strtol(arguments[4], NULL, 10);
    Use before = {0};
    for (long i = 0; i < cycles; i++) {
        if (i == cycles / 5) before = use();
        cycle(arguments[1], arguments[2], &scenes[(size_t)i % scene_count]);
    }
    const Use after = use();
    printf("%ld cycles: heap %zu to %zu bytes, resident %ld to %ld kB, mappings %ld to %ld, files %ld to %ld, threads %ld to %ld\n", cycles,
           before.heap, after.heap, before.resident / 1024, after.resident / 1024, before.mappings, after.mappings, before.files,
           after.files, before.threads, after.threads);
    REQUIRE(after.heap <= before.heap && after.resident <= before.resident + RESIDENT_SLACK && after.mappings <= before.mappings &&
                after.files == before.files && after.threads == before.threads,
            "something grows");
    return 0;
}
