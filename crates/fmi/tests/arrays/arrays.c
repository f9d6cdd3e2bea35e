/* An FMI 3.0 model (model exchange and co-simulation) with what the example models lack: x' = u - k .* x with n states
 * in one array, a matrix, all widths of integers, texts and bytes. Lenient, but strict about the numbers of values. With SINGLE
 * the value of type Float32 is added to u. */
#include "fmi3.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define MOST 5

typedef struct {
    uint64_t n;
    double time, x[MOST], dx[MOST], k[MOST], u[MOST], sum;
    int32_t steps[2];
    float f32;
    int8_t i8; uint8_t u8; int16_t i16; uint16_t u16; int32_t i32; uint32_t u32; int64_t i64; uint64_t u64;
    int64_t choice, count;
    int32_t matrix[6];
    bool flags[2];
    char text[2][16], word[16];
    uint8_t bytes[16], packet[16];
    size_t n_bytes, n_packet;
    int configuring;
} Model;

static void start_values(Model *m) {
    int i;
    memset(m, 0, sizeof *m);
    m->n = 3;
    for (i = 0; i < MOST; i++) { m->x[i] = i + 1; m->k[i] = 1; }
    m->steps[0] = m->steps[1] = 1;
    m->f32 = 0.5f; m->i8 = -8; m->u8 = 208; m->i16 = -16; m->u16 = 60016; m->i32 = -32; m->u32 = 4000000032u;
    m->i64 = -64; m->u64 = 18000000000000000064u; m->choice = 2;
    for (i = 0; i < 6; i++) m->matrix[i] = i;
    m->flags[0] = true;
    strcpy(m->text[0], "one"); strcpy(m->text[1], "two"); strcpy(m->word, "none");
    m->bytes[0] = 0xca; m->bytes[1] = 0xfe; m->n_bytes = 2;
}

#ifdef LOGS_LATE
/* A thread that uses the callback when the instance has gone. */
#include <pthread.h>
#include <unistd.h>
static fmi3LogMessageCallback given;
static fmi3InstanceEnvironment given_environment;

static void *log_late(void *nothing) {
    int i;
    for (i = 0; i < 20; i++) {
        usleep(2000);
        given(given_environment, fmi3Warning, "logAll", "late");
    }
    return nothing;
}
#endif

static fmi3Instance make(fmi3String token) {
    Model *m;
    if (strcmp(token, "{arrays}") != 0) return NULL;
    m = malloc(sizeof *m);
    if (m != NULL) start_values(m);
    return m;
}

FMI3_EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
FMI3_EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging,
                                                      fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
#ifdef LOGS_LATE
    given = log;
    given_environment = environment;
#endif
    return make(token);
}
FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                     fmi3Boolean early, const fmi3ValueReference r[], size_t n,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                     fmi3IntermediateUpdateCallback update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)environment, (void)log, (void)r, (void)n;
    (void)update;
    return event_mode || early ? NULL : make(token);
}
FMI3_EXPORT void fmi3FreeInstance(fmi3Instance i) {
#ifdef LOGS_LATE
    pthread_t thread;
    if (pthread_create(&thread, NULL, log_late, NULL) == 0) pthread_detach(thread);
#endif
    free(i);
}
FMI3_EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance i, bool td, double t, double start, bool sd, double s) {
    (void)td, (void)t, (void)sd, (void)s;
    ((Model *)i)->time = start;
    return ((Model *)i)->configuring ? fmi3Error : fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance i) { start_values(i); return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetFMUState(fmi3Instance i, fmi3FMUState *s) {
    if (*s == NULL) *s = malloc(sizeof(Model));
    if (*s == NULL) return fmi3Error;
    memcpy(*s, i, sizeof(Model));
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetFMUState(fmi3Instance i, fmi3FMUState s) { memcpy(i, s, sizeof(Model)); return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance i, fmi3FMUState *s) { (void)i; free(*s); *s = NULL; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3EnterConfigurationMode(fmi3Instance i) { ((Model *)i)->configuring = 1; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3ExitConfigurationMode(fmi3Instance i) { ((Model *)i)->configuring = 0; return fmi3OK; }

/* Copies the values of one variable after the other; the numbers must fit. */
#define ACCESS(type, c_type, FIND)                                                                                    \
    FMI3_EXPORT fmi3Status fmi3Get##type(fmi3Instance i, const fmi3ValueReference r[], size_t n, c_type v[], size_t nv) { \
        Model *m = i;                                                                                                 \
        size_t at = 0, j, count;                                                                                      \
        for (j = 0; j < n; j++) {                                                                                     \
            c_type *p = NULL;                                                                                         \
            count = 1;                                                                                                \
            switch (r[j]) { FIND }                                                                                    \
            if (p == NULL || at + count > nv) return fmi3Error;                                                       \
            memcpy(v + at, p, count * sizeof *p);                                                                     \
            at += count;                                                                                              \
        }                                                                                                             \
        return at == nv ? fmi3OK : fmi3Error;                                                                         \
    }                                                                                                                 \
    FMI3_EXPORT fmi3Status fmi3Set##type(fmi3Instance i, const fmi3ValueReference r[], size_t n, const c_type v[], size_t nv) { \
        Model *m = i;                                                                                                 \
        size_t at = 0, j, count;                                                                                      \
        for (j = 0; j < n; j++) {                                                                                     \
            c_type *p = NULL;                                                                                         \
            count = 1;                                                                                                \
            switch (r[j]) { FIND }                                                                                    \
            if (p == NULL || at + count > nv || (m->configuring && r[j] != 1)) return fmi3Error;                      \
            memcpy(p, v + at, count * sizeof *p);                                                                     \
            at += count;                                                                                              \
        }                                                                                                             \
        if (m->n > MOST) { m->n = 3; return fmi3Discard; }                                                            \
        return at == nv ? fmi3OK : fmi3Error;                                                                         \
    }
static double *derivatives(Model *m) {
    size_t j;
    for (j = 0; j < m->n; j++) m->dx[j] = m->u[j] - m->k[j] * m->x[j];
#ifdef SINGLE
    for (j = 0; j < m->n; j++) m->dx[j] += m->f32;
#endif
    return m->dx;
}
static double *sum(Model *m) {
    size_t j;
    m->sum = 0;
    for (j = 0; j < m->n; j++) m->sum += m->x[j];
#ifdef NAN_ABOVE
    if (m->k[0] > NAN_ABOVE) m->sum = NAN;
#endif
    return &m->sum;
}
ACCESS(Float64, double, case 0: p = &m->time; break; case 2: p = m->x; count = m->n; break;
       case 3: p = derivatives(m); count = m->n; break; case 4: p = m->k; count = m->n; break; case 5: p = sum(m); break;
       case 6: p = m->u; count = m->n; break;)
ACCESS(Float32, float, case 10: p = &m->f32; break;)
ACCESS(Int8, int8_t, case 11: p = &m->i8; break;)
ACCESS(UInt8, uint8_t, case 12: p = &m->u8; break;)
ACCESS(Int16, int16_t, case 13: p = &m->i16; break;)
ACCESS(UInt16, uint16_t, case 14: p = &m->u16; break;)
ACCESS(Int32, int32_t, case 7: p = m->steps; count = 2; break; case 15: p = &m->i32; break; case 21: p = m->matrix; count = 6; break;)
ACCESS(UInt32, uint32_t, case 16: p = &m->u32; break;)
/* More than doubles can tell apart. */
static int64_t *counted(Model *m) {
    m->count = (INT64_C(1) << 53) + 1 + (int64_t)floor(10 * m->time + 0.5);
    return &m->count;
}
ACCESS(Int64, int64_t, case 17: p = &m->i64; break; case 19: p = &m->choice; break; case 26: p = counted(m); break;)
ACCESS(UInt64, uint64_t, case 1: p = m->configuring || v != NULL ? &m->n : NULL; break; case 18: p = &m->u64; break;)
ACCESS(Boolean, bool, case 20: p = m->flags; count = 2; break;)

FMI3_EXPORT fmi3Status fmi3GetString(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3String v[], size_t nv) {
    Model *m = i;
    size_t at = 0, j;
    for (j = 0; j < n; j++) {
        if (r[j] == 22 && at + 2 <= nv) {
            v[at++] = m->text[0]; v[at++] = m->text[1];
        } else if (r[j] == 24 && at < nv) {
#ifdef LONG_TEXT
            static char text[LONG_TEXT + 1];
            memset(text, m->time < 0.45 ? 'e' : 'l', LONG_TEXT);
            v[at++] = text;
#else
            v[at++] = m->time < 0.45 ? "early" : "late";
#endif
        } else if (r[j] == 27 && at < nv) {
            v[at++] = m->word;
        } else {
            return fmi3Error;
        }
    }
    return at == nv ? fmi3OK : fmi3Error;
}
FMI3_EXPORT fmi3Status fmi3SetString(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3String v[], size_t nv) {
    Model *m = i;
    if (n == 1 && r[0] == 27 && nv == 1 && strlen(v[0]) < 16) {
        strcpy(m->word, v[0]);
        return fmi3OK;
    }
    if (n != 1 || r[0] != 22 || nv != 2 || strlen(v[0]) > 15 || strlen(v[1]) > 15) return fmi3Error;
    strcpy(m->text[0], v[0]); strcpy(m->text[1], v[1]);
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetBinary(fmi3Instance i, const fmi3ValueReference r[], size_t n, size_t s[], fmi3Binary v[], size_t nv) {
    Model *m = i;
    size_t j;
    if (n != nv) return fmi3Error;
    for (j = 0; j < n; j++) {
        if (r[j] == 23) {
            s[j] = m->n_bytes; v[j] = m->bytes;
#ifdef HUGE_BINARY
            s[j] = (size_t)1 << HUGE_BINARY;
#endif
        } else if (r[j] == 28) {
            s[j] = m->n_packet; v[j] = m->packet;
        } else if (r[j] == 25) { /* longer with time, and empty at first */
            s[j] = (size_t)floor(10 * m->time + 0.5) % 4; v[j] = (const uint8_t *)"\0\1\377";
        } else {
            return fmi3Error;
        }
    }
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetBinary(fmi3Instance i, const fmi3ValueReference r[], size_t n, const size_t s[], const fmi3Binary v[], size_t nv) {
    Model *m = i;
    if (n == 1 && r[0] == 28 && nv == 1 && s[0] <= sizeof m->packet) {
        memcpy(m->packet, v[0], s[0]); m->n_packet = s[0];
        return fmi3OK;
    }
    if (n != 1 || r[0] != 23 || nv != 1 || s[0] > sizeof m->bytes) return fmi3Error;
    memcpy(m->bytes, v[0], s[0]); m->n_bytes = s[0];
    return fmi3OK;
}

/* Of dx = u - k .* x with respect to x: a diagonal matrix, the same from both sides. */
static fmi3Status along_diagonal(Model *m, unsigned unknown, unsigned known, const double in[], size_t n_in, double out[], size_t n_out) {
    size_t j;
    if (unknown != 3 || known != 2 || n_in != m->n || n_out != m->n) return fmi3Error;
    for (j = 0; j < m->n; j++) out[j] = -m->k[j] * in[j];
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetDirectionalDerivative(fmi3Instance i, const fmi3ValueReference unknowns[], size_t nu,
                                                    const fmi3ValueReference knowns[], size_t nk, const double seed[],
                                                    size_t ns, double sensitivity[], size_t n) {
    return nu == 1 && nk == 1 ? along_diagonal(i, unknowns[0], knowns[0], seed, ns, sensitivity, n) : fmi3Error;
}
FMI3_EXPORT fmi3Status fmi3GetAdjointDerivative(fmi3Instance i, const fmi3ValueReference unknowns[], size_t nu,
                                                const fmi3ValueReference knowns[], size_t nk, const double seed[],
                                                size_t ns, double sensitivity[], size_t n) {
    return nu == 1 && nk == 1 ? along_diagonal(i, unknowns[0], knowns[0], seed, ns, sensitivity, n) : fmi3Error;
}
/* Each derivative on its state by a fixed factor, and on no element of the input u as far as the present run goes. */
FMI3_EXPORT fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance i, fmi3ValueReference r, size_t *n) {
    *n = r == 3 ? ((Model *)i)->n + 1 : 0;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetVariableDependencies(fmi3Instance i, fmi3ValueReference r, size_t elements[],
                                                   fmi3ValueReference knowns[], size_t known_elements[], int kinds[],
                                                   size_t n) {
    size_t j;
    if (r != 3 || n != ((Model *)i)->n + 1) return fmi3Error;
    for (j = 0; j + 1 < n; j++) {
        elements[j] = known_elements[j] = j + 1;
        knowns[j] = 2;
        kinds[j] = 2;
    }
    elements[j] = known_elements[j] = 0;
    knowns[j] = 6;
    kinds[j] = 0;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance i, bool *a, bool *t, bool *nc, bool *vc, bool *d, double *next) {
    (void)i;
    *a = *t = *nc = *vc = *d = false;
    *next = 0;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance i) { (void)i; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance i, bool p, bool *e, bool *t) {
    (void)i, (void)p;
    *e = *t = false;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3SetTime(fmi3Instance i, double t) { ((Model *)i)->time = t; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance i, const double x[], size_t n) {
    Model *m = i;
    if (n != m->n) return fmi3Error;
    memcpy(m->x, x, n * sizeof *x);
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance i, double x[], size_t n) {
    Model *m = i;
    if (n != m->n) return fmi3Error;
    memcpy(x, m->x, n * sizeof *x);
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance i, double dx[], size_t n) {
    Model *m = i;
    if (n != m->n) return fmi3Error;
    memcpy(dx, derivatives(m), n * sizeof *dx);
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetEventIndicators(fmi3Instance i, double z[], size_t n) { (void)i, (void)z; return n ? fmi3Error : fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance i, double x[], size_t n) {
    (void)i;
    while (n-- > 0) x[n] = 1;
    return fmi3OK;
}
FMI3_EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance i, size_t *n) { *n = ((Model *)i)->n; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance i, size_t *n) { (void)i; *n = 0; return fmi3OK; }
FMI3_EXPORT fmi3Status fmi3DoStep(fmi3Instance i, double t, double h, bool p, bool *e, bool *term, bool *early, double *last) {
    Model *m = i;
    size_t j;
    (void)p;
    for (j = 0; j < m->n; j++) m->x[j] = m->u[j] / m->k[j] + (m->x[j] - m->u[j] / m->k[j]) * exp(-m->k[j] * h);
    m->time = *last = t + h;
    *e = *term = *early = false;
    return fmi3OK;
}
