/* FMI 3.0 front end, Model Exchange and Co-Simulation: turns the model behind model.h, with the solver of solver.h,
 * into an FMU. As strict as fmi2_common.h: every call is checked against the state machines of FMI 3.0.1 (sections
 * 2.3, 3.2 and 4.2).
 *
 * Behind the variables of the model stand its event indicators, with the value references that follow. */
#include "solver.h"

#include "fmi3.h"

typedef struct {
    Instance base; /* first, so that a pointer to the one is a pointer to the other */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    int co_simulation;
    int event_mode;   /* events are handled by the importer (Co-Simulation) */
    int early_return; /* and a step may end at one */
} Component;

enum { RUNNING = EVENT | CONTINUOUS | STEP };

static fmi3Status translate(ModelStatus status) {
    return status == MODEL_OK ? fmi3OK : status == MODEL_DISCARD ? fmi3Discard : fmi3Error;
}

static void emit(const Instance *in, ModelStatus status, const char *category, const char *text) {
    const Component *component = (const Component *)in;
    if (component->log != NULL) {
        component->log(component->environment, translate(status), category, text);
    }
}

/* -------------------------------------------------------------------------- creation, initialisation, end */

FMI3_EXPORT const char *fmi3GetVersion(void) {
    return "3.0";
}

static Component *make(fmi3String name, fmi3String token, fmi3Boolean logging, fmi3InstanceEnvironment environment,
                       fmi3LogMessageCallback log) {
    const Store store = {calloc, free};
    const char *problem = "out of memory";
    Instance *in = NULL;
    if (name == NULL || name[0] == '\0') {
        problem = "the instance name is missing";
    } else if (token == NULL || strcmp(token, model.token) != 0) {
        problem = "the instantiation token is not the one this binary was built for";
    } else if (model.n_states > MOST_STATES || model.n_variables > MOST_VARIABLES) {
        problem = "the model is larger than the front end provides for";
    } else {
        in = create(sizeof(Component), store, name, logging);
    }
    if (in != NULL) {
        ((Component *)in)->environment = environment;
        ((Component *)in)->log = log;
    } else if (log != NULL) {
        log(environment, fmi3Error, category_name(LOG_ERROR), problem);
    }
    return (Component *)in;
}

FMI3_EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging,
                                                      fmi3InstanceEnvironment environment,
                                                      fmi3LogMessageCallback log) {
    (void)resources;
    (void)visible;
    return make(name, token, logging, environment, log);
}

FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging,
                                                     fmi3Boolean event_mode, fmi3Boolean early_return,
                                                     const fmi3ValueReference intermediate[], size_t n_intermediate,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                     fmi3IntermediateUpdateCallback update) {
    Component *component = make(name, token, logging, environment, log);
    (void)resources;
    (void)visible;
    (void)intermediate;
    (void)n_intermediate;
    (void)update;
    if (component != NULL) {
        component->co_simulation = 1;
        component->event_mode = event_mode;
        component->early_return = early_return;
    }
    return component;
}

FMI3_EXPORT void fmi3FreeInstance(fmi3Instance instance) {
    if (instance != NULL) {
        destroy((Instance *)instance);
    }
}

FMI3_EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n,
                                           const fmi3String categories[]) {
    Instance *in = admit(instance, ANY, "fmi3SetDebugLogging");
    return in == NULL ? fmi3Error : translate(choose_categories(in, on, n, categories, "fmi3SetDebugLogging"));
}

FMI3_EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined,
                                                   fmi3Float64 tolerance, fmi3Float64 start,
                                                   fmi3Boolean stop_defined, fmi3Float64 stop) {
    Instance *in = admit(instance, INSTANTIATED, "fmi3EnterInitializationMode");
    if (in == NULL) {
        return fmi3Error;
    }
    if ((tolerance_defined && !(tolerance > 0)) || !isfinite(start) || (stop_defined && !(stop >= start))) {
        return translate(fail(in, "fmi3EnterInitializationMode", "no experiment from t = %g to %g, tolerance %g",
                              start, stop_defined ? stop : HUGE_VAL, tolerance_defined ? tolerance : 0.0));
    }
    in->now.time = in->now.last = start;
    in->now.stop = stop_defined ? stop : HUGE_VAL;
    in->now.phase = INITIALIZATION;
    in->now.stale = 1;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    Instance *in = admit(instance, INITIALIZATION, "fmi3ExitInitializationMode");
    ModelStatus status = in == NULL ? MODEL_ERROR : refresh(in, "fmi3ExitInitializationMode");
    if (status == MODEL_DISCARD) { /* at the start there is no smaller step to try */
        status = fail(in, "fmi3ExitInitializationMode", "the model cannot be evaluated at its start values");
    }
    if (status == MODEL_OK) {
        const Component *component = (const Component *)in;
        in->now.phase = EVENT;
        if (component->co_simulation && !component->event_mode) {
            status = begin_steps(in, "fmi3ExitInitializationMode");
        }
    }
    return translate(status);
}

FMI3_EXPORT fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance) {
    Instance *in = admit(instance, INSTANTIATED, "fmi3EnterConfigurationMode");
    return in == NULL ? fmi3Error : translate(fail(in, "fmi3EnterConfigurationMode", "no structural parameters"));
}

FMI3_EXPORT fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance) {
    Instance *in = admit(instance, CONFIGURATION, "fmi3ExitConfigurationMode");
    return in == NULL ? fmi3Error : fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance instance) {
    Instance *in = admit(instance, RUNNING, "fmi3Terminate");
    if (in == NULL) {
        return fmi3Error;
    }
    in->now.phase = TERMINATED;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance instance) {
    Instance *in = admit(instance, ANY, "fmi3Reset");
    if (in == NULL) {
        return fmi3Error;
    }
    restart(in);
    return fmi3OK;
}

/* --------------------------------------------------------------------------------------------- variables */

/* Every variable is a single value. */
static ModelStatus same_length(Instance *in, size_t n, size_t n_values, const char *function) {
    return n == n_values ? MODEL_OK
                         : fail(in, function, "%lu values for %lu variables", (unsigned long)n_values, (unsigned long)n);
}

FMI3_EXPORT fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                      fmi3Float64 values[], size_t n_values) {
    Instance *in = admit(instance, READABLE, "fmi3GetFloat64");
    ModelStatus status = in == NULL ? MODEL_ERROR : same_length(in, n, n_values, "fmi3GetFloat64");
    size_t i;
    if (status == MODEL_OK && n > 0 && (references == NULL || values == NULL)) {
        status = fail(in, "fmi3GetFloat64", "NULL array for %lu values", (unsigned long)n);
    }
    for (i = 0; status == MODEL_OK && i < n; i++) {
        const size_t indicator = references[i] - model.n_variables;
        if (references[i] >= model.n_variables && indicator < model.n_indicators) {
            status = refresh(in, "fmi3GetFloat64");
            values[i] = real_at(in, model.indicators)[indicator];
        } else {
            status = prepare_get(in, &references[i], 1, values, MODEL_REAL, "fmi3GetFloat64");
            if (status == MODEL_OK) {
                values[i] = get_real(in, references[i]);
            }
        }
    }
    return translate(status);
}

FMI3_EXPORT fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                      const fmi3Float64 values[], size_t n_values) {
    Instance *in = admit(instance, INSTANTIATED | INITIALIZATION | RUNNING, "fmi3SetFloat64");
    ModelStatus status = in == NULL ? MODEL_ERROR : same_length(in, n, n_values, "fmi3SetFloat64");
    size_t i;
    if (status == MODEL_OK) {
        status = prepare_set(in, references, n, values, MODEL_REAL, "fmi3SetFloat64");
    }
    for (i = 0; status == MODEL_OK && i < n; i++) {
        *real_at(in, model.variables[references[i]].offset) = values[i];
    }
    return translate(status);
}

/* With an event mode, what is discrete is set there only. */
static Instance *admit_discrete(fmi3Instance instance, const char *function) {
    const Component *component = (const Component *)instance;
    const int step = component != NULL && !component->event_mode ? STEP : 0;
    return admit(instance, INSTANTIATED | INITIALIZATION | EVENT | step, function);
}

FMI3_EXPORT fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                    fmi3Int32 values[], size_t n_values) {
    Instance *in = admit(instance, READABLE, "fmi3GetInt32");
    ModelStatus status = in == NULL ? MODEL_ERROR : same_length(in, n, n_values, "fmi3GetInt32");
    size_t i;
    if (status == MODEL_OK) {
        status = prepare_get(in, references, n, values, MODEL_INTEGER, "fmi3GetInt32");
    }
    for (i = 0; status == MODEL_OK && i < n; i++) {
        values[i] = *integer_at(in, model.variables[references[i]].offset);
    }
    return translate(status);
}

FMI3_EXPORT fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                    const fmi3Int32 values[], size_t n_values) {
    Instance *in = admit_discrete(instance, "fmi3SetInt32");
    ModelStatus status = in == NULL ? MODEL_ERROR : same_length(in, n, n_values, "fmi3SetInt32");
    size_t i;
    if (status == MODEL_OK) {
        status = prepare_set(in, references, n, values, MODEL_INTEGER, "fmi3SetInt32");
    }
    for (i = 0; status == MODEL_OK && i < n; i++) {
        *integer_at(in, model.variables[references[i]].offset) = values[i];
    }
    return translate(status);
}

FMI3_EXPORT fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                      fmi3Boolean values[], size_t n_values) {
    Instance *in = admit(instance, READABLE, "fmi3GetBoolean");
    ModelStatus status = in == NULL ? MODEL_ERROR : same_length(in, n, n_values, "fmi3GetBoolean");
    size_t i;
    if (status == MODEL_OK) {
        status = prepare_get(in, references, n, values, MODEL_BOOLEAN, "fmi3GetBoolean");
    }
    for (i = 0; status == MODEL_OK && i < n; i++) {
        values[i] = *integer_at(in, model.variables[references[i]].offset) != 0;
    }
    return translate(status);
}

FMI3_EXPORT fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                      const fmi3Boolean values[], size_t n_values) {
    Instance *in = admit_discrete(instance, "fmi3SetBoolean");
    ModelStatus status = in == NULL ? MODEL_ERROR : same_length(in, n, n_values, "fmi3SetBoolean");
    size_t i;
    if (status == MODEL_OK) {
        status = prepare_set(in, references, n, values, MODEL_BOOLEAN, "fmi3SetBoolean");
    }
    for (i = 0; status == MODEL_OK && i < n; i++) {
        *integer_at(in, model.variables[references[i]].offset) = values[i];
    }
    return translate(status);
}

/* Types that no model has: only the empty request is answered. */
#define NONE_GET(type, c_type)                                                                                        \
    FMI3_EXPORT fmi3Status fmi3Get##type(fmi3Instance instance, const fmi3ValueReference references[], size_t n,      \
                                         c_type values[], size_t n_values) {                                          \
        Instance *in = admit(instance, READABLE, "fmi3Get" #type);                                                    \
        (void)references;                                                                                             \
        (void)values;                                                                                                 \
        (void)n_values;                                                                                               \
        if (in != NULL && n > 0) {                                                                                    \
            fail(in, "fmi3Get" #type, "the model has no variables of this type");                                     \
        }                                                                                                             \
        return in != NULL && n == 0 ? fmi3OK : fmi3Error;                                                             \
    }
#define NONE_SET(type, c_type)                                                                                        \
    FMI3_EXPORT fmi3Status fmi3Set##type(fmi3Instance instance, const fmi3ValueReference references[], size_t n,      \
                                         const c_type values[], size_t n_values) {                                    \
        Instance *in = admit(instance, ANY, "fmi3Set" #type);                                                         \
        (void)references;                                                                                             \
        (void)values;                                                                                                 \
        (void)n_values;                                                                                               \
        if (in != NULL && n > 0) {                                                                                    \
            fail(in, "fmi3Set" #type, "the model has no variables of this type");                                     \
        }                                                                                                             \
        return in != NULL && n == 0 ? fmi3OK : fmi3Error;                                                             \
    }
#define NONE(type, c_type) NONE_GET(type, c_type) NONE_SET(type, c_type)
NONE(Float32, float)
NONE(Int8, int8_t)
NONE(UInt8, uint8_t)
NONE(Int16, int16_t)
NONE(UInt16, uint16_t)
NONE(UInt32, uint32_t)
NONE(Int64, int64_t)
NONE(UInt64, uint64_t)
NONE(String, fmi3String)

FMI3_EXPORT fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                                    size_t n_unknowns, const fmi3ValueReference knowns[],
                                                    size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                                    fmi3Float64 sensitivity[], size_t n_sensitivity) {
    Instance *in = admit(instance, READABLE, "fmi3GetDirectionalDerivative");
    if (in == NULL) {
        return fmi3Error;
    }
    if (n_seed != n_knowns || n_sensitivity != n_unknowns ||
        (n_unknowns > 0 && (unknowns == NULL || sensitivity == NULL)) ||
        (n_knowns > 0 && (knowns == NULL || seed == NULL))) {
        return translate(fail(in, "fmi3GetDirectionalDerivative", "arrays that do not fit %lu unknowns and %lu knowns",
                              (unsigned long)n_unknowns, (unsigned long)n_knowns));
    }
    return translate(directional(in, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity,
                                 "fmi3GetDirectionalDerivative"));
}

/* ------------------------------------------------------------------------------------------ saved states */

FMI3_EXPORT fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state) {
    Instance *in = admit(instance, ANY, "fmi3GetFMUState");
    return in == NULL ? fmi3Error : translate(save(in, state, "fmi3GetFMUState"));
}

FMI3_EXPORT fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state) {
    Instance *in = admit(instance, ANY, "fmi3SetFMUState");
    return in == NULL ? fmi3Error : translate(bring_back(in, state, "fmi3SetFMUState"));
}

FMI3_EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state) {
    Instance *in = admit(instance, ANY, "fmi3FreeFMUState");
    return in == NULL ? fmi3Error : translate(forget(in, state, "fmi3FreeFMUState"));
}

FMI3_EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size) {
    Instance *in = admit(instance, ANY, "fmi3SerializedFMUStateSize");
    if (in == NULL || own_state(in, state, "fmi3SerializedFMUStateSize") == NULL) {
        return fmi3Error;
    }
    if (size == NULL) {
        return translate(fail(in, "fmi3SerializedFMUStateSize", "size is NULL"));
    }
    *size = SERIALISED_SIZE;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[],
                                             size_t size) {
    Instance *in = admit(instance, ANY, "fmi3SerializeFMUState");
    return in == NULL ? fmi3Error
                      : translate(serialise(in, state, (char *)bytes, size, "fmi3SerializeFMUState"));
}

FMI3_EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size,
                                               fmi3FMUState *state) {
    Instance *in = admit(instance, ANY, "fmi3DeserializeFMUState");
    return in == NULL ? fmi3Error
                      : translate(deserialise(in, (const char *)bytes, size, state, "fmi3DeserializeFMUState"));
}

/* -------------------------------------------------------------------------------------------- event mode */

FMI3_EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
    Instance *in = admit(instance, CONTINUOUS | STEP, "fmi3EnterEventMode");
    ModelStatus status;
    if (in == NULL) {
        return fmi3Error;
    }
    if (in->now.phase == STEP && !((const Component *)in)->event_mode) {
        return translate(fail(in, "fmi3EnterEventMode", "instantiated without event mode"));
    }
    status = commit(in, "fmi3EnterEventMode");
    if (status == MODEL_OK) {
        in->now.phase = EVENT;
        in->now.again = 0;
    }
    return translate(status);
}

FMI3_EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again, fmi3Boolean *terminate,
                                                fmi3Boolean *nominals_changed, fmi3Boolean *values_changed,
                                                fmi3Boolean *next_defined, fmi3Float64 *next) {
    Instance *in = admit(instance, EVENT, "fmi3UpdateDiscreteStates");
    ModelEvents events;
    ModelStatus status;
    if (in == NULL) {
        return fmi3Error;
    }
    if (again == NULL || terminate == NULL || nominals_changed == NULL || values_changed == NULL ||
        next_defined == NULL || next == NULL) {
        return translate(fail(in, "fmi3UpdateDiscreteStates", "NULL argument"));
    }
    status = update_once(in, &events, "fmi3UpdateDiscreteStates");
    in->now.again = events.again != 0;
    in->now.ended |= events.terminate != 0;
    in->now.next_event = events.next_event ? events.next_event_time : HUGE_VAL;
    *again = events.again != 0;
    *terminate = events.terminate != 0;
    *nominals_changed = false;
    *values_changed = events.states_changed != 0;
    *next_defined = events.next_event != 0;
    *next = events.next_event ? events.next_event_time : 0.0;
    return translate(status);
}

/* From event mode on, once the events have settled. */
static ModelStatus leave_event_mode(fmi3Instance instance, int co_simulation, int phase, const char *function) {
    Instance *in = admit(instance, EVENT, function);
    if (in == NULL) {
        return MODEL_ERROR;
    }
    if (((const Component *)in)->co_simulation != co_simulation) {
        return fail(in, function, "this instance is of the other kind");
    }
    if (in->now.again) {
        return fail(in, function, "the event iteration at t = %.17g is not over", in->now.time);
    }
    in->now.phase = phase;
    return MODEL_OK;
}

FMI3_EXPORT fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) {
    return translate(leave_event_mode(instance, 0, CONTINUOUS, "fmi3EnterContinuousTimeMode"));
}

FMI3_EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
    return translate(leave_event_mode(instance, 1, STEP, "fmi3EnterStepMode"));
}

/* ---------------------------------------------------------------------------------------- Model Exchange */

FMI3_EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean no_set_state_prior,
                                                   fmi3Boolean *enter_event_mode, fmi3Boolean *terminate) {
    Instance *in = admit(instance, CONTINUOUS, "fmi3CompletedIntegratorStep");
    (void)no_set_state_prior; /* nothing is buffered that could be flushed */
    if (in == NULL) {
        return fmi3Error;
    }
    if (enter_event_mode == NULL || terminate == NULL) {
        return translate(fail(in, "fmi3CompletedIntegratorStep", "NULL argument"));
    }
    *enter_event_mode = wants_event(in);
    *terminate = false;
    return translate(commit(in, "fmi3CompletedIntegratorStep"));
}

FMI3_EXPORT fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) {
    Instance *in = admit(instance, CONTINUOUS, "fmi3SetTime");
    return in == NULL ? fmi3Error : translate(move_time(in, time, "fmi3SetTime"));
}

FMI3_EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 states[], size_t n) {
    Instance *in = admit_array(instance, CONTINUOUS, states, n, model.n_states, "fmi3SetContinuousStates");
    if (in == NULL) {
        return fmi3Error;
    }
    move_states(in, states, n);
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[], size_t n) {
    Instance *in =
        admit_array(instance, READABLE, derivatives, n, model.n_states, "fmi3GetContinuousStateDerivatives");
    ModelStatus status = in == NULL ? MODEL_ERROR : refresh(in, "fmi3GetContinuousStateDerivatives");
    if (status == MODEL_OK) {
        read_array(in, derivatives, n, model.derivatives);
    }
    return translate(status);
}

FMI3_EXPORT fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 indicators[], size_t n) {
    Instance *in = admit_array(instance, READABLE, indicators, n, model.n_indicators, "fmi3GetEventIndicators");
    ModelStatus status = in == NULL ? MODEL_ERROR : refresh(in, "fmi3GetEventIndicators");
    if (status == MODEL_OK) {
        read_array(in, indicators, n, model.indicators);
    }
    return translate(status);
}

FMI3_EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 states[], size_t n) {
    Instance *in = admit_array(instance, READABLE, states, n, model.n_states, "fmi3GetContinuousStates");
    if (in == NULL) {
        return fmi3Error;
    }
    read_array(in, states, n, model.states);
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t n) {
    Instance *in = admit_array(instance, READABLE, nominals, n, model.n_states, "fmi3GetNominalsOfContinuousStates");
    size_t i;
    if (in == NULL) {
        return fmi3Error;
    }
    for (i = 0; i < n; i++) {
        nominals[i] = model.nominals != NULL ? model.nominals[i] : 1.0;
    }
    return fmi3OK;
}

static fmi3Status count(fmi3Instance instance, size_t n, size_t *out, const char *function) {
    Instance *in = admit(instance, ANY, function);
    if (in == NULL || out == NULL) {
        return fmi3Error;
    }
    *out = n;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *n) {
    return count(instance, model.n_states, n, "fmi3GetNumberOfContinuousStates");
}

FMI3_EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *n) {
    return count(instance, model.n_indicators, n, "fmi3GetNumberOfEventIndicators");
}

/* ----------------------------------------------------------------------------------------- Co-Simulation */

FMI3_EXPORT fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 size,
                                  fmi3Boolean no_set_state_prior, fmi3Boolean *event, fmi3Boolean *terminate,
                                  fmi3Boolean *early, fmi3Float64 *reached) {
    Instance *in = admit(instance, STEP, "fmi3DoStep");
    const Component *component = (const Component *)instance;
    ModelStatus status;
    Situation before;
    void *memory;
    (void)no_set_state_prior;
    if (in == NULL) {
        return fmi3Error;
    }
    if (event == NULL || terminate == NULL || early == NULL || reached == NULL) {
        return translate(fail(in, "fmi3DoStep", "NULL argument"));
    }
    before = in->now;
    memory = in->store.take(1, model.memory_size);
    if (memory == NULL) {
        return translate(fail(in, "fmi3DoStep", "out of memory"));
    }
    memcpy(memory, in->memory, model.memory_size);
    /* Without early return events inside of a step happen there; those at its end are left to event mode. */
    status = step_to(in, time, size, component->event_mode && component->early_return, "fmi3DoStep");
    if (status == MODEL_DISCARD) { /* nothing has happened then */
        memcpy(in->memory, memory, model.memory_size);
        in->now = before;
    }
    in->store.give_back(memory);
    *event = in->now.again != 0;
    *terminate = in->now.ended != 0;
    *early = in->now.time < time + size;
    *reached = in->now.time;
    in->now.again = 0;
    return translate(status);
}

/* ------------------------------------------------ functions that the standard demands and no model has a use for */

static fmi3Status not_offered(fmi3Instance instance, const char *function) {
    Instance *in = admit(instance, ANY, function);
    return in == NULL ? fmi3Error : translate(fail(in, function, "not offered by this FMU"));
}

#define UNUSED(name, ...)                                                                                             \
    FMI3_EXPORT fmi3Status name(fmi3Instance instance, __VA_ARGS__);                                                  \
    FMI3_EXPORT fmi3Status name(fmi3Instance instance, __VA_ARGS__)

#define VARIABLES const fmi3ValueReference references[], size_t n

FMI3_EXPORT fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                           fmi3Boolean visible, fmi3Boolean logging,
                                                           fmi3InstanceEnvironment environment,
                                                           fmi3LogMessageCallback log, const void *update,
                                                           const void *lock, const void *unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
    if (log != NULL) {
        log(environment, fmi3Error, category_name(LOG_ERROR), "this FMU offers no Scheduled Execution");
    }
    return NULL;
}

UNUSED(fmi3GetBinary, VARIABLES, size_t sizes[], fmi3Binary values[], size_t n_values) {
    (void)references, (void)sizes, (void)values, (void)n_values;
    return n == 0 ? fmi3OK : not_offered(instance, "fmi3GetBinary");
}

UNUSED(fmi3SetBinary, VARIABLES, const size_t sizes[], const fmi3Binary values[], size_t n_values) {
    (void)references, (void)sizes, (void)values, (void)n_values;
    return n == 0 ? fmi3OK : not_offered(instance, "fmi3SetBinary");
}

UNUSED(fmi3GetClock, VARIABLES, fmi3Clock values[]) {
    (void)references, (void)values;
    return n == 0 ? fmi3OK : not_offered(instance, "fmi3GetClock");
}

UNUSED(fmi3SetClock, VARIABLES, const fmi3Clock values[]) {
    (void)references, (void)values;
    return n == 0 ? fmi3OK : not_offered(instance, "fmi3SetClock");
}

UNUSED(fmi3GetNumberOfVariableDependencies, fmi3ValueReference reference, size_t *n) {
    (void)reference, (void)n;
    return not_offered(instance, "fmi3GetNumberOfVariableDependencies");
}

UNUSED(fmi3GetVariableDependencies, fmi3ValueReference dependent, size_t elements[], fmi3ValueReference independents[],
       size_t independent_elements[], int kinds[], size_t n) {
    (void)dependent, (void)elements, (void)independents, (void)independent_elements, (void)kinds, (void)n;
    return not_offered(instance, "fmi3GetVariableDependencies");
}

UNUSED(fmi3GetAdjointDerivative, const fmi3ValueReference unknowns[], size_t n_unknowns,
       const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
       fmi3Float64 sensitivity[], size_t n_sensitivity) {
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)n_seed, (void)sensitivity;
    (void)n_sensitivity;
    return not_offered(instance, "fmi3GetAdjointDerivative");
}

UNUSED(fmi3GetIntervalDecimal, VARIABLES, fmi3Float64 intervals[], int qualifiers[]) {
    (void)references, (void)n, (void)intervals, (void)qualifiers;
    return not_offered(instance, "fmi3GetIntervalDecimal");
}

UNUSED(fmi3GetIntervalFraction, VARIABLES, uint64_t counters[], uint64_t resolutions[], int qualifiers[]) {
    (void)references, (void)n, (void)counters, (void)resolutions, (void)qualifiers;
    return not_offered(instance, "fmi3GetIntervalFraction");
}

UNUSED(fmi3GetShiftDecimal, VARIABLES, fmi3Float64 shifts[]) {
    (void)references, (void)n, (void)shifts;
    return not_offered(instance, "fmi3GetShiftDecimal");
}

UNUSED(fmi3GetShiftFraction, VARIABLES, uint64_t counters[], uint64_t resolutions[]) {
    (void)references, (void)n, (void)counters, (void)resolutions;
    return not_offered(instance, "fmi3GetShiftFraction");
}

UNUSED(fmi3SetIntervalDecimal, VARIABLES, const fmi3Float64 intervals[]) {
    (void)references, (void)n, (void)intervals;
    return not_offered(instance, "fmi3SetIntervalDecimal");
}

UNUSED(fmi3SetIntervalFraction, VARIABLES, const uint64_t counters[], const uint64_t resolutions[]) {
    (void)references, (void)n, (void)counters, (void)resolutions;
    return not_offered(instance, "fmi3SetIntervalFraction");
}

UNUSED(fmi3SetShiftDecimal, VARIABLES, const fmi3Float64 shifts[]) {
    (void)references, (void)n, (void)shifts;
    return not_offered(instance, "fmi3SetShiftDecimal");
}

UNUSED(fmi3SetShiftFraction, VARIABLES, const uint64_t counters[], const uint64_t resolutions[]) {
    (void)references, (void)n, (void)counters, (void)resolutions;
    return not_offered(instance, "fmi3SetShiftFraction");
}

FMI3_EXPORT fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) {
    return not_offered(instance, "fmi3EvaluateDiscreteStates");
}

UNUSED(fmi3GetOutputDerivatives, VARIABLES, const int32_t orders[], fmi3Float64 values[], size_t n_values) {
    (void)references, (void)n, (void)orders, (void)values, (void)n_values;
    return not_offered(instance, "fmi3GetOutputDerivatives");
}

UNUSED(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time) {
    (void)clock, (void)time;
    return not_offered(instance, "fmi3ActivateModelPartition");
}
