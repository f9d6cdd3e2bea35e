/* Furuta pendulum with dry friction in both joints; equations and conventions: readme.md. */
#include "model.h"

#include <math.h>
#include <stdio.h>

enum { ARM, PENDULUM, N_JOINTS };
enum { BACKWARD = -1, LOCKED = 0, FORWARD = 1 };

/* Keeps the indicator of a joint positive that has just started from rest, rad/s. Small enough that a reversal is
 * reported only some 1e-9 s late, large against the rounding of a speed. */
static const double SPEED_MARGIN = 1e-9;

/* The same for a locked joint whose torque is just at the limit, N m. */
static const double TORQUE_MARGIN = 1e-12;

typedef struct {
    double states[2 * N_JOINTS]; /* angle and speed of the arm, angle and speed of the pendulum */
    double derivatives[2 * N_JOINTS];
    double indicators[2 * N_JOINTS]; /* two a joint */
    double torque[N_JOINTS];
    double friction[N_JOINTS];
    double gravity, arm_length, arm_inertia;
    double mass, distance, inertia1, inertia2, inertia3;
    int32_t mode[N_JOINTS];
} Memory;

#define AT(member) offsetof(Memory, member)

static const ModelVariable variables[] = {
    {"time", MODEL_REAL, MODEL_TIME, 0, 0},
    {"armJoint.phi", MODEL_REAL, MODEL_STATE, AT(states), 0},
    {"armJoint.w", MODEL_REAL, MODEL_STATE, AT(states) + 1 * sizeof(double), 0},
    {"pendulumJoint.phi", MODEL_REAL, MODEL_STATE, AT(states) + 2 * sizeof(double), 0.5235987755983},
    {"pendulumJoint.w", MODEL_REAL, MODEL_STATE, AT(states) + 3 * sizeof(double), 0},
    {"der(armJoint.phi)", MODEL_REAL, MODEL_CALCULATED, AT(derivatives), 0},
    {"der(armJoint.w)", MODEL_REAL, MODEL_CALCULATED, AT(derivatives) + 1 * sizeof(double), 0},
    {"der(pendulumJoint.phi)", MODEL_REAL, MODEL_CALCULATED, AT(derivatives) + 2 * sizeof(double), 0},
    {"der(pendulumJoint.w)", MODEL_REAL, MODEL_CALCULATED, AT(derivatives) + 3 * sizeof(double), 0},
    {"armJoint.tau", MODEL_REAL, MODEL_CALCULATED, AT(torque), 0},
    {"pendulumJoint.tau", MODEL_REAL, MODEL_CALCULATED, AT(torque) + 1 * sizeof(double), 0},
    {"armJoint.mode", MODEL_INTEGER, MODEL_CALCULATED, AT(mode), 0},
    {"pendulumJoint.mode", MODEL_INTEGER, MODEL_CALCULATED, AT(mode) + 1 * sizeof(int32_t), 0},
    {"armFriction", MODEL_REAL, MODEL_TUNABLE, AT(friction), 0.012},
    {"pendulumFriction", MODEL_REAL, MODEL_TUNABLE, AT(friction) + 1 * sizeof(double), 0.002},
    {"g", MODEL_REAL, MODEL_FIXED, AT(gravity), 9.81},
    {"arm.length", MODEL_REAL, MODEL_FIXED, AT(arm_length), 0.245},
    {"arm.inertia", MODEL_REAL, MODEL_FIXED, AT(arm_inertia), 0.001},
    {"pendulum.mass", MODEL_REAL, MODEL_FIXED, AT(mass), 0.035},
    {"pendulum.distance", MODEL_REAL, MODEL_FIXED, AT(distance), 0.2105},
    {"pendulum.inertia1", MODEL_REAL, MODEL_FIXED, AT(inertia1), 0.00384},
    {"pendulum.inertia2", MODEL_REAL, MODEL_FIXED, AT(inertia2), 0.001},
    {"pendulum.inertia3", MODEL_REAL, MODEL_FIXED, AT(inertia3), 0.001},
};

static double *speed(Memory *memory, int joint) {
    return &memory->states[2 * joint + 1];
}

/* M q'' = f - tau: the symmetric mass matrix and the torques that do not come from friction. */
typedef struct {
    double m11, m12, m22;
    double f1, f2;
} Balance;

static Balance balance(const Memory *memory) {
    const double length = memory->arm_length, distance = memory->distance, mass = memory->mass;
    const double k = mass * length * distance;
    const double b0 = memory->inertia3 + mass * distance * distance;
    const double e = b0 - memory->inertia2;
    const double s = sin(memory->states[2]), c = cos(memory->states[2]);
    const double w_phi = memory->states[1], w_theta = memory->states[3];
    Balance at;
    at.m11 = memory->arm_inertia + mass * length * length + memory->inertia2 * c * c + b0 * s * s;
    at.m12 = -k * c;
    at.m22 = memory->inertia1 + mass * distance * distance;
    at.f1 = -2 * e * s * c * w_phi * w_theta - k * s * w_theta * w_theta;
    at.f2 = e * s * c * w_phi * w_phi + mass * memory->gravity * distance * s;
    return at;
}

/* Accelerations and friction torques for given modes: a moving joint has the full friction torque, a locked one no
 * acceleration and whatever torque that takes. */
static void solve(const Balance *at, const Memory *memory, const int32_t mode[], double acceleration[],
                  double torque[]) {
    torque[ARM] = mode[ARM] * memory->friction[ARM];
    torque[PENDULUM] = mode[PENDULUM] * memory->friction[PENDULUM];
    acceleration[ARM] = 0;
    acceleration[PENDULUM] = 0;
    if (mode[ARM] != LOCKED && mode[PENDULUM] != LOCKED) {
        const double r1 = at->f1 - torque[ARM], r2 = at->f2 - torque[PENDULUM];
        const double determinant = at->m11 * at->m22 - at->m12 * at->m12;
        acceleration[ARM] = (at->m22 * r1 - at->m12 * r2) / determinant;
        acceleration[PENDULUM] = (at->m11 * r2 - at->m12 * r1) / determinant;
    } else if (mode[PENDULUM] != LOCKED) {
        acceleration[PENDULUM] = (at->f2 - torque[PENDULUM]) / at->m22;
        torque[ARM] = at->f1 - at->m12 * acceleration[PENDULUM];
    } else if (mode[ARM] != LOCKED) {
        acceleration[ARM] = (at->f1 - torque[ARM]) / at->m11;
        torque[PENDULUM] = at->f2 - at->m12 * acceleration[ARM];
    } else {
        torque[ARM] = at->f1;
        torque[PENDULUM] = at->f2;
    }
}

/* By how much (N m) the laws of friction are broken if the joints in `resting` take these modes; at most 0: not. */
static double violation(const Balance *at, const Memory *memory, const int32_t mode[], const int resting[]) {
    double acceleration[N_JOINTS], torque[N_JOINTS], worst = -HUGE_VAL;
    int joint;
    solve(at, memory, mode, acceleration, torque);
    for (joint = 0; joint < N_JOINTS; joint++) {
        double broken;
        if (!resting[joint]) {
            continue;
        }
        if (mode[joint] == LOCKED) {
            broken = fabs(torque[joint]) - (memory->friction[joint] + 0.5 * TORQUE_MARGIN);
        } else {
            broken = -mode[joint] * acceleration[joint] * (joint == ARM ? at->m11 : at->m22);
            if (broken == 0) {
                broken = TORQUE_MARGIN; /* no acceleration is no start; locked is preferred */
            }
        }
        worst = fmax(worst, broken);
    }
    return worst;
}

/* Chooses the modes of the resting joints together: the one combination that agrees with the laws of friction (the
 * accelerations that belong to it are unique, see the readme). Should rounding leave none, the one closest to it. */
static void decide(Memory *memory, const int resting[]) {
    static const int32_t choices[] = {LOCKED, FORWARD, BACKWARD};
    const Balance at = balance(memory);
    double least = HUGE_VAL;
    int32_t best[N_JOINTS];
    int joint, i, k;
    for (joint = 0; joint < N_JOINTS; joint++) {
        best[joint] = resting[joint] ? LOCKED : memory->mode[joint];
    }
    for (i = 0; i < (resting[ARM] ? 3 : 1); i++) {
        for (k = 0; k < (resting[PENDULUM] ? 3 : 1); k++) {
            int32_t mode[N_JOINTS];
            double broken;
            mode[ARM] = resting[ARM] ? choices[i] : memory->mode[ARM];
            mode[PENDULUM] = resting[PENDULUM] ? choices[k] : memory->mode[PENDULUM];
            broken = violation(&at, memory, mode, resting);
            if (least > 0 && broken < least) { /* the first that breaks nothing is the one */
                least = broken;
                best[ARM] = mode[ARM];
                best[PENDULUM] = mode[PENDULUM];
            }
        }
    }
    memory->mode[ARM] = best[ARM];
    memory->mode[PENDULUM] = best[PENDULUM];
}

static ModelStatus check(const Memory *memory, ModelProblem *problem) {
    const struct {
        const char *name;
        double value;
    } parameters[] = {
        {"armFriction", memory->friction[ARM]}, {"pendulumFriction", memory->friction[PENDULUM]},
        {"arm.inertia", memory->arm_inertia},   {"pendulum.mass", memory->mass},
        {"pendulum.inertia1", memory->inertia1}, {"pendulum.inertia2", memory->inertia2},
        {"pendulum.inertia3", memory->inertia3},
    };
    size_t i;
    for (i = 0; i < sizeof parameters / sizeof parameters[0]; i++) {
        if (!(parameters[i].value >= 0) || isinf(parameters[i].value)) {
            snprintf(problem->text, sizeof problem->text, "%s = %g must be a number of at least 0", parameters[i].name,
                     parameters[i].value);
            return MODEL_ERROR;
        }
    }
    return MODEL_OK;
}

static ModelStatus initialize(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    int resting[N_JOINTS], joint;
    (void)time;
    if (check(memory, problem) != MODEL_OK) {
        return MODEL_ERROR;
    }
    for (joint = 0; joint < N_JOINTS; joint++) {
        const double w = *speed(memory, joint);
        resting[joint] = w == 0;
        memory->mode[joint] = w > 0 ? FORWARD : w < 0 ? BACKWARD : LOCKED;
    }
    decide(memory, resting);
    return MODEL_OK;
}

static ModelStatus calculate(void *instance, double time, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    const Balance at = balance(memory);
    double acceleration[N_JOINTS];
    int joint;
    (void)time;
    (void)problem;
    solve(&at, memory, memory->mode, acceleration, memory->torque);
    for (joint = 0; joint < N_JOINTS; joint++) {
        const int32_t mode = memory->mode[joint];
        const double limit = memory->friction[joint] + TORQUE_MARGIN;
        memory->derivatives[2 * joint] = *speed(memory, joint);
        memory->derivatives[2 * joint + 1] = acceleration[joint];
        memory->indicators[2 * joint] =
            mode == LOCKED ? limit - memory->torque[joint] : mode * *speed(memory, joint) + SPEED_MARGIN;
        memory->indicators[2 * joint + 1] = mode == LOCKED ? limit + memory->torque[joint] : 1;
    }
    return MODEL_OK;
}

static ModelStatus update(void *instance, double time, ModelEvents *events, ModelProblem *problem) {
    Memory *memory = (Memory *)instance;
    int resting[N_JOINTS], joint;
    (void)time;
    if (check(memory, problem) != MODEL_OK) { /* the frictions are tunable */
        return MODEL_ERROR;
    }
    for (joint = 0; joint < N_JOINTS; joint++) {
        double *w = speed(memory, joint);
        resting[joint] = memory->mode[joint] * *w <= 0;
        if (resting[joint] && *w != 0) {
            *w = 0;
            events->states_changed = 1;
        }
    }
    decide(memory, resting);
    return MODEL_OK;
}

const ModelDefinition model = {
    .identifier = "furuta",
    .token = "{0814ab93-9fee-452a-9f7a-3b95abbaa92e}",
    .variables = variables,
    .n_variables = sizeof variables / sizeof variables[0],
    .memory_size = sizeof(Memory),
    .states = AT(states),
    .derivatives = AT(derivatives),
    .indicators = AT(indicators),
    .n_states = 2 * N_JOINTS,
    .n_indicators = 2 * N_JOINTS,
    .initialize = initialize,
    .calculate = calculate,
    .update = update,
};
