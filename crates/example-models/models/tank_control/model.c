/* Four tanks whose two pumps are driven by PI controllers; equations and reference values: readme.md. */
#include "model.h"

#include <math.h>
#include <stdio.h>

enum { N_TANKS = 4, N_LOWER = 2, N_LOOPS = 2 };

/* The states come first. */
typedef struct {
    double level[N_TANKS];
    double integral[N_LOOPS];
    double rate[N_TANKS + N_LOOPS];
    double voltage[N_LOOPS];
    double error[N_LOOPS];
    double reference[N_LOOPS];
    double gain[N_LOOPS];
    double time[N_LOOPS]; /* integral times */
    double share[N_LOOPS];
} Memory;

#define AT(member) offsetof(Memory, member)
#define PLACE(member, i) (AT(member) + (i) * sizeof(double))

enum {
    TIME,
    LEVEL,
    INTEGRAL = LEVEL + N_TANKS,
    RATE = INTEGRAL + N_LOOPS,
    VOLTAGE = RATE + N_TANKS + N_LOOPS,
    ERROR_OF = VOLTAGE + N_LOOPS,
    REFERENCE = ERROR_OF + N_LOOPS,
    GAIN = REFERENCE + N_LOOPS,
    INTEGRAL_TIME = GAIN + N_LOOPS,
    SHARE = INTEGRAL_TIME + N_LOOPS
};

static const ModelVariable variables[] = {
    [TIME] = {"time", MODEL_REAL, MODEL_TIME, 0, 0},
    [LEVEL] = {"x1", MODEL_REAL, MODEL_STATE, PLACE(level, 0), 12.2629675195507},
    [LEVEL + 1] = {"x2", MODEL_REAL, MODEL_STATE, PLACE(level, 1), 12.783158403008972},
    [LEVEL + 2] = {"x3", MODEL_REAL, MODEL_STATE, PLACE(level, 2), 1.6339411322567796},
    [LEVEL + 3] = {"x4", MODEL_REAL, MODEL_STATE, PLACE(level, 3), 1.409044702533737},
    [INTEGRAL] = {"z1", MODEL_REAL, MODEL_STATE, PLACE(integral, 0), 0},
    [INTEGRAL + 1] = {"z2", MODEL_REAL, MODEL_STATE, PLACE(integral, 1), 0},
    [RATE] = {"der(x1)", MODEL_REAL, MODEL_CALCULATED, PLACE(rate, 0), 0},
    [RATE + 1] = {"der(x2)", MODEL_REAL, MODEL_CALCULATED, PLACE(rate, 1), 0},
    [RATE + 2] = {"der(x3)", MODEL_REAL, MODEL_CALCULATED, PLACE(rate, 2), 0},
    [RATE + 3] = {"der(x4)", MODEL_REAL, MODEL_CALCULATED, PLACE(rate, 3), 0},
    [RATE + 4] = {"der(z1)", MODEL_REAL, MODEL_CALCULATED, PLACE(rate, 4), 0},
    [RATE + 5] = {"der(z2)", MODEL_REAL, MODEL_CALCULATED, PLACE(rate, 5), 0},
    [VOLTAGE] = {"u1", MODEL_REAL, MODEL_CALCULATED, PLACE(voltage, 0), 0},
    [VOLTAGE + 1] = {"u2", MODEL_REAL, MODEL_CALCULATED, PLACE(voltage, 1), 0},
    [ERROR_OF] = {"e1", MODEL_REAL, MODEL_CALCULATED, PLACE(error, 0), 0},
    [ERROR_OF + 1] = {"e2", MODEL_REAL, MODEL_CALCULATED, PLACE(error, 1), 0},
    [REFERENCE] = {"r1", MODEL_REAL, MODEL_FIXED, PLACE(reference, 0), 14},
    [REFERENCE + 1] = {"r2", MODEL_REAL, MODEL_FIXED, PLACE(reference, 1), 14},
    [GAIN] = {"K1", MODEL_REAL, MODEL_FIXED, PLACE(gain, 0), 3},
    [GAIN + 1] = {"K2", MODEL_REAL, MODEL_FIXED, PLACE(gain, 1), 2.7},
    [INTEGRAL_TIME] = {"T1", MODEL_REAL, MODEL_FIXED, PLACE(time, 0), 30},
    [INTEGRAL_TIME + 1] = {"T2", MODEL_REAL, MODEL_FIXED, PLACE(time, 1), 40},
    [SHARE] = {"g1", MODEL_REAL, MODEL_FIXED, PLACE(share, 0), 0.7},
    [SHARE + 1] = {"g2", MODEL_REAL, MODEL_FIXED, PLACE(share, 1), 0.6},
};

/* Constants of the laboratory process, in cm, s and V. */
static const double area[N_TANKS] = {28, 32, 28, 32};
static const double outlet[N_TANKS] = {0.071, 0.057, 0.071, 0.057};
static const double flow_per_volt[N_LOOPS] = {3.33, 3.35};
static const double gravity = 981, bias = 3, least = 0, most = 10;

static ModelStatus initialize(void *instance, double time, ModelProblem *problem) {
    const Memory *memory = (const Memory *)instance;
    int loop;
    (void)time;
    for (loop = 0; loop < N_LOOPS; loop++) {
        if (!(memory->gain[loop] > 0) || !(memory->time[loop] > 0)) {
            snprintf(problem->text, sizeof problem->text, "K%d = %g and T%d = %g must be positive", loop + 1,
                     memory->gain[loop], loop + 1, memory->time[loop]);
            return MODEL_ERROR;
        }
    }
    return MODEL_OK;
}

static ModelStatus calculate(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    double flow[N_TANKS];
    int tank, loop;
    (void)time;
    (void)problem;
    for (loop = 0; loop < N_LOOPS; loop++) {
        const double error = memory->reference[loop] - memory->level[loop], gain = memory->gain[loop];
        const double requested = bias + gain * (error + memory->integral[loop] / memory->time[loop]);
        const double voltage = requested < least ? least : requested > most ? most : requested;
        memory->error[loop] = error;
        memory->voltage[loop] = voltage;
        /* Back-calculation stops the integral of a saturated controller. */
        memory->rate[N_TANKS + loop] = error + (voltage - requested) / gain;
    }
    for (tank = 0; tank < N_TANKS; tank++) {
        flow[tank] = outlet[tank] * sqrt(2 * gravity * (memory->level[tank] > 0 ? memory->level[tank] : 0));
    }
    for (tank = 0; tank < N_LOWER; tank++) {
        const double pumped = memory->share[tank] * flow_per_volt[tank] * memory->voltage[tank];
        memory->rate[tank] = (flow[tank + N_LOWER] + pumped - flow[tank]) / area[tank];
    }
    for (tank = N_LOWER; tank < N_TANKS; tank++) {
        const int pump = N_TANKS - 1 - tank;
        const double pumped = (1 - memory->share[pump]) * flow_per_volt[pump] * memory->voltage[pump];
        memory->rate[tank] = (pumped - flow[tank]) / area[tank];
    }
    return MODEL_OK;
}

static const double nominals[N_TANKS + N_LOOPS] = {10, 10, 1, 1, 10, 10};

const ModelDefinition model = {
    .identifier = "tank_control",
    .token = "{5d1f0c3e-7a42-4f5b-9c1e-2b6d8f04a917}",
    .variables = variables,
    .n_variables = sizeof variables / sizeof variables[0],
    .memory_size = sizeof(Memory),
    .states = AT(level),
    .derivatives = AT(rate),
    .n_states = N_TANKS + N_LOOPS,
    .nominals = nominals,
    .initialize = initialize,
    .calculate = calculate,
};
