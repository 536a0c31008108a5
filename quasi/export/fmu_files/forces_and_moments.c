/* The force-and-moment model as an FMU without states: outputs follow from inputs. */

static fmi2Status begin(Instance *fmu)
{
    (void)fmu;
    return fmi2OK;
}

static void calculate(Instance *fmu)
{
    double *value = fmu->data.value;
    MODEL(forces_and_moments)(
        value + AT_STATE, value + AT_SPEEDS, value + AT_ACCELERATIONS, value + AT_EXTRA, value + AT_FORCES,
        value + AT_MOMENTS);
}

static fmi2Status advance(Instance *fmu, double step)
{
    (void)fmu;
    (void)step;
    return fmi2OK;
}

static fmi2Status remember(Instance *fmu)
{
    (void)fmu;
    return fmi2OK;
}

static int astray(const Instance *fmu)
{
    (void)fmu;
    return 0;
}

static void mend(Instance *fmu)
{
    (void)fmu;
}
