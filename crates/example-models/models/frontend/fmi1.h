/* FMI 1.0 for C: the types and functions of the standard (Model Exchange 1.0, chapter 2; Co-Simulation 1.0, chapter
 * 3), written for this project from the text of the standard. Binary compatible with the standard's own headers, of
 * which nothing is copied. */
#ifndef FMI1_H
#define FMI1_H

#include <stddef.h>

#include "identifier.h" /* MODEL_IDENTIFIER */

#if defined(_WIN32) || defined(__CYGWIN__)
#define FMI1_EXPORT __declspec(dllexport)
#elif defined(__GNUC__) || defined(__clang__)
#define FMI1_EXPORT __attribute__((visibility("default")))
#else
#define FMI1_EXPORT
#endif

/* All names carry the model identifier as prefix. */
#define FMI1_PASTE(a, b) a##_##b
#define FMI1_PREFIX(a, b) FMI1_PASTE(a, b)
#define FMI1(name) FMI1_PREFIX(MODEL_IDENTIFIER, name)

typedef void *fmiComponent;
typedef unsigned int fmiValueReference;
typedef double fmiReal;
typedef int fmiInteger;
typedef char fmiBoolean;
typedef const char *fmiString;

enum { fmiFalse = 0, fmiTrue = 1 };

typedef enum { fmiOK, fmiWarning, fmiDiscard, fmiError, fmiFatal, fmiPending } fmiStatus;

typedef void (*fmiCallbackLogger)(fmiComponent component, fmiString instance_name, fmiStatus status,
                                  fmiString category, fmiString message, ...);
typedef void *(*fmiCallbackAllocateMemory)(size_t count, size_t size);
typedef void (*fmiCallbackFreeMemory)(void *block);
typedef void (*fmiStepFinished)(fmiComponent component, fmiStatus status);

/* Model Exchange passes the first three, Co-Simulation all four, both by value. */
typedef struct {
    fmiCallbackLogger logger;
    fmiCallbackAllocateMemory allocateMemory;
    fmiCallbackFreeMemory freeMemory;
#ifdef FMI1_CO_SIMULATION
    fmiStepFinished stepFinished;
#endif
} fmiCallbackFunctions;

typedef struct {
    fmiBoolean iterationConverged;
    fmiBoolean stateValueReferencesChanged;
    fmiBoolean stateValuesChanged;
    fmiBoolean terminateSimulation;
    fmiBoolean upcomingTimeEvent;
    fmiReal nextEventTime;
} fmiEventInfo;

typedef enum { fmiDoStepStatus, fmiPendingStatus, fmiLastSuccessfulTime } fmiStatusKind;

#endif
