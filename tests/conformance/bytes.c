/* `bytes LIBRARY GUID VARIABLES write FILE`: runs every scene and writes the bytes of its state at half-time and its variables at the end.
 * `bytes LIBRARY GUID VARIABLES read FILE`, in another process: continues from these bytes and must reach the same end. */
#include <stdio.h>
#include <string.h>

#include "master.h"

enum { HALF = 37, END = 60, MOST_BYTES = 1 << 13 };

static uint64_t go_on(fmi2Component c, const Scene *scene) {
    for (int step = HALF; step < END; step++) drive(c, scene, step);
    return fingerprint(c);
}

static void write_scene(fmi2Component c, const Scene *scene, FILE *file) {
    static char bytes[MOST_BYTES];
    fmi2FMUstate state = NULL;
    size_t size = 0;
    start(c, scene);
    for (int step = 0; step < HALF; step++) drive(c, scene, step);
    REQUIRE(fmi2.GetFMUstate(c, &state) == fmi2OK && fmi2.SerializedFMUstateSize(c, state, &size) == fmi2OK && size <= MOST_BYTES &&
                fmi2.SerializeFMUstate(c, state, bytes, size) == fmi2OK && fmi2.FreeFMUstate(c, &state) == fmi2OK,
            "%s: no bytes", scene->title);
    const uint64_t end = go_on(c, scene);
    REQUIRE(fwrite(&size, sizeof size, 1, file) == 1 && fwrite(bytes, size, 1, file) == 1 && fwrite(&end, sizeof end, 1, file) == 1,
            "%s: not written", scene->title);
}

static void read_scene(fmi2Component c, const Scene *scene, FILE *file) {
    static char bytes[MOST_BYTES];
    fmi2FMUstate state = NULL;
    size_t size = 0;
    uint64_t end = 0;
    REQUIRE(fread(&size, sizeof size, 1, file) == 1 && size <= MOST_BYTES && fread(bytes, size, 1, file) == 1 &&
                fread(&end, sizeof end, 1, file) == 1,
            "%s: not read", scene->title);
    REQUIRE(fmi2.DeSerializeFMUstate(c, bytes, size, &state) == fmi2OK && fmi2.SetFMUstate(c, state) == fmi2OK &&
                fmi2.FreeFMUstate(c, &state) == fmi2OK,
            "%s: no state", scene->title);
    REQUIRE(go_on(c, scene) == end, "%s: ends elsewhere in a new process", scene->title);
}

int main(int count, char **arguments) {
    REQUIRE(count == 6, "usage: bytes LIBRARY GUID VARIABLES write|read FILE");
    read_variables(arguments[3]);
    const bool writes = strcmp(arguments[4], "write") == 0;
    void *library = load(arguments[1]);
    FILE *file = fopen(arguments[5], writes ? "wb" : "rb");
    REQUIRE(library && file, "%s or %s cannot be opened", arguments[1], arguments[5]);
    for (size_t i = 0; i < scene_count; i++) {
        Log log = {.name = "machine"};
        fmi2Component c = instantiate(&log, arguments[2], false);
        REQUIRE(c, "fmi2Instantiate: %s", log.text);
        (writes ? write_scene : read_scene)(c, &scenes[i], file);
        fmi2.FreeInstance(c);
    }
    REQUIRE(fclose(file) == 0, "%s cannot be closed", arguments[5]);
    unload(library);
    printf("%zu scenes %s\n", scene_count, writes ? "written" : "continued to the same bits");
    return 0;
}
