/* FMI 2.0 Model Exchange front end: turns the model behind model.h into an FMU; see fmi2_common.h. */
#include "instance.h"

#define FRONTEND_TYPE fmi2ModelExchange
#define RUNNING (EVENT | CONTINUOUS)

/* The initialisation is over. */
static ModelStatus begin_running(Instance *in, const char *function) {
    (void)function;
    in->now.phase = EVENT;
    return MODEL_OK;
}

#include "fmi2_common.h"

/* ---------------------------------------------------------------------------------------- Model Exchange */

fmi2Status fmi2EnterEventMode(fmi2Component component) {
    Instance *in = admit(component, EVENT | CONTINUOUS, "fmi2EnterEventMode");
    ModelStatus status = in == NULL ? MODEL_ERROR : commit(in, "fmi2EnterEventMode");
    if (status == MODEL_OK) {
        in->now.phase = EVENT;
    }
    return translate(status);
}

fmi2Status fmi2NewDiscreteStates(fmi2Component component, fmi2EventInfo *info) {
    Instance *in = admit(component, EVENT, "fmi2NewDiscreteStates");
    ModelEvents events;
    ModelStatus status;
    if (in == NULL) {
        return fmi2Error;
    }
    if (info == NULL) {
        return translate(fail(in, "fmi2NewDiscreteStates", "info is NULL"));
    }
    status = update_once(in, &events, "fmi2NewDiscreteStates");
    if (status != MODEL_OK) {
        return translate(status);
    }
    in->now.again = events.again != 0;
    info->newDiscreteStatesNeeded = events.again ? fmi2True : fmi2False;
    info->terminateSimulation = events.terminate ? fmi2True : fmi2False;
    info->nominalsOfContinuousStatesChanged = fmi2False;
    info->valuesOfContinuousStatesChanged = events.states_changed ? fmi2True : fmi2False;
    info->nextEventTimeDefined = events.next_event ? fmi2True : fmi2False;
    info->nextEventTime = events.next_event ? events.next_event_time : 0.0;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component component) {
    Instance *in = admit(component, EVENT, "fmi2EnterContinuousTimeMode");
    if (in == NULL) {
        return fmi2Error;
    }
    if (in->now.again) {
        return translate(fail(in, "fmi2EnterContinuousTimeMode", "the event iteration at t = %.17g is not over",
                              in->now.time));
    }
    in->now.phase = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component component, fmi2Boolean no_set_state_prior,
                                       fmi2Boolean *enter_event_mode, fmi2Boolean *terminate_simulation) {
    Instance *in = admit(component, CONTINUOUS, "fmi2CompletedIntegratorStep");
    (void)no_set_state_prior; /* nothing is buffered that could be flushed */
    if (in == NULL) {
        return fmi2Error;
    }
    if (enter_event_mode == NULL || terminate_simulation == NULL) {
        return translate(fail(in, "fmi2CompletedIntegratorStep", "NULL argument"));
    }
    *enter_event_mode = wants_event(in) ? fmi2True : fmi2False;
    *terminate_simulation = fmi2False;
    return translate(commit(in, "fmi2CompletedIntegratorStep"));
}

fmi2Status fmi2SetTime(fmi2Component component, fmi2Real time) {
    Instance *in = admit(component, EVENT | CONTINUOUS, "fmi2SetTime");
    return in == NULL ? fmi2Error : translate(move_time(in, time, "fmi2SetTime"));
}

fmi2Status fmi2SetContinuousStates(fmi2Component component, const fmi2Real states[], size_t n) {
    Instance *in = admit_array(component, CONTINUOUS, states, n, model.n_states, "fmi2SetContinuousStates");
    if (in == NULL) {
        return fmi2Error;
    }
    move_states(in, states, n);
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component component, fmi2Real derivatives[], size_t n) {
    Instance *in =
        admit_array(component, READABLE & ~INITIALIZATION, derivatives, n, model.n_states, "fmi2GetDerivatives");
    ModelStatus status = in == NULL ? MODEL_ERROR : refresh(in, "fmi2GetDerivatives");
    if (status == MODEL_OK) {
        read_array(in, derivatives, n, model.derivatives);
    }
    return translate(status);
}

fmi2Status fmi2GetEventIndicators(fmi2Component component, fmi2Real indicators[], size_t n) {
    Instance *in = admit_array(component, READABLE, indicators, n, model.n_indicators, "fmi2GetEventIndicators");
    ModelStatus status = in == NULL ? MODEL_ERROR : refresh(in, "fmi2GetEventIndicators");
    if (status == MODEL_OK) {
        read_array(in, indicators, n, model.indicators);
    }
    return translate(status);
}

fmi2Status fmi2GetContinuousStates(fmi2Component component, fmi2Real states[], size_t n) {
    Instance *in = admit_array(component, READABLE, states, n, model.n_states, "fmi2GetContinuousStates");
    if (in == NULL) {
        return fmi2Error;
    }
    read_array(in, states, n, model.states);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component component, fmi2Real nominals[], size_t n) {
    Instance *in = admit_array(component, ANY & ~INITIALIZATION, nominals, n, model.n_states,
                               "fmi2GetNominalsOfContinuousStates");
    size_t i;
    if (in == NULL) {
        return fmi2Error;
    }
    for (i = 0; i < n; i++) {
        nominals[i] = model.nominals != NULL ? model.nominals[i] : 1.0;
    }
    return fmi2OK;
}
