/* An FMI 3.0 co-simulation of x' = 1 that does not always make the step it is asked for, in a way chosen by a macro:
 * DISCARDS (steps above 0.06, with nothing computed and arguments that say otherwise), RETURNS_EARLY (after 0.04) or
 * STANDS_STILL (returns early where it began, beyond t = 0.5). With INTERNAL_STEPS it moves from one multiple of 0.1 to the
 * next and stands at the last one in between. With ENDS_IN_EVENT it asks for event mode and for the end of the simulation with
 * the step that reaches t = 0.5, and refuses event mode. */
#include "fmi3.h"

#include <math.h>
#include <stdlib.h>

typedef struct {
    double time, x;
} Model;

FMI3_EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                     fmi3Boolean early, const fmi3ValueReference r[], size_t n,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                     fmi3IntermediateUpdateCallback update) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early, (void)r, (void)n;
    (void)environment, (void)log, (void)update;
    return calloc(1, sizeof(Model));
}
FMI3_EXPORT void fmi3FreeInstance(fmi3Instance i) { free(i); }
FMI3_EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance i, bool td, double t, double start, bool sd, double s) {
    (void)td, (void)t, (void)sd, (void)s;
    ((Model *)i)->time = start;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance i) { ((Model *)i)->x = 0; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, double v[], size_t nv) {
    size_t j;
    for (j = 0; j < n && j < nv; j++) v[j] = r[j] == 0 ? ((Model *)i)->time : ((Model *)i)->x;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, const double v[], size_t nv) {
    size_t j;
    for (j = 0; j < n && j < nv; j++) {
        if (r[j] == 1) ((Model *)i)->x = v[j];
    }
    return fmi3OK;
}
#ifdef ENDS_IN_EVENT
FMI3_EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance i) { (void)i; return fmi3Error; }
FMI3_EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance i, bool *a, bool *t, bool *nc, bool *vc, bool *d, double *next) {
    (void)i;
    *a = *t = *nc = *vc = *d = false;
    *next = 0;
    return fmi3OK;
}
#endif
FMI3_EXPORT fmi3Status fmi3DoStep(fmi3Instance i, double t, double h, bool p, bool *e, bool *term, bool *early, double *last) {
    Model *m = i;
    double made = h;
    (void)p;
    *e = *term = *early = false;
#ifdef DISCARDS
    if (h > 0.06) {
        *term = *e = true;
        *last = t + h;
        return fmi3Discard;
    }
#endif
#ifdef RETURNS_EARLY
    if (h > 0.05) made = 0.04;
#endif
#ifdef STANDS_STILL
    if (t > 0.5) made = 0;
#endif
#ifdef INTERNAL_STEPS
    m->time = m->x = 0.1 * floor((t + h) / 0.1 + 1e-9);
#else
    m->time = t + made;
    m->x += made;
    *early = made < h;
#endif
#ifdef ENDS_IN_EVENT
    *e = *term = m->time > 0.5 - 1e-9;
#endif
    *last = m->time;
    return fmi3OK;
}
