/* `surroundings LIBRARY GUID VARIABLES LOCALE`: loading, running, refusing and unloading leave the process as it was: floating-point
 * environment, locale, signal handlers, environment variables, working directory, open files; nothing is written to standard output (nor to
 * standard error, which the caller of this program checks). The process does not influence the library either: for any locale results have
 * the same bits, and numbers in messages have a decimal point. Flush to zero, rounding directions and traps for invalid operations belong to
 * the master and stay; ordinary runs cause no trap. */
#include <fenv.h>
#include <locale.h>
#include <math.h>
#include <pmmintrin.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "master.h"

enum { STEPS = 25 };
extern char **environ;
static const char *file, *guid;

/* State of the process that must stay; pointers are compared by what they point to. */
typedef struct {
    int rounding;
    unsigned short x87_control;
    unsigned sse_control;
    char locale[256], folder[256];
    void (*handlers[NSIG])(int);
    uint64_t environment;
    off_t written;
} Surroundings;

static Surroundings look(void) {
    static const unsigned FLAGS = 0x3f;
    Surroundings s;
    memset(&s, 0, sizeof s);
    s.rounding = fegetround();
    __asm__ volatile("fnstcw %0" : "=m"(s.x87_control));
    /* Flags may only be added; a master sets masks, rounding, flush to zero, and denormals are zero. */
    s.sse_control = _mm_getcsr() & ~FLAGS;
    snprintf(s.locale, sizeof s.locale, "%s %s", setlocale(LC_ALL, NULL), localeconv()->decimal_point);
    REQUIRE(getcwd(s.folder, sizeof s.folder), "no working directory");
    for (int i = 1; i < NSIG; i++) {
        struct sigaction action;
        if (sigaction(i, NULL, &action) == 0) s.handlers[i] = action.sa_handler;
    }
    for (char **variable = environ; *variable; variable++)
        for (const char *c = *variable; *c; c++) s.environment = (s.environment ^ (unsigned char)*c) * 0x100000001b3u;
    struct stat output;
    REQUIRE(fstat(STDOUT_FILENO, &output) == 0, "no standard output");
    s.written = output.st_size;
    return s;
}

static void judge(const Surroundings *before, const char *when) {
    const Surroundings after = look();
    REQUIRE(after.rounding == before->rounding && after.x87_control == before->x87_control && after.sse_control == before->sse_control,
            "%s: the floating-point environment has changed", when);
    REQUIRE(strcmp(after.locale, before->locale) == 0, "%s: the locale has changed", when);
    REQUIRE(strcmp(after.folder, before->folder) == 0, "%s: the working directory has changed", when);
    REQUIRE(memcmp(after.handlers, before->handlers, sizeof after.handlers) == 0, "%s: a signal handler has changed", when);
    REQUIRE(after.environment == before->environment, "%s: the environment has changed", when);
    REQUIRE(after.written == before->written, "%s: something was written to standard output", when);
}

/* A whole life of an instance, checked after every call; returns its end. */
static uint64_t life(const Scene *scene, const char *title) {
    Log log = {.name = "machine"};
    fmi2FMUstate state = NULL;
    const Surroundings before = look();
    void *library = load(file);
    REQUIRE(library, "the library cannot be loaded: %s", file);
    judge(&before, "loading");
    fmi2Component c = instantiate(&log, guid, true);
    REQUIRE(c, "fmi2Instantiate: %s", log.text);
    judge(&before, "fmi2Instantiate");
    start(c, scene);
    judge(&before, "initialisation");
    for (int step = 0; step < STEPS; step++) {
        drive(c, scene, step);
        judge(&before, scene->title);
        get(c, "singular.sigmaPhi");
        judge(&before, "reading");
    }
    REQUIRE(fmi2.DoStep(c, 0.5, 1e-3, fmi2True) == fmi2Error, "a wrong point was accepted");
    REQUIRE(strstr(log.text, "currentCommunicationPoint is 0.5 s, expected 0."), "%s: no decimal point: %s", title, log.text);
    judge(&before, "a refusal");
    REQUIRE(fmi2.GetFMUstate(c, &state) == fmi2OK && fmi2.SetFMUstate(c, state) == fmi2OK && fmi2.FreeFMUstate(c, &state) == fmi2OK,
            "stored states: %s", log.text);
    judge(&before, "stored states");
    const uint64_t end = fingerprint(c);
    fmi2.FreeInstance(c);
    unload(library);
    judge(&before, "unloading");
    return end;
}

/* Other rounding directions change the results slightly; a large difference would mean that the mechanism has come apart. */
static double tip(const Scene *scene, int rounding, unsigned sse_control) {
    Log log = {.name = "machine"};
    const int usual = fegetround();
    const unsigned usual_sse = _mm_getcsr();
    void *library = load(file);
    REQUIRE(library, "the library cannot be loaded: %s", file);
    fmi2Component c = instantiate(&log, guid, false);
    fesetround(rounding);
    _mm_setcsr(_mm_getcsr() | sse_control);
    const Surroundings before = look();
    start(c, scene);
    for (int step = 0; step < STEPS; step++) drive(c, scene, step);
    const double x = get(c, "tip.x");
    judge(&before, scene->title);
    _mm_setcsr(usual_sse);
    fesetround(usual);
    fmi2.FreeInstance(c);
    unload(library);
    return x;
}

int main(int count, char **arguments) {
    REQUIRE(count == 5, "usage: surroundings LIBRARY GUID VARIABLES LOCALE");
    file = arguments[1], guid = arguments[2];
    read_variables(arguments[3]);
    feenableexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
    /* Into a file: its length shows whether anything was written. */
    FILE *output = tmpfile();
    const int shown = dup(STDOUT_FILENO);
    REQUIRE(output && dup2(fileno(output), STDOUT_FILENO) >= 0, "standard output cannot be redirected");

    static const int roundings[] = {FE_UPWARD, FE_DOWNWARD, FE_TOWARDZERO};
    double worst = 0.0;
    for (size_t i = 0; i < scene_count; i++) {
        setlocale(LC_ALL, "C");
        const uint64_t usual = life(&scenes[i], "C");
        REQUIRE(setlocale(LC_ALL, arguments[4]), "there is no locale %s", arguments[4]);
        REQUIRE(strcmp(localeconv()->decimal_point, ",") == 0, "%s has no decimal comma", arguments[4]);
        REQUIRE(life(&scenes[i], arguments[4]) == usual, "%s: other bits with the locale %s", scenes[i].title, arguments[4]);
        setlocale(LC_ALL, "C");
        const double nearest = tip(&scenes[i], FE_TONEAREST, 0);
        for (size_t k = 0; k < 3; k++) worst = fmax(worst, fabs(tip(&scenes[i], roundings[k], 0) - nearest));
        worst = fmax(worst, fabs(tip(&scenes[i], FE_TONEAREST, _MM_FLUSH_ZERO_ON | _MM_DENORMALS_ZERO_ON) - nearest));
    }
    dup2(shown, STDOUT_FILENO);
    printf("%zu scenes: everything around them stays; other roundings move the tip by %.1e m\n", scene_count, worst);
    return 0;
}
