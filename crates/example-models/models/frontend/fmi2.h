/* FMI 2.0 for C: the types and functions of the standard (FMI 2.0.4, sections 2.1, 3.2 and 4.2), written for this
 * project from the text of the standard. Binary compatible with the standard's own headers, of which nothing is
 * copied. */
#ifndef FMI2_H
#define FMI2_H

#include <stddef.h>

#if defined(_WIN32) || defined(__CYGWIN__)
#define FMI2_EXPORT __declspec(dllexport)
#elif defined(__GNUC__) || defined(__clang__)
#define FMI2_EXPORT __attribute__((visibility("default")))
#else
#define FMI2_EXPORT
#endif

/* Section 2.1.2: platform dependent types. */
#define fmi2TypesPlatform "default"
#define fmi2Version "2.0"
#define fmi2True 1
#define fmi2False 0

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef const fmi2Char *fmi2String;
typedef char fmi2Byte;

/* Section 2.1.3: status returned by functions. */
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;

/* Section 2.1.5: creation. */
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;

typedef void (*fmi2CallbackLogger)(fmi2ComponentEnvironment environment, fmi2String instance_name, fmi2Status status,
                                   fmi2String category, fmi2String message, ...);
typedef void *(*fmi2CallbackAllocateMemory)(size_t count, size_t size);
typedef void (*fmi2CallbackFreeMemory)(void *block);
typedef void (*fmi2StepFinished)(fmi2ComponentEnvironment environment, fmi2Status status);

typedef struct {
    fmi2CallbackLogger logger;
    fmi2CallbackAllocateMemory allocateMemory;
    fmi2CallbackFreeMemory freeMemory;
    fmi2StepFinished stepFinished;
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

/* Section 3.2.2: what an event did. */
typedef struct {
    fmi2Boolean newDiscreteStatesNeeded;
    fmi2Boolean terminateSimulation;
    fmi2Boolean nominalsOfContinuousStatesChanged;
    fmi2Boolean valuesOfContinuousStatesChanged;
    fmi2Boolean nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;

/* Section 4.2.3: what a slave may be asked about its last step. */
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;

/* Inquire version and platform, logging (2.1.4, 2.1.5). */
FMI2_EXPORT const char *fmi2GetTypesPlatform(void);
FMI2_EXPORT const char *fmi2GetVersion(void);
FMI2_EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t n_categories,
                                           const fmi2String categories[]);

/* Creation, initialisation, termination (2.1.5, 2.1.6). */
FMI2_EXPORT fmi2Component fmi2Instantiate(fmi2String instance_name, fmi2Type type, fmi2String guid,
                                          fmi2String resource_location, const fmi2CallbackFunctions *functions,
                                          fmi2Boolean visible, fmi2Boolean logging_on);
FMI2_EXPORT void fmi2FreeInstance(fmi2Component component);
FMI2_EXPORT fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                                           fmi2Real start_time, fmi2Boolean stop_time_defined, fmi2Real stop_time);
FMI2_EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component component);
FMI2_EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component component);
FMI2_EXPORT fmi2Status fmi2Terminate(fmi2Component component);
FMI2_EXPORT fmi2Status fmi2Reset(fmi2Component component);

/* Getting and setting variables (2.1.7). */
FMI2_EXPORT fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                   fmi2Real values[]);
FMI2_EXPORT fmi2Status fmi2GetInteger(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                      fmi2Integer values[]);
FMI2_EXPORT fmi2Status fmi2GetBoolean(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                      fmi2Boolean values[]);
FMI2_EXPORT fmi2Status fmi2GetString(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                     fmi2String values[]);
FMI2_EXPORT fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                   const fmi2Real values[]);
FMI2_EXPORT fmi2Status fmi2SetInteger(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                      const fmi2Integer values[]);
FMI2_EXPORT fmi2Status fmi2SetBoolean(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                      const fmi2Boolean values[]);
FMI2_EXPORT fmi2Status fmi2SetString(fmi2Component component, const fmi2ValueReference references[], size_t n,
                                     const fmi2String values[]);

/* Getting and setting the complete state (2.1.8). */
FMI2_EXPORT fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state);
FMI2_EXPORT fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state);
FMI2_EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state);
FMI2_EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *size);
FMI2_EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[],
                                             size_t size);
FMI2_EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size,
                                               fmi2FMUstate *state);

/* Partial derivatives (2.1.9). */
FMI2_EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknowns[],
                                                    size_t n_unknowns, const fmi2ValueReference knowns[],
                                                    size_t n_knowns, const fmi2Real seed[], fmi2Real sensitivity[]);

/* Model Exchange (3.2.1, 3.2.2). */
FMI2_EXPORT fmi2Status fmi2EnterEventMode(fmi2Component component);
FMI2_EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component component, fmi2EventInfo *info);
FMI2_EXPORT fmi2Status fmi2EnterContinuousTimeMode(fmi2Component component);
FMI2_EXPORT fmi2Status fmi2CompletedIntegratorStep(fmi2Component component, fmi2Boolean no_set_state_prior,
                                                   fmi2Boolean *enter_event_mode, fmi2Boolean *terminate_simulation);
FMI2_EXPORT fmi2Status fmi2SetTime(fmi2Component component, fmi2Real time);
FMI2_EXPORT fmi2Status fmi2SetContinuousStates(fmi2Component component, const fmi2Real states[], size_t n);
FMI2_EXPORT fmi2Status fmi2GetDerivatives(fmi2Component component, fmi2Real derivatives[], size_t n);
FMI2_EXPORT fmi2Status fmi2GetEventIndicators(fmi2Component component, fmi2Real indicators[], size_t n);
FMI2_EXPORT fmi2Status fmi2GetContinuousStates(fmi2Component component, fmi2Real states[], size_t n);
FMI2_EXPORT fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component component, fmi2Real nominals[], size_t n);

/* Co-Simulation (4.2.1 to 4.2.3). */
FMI2_EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference references[],
                                                   size_t n, const fmi2Integer orders[], const fmi2Real values[]);
FMI2_EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference references[],
                                                    size_t n, const fmi2Integer orders[], fmi2Real values[]);
FMI2_EXPORT fmi2Status fmi2DoStep(fmi2Component component, fmi2Real current_time, fmi2Real step_size,
                                  fmi2Boolean no_set_state_prior);
FMI2_EXPORT fmi2Status fmi2CancelStep(fmi2Component component);
FMI2_EXPORT fmi2Status fmi2GetStatus(fmi2Component component, fmi2StatusKind kind, fmi2Status *value);
FMI2_EXPORT fmi2Status fmi2GetRealStatus(fmi2Component component, fmi2StatusKind kind, fmi2Real *value);
FMI2_EXPORT fmi2Status fmi2GetIntegerStatus(fmi2Component component, fmi2StatusKind kind, fmi2Integer *value);
FMI2_EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component component, fmi2StatusKind kind, fmi2Boolean *value);
FMI2_EXPORT fmi2Status fmi2GetStringStatus(fmi2Component component, fmi2StatusKind kind, fmi2String *value);

#endif
