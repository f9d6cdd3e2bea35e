/* Van der Pol's oscillator; equations and reference values: readme.md. */
#include "model.h"

typedef struct {
    double states[2];
    double derivatives[2];
    double mu;
} Memory;

#define AT(member) offsetof(Memory, member)

enum { TIME, X0, DER_X0, X1, DER_X1, MU };

static const ModelVariable variables[] = {
    [TIME] = {"time", MODEL_REAL, MODEL_TIME, 0, 0},
    [X0] = {"x0", MODEL_REAL, MODEL_STATE, AT(states), 2},
    [DER_X0] = {"der(x0)", MODEL_REAL, MODEL_CALCULATED, AT(derivatives), 0},
    [X1] = {"x1", MODEL_REAL, MODEL_STATE, AT(states) + sizeof(double), 0},
    [DER_X1] = {"der(x1)", MODEL_REAL, MODEL_CALCULATED, AT(derivatives) + sizeof(double), 0},
    [MU] = {"mu", MODEL_REAL, MODEL_FIXED, AT(mu), 1},
};

static ModelStatus calculate(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    const double x0 = memory->states[0], x1 = memory->states[1];
    (void)time;
    (void)problem;
    memory->derivatives[0] = x1;
    memory->derivatives[1] = memory->mu * (1 - x0 * x0) * x1 - x0;
    return MODEL_OK;
}

static double partial(const void *instance, unsigned unknown, unsigned known) {
    const Memory *memory = (const Memory *)instance;
    const double x0 = memory->states[0], x1 = memory->states[1];
    if (unknown == DER_X0) {
        return known == X1 ? 1 : 0;
    }
    switch (known) {
    case X0:
        return -2 * memory->mu * x0 * x1 - 1;
    case X1:
        return memory->mu * (1 - x0 * x0);
    case MU:
        return (1 - x0 * x0) * x1;
    default:
        return 0;
    }
}

const ModelDefinition model = {
    .identifier = "van_der_pol",
    .token = "{2b41a57a-99fc-45b1-9231-35ff03e6456d}",
    .variables = variables,
    .n_variables = sizeof variables / sizeof variables[0],
    .memory_size = sizeof(Memory),
    .states = AT(states),
    .derivatives = AT(derivatives),
    .n_states = 2,
    .calculate = calculate,
    .partial = partial,
};
