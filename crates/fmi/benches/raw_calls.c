/* The same FMI 2.0 calls as calls.rs, made from C with nothing between: what a call costs at least.
 * Usage: raw_calls LIBRARY GUID N_STATES CALLS. Prints "name ns" a line, the smallest of 30 repetitions. */
#define _POSIX_C_SOURCE 200809L
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

typedef void *Component;
typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} Callbacks;

static void silent(void *e, const char *i, int s, const char *c, const char *m, ...) {
    (void)e; (void)i; (void)s; (void)c; (void)m;
}

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void *symbol(void *library, const char *name) {
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "%s is missing\n", name);
        exit(1);
    }
    return found;
}

#define BEST(name, call)                                                     \
    do {                                                                     \
        double best = 1e9;                                                   \
        for (int repetition = 0; repetition < 30; ++repetition) {            \
            double begin = now();                                            \
            for (long i = 0; i < calls; ++i)                                 \
                if (call) return 2;                                          \
            double seconds = now() - begin;                                  \
            best = seconds < best ? seconds : best;                          \
        }                                                                    \
        printf("%s %.3f\n", name, 1e9 * best / calls);                       \
    } while (0)

int main(int count, char **arguments) {
    if (count != 5) return 1;
    void *library = dlopen(arguments[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        return 1;
    }
    size_t n = (size_t)atol(arguments[3]);
    long calls = atol(arguments[4]);
    Component (*instantiate)(const char *, int, const char *, const char *, const Callbacks *, int, int) =
        symbol(library, "fmi2Instantiate");
    int (*setup)(Component, int, double, double, int, double) = symbol(library, "fmi2SetupExperiment");
    int (*enter)(Component) = symbol(library, "fmi2EnterInitializationMode");
    int (*leave)(Component) = symbol(library, "fmi2ExitInitializationMode");
    int (*continuous)(Component) = symbol(library, "fmi2EnterContinuousTimeMode");
    int (*set_time)(Component, double) = symbol(library, "fmi2SetTime");
    int (*set_states)(Component, const double *, size_t) = symbol(library, "fmi2SetContinuousStates");
    int (*derivatives)(Component, double *, size_t) = symbol(library, "fmi2GetDerivatives");
    int (*get_real)(Component, const unsigned *, size_t, double *) = symbol(library, "fmi2GetReal");
    int (*set_real)(Component, const unsigned *, size_t, const double *) = symbol(library, "fmi2SetReal");

    Callbacks callbacks = {silent, calloc, free, 0, 0};
    Component c = instantiate("raw", 0, arguments[2], "", &callbacks, 0, 0);
    if (!c || setup(c, 0, 0, 0, 0, 0) || enter(c) || leave(c) || continuous(c)) return 2;
    double *x = calloc(n, sizeof *x), *dx = calloc(n, sizeof *dx), one;
    const unsigned first = 1;
    x[0] = 2;
    BEST("set_time", set_time(c, 1e-9 * i));
    BEST("set_continuous_states", set_states(c, x, n));
    BEST("get_derivatives", derivatives(c, dx, n));
    BEST("right-hand side", (set_time(c, 1e-9 * i) | set_states(c, x, n) | derivatives(c, dx, n)));
    BEST("get_reals", get_real(c, &first, 1, &one));
    (void)set_real;
    return 0;
}
