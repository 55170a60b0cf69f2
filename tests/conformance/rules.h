/* Which call is allowed in which state: FMI 2.0.4, section 4.2.4, figure and table, typed in from there.
 *
 * The states stepInProgress and stepCanceled are left out (a step is never pending); so is the state error, which a unit that changes
 * nothing on an error never enters. */
#ifndef RULES_H
#define RULES_H

typedef enum { INSTANTIATED, INITIALIZATION, COMPLETE, FAILED, TERMINATED, STATES } State;

/* As the messages of the library name them. */
static const char *const state_names[STATES] = {"instantiated", "initialization mode", "step complete", "step failed", "terminated"};

typedef enum {
    SET_DEBUG_LOGGING, SETUP_EXPERIMENT, ENTER_INITIALIZATION, EXIT_INITIALIZATION, TERMINATE, RESET,
    GET_REAL, GET_INTEGER, GET_BOOLEAN, GET_STRING, SET_REAL, SET_INTEGER, SET_BOOLEAN, SET_STRING,
    GET_STATE, SET_STATE, FREE_STATE, SERIALIZED_SIZE, SERIALIZE, DESERIALIZE,
    GET_DIRECTIONAL_DERIVATIVE, SET_INPUT_DERIVATIVES, GET_OUTPUT_DERIVATIVES, DO_STEP, CANCEL_STEP,
    GET_STATUS, GET_REAL_STATUS, GET_INTEGER_STATUS, GET_BOOLEAN_STATUS, GET_STRING_STATUS, CALLS
} Call;

/* A column for each state, in the order of State. x: allowed by the standard, possibly to debug only. +: not by the standard, but by
 * this unit, which says so in ARCHITECTURE.md: after a discarded step, which has been rolled back, another input or step may be tried at
 * once. -: must be refused. fmi2CancelStep belongs to a state that does not exist here. */
static const struct {
    const char *name, *allowed;
} rules[CALLS] = {
    /* clang-format off */
    [SET_DEBUG_LOGGING]          = {"fmi2SetDebugLogging",           "xxxxx"},
    [SETUP_EXPERIMENT]           = {"fmi2SetupExperiment",           "x----"},
    [ENTER_INITIALIZATION]       = {"fmi2EnterInitializationMode",   "x----"},
    [EXIT_INITIALIZATION]        = {"fmi2ExitInitializationMode",    "-x---"},
    [TERMINATE]                  = {"fmi2Terminate",                 "--xx-"},
    [RESET]                      = {"fmi2Reset",                     "xxxxx"},
    [GET_REAL]                   = {"fmi2GetReal",                   "-xxxx"},
    [GET_INTEGER]                = {"fmi2GetInteger",                "-xxxx"},
    [GET_BOOLEAN]                = {"fmi2GetBoolean",                "-xxxx"},
    [GET_STRING]                 = {"fmi2GetString",                 "-xxxx"},
    [SET_REAL]                   = {"fmi2SetReal",                   "xxx+-"},
    [SET_INTEGER]                = {"fmi2SetInteger",                "xxx+-"},
    [SET_BOOLEAN]                = {"fmi2SetBoolean",                "xxx+-"},
    [SET_STRING]                 = {"fmi2SetString",                 "xxx+-"},
    [GET_STATE]                  = {"fmi2GetFMUstate",               "xxxxx"},
    [SET_STATE]                  = {"fmi2SetFMUstate",               "xxxxx"},
    [FREE_STATE]                 = {"fmi2FreeFMUstate",              "xxxxx"},
    [SERIALIZED_SIZE]            = {"fmi2SerializedFMUstateSize",    "xxxxx"},
    [SERIALIZE]                  = {"fmi2SerializeFMUstate",         "xxxxx"},
    [DESERIALIZE]                = {"fmi2DeSerializeFMUstate",       "xxxxx"},
    [GET_DIRECTIONAL_DERIVATIVE] = {"fmi2GetDirectionalDerivative",  "-xxxx"},
    [SET_INPUT_DERIVATIVES]      = {"fmi2SetRealInputDerivatives",   "xxx+-"},
    [GET_OUTPUT_DERIVATIVES]     = {"fmi2GetRealOutputDerivatives",  "--xxx"},
    [DO_STEP]                    = {"fmi2DoStep",                    "--x+-"},
    [CANCEL_STEP]                = {"fmi2CancelStep",                "-----"},
    [GET_STATUS]                 = {"fmi2GetStatus",                 "--xxx"},
    [GET_REAL_STATUS]            = {"fmi2GetRealStatus",             "--xxx"},
    [GET_INTEGER_STATUS]         = {"fmi2GetIntegerStatus",          "--xxx"},
    [GET_BOOLEAN_STATUS]         = {"fmi2GetBooleanStatus",          "--xxx"},
    [GET_STRING_STATUS]          = {"fmi2GetStringStatus",           "--xxx"},
    /* clang-format on */
};

#endif
