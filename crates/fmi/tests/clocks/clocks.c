/* An FMI 3.0 model (model exchange and co-simulation with event mode) with a clock of every kind. An integrator x' = u
 * is controlled by a sampler: at each tick of "sample", u = K (setpoint - x), held until the next. Ticks are counted.
 *   sample    constant, every 0.1
 *   third     constant as a fraction, 1/3, 2/3, ...
 *   counted   fixed: interval and shift are asked for, period and half of it, in thousandths
 *   growing   changing: at start + gap, then each interval twice as long as the one before
 *   later     countdown: ticks `delay` after each tick of "button"
 *   button    triggered from outside
 *   alarm     output: ticks whenever "later" does
 *   optional  fixed with a given interval, may be left out
 *   retuned   tunable: every 0.5, after its second tick every 0.25
 * As strict as the standard: clocks are set in event mode only, clocked inputs only while their clock ticks, intervals
 * are told in initialization and event mode only. */
#include "fmi3.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { SAMPLE = 11, THIRD, COUNTED, GROWING, LATER, BUTTON, ALARM, OPTIONAL, RETUNED, LAST };
enum { START, INITIALIZATION, EVENT, CONTINUOUS, STEP };

typedef struct {
    double time, x, u, K, period, delay, setpoint, gap;
    int32_t counts[LAST];
    int32_t visits;
    int active[LAST];
    int told;             /* the countdown has been told */
    int counting;         /* it runs, or ends now */
    double countdown_end;
    int told_tunable;
    double tunable;
    double growing;
    int phase, co_simulation;
} Model;

static void start_values(Model *m) {
    const int co_simulation = m->co_simulation;
    memset(m, 0, sizeof *m);
    m->co_simulation = co_simulation;
    m->x = 1; m->K = 2; m->period = 0.3; m->delay = 0.125; m->gap = 0.0625; m->tunable = 0.5;
}

static fmi3Instance make(fmi3String token, int co_simulation) {
    Model *m;
    if (strcmp(token, "{clocks}") != 0) return NULL;
    m = malloc(sizeof *m);
    if (m != NULL) { m->co_simulation = co_simulation; start_values(m); }
    return m;
}

FMI3_EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
FMI3_EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging,
                                                      fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    return make(token, 0);
}
FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                     fmi3Boolean early, const fmi3ValueReference r[], size_t n,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                     fmi3IntermediateUpdateCallback update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)environment, (void)log, (void)r, (void)n;
    (void)update, (void)early;
#ifdef NO_EVENT_MODE
    event_mode = !event_mode;
#endif
    return event_mode ? make(token, 1) : NULL;
}
FMI3_EXPORT void fmi3FreeInstance(fmi3Instance i) { free(i); }
FMI3_EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance i, bool on, size_t n, const fmi3String c[]) {
    (void)i, (void)on, (void)n, (void)c;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance i, bool td, double t, double start, bool sd, double s) {
    Model *m = i;
    (void)td, (void)t, (void)sd, (void)s;
    m->time = start;
    m->growing = m->gap;
    m->phase = INITIALIZATION;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance i) { ((Model *)i)->phase = EVENT; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance i) { start_values(i); return fmi3OK; }

static double *real(Model *m, fmi3ValueReference r, double *scratch) {
    switch (r) {
        case 0: return &m->time;
        case 1: return &m->x;
        case 2: *scratch = m->u; return scratch;
        case 3: return &m->u;
        case 4: return &m->K;
        case 5: return &m->period;
        case 6: return &m->delay;
        case 7: return &m->setpoint;
        case 8: return &m->gap;
        default: return NULL;
    }
}
FMI3_EXPORT fmi3Status fmi3GetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, double v[], size_t nv) {
    size_t j;
    double scratch;
    for (j = 0; j < n; j++) {
        double *p = real(i, r[j], &scratch);
        if (p == NULL || j >= nv) return fmi3Error;
        v[j] = *p;
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, const double v[], size_t nv) {
    Model *m = i;
    size_t j;
    double scratch;
    for (j = 0; j < n; j++) {
        double *p = real(m, r[j], &scratch);
        const int clocked = r[j] == 7 && m->phase == EVENT && m->active[SAMPLE];
        if (p == NULL || j >= nv || !(clocked || m->phase <= INITIALIZATION)) return fmi3Error;
        *p = v[j];
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetInt32(fmi3Instance i, const fmi3ValueReference r[], size_t n, int32_t v[], size_t nv) {
    Model *m = i;
    size_t j;
    for (j = 0; j < n; j++) {
        if (j >= nv || r[j] < 21 || r[j] > 30) return fmi3Error;
        v[j] = r[j] == 30 ? m->visits : m->counts[r[j] - 10];
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetClock(fmi3Instance i, const fmi3ValueReference r[], size_t n, const bool v[]) {
    Model *m = i;
    size_t j;
    for (j = 0; j < n; j++) {
        if (m->phase != EVENT || r[j] < SAMPLE || r[j] >= LAST || r[j] == ALARM) return fmi3Error;
        if (r[j] == LATER && !(m->counting && fabs(m->time - m->countdown_end) < 1e-9)) return fmi3Error;
        m->active[r[j]] = v[j];
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetClock(fmi3Instance i, const fmi3ValueReference r[], size_t n, bool v[]) {
    Model *m = i;
    size_t j;
    for (j = 0; j < n; j++) {
        if (m->phase != EVENT || r[j] != ALARM) return fmi3Error;
        v[j] = m->active[LATER];
    }
    return fmi3OK;
}
enum { NOT_YET_KNOWN, UNCHANGED, CHANGED };
FMI3_EXPORT fmi3Status fmi3GetIntervalDecimal(fmi3Instance i, const fmi3ValueReference r[], size_t n, double v[], int q[]) {
    Model *m = i;
    size_t j;
    for (j = 0; j < n; j++) {
        if (m->phase != INITIALIZATION && m->phase != EVENT) return fmi3Error;
        if (r[j] == GROWING) {
            v[j] = m->growing;
            q[j] = CHANGED;
            m->growing *= 2;
        } else if (r[j] == LATER) {
            q[j] = !m->counting ? NOT_YET_KNOWN : m->told ? UNCHANGED : CHANGED;
            v[j] = m->delay;
            m->told = m->counting;
        } else if (r[j] == RETUNED) {
            q[j] = m->told_tunable ? UNCHANGED : CHANGED;
            v[j] = m->tunable;
            m->told_tunable = 1;
        } else {
            return fmi3Error;
        }
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetIntervalFraction(fmi3Instance i, const fmi3ValueReference r[], size_t n, uint64_t c[], uint64_t d[], int q[]) {
    Model *m = i;
    if (m->phase != INITIALIZATION || n != 1 || r[0] != COUNTED) return fmi3Error;
    c[0] = (uint64_t)llround(1000 * m->period);
    d[0] = 1000;
    q[0] = CHANGED;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetShiftFraction(fmi3Instance i, const fmi3ValueReference r[], size_t n, uint64_t c[], uint64_t d[]) {
    Model *m = i;
    if (m->phase != INITIALIZATION || n != 1 || r[0] != COUNTED) return fmi3Error;
    c[0] = (uint64_t)llround(500 * m->period);
    d[0] = 1000;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetShiftDecimal(fmi3Instance i, const fmi3ValueReference r[], size_t n, double v[]) {
    Model *m = i;
    if (m->phase != INITIALIZATION || n != 1 || r[0] != RETUNED) return fmi3Error;
    v[0] = 0.25;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SetIntervalDecimal(fmi3Instance i, const fmi3ValueReference r[], size_t n, const double v[]) {
    Model *m = i;
    if (m->phase != INITIALIZATION || n != 1 || v[0] > 100) return fmi3Error;
    if (r[0] == COUNTED) {
        m->period = v[0];
    } else if (r[0] == RETUNED) {
        m->tunable = v[0];
        m->told_tunable = 1;
    } else if (r[0] != OPTIONAL) {
        return fmi3Error;
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetIntervalFraction(fmi3Instance i, const fmi3ValueReference r[], size_t n, const uint64_t c[], const uint64_t d[]) {
    Model *m = i;
    if (m->phase != INITIALIZATION || n != 1 || r[0] != COUNTED) return fmi3Error;
    m->period = (double)c[0] / (double)d[0];
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance i) {
    Model *m = i;
    if (m->phase != CONTINUOUS && m->phase != STEP) return fmi3Error;
    m->phase = EVENT;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance i, bool *a, bool *t, bool *nc, bool *vc, bool *d, double *next) {
    Model *m = i;
    int k;
    *a = *t = *nc = *vc = *d = false;
    *next = 0;
    if (m->phase != EVENT) return fmi3Error;
    m->visits++;
    for (k = SAMPLE; k < LAST; k++) m->counts[k] += m->active[k];
    m->counts[ALARM] += m->active[LATER];
    if (m->active[SAMPLE]) m->u = m->K * (m->setpoint - m->x);
    if (m->active[LATER]) m->counting = 0;
    if (m->active[BUTTON]) {
        m->counting = 1;
        m->told = 0;
        m->countdown_end = m->time + m->delay;
    }
    if (m->active[RETUNED] && m->counts[RETUNED] == 2) {
        m->tunable = 0.25;
        m->told_tunable = 0;
    }
    memset(m->active, 0, sizeof m->active);
#ifdef ENDLESS
    *a = m->time >= ENDLESS;
#endif
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance i) { ((Model *)i)->phase = CONTINUOUS; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance i) { ((Model *)i)->phase = STEP; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance i, bool p, bool *e, bool *t) {
    (void)i, (void)p;
    *e = *t = false;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetTime(fmi3Instance i, double t) { ((Model *)i)->time = t; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance i, const double x[], size_t n) {
    if (n != 1) return fmi3Error;
    ((Model *)i)->x = x[0];
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance i, double x[], size_t n) {
    if (n != 1) return fmi3Error;
    x[0] = ((Model *)i)->x;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance i, double dx[], size_t n) {
    if (n != 1) return fmi3Error;
    dx[0] = ((Model *)i)->u;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetEventIndicators(fmi3Instance i, double z[], size_t n) { (void)i, (void)z; return n ? fmi3Error : fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance i, double x[], size_t n) {
    (void)i;
    while (n-- > 0) x[n] = 1;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance i, size_t *n) { (void)i; *n = 1; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance i, size_t *n) { (void)i; *n = 0; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3DoStep(fmi3Instance i, double t, double h, bool p, bool *e, bool *term, bool *early, double *last) {
    Model *m = i;
    (void)p;
    *e = *term = *early = false;
    if (m->phase != STEP) return fmi3Error;
    m->x += m->u * h;
    m->time = *last = t + h;
    return fmi3OK;
}
