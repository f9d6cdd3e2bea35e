/* The door between one model source and an FMI front end.
 *
 * A model source (model.c) describes its variables in a table and offers a few plain functions; a front end
 * (fmi2_me.c, ...) turns these into the functions of one version of the FMI standard. Neither knows the other's
 * side: no FMI name appears in a model source, no model name in a front end.
 *
 * A model's whole situation lives in one plain structure of its own, its "memory": doubles and int32_t, no
 * pointers. So it can be copied, saved and restored byte by byte, and any number of instances can live side by
 * side. A model source allocates nothing, keeps no global variables and prints nothing.
 */
#ifndef MODEL_H
#define MODEL_H

#include <stddef.h>
#include <stdint.h>

/* Keeps the model's own symbols out of the shared library's table, so that two FMUs in one process never meet. */
#if defined(__GNUC__) || defined(__clang__)
#define MODEL_LOCAL __attribute__((visibility("hidden")))
#else
#define MODEL_LOCAL
#endif

typedef enum {
    MODEL_REAL,    /* a double in the memory */
    MODEL_INTEGER, /* an int32_t */
    MODEL_BOOLEAN  /* an int32_t, 0 or 1 */
} ModelType;

/* What a variable is for; it decides when it may be set and whether reading it needs a calculation first. */
typedef enum {
    MODEL_TIME,           /* the independent variable; kept by the front end, has no place in the memory */
    MODEL_FIXED,          /* parameter, settable until the end of the initialisation */
    MODEL_TUNABLE,        /* parameter, settable at events too */
    MODEL_INPUT,          /* continuous input, settable at any time */
    MODEL_DISCRETE_INPUT, /* input that changes at events only */
    MODEL_STATE,          /* continuous state; its start value is settable until the end of the initialisation */
    MODEL_DISCRETE_STATE, /* the same for a discrete variable that has a start value */
    MODEL_CALCULATED      /* result of initialize, calculate or update; never settable */
} ModelRole;

/* One variable. Its place in the table is its value reference, unique over all types (FMI 3.0 asks for that). */
typedef struct {
    const char *name;
    ModelType type;
    ModelRole role;
    size_t offset; /* in the memory, in bytes */
    double start;  /* start value (an integer or Boolean as a double); 0 where the role has none */
} ModelVariable;

typedef enum {
    MODEL_OK,
    MODEL_DISCARD, /* cannot be evaluated here; a smaller step may help */
    MODEL_ERROR    /* the run cannot go on */
} ModelStatus;

/* Where a model says why it returned something else than MODEL_OK: one sentence with the numbers in it. */
typedef struct {
    char text[256];
} ModelProblem;

/* What an event did. All zero means: nothing happened, no time event is planned. */
typedef struct {
    int again;           /* the event iteration is not over: update must be called once more */
    int terminate;       /* the model wants to end the simulation */
    int states_changed;  /* update wrote to the continuous states */
    int next_event;      /* next_event_time is valid */
    double next_event_time;
} ModelEvents;

typedef struct {
    const char *identifier; /* model identifier, a C name; also the name of the binary */
    const char *token;      /* what the model description carries as guid (3.0: instantiation token) */

    const ModelVariable *variables;
    size_t n_variables;

    size_t memory_size;
    size_t states;      /* offsets of the arrays of n_states doubles ... */
    size_t derivatives; /* ... in the same order as ModelStructure/Derivatives */
    size_t indicators;  /* offset of the array of n_indicators doubles */
    size_t n_states;
    size_t n_indicators;
    const double *nominals; /* n_states values, or NULL: all 1 */

    /* Checks parameters and start values and settles everything discrete from them. May be called again whenever
     * one of them was set anew during the initialisation. Optional. */
    ModelStatus (*initialize)(void *memory, double time, ModelProblem *problem);

    /* Derivatives, event indicators and calculated variables from time, states, inputs, parameters and the
     * discrete variables, none of which it changes. */
    ModelStatus (*calculate)(void *memory, double time, ModelProblem *problem);

    /* One round of the event iteration. `events` comes in all zero. Optional: a model without events. */
    ModelStatus (*update)(void *memory, double time, ModelEvents *events, ModelProblem *problem);

    /* At the end of a completed step of whoever integrates: whether the model asks for an event there (a step event),
     * which lets `update` be called. Optional. */
    int (*wants_event)(const void *memory, double time);

    /* Partial derivative of a calculated Real variable (value reference `unknown`) with respect to a state, input
     * or parameter (`known`) after a calculate at this point. Optional. */
    double (*partial)(const void *memory, unsigned unknown, unsigned known);
} ModelDefinition;

/* The one thing a model source defines. */
extern MODEL_LOCAL const ModelDefinition model;

#endif
