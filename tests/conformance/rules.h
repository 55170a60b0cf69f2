/* Calls allowed in each state: FMI 2.0.4, sections 3.2.3 and 4.2.4, figures and tables, typed in from there.
 *
 * The states stepInProgress and stepCanceled are missing, because a step is never pending; so is the state error, because this unit changes
 * nothing on an error and never enters it. */
#ifndef RULES_H
#define RULES_H

/* The columns of the tables; the meaning of two depends on the kind of unit. */
typedef enum {
    INSTANTIATED, INITIALIZATION, COMPLETE, FAILED, TERMINATED, STATES,
    EVENT = COMPLETE, CONTINUOUS = FAILED
} State;

/* As the messages of the library name them, by fmi2Type. */
static const char *const kind_names[] = {"model exchange", "co-simulation"};
static const char *const state_names[][STATES] = {
    {"instantiated", "initialization mode", "event mode", "continuous-time mode", "terminated"},
    {"instantiated", "initialization mode", "step complete", "step failed", "terminated"},
};

typedef enum {
    SET_DEBUG_LOGGING, SETUP_EXPERIMENT, ENTER_INITIALIZATION, EXIT_INITIALIZATION, TERMINATE, RESET,
    GET_REAL, GET_INTEGER, GET_BOOLEAN, GET_STRING, SET_REAL, SET_INTEGER, SET_BOOLEAN, SET_STRING,
    GET_STATE, SET_STATE, FREE_STATE, SERIALIZED_SIZE, SERIALIZE, DESERIALIZE,
    GET_DIRECTIONAL_DERIVATIVE, SET_INPUT_DERIVATIVES, GET_OUTPUT_DERIVATIVES, DO_STEP, CANCEL_STEP,
    GET_STATUS, GET_REAL_STATUS, GET_INTEGER_STATUS, GET_BOOLEAN_STATUS, GET_STRING_STATUS,
    ENTER_EVENT, NEW_DISCRETE_STATES, ENTER_CONTINUOUS_TIME, COMPLETED_STEP, SET_TIME, SET_CONTINUOUS_STATES,
    GET_DERIVATIVES, GET_INDICATORS, GET_CONTINUOUS_STATES, GET_NOMINALS, CALLS
} Call;

/* By fmi2Type, a column for each state, in the order of State. x: allowed by the standard, possibly to debug only. +: allowed only by
 * this unit (ARCHITECTURE.md): after a discarded step, which has been rolled back, another input or step may be tried at once; and
 * fmi2SetReal also sets continuous states, for which the table has fmi2SetContinuousStates. -: must be refused. fmi2CancelStep belongs to
 * a state that does not exist here. */
static const struct {
    const char *name, *allowed[2];
} rules[CALLS] = {
    /* clang-format off */
    [SET_DEBUG_LOGGING]          = {"fmi2SetDebugLogging",           {"xxxxx", "xxxxx"}},
    [SETUP_EXPERIMENT]           = {"fmi2SetupExperiment",           {"x----", "x----"}},
    [ENTER_INITIALIZATION]       = {"fmi2EnterInitializationMode",   {"x----", "x----"}},
    [EXIT_INITIALIZATION]        = {"fmi2ExitInitializationMode",    {"-x---", "-x---"}},
    [TERMINATE]                  = {"fmi2Terminate",                 {"--xx-", "--xx-"}},
    [RESET]                      = {"fmi2Reset",                     {"xxxxx", "xxxxx"}},
    [GET_REAL]                   = {"fmi2GetReal",                   {"-xxxx", "-xxxx"}},
    [GET_INTEGER]                = {"fmi2GetInteger",                {"-xxxx", "-xxxx"}},
    [GET_BOOLEAN]                = {"fmi2GetBoolean",                {"-xxxx", "-xxxx"}},
    [GET_STRING]                 = {"fmi2GetString",                 {"-xxxx", "-xxxx"}},
    [SET_REAL]                   = {"fmi2SetReal",                   {"xxxx-", "xxx+-"}},
    [SET_INTEGER]                = {"fmi2SetInteger",                {"xxx--", "xxx+-"}},
    [SET_BOOLEAN]                = {"fmi2SetBoolean",                {"xxx--", "xxx+-"}},
    [SET_STRING]                 = {"fmi2SetString",                 {"xxx--", "xxx+-"}},
    [GET_STATE]                  = {"fmi2GetFMUstate",               {"xxxxx", "xxxxx"}},
    [SET_STATE]                  = {"fmi2SetFMUstate",               {"xxxxx", "xxxxx"}},
    [FREE_STATE]                 = {"fmi2FreeFMUstate",              {"xxxxx", "xxxxx"}},
    [SERIALIZED_SIZE]            = {"fmi2SerializedFMUstateSize",    {"xxxxx", "xxxxx"}},
    [SERIALIZE]                  = {"fmi2SerializeFMUstate",         {"xxxxx", "xxxxx"}},
    [DESERIALIZE]                = {"fmi2DeSerializeFMUstate",       {"xxxxx", "xxxxx"}},
    [GET_DIRECTIONAL_DERIVATIVE] = {"fmi2GetDirectionalDerivative",  {"-xxxx", "-xxxx"}},
    [SET_INPUT_DERIVATIVES]      = {"fmi2SetRealInputDerivatives",   {"-----", "xxx+-"}},
    [GET_OUTPUT_DERIVATIVES]     = {"fmi2GetRealOutputDerivatives",  {"-----", "--xxx"}},
    [DO_STEP]                    = {"fmi2DoStep",                    {"-----", "--x+-"}},
    [CANCEL_STEP]                = {"fmi2CancelStep",                {"-----", "-----"}},
    [GET_STATUS]                 = {"fmi2GetStatus",                 {"-----", "--xxx"}},
    [GET_REAL_STATUS]            = {"fmi2GetRealStatus",             {"-----", "--xxx"}},
    [GET_INTEGER_STATUS]         = {"fmi2GetIntegerStatus",          {"-----", "--xxx"}},
    [GET_BOOLEAN_STATUS]         = {"fmi2GetBooleanStatus",          {"-----", "--xxx"}},
    [GET_STRING_STATUS]          = {"fmi2GetStringStatus",           {"-----", "--xxx"}},
    [ENTER_EVENT]                = {"fmi2EnterEventMode",            {"--xx-", "-----"}},
    [NEW_DISCRETE_STATES]        = {"fmi2NewDiscreteStates",         {"--x--", "-----"}},
    [ENTER_CONTINUOUS_TIME]      = {"fmi2EnterContinuousTimeMode",   {"--x--", "-----"}},
    [COMPLETED_STEP]             = {"fmi2CompletedIntegratorStep",   {"---x-", "-----"}},
    [SET_TIME]                   = {"fmi2SetTime",                   {"--xx-", "-----"}},
    [SET_CONTINUOUS_STATES]      = {"fmi2SetContinuousStates",       {"---x-", "-----"}},
    [GET_DERIVATIVES]            = {"fmi2GetDerivatives",            {"--xxx", "-----"}},
    [GET_INDICATORS]             = {"fmi2GetEventIndicators",        {"-xxxx", "-----"}},
    [GET_CONTINUOUS_STATES]      = {"fmi2GetContinuousStates",       {"-xxxx", "-----"}},
    [GET_NOMINALS]               = {"fmi2GetNominalsOfContinuousStates", {"x-xxx", "-----"}},
    /* clang-format on */
};

#endif
