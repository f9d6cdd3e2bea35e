/* The functions of FMI 3.0 (names from its chapters 2 to 5) that a fixture does not define itself: importers like FMPy want
 * a library to have all of them. They answer with an error. */
#define REST(name) __attribute__((weak, visibility("default"))) int name(void);  __attribute__((weak)) int name(void) { return 3; }

REST(fmi3ActivateModelPartition) REST(fmi3CompletedIntegratorStep) REST(fmi3DeserializeFMUState) REST(fmi3DoStep)
REST(fmi3EnterConfigurationMode) REST(fmi3EnterContinuousTimeMode) REST(fmi3EnterEventMode)
REST(fmi3EnterInitializationMode) REST(fmi3EnterStepMode) REST(fmi3EvaluateDiscreteStates)
REST(fmi3ExitConfigurationMode) REST(fmi3ExitInitializationMode) REST(fmi3FreeFMUState)
REST(fmi3GetAdjointDerivative) REST(fmi3GetBinary) REST(fmi3GetBoolean) REST(fmi3GetClock)
REST(fmi3GetContinuousStateDerivatives) REST(fmi3GetContinuousStates) REST(fmi3GetDirectionalDerivative)
REST(fmi3GetEventIndicators) REST(fmi3GetFMUState) REST(fmi3GetFloat32) REST(fmi3GetFloat64) REST(fmi3GetInt16)
REST(fmi3GetInt32) REST(fmi3GetInt64) REST(fmi3GetInt8) REST(fmi3GetIntervalDecimal) REST(fmi3GetIntervalFraction)
REST(fmi3GetNominalsOfContinuousStates) REST(fmi3GetNumberOfContinuousStates) REST(fmi3GetNumberOfEventIndicators)
REST(fmi3GetNumberOfVariableDependencies) REST(fmi3GetOutputDerivatives) REST(fmi3GetShiftDecimal)
REST(fmi3GetShiftFraction) REST(fmi3GetString) REST(fmi3GetUInt16) REST(fmi3GetUInt32) REST(fmi3GetUInt64)
REST(fmi3GetUInt8) REST(fmi3GetVariableDependencies) REST(fmi3InstantiateCoSimulation)
REST(fmi3InstantiateModelExchange) REST(fmi3InstantiateScheduledExecution) REST(fmi3Reset)
REST(fmi3SerializeFMUState) REST(fmi3SerializedFMUStateSize) REST(fmi3SetBinary) REST(fmi3SetBoolean)
REST(fmi3SetClock) REST(fmi3SetContinuousStates) REST(fmi3SetDebugLogging) REST(fmi3SetFMUState)
REST(fmi3SetFloat32) REST(fmi3SetFloat64) REST(fmi3SetInt16) REST(fmi3SetInt32) REST(fmi3SetInt64)
REST(fmi3SetInt8) REST(fmi3SetIntervalDecimal) REST(fmi3SetIntervalFraction) REST(fmi3SetShiftDecimal)
REST(fmi3SetShiftFraction) REST(fmi3SetString) REST(fmi3SetTime) REST(fmi3SetUInt16) REST(fmi3SetUInt32)
REST(fmi3SetUInt64) REST(fmi3SetUInt8) REST(fmi3Terminate) REST(fmi3UpdateDiscreteStates)
