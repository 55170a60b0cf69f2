/* `panic LIBRARY GUID VARIABLES`: on a test build whose fmi2CancelStep panics. The panic becomes fmi2Fatal with a line in the log; the
 * instance can only be freed; this process and the other instances continue. */
#include <stdio.h>
#include <string.h>

#include "master.h"

int main(int count, char **arguments) {
    REQUIRE(count == 4, "usage: panic LIBRARY GUID VARIABLES");
    read_variables(arguments[3]);
    void *library = load(arguments[1]);
    REQUIRE(library, "the library cannot be loaded: %s", arguments[1]);

    for (int round = 0; round < 3; round++) {
        Log log = {.name = "machine"}, other_log = {.name = "other"};
        fmi2Component c = instantiate(&log, arguments[2], false), other = instantiate(&other_log, arguments[2], false);
        REQUIRE(c && other, "fmi2Instantiate: %s", log.text);
        start(c, &scenes[0]);
        start(other, &scenes[0]);
        drive(c, &scenes[0], 0);

        REQUIRE(fmi2.CancelStep(c) == fmi2Fatal, "the panic did not become fmi2Fatal");
        REQUIRE(log.lines == 1 && log.status == fmi2Fatal && strcmp(log.category, "logStatusFatal") == 0, "the log: %d lines", log.lines);
        REQUIRE(strcmp(log.text, "fmi2CancelStep: defect of the library, the instance can only be freed: forced by the test build") == 0,
                "the log: %s", log.text);

        const Variable *v = variable("tip.x");
        double value = -7;
        fmi2FMUstate state = NULL;
        REQUIRE(fmi2.DoStep(c, 1e-3, 1e-3, fmi2True) == fmi2Fatal && fmi2.Reset(c) == fmi2Fatal && fmi2.Terminate(c) == fmi2Fatal &&
                    fmi2.GetReal(c, &v->reference, 1, &value) == fmi2Fatal && fmi2.GetFMUstate(c, &state) == fmi2Fatal,
                "a call after the panic was not answered with fmi2Fatal");
        REQUIRE(value == -7 && !state && log.lines == 1, "a call after the panic has written");
        fmi2.FreeInstance(c);

        for (int step = 0; step < 20; step++) drive(other, &scenes[0], step);
        fmi2.FreeInstance(other);
    }
    unload(library);
    printf("a panic is fmi2Fatal, and the others go on\n");
    return 0;
}
