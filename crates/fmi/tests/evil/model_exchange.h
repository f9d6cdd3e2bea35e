/* The functions of model exchange. */
EXPORT fmi2Status fmi2EnterEventMode(fmi2Component c) {
    (void)c;
#ifdef ONE_SET
    ((Model *)c)->has_u = 0; /* the next instant of super-dense time */
#endif
    return fmi2OK;
}

EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    (void)c;
    memset(info, 0, sizeof *info);
#ifdef ENDLESS_EVENTS
    info->newDiscreteStatesNeeded = fmi2True;
#endif
#ifdef LATE_FROM
    info->nextEventTimeDefined = ((Model *)c)->time < LATE_FROM;
    info->nextEventTime = LATE_FROM;
#endif
#ifdef PAST_EVENT
    info->nextEventTimeDefined = fmi2True;
    info->nextEventTime = -1;
#endif
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { (void)c; return fmi2OK; }

EXPORT fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set, fmi2Boolean *event,
                                              fmi2Boolean *terminate) {
    (void)c; (void)no_set;
#ifdef REPORTS_PRIOR
    ((Model *)c)->n = no_set;
#endif
    *event = fmi2False;
    *terminate = fmi2False;
#ifdef OUTPUTS_OF_STEPS
#ifdef RESTS_AT_FIRST
    if (((Model *)c)->time >= 0.5)
#endif
        ((Model *)c)->y = ((Model *)c)->x;
#endif
#ifdef ENDS_ITSELF
    *terminate = ((Model *)c)->time >= 0.25;
#endif
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
#ifdef ONE_SET
    if (time != ((Model *)c)->time) ((Model *)c)->has_u = 0;
#endif
    ((Model *)c)->time = time;
    upset(SET_TIME);
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real *x, size_t n) {
    if (n != 1) return fmi2Error;
    ((Model *)c)->x = x[0];
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real *x, size_t n) {
    if (n != 1) return fmi2Error;
    x[0] = ((Model *)c)->x;
    return fmi2OK;
}

#ifndef MISSING_SYMBOL
EXPORT fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real *dx, size_t n) {
    Model *m = c;
    if (n != 1) return fmi2Error;
#if defined(FAULT) && !defined(FAULT_AT_END)
    if (K(m) > FAULT_ABOVE && m->time > 0.2) FAULT;
#endif
    enter();
    REMEMBER(m);
    dx[0] = -K(m) * m->x + REMEMBERED(m);
#ifndef OUTPUTS_OF_STEPS
    m->y = m->x;
#endif
#ifdef FASTER
    dx[0] = -1.5 * m->x;
#endif
#ifdef USES_STRTOD
    dx[0] = -strtod("1.5", NULL) * m->x;
#endif
#ifdef SLOW
    usleep(SLOW);
#endif
    upset(DERIVATIVES);
    leave();
#ifdef ONE_SET
    dx[0] = m->u;
#endif
#ifdef CLASHES
    dx[0] = -atoi("3") * m->x;
#endif
#ifdef UNDEFINED_SYMBOL
    if (m->time > 1e9) dx[0] = not_there(m->x);
#endif
#ifdef LAST_ONLY
    dx[0] = -last->k * m->x;
#endif
#ifdef STATIC_SCRATCH
    {
        volatile int i;
        scratch = m->k;
        for (i = 0; i < 2000; i++) {}
        dx[0] = -scratch * m->x;
    }
#endif
#ifdef FLUSHES
    /* Denormal unless it is flushed. */
    {
        volatile double tiny = 1e-310;
        dx[0] = tiny * 1.0 > 0 ? -1.0 : -2.0;
    }
#endif
#ifdef DISCARD_BELOW
    if (m->x < 0.5) return fmi2Discard;
#endif
#ifdef ERROR_LATE
    if (m->time > 0.5) {
        say(m, fmi2Error, "broken beyond t = 0.5");
        return fmi2Error;
    }
#endif
#ifdef FATAL_LATE
    if (m->time > 0.5) {
        m->fatal = 1;
        return fmi2Fatal;
    }
#endif
#ifdef FAILING_ALWAYS
    return FAILING_ALWAYS;
#endif
#ifdef FAILING_LATE
    if (m->time > 0.5 && (ODD_RUN)) return FAILING_LATE;
#endif
#ifdef ODD_FACTOR
    if (ODD_RUN) dx[0] *= ODD_FACTOR;
#endif
#ifdef ERROR_ABOVE
    if (K(m) > ERROR_ABOVE) return fmi2Error;
#endif
#ifdef FATAL_ABOVE
    if (K(m) > FATAL_ABOVE) {
        m->fatal = 1;
        return fmi2Fatal;
    }
#endif
#ifdef NAN_LATE
    if (m->time > 0.5) dx[0] = NAN;
#endif
#ifdef ODD_STATUS
    if (m->time > 0.5) return (fmi2Status)77;
#endif
#ifdef LOG_FLOOD
    {
        int i;
        for (i = 0; i < 200; i++) {
            say(m, fmi2Warning, NULL);
            say(m, fmi2Warning, "100 % sure, %");
            say(m, fmi2Warning, "bad \xff\xfe bytes");
            m->functions.logger(m->functions.componentEnvironment, NULL, fmi2Warning, NULL, "x = %g of %s", m->x, (char *)NULL);
        }
    }
#endif
    return fmi2OK;
}
#endif

EXPORT fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real *z, size_t n) {
    (void)c; (void)z; (void)n;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real *x, size_t n) {
    (void)c;
    while (n-- > 0) {
#if defined(BAD_NOMINAL)
        x[n] = 0;
#elif defined(NOMINAL)
        x[n] = NOMINAL;
#else
        x[n] = 1;
#endif
    }
    return fmi2OK;
}
