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
#ifdef SLOW
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
    double y; /* x where the derivatives were computed last */
    int restored;
    double restored_k;
    double remembered;
    double made_k; /* k when the instance was made */
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
}

static void say(Model *m, fmi2Status status, const char *text) {
    m->functions.logger(m->functions.componentEnvironment, "evil", status, "logAll", text);
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
    enter();
#ifdef DIES_WITH_TWO_INSTANCES
    if (alive++ > 0) abort();
#endif
    m = functions->allocateMemory(1, sizeof *m);
    leave();
    if (m == NULL) return NULL;
    memcpy(&m->functions, functions, sizeof *functions);
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
    (void)has_tolerance; (void)tolerance; (void)has_stop; (void)stop;
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
    upset(END);
    return TERMINATE;
}

EXPORT fmi2Status fmi2Reset(fmi2Component c) {
    Model *m = c;
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

#ifdef STATES
EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    Model *m = c;
#ifdef SAVE_FAILS
    say(m, fmi2Error, "nothing can be saved");
    return fmi2Error;
#endif
    if (*state == NULL) *state = m->functions.allocateMemory(1, sizeof *m);
    if (*state == NULL) return fmi2Error;
    memcpy(*state, m, sizeof *m);
    return fmi2OK;
}

/* Everything that was saved, parameters too. */
EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    Model *m = c;
#ifdef RESTORE_FAILS
    return fmi2Error;
#endif
#ifdef RESTORE_FORGETS
    {
        double k = m->k;
        memcpy(m, state, sizeof *m);
        m->x *= 1 + 1e-9 * k;
    }
#else
#ifdef REMEMBERS_IN_INSTANCE
    {
        double remembered = m->remembered;
        memcpy(m, state, sizeof *m);
        m->remembered = remembered;
    }
#else
    memcpy(m, state, sizeof *m);
#endif
#endif
    m->restored = 1;
    m->restored_k = m->k;
    return fmi2OK;
}

EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    ((Model *)c)->functions.freeMemory(*state);
    *state = NULL;
    return fmi2OK;
}
#endif

EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference *vr, size_t n, fmi2Real *value) {
    Model *m = c;
    size_t i;
#ifdef LATCHES
    m->is_spoiled |= m->is_set;
#endif
    for (i = 0; i < n; i++) {
#ifdef STALE_OUTPUTS
        if (vr[i] == 3) {
            value[i] = m->y;
            continue;
        }
#endif
#ifdef TRUSTS_REFERENCES
        static double table[7];
        if (vr[i] > 6) {
            value[i] = table[vr[i]];
            continue;
        }
#endif
        switch (vr[i]) {
        case 0: case 3: value[i] = m->x; break;
        case 1: value[i] = -K(m) * m->x; break;
        case 2: value[i] = K(m); break;
        case 4: value[i] = 2.5; break;
        case 5: value[i] = 2 * K(m); break;
        case 6: value[i] = m->time; break;
        default: return fmi2Error;
        }
#ifdef NAN_OUTPUT
        if (vr[i] == 3) value[i] = NAN;
#endif
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference *vr, size_t n, const fmi2Real *value) {
    Model *m = c;
    size_t i;
    for (i = 0; i < n; i++) {
        switch (vr[i]) {
        case 0: m->x = value[i]; break;
        case 2:
            if (value[i] < 0) {
                say(m, fmi2Error, "#r2# must not be negative, #i0#");
                return fmi2Error;
            }
            K(m) = value[i];
            break;
#ifdef ONE_SET
        case 7:
#ifdef LATE_INPUTS
            if (!m->is_late) {
                say(m, fmi2Error, "inputs are set in initialization mode");
                return fmi2Error;
            }
#endif
            if (m->has_u) {
                say(m, fmi2Error, "the input is set twice at one instant");
                return fmi2Error;
            }
            m->u = value[i];
            m->has_u = 1;
            break;
#endif
#ifdef LATCHES
        case 7:
#ifdef REFUSES_EARLY_INPUTS
            if (!m->initialized) {
                m->broken = 1;
                return fmi2Error;
            }
#endif
            m->u = value[i];
            m->is_set = 1;
            m->is_spoiled = 0;
            break;
#endif
        default: return fmi2Error;
        }
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference *vr, size_t n, fmi2Integer *value) {
    (void)vr;
    while (n-- > 0) value[n] = ((Model *)c)->n;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference *vr, size_t n, const fmi2Integer *value) {
    (void)vr;
    while (n-- > 0) ((Model *)c)->n = value[n];
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference *vr, size_t n, fmi2Boolean *value) {
    (void)vr;
    while (n-- > 0) value[n] = ((Model *)c)->b;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference *vr, size_t n, const fmi2Boolean *value) {
    (void)vr;
    while (n-- > 0) ((Model *)c)->b = value[n];
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterEventMode(fmi2Component c) {
    (void)c;
#ifdef ONE_SET
    ((Model *)c)->has_u = 0; /* the next instant of super-dense time */
#endif
    return fmi2OK;
}

EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    (void)c;
    memset(info, 0, sizeof *info);
#ifdef ENDLESS_EVENTS
    info->newDiscreteStatesNeeded = fmi2True;
#endif
#ifdef PAST_EVENT
    info->nextEventTimeDefined = fmi2True;
    info->nextEventTime = -1;
#endif
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { (void)c; return fmi2OK; }

EXPORT fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set, fmi2Boolean *event,
                                              fmi2Boolean *terminate) {
    (void)c; (void)no_set;
#ifdef REPORTS_PRIOR
    ((Model *)c)->n = no_set;
#endif
    *event = fmi2False;
    *terminate = fmi2False;
#ifdef ENDS_ITSELF
    *terminate = ((Model *)c)->time >= 0.25;
#endif
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
#ifdef ONE_SET
    if (time != ((Model *)c)->time) ((Model *)c)->has_u = 0;
#endif
    ((Model *)c)->time = time;
    upset(SET_TIME);
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real *x, size_t n) {
    if (n != 1) return fmi2Error;
    ((Model *)c)->x = x[0];
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real *x, size_t n) {
    if (n != 1) return fmi2Error;
    x[0] = ((Model *)c)->x;
    return fmi2OK;
}

#ifndef MISSING_SYMBOL
EXPORT fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real *dx, size_t n) {
    Model *m = c;
    if (n != 1) return fmi2Error;
#ifdef FAULT
    if (K(m) > FAULT_ABOVE && m->time > 0.2) FAULT;
#endif
    enter();
    REMEMBER(m);
    dx[0] = -K(m) * m->x + REMEMBERED(m);
    m->y = m->x;
#ifdef FASTER
    dx[0] = -1.5 * m->x;
#endif
#ifdef USES_STRTOD
    dx[0] = -strtod("1.5", NULL) * m->x;
#endif
#ifdef SLOW
    usleep(SLOW);
#endif
    upset(DERIVATIVES);
    leave();
#ifdef ONE_SET
    dx[0] = m->u;
#endif
#ifdef CLASHES
    dx[0] = -atoi("3") * m->x;
#endif
#ifdef UNDEFINED_SYMBOL
    if (m->time > 1e9) dx[0] = not_there(m->x);
#endif
#ifdef LAST_ONLY
    dx[0] = -last->k * m->x;
#endif
#ifdef STATIC_SCRATCH
    {
        volatile int i;
        scratch = m->k;
        for (i = 0; i < 2000; i++) {}
        dx[0] = -scratch * m->x;
    }
#endif
#ifdef FLUSHES
    /* Denormal unless it is flushed. */
    {
        volatile double tiny = 1e-310;
        dx[0] = tiny * 1.0 > 0 ? -1.0 : -2.0;
    }
#endif
#ifdef DISCARD_BELOW
    if (m->x < 0.5) return fmi2Discard;
#endif
#ifdef ERROR_LATE
    if (m->time > 0.5) {
        say(m, fmi2Error, "broken beyond t = 0.5");
        return fmi2Error;
    }
#endif
#ifdef FATAL_LATE
    if (m->time > 0.5) {
        m->fatal = 1;
        return fmi2Fatal;
    }
#endif
#ifdef FAILING_ALWAYS
    return FAILING_ALWAYS;
#endif
#ifdef FAILING_LATE
    if (m->time > 0.5 && (ODD_RUN)) return FAILING_LATE;
#endif
#ifdef ODD_FACTOR
    if (ODD_RUN) dx[0] *= ODD_FACTOR;
#endif
#ifdef ERROR_ABOVE
    if (K(m) > ERROR_ABOVE) return fmi2Error;
#endif
#ifdef FATAL_ABOVE
    if (K(m) > FATAL_ABOVE) {
        m->fatal = 1;
        return fmi2Fatal;
    }
#endif
#ifdef NAN_LATE
    if (m->time > 0.5) dx[0] = NAN;
#endif
#ifdef ODD_STATUS
    if (m->time > 0.5) return (fmi2Status)77;
#endif
#ifdef LOG_FLOOD
    {
        int i;
        for (i = 0; i < 200; i++) {
            say(m, fmi2Warning, NULL);
            say(m, fmi2Warning, "100 % sure, %");
            say(m, fmi2Warning, "bad \xff\xfe bytes");
            m->functions.logger(m->functions.componentEnvironment, NULL, fmi2Warning, NULL, "x = %g of %s", m->x, (char *)NULL);
        }
    }
#endif
    return fmi2OK;
}
#endif

EXPORT fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real *z, size_t n) {
    (void)c; (void)z; (void)n;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real *x, size_t n) {
    (void)c;
    while (n-- > 0) {
#if defined(BAD_NOMINAL)
        x[n] = 0;
#elif defined(NOMINAL)
        x[n] = NOMINAL;
#else
        x[n] = 1;
#endif
    }
    return fmi2OK;
}

/* Co-simulation: the exact solution. */
static void solve(Model *m, double h) {
#ifdef LATCHES
    /* Without fresh inputs, or when values were read since they were set, nothing is integrated. */
    if (m->is_set && !m->is_spoiled) m->x += m->u * h;
#ifdef EXTRAPOLATES
    /* An input that was another one before the initialization goes back. */
    if (m->known != m->u) m->x -= 2 * m->u * h;
#endif
    m->is_set = m->is_spoiled = 0;
    m->time += h;
    return;
#endif
    m->x *= exp(-K(m) * h);
    m->time += h;
}

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set) {
    Model *m = c;
    (void)no_set;
#ifdef REPORTS_PRIOR
    m->n = no_set;
#endif
#ifdef ONE_LENGTH
    if (m->polls == 0) m->k = step;
    /* The last step ends at the stop time. */
    if (step != m->k && fabs(step - m->k) < 1e-9 && time < ONE_LENGTH) {
        say(m, fmi2Error, "a step of nearly the same length");
        return fmi2Error;
    }
    m->polls = -1;
    m->time = time + step;
    return fmi2OK;
#endif
    if (fabs(time - m->time) > 1e-12) {
        say(m, fmi2Error, "the step begins elsewhere");
        return fmi2Error;
    }
#ifdef PARTIAL_STEPS
    if (step > 0.0301) {
        solve(m, 0.03);
        return fmi2Discard;
    }
#endif
#ifdef REFUSES_LONG_STEPS
    if (step > 0.0301) return fmi2Discard;
#endif
#ifdef REFUSES_ALL_STEPS
    return fmi2Discard;
#endif
#ifdef ENDS_ITSELF
    if (time + step >= 0.25) {
        solve(m, 0.25 - time);
        return fmi2Discard;
    }
#endif
#ifdef STEP_ERROR
    if (time > 0.5) {
        say(m, fmi2Error, "no step beyond t = 0.5");
        return fmi2Error;
    }
#endif
#if defined(PENDING) || defined(STUCK)
    m->polls = 3;
#endif
    solve(m, step);
    upset(STEP);
    return m->polls > 0 ? fmi2Pending : fmi2OK;
}

EXPORT fmi2Status fmi2GetStatus(fmi2Component c, fmi2StatusKind kind, fmi2Status *value) {
    Model *m = c;
    if (kind != fmi2DoStepStatus) return fmi2Discard;
#ifndef STUCK
    m->polls--;
#endif
    *value = m->polls > 0 ? fmi2Pending : fmi2OK;
    return fmi2OK;
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component c) {
    ((Model *)c)->polls = 0;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Model *)c)->time;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, fmi2StatusKind kind, fmi2Boolean *value) {
    (void)c;
    if (kind != fmi2Terminated) return fmi2Discard;
#ifdef ENDS_ITSELF
    *value = fmi2True;
#else
    *value = fmi2False;
#endif
    return fmi2OK;
}
