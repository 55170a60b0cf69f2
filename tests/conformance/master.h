/* A small master in C, shared by the programs of this folder. Types and prototypes come from the standard's headers in the pinned FMPy;
 * nothing here was made from the library's sources. */
#ifndef MASTER_H
#define MASTER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "fmi2FunctionTypes.h"

/* Every function that a unit of both kinds exports (FMI 2.0.4, sections 2.1, 3.2 and 4.2.1). */
#define FMI2_FUNCTIONS(X)                                                                                                          \
    X(GetTypesPlatform) X(GetVersion) X(Instantiate) X(FreeInstance) X(SetDebugLogging) X(SetupExperiment)                         \
    X(EnterInitializationMode) X(ExitInitializationMode) X(Terminate) X(Reset) X(GetReal) X(GetInteger) X(GetBoolean) X(GetString) \
    X(SetReal) X(SetInteger) X(SetBoolean) X(SetString) X(GetFMUstate) X(SetFMUstate) X(FreeFMUstate) X(SerializedFMUstateSize)    \
    X(SerializeFMUstate) X(DeSerializeFMUstate) X(GetDirectionalDerivative) X(SetRealInputDerivatives)                             \
    X(GetRealOutputDerivatives) X(DoStep) X(CancelStep) X(GetStatus) X(GetRealStatus) X(GetIntegerStatus) X(GetBooleanStatus)      \
    X(GetStringStatus) X(EnterEventMode) X(NewDiscreteStates) X(EnterContinuousTimeMode) X(CompletedIntegratorStep) X(SetTime)     \
    X(SetContinuousStates) X(GetDerivatives) X(GetEventIndicators) X(GetContinuousStates) X(GetNominalsOfContinuousStates)

typedef struct {
#define FIELD(name) fmi2##name##TYPE *name;
    FMI2_FUNCTIONS(FIELD)
#undef FIELD
} Functions;

/* The functions of the last loaded library. */
extern Functions fmi2;

/* Loads a library and looks up every function; NULL on failure. */
void *load(const char *file);
void unload(void *library);

/* Ends the program with a sentence on stderr. */
#define FAIL(...) fail(__FILE__, __LINE__, __VA_ARGS__)
#define REQUIRE(condition, ...) ((condition) ? (void)0 : FAIL(__VA_ARGS__))
void fail(const char *file, int line, const char *format, ...) __attribute__((noreturn, format(printf, 3, 4)));

/* Messages that the logger has received since `lines` was set to 0; its address is the component environment. */
typedef struct {
    const char *name;
    int lines;
    fmi2Status status;
    char category[32];
    char text[2048];
} Log;

/* An instance for co-simulation, or of any kind; NULL if the library refuses. */
fmi2Component instantiate(Log *log, const char *guid, bool logging_on);
fmi2Component instantiate_as(fmi2Type kind, Log *log, const char *guid, bool logging_on);
/* The callbacks of `instantiate`: only the logger of this master. */
fmi2CallbackFunctions callbacks(Log *log);

typedef enum { REAL, INTEGER, BOOLEAN } Type;
/* A sample is a discrete input: an encoder may deliver anything, also NaN, and its changes have no derivatives. */
typedef enum { INPUT, FIXED, TUNABLE, OUTPUT, LOCAL, SAMPLE } Role;

/* A variable of the model description. */
typedef struct {
    fmi2ValueReference reference;
    Type type;
    Role role;
    double min, max, start;
    char name[64];
} Variable;

enum { MOST_VARIABLES = 512 };
extern Variable variables[MOST_VARIABLES];
extern size_t variable_count;

/* Reads the table that test_conformance.py writes from modelDescription.xml: reference, type, role, min, max, start, name. */
void read_variables(const char *file);
/* The variable with this name. */
const Variable *variable(const char *name);

/* Set and read by name; any status except fmi2OK ends the program. */
void set(fmi2Component c, const char *name, double value);
double get(fmi2Component c, const char *name);

/* A scene to drive: values by name, ended by a NULL name; communication step, s. */
typedef struct {
    const char *title;
    struct {
        const char *name;
        double value;
    } values[24];
    double size;
} Scene;

/* Every method, alone and with every effect; some at their strictest. */
extern const Scene scenes[];
extern const size_t scene_count;

/* Initialises from 0 s with the values of a scene. */
void start(fmi2Component c, const Scene *scene);
/* The next step from `step` * size, with changing inputs, input derivatives and a tuned parameter. */
void drive(fmi2Component c, const Scene *scene, int step);
/* Hash of the bits of every variable. */
uint64_t fingerprint(fmi2Component c);

/* Random numbers (splitmix64), equal on every platform. */
extern uint64_t seed;
uint64_t random_bits(void);
/* From 0 to n - 1. */
size_t below(size_t n);
/* True one time in n. */
bool one_in(size_t n);
double uniform(double low, double high);

#endif
