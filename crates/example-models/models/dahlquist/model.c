/* Dahlquist's test equation; equation and closed form: readme.md. */
#include "model.h"

typedef struct {
    double x;
    double derivative;
    double k;
} Memory;

#define AT(member) offsetof(Memory, member)

enum { TIME, X, DER_X, K };

static const ModelVariable variables[] = {
    [TIME] = {"time", MODEL_REAL, MODEL_TIME, 0, 0},
    [X] = {"x", MODEL_REAL, MODEL_STATE, AT(x), 1},
    [DER_X] = {"der(x)", MODEL_REAL, MODEL_CALCULATED, AT(derivative), 0},
    [K] = {"k", MODEL_REAL, MODEL_FIXED, AT(k), 1},
};

static ModelStatus calculate(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    (void)time;
    (void)problem;
    memory->derivative = -memory->k * memory->x;
    return MODEL_OK;
}

static double partial(const void *instance, unsigned unknown, unsigned known) {
    const Memory *memory = (const Memory *)instance;
    (void)unknown; /* there is only der(x) */
    return known == X ? -memory->k : known == K ? -memory->x : 0;
}

const ModelDefinition model = {
    .identifier = "dahlquist",
    .token = "{9686edb1-c995-41e0-a850-2ee5a2df2214}",
    .variables = variables,
    .n_variables = sizeof variables / sizeof variables[0],
    .memory_size = sizeof(Memory),
    .states = AT(x),
    .derivatives = AT(derivative),
    .n_states = 1,
    .calculate = calculate,
    .partial = partial,
};
