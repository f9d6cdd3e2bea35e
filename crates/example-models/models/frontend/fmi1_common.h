/* What the FMI 1.0 front ends for Model Exchange and Co-Simulation share: creation, variables, messages. As strict as
 * fmi2_common.h. FMI 1.0 has no event mode: between steps everything may be set that may be set at events.
 *
 * Included once, by fmi1_me.c or fmi1_cs.c, behind RUNNING (the states in which the model runs). */
#ifndef FMI1_COMMON_H
#define FMI1_COMMON_H

#include "fmi1.h"

typedef struct {
    Instance base; /* first, so that a pointer to the one is a pointer to the other */
    fmiCallbackFunctions functions;
} Component;

static fmiStatus translate(ModelStatus status) {
    return status == MODEL_OK ? fmiOK : status == MODEL_DISCARD ? fmiDiscard : fmiError;
}

static void emit(const Instance *in, ModelStatus status, const char *category, const char *text) {
    const Component *component = (const Component *)in;
    if (component->functions.logger != NULL) {
        component->functions.logger((fmiComponent)component, in->name, translate(status), category, "%s", text);
    }
}

static fmiComponent make(fmiString instance_name, fmiString guid, fmiCallbackFunctions functions, fmiBoolean logging) {
    Store store = {calloc, free};
    const char *problem = "out of memory";
    Instance *in = NULL;
    if (functions.allocateMemory != NULL && functions.freeMemory != NULL) {
        store.take = functions.allocateMemory;
        store.give_back = functions.freeMemory;
    }
    if (instance_name == NULL || instance_name[0] == '\0') {
        problem = "the instance name is missing";
    } else if (model.n_states > MOST_STATES || model.n_variables > MOST_VARIABLES) {
        problem = "the model is larger than the front end provides for";
    } else if (guid == NULL || strcmp(guid, model.token) != 0) {
        problem = "the guid is not the one this binary was built for";
    } else {
        in = create(sizeof(Component), store, instance_name, logging);
    }
    if (in != NULL) {
        ((Component *)in)->functions = functions;
    } else if (functions.logger != NULL) {
        functions.logger(NULL, instance_name != NULL ? instance_name : "", fmiError, category_name(LOG_ERROR),
                         "instantiation: %s", problem);
    }
    return in;
}

/* The initialisation: parameters are checked and everything is calculated for the first time. */
static ModelStatus initialise(Instance *in, double start, double stop, const char *function) {
    ModelStatus status;
    if (!isfinite(start) || !(stop >= start)) {
        return fail(in, function, "no experiment from t = %g to %g", start, stop);
    }
    in->now.time = in->now.last = start;
    in->now.stop = stop;
    in->now.phase = INITIALIZATION;
    in->now.stale = 1;
    status = refresh(in, function);
    return status == MODEL_DISCARD ? fail(in, function, "the model cannot be evaluated at its start values") : status;
}

FMI1_EXPORT fmiString FMI1(fmiGetVersion)(void) {
    return "1.0";
}

FMI1_EXPORT fmiStatus FMI1(fmiSetDebugLogging)(fmiComponent component, fmiBoolean on) {
    Instance *in = admit(component, ANY, "fmiSetDebugLogging");
    if (in == NULL) {
        return fmiError;
    }
    in->logging = on ? LOG_ALL : 0;
    return fmiOK;
}

FMI1_EXPORT fmiStatus FMI1(fmiGetReal)(fmiComponent component, const fmiValueReference references[], size_t n,
                                       fmiReal values[]) {
    Instance *in = admit(component, READABLE, "fmiGetReal");
    ModelStatus status = in == NULL ? MODEL_ERROR : prepare_get(in, references, n, values, MODEL_REAL, "fmiGetReal");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        values[i] = get_real(in, references[i]);
    }
    return translate(status);
}

FMI1_EXPORT fmiStatus FMI1(fmiGetInteger)(fmiComponent component, const fmiValueReference references[], size_t n,
                                          fmiInteger values[]) {
    Instance *in = admit(component, READABLE, "fmiGetInteger");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : prepare_get(in, references, n, values, MODEL_INTEGER, "fmiGetInteger");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        values[i] = *integer_at(in, model.variables[references[i]].offset);
    }
    return translate(status);
}

FMI1_EXPORT fmiStatus FMI1(fmiGetBoolean)(fmiComponent component, const fmiValueReference references[], size_t n,
                                          fmiBoolean values[]) {
    Instance *in = admit(component, READABLE, "fmiGetBoolean");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : prepare_get(in, references, n, values, MODEL_BOOLEAN, "fmiGetBoolean");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        values[i] = *integer_at(in, model.variables[references[i]].offset) ? fmiTrue : fmiFalse;
    }
    return translate(status);
}

/* No model has String variables so far: only the empty request is answered. */
FMI1_EXPORT fmiStatus FMI1(fmiGetString)(fmiComponent component, const fmiValueReference references[], size_t n,
                                         fmiString values[]) {
    Instance *in = admit(component, READABLE, "fmiGetString");
    (void)references;
    (void)values;
    if (in != NULL && n > 0) {
        fail(in, "fmiGetString", "the model has no String variables");
    }
    return in != NULL && n == 0 ? fmiOK : fmiError;
}

FMI1_EXPORT fmiStatus FMI1(fmiSetReal)(fmiComponent component, const fmiValueReference references[], size_t n,
                                       const fmiReal values[]) {
    Instance *in = admit(component, INSTANTIATED | RUNNING, "fmiSetReal");
    ModelStatus status = in == NULL ? MODEL_ERROR : prepare_set(in, references, n, values, MODEL_REAL, "fmiSetReal");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        *real_at(in, model.variables[references[i]].offset) = values[i];
    }
    return translate(status);
}

FMI1_EXPORT fmiStatus FMI1(fmiSetInteger)(fmiComponent component, const fmiValueReference references[], size_t n,
                                          const fmiInteger values[]) {
    Instance *in = admit(component, INSTANTIATED | RUNNING, "fmiSetInteger");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : prepare_set(in, references, n, values, MODEL_INTEGER, "fmiSetInteger");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        *integer_at(in, model.variables[references[i]].offset) = values[i];
    }
    return translate(status);
}

FMI1_EXPORT fmiStatus FMI1(fmiSetBoolean)(fmiComponent component, const fmiValueReference references[], size_t n,
                                          const fmiBoolean values[]) {
    Instance *in = admit(component, INSTANTIATED | RUNNING, "fmiSetBoolean");
    ModelStatus status =
        in == NULL ? MODEL_ERROR : prepare_set(in, references, n, values, MODEL_BOOLEAN, "fmiSetBoolean");
    size_t i;
    for (i = 0; status == MODEL_OK && i < n; i++) {
        if (values[i] != fmiTrue && values[i] != fmiFalse) {
            status = fail(in, "fmiSetBoolean", "%d is neither fmiTrue nor fmiFalse", values[i]);
        }
    }
    for (i = 0; status == MODEL_OK && i < n; i++) {
        *integer_at(in, model.variables[references[i]].offset) = values[i];
    }
    return translate(status);
}

FMI1_EXPORT fmiStatus FMI1(fmiSetString)(fmiComponent component, const fmiValueReference references[], size_t n,
                                         const fmiString values[]) {
    Instance *in = admit(component, INSTANTIATED | RUNNING, "fmiSetString");
    (void)references;
    (void)values;
    if (in != NULL && n > 0) {
        fail(in, "fmiSetString", "the model has no String variables");
    }
    return in != NULL && n == 0 ? fmiOK : fmiError;
}

#endif
