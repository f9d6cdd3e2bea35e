/* Exhaust pipe of a turbo compound engine: two turbines, two gas volumes with walls; equations: readme.md. */
#include "model.h"

#include <math.h>
#include <stdio.h>

enum { N_VOLUMES = 2 };

/* One gas volume and its wall. */
typedef struct {
    double p, T, Tw;
} Gas;

typedef struct {
    Gas gas[N_VOLUMES]; /* the states */
    Gas rate[N_VOLUMES];
    double T_in, p_in, p_out;
    double w[N_VOLUMES]; /* speed of the turbine in front of each volume */
    double m1, Ta, m2, Tb, m3;
    double Q[N_VOLUMES];
    double C[N_VOLUMES], G[N_VOLUMES], GA[N_VOLUMES]; /* wall: capacity, to the gas, to the surroundings */
    double T_amb, R, cp;
    double V[N_VOLUMES];
    double K[N_VOLUMES + 1]; /* two turbines and the outlet */
    double D[N_VOLUMES], eta[N_VOLUMES], nu[N_VOLUMES];
    double c0, delta;
} Memory;

#define AT(member) offsetof(Memory, member)

enum {
    TIME, P1, T1, TW1, P2, T2, TW2, DER_P1, DER_T1, DER_TW1, DER_P2, DER_T2, DER_TW2,
    T_OUT, T_IN, P_IN, W_TURB1, W_TURB2, P_OUT,
    M1, TA, M2, TB, M3, Q1, Q2,
    C1, G1, C2, G2, GA1, GA2, T_AMB, GAS_R, CP, V1, V2, K1, K2, K3,
    D1, D2, ETA1, ETA2, NU1, NU2, C0, DELTA
};

static const ModelVariable variables[] = {
    [TIME] = {"time", MODEL_REAL, MODEL_TIME, 0, 0},
    [P1] = {"p1", MODEL_REAL, MODEL_STATE, AT(gas[0].p), 1.05e5},
    [T1] = {"T1", MODEL_REAL, MODEL_STATE, AT(gas[0].T), 480},
    [TW1] = {"Tw1", MODEL_REAL, MODEL_STATE, AT(gas[0].Tw), 430},
    [P2] = {"p2", MODEL_REAL, MODEL_STATE, AT(gas[1].p), 1.02e5},
    [T2] = {"T2", MODEL_REAL, MODEL_STATE, AT(gas[1].T), 450},
    [TW2] = {"Tw2", MODEL_REAL, MODEL_STATE, AT(gas[1].Tw), 400},
    [DER_P1] = {"der(p1)", MODEL_REAL, MODEL_CALCULATED, AT(rate[0].p), 0},
    [DER_T1] = {"der(T1)", MODEL_REAL, MODEL_CALCULATED, AT(rate[0].T), 0},
    [DER_TW1] = {"der(Tw1)", MODEL_REAL, MODEL_CALCULATED, AT(rate[0].Tw), 0},
    [DER_P2] = {"der(p2)", MODEL_REAL, MODEL_CALCULATED, AT(rate[1].p), 0},
    [DER_T2] = {"der(T2)", MODEL_REAL, MODEL_CALCULATED, AT(rate[1].T), 0},
    [DER_TW2] = {"der(Tw2)", MODEL_REAL, MODEL_CALCULATED, AT(rate[1].Tw), 0},
    [T_OUT] = {"T_out", MODEL_REAL, MODEL_CALCULATED, AT(gas[1].T), 0},
    [T_IN] = {"T_in", MODEL_REAL, MODEL_INPUT, AT(T_in), 550},
    [P_IN] = {"p_in", MODEL_REAL, MODEL_INPUT, AT(p_in), 1.08e5},
    [W_TURB1] = {"w_turb1", MODEL_REAL, MODEL_INPUT, AT(w[0]), 1700},
    [W_TURB2] = {"w_turb2", MODEL_REAL, MODEL_INPUT, AT(w[1]), 2100},
    [P_OUT] = {"p_out", MODEL_REAL, MODEL_INPUT, AT(p_out), 1.015e5},
    [M1] = {"m1", MODEL_REAL, MODEL_CALCULATED, AT(m1), 0},
    [TA] = {"Ta", MODEL_REAL, MODEL_CALCULATED, AT(Ta), 0},
    [M2] = {"m2", MODEL_REAL, MODEL_CALCULATED, AT(m2), 0},
    [TB] = {"Tb", MODEL_REAL, MODEL_CALCULATED, AT(Tb), 0},
    [M3] = {"m3", MODEL_REAL, MODEL_CALCULATED, AT(m3), 0},
    [Q1] = {"Q1", MODEL_REAL, MODEL_CALCULATED, AT(Q[0]), 0},
    [Q2] = {"Q2", MODEL_REAL, MODEL_CALCULATED, AT(Q[1]), 0},
    [C1] = {"C1", MODEL_REAL, MODEL_FIXED, AT(C[0]), 2500},
    [G1] = {"G1", MODEL_REAL, MODEL_FIXED, AT(G[0]), 120},
    [C2] = {"C2", MODEL_REAL, MODEL_FIXED, AT(C[1]), 9000},
    [G2] = {"G2", MODEL_REAL, MODEL_FIXED, AT(G[1]), 80},
    [GA1] = {"GA1", MODEL_REAL, MODEL_FIXED, AT(GA[0]), 6},
    [GA2] = {"GA2", MODEL_REAL, MODEL_FIXED, AT(GA[1]), 12},
    [T_AMB] = {"T_amb", MODEL_REAL, MODEL_FIXED, AT(T_amb), 293.15},
    [GAS_R] = {"R", MODEL_REAL, MODEL_FIXED, AT(R), 287.5},
    [CP] = {"cp", MODEL_REAL, MODEL_FIXED, AT(cp), 1130},
    [V1] = {"V1", MODEL_REAL, MODEL_FIXED, AT(V[0]), 0.006},
    [V2] = {"V2", MODEL_REAL, MODEL_FIXED, AT(V[1]), 0.015},
    [K1] = {"K1", MODEL_REAL, MODEL_FIXED, AT(K[0]), 5.8e-5},
    [K2] = {"K2", MODEL_REAL, MODEL_FIXED, AT(K[1]), 9.5e-5},
    [K3] = {"K3", MODEL_REAL, MODEL_FIXED, AT(K[2]), 2.5e-4},
    [D1] = {"D1", MODEL_REAL, MODEL_FIXED, AT(D[0]), 0.086},
    [D2] = {"D2", MODEL_REAL, MODEL_FIXED, AT(D[1]), 0.110},
    [ETA1] = {"eta1", MODEL_REAL, MODEL_FIXED, AT(eta[0]), 0.74},
    [ETA2] = {"eta2", MODEL_REAL, MODEL_FIXED, AT(eta[1]), 0.78},
    [NU1] = {"nu1", MODEL_REAL, MODEL_FIXED, AT(nu[0]), 0.66},
    [NU2] = {"nu2", MODEL_REAL, MODEL_FIXED, AT(nu[1]), 0.65},
    [C0] = {"c0", MODEL_REAL, MODEL_FIXED, AT(c0), 10},
    [DELTA] = {"delta", MODEL_REAL, MODEL_FIXED, AT(delta), 1e-4},
};

/* Whether all these variables are positive; what stands at 0 or below, or is no number, is named. */
static int positive(const void *memory, const unsigned char references[], size_t n, ModelProblem *problem) {
    size_t i;
    for (i = 0; i < n; i++) {
        const ModelVariable *variable = &variables[references[i]];
        const double value = *(const double *)((const char *)memory + variable->offset);
        if (!(value > 0)) {
            snprintf(problem->text, sizeof problem->text, "%s = %g must be positive", variable->name, value);
            return 0;
        }
    }
    return 1;
}

static ModelStatus initialize(void *instance, double time, ModelProblem *problem) {
    static const unsigned char must_be_positive[] = {C1, C2, GAS_R, V1, V2, NU1, NU2, C0, DELTA};
    const Memory *memory = (const Memory *)instance;
    (void)time;
    if (!positive(memory, must_be_positive, sizeof must_be_positive, problem)) {
        return MODEL_ERROR;
    }
    if (!(memory->cp > memory->R)) {
        snprintf(problem->text, sizeof problem->text, "cp = %g must be above R = %g", memory->cp, memory->R);
        return MODEL_ERROR;
    }
    return MODEL_OK;
}

/* Mass flow from pressure pu and temperature Tu to pressure pd: the ellipse law, its square root rounded at zero. */
static double mass_flow(const Memory *memory, double K, double pu, double Tu, double pd) {
    const double ratio = pd / pu, X = 1 - ratio * ratio;
    return X > 0 ? K * pu / sqrt(Tu) * X / sqrt(X + memory->delta) : 0;
}

/* Temperature behind turbine i. */
static double exit_temperature(const Memory *memory, int i, double pu, double Tu, double pd) {
    const double ratio = pd / pu < 1 ? pd / pu : 1;
    const double drop = 1 - pow(ratio, memory->R / memory->cp); /* isentropic, relative */
    const double spouting = sqrt(2 * memory->cp * Tu * drop + memory->c0 * memory->c0);
    const double r = memory->D[i] * memory->w[i] / 2 / (spouting * memory->nu[i]); /* blade speed over the best one */
    const double eta = memory->eta[i] * 2 * r / (1 + r * r);
    return Tu * (1 - eta * drop);
}

/* Mass and energy balance of gas volume i and its wall, with the flow in (at temperature T_flow) and the flow out. */
static void balance(Memory *memory, int i, double in, double T_flow, double out) {
    const double R = memory->R, cp = memory->cp, V = memory->V[i];
    const Gas gas = memory->gas[i];
    Gas *rate = &memory->rate[i];
    const double Q = memory->G[i] * (gas.T - gas.Tw);
    rate->p = R / ((cp - R) * V) * (cp * (in * T_flow - out * gas.T) - Q);
    rate->T = gas.T / gas.p * rate->p - R * gas.T * gas.T / (gas.p * V) * (in - out);
    rate->Tw = (Q - memory->GA[i] * (gas.Tw - memory->T_amb)) / memory->C[i];
    memory->Q[i] = Q;
}

static ModelStatus calculate(void *instance, double time, ModelProblem *problem) {
    static const unsigned char inputs[] = {T_IN, P_IN};
    static const unsigned char states[] = {P1, T1, P2, T2};
    Memory *memory = (Memory *)instance;
    const Gas *one = &memory->gas[0], *two = &memory->gas[1];
    (void)time;
    if (!positive(memory, inputs, sizeof inputs, problem)) {
        return MODEL_ERROR;
    }
    if (!positive(memory, states, sizeof states, problem)) {
        return MODEL_DISCARD; /* a trial point too far away */
    }
    memory->m1 = mass_flow(memory, memory->K[0], memory->p_in, memory->T_in, one->p);
    memory->Ta = exit_temperature(memory, 0, memory->p_in, memory->T_in, one->p);
    memory->m2 = mass_flow(memory, memory->K[1], one->p, one->T, two->p);
    memory->Tb = exit_temperature(memory, 1, one->p, one->T, two->p);
    memory->m3 = mass_flow(memory, memory->K[2], two->p, two->T, memory->p_out);
    balance(memory, 0, memory->m1, memory->Ta, memory->m2);
    balance(memory, 1, memory->m2, memory->Tb, memory->m3);
    return MODEL_OK;
}

static const double nominals[] = {1e5, 500, 500, 1e5, 500, 500};

const ModelDefinition model = {
    .identifier = "exhaust",
    .token = "{01c9d825-eb5e-4ab0-b2fd-f59b3c4971d5}",
    .variables = variables,
    .n_variables = sizeof variables / sizeof variables[0],
    .memory_size = sizeof(Memory),
    .states = AT(gas),
    .derivatives = AT(rate),
    .n_states = sizeof nominals / sizeof nominals[0],
    .nominals = nominals,
    .initialize = initialize,
    .calculate = calculate,
};
