/* An FMI 3.0 model (model exchange, and co-simulation with an event mode) that ticks at start + k * period, k = 1, 2, ...:
 * n counts the ticks, and one counts only where the time is not before it, to the last bit. x' = n + 10 on + 100 gear, where
 * "on" tells, since the last event, whether u is above 0.5: the event indicator. Strict: the time never goes back behind a completed step or an event, and the
 * discrete input "gear" is set in initialization and event mode only. */
#include "fmi3.h"

#include <stdlib.h>
#include <string.h>

enum { INSTANTIATED, INITIALIZATION, EVENT, CONTINUOUS, STEP };

typedef struct {
    double time, x, n, period, u, on, gear, visits, start, floor;
    int phase, co_simulation;
} Model;

static void start_values(Model *m) {
    const int co_simulation = m->co_simulation;
    memset(m, 0, sizeof *m);
    m->co_simulation = co_simulation;
    m->period = 0.1;
}
static fmi3Instance make(int co_simulation) {
    Model *m = calloc(1, sizeof *m);
    if (m != NULL) { m->co_simulation = co_simulation; start_values(m); }
    return m;
}
static double next(const Model *m) { return m->start + (m->n + 1) * m->period; }
static double slope(const Model *m) { return m->n + 10 * m->on + 100 * m->gear; }

FMI3_EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
FMI3_EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging,
                                                      fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    return make(0);
}
FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                     fmi3Boolean early, const fmi3ValueReference r[], size_t n,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                     fmi3IntermediateUpdateCallback update) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early, (void)r, (void)n;
    (void)environment, (void)log, (void)update;
    return make(1);
}
FMI3_EXPORT void fmi3FreeInstance(fmi3Instance i) { free(i); }
FMI3_EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance i, bool td, double t, double start, bool sd, double s) {
    Model *m = i;
    (void)td, (void)t, (void)sd, (void)s;
    m->time = m->start = m->floor = start;
    m->phase = INITIALIZATION;
    return fmi3OK;
}
static fmi3Status enter(Model *m, int phase) { m->phase = phase; m->floor = m->time; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance i) { return enter(i, EVENT); }
FMI3_EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance i) { return enter(i, EVENT); }
FMI3_EXPORT fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance i) { return enter(i, CONTINUOUS); }
FMI3_EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance i) { return enter(i, STEP); }
FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance i) { start_values(i); return fmi3OK; }

FMI3_EXPORT fmi3Status fmi3GetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, double v[], size_t nv) {
    const Model *m = i;
    const double values[] = { m->time, m->x, slope(m), m->n, m->period, m->u, m->on, m->gear, m->visits };
    size_t j;
    for (j = 0; j < n && j < nv; j++) v[j] = values[r[j]];
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, const double v[], size_t nv) {
    Model *m = i;
    size_t j;
    for (j = 0; j < n && j < nv; j++) {
        if (r[j] == 1) m->x = v[j];
        else if (r[j] == 4 && m->phase == INSTANTIATED) m->period = v[j];
        else if (r[j] == 5) m->u = v[j];
        else if (r[j] == 7 && m->phase <= EVENT) m->gear = v[j];
        else return fmi3Error;
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance i, bool *again, bool *end, bool *nominals, bool *states,
                                                bool *has_next, double *at) {
    Model *m = i;
    if (m->phase != EVENT) return fmi3Error;
    *again = *end = *nominals = *states = false;
    m->visits++;
    m->on = m->u > 0.5;
    if (m->time >= next(m)) m->n++;
    *has_next = true;
    *at = next(m);
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetTime(fmi3Instance i, double t) {
    Model *m = i;
    if (t < m->floor) return fmi3Error;
    m->time = t;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance i, bool no_set, bool *event, bool *end) {
    (void)no_set;
    ((Model *)i)->floor = ((Model *)i)->time;
    *event = *end = false;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance i, size_t *n) { (void)i; *n = 1; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance i, size_t *n) { (void)i; *n = 1; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance i, double x[], size_t n) { if (n) *x = ((Model *)i)->x; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance i, const double x[], size_t n) { if (n) ((Model *)i)->x = *x; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance i, double dx[], size_t n) { if (n) *dx = slope(i); return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance i, double x[], size_t n) { (void)i; if (n) *x = 1; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetEventIndicators(fmi3Instance i, double z[], size_t n) { if (n) *z = ((Model *)i)->u - 0.5; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3DoStep(fmi3Instance i, double t, double h, bool p, bool *event, bool *end, bool *early, double *last) {
    Model *m = i;
    (void)p;
    if (m->phase != STEP) return fmi3Error;
    m->x += slope(m) * h;
    m->time = *last = t + h;
    *event = m->time >= next(m);
    *end = *early = false;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetFMUState(fmi3Instance i, fmi3FMUState *s) {
    if (*s == NULL) *s = malloc(sizeof(Model));
    if (*s == NULL) return fmi3Error;
    memcpy(*s, i, sizeof(Model));
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetFMUState(fmi3Instance i, fmi3FMUState s) { memcpy(i, s, sizeof(Model)); return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance i, fmi3FMUState *s) { (void)i; free(*s); *s = NULL; return fmi3OK; }
