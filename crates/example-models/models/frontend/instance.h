/* What the front ends share: one instance of the model, its state machine, its variables and its saved states, in
 * words of no particular version of FMI. Each front end includes this file once, defines `emit` and translates.
 *
 * Every function below that returns MODEL_ERROR (or NULL) has logged the reason and put the instance into the
 * error state. There are no global variables; memory is taken by `create` and for saved states only.
 */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "model.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* States of the state machine, as bits, so that a set of them is a number. */
enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    EVENT = 4,
    CONTINUOUS = 8,
    TERMINATED = 16,
    FAILED = 32,
    STEP = 64,           /* between communication points (Co-Simulation) */
    CONFIGURATION = 128, /* structural parameters are set (FMI 3.0) */
    ANY = 255,
    /* reading after the end or after an error is allowed, for debugging */
    READABLE = INITIALIZATION | EVENT | CONTINUOUS | TERMINATED | FAILED | STEP
};

/* What the front ends provide for. */
enum { MOST_STATES = 16, MOST_INDICATORS = 16, MOST_VARIABLES = 64 };

/* Log categories, as bits; the names stand in the model descriptions. */
enum { LOG_EVENTS = 1, LOG_DISCARD = 2, LOG_ERROR = 4, LOG_ALL = 7 };

/* Everything but the model's memory that a saved state has to bring back. */
typedef struct {
    double time;
    double last;      /* the last point the importer has committed itself to; time never goes back behind it */
    double stop;      /* stop time, or infinity */
    int32_t phase;    /* one of the states above */
    int32_t stale;    /* the calculated variables do not belong to the present point */
    int32_t again;    /* the event iteration is not over */
    int32_t ended;    /* the model has ended the simulation (Co-Simulation) */
    double next_event;             /* the next time event, or infinity (Co-Simulation) */
    double slopes[MOST_VARIABLES]; /* derivatives of the inputs, by value reference (Co-Simulation) */
} Situation;

/* A saved state. All of an instance's saved states hang in a list: so a foreign or freed one is recognised without
 * looking into it, and none outlives its instance. The memory follows behind the structure. */
typedef struct Saved {
    struct Saved *next;
    Situation now;
} Saved;

/* Where memory comes from: the importer's functions if it brings some, else calloc and free. */
typedef struct {
    void *(*take)(size_t count, size_t size);
    void (*give_back)(void *block);
} Store;

typedef struct {
    unsigned char *memory; /* the model's; behind the structure in the same block, as is the name */
    const char *name;
    Store store;
    Saved *saved;
    int logging_at_start; /* sets of log categories */
    int logging;
    Situation now;
} Instance;

/* Rounds a size up so that whatever is put behind it is aligned for any type. */
#define ALIGNED(size) (((size) + 15u) / 16u * 16u)

/* ------------------------------------------------------------------------------------------------ messages */

/* Hands one message to the importer; the front end's own. */
static void emit(const Instance *in, ModelStatus status, const char *category, const char *text);

static inline const char *category_name(int category) {
    return category == LOG_EVENTS ? "logEvents" : category == LOG_DISCARD ? "logStatusDiscard" : "logStatusError";
}

static inline void say(const Instance *in, int category, const char *function, const char *format, va_list arguments) {
    char text[512];
    const int written = snprintf(text, sizeof text, "%s: ", function);
    /* Errors and discarded steps are always told; the switch is for what happens in a healthy run. */
    if (category == LOG_EVENTS && !(in->logging & LOG_EVENTS)) {
        return;
    }
    if (written >= 0 && (size_t)written < sizeof text) {
        vsnprintf(text + written, sizeof text - (size_t)written, format, arguments);
    }
    emit(in, category == LOG_ERROR ? MODEL_ERROR : category == LOG_DISCARD ? MODEL_DISCARD : MODEL_OK,
         category_name(category), text);
}

static inline ModelStatus fail(Instance *in, const char *function, const char *format, ...) {
    va_list arguments;
    in->now.phase = FAILED;
    va_start(arguments, format);
    say(in, LOG_ERROR, function, format, arguments);
    va_end(arguments);
    return MODEL_ERROR;
}

static inline void tell(const Instance *in, int category, const char *function, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say(in, category, function, format, arguments);
    va_end(arguments);
}

static inline ModelStatus choose_categories(Instance *in, int on, size_t n, const char *const names[],
                                            const char *function) {
    int chosen = n == 0 ? LOG_ALL : 0, category;
    size_t i;
    if (n > 0 && names == NULL) {
        return fail(in, function, "NULL array for %lu categories", (unsigned long)n);
    }
    for (i = 0; i < n; i++) {
        for (category = 1; category < LOG_ALL; category *= 2) {
            if (names[i] != NULL && strcmp(names[i], category_name(category)) == 0) {
                break;
            }
        }
        if (category > LOG_ALL) {
            return fail(in, function, "unknown log category \"%s\"", names[i] != NULL ? names[i] : "(NULL)");
        }
        chosen |= category;
    }
    in->logging = on ? in->logging | chosen : in->logging & ~chosen;
    return MODEL_OK;
}

static inline const char *phase_name(int phase) {
    switch (phase) {
    case INSTANTIATED:
        return "instantiated";
    case INITIALIZATION:
        return "initialization mode";
    case EVENT:
        return "event mode";
    case CONTINUOUS:
        return "continuous-time mode";
    case STEP:
        return "step mode";
    case CONFIGURATION:
        return "configuration mode";
    case TERMINATED:
        return "terminated";
    default:
        return "error";
    }
}

/* The instance behind an importer's handle if the call is allowed in its state, else NULL. */
static inline Instance *admit(void *handle, int phases, const char *function) {
    Instance *in = (Instance *)handle;
    if (in != NULL && !(in->now.phase & phases)) {
        fail(in, function, "not allowed in state \"%s\"", phase_name(in->now.phase));
        return NULL;
    }
    return in;
}

/* The same for a call with an array that must have `expected` elements. */
static inline Instance *admit_array(void *handle, int phases, const void *array, size_t n, size_t expected,
                                    const char *function) {
    Instance *in = admit(handle, phases, function);
    if (in != NULL && n != expected) {
        fail(in, function, "an array of %lu values, the model has %lu", (unsigned long)n, (unsigned long)expected);
        return NULL;
    }
    if (in != NULL && n > 0 && array == NULL) {
        fail(in, function, "NULL array for %lu values", (unsigned long)n);
        return NULL;
    }
    return in;
}

/* ------------------------------------------------------------------------------------ creation and calculation */

static inline double *real_at(const Instance *in, size_t offset) {
    return (double *)(void *)(in->memory + offset);
}

static inline int32_t *integer_at(const Instance *in, size_t offset) {
    return (int32_t *)(void *)(in->memory + offset);
}

/* Back to the situation right after the instantiation. */
static inline void restart(Instance *in) {
    size_t i;
    memset(in->memory, 0, model.memory_size);
    for (i = 0; i < model.n_variables; i++) {
        const ModelVariable *variable = &model.variables[i];
        if (variable->role == MODEL_TIME || variable->role == MODEL_CALCULATED) {
            continue;
        }
        if (variable->type == MODEL_REAL) {
            *real_at(in, variable->offset) = variable->start;
        } else {
            *integer_at(in, variable->offset) = (int32_t)variable->start;
        }
    }
    memset(&in->now, 0, sizeof in->now);
    in->now.stop = HUGE_VAL;
    in->now.next_event = HUGE_VAL;
    in->now.phase = INSTANTIATED;
    in->now.stale = 1;
    in->logging = in->logging_at_start;
}

/* A new instance, or NULL if there is no memory. `size` is that of the front end's structure, whose first member is
 * the Instance. */
static inline Instance *create(size_t size, Store store, const char *name, int logging) {
    Instance *in = (Instance *)store.take(1, ALIGNED(size) + ALIGNED(model.memory_size) + strlen(name) + 1);
    if (in != NULL) {
        memset(in, 0, size);
        in->store = store;
        in->memory = (unsigned char *)in + ALIGNED(size);
        in->name = strcpy((char *)in->memory + ALIGNED(model.memory_size), name);
        in->logging_at_start = logging ? LOG_ALL : 0;
        restart(in);
    }
    return in;
}

static inline void destroy(Instance *in) {
    const Store store = in->store;
    while (in->saved != NULL) {
        Saved *next = in->saved->next;
        store.give_back(in->saved);
        in->saved = next;
    }
    store.give_back(in);
}

/* Tells what the model reported. */
static inline ModelStatus settle(Instance *in, ModelStatus status, const ModelProblem *problem, const char *function) {
    if (status == MODEL_DISCARD) {
        tell(in, LOG_DISCARD, function, "%s (t = %.17g)", problem->text, in->now.time);
    } else if (status != MODEL_OK) {
        fail(in, function, "%s (t = %.17g)", problem->text, in->now.time);
    }
    return status;
}

static inline ModelStatus recalculate(Instance *in, const char *function) {
    ModelProblem problem = {""};
    ModelStatus status = MODEL_OK;
    if (in->now.phase == INITIALIZATION && model.initialize != NULL) {
        status = model.initialize(in->memory, in->now.time, &problem);
    }
    if (status == MODEL_OK) {
        status = model.calculate(in->memory, in->now.time, &problem);
    }
    in->now.stale = status != MODEL_OK;
    return settle(in, status, &problem, function);
}

/* Brings the calculated variables up to date, if they are not. After an error they are left as they are. */
static inline ModelStatus refresh(Instance *in, const char *function) {
    return !in->now.stale || in->now.phase == FAILED ? MODEL_OK : recalculate(in, function);
}

/* ----------------------------------------------------------------------------------------------- variables */

static inline const char *type_name(ModelType type) {
    return type == MODEL_REAL ? "Real" : type == MODEL_INTEGER ? "Integer" : "Boolean";
}

/* The variable behind a value reference, or NULL if there is none of that type. */
static inline const ModelVariable *find(unsigned reference, ModelType type) {
    return reference < model.n_variables && model.variables[reference].type == type ? &model.variables[reference]
                                                                                    : NULL;
}

/* In which states a variable may be set. */
static inline int settable(ModelRole role) {
    switch (role) {
    case MODEL_INPUT:
        return INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEP;
    case MODEL_TUNABLE:
    case MODEL_DISCRETE_INPUT:
        return INSTANTIATED | INITIALIZATION | EVENT | STEP;
    case MODEL_FIXED:
    case MODEL_STATE:
    case MODEL_DISCRETE_STATE:
        return INSTANTIATED | INITIALIZATION;
    default:
        return 0;
    }
}

/* Common to all getters: the references are looked at and the variables brought up to date. */
static inline ModelStatus prepare_get(Instance *in, const unsigned references[], size_t n, const void *values,
                                      ModelType type, const char *function) {
    size_t i;
    int calculated = 0;
    if (n > 0 && (references == NULL || values == NULL)) {
        return fail(in, function, "NULL array for %lu values", (unsigned long)n);
    }
    for (i = 0; i < n; i++) {
        const ModelVariable *variable = find(references[i], type);
        if (variable == NULL) {
            return fail(in, function, "no %s variable has the value reference %u", type_name(type), references[i]);
        }
        calculated |= variable->role == MODEL_CALCULATED;
    }
    return calculated ? refresh(in, function) : MODEL_OK;
}

/* Common to all setters: nothing is written before everything has been looked at. */
static inline ModelStatus prepare_set(Instance *in, const unsigned references[], size_t n, const void *values,
                                      ModelType type, const char *function) {
    size_t i;
    if (n > 0 && (references == NULL || values == NULL)) {
        return fail(in, function, "NULL array for %lu values", (unsigned long)n);
    }
    for (i = 0; i < n; i++) {
        const ModelVariable *variable = find(references[i], type);
        if (variable == NULL) {
            return fail(in, function, "no %s variable has the value reference %u", type_name(type), references[i]);
        }
        if (!(settable(variable->role) & in->now.phase)) {
            return fail(in, function, "%s cannot be set in state \"%s\"", variable->name, phase_name(in->now.phase));
        }
    }
    in->now.stale |= n > 0;
    return MODEL_OK;
}

static inline double get_real(const Instance *in, unsigned reference) {
    const ModelVariable *variable = &model.variables[reference];
    return variable->role == MODEL_TIME ? in->now.time : *real_at(in, variable->offset);
}

/* Sensitivities of the unknowns along the seed of the knowns. The arrays themselves have been looked at. */
static inline ModelStatus directional(Instance *in, const unsigned unknowns[], size_t n_unknowns,
                                      const unsigned knowns[], size_t n_knowns, const double seed[],
                                      double sensitivity[], const char *function) {
    size_t i, k;
    if (model.partial == NULL) {
        return fail(in, function, "not offered by this FMU");
    }
    for (i = 0; i < n_unknowns; i++) {
        const ModelVariable *variable = find(unknowns[i], MODEL_REAL);
        if (variable == NULL || (variable->role != MODEL_CALCULATED && variable->role != MODEL_STATE)) {
            return fail(in, function, "value reference %u is not an unknown", unknowns[i]);
        }
    }
    for (k = 0; k < n_knowns; k++) {
        const ModelVariable *variable = find(knowns[k], MODEL_REAL);
        int phases = 0;
        if (variable != NULL && (variable->role == MODEL_STATE || variable->role == MODEL_INPUT)) {
            phases = READABLE;
        } else if (variable != NULL && (variable->role == MODEL_FIXED || variable->role == MODEL_TUNABLE)) {
            phases = INITIALIZATION;
        }
        if (!(phases & in->now.phase)) {
            return fail(in, function, "value reference %u is not a known in state \"%s\"", knowns[k],
                        phase_name(in->now.phase));
        }
    }
    if (refresh(in, function) != MODEL_OK) {
        return in->now.phase == FAILED ? MODEL_ERROR : MODEL_DISCARD;
    }
    for (i = 0; i < n_unknowns; i++) {
        const int state = model.variables[unknowns[i]].role == MODEL_STATE;
        sensitivity[i] = 0;
        for (k = 0; k < n_knowns; k++) {
            sensitivity[i] += seed[k] * (state ? (unknowns[i] == knowns[k] ? 1.0 : 0.0)
                                               : model.partial(in->memory, unknowns[i], knowns[k]));
        }
    }
    return MODEL_OK;
}

/* ----------------------------------------------------------------------------------- the point in time and space */

static inline ModelStatus move_time(Instance *in, double time, const char *function) {
    if (!(time >= in->now.last) || isinf(time)) {
        return fail(in, function, "t = %.17g lies before the last completed step at %.17g, or is no time", time,
                    in->now.last);
    }
    if (time != in->now.time) {
        in->now.time = time;
        in->now.stale = 1;
    }
    return MODEL_OK;
}

/* The importer has decided to go on from here. */
static inline ModelStatus commit(Instance *in, const char *function) {
    if (in->now.time > in->now.stop) {
        return fail(in, function, "t = %.17g is behind the stop time %.17g", in->now.time, in->now.stop);
    }
    in->now.last = in->now.time;
    return MODEL_OK;
}

/* Whether the model asks for an event at the end of a completed step. */
static inline int wants_event(const Instance *in) {
    return model.wants_event != NULL && model.wants_event(in->memory, in->now.time);
}

/* One round of the event iteration, and what it brought in the log. */
static inline ModelStatus update_once(Instance *in, ModelEvents *events, const char *function) {
    ModelStatus status = MODEL_OK;
    memset(events, 0, sizeof *events);
    if (model.update != NULL) {
        ModelProblem problem = {""};
        status = settle(in, model.update(in->memory, in->now.time, events, &problem), &problem, function);
        in->now.stale = 1;
    }
    if (status == MODEL_OK && (in->logging & LOG_EVENTS)) {
        tell(in, LOG_EVENTS, function, "t = %.17g%s%s%s", in->now.time, events->states_changed ? ", states changed" : "",
             events->again ? ", once more" : "", events->terminate ? ", the model ends the simulation" : "");
    }
    return status;
}

static inline void move_states(Instance *in, const double states[], size_t n) {
    /* Importers set the same point again before they ask for something else there: that costs no calculation. */
    if (n > 0 && memcmp(in->memory + model.states, states, n * sizeof(double)) != 0) {
        memcpy(in->memory + model.states, states, n * sizeof(double));
        in->now.stale = 1;
    }
}

static inline void read_array(const Instance *in, double values[], size_t n, size_t offset) {
    if (n > 0) {
        memcpy(values, in->memory + offset, n * sizeof(double));
    }
}

/* -------------------------------------------------------------------------------------------- saved states */

static inline unsigned char *saved_memory(Saved *saved) {
    return (unsigned char *)saved + ALIGNED(sizeof(Saved));
}

/* The saved state behind a token of this instance, or NULL. */
static inline Saved *own_state(Instance *in, const void *token, const char *function) {
    Saved *saved = in->saved;
    while (saved != NULL && (const void *)saved != token) {
        saved = saved->next;
    }
    if (saved == NULL) {
        fail(in, function, token == NULL ? "the state is NULL" : "the state was not saved by this instance");
    }
    return saved;
}

/* The place to save into: the one the importer brings along, or a new one. */
static inline Saved *place(Instance *in, void **token, const char *function) {
    Saved *saved;
    if (token == NULL) {
        fail(in, function, "state is NULL");
        return NULL;
    }
    if (*token != NULL) {
        return own_state(in, *token, function);
    }
    saved = (Saved *)in->store.take(1, ALIGNED(sizeof(Saved)) + model.memory_size);
    if (saved == NULL) {
        fail(in, function, "out of memory");
        return NULL;
    }
    saved->next = in->saved;
    in->saved = saved;
    *token = saved;
    return saved;
}

static inline ModelStatus save(Instance *in, void **token, const char *function) {
    Saved *saved = place(in, token, function);
    if (saved == NULL) {
        return MODEL_ERROR;
    }
    saved->now = in->now;
    memcpy(saved_memory(saved), in->memory, model.memory_size);
    return MODEL_OK;
}

static inline ModelStatus bring_back(Instance *in, const void *token, const char *function) {
    Saved *saved = own_state(in, token, function);
    if (saved == NULL) {
        return MODEL_ERROR;
    }
    in->now = saved->now;
    memcpy(in->memory, saved_memory(saved), model.memory_size);
    return MODEL_OK;
}

static inline ModelStatus forget(Instance *in, void **token, const char *function) {
    Saved *saved, **link;
    if (token == NULL || *token == NULL) {
        return MODEL_OK; /* the standard: such a call is ignored */
    }
    saved = own_state(in, *token, function);
    if (saved == NULL) {
        return MODEL_ERROR;
    }
    for (link = &in->saved; *link != saved; link = &(*link)->next) {
    }
    *link = saved->next;
    in->store.give_back(saved);
    *token = NULL;
    return MODEL_OK;
}

/* First bytes of a serialised state; then come the Situation and the memory. */
typedef struct {
    char magic[8];
    uint64_t origin;   /* of which model */
    uint64_t checksum; /* of everything that follows */
} Header;

#define SERIALISED_SIZE (sizeof(Header) + sizeof(Situation) + model.memory_size)

/* FNV-1a, 64 bits (Fowler, Noll, Vo 1991). */
static inline uint64_t hash(uint64_t start, const void *bytes, size_t n) {
    const unsigned char *byte = (const unsigned char *)bytes;
    while (n-- > 0) {
        start = (start ^ *byte++) * UINT64_C(1099511628211);
    }
    return start;
}

static inline Header header_for(const Situation *now, const unsigned char *memory) {
    const uint64_t start = UINT64_C(14695981039346656037);
    Header header;
    memcpy(header.magic, "state 01", sizeof header.magic);
    header.origin = hash(hash(start, model.identifier, strlen(model.identifier)), model.token, strlen(model.token));
    header.checksum = hash(hash(start, now, sizeof *now), memory, model.memory_size);
    return header;
}

static inline ModelStatus serialise(Instance *in, const void *token, char bytes[], size_t size, const char *function) {
    Saved *saved = own_state(in, token, function);
    Header header;
    if (saved == NULL) {
        return MODEL_ERROR;
    }
    if (bytes == NULL || size < SERIALISED_SIZE) {
        return fail(in, function, "room for %lu bytes, needed are %lu", bytes == NULL ? 0ul : (unsigned long)size,
                    (unsigned long)SERIALISED_SIZE);
    }
    header = header_for(&saved->now, saved_memory(saved));
    memcpy(bytes, &header, sizeof header);
    memcpy(bytes + sizeof header, &saved->now, sizeof saved->now);
    memcpy(bytes + sizeof header + sizeof saved->now, saved_memory(saved), model.memory_size);
    return MODEL_OK;
}

static inline ModelStatus deserialise(Instance *in, const char bytes[], size_t size, void **token,
                                      const char *function) {
    const unsigned char *memory;
    Header found, expected;
    Situation now;
    Saved *saved;
    if (bytes == NULL || size != SERIALISED_SIZE) {
        return fail(in, function, "%lu bytes, a saved state has %lu", bytes == NULL ? 0ul : (unsigned long)size,
                    (unsigned long)SERIALISED_SIZE);
    }
    memory = (const unsigned char *)bytes + sizeof found + sizeof now;
    memcpy(&found, bytes, sizeof found);
    memcpy(&now, bytes + sizeof found, sizeof now);
    expected = header_for(&now, memory);
    if (memcmp(&found, &expected, sizeof found) != 0) {
        return fail(in, function, "these bytes are not a saved state of %s, or were changed", model.identifier);
    }
    saved = place(in, token, function);
    if (saved == NULL) {
        return MODEL_ERROR;
    }
    saved->now = now;
    memcpy(saved_memory(saved), memory, model.memory_size);
    return MODEL_OK;
}

#endif
