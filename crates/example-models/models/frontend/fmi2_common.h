/* What the FMI 2.0 front ends for Model Exchange and Co-Simulation share: everything but the running modes.
 *
 * Strict on purpose, so that an importer which works with it keeps to the standard: every call is checked against
 * the state machine of FMI 2.0.4 (sections 3.2.3 and 4.2.4), every length, pointer and value reference is looked at,
 * and a wrong call is answered with fmi2Error, a message that names the call, and the error state, which only
 * fmi2Reset, fmi2SetFMUstate and fmi2FreeInstance leave.
 *
 * Included once, by fmi2_me.c or fmi2_cs.c. */
#ifndef FMI2_COMMON_H
#define FMI2_COMMON_H

#include "fmi2.h"

#include "instance.h"

typedef struct {
    Instance base; /* first, so that a pointer to the one is a pointer to the other */
    fmi2CallbackFunctions functions;
} Component;

/* Each front end says which kind of instance it makes, and in which states what is allowed. */
#ifndef FRONTEND_TYPE
#error "include this from fmi2_me.c or fmi2_cs.c"
#endif

static fmi2Status translate(ModelStatus status) {
    return status == MODEL_OK ? fmi2OK : status == MODEL_DISCARD ? fmi2Discard : fmi2Error;
}

static void emit(const Instance *in, ModelStatus status, const char *category, const char *text) {
    const fmi2CallbackFunctions *functions = &((const Component *)in)->functions;
    if (functions->logger != NULL) {
        functions->logger(functions->componentEnvironment, in->name, translate(status), category, "%s", text);
    }
}

/* -------------------------------------------------------------------------- creation, initialisation, end */

const char *fmi2GetTypesPlatform(void) {
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void) {
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String instance_name, fmi2Type type, fmi2String guid, fmi2String resource_location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging_on) {
    Store store = {calloc, free};
    const char *problem = "out of memory";
    Instance *in = NULL;
    (void)resource_location; /* no resources */
    (void)visible;           /* nothing to show */
    if (functions == NULL) {
        return NULL;
    }
    if (functions->allocateMemory != NULL && functions->freeMemory != NULL) {
        store.take = functions->allocateMemory;
        store.give_back = functions->freeMemory;
    }
    if (instance_name == NULL || instance_name[0] == '\0') {
        problem = "the instance name is missing";
    } else if (type != FRONTEND_TYPE) {
        problem = "this FMU does not offer the interface asked for";
    } else if (model.n_states > MOST_STATES || model.n_variables > MOST_VARIABLES) {
        problem = "the model is larger than the front end provides for";
    } else if (guid == NULL || strcmp(guid, model.token) != 0) {
        problem = "the guid is not the one this binary was built for";
    } else {
        in = create(sizeof(Component), store, instance_name, logging_on);
    }
    if (in != NULL) {
        ((Component *)in)->functions = *functions;
    } else if (functions->logger != NULL) {
        functions->logger(functions->componentEnvironment, instance_name != NULL ? instance_name : "", fmi2Error,
                          category_name(LOG_ERROR), "fmi2Instantiate: %s", problem);
    }
    return in;
}

void fmi2FreeInstance(fmi2Component component) {
    if (component != NULL) {
        destroy((Instance *)component);
    }
}

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t n_categories,
                               const fmi2String categories[]) {
    Instance *in = admit(component, ANY, "fmi2SetDebugLogging");
    return in == NULL ? fmi2Error
                      : translate(choose_categories(in, on, n_categories, categories, "fmi2SetDebugLogging"));
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                               fmi2Real start_time, fmi2Boolean stop_time_defined, fmi2Real stop_time) {
    Instance *in = admit(component, INSTANTIATED, "fmi2SetupExperiment");
    if (in == NULL) {
        return fmi2Error;
    }
    if (tolerance_defined && !(tolerance > 0)) {
        return translate(fail(in, "fmi2SetupExperiment", "the tolerance %g is not positive", tolerance));
    }
    if (!isfinite(start_time) || (stop_time_defined && !(stop_time >= start_time))) {
        return translate(fail(in, "fmi2SetupExperiment", "no experiment from t = %g to %g", start_time,
                              stop_time_defined ? stop_time : HUGE_VAL));
    }
    in->now.time = in->now.last = start_time;
    in->now.stop = stop_time_defined ? stop_time : HUGE_VAL;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component) {
    Instance *in = admit(component, INSTANTIATED, "fmi2EnterInitializationMode");
    if (in == NULL) {
        return fmi2Error;
    }
    in->now.phase = INITIALIZATION;
    in->now.stale = 1;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component) {
    Instance *in = admit(component, INITIALIZATION, "fmi2ExitInitializationMode");
    ModelStatus status = in == NULL ? MODEL_ERROR : refresh(in, "fmi2ExitInitializationMode");
    if (status == MODEL_DISCARD) { /* at the start there is no smaller step to try */
        status = fail(in, "fmi2ExitInitializationMode", "the model cannot be evaluated at its start values");
    }
    if (status == MODEL_OK) {
        status = begin_running(in, "fmi2ExitInitializationMode");
    }
    return translate(status);
}

fmi2Status fmi2Terminate(fmi2Component component) {
    Instance *in = admit(component, RUNNING, "fmi2Terminate");
    if (in == NULL) {
        return fmi2Error;
    }
    in->now.phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component component) {
    Instance *in = admit(component, ANY, "fmi2Reset");
    if (in == NULL) {
        return fmi2Error;
    }
    restart(in);
    return fmi2OK;
}

/* --------------------------------------------------------------------------------------------- variables */

fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference references[], size_t n, fmi2Real values[]) {
    Instance *in = admit(component, READABLE, "fmi2GetReal");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : prepare_get(in, references, n, values, MODEL_REAL, "fmi2GetReal");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        values[i] = get_real(in, references[i]);
    }
    return translate(status);
}

fmi2Status fmi2GetInteger(fmi2Component component, const fmi2ValueReference references[], size_t n,
                          fmi2Integer values[]) {
    Instance *in = admit(component, READABLE, "fmi2GetInteger");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : prepare_get(in, references, n, values, MODEL_INTEGER, "fmi2GetInteger");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        values[i] = *integer_at(in, model.variables[references[i]].offset);
    }
    return translate(status);
}

fmi2Status fmi2GetBoolean(fmi2Component component, const fmi2ValueReference references[], size_t n,
                          fmi2Boolean values[]) {
    Instance *in = admit(component, READABLE, "fmi2GetBoolean");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : prepare_get(in, references, n, values, MODEL_BOOLEAN, "fmi2GetBoolean");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        values[i] = *integer_at(in, model.variables[references[i]].offset) ? fmi2True : fmi2False;
    }
    return translate(status);
}

/* No model has String variables so far: only the empty request is answered. */
fmi2Status fmi2GetString(fmi2Component component, const fmi2ValueReference references[], size_t n,
                         fmi2String values[]) {
    Instance *in = admit(component, READABLE, "fmi2GetString");
    (void)references;
    (void)values;
    if (in != NULL && n > 0) {
        fail(in, "fmi2GetString", "the model has no String variables");
    }
    return in != NULL && n == 0 ? fmi2OK : fmi2Error;
}

fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference references[], size_t n,
                       const fmi2Real values[]) {
    Instance *in = admit(component, INSTANTIATED | INITIALIZATION | RUNNING, "fmi2SetReal");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : prepare_set(in, references, n, values, MODEL_REAL, "fmi2SetReal");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        *real_at(in, model.variables[references[i]].offset) = values[i];
    }
    return translate(status);
}

fmi2Status fmi2SetInteger(fmi2Component component, const fmi2ValueReference references[], size_t n,
                          const fmi2Integer values[]) {
    Instance *in = admit(component, INSTANTIATED | INITIALIZATION | (RUNNING & ~CONTINUOUS), "fmi2SetInteger");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : prepare_set(in, references, n, values, MODEL_INTEGER, "fmi2SetInteger");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        *integer_at(in, model.variables[references[i]].offset) = values[i];
    }
    return translate(status);
}

fmi2Status fmi2SetBoolean(fmi2Component component, const fmi2ValueReference references[], size_t n,
                          const fmi2Boolean values[]) {
    Instance *in = admit(component, INSTANTIATED | INITIALIZATION | (RUNNING & ~CONTINUOUS), "fmi2SetBoolean");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : prepare_set(in, references, n, values, MODEL_BOOLEAN, "fmi2SetBoolean");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        if (values[i] != fmi2True && values[i] != fmi2False) {
            status = fail(in, "fmi2SetBoolean", "%d is neither fmi2True nor fmi2False", values[i]);
        }
    }
    for (i = 0; status == MODEL_OK && i < n; i++) {
        *integer_at(in, model.variables[references[i]].offset) = values[i];
    }
    return translate(status);
}

fmi2Status fmi2SetString(fmi2Component component, const fmi2ValueReference references[], size_t n,
                         const fmi2String values[]) {
    Instance *in = admit(component, INSTANTIATED | INITIALIZATION | (RUNNING & ~CONTINUOUS), "fmi2SetString");
    (void)references;
    (void)values;
    if (in != NULL && n > 0) {
        fail(in, "fmi2SetString", "the model has no String variables");
    }
    return in != NULL && n == 0 ? fmi2OK : fmi2Error;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknowns[],
                                        size_t n_unknowns, const fmi2ValueReference knowns[], size_t n_knowns,
                                        const fmi2Real seed[], fmi2Real sensitivity[]) {
    Instance *in = admit(component, READABLE, "fmi2GetDirectionalDerivative");
    if (in == NULL) {
        return fmi2Error;
    }
    if ((n_unknowns > 0 && (unknowns == NULL || sensitivity == NULL)) ||
        (n_knowns > 0 && (knowns == NULL || seed == NULL))) {
        return translate(fail(in, "fmi2GetDirectionalDerivative", "NULL array for %lu unknowns or %lu knowns",
                              (unsigned long)n_unknowns, (unsigned long)n_knowns));
    }
    return translate(directional(in, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity,
                                 "fmi2GetDirectionalDerivative"));
}

/* ------------------------------------------------------------------------------------------ saved states */

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state) {
    Instance *in = admit(component, ANY, "fmi2GetFMUstate");
    return in == NULL ? fmi2Error : translate(save(in, state, "fmi2GetFMUstate"));
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state) {
    Instance *in = admit(component, ANY, "fmi2SetFMUstate");
    return in == NULL ? fmi2Error : translate(bring_back(in, state, "fmi2SetFMUstate"));
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state) {
    Instance *in = admit(component, ANY, "fmi2FreeFMUstate");
    return in == NULL ? fmi2Error : translate(forget(in, state, "fmi2FreeFMUstate"));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *size) {
    Instance *in = admit(component, ANY, "fmi2SerializedFMUstateSize");
    if (in == NULL || own_state(in, state, "fmi2SerializedFMUstateSize") == NULL) {
        return fmi2Error;
    }
    if (size == NULL) {
        return translate(fail(in, "fmi2SerializedFMUstateSize", "size is NULL"));
    }
    *size = SERIALISED_SIZE;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    Instance *in = admit(component, ANY, "fmi2SerializeFMUstate");
    return in == NULL ? fmi2Error : translate(serialise(in, state, bytes, size, "fmi2SerializeFMUstate"));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    Instance *in = admit(component, ANY, "fmi2DeSerializeFMUstate");
    return in == NULL ? fmi2Error : translate(deserialise(in, bytes, size, state, "fmi2DeSerializeFMUstate"));
}

#endif
