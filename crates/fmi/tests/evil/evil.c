/* An FMI 2.0 model (model exchange and co-simulation) with one fault at a time, chosen by a macro: x' = -k x, y = x. */
#include "fmi2.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef LOGS_LATE
#include <pthread.h>
#include <unistd.h>
#endif
#if defined(SLOW) || defined(STEPS_FILE)
#include <unistd.h>
#endif

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef struct {
    double time, x, k, n_sets;
    int n, b;
    int fatal, polls;
#ifdef ONE_SET
    double u;
    int has_u; /* set at this instant */
    int is_late; /* in initialization mode or beyond */
#endif
#ifdef LATCHES
    double u;
    int is_set, is_spoiled; /* u was set since the last step; and something was read since */
    double known; /* u as the initialization mode found it */
    int initialized, broken;
#endif
    int logs; /* it was asked to log */
    double y; /* x where the derivatives were computed last */
    int restored;
    double restored_k;
    double remembered;
    double made_k; /* k when the instance was made */
    double stop;
    int has_stop;
    fmi2CallbackFunctions functions;
} Model;

#include "process.h"
#if defined(FAULT) || defined(LEAKS)
#include "faults.h"
#endif
#include "state.h"

#ifdef ODD_RUN
/* Runs in this loaded copy; of which some are odd, by an expression in `runs`. */
static int runs;
#endif
#ifdef LAST_ONLY
static Model *last;
#endif
#ifdef STATIC_SCRATCH
static volatile double scratch;
#endif
#ifdef UNDEFINED_SYMBOL
extern double not_there(double);
#endif
static void start_values(Model *m) {
    m->y = 1;
#ifdef LATCHES
    m->u = m->is_set = m->is_spoiled = 0;
    m->known = m->initialized = m->broken = 0;
#endif
    m->time = 0;
    m->x = 1;
#if !defined(STATIC_PARAMETERS)
    K(m) = 1;
#endif
#ifdef LARGE_TLS
    large[0] = 1;
#endif
    m->n = 3;
    m->b = 1;
    m->polls = 0;
#ifdef ONE_SET
    m->u = m->has_u = m->is_late = 0;
#endif
#ifdef AT_START
    AT_START;
#endif
}

#ifndef LOG_ENVIRONMENT
#define LOG_ENVIRONMENT m->functions.componentEnvironment
#endif
static void say(Model *m, fmi2Status status, const char *text) {
    m->functions.logger(LOG_ENVIRONMENT, "evil", status, "logAll", text);
}

#ifdef LOGS_LATE
/* The standard keeps the structure alive as long as the instance; the thread uses it longer. */
static const fmi2CallbackFunctions *given;

static void *log_late(void *functions) {
    const fmi2CallbackFunctions *known = functions;
    int i;
    for (i = 0; i < 20; i++) {
        usleep(2000);
        known->logger(known->componentEnvironment, "evil", fmi2Warning, "logAll", "late %d", i);
    }
    return NULL;
}
#endif

#ifdef LOGS_AT_END
static const fmi2CallbackFunctions *given;

__attribute__((destructor)) static void log_at_end(void) {
    if (given != NULL) given->logger(given->componentEnvironment, "evil", fmi2Warning, "logAll", "%s", "at the end");
}
#endif

#ifndef TYPES_PLATFORM
#define TYPES_PLATFORM "default"
#endif
#ifndef VERSION
#define VERSION "2.0"
#endif
EXPORT const char *fmi2GetTypesPlatform(void) { return TYPES_PLATFORM; }
EXPORT const char *fmi2GetVersion(void) { return VERSION; }

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                     const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    Model *m;
    (void)name; (void)type; (void)guid; (void)resources; (void)visible; (void)logging;
#ifdef NOT_INSTANTIABLE
    functions->logger(functions->componentEnvironment, "evil", fmi2Error, "logAll", "no licence for %s", "evil");
    return NULL;
#endif
#ifdef INSTANCES
    if (n_made++ >= INSTANCES) return NULL;
#endif
#ifdef AT_INSTANTIATE
    AT_INSTANTIATE;
#endif
    enter();
#ifdef DIES_WITH_TWO_INSTANCES
    if (alive++ > 0) abort();
#endif
    m = functions->allocateMemory(1, sizeof *m);
    leave();
    if (m == NULL) return NULL;
    memcpy(&m->functions, functions, sizeof *functions);
    m->logs = logging;
    start_values(m);
#ifdef REMEMBERS_IN_INSTANCE
    m->remembered = 0;
#endif
    m->made_k = K(m);
#ifdef LAST_ONLY
    last = m;
#endif
#ifdef THREAD_DATA
    pthread_setspecific(key, m);
#endif
#ifdef FLUSHES
    _mm_setcsr(_mm_getcsr() | 0x8040);
#endif
    upset(INSTANTIATE);
#if defined(LOGS_LATE) || defined(LOGS_AT_END)
    given = functions;
#endif
    return m;
}

EXPORT void fmi2FreeInstance(fmi2Component c) {
    Model *m = c;
    if (m->fatal) abort();
    upset(FREE);
#ifdef AT_FREE
    AT_FREE;
#endif
#ifdef LOGS_LATE
    {
        pthread_t thread;
        if (pthread_create(&thread, NULL, log_late, (void *)given) == 0) pthread_detach(thread);
    }
#endif
    enter();
#ifdef DIES_WITH_TWO_INSTANCES
    alive--;
#endif
    m->functions.freeMemory(m);
    leave();
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                                      fmi2Boolean has_stop, fmi2Real stop) {
    (void)has_tolerance; (void)tolerance;
#ifdef NEEDS_STOP
    if (!has_stop) {
        say(c, fmi2Error, "a stop time is needed");
        return fmi2Error;
    }
#endif
    ((Model *)c)->stop = stop;
    ((Model *)c)->has_stop = has_stop;
    ((Model *)c)->time = start;
#ifdef BEGINS_IN_SETUP
    K((Model *)c) = 1;
    ((Model *)c)->x = 1;
#endif
#ifdef TELLS_TOLERANCE
    K((Model *)c) = has_tolerance ? tolerance : -1;
#endif
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    (void)c;
#ifdef LATCHES
    if (((Model *)c)->broken) return fmi2Error;
    ((Model *)c)->known = ((Model *)c)->u;
    ((Model *)c)->initialized = 1;
#endif
#ifdef ONE_SET
    ((Model *)c)->is_late = 1;
#endif
    return fmi2OK;
}

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    (void)c;
#ifdef LEAKS
    leak();
#endif
    upset(INITIALIZE);
#ifdef AT_INITIALIZE
    {
        Model *m = c;
        AT_INITIALIZE;
    }
#endif
#ifdef COMPUTES_X
    ((Model *)c)->x = COMPUTES_X;
#endif
#ifdef OVERRIDES_K
    K((Model *)c) = 1.5;
#endif
#ifdef RESTORE_STICKS
    if (((Model *)c)->restored) K((Model *)c) = ((Model *)c)->restored_k;
#endif
#ifdef ODD_RUN
    runs++;
#ifdef FAILING_START
    if (ODD_RUN) return FAILING_START;
#endif
#endif
#ifdef NO_START
    say(c, fmi2Error, "no solution for #r2# (## #r99#)");
    return fmi2Error;
#endif
    return fmi2OK;
}

#ifndef TERMINATE
#define TERMINATE fmi2OK
#endif
EXPORT fmi2Status fmi2Terminate(fmi2Component c) {
    (void)c;
#ifdef FAULT_AT_END
    if (K((Model *)c) > FAULT_ABOVE) FAULT;
#endif
    upset(END);
#ifdef AT_TERMINATE
    AT_TERMINATE;
#endif
    return TERMINATE;
}

EXPORT fmi2Status fmi2Reset(fmi2Component c) {
    Model *m = c;
#ifdef AT_RESET
    AT_RESET;
#endif
#if defined(LYING_RESET)
    double k = K(m);
    start_values(m);
    K(m) = k * 1.0000001;
#elif defined(RESET_AS_MADE)
    start_values(m);
    K(m) = m->made_k;
#elif defined(RESET_KEEPS_PARAMETERS)
    m->time = 0;
    m->x = 1;
#elif defined(RESET_TO_ZERO)
    start_values(m);
    m->x = 0;
#elif defined(FAILING_RESET)
    (void)m;
    return fmi2Error;
#elif defined(RESET)
    start_values(m);
    return RESET;
#else
    start_values(m);
#endif
    return fmi2OK;
}

#include "values.h"
#include "model_exchange.h"
#include "co_simulation.h"
