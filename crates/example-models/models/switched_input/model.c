/* First-order lag behind a switch and a gear, with a limit switch; equations and closed forms: readme.md. */
#include "model.h"

#include <stdio.h>

typedef struct {
    double x;
    double derivative;
    double indicator;
    double target;
    double u;
    double gain, time_constant;
    double high, low;
    int32_t enabled;
    int32_t gear;
    int32_t limit;
} Memory;

#define AT(member) offsetof(Memory, member)

enum { TIME, X, DER_X, Y, TARGET, LIMIT, U, ENABLED, GEAR, K, T, HIGH, LOW };

static const ModelVariable variables[] = {
    [TIME] = {"time", MODEL_REAL, MODEL_TIME, 0, 0},
    [X] = {"x", MODEL_REAL, MODEL_STATE, AT(x), 0},
    [DER_X] = {"der(x)", MODEL_REAL, MODEL_CALCULATED, AT(derivative), 0},
    [Y] = {"y", MODEL_REAL, MODEL_CALCULATED, AT(x), 0},
    [TARGET] = {"target", MODEL_REAL, MODEL_CALCULATED, AT(target), 0},
    [LIMIT] = {"limit", MODEL_BOOLEAN, MODEL_CALCULATED, AT(limit), 0},
    [U] = {"u", MODEL_REAL, MODEL_INPUT, AT(u), 0},
    [ENABLED] = {"enabled", MODEL_BOOLEAN, MODEL_DISCRETE_INPUT, AT(enabled), 1},
    [GEAR] = {"gear", MODEL_INTEGER, MODEL_DISCRETE_INPUT, AT(gear), 1},
    [K] = {"K", MODEL_REAL, MODEL_TUNABLE, AT(gain), 2},
    [T] = {"T", MODEL_REAL, MODEL_FIXED, AT(time_constant), 0.5},
    [HIGH] = {"limit_high", MODEL_REAL, MODEL_FIXED, AT(high), 1.5},
    [LOW] = {"limit_low", MODEL_REAL, MODEL_FIXED, AT(low), 1},
};

static ModelStatus initialize(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    (void)time;
    if (!(memory->time_constant > 0)) {
        snprintf(problem->text, sizeof problem->text, "T = %g must be positive", memory->time_constant);
        return MODEL_ERROR;
    }
    if (!(memory->low < memory->high)) {
        snprintf(problem->text, sizeof problem->text, "limit_low = %g must lie below limit_high = %g", memory->low,
                 memory->high);
        return MODEL_ERROR;
    }
    memory->limit = memory->x >= memory->high;
    return MODEL_OK;
}

static ModelStatus calculate(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    (void)time;
    (void)problem;
    memory->target = memory->enabled ? memory->gain * memory->gear * memory->u : 0;
    memory->derivative = (memory->target - memory->x) / memory->time_constant;
    /* positive while the switch stays where it is; the distance of the two limits is the hysteresis */
    memory->indicator = memory->limit ? memory->x - memory->low : memory->high - memory->x;
    return MODEL_OK;
}

static ModelStatus update(void *instance, double time, ModelEvents *events, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    (void)time;
    (void)events;
    (void)problem;
    memory->limit = memory->limit ? memory->x > memory->low : memory->x >= memory->high;
    return MODEL_OK;
}

static double partial(const void *instance, unsigned unknown, unsigned known) {
    const Memory *memory = (const Memory *)instance;
    const double gear = memory->enabled ? memory->gear : 0;
    /* of the target, the one place where input and gain come in */
    const double target = known == U ? memory->gain * gear : known == K ? gear * memory->u : 0;
    switch (unknown) {
    case TARGET:
        return target;
    case Y:
        return known == X ? 1 : 0;
    case DER_X:
        if (known == T) {
            return (memory->x - memory->target) / (memory->time_constant * memory->time_constant);
        }
        return (target - (known == X ? 1 : 0)) / memory->time_constant;
    default:
        return 0;
    }
}

const ModelDefinition model = {
    .identifier = "switched_input",
    .token = "{9cb5c70b-3586-4fac-b527-d30e1d0312be}",
    .variables = variables,
    .n_variables = sizeof variables / sizeof variables[0],
    .memory_size = sizeof(Memory),
    .states = AT(x),
    .derivatives = AT(derivative),
    .indicators = AT(indicator),
    .n_states = 1,
    .n_indicators = 1,
    .initialize = initialize,
    .calculate = calculate,
    .update = update,
    .partial = partial,
};
