/* Dahlquist's test equation x' = -k x for k < 10; a larger k stands for a fault. Any front end makes an FMU of it, so that
 * one library shows that it is as good as before after each of them. */
#include "model.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

typedef struct {
    double x;
    double derivative;
    double k;
    double indicator;
    double next;
    int32_t fault;
} Memory;

#define AT(member) offsetof(Memory, member)

enum { TIME, X, DER_X, K };

/* The values of k that stand for faults; the last ones end or hang the process. */
enum {
    NO_START = 10,
    DISCARDS_START,
    ERROR_LATE,
    DISCARD_LATE,
    NAN_LATE,
    INFINITE_LATE,
    HUGE_VALUES,
    EVENT_STORM,
    ENDLESS_EVENTS,
    PAST_EVENT,
    ENDS_ITSELF,
    FAILING_EVENT,
    STEP_EVENTS,
    ENDLESS_LATE,
    LEAKS = 90,
    PRINTS,
    SEGFAULTS,
    ABORTS,
    EXITS,
    HANGS
};

static const ModelVariable variables[] = {
    [TIME] = {"time", MODEL_REAL, MODEL_TIME, 0, 0},
    [X] = {"x", MODEL_REAL, MODEL_STATE, AT(x), 1},
    [DER_X] = {"der(x)", MODEL_REAL, MODEL_CALCULATED, AT(derivative), 0},
    [K] = {"k", MODEL_REAL, MODEL_FIXED, AT(k), 1},
};

#ifdef CRASHES_WHEN_LOADED
__attribute__((constructor)) static void crash(void) { abort(); }
#endif

static ModelStatus initialize(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    (void)time;
    memory->next = 0.5;
#ifdef COMPUTES_X
    memory->x = COMPUTES_X;
#endif
    memory->fault = memory->k < 10 ? 0 : (int32_t)memory->k;
    switch (memory->fault) {
    case NO_START:
        snprintf(problem->text, sizeof problem->text, "no solution for k = %g", memory->k);
        return MODEL_ERROR;
    case DISCARDS_START:
        return MODEL_DISCARD;
    case LEAKS:
        return malloc(1 << 20) == NULL ? MODEL_ERROR : MODEL_OK;
    default:
        return MODEL_OK;
    }
}

static ModelStatus calculate(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    double rate = memory->fault ? 1 : memory->k;
    memory->derivative = -rate * memory->x;
    memory->indicator = 1;
    switch (memory->fault) {
    case STEP_EVENTS:
        memory->derivative = 1;
        break;
    case HUGE_VALUES:
        memory->derivative = 1e307;
        break;
    case EVENT_STORM:
        memory->indicator = memory->next - time;
        break;
    case PRINTS:
        puts("a model that talks");
        break;
    case SEGFAULTS:
        *(volatile int *)0 = 1;
        break;
    case ABORTS:
        abort();
    case EXITS:
        exit(3);
    case HANGS:
        for (;;) *(volatile double *)&memory->x = memory->x;
    default:
        break;
    }
    if (time <= 0.5) return MODEL_OK;
    switch (memory->fault) {
    case ERROR_LATE:
        snprintf(problem->text, sizeof problem->text, "broken beyond t = %g", 0.5);
        return MODEL_ERROR;
    case DISCARD_LATE:
        return MODEL_DISCARD;
    case NAN_LATE:
        memory->derivative = NAN;
        break;
    case INFINITE_LATE:
        memory->derivative = INFINITY;
        break;
    default:
        break;
    }
    return MODEL_OK;
}

static ModelStatus update(void *instance, double time, ModelEvents *events, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    switch (memory->fault) {
    case EVENT_STORM:
        /* Every event is the reason of the next one. */
        if (time >= memory->next) memory->next = time + 1e-12;
        break;
    case STEP_EVENTS:
        /* As a selection of states: the model goes on with an equal point that suits it better. */
        events->states_changed = memory->x >= 1.5;
        if (events->states_changed) memory->x -= 1;
        break;
    case ENDLESS_EVENTS:
        events->again = 1;
        break;
    case PAST_EVENT:
        events->next_event = 1;
        events->next_event_time = time - 1;
        break;
    case ENDS_ITSELF:
        events->next_event = 1;
        events->next_event_time = 0.25;
        events->terminate = time >= 0.25;
        break;
    case ENDLESS_LATE:
        events->next_event = time < 0.25;
        events->next_event_time = 0.25;
        events->again = time >= 0.25;
        break;
    case FAILING_EVENT:
        events->next_event = 1;
        events->next_event_time = 0.25;
        if (time >= 0.25) {
            snprintf(problem->text, sizeof problem->text, "no event at t = %g", time);
            return MODEL_ERROR;
        }
        break;
    default:
        break;
    }
    return MODEL_OK;
}

static int wants_event(const void *instance, double time) {
    const Memory *memory = (const Memory *)instance;
    (void)time;
    return memory->fault == STEP_EVENTS && memory->x >= 1.5;
}

const ModelDefinition model = {
    .identifier = "dahlquist",
    .token = "{9686edb1-c995-41e0-a850-2ee5a2df2214}",
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
    .wants_event = wants_event,
};
