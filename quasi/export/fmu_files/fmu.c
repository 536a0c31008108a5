/* FMI 2.0 functions of an FMU: model exchange and co-simulation. What it does stands in its other files. */

static const double START[VALUES] = START_VALUES;

static fmi2Status say(Instance *fmu, fmi2Status status, const char *message)
{
    if (fmu->functions.logger != NULL) {
        fmu->functions.logger(
            fmu->functions.componentEnvironment, fmu->name, status, status == fmi2OK ? "logAll" : "logStatusError",
            "%s", message);
    }
    return status;
}

#include BEHAVIOUR

SEEN const char *FMI(fmi2GetTypesPlatform)(void)
{
    return "default";
}

SEEN const char *FMI(fmi2GetVersion)(void)
{
    return "2.0";
}

SEEN fmi2Status FMI(fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c;
    (void)on;
    (void)n;
    (void)categories;
    return fmi2OK;
}

static void restart(Instance *fmu)
{
    memset(&fmu->data, 0, sizeof fmu->data);
    memcpy(fmu->data.value, START, sizeof START);
    fmu->data.stale = 1;
}

SEEN fmi2Component FMI(fmi2Instantiate)(
    fmi2String name, fmi2Type type, fmi2String guid, fmi2String location, const fmi2CallbackFunctions *functions,
    fmi2Boolean visible, fmi2Boolean logging)
{
    Instance *fmu = calloc(1, sizeof(Instance));
    (void)location;
    (void)visible;
    (void)logging;
    if (fmu == NULL) {
        return NULL;
    }
    if (functions != NULL) {
        fmu->functions = *functions;
    }
    strncpy(fmu->name, name != NULL ? name : "", sizeof fmu->name - 1);
    fmu->co_simulation = type == fmi2CoSimulation;
    if (guid == NULL || strcmp(guid, GUID) != 0) {
        say(fmu, fmi2Error, "the guid of modelDescription.xml is not that of this binary; take both from one FMU");
        free(fmu);
        return NULL;
    }
    restart(fmu);
    return fmu;
}

SEEN void FMI(fmi2FreeInstance)(fmi2Component c)
{
    free(c);
}

SEEN fmi2Status FMI(fmi2SetupExperiment)(
    fmi2Component c, fmi2Boolean tolerance_given, fmi2Real tolerance, fmi2Real start, fmi2Boolean stop_given,
    fmi2Real stop)
{
    (void)tolerance_given;
    (void)tolerance;
    (void)stop_given;
    (void)stop;
    ((Instance *)c)->data.time = start;
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2EnterInitializationMode)(fmi2Component c)
{
    ((Instance *)c)->data.stale = 1;
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2ExitInitializationMode)(fmi2Component c)
{
    Instance *fmu = c;
    const fmi2Status status = begin(fmu);
    fmu->data.stale = 1;
    fmu->data.begun = status == fmi2OK;
    return status;
}

SEEN fmi2Status FMI(fmi2Terminate)(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2Reset)(fmi2Component c)
{
    restart(c);
    return fmi2OK;
}

static void refresh(Instance *fmu)
{
    if (fmu->data.stale) {
        calculate(fmu);
        fmu->data.stale = 0;
    }
}

SEEN fmi2Status FMI(fmi2GetReal)(fmi2Component c, const fmi2ValueReference at[], size_t n, fmi2Real value[])
{
    Instance *fmu = c;
    size_t k;
    refresh(fmu);
    for (k = 0; k < n; k++) {
        if (at[k] >= VALUES) {
            return say(fmu, fmi2Error, "fmi2GetReal: there is no variable of this value reference");
        }
        value[k] = fmu->data.value[at[k]];
    }
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2SetReal)(fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2Real value[])
{
    Instance *fmu = c;
    size_t k;
    for (k = 0; k < n; k++) {
        if (at[k] >= SETTABLE) {
            return say(fmu, fmi2Error, "fmi2SetReal: this variable cannot be set");
        }
        if (fmu->data.begun && at[k] >= INPUT_VALUES) { /* what was made of them at the beginning would not follow */
            return say(fmu, fmi2Error, "fmi2SetReal: parameters and initial states are set until initialisation ends");
        }
        fmu->data.value[at[k]] = value[k];
    }
    fmu->data.stale = 1;
    return fmi2OK;
}

/* there are real variables alone */
static fmi2Status none(fmi2Component c, size_t n)
{
    return n == 0 ? fmi2OK : say(c, fmi2Error, "this FMU has real variables alone");
}

#define NO_SUCH(kind)                                                                                              \
    SEEN fmi2Status FMI(fmi2Get##kind)(                                                                            \
        fmi2Component c, const fmi2ValueReference at[], size_t n, fmi2##kind value[])                              \
    {                                                                                                              \
        (void)at;                                                                                                  \
        (void)value;                                                                                               \
        return none(c, n);                                                                                         \
    }                                                                                                              \
    SEEN fmi2Status FMI(fmi2Set##kind)(                                                                            \
        fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2##kind value[])                        \
    {                                                                                                              \
        (void)at;                                                                                                  \
        (void)value;                                                                                               \
        return none(c, n);                                                                                         \
    }

NO_SUCH(Integer)
NO_SUCH(Boolean)
NO_SUCH(String)

SEEN fmi2Status FMI(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(Data));
    }
    if (*state == NULL) {
        return say(c, fmi2Error, "no memory is left for a state");
    }
    memcpy(*state, &((Instance *)c)->data, sizeof(Data));
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state)
{
    memcpy(&((Instance *)c)->data, state, sizeof(Data));
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c;
    (void)state;
    *size = sizeof(Data);
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(Data)) {
        return say(c, fmi2Error, "fmi2SerializeFMUstate: the room is too small");
    }
    memcpy(bytes, state, sizeof(Data));
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2DeSerializeFMUstate)(
    fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    if (size != sizeof(Data)) {
        return say(c, fmi2Error, "fmi2DeSerializeFMUstate: this is no state of this FMU");
    }
    if (*state == NULL) {
        *state = malloc(sizeof(Data));
    }
    if (*state == NULL) {
        return say(c, fmi2Error, "no memory is left for a state");
    }
    memcpy(*state, bytes, sizeof(Data));
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2GetDirectionalDerivative)(
    fmi2Component c, const fmi2ValueReference unknown[], size_t n, const fmi2ValueReference known[], size_t m,
    const fmi2Real seed[], fmi2Real value[])
{
    (void)unknown;
    (void)n;
    (void)known;
    (void)m;
    (void)seed;
    (void)value;
    return say(c, fmi2Error, "directional derivatives are not offered");
}

/* ---- model exchange ---- */

SEEN fmi2Status FMI(fmi2EnterEventMode)(fmi2Component c)
{
    return remember(c);
}

SEEN fmi2Status FMI(fmi2NewDiscreteStates)(fmi2Component c, fmi2EventInfo *info)
{
    Instance *fmu = c;
    info->newDiscreteStatesNeeded = 0;
    info->terminateSimulation = 0;
    info->nominalsOfContinuousStatesChanged = 0;
    info->valuesOfContinuousStatesChanged = astray(fmu);
    if (astray(fmu)) {
        mend(fmu);
    }
    info->nextEventTimeDefined = 0;
    info->nextEventTime = 0.0;
    fmu->data.stale = 1;
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2EnterContinuousTimeMode)(fmi2Component c)
{
    return remember(c);
}

SEEN fmi2Status FMI(fmi2CompletedIntegratorStep)(
    fmi2Component c, fmi2Boolean no_earlier_state, fmi2Boolean *enter_event_mode, fmi2Boolean *terminate)
{
    (void)no_earlier_state;
    *enter_event_mode = astray(c);
    *terminate = 0;
    return remember(c);
}

SEEN fmi2Status FMI(fmi2SetTime)(fmi2Component c, fmi2Real time)
{
    Instance *fmu = c;
    fmu->data.time = time;
    fmu->data.stale = 1;
    return fmi2OK;
}

static fmi2Status fits(fmi2Component c, size_t n)
{
    return n == STATES ? fmi2OK : say(c, fmi2Error, "the number of continuous states is another");
}

SEEN fmi2Status FMI(fmi2SetContinuousStates)(fmi2Component c, const fmi2Real x[], size_t n)
{
    Instance *fmu = c;
    if (fits(c, n) != fmi2OK) {
        return fmi2Error;
    }
    if (n > 0) {
        memcpy(fmu->data.value + AT_X, x, n*sizeof x[0]);
    }
    fmu->data.stale = 1;
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2GetContinuousStates)(fmi2Component c, fmi2Real x[], size_t n)
{
    if (fits(c, n) != fmi2OK) {
        return fmi2Error;
    }
    if (n > 0) {
        memcpy(x, ((Instance *)c)->data.value + AT_X, n*sizeof x[0]);
    }
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2GetDerivatives)(fmi2Component c, fmi2Real slope[], size_t n)
{
    if (fits(c, n) != fmi2OK) {
        return fmi2Error;
    }
    refresh(c);
    if (n > 0) {
        memcpy(slope, ((Instance *)c)->data.value + AT_SLOPE, n*sizeof slope[0]);
    }
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2GetNominalsOfContinuousStates)(fmi2Component c, fmi2Real nominal[], size_t n)
{
    size_t k;
    for (k = 0; k < n; k++) {
        nominal[k] = 1.0;
    }
    return fits(c, n);
}

SEEN fmi2Status FMI(fmi2GetEventIndicators)(fmi2Component c, fmi2Real indicator[], size_t n)
{
    (void)indicator;
    return n == 0 ? fmi2OK : say(c, fmi2Error, "there are no event indicators");
}

/* ---- co-simulation ---- */

SEEN fmi2Status FMI(fmi2DoStep)(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_earlier_state)
{
    Instance *fmu = c;
    fmi2Status status;
    (void)no_earlier_state;
    if (!(step > 0.0)) {
        return step == 0.0 ? fmi2OK : say(fmu, fmi2Error, "fmi2DoStep: the step must be positive");
    }
    fmu->data.time = time;
    status = advance(fmu, step);
    fmu->data.time = time + step;
    fmu->data.stale = 1;
    return status;
}

SEEN fmi2Status FMI(fmi2CancelStep)(fmi2Component c)
{
    return say(c, fmi2Error, "steps end before they could be cancelled");
}

SEEN fmi2Status FMI(fmi2SetRealInputDerivatives)(
    fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2Integer order[], const fmi2Real value[])
{
    (void)at;
    (void)order;
    (void)value;
    return n == 0 ? fmi2OK : say(c, fmi2Error, "inputs are held over a step");
}

SEEN fmi2Status FMI(fmi2GetRealOutputDerivatives)(
    fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2Integer order[], fmi2Real value[])
{
    (void)at;
    (void)order;
    (void)value;
    return n == 0 ? fmi2OK : say(c, fmi2Error, "derivatives of outputs are not offered");
}

SEEN fmi2Status FMI(fmi2GetStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c;
    (void)kind;
    *value = fmi2OK;
    return fmi2OK;
}

SEEN fmi2Status FMI(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    *value = kind == fmi2LastSuccessfulTime ? ((Instance *)c)->data.time : 0.0;
    return kind == fmi2LastSuccessfulTime ? fmi2OK : fmi2Discard;
}

SEEN fmi2Status FMI(fmi2GetIntegerStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c;
    (void)kind;
    *value = 0;
    return fmi2Discard;
}

SEEN fmi2Status FMI(fmi2GetBooleanStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c;
    *value = 0;
    return kind == fmi2Terminated ? fmi2OK : fmi2Discard;
}

SEEN fmi2Status FMI(fmi2GetStringStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c;
    (void)kind;
    *value = "";
    return fmi2Discard;
}
