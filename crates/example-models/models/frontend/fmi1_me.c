/* FMI 1.0 Model Exchange front end: turns the model behind model.h into an FMU; see fmi1_common.h. */
#include "instance.h"

#define RUNNING EVENT
#include "fmi1_common.h"

FMI1_EXPORT fmiString FMI1(fmiGetModelTypesPlatform)(void) {
    return "standard32";
}

FMI1_EXPORT fmiComponent FMI1(fmiInstantiateModel)(fmiString instance_name, fmiString guid,
                                                   fmiCallbackFunctions functions, fmiBoolean logging) {
    return make(instance_name, guid, functions, logging);
}

FMI1_EXPORT void FMI1(fmiFreeModelInstance)(fmiComponent component) {
    if (component != NULL) {
        destroy((Instance *)component);
    }
}

FMI1_EXPORT fmiStatus FMI1(fmiSetTime)(fmiComponent component, fmiReal time) {
    Instance *in = admit(component, INSTANTIATED | EVENT, "fmiSetTime");
    if (in == NULL) {
        return fmiError;
    }
    if (in->now.phase == INSTANTIATED) {
        in->now.time = in->now.last = time;
        return fmiOK;
    }
    return translate(move_time(in, time, "fmiSetTime"));
}

/* Updates the discrete variables, once or until they settle, and says what happened. */
static ModelStatus update_events(Instance *in, int once, fmiEventInfo *info, const char *function) {
    ModelEvents events;
    int changed = 0, rounds = 0;
    do {
        const ModelStatus status = update_once(in, &events, function);
        if (status != MODEL_OK) {
            return status;
        }
        changed |= events.states_changed;
        if (++rounds > 100) {
            return fail(in, function, "the events at t = %.17g do not end", in->now.time);
        }
    } while (events.again && !once && !events.terminate);
    info->iterationConverged = events.again ? fmiFalse : fmiTrue;
    info->stateValueReferencesChanged = fmiFalse;
    info->stateValuesChanged = changed ? fmiTrue : fmiFalse;
    info->terminateSimulation = events.terminate ? fmiTrue : fmiFalse;
    info->upcomingTimeEvent = events.next_event ? fmiTrue : fmiFalse;
    info->nextEventTime = events.next_event ? events.next_event_time : 0.0;
    return MODEL_OK;
}

FMI1_EXPORT fmiStatus FMI1(fmiInitialize)(fmiComponent component, fmiBoolean tolerance_controlled,
                                          fmiReal relative_tolerance, fmiEventInfo *info) {
    Instance *in = admit(component, INSTANTIATED, "fmiInitialize");
    ModelStatus status;
    if (in == NULL) {
        return fmiError;
    }
    if (info == NULL || (tolerance_controlled && !(relative_tolerance > 0))) {
        return translate(fail(in, "fmiInitialize", "no event info, or a tolerance that is not positive"));
    }
    status = initialise(in, in->now.time, HUGE_VAL, "fmiInitialize");
    if (status == MODEL_OK) {
        in->now.phase = EVENT;
        status = update_events(in, 0, info, "fmiInitialize");
    }
    return translate(status);
}

FMI1_EXPORT fmiStatus FMI1(fmiEventUpdate)(fmiComponent component, fmiBoolean intermediate_results,
                                           fmiEventInfo *info) {
    Instance *in = admit(component, EVENT, "fmiEventUpdate");
    ModelStatus status;
    if (in == NULL) {
        return fmiError;
    }
    if (info == NULL) {
        return translate(fail(in, "fmiEventUpdate", "info is NULL"));
    }
    status = commit(in, "fmiEventUpdate");
    return translate(status == MODEL_OK ? update_events(in, intermediate_results, info, "fmiEventUpdate") : status);
}

FMI1_EXPORT fmiStatus FMI1(fmiCompletedIntegratorStep)(fmiComponent component, fmiBoolean *call_event_update) {
    Instance *in = admit(component, EVENT, "fmiCompletedIntegratorStep");
    if (in == NULL) {
        return fmiError;
    }
    if (call_event_update == NULL) {
        return translate(fail(in, "fmiCompletedIntegratorStep", "NULL argument"));
    }
    *call_event_update = wants_event(in) ? fmiTrue : fmiFalse;
    return translate(commit(in, "fmiCompletedIntegratorStep"));
}

FMI1_EXPORT fmiStatus FMI1(fmiSetContinuousStates)(fmiComponent component, const fmiReal states[], size_t n) {
    Instance *in = admit_array(component, EVENT, states, n, model.n_states, "fmiSetContinuousStates");
    if (in == NULL) {
        return fmiError;
    }
    move_states(in, states, n);
    return fmiOK;
}

FMI1_EXPORT fmiStatus FMI1(fmiGetDerivatives)(fmiComponent component, fmiReal derivatives[], size_t n) {
    Instance *in = admit_array(component, EVENT, derivatives, n, model.n_states, "fmiGetDerivatives");
    ModelStatus status = in == NULL ? MODEL_ERROR : refresh(in, "fmiGetDerivatives");
    if (status == MODEL_OK) {
        read_array(in, derivatives, n, model.derivatives);
    }
    return translate(status);
}

FMI1_EXPORT fmiStatus FMI1(fmiGetEventIndicators)(fmiComponent component, fmiReal indicators[], size_t n) {
    Instance *in = admit_array(component, EVENT, indicators, n, model.n_indicators, "fmiGetEventIndicators");
    ModelStatus status = in == NULL ? MODEL_ERROR : refresh(in, "fmiGetEventIndicators");
    if (status == MODEL_OK) {
        read_array(in, indicators, n, model.indicators);
    }
    return translate(status);
}

FMI1_EXPORT fmiStatus FMI1(fmiGetContinuousStates)(fmiComponent component, fmiReal states[], size_t n) {
    Instance *in = admit_array(component, EVENT, states, n, model.n_states, "fmiGetContinuousStates");
    if (in == NULL) {
        return fmiError;
    }
    read_array(in, states, n, model.states);
    return fmiOK;
}

FMI1_EXPORT fmiStatus FMI1(fmiGetNominalContinuousStates)(fmiComponent component, fmiReal nominals[], size_t n) {
    Instance *in =
        admit_array(component, INSTANTIATED | EVENT, nominals, n, model.n_states, "fmiGetNominalContinuousStates");
    size_t i;
    if (in == NULL) {
        return fmiError;
    }
    for (i = 0; i < n; i++) {
        nominals[i] = model.nominals != NULL ? model.nominals[i] : 1.0;
    }
    return fmiOK;
}

FMI1_EXPORT fmiStatus FMI1(fmiGetStateValueReferences)(fmiComponent component, fmiValueReference references[],
                                                       size_t n) {
    Instance *in =
        admit_array(component, INSTANTIATED | EVENT, references, n, model.n_states, "fmiGetStateValueReferences");
    unsigned i, k = 0;
    if (in == NULL) {
        return fmiError;
    }
    for (i = 0; i < model.n_variables; i++) {
        if (model.variables[i].role == MODEL_STATE && k < n) {
            references[k++] = i;
        }
    }
    return fmiOK;
}

FMI1_EXPORT fmiStatus FMI1(fmiTerminate)(fmiComponent component) {
    Instance *in = admit(component, EVENT, "fmiTerminate");
    if (in == NULL) {
        return fmiError;
    }
    in->now.phase = TERMINATED;
    return fmiOK;
}
