/* A master in C for one library: `driver LIBRARY GUID SCRIPT` loads it, carries out the script, unloads it, and does so
 * twice in one process. Every line of the script is a call; numbers go in and out as bits, so that text loses none:
 *
 *   real REFERENCE BITS | integer REFERENCE NUMBER | boolean REFERENCE NUMBER      set a variable
 *   start STOPTIME                                                                 initialise from 0 to STOPTIME
 *   step NOW SIZE                                                                  fmi2DoStep; times as bits
 *   reals REFERENCE... | integers REFERENCE...                                     read variables
 *
 * What is printed: a line for each status that is not fmi2OK, each message of the logger, each reading. The names are those
 * of the FMI 2.0 headers; only what is called is declared. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
typedef HMODULE Handle;
static Handle load(const char *file) { return LoadLibraryA(file); }
static void *find(Handle library, const char *name) { return (void *)GetProcAddress(library, name); }
static int unload(Handle library) { return FreeLibrary(library) != 0; }
#else
#include <dlfcn.h>
typedef void *Handle;
static Handle load(const char *file) { return dlopen(file, RTLD_NOW | RTLD_LOCAL); }
static void *find(Handle library, const char *name) { return dlsym(library, name); }
static int unload(Handle library) { return dlclose(library) == 0; }
#endif

enum { MOST_REFERENCES = 256, LONGEST_LINE = 4096 };

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, int);
    void *componentEnvironment;
} Callbacks;

static struct {
    void *(*instantiate)(const char *, int, const char *, const char *, const Callbacks *, int, int);
    void (*freeInstance)(void *);
    int (*setupExperiment)(void *, int, double, double, int, double);
    int (*enterInitializationMode)(void *);
    int (*exitInitializationMode)(void *);
    int (*terminate)(void *);
    int (*setReal)(void *, const unsigned *, size_t, const double *);
    int (*setInteger)(void *, const unsigned *, size_t, const int *);
    int (*setBoolean)(void *, const unsigned *, size_t, const int *);
    int (*getReal)(void *, const unsigned *, size_t, double *);
    int (*getInteger)(void *, const unsigned *, size_t, int *);
    int (*doStep)(void *, double, double, int);
} fmi2;

static void fail(const char *what, const char *which) {
    fprintf(stderr, "driver: %s: %s\n", what, which);
    exit(1);
}

static void logger(void *environment, const char *instance, int status, const char *category, const char *message, ...) {
    (void)environment;
    printf("log %s %d %s %s\n", instance, status, category, message);
}

static void look_up(Handle library) {
    const struct {
        const char *name;
        void *place;
    } functions[] = {
        {"fmi2Instantiate", &fmi2.instantiate},
        {"fmi2FreeInstance", &fmi2.freeInstance},
        {"fmi2SetupExperiment", &fmi2.setupExperiment},
        {"fmi2EnterInitializationMode", &fmi2.enterInitializationMode},
        {"fmi2ExitInitializationMode", &fmi2.exitInitializationMode},
        {"fmi2Terminate", &fmi2.terminate},
        {"fmi2SetReal", &fmi2.setReal},
        {"fmi2SetInteger", &fmi2.setInteger},
        {"fmi2SetBoolean", &fmi2.setBoolean},
        {"fmi2GetReal", &fmi2.getReal},
        {"fmi2GetInteger", &fmi2.getInteger},
        {"fmi2DoStep", &fmi2.doStep},
    };
    for (size_t i = 0; i < sizeof functions / sizeof functions[0]; i++) {
        void *function = find(library, functions[i].name);
        if (!function) fail("the library does not export", functions[i].name);
        memcpy(functions[i].place, &function, sizeof function);
    }
}

static double number(uint64_t bits) {
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void report(const char *call, int status) {
    if (status != 0) printf("%s: status %d\n", call, status);
}

/* References from the rest of the line. */
static size_t references(const char *rest, unsigned *list) {
    size_t count = 0;
    int length;
    while (count < MOST_REFERENCES && sscanf(rest, "%u%n", &list[count], &length) == 1) {
        rest += length;
        count++;
    }
    return count;
}

static void read_reals(void *component, const char *rest) {
    unsigned list[MOST_REFERENCES];
    double values[MOST_REFERENCES];
    size_t count = references(rest, list);
    report("fmi2GetReal", fmi2.getReal(component, list, count, values));
    printf("reals");
    for (size_t i = 0; i < count; i++) {
        uint64_t bits;
        memcpy(&bits, &values[i], sizeof bits);
        printf(" %016" PRIx64, bits);
    }
    printf("\n");
}

static void read_integers(void *component, const char *rest) {
    unsigned list[MOST_REFERENCES];
    int values[MOST_REFERENCES];
    size_t count = references(rest, list);
    report("fmi2GetInteger", fmi2.getInteger(component, list, count, values));
    printf("integers");
    for (size_t i = 0; i < count; i++) printf(" %d", values[i]);
    printf("\n");
}

static void carry_out(void *component, const char *line) {
    unsigned reference;
    int whole;
    uint64_t first, second;
    if (sscanf(line, "real %u %" SCNx64, &reference, &first) == 2) {
        double value = number(first);
        report("fmi2SetReal", fmi2.setReal(component, &reference, 1, &value));
    } else if (sscanf(line, "integer %u %d", &reference, &whole) == 2) {
        report("fmi2SetInteger", fmi2.setInteger(component, &reference, 1, &whole));
    } else if (sscanf(line, "boolean %u %d", &reference, &whole) == 2) {
        report("fmi2SetBoolean", fmi2.setBoolean(component, &reference, 1, &whole));
    } else if (sscanf(line, "start %" SCNx64, &first) == 1) {
        report("fmi2SetupExperiment", fmi2.setupExperiment(component, 0, 0.0, 0.0, 1, number(first)));
        report("fmi2EnterInitializationMode", fmi2.enterInitializationMode(component));
        report("fmi2ExitInitializationMode", fmi2.exitInitializationMode(component));
    } else if (sscanf(line, "step %" SCNx64 " %" SCNx64, &first, &second) == 2) {
        report("fmi2DoStep", fmi2.doStep(component, number(first), number(second), 1));
    } else if (strncmp(line, "reals ", 6) == 0) {
        read_reals(component, line + 6);
    } else if (strncmp(line, "integers ", 9) == 0) {
        read_integers(component, line + 9);
    } else {
        fail("the script has an unknown line", line);
    }
}

static void run(const char *file, const char *guid, FILE *script) {
    const Callbacks callbacks = {.logger = logger};
    char line[LONGEST_LINE];
    Handle library = load(file);
    if (!library) fail("the library cannot be loaded", file);
    look_up(library);
    void *component = fmi2.instantiate("machine", 1, guid, "", &callbacks, 0, 1);
    if (!component) fail("fmi2Instantiate gave null for the GUID", guid);
    while (fgets(line, sizeof line, script)) carry_out(component, line);
    report("fmi2Terminate", fmi2.terminate(component));
    fmi2.freeInstance(component);
    if (!unload(library)) fail("the library cannot be unloaded", file);
}

int main(int count, char **arguments) {
    if (count != 4) fail("usage", "driver LIBRARY GUID SCRIPT");
    for (int round = 1; round <= 2; round++) {
        FILE *script = fopen(arguments[3], "r");
        if (!script) fail("the script cannot be read", arguments[3]);
        printf("round %d\n", round);
        run(arguments[1], arguments[2], script);
        fclose(script);
    }
    printf("done\n");
    return 0;
}
