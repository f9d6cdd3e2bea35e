/* Reading and setting variables; saving and restoring all of them. */
EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference *vr, size_t n, fmi2Real *value) {
    Model *m = c;
    size_t i;
#ifdef LATCHES
    m->is_spoiled |= m->is_set;
#endif
    for (i = 0; i < n; i++) {
#if defined STALE_OUTPUTS || defined OUTPUTS_OF_STEPS
        if (vr[i] == 3) {
#ifdef LATE_FROM
            value[i] = m->time <= LATE_FROM ? m->x : m->y;
#else
            value[i] = m->y;
#endif
            continue;
        }
#endif
#ifdef TRUSTS_REFERENCES
        static double table[7];
        if (vr[i] > 6) {
            value[i] = table[vr[i]];
            continue;
        }
#endif
        switch (vr[i]) {
        case 0: case 3: value[i] = m->x; break;
        case 1: value[i] = -K(m) * m->x; break;
        case 2: value[i] = K(m); break;
        case 4: value[i] = 2.5; break;
        case 5: value[i] = 2 * K(m); break;
        case 6: value[i] = m->time; break;
        default: return fmi2Error;
        }
#ifdef STATE_VALUE
        if (vr[i] == 0) value[i] = STATE_VALUE;
#endif
#ifdef NAN_OUTPUT
        if (vr[i] == 3) value[i] = NAN;
#endif
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference *vr, size_t n, const fmi2Real *value) {
    Model *m = c;
    size_t i;
    for (i = 0; i < n; i++) {
        switch (vr[i]) {
        case 0: m->x = value[i]; break;
        case 2:
            if (value[i] < 0) {
                say(m, fmi2Error, "#r2# must not be negative, #i0#");
                return fmi2Error;
            }
            K(m) = value[i];
            break;
#ifdef ONE_SET
        case 7:
#ifdef LATE_INPUTS
            if (!m->is_late) {
                say(m, fmi2Error, "inputs are set in initialization mode");
                return fmi2Error;
            }
#endif
            if (m->has_u) {
                say(m, fmi2Error, "the input is set twice at one instant");
                return fmi2Error;
            }
            m->u = value[i];
            m->has_u = 1;
            break;
#endif
#ifdef LATCHES
        case 7:
#ifdef REFUSES_EARLY_INPUTS
            if (!m->initialized) {
                m->broken = 1;
                return fmi2Error;
            }
#endif
            m->u = value[i];
            m->is_set = 1;
            m->is_spoiled = 0;
            break;
#endif
        default: return fmi2Error;
        }
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference *vr, size_t n, fmi2Integer *value) {
    (void)vr;
    while (n-- > 0) value[n] = ((Model *)c)->n;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference *vr, size_t n, const fmi2Integer *value) {
    (void)vr;
    while (n-- > 0) ((Model *)c)->n = value[n];
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference *vr, size_t n, fmi2Boolean *value) {
    (void)vr;
    while (n-- > 0) value[n] = ((Model *)c)->b;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference *vr, size_t n, const fmi2Boolean *value) {
    (void)vr;
    while (n-- > 0) ((Model *)c)->b = value[n];
    return fmi2OK;
}

#ifdef STATES
EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    Model *m = c;
#ifdef SAVE_FAILS
    say(m, fmi2Error, "nothing can be saved");
    return fmi2Error;
#endif
    if (*state == NULL) *state = m->functions.allocateMemory(1, sizeof *m);
    if (*state == NULL) return fmi2Error;
    memcpy(*state, m, sizeof *m);
    return fmi2OK;
}

/* Everything that was saved, parameters too. */
EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    Model *m = c;
#ifdef RESTORE_FAILS
    return fmi2Error;
#endif
#ifdef RESTORE_FORGETS
    {
        double k = m->k;
        memcpy(m, state, sizeof *m);
        m->x *= 1 + 1e-9 * k;
    }
#else
#ifdef REMEMBERS_IN_INSTANCE
    {
        double remembered = m->remembered;
        memcpy(m, state, sizeof *m);
        m->remembered = remembered;
    }
#else
    memcpy(m, state, sizeof *m);
#endif
#endif
    m->restored = 1;
    m->restored_k = m->k;
    return fmi2OK;
}

EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    ((Model *)c)->functions.freeMemory(*state);
    *state = NULL;
    return fmi2OK;
}
#endif
