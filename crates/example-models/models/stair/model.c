/* A counter driven by time events; description: readme.md. */
#include "model.h"

typedef struct {
    double start; /* of the simulation */
    int32_t counter;
    int32_t steps; /* time events so far */
} Memory;

#define AT(member) offsetof(Memory, member)

enum { LAST = 10 };

static const ModelVariable variables[] = {
    {"time", MODEL_REAL, MODEL_TIME, 0, 0},
    {"counter", MODEL_INTEGER, MODEL_DISCRETE_STATE, AT(counter), 1},
};

static ModelStatus initialize(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    (void)problem;
    memory->start = time;
    memory->steps = 0;
    return MODEL_OK;
}

static ModelStatus calculate(void *instance, double time, ModelProblem *problem) {
    (void)instance;
    (void)time;
    (void)problem;
    return MODEL_OK;
}

static ModelStatus update(void *instance, double time, ModelEvents *events, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    (void)problem;
    /* the k-th event at start + k, not by adding up: no drift */
    if (memory->counter < LAST && time >= memory->start + (memory->steps + 1)) {
        memory->steps++;
        memory->counter++;
    }
    if (memory->counter >= LAST) {
        events->terminate = 1;
    } else {
        events->next_event = 1;
        events->next_event_time = memory->start + (memory->steps + 1);
    }
    return MODEL_OK;
}

const ModelDefinition model = {
    .identifier = "stair",
    .token = "{45c291f0-aadd-4669-a05e-7814cbce2dbb}",
    .variables = variables,
    .n_variables = sizeof variables / sizeof variables[0],
    .memory_size = sizeof(Memory),
    .initialize = initialize,
    .calculate = calculate,
    .update = update,
};
