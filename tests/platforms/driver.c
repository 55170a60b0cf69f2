/* A master in C for one library: `driver LIBRARY GUID ROUNDS SCRIPT...` runs all scripts ROUNDS times in one process; it loads
 * the library before each script and unloads it afterwards. Every line of a script is a call; numbers go in and out as bits, so
 * that no digit is lost:
 *
 *   real REFERENCE BITS | integer REFERENCE NUMBER | boolean REFERENCE NUMBER      set a variable
 *   start STOPTIME                                                                 initialise from 0 to STOPTIME
 *   step NOW SIZE                                                                  fmi2DoStep; times as bits
 *   reals REFERENCE... | integers REFERENCE...                                     read variables
 *   slopes KNOWN UNKNOWN...                                                        directional derivatives with respect to KNOWN
 *   store FILE | restore FILE                                                      the whole state, as bytes
 *
 * Output: a line for each status other than fmi2OK, each message of the logger, each reading. Names are as in the FMI 2.0
 * headers; only the called functions are declared. */
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
static int is_loaded(const char *file) { return GetModuleHandleA(file) != NULL; }
#else
#include <dlfcn.h>
typedef void *Handle;
static Handle load(const char *file) { return dlopen(file, RTLD_NOW | RTLD_LOCAL); }
static void *find(Handle library, const char *name) { return dlsym(library, name); }
static int unload(Handle library) { return dlclose(library) == 0; }
static int is_loaded(const char *file) {
    Handle library = dlopen(file, RTLD_NOW | RTLD_NOLOAD);
    return library && dlclose(library) == 0;
}
#endif

enum { MOST_REFERENCES = 256, LONGEST_LINE = 4096, LARGEST_STATE = 1 << 16 };

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
    int (*getDirectionalDerivative)(void *, const unsigned *, size_t, const unsigned *, size_t, const double *, double *);
    int (*getState)(void *, void **);
    int (*setState)(void *, void *);
    int (*freeState)(void *, void **);
    int (*serializedSize)(void *, void *, size_t *);
    int (*serialize)(void *, void *, char *, size_t);
    int (*deserialize)(void *, const char *, size_t, void **);
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
        {"fmi2GetDirectionalDerivative", &fmi2.getDirectionalDerivative},
        {"fmi2GetFMUstate", &fmi2.getState},
        {"fmi2SetFMUstate", &fmi2.setState},
        {"fmi2FreeFMUstate", &fmi2.freeState},
        {"fmi2SerializedFMUstateSize", &fmi2.serializedSize},
        {"fmi2SerializeFMUstate", &fmi2.serialize},
        {"fmi2DeSerializeFMUstate", &fmi2.deserialize},
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

/* Reads references from the rest of the line. */
static size_t references(const char *rest, unsigned *list) {
    size_t count = 0;
    int length;
    while (count < MOST_REFERENCES && sscanf(rest, "%u%n", &list[count], &length) == 1) {
        rest += length;
        count++;
    }
    return count;
}

static void print_bits(const char *title, const double *values, size_t count) {
    printf("%s", title);
    for (size_t i = 0; i < count; i++) {
        uint64_t bits;
        memcpy(&bits, &values[i], sizeof bits);
        printf(" %016" PRIx64, bits);
    }
    printf("\n");
}

static void read_reals(void *component, const char *rest) {
    unsigned list[MOST_REFERENCES];
    double values[MOST_REFERENCES];
    size_t count = references(rest, list);
    report("fmi2GetReal", fmi2.getReal(component, list, count, values));
    print_bits("reals", values, count);
}

static void read_slopes(void *component, const char *rest) {
    unsigned list[MOST_REFERENCES];
    double values[MOST_REFERENCES];
    const double seed = 1.0;
    size_t count = references(rest, list);
    if (count < 2) fail("slopes asks for two references or more, not", rest);
    int status = fmi2.getDirectionalDerivative(component, list + 1, count - 1, list, 1, &seed, values);
    report("fmi2GetDirectionalDerivative", status);
    if (status == 0) print_bits("slopes", values, count - 1);
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

static FILE *open_file(const char *name, const char *mode) {
    FILE *file = fopen(name, mode);
    if (!file) fail("the file cannot be opened", name);
    return file;
}

static void store(void *component, const char *name) {
    char bytes[LARGEST_STATE];
    void *state = NULL;
    size_t size = 0;
    report("fmi2GetFMUstate", fmi2.getState(component, &state));
    report("fmi2SerializedFMUstateSize", fmi2.serializedSize(component, state, &size));
    if (size > sizeof bytes) fail("the state is too large for", name);
    report("fmi2SerializeFMUstate", fmi2.serialize(component, state, bytes, size));
    report("fmi2FreeFMUstate", fmi2.freeState(component, &state));
    FILE *file = open_file(name, "wb");
    if (fwrite(bytes, 1, size, file) != size || fclose(file) != 0) fail("the file cannot be written", name);
}

static void restore(void *component, const char *name) {
    char bytes[LARGEST_STATE];
    void *state = NULL;
    FILE *file = open_file(name, "rb");
    size_t size = fread(bytes, 1, sizeof bytes, file);
    fclose(file);
    report("fmi2DeSerializeFMUstate", fmi2.deserialize(component, bytes, size, &state));
    report("fmi2SetFMUstate", fmi2.setState(component, state));
    report("fmi2FreeFMUstate", fmi2.freeState(component, &state));
}

static void carry_out(void *component, const char *line) {
    char name[LONGEST_LINE];
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
    } else if (strncmp(line, "slopes ", 7) == 0) {
        read_slopes(component, line + 7);
    } else if (sscanf(line, "store %s", name) == 1) {
        store(component, name);
    } else if (sscanf(line, "restore %s", name) == 1) {
        restore(component, name);
    } else {
        fail("the script has an unknown line", line);
    }
}

static void run(const char *file, const char *guid, const char *script) {
    const Callbacks callbacks = {.logger = logger};
    char line[LONGEST_LINE];
    FILE *lines = open_file(script, "r");
    Handle library = load(file);
    if (!library || !is_loaded(file)) fail("the library cannot be loaded", file);
    look_up(library);
    void *component = fmi2.instantiate("machine", 1, guid, "", &callbacks, 0, 1);
    if (!component) fail("fmi2Instantiate gave null for the GUID", guid);
    while (fgets(line, sizeof line, lines)) carry_out(component, line);
    report("fmi2Terminate", fmi2.terminate(component));
    fmi2.freeInstance(component);
    if (!unload(library) || is_loaded(file)) fail("the library cannot be unloaded", file);
    fclose(lines);
}

int main(int count, char **arguments) {
    if (count < 5) fail("usage", "driver LIBRARY GUID ROUNDS SCRIPT...");
    for (int round = atoi(arguments[3]); round > 0; round--) {
        for (int script = 4; script < count; script++) {
            printf("script %s\n", arguments[script]);
            run(arguments[1], arguments[2], arguments[script]);
        }
    }
    printf("done\n");
    return 0;
}
