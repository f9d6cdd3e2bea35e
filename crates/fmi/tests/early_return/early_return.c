/* An FMI 3.0 co-simulation that ends its steps early: x' = u and w' = x by the trapezoidal rule over ten substeps, exact where
 * u is held. When x reaches `level`, the step ends early, and the level rises by 2 in event mode. With NO_EVENT_MODE it refuses
 * to be made with the event mode that its description promises. */
#include "fmi3.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    double time, u, x, w, level;
    int early_allowed, event;
} Model;

static void start_values(Model *m) {
    m->time = m->u = m->x = m->w = 0;
    m->level = 1;
    m->event = 0;
}

FMI3_EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                     fmi3Boolean early, const fmi3ValueReference r[], size_t n,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                     fmi3IntermediateUpdateCallback update) {
    Model *m;
    (void)name, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)r, (void)n;
    (void)environment, (void)log, (void)update;
#ifdef NO_EVENT_MODE
    if (event_mode) {
        log(environment, fmi3Error, "logStatusError", "there is no event mode");
        return NULL;
    }
#endif
    if (strcmp(token, "{early_return}") != 0) return NULL;
    m = calloc(1, sizeof *m);
    if (m == NULL) return NULL;
    m->early_allowed = early;
    start_values(m);
    return m;
}
FMI3_EXPORT void fmi3FreeInstance(fmi3Instance i) { free(i); }
FMI3_EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance i, bool on, size_t n, const fmi3String c[]) {
    (void)i, (void)on, (void)n, (void)c;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance i, bool td, double t, double start, bool sd, double s) {
    (void)td, (void)t, (void)sd, (void)s;
    ((Model *)i)->time = start;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance i) { start_values(i); return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, double v[], size_t nv) {
    Model *m = i;
    const double all[] = {m->time, m->u, m->x, m->w, m->level};
    size_t j;
    for (j = 0; j < n; j++) {
        if (r[j] > 4 || j >= nv) return fmi3Error;
        v[j] = all[r[j]];
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, const double v[], size_t nv) {
    Model *m = i;
    size_t j;
    for (j = 0; j < n; j++) {
        if (j >= nv || r[j] < 1 || r[j] > 4) return fmi3Error;
        *(r[j] == 1 ? &m->u : r[j] == 2 ? &m->x : r[j] == 3 ? &m->w : &m->level) = v[j];
    }
    return fmi3OK;
}
/* At the end of the last step. */
FMI3_EXPORT fmi3Status fmi3GetOutputDerivatives(fmi3Instance i, const fmi3ValueReference r[], size_t n, const int32_t orders[], double v[], size_t nv) {
    Model *m = i;
    size_t j;
    for (j = 0; j < n; j++) {
        if (j >= nv || orders[j] != 1 || (r[j] != 2 && r[j] != 3)) return fmi3Error;
        v[j] = r[j] == 2 ? m->u : m->x;
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance i, bool *a, bool *t, bool *nc, bool *vc, bool *d, double *next) {
    Model *m = i;
    *a = *t = *nc = *vc = *d = false;
    *next = 0;
    if (m->event) m->level += 2;
    m->event = 0;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3DoStep(fmi3Instance i, double t, double h, bool p, bool *e, bool *term, bool *early, double *last) {
    Model *m = i;
    int k;
    (void)p;
    *e = *term = *early = false;
    for (k = 1; k <= 10; k++) {
        const double before = m->x, began = m->time;
        m->time = t + k * (h / 10);
        m->x += (m->time - began) * m->u;
        m->w += (m->time - began) * 0.5 * (before + m->x);
        m->event = m->early_allowed && m->x >= m->level;
        if (m->event && k < 10) {
            *e = *early = true;
            break;
        }
        *e = m->event != 0;
    }
    *last = m->time;
    return fmi3OK;
}
