/* FMI 1.0 Co-Simulation front end: turns the model behind model.h, with the solver of solver.h, into an FMU; see
 * fmi1_common.h. */
#include "solver.h"

#define RUNNING STEP
#define FMI1_CO_SIMULATION
#include "fmi1_common.h"

FMI1_EXPORT fmiString FMI1(fmiGetTypesPlatform)(void) {
    return "standard32";
}

FMI1_EXPORT fmiComponent FMI1(fmiInstantiateSlave)(fmiString instance_name, fmiString guid, fmiString location,
                                                   fmiString mime_type, fmiReal timeout, fmiBoolean visible,
                                                   fmiBoolean interactive, fmiCallbackFunctions functions,
                                                   fmiBoolean logging) {
    (void)mime_type;
    (void)timeout;
    (void)visible;
    (void)interactive;
    if (location == NULL || strncmp(location, "file://", 7) != 0) {
        return NULL;
    }
    return make(instance_name, guid, functions, logging);
}

FMI1_EXPORT void FMI1(fmiFreeSlaveInstance)(fmiComponent component) {
    if (component != NULL) {
        destroy((Instance *)component);
    }
}

FMI1_EXPORT fmiStatus FMI1(fmiInitializeSlave)(fmiComponent component, fmiReal start, fmiBoolean stop_defined,
                                               fmiReal stop) {
    Instance *in = admit(component, INSTANTIATED, "fmiInitializeSlave");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : initialise(in, start, stop_defined ? stop : HUGE_VAL, "fmiInitializeSlave");
    return translate(status == MODEL_OK ? begin_steps(in, "fmiInitializeSlave") : status);
}

FMI1_EXPORT fmiStatus FMI1(fmiTerminateSlave)(fmiComponent component) {
    Instance *in = admit(component, STEP, "fmiTerminateSlave");
    if (in == NULL) {
        return fmiError;
    }
    in->now.phase = TERMINATED;
    return fmiOK;
}

FMI1_EXPORT fmiStatus FMI1(fmiResetSlave)(fmiComponent component) {
    Instance *in = admit(component, ANY, "fmiResetSlave");
    if (in == NULL) {
        return fmiError;
    }
    restart(in);
    return fmiOK;
}

FMI1_EXPORT fmiStatus FMI1(fmiSetRealInputDerivatives)(fmiComponent component, const fmiValueReference references[],
                                                       size_t n, const fmiInteger orders[], const fmiReal values[]) {
    Instance *in = admit(component, INSTANTIATED | STEP, "fmiSetRealInputDerivatives");
    return in == NULL ? fmiError
                      : translate(set_slopes(in, references, n, orders, values, "fmiSetRealInputDerivatives"));
}

FMI1_EXPORT fmiStatus FMI1(fmiGetRealOutputDerivatives)(fmiComponent component, const fmiValueReference references[],
                                                        size_t n, const fmiInteger orders[], fmiReal values[]) {
    Instance *in = admit(component, READABLE, "fmiGetRealOutputDerivatives");
    (void)references;
    (void)n;
    (void)orders;
    (void)values;
    return in == NULL ? fmiError : translate(fail(in, "fmiGetRealOutputDerivatives", "not offered by this FMU"));
}

FMI1_EXPORT fmiStatus FMI1(fmiDoStep)(fmiComponent component, fmiReal time, fmiReal size, fmiBoolean new_step) {
    Instance *in = admit(component, STEP, "fmiDoStep");
    ModelStatus status;
    (void)new_step;
    if (in == NULL) {
        return fmiError;
    }
    if (in->now.ended) { /* FMI 1.0 has no better word for it */
        return fmiDiscard;
    }
    status = step_to(in, time, size, 0, "fmiDoStep");
    return translate(status == MODEL_OK && in->now.time < time + size && in->now.ended ? MODEL_DISCARD : status);
}

FMI1_EXPORT fmiStatus FMI1(fmiCancelStep)(fmiComponent component) {
    Instance *in = admit(component, STEP, "fmiCancelStep");
    return in == NULL ? fmiError : translate(fail(in, "fmiCancelStep", "no step is pending"));
}

FMI1_EXPORT fmiStatus FMI1(fmiGetStatus)(fmiComponent component, fmiStatusKind kind, fmiStatus *value) {
    (void)component;
    (void)kind;
    (void)value;
    return fmiDiscard; /* no step is ever pending */
}

FMI1_EXPORT fmiStatus FMI1(fmiGetRealStatus)(fmiComponent component, fmiStatusKind kind, fmiReal *value) {
    Instance *in = admit(component, STEP, "fmiGetRealStatus");
    if (in == NULL || value == NULL) {
        return fmiError;
    }
    if (kind != fmiLastSuccessfulTime) {
        return fmiDiscard;
    }
    *value = in->now.time;
    return fmiOK;
}

FMI1_EXPORT fmiStatus FMI1(fmiGetIntegerStatus)(fmiComponent component, fmiStatusKind kind, fmiInteger *value) {
    (void)component;
    (void)kind;
    (void)value;
    return fmiDiscard;
}

FMI1_EXPORT fmiStatus FMI1(fmiGetBooleanStatus)(fmiComponent component, fmiStatusKind kind, fmiBoolean *value) {
    (void)component;
    (void)kind;
    (void)value;
    return fmiDiscard;
}

FMI1_EXPORT fmiStatus FMI1(fmiGetStringStatus)(fmiComponent component, fmiStatusKind kind, fmiString *value) {
    (void)component;
    (void)kind;
    (void)value;
    return fmiDiscard;
}
