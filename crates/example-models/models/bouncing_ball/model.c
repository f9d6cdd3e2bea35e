/* Ball that falls, bounces and comes to rest; equations and closed forms: readme.md. */
#include "model.h"

#include <float.h>
#include <stdio.h>

typedef struct {
    double states[2]; /* height, velocity */
    double derivatives[2];
    double indicator;
    double gravity, restitution, least_velocity;
    int32_t resting;
    int32_t bounces;
} Memory;

enum { H, V };

#define AT(member) offsetof(Memory, member)

static const ModelVariable variables[] = {
    {"time", MODEL_REAL, MODEL_TIME, 0, 0},
    {"h", MODEL_REAL, MODEL_STATE, AT(states), 1},
    {"der(h)", MODEL_REAL, MODEL_CALCULATED, AT(derivatives), 0},
    {"v", MODEL_REAL, MODEL_STATE, AT(states) + sizeof(double), 0},
    {"der(v)", MODEL_REAL, MODEL_CALCULATED, AT(derivatives) + sizeof(double), 0},
    {"g", MODEL_REAL, MODEL_FIXED, AT(gravity), -9.81},
    {"e", MODEL_REAL, MODEL_TUNABLE, AT(restitution), 0.7},
    {"v_min", MODEL_REAL, MODEL_FIXED, AT(least_velocity), 0.1},
    {"bounces", MODEL_INTEGER, MODEL_CALCULATED, AT(bounces), 0},
    {"resting", MODEL_BOOLEAN, MODEL_CALCULATED, AT(resting), 0},
};

static ModelStatus check(const Memory *memory, ModelProblem *problem) {
    if (!(memory->restitution >= 0 && memory->restitution <= 1)) {
        snprintf(problem->text, sizeof problem->text, "e = %g must lie between 0 and 1", memory->restitution);
        return MODEL_ERROR;
    }
    return MODEL_OK;
}

static ModelStatus initialize(void *instance, double time, ModelProblem *problem) {
    (void)time;
    return check((const Memory *)instance, problem);
}

static ModelStatus calculate(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    const double height = memory->states[H];
    (void)time;
    (void)problem;
    memory->derivatives[H] = memory->resting ? 0 : memory->states[V];
    memory->derivatives[V] = memory->resting ? 0 : memory->gravity;
    if (memory->resting) {
        memory->indicator = 1;
    } else {
        /* A ball on the ground that moves upward has just bounced: that is no event. The height itself otherwise,
         * so that the moment of impact is the root of a smooth function. */
        memory->indicator = height <= 0 && memory->states[V] > 0 ? DBL_MIN : height;
    }
    return MODEL_OK;
}

static ModelStatus update(void *instance, double time, ModelEvents *events, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    (void)time;
    if (check(memory, problem) != MODEL_OK) { /* e is tunable */
        return MODEL_ERROR;
    }
    if (!memory->resting && memory->states[H] <= 0 && memory->states[V] <= 0) {
        memory->bounces++;
        memory->states[H] = 0;
        memory->states[V] *= -memory->restitution;
        if (memory->states[V] <= 0 || memory->states[V] < memory->least_velocity) {
            memory->states[V] = 0;
            memory->resting = 1;
        }
        events->states_changed = 1;
    }
    return MODEL_OK;
}

const ModelDefinition model = {
    .identifier = "bouncing_ball",
    .token = "{299f6b07-66a7-455d-a1af-5fadec9f93fb}",
    .variables = variables,
    .n_variables = sizeof variables / sizeof variables[0],
    .memory_size = sizeof(Memory),
    .states = AT(states),
    .derivatives = AT(derivatives),
    .indicators = AT(indicator),
    .n_states = 2,
    .n_indicators = 1,
    .initialize = initialize,
    .calculate = calculate,
    .update = update,
};
