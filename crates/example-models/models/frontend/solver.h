/* The solver of the Co-Simulation front ends: the classical Runge-Kutta method with small equal steps, events located
 * by bisection. Simple and always the same, so that results can be compared bit by bit; no model of its own kind of
 * accuracy is wanted here.
 *
 * Included once, by a front end, in place of instance.h. */
#ifndef SOLVER_H
#define SOLVER_H

#include "instance.h"

/* Longest internal step, in seconds. */
#define LONGEST_STEP 1e-3

/* What the end of an internal step brought. */
typedef struct {
    double states[MOST_STATES];
    double indicators[MOST_INDICATORS];
} Point;

static inline double *states_of(const Instance *in) {
    return real_at(in, model.states);
}

/* Puts the model to a point: time, states, and the inputs along their slopes from `origin`. */
static inline ModelStatus evaluate(Instance *in, double origin, double time, const double states[],
                                   const double inputs[], const char *function) {
    size_t i;
    in->now.time = time;
    if (model.n_states > 0) {
        memcpy(in->memory + model.states, states, model.n_states * sizeof(double));
    }
    for (i = 0; i < model.n_variables; i++) {
        if (in->now.slopes[i] != 0) {
            *real_at(in, model.variables[i].offset) = inputs[i] + in->now.slopes[i] * (time - origin);
        }
    }
    return recalculate(in, function);
}

/* One Runge-Kutta step of size h from (t, x); the model stands at its end afterwards. */
static inline ModelStatus runge_kutta(Instance *in, double origin, const double inputs[], double t, const double x[],
                                      double h, Point *end, const char *function) {
    static const double place[4] = {0, 0.5, 0.5, 1}, weight[4] = {1, 2, 2, 1};
    double slope[MOST_STATES] = {0}, sum[MOST_STATES] = {0}, stage[MOST_STATES];
    ModelStatus status;
    size_t i;
    int k;
    for (k = 0; k < 4 && model.n_states > 0; k++) {
        for (i = 0; i < model.n_states; i++) {
            stage[i] = x[i] + place[k] * h * slope[i];
        }
        status = evaluate(in, origin, t + place[k] * h, stage, inputs, function);
        if (status != MODEL_OK) {
            return status;
        }
        read_array(in, slope, model.n_states, model.derivatives);
        for (i = 0; i < model.n_states; i++) {
            sum[i] += weight[k] * slope[i];
        }
    }
    for (i = 0; i < model.n_states; i++) {
        end->states[i] = x[i] + h / 6 * sum[i];
    }
    status = evaluate(in, origin, t + h, end->states, inputs, function);
    if (status == MODEL_OK) {
        read_array(in, end->indicators, model.n_indicators, model.indicators);
    }
    return status;
}

static inline int crossed(const double before[], const double after[]) {
    size_t i;
    for (i = 0; i < model.n_indicators; i++) {
        if ((before[i] > 0) != (after[i] > 0)) {
            return 1;
        }
    }
    return 0;
}

/* Lets the events of the present point happen. */
static inline ModelStatus happen(Instance *in, const char *function) {
    int rounds;
    for (rounds = 0; rounds < 100; rounds++) {
        ModelEvents events;
        const ModelStatus status = update_once(in, &events, function);
        if (status != MODEL_OK) {
            return status;
        }
        in->now.next_event = events.next_event ? events.next_event_time : HUGE_VAL;
        in->now.ended |= events.terminate != 0;
        if (events.terminate || !(events.again || in->now.next_event <= in->now.time)) {
            return recalculate(in, function);
        }
    }
    return fail(in, function, "the events at t = %.17g do not end", in->now.time);
}

/* The initialisation is over: the initial events, then steps. */
static inline ModelStatus begin_steps(Instance *in, const char *function) {
    in->now.phase = STEP;
    return happen(in, function);
}

/* Goes on to `end`, or to the first event if `stop_at_events` (which has not happened then; *at_event says so), or to
 * where the model ends the simulation. */
static inline ModelStatus go_on(Instance *in, double end, int stop_at_events, int *at_event, const char *function) {
    const double origin = in->now.time;
    double inputs[MOST_VARIABLES] = {0}, indicators[MOST_INDICATORS];
    size_t i;
    *at_event = 0;
    for (i = 0; i < model.n_variables; i++) {
        inputs[i] = in->now.slopes[i] != 0 ? *real_at(in, model.variables[i].offset) : 0;
    }
    while (in->now.time < end && !in->now.ended) {
        const double t = in->now.time, target = in->now.next_event < end ? in->now.next_event : end;
        const double n = ceil((target - t) / LONGEST_STEP * (1 - 1e-12));
        double x[MOST_STATES], low = 0, h = n > 1 ? (target - t) / n : target - t;
        int event;
        Point next;
        ModelStatus status = refresh(in, function);
        if (status != MODEL_OK) {
            return status;
        }
        if (model.n_states > 0) {
            memcpy(x, in->memory + model.states, sizeof x[0] * model.n_states);
        }
        read_array(in, indicators, model.n_indicators, model.indicators);
        status = runge_kutta(in, origin, inputs, t, x, h, &next, function);
        event = status == MODEL_OK && crossed(indicators, next.indicators);
        /* the right end of the bracket: there the event has happened */
        while (status == MODEL_OK && event && h - low > 1e-15 * (1 + fabs(t))) {
            const double middle = 0.5 * (low + h);
            status = runge_kutta(in, origin, inputs, t, x, middle, &next, function);
            if (status == MODEL_OK && crossed(indicators, next.indicators)) {
                h = middle;
            } else {
                low = middle;
            }
            if (middle == low && !(0.5 * (low + h) > low && 0.5 * (low + h) < h)) {
                break;
            }
        }
        if (event && status == MODEL_OK) {
            status = runge_kutta(in, origin, inputs, t, x, h, &next, function);
        }
        if (status != MODEL_OK) {
            return status;
        }
        if (!event && n <= 1) {
            in->now.time = target; /* not a rounding error beside it */
            in->now.stale = 1;
        }
        if (event || in->now.time >= in->now.next_event || wants_event(in)) {
            *at_event = stop_at_events;
            if (stop_at_events) {
                break;
            }
            status = happen(in, function);
            if (status != MODEL_OK) {
                return status;
            }
        }
    }
    return refresh(in, function);
}

/* One communication step. */
static inline ModelStatus step_to(Instance *in, double time, double size, int stop_at_events, const char *function) {
    int at_event = 0;
    ModelStatus status;
    if (fabs(time - in->now.time) > 1e-9 * (1 + fabs(time))) {
        return fail(in, function, "the step begins at %.17g, the last one ended at %.17g", time, in->now.time);
    }
    if (!(size > 0) || isinf(size)) {
        return fail(in, function, "a step of %.17g", size);
    }
#ifdef FIXED_STEP
    if (size != FIXED_STEP) {
        return fail(in, function, "a step of %.17g, not of %.17g", size, (double)FIXED_STEP);
    }
#endif
    if (time + size > in->now.stop) {
        return fail(in, function, "the step ends at %.17g, behind the stop time %.17g", time + size, in->now.stop);
    }
    if (in->now.ended) {
        return fail(in, function, "the model has ended the simulation at %.17g", in->now.time);
    }
    in->now.time = time;
    in->now.stale = 1; /* inputs and tunable parameters may have been set */
    status = go_on(in, time + size, stop_at_events, &at_event, function);
    in->now.again = at_event;
    memset(in->now.slopes, 0, sizeof in->now.slopes);
    in->now.last = in->now.time;
    return status;
}

/* Derivatives of inputs, for the next step only. */
static inline ModelStatus set_slopes(Instance *in, const unsigned references[], size_t n, const int orders[],
                                     const double values[], const char *function) {
    size_t i;
    if (n > 0 && (references == NULL || orders == NULL || values == NULL)) {
        return fail(in, function, "NULL array for %lu values", (unsigned long)n);
    }
    for (i = 0; i < n; i++) {
        const ModelVariable *variable = find(references[i], MODEL_REAL);
        if (variable == NULL || variable->role != MODEL_INPUT) {
            return fail(in, function, "value reference %u is not a continuous input", references[i]);
        }
        if (orders[i] != 1) {
            return fail(in, function, "a derivative of order %d", orders[i]);
        }
        in->now.slopes[references[i]] = values[i];
    }
    return MODEL_OK;
}

#endif
