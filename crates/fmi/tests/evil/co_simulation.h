/* The functions of co-simulation, which has the exact solution. */
static void solve(Model *m, double h) {
#ifdef LATCHES
    /* Without fresh inputs, or when values were read since they were set, nothing is integrated. */
    if (m->is_set && !m->is_spoiled) m->x += m->u * h;
#ifdef EXTRAPOLATES
    /* An input that was another one before the initialization goes back. */
    if (m->known != m->u) m->x -= 2 * m->u * h;
#endif
    m->is_set = m->is_spoiled = 0;
    m->time += h;
    return;
#endif
#ifdef ONE_EULER_STEP
    m->x *= 1 - K(m) * h;
#else
    m->x *= exp(-K(m) * h);
#endif
    m->time += h;
}

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set) {
    Model *m = c;
    (void)no_set;
#ifdef STEPS_FILE
    /* One byte for each step, which takes its time. */
    {
        FILE *file = fopen(STEPS_FILE, "a");
        if (file == NULL || fputc('.', file) == EOF) return fmi2Error;
        fclose(file);
        usleep(1000);
    }
#endif
#ifdef REPORTS_PRIOR
    m->n = no_set;
#endif
#ifdef ONE_LENGTH
    if (m->polls == 0) m->k = step;
    /* The last step ends at the stop time. */
    if (step != m->k && fabs(step - m->k) < 1e-9 && time < ONE_LENGTH) {
        say(m, fmi2Error, "a step of nearly the same length");
        return fmi2Error;
    }
    m->polls = -1;
    m->time = time + step;
    return fmi2OK;
#endif
    if (fabs(time - m->time) > 1e-12) {
        say(m, fmi2Error, "the step begins elsewhere");
        return fmi2Error;
    }
#ifdef STRICT_STOP
    /* Its own time is a sum of steps. */
    if (m->has_stop && m->time + step > m->stop) {
        say(m, fmi2Error, "a step beyond the stop time");
        return STRICT_STOP;
    }
#endif
#ifdef FAILS_BEYOND
    if (time + step > FAILS_BEYOND) return fmi2Error;
#endif
#ifdef PARTIAL_STEPS
    if (step > 0.0301) {
        solve(m, 0.03);
        return fmi2Discard;
    }
#endif
#ifdef REFUSES_LONG_STEPS
    if (step > 0.0301) return fmi2Discard;
#endif
#ifdef REFUSES_ALL_STEPS
    return fmi2Discard;
#endif
#ifdef ENDS_ITSELF
    if (time + step >= 0.25) {
        solve(m, 0.25 - time);
        return fmi2Discard;
    }
#endif
#ifdef STEP_ERROR
    if (time > 0.5) {
        say(m, fmi2Error, "no step beyond t = 0.5");
        return fmi2Error;
    }
#endif
#if defined(PENDING) || defined(STUCK)
    m->polls = 3;
#endif
    solve(m, step);
    upset(STEP);
    return m->polls > 0 ? fmi2Pending : fmi2OK;
}

EXPORT fmi2Status fmi2GetStatus(fmi2Component c, fmi2StatusKind kind, fmi2Status *value) {
    Model *m = c;
    if (kind != fmi2DoStepStatus) return fmi2Discard;
#ifndef STUCK
    m->polls--;
#endif
    *value = m->polls > 0 ? fmi2Pending : fmi2OK;
    return fmi2OK;
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component c) {
    ((Model *)c)->polls = 0;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Model *)c)->time;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, fmi2StatusKind kind, fmi2Boolean *value) {
    (void)c;
    if (kind != fmi2Terminated) return fmi2Discard;
#ifdef ENDS_ITSELF
    *value = fmi2True;
#else
    *value = fmi2False;
#endif
    return fmi2OK;
}
