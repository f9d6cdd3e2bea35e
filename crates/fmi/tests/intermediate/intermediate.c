/* An FMI 3.0 co-simulation that calls back during its steps: x' = u and w' = v by the trapezoidal rule over ten substeps,
 * exact where u is a line and is set anew in each of them; v can be set between communication points only. When x
 * reaches `level`, the step ends early, and the level rises by 2 in event mode. With MISUSE it calls back where it must
 * not: at the end of the initialization, and from within itself. */
#include "fmi3.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    double time, u, v, x, w, level;
    int32_t updates, misuse;
    int inside, early_allowed, event, wants_u;
    fmi3InstanceEnvironment environment;
    fmi3IntermediateUpdateCallback update;
} Model;

static void start_values(Model *m) {
    m->time = m->u = m->v = m->x = m->w = 0;
    m->level = 1;
    m->updates = m->misuse = m->inside = m->event = 0;
}

FMI3_EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                     fmi3Boolean early, const fmi3ValueReference r[], size_t n,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                     fmi3IntermediateUpdateCallback update) {
    Model *m;
    size_t i;
    (void)name, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)log;
#ifdef NO_EVENT_MODE
    if (event_mode) {
        log(environment, fmi3Error, "logStatusError", "there is no event mode");
        return NULL;
    }
#endif
    if (strcmp(token, "{intermediate}") != 0) return NULL;
    m = calloc(1, sizeof *m);
    if (m == NULL) return NULL;
    m->environment = environment;
    m->update = update;
    m->early_allowed = early;
    for (i = 0; i < n; i++) m->wants_u |= r[i] == 1;
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

/* Calls back; whether the importer wants to leave the step. */
static bool call_back(Model *m, bool can_leave) {
    bool leave = true;
    double until = -1;
    if (m->update == NULL) return false;
    m->updates++;
    m->inside++;
    /* Any bits that are not 0 are true. */
    m->update(m->environment, m->time, m->wants_u, true, true, can_leave, &leave, &until);
    m->inside--;
    if (until < m->time) m->misuse += 100;
    return leave;
}

FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance i) {
#ifdef MISUSE
    Model *m = i;
    const double u = m->u;
    const bool left = call_back(m, true);
    if (left || m->u != u) m->misuse += 10;
    if (m->update != NULL) m->update(NULL, 0, true, true, true, true, NULL, NULL);
#endif
    (void)i;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance i) { start_values(i); return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, double v[], size_t nv) {
    Model *m = i;
    const double all[] = {m->time, m->u, m->v, m->x, m->w, m->level};
    size_t j;
    for (j = 0; j < n; j++) {
        if (r[j] > 5 || j >= nv) return fmi3Error;
        v[j] = all[r[j]];
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, const double v[], size_t nv) {
    Model *m = i;
    size_t j;
    for (j = 0; j < n; j++) {
        if (j >= nv || r[j] < 1 || r[j] > 5) return fmi3Error;
        if (m->inside && r[j] != 1) return fmi3Error;
        *(r[j] == 1 ? &m->u : r[j] == 2 ? &m->v : r[j] == 3 ? &m->x : r[j] == 4 ? &m->w : &m->level) = v[j];
    }
#ifdef MISUSE
    if (m->inside == 1 && call_back(m, true)) m->misuse += 1;
#endif
#ifdef REFUSES
    if (m->inside && m->time > 1.2) return fmi3Error;
#endif
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetInt32(fmi3Instance i, const fmi3ValueReference r[], size_t n, int32_t v[], size_t nv) {
    Model *m = i;
    size_t j;
    for (j = 0; j < n; j++) {
        if (j >= nv || r[j] < 6 || r[j] > 7) return fmi3Error;
        v[j] = r[j] == 6 ? m->updates : m->misuse;
    }
    return fmi3OK;
}
/* At the end of the last step. */
FMI3_EXPORT fmi3Status fmi3GetOutputDerivatives(fmi3Instance i, const fmi3ValueReference r[], size_t n, const int32_t orders[], double v[], size_t nv) {
    Model *m = i;
    size_t j;
    for (j = 0; j < n; j++) {
        if (j >= nv || orders[j] != 1 || (r[j] != 3 && r[j] != 4)) return fmi3Error;
        v[j] = r[j] == 3 ? m->u : m->v;
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
        const double before = m->u, began = m->time;
        bool leave;
        m->time = t + k * (h / 10);
        leave = call_back(m, m->early_allowed);
        m->x += (m->time - began) * 0.5 * (before + m->u);
        m->w += (m->time - began) * m->v;
        if (leave && !m->early_allowed) m->misuse += 1000;
        m->event = m->early_allowed && m->x >= m->level;
        if ((m->event || leave) && k < 10) {
            *e = m->event != 0;
            *early = true;
            break;
        }
        *e = m->event != 0;
    }
    *last = m->time;
    return fmi3OK;
}
