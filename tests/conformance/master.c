#include "master.h"

#include <dlfcn.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

Functions fmi2;
Variable variables[MOST_VARIABLES];
size_t variable_count;
uint64_t seed;

void fail(const char *file, int line, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    fprintf(stderr, "%s:%d: ", file, line);
    vfprintf(stderr, format, arguments);
    fprintf(stderr, "\n");
    va_end(arguments);
    exit(1);
}

void *load(const char *file) {
    void *library = dlopen(file, RTLD_NOW | RTLD_LOCAL);
    if (!library) return NULL;
#define LOOK_UP(name)                                                                  \
    {                                                                                  \
        void *function = dlsym(library, "fmi2" #name);                                 \
        REQUIRE(function, "%s does not export fmi2" #name, file);                      \
        memcpy(&fmi2.name, &function, sizeof function);                                \
    }
    FMI2_FUNCTIONS(LOOK_UP)
#undef LOOK_UP
    return library;
}

void unload(void *library) { REQUIRE(dlclose(library) == 0, "the library cannot be unloaded: %s", dlerror()); }

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category, fmi2String text, ...) {
    Log *log = environment;
    va_list arguments;
    REQUIRE(strcmp(name, log->name) == 0, "the logger got the instance name \"%s\", not \"%s\"", name, log->name);
    log->lines++;
    log->status = status;
    snprintf(log->category, sizeof log->category, "%s", category);
    /* By the standard the text is a printf format. */
    va_start(arguments, text);
    vsnprintf(log->text, sizeof log->text, text, arguments);
    va_end(arguments);
}

fmi2CallbackFunctions callbacks(Log *log) {
    return (fmi2CallbackFunctions){.logger = logger, .componentEnvironment = log};
}

/* The library copies the callbacks: the struct need not outlive the call. */
fmi2Component instantiate_as(fmi2Type kind, Log *log, const char *guid, bool logging_on) {
    fmi2CallbackFunctions functions = callbacks(log);
    return fmi2.Instantiate(log->name, kind, guid, "", &functions, fmi2False, logging_on);
}

fmi2Component instantiate(Log *log, const char *guid, bool logging_on) {
    return instantiate_as(fmi2CoSimulation, log, guid, logging_on);
}

void read_variables(const char *file) {
    FILE *table = fopen(file, "r");
    REQUIRE(table, "the table of variables cannot be read: %s", file);
    Variable v;
    char type, role;
    while (fscanf(table, "%u %c %c %la %la %la %63s", &v.reference, &type, &role, &v.min, &v.max, &v.start, v.name) == 7) {
        const char *types = "RIB", *roles = "iftols";
        REQUIRE(strchr(types, type) && strchr(roles, role) && variable_count < MOST_VARIABLES, "table of variables: %s", v.name);
        v.type = (Type)(strchr(types, type) - types);
        v.role = (Role)(strchr(roles, role) - roles);
        variables[variable_count++] = v;
    }
    REQUIRE(feof(table) && variable_count > 0, "the table of variables ends at %zu", variable_count);
    fclose(table);
}

const Variable *variable(const char *name) {
    for (size_t i = 0; i < variable_count; i++)
        if (strcmp(variables[i].name, name) == 0) return &variables[i];
    FAIL("there is no variable %s", name);
}

void set(fmi2Component c, const char *name, double value) {
    const Variable *v = variable(name);
    int whole = (int)value;
    fmi2Status status = v->type == REAL      ? fmi2.SetReal(c, &v->reference, 1, &value)
                        : v->type == INTEGER ? fmi2.SetInteger(c, &v->reference, 1, &whole)
                                             : fmi2.SetBoolean(c, &v->reference, 1, &whole);
    REQUIRE(status == fmi2OK, "%s = %g: status %d", name, value, status);
}

double get(fmi2Component c, const char *name) {
    const Variable *v = variable(name);
    double value = NAN;
    int whole = 0;
    fmi2Status status = v->type == REAL      ? fmi2.GetReal(c, &v->reference, 1, &value)
                        : v->type == INTEGER ? fmi2.GetInteger(c, &v->reference, 1, &whole)
                                             : fmi2.GetBoolean(c, &v->reference, 1, &whole);
    REQUIRE(status == fmi2OK, "reading %s: status %d", name, status);
    return v->type == REAL ? value : whole;
}

uint64_t fingerprint(fmi2Component c) {
    uint64_t mixed = 0;
    for (size_t i = 0; i < variable_count; i++) {
        double value = get(c, variables[i].name);
        uint64_t bits;
        memcpy(&bits, &value, sizeof bits);
        /* FNV-1a, a word at a time. */
        mixed = (mixed ^ bits) * 0x100000001b3u;
    }
    return mixed;
}

uint64_t random_bits(void) {
    uint64_t z = (seed += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

size_t below(size_t n) { return (size_t)(random_bits() % n); }

bool one_in(size_t n) { return below(n) == 0; }

double uniform(double low, double high) { return low + (high - low) * (double)(random_bits() >> 11) * 0x1p-53; }
