/* Four tanks and two pumps; equations and reference values: readme.md. */
#include "model.h"

#include <math.h>
#include <stdio.h>

/* The lower tanks come first: tank i < 2 is fed by tank i + 2 above it. */
enum { N_TANKS = 4, N_LOWER = 2, N_PUMPS = 2 };

/* Which pump feeds which tank: its share of the flow goes into the lower tank of its side, the rest into the upper
 * tank of the other side. */
static const int pump_of[N_TANKS] = {0, 1, 1, 0};

typedef struct {
    double level[N_TANKS];
    double derivative[N_TANKS];
    double voltage[N_PUMPS];
    double area[N_TANKS];   /* cross-section of the tank */
    double outlet[N_TANKS]; /* cross-section of the hole at its bottom */
    double gravity;
    double gain[N_PUMPS];  /* flow per voltage */
    double share[N_PUMPS]; /* what goes into the lower tank */
} Memory;

#define AT(member) offsetof(Memory, member)
#define PLACE(member, i) (AT(member) + (i) * sizeof(double))

/* The first value reference of each group. */
enum {
    TIME,
    LEVEL,
    DER_LEVEL = LEVEL + N_TANKS,
    VOLTAGE = DER_LEVEL + N_TANKS,
    AREA = VOLTAGE + N_PUMPS,
    OUTLET = AREA + N_TANKS,
    GRAVITY = OUTLET + N_TANKS,
    GAIN,
    SHARE = GAIN + N_PUMPS
};

static const ModelVariable variables[] = {
    [TIME] = {"time", MODEL_REAL, MODEL_TIME, 0, 0},
    [LEVEL] = {"qt.x1", MODEL_REAL, MODEL_STATE, PLACE(level, 0), 0.0627},
    [LEVEL + 1] = {"qt.x2", MODEL_REAL, MODEL_STATE, PLACE(level, 1), 0.06044},
    [LEVEL + 2] = {"qt.x3", MODEL_REAL, MODEL_STATE, PLACE(level, 2), 0.024},
    [LEVEL + 3] = {"qt.x4", MODEL_REAL, MODEL_STATE, PLACE(level, 3), 0.023},
    [DER_LEVEL] = {"der(qt.x1)", MODEL_REAL, MODEL_CALCULATED, PLACE(derivative, 0), 0},
    [DER_LEVEL + 1] = {"der(qt.x2)", MODEL_REAL, MODEL_CALCULATED, PLACE(derivative, 1), 0},
    [DER_LEVEL + 2] = {"der(qt.x3)", MODEL_REAL, MODEL_CALCULATED, PLACE(derivative, 2), 0},
    [DER_LEVEL + 3] = {"der(qt.x4)", MODEL_REAL, MODEL_CALCULATED, PLACE(derivative, 3), 0},
    [VOLTAGE] = {"u1", MODEL_REAL, MODEL_INPUT, PLACE(voltage, 0), 0},
    [VOLTAGE + 1] = {"u2", MODEL_REAL, MODEL_INPUT, PLACE(voltage, 1), 0},
    [AREA] = {"qt.A1", MODEL_REAL, MODEL_FIXED, PLACE(area, 0), 4.9e-4},
    [AREA + 1] = {"qt.A2", MODEL_REAL, MODEL_FIXED, PLACE(area, 1), 4.9e-4},
    [AREA + 2] = {"qt.A3", MODEL_REAL, MODEL_FIXED, PLACE(area, 2), 4.9e-4},
    [AREA + 3] = {"qt.A4", MODEL_REAL, MODEL_FIXED, PLACE(area, 3), 4.9e-4},
    [OUTLET] = {"qt.a1", MODEL_REAL, MODEL_FIXED, PLACE(outlet, 0), 0.03e-4},
    [OUTLET + 1] = {"qt.a2", MODEL_REAL, MODEL_FIXED, PLACE(outlet, 1), 0.03e-4},
    [OUTLET + 2] = {"qt.a3", MODEL_REAL, MODEL_FIXED, PLACE(outlet, 2), 0.03e-4},
    [OUTLET + 3] = {"qt.a4", MODEL_REAL, MODEL_FIXED, PLACE(outlet, 3), 0.03e-4},
    [GRAVITY] = {"qt.g", MODEL_REAL, MODEL_FIXED, AT(gravity), 9.81},
    [GAIN] = {"qt.k1_nmp", MODEL_REAL, MODEL_FIXED, PLACE(gain, 0), 0.56e-6},
    [GAIN + 1] = {"qt.k2_nmp", MODEL_REAL, MODEL_FIXED, PLACE(gain, 1), 0.56e-6},
    [SHARE] = {"qt.g1_nmp", MODEL_REAL, MODEL_FIXED, PLACE(share, 0), 0.30},
    [SHARE + 1] = {"qt.g2_nmp", MODEL_REAL, MODEL_FIXED, PLACE(share, 1), 0.30},
};

/* A state of the levels, which the rounding of a step may leave a little below zero. */
static double at_least_empty(double level) {
    return level > 0 ? level : 0;
}

static double outflow(const Memory *memory, int tank) {
    return memory->outlet[tank] * sqrt(2 * memory->gravity * at_least_empty(memory->level[tank]));
}

/* Share of its pump's flow that a tank gets. */
static double part(const Memory *memory, int tank) {
    const double share = memory->share[pump_of[tank]];
    return tank < N_LOWER ? share : 1 - share;
}

static ModelStatus initialize(void *instance, double time, ModelProblem *problem) {
    const Memory *memory = (const Memory *)instance;
    int tank;
    (void)time;
    for (tank = 0; tank < N_TANKS; tank++) {
        if (!(memory->area[tank] > 0)) {
            snprintf(problem->text, sizeof problem->text, "qt.A%d = %g must be positive", tank + 1,
                     memory->area[tank]);
            return MODEL_ERROR;
        }
        if (!(memory->outlet[tank] >= 0)) {
            snprintf(problem->text, sizeof problem->text, "qt.a%d = %g must not be negative", tank + 1,
                     memory->outlet[tank]);
            return MODEL_ERROR;
        }
    }
    if (!(memory->gravity >= 0)) {
        snprintf(problem->text, sizeof problem->text, "qt.g = %g must not be negative", memory->gravity);
        return MODEL_ERROR;
    }
    return MODEL_OK;
}

static ModelStatus calculate(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    double flow[N_TANKS];
    int tank;
    (void)time;
    (void)problem;
    for (tank = 0; tank < N_TANKS; tank++) {
        flow[tank] = outflow(memory, tank);
    }
    for (tank = 0; tank < N_TANKS; tank++) {
        const int pump = pump_of[tank];
        const double above = tank < N_LOWER ? flow[tank + N_LOWER] : 0;
        const double pumped = part(memory, tank) * memory->gain[pump] * memory->voltage[pump];
        memory->derivative[tank] = (above + pumped - flow[tank]) / memory->area[tank];
    }
    return MODEL_OK;
}

/* Partial derivative of a tank's outflow. */
static double partial_outflow(const Memory *memory, int tank, unsigned known) {
    const double level = at_least_empty(memory->level[tank]), g = memory->gravity;
    if (known == (unsigned)(LEVEL + tank)) {
        return level > 0 ? memory->outlet[tank] * sqrt(g / (2 * level)) : 0;
    }
    if (known == (unsigned)(OUTLET + tank)) {
        return sqrt(2 * g * level);
    }
    if (known == GRAVITY) {
        return g > 0 ? memory->outlet[tank] * sqrt(level / (2 * g)) : 0;
    }
    return 0;
}

/* Partial derivative of what is pumped into a tank. */
static double partial_pumped(const Memory *memory, int tank, unsigned known) {
    const int pump = pump_of[tank];
    const double gain = memory->gain[pump], voltage = memory->voltage[pump];
    if (known == (unsigned)(VOLTAGE + pump)) {
        return part(memory, tank) * gain;
    }
    if (known == (unsigned)(GAIN + pump)) {
        return part(memory, tank) * voltage;
    }
    if (known == (unsigned)(SHARE + pump)) {
        return tank < N_LOWER ? gain * voltage : -gain * voltage;
    }
    return 0;
}

static double partial(const void *instance, unsigned unknown, unsigned known) {
    const Memory *memory = (const Memory *)instance;
    const int tank = (int)unknown - DER_LEVEL;
    double flow;
    if (known == (unsigned)(AREA + tank)) {
        return -memory->derivative[tank] / memory->area[tank];
    }
    flow = partial_pumped(memory, tank, known) - partial_outflow(memory, tank, known);
    if (tank < N_LOWER) {
        flow += partial_outflow(memory, tank + N_LOWER, known);
    }
    return flow / memory->area[tank];
}

static const double nominals[N_TANKS] = {0.05, 0.05, 0.05, 0.05};

const ModelDefinition model = {
    .identifier = "quad_tank",
    .token = "{790fdeed-a49b-47ff-aa5a-f9467440a8c9}",
    .variables = variables,
    .n_variables = sizeof variables / sizeof variables[0],
    .memory_size = sizeof(Memory),
    .states = AT(level),
    .derivatives = AT(derivative),
    .n_states = N_TANKS,
    .nominals = nominals,
    .initialize = initialize,
    .calculate = calculate,
    .partial = partial,
};
