/* FMI 2.0 Co-Simulation front end: turns the model behind model.h, with the solver of solver.h, into an FMU; see
 * fmi2_common.h.
 *
 * Strict about steps too: each one must begin where the last one ended, and end at the stop time at the latest. With
 * FIXED_STEP defined (a number), every step must have exactly that size. */
#include "solver.h"

#define FRONTEND_TYPE fmi2CoSimulation
#define RUNNING STEP

static ModelStatus begin_running(Instance *in, const char *function) {
    return begin_steps(in, function);
}

#include "fmi2_common.h"

/* ----------------------------------------------------------------------------------------- Co-Simulation */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                       const fmi2Integer orders[], const fmi2Real values[]) {
    Instance *in = admit(component, INSTANTIATED | INITIALIZATION | STEP, "fmi2SetRealInputDerivatives");
    return in == NULL ? fmi2Error
                      : translate(set_slopes(in, references, n, orders, values, "fmi2SetRealInputDerivatives"));
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                        const fmi2Integer orders[], fmi2Real values[]) {
    Instance *in = admit(component, READABLE, "fmi2GetRealOutputDerivatives");
    (void)references;
    (void)n;
    (void)orders;
    (void)values;
    return in == NULL ? fmi2Error
                      : translate(fail(in, "fmi2GetRealOutputDerivatives", "not offered by this FMU"));
}

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real current_time, fmi2Real step_size,
                      fmi2Boolean no_set_state_prior) {
    Instance *in = admit(component, STEP, "fmi2DoStep");
    ModelStatus status;
    (void)no_set_state_prior; /* nothing is buffered that could be flushed */
    if (in == NULL) {
        return fmi2Error;
    }
    status = step_to(in, current_time, step_size, 0, "fmi2DoStep");
    return translate(status == MODEL_OK && in->now.ended ? MODEL_DISCARD : status);
}

fmi2Status fmi2CancelStep(fmi2Component component) {
    Instance *in = admit(component, STEP, "fmi2CancelStep");
    return in == NULL ? fmi2Error : translate(fail(in, "fmi2CancelStep", "no step is pending"));
}

fmi2Status fmi2GetStatus(fmi2Component component, fmi2StatusKind kind, fmi2Status *value) {
    (void)component;
    (void)kind;
    (void)value;
    return fmi2Discard; /* no step is ever pending */
}

fmi2Status fmi2GetRealStatus(fmi2Component component, fmi2StatusKind kind, fmi2Real *value) {
    Instance *in = admit(component, STEP | FAILED, "fmi2GetRealStatus");
    if (in == NULL || value == NULL) {
        return fmi2Error;
    }
    if (kind != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = in->now.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component component, fmi2StatusKind kind, fmi2Integer *value) {
    (void)component;
    (void)kind;
    (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component component, fmi2StatusKind kind, fmi2Boolean *value) {
    Instance *in = admit(component, STEP | FAILED, "fmi2GetBooleanStatus");
    if (in == NULL || value == NULL) {
        return fmi2Error;
    }
    if (kind != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = in->now.ended ? fmi2True : fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component component, fmi2StatusKind kind, fmi2String *value) {
    (void)component;
    (void)kind;
    (void)value;
    return fmi2Discard;
}
