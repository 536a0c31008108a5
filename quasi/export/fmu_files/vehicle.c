/* A whole quadrotor: delay, limits and lag of its rotors, its aerodynamic model, and a rigid body.
 *
 * States: attitude w x y z (unit quaternion, body to earth), u v w over ground (m/s, body axes), p q r (rad/s),
 * x y z (m, earth axes), rotor speeds (rad/s).
 *
 *     dq/dt = q (0, omega)/2                            dx/dt = R v
 *     dv/dt = F/m + R' g - omega x v                    (R' g only where the model's forces leave gravity out)
 *     domega/dt = I^-1 (M - omega x I omega)            dW/dt = (target - W)/tau
 *
 * Source: Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., 2016, section 1.7. */

enum { Q = 0, V = 4, OMEGA = 7, POSITION = 10, ROTORS = 13 };

/* The speeds that are asked of the rotors at present: w1_CMD to w4_CMD, or what the model's map makes of commands and
 * battery voltage. */
static int takes_commands(const Instance *fmu)
{
    return COMMAND_MAP && fmu->data.value[AT_TAKES] != 0.0;
}

static void asked(const Instance *fmu, double *speeds)
{
    const double *value = fmu->data.value;
#if COMMAND_MAP
    if (takes_commands(fmu)) {
        MODEL(steady_speeds)(value + AT_SHARES, value[AT_VOLTAGE], speeds);
        return;
    }
#endif
    memcpy(speeds, value + AT_COMMANDS, 4*sizeof *speeds);
}

/* What is remembered at the beginning, from parameters and initial states as they are. Returns what is wrong with them,
 * NULL where nothing is. */
static const char *start_memory(Instance *fmu)
{
    const double *value = fmu->data.value;
    Memory *memory = &fmu->data.memory;
    const double *i = value + AT_INERTIA; /* Ixx Iyy Izz Ixy Ixz Iyz */
    const double minor = i[0]*i[1] - i[3]*i[3];
    const double all = i[0]*(i[1]*i[2] - i[5]*i[5]) - i[3]*(i[3]*i[2] - i[5]*i[4]) + i[4]*(i[3]*i[5] - i[1]*i[4]);
    double norm = 0.0;
    int k, lags = 1;
    for (k = 0; k < 4; k++) {
        norm += value[AT_X + Q + k]*value[AT_X + Q + k];
        lags = lags && value[AT_UP + k] > 0.0 && value[AT_DOWN + k] > 0.0;
        memory->command[0][k] = value[AT_X + ROTORS + k]; /* the rotors were in balance with their commands */
    }
    memory->inverse[0] = (i[1]*i[2] - i[5]*i[5])/all;
    memory->inverse[1] = memory->inverse[3] = (i[4]*i[5] - i[3]*i[2])/all;
    memory->inverse[2] = memory->inverse[6] = (i[3]*i[5] - i[4]*i[1])/all;
    memory->inverse[4] = (i[0]*i[2] - i[4]*i[4])/all;
    memory->inverse[5] = memory->inverse[7] = (i[4]*i[3] - i[0]*i[5])/all;
    memory->inverse[8] = minor/all;
    memory->when[0] = fmu->data.time;
    memory->count = 1;
    memory->stepped = 0;
    return !lags ? "time constants of rotors must be positive"
        : !(value[AT_MASS] > 0.0) ? "mass must be positive"
        : !(i[0] > 0.0 && minor > 0.0 && all > 0.0) ? "the inertia must be positive definite"
        : !(value[AT_DELAY] >= 0.0) ? "delay must not be negative"
        : !(value[AT_LOWEST] < value[AT_HIGHEST]) ? "lowest_speed must lie below highest_speed"
        : !(value[AT_LONGEST] > 0.0) ? "longest_step must be positive"
        : BATTERY && !(value[AT_REFERENCE_VOLTAGE] > 0.0 && value[AT_REFERENCE_VOLTAGE] < HUGE_VAL)
            ? "reference_voltage must be positive and finite"
        : BATTERY && !(fabs(value[AT_EXPONENT]) < HUGE_VAL) ? "voltage_exponent must be finite"
        : !(norm > 0.0) ? "the initial quaternion must not be zero"
        : NULL;
}

static void make_unit(double *x)
{
    const double norm = sqrt(x[0]*x[0] + x[1]*x[1] + x[2]*x[2] + x[3]*x[3]);
    int k;
    for (k = 0; k < 4; k++) {
        x[k] /= norm;
    }
}

static fmi2Status begin(Instance *fmu)
{
    const char *problem = start_memory(fmu);
    if (problem != NULL) {
        return say(fmu, fmi2Error, problem);
    }
    make_unit(fmu->data.value + AT_X);
    return fmi2OK;
}

/* Append the present commands to what is remembered, and forget what no delay reaches any more. */
static fmi2Status note(Instance *fmu, double time)
{
    Memory *memory = &fmu->data.memory;
    const double reached = time - fmu->data.value[AT_DELAY];
    int gone = 0;
    while (gone + 1 < memory->count && memory->when[gone + 1] <= reached) {
        gone++;
    }
    if (gone > 0) {
        memory->count -= gone;
        memmove(memory->when, memory->when + gone, (size_t)memory->count*sizeof memory->when[0]);
        memmove(memory->command, memory->command + gone, (size_t)memory->count*sizeof memory->command[0]);
    }
    if (memory->count == MEMORY_ROWS) {
        say(fmu, fmi2Error, "too many steps within the delay of the rotors; take longer steps");
        return fmi2Error;
    }
    memory->when[memory->count] = time;
    asked(fmu, memory->command[memory->count]);
    memory->count++;
    return fmi2OK;
}

/* Mean of a command, held between the times that are remembered, from `from` to `to`. */
static double mean_command(const Memory *memory, int rotor, double from, double to)
{
    double sum = 0.0;
    int k;
    for (k = 0; k < memory->count; k++) {
        const double begins = k == 0 || memory->when[k] < from ? from : memory->when[k];
        const double ends = k + 1 == memory->count || memory->when[k + 1] > to ? to : memory->when[k + 1];
        if (ends > begins) {
            sum += (ends - begins)*memory->command[k][rotor];
        }
    }
    return sum/(to - from);
}

/* A command at some time, linear between the times that are remembered and the present. */
static double command_at(const Instance *fmu, int rotor, double time)
{
    const Memory *memory = &fmu->data.memory;
    int k = memory->count - 1;
    double now[4], next_time = fmu->data.time, next;
    asked(fmu, now);
    next = now[rotor];
    while (k >= 0 && memory->when[k] > time) {
        next_time = memory->when[k];
        next = memory->command[k][rotor];
        k--;
    }
    if (k < 0) {
        return memory->command[0][rotor];
    }
    if (next_time <= memory->when[k]) {
        return next_time <= time ? next : memory->command[k][rotor];
    }
    return memory->command[k][rotor]
        + (next - memory->command[k][rotor])*(time - memory->when[k])/(next_time - memory->when[k]);
}

/* What a command lets a rotor settle at: battery, then limits. */
static double settled(const Instance *fmu, double command)
{
    const double *value = fmu->data.value;
    double factor = 1.0, low, high;
    if (BATTERY && value[AT_EXPONENT] != 0.0 && !takes_commands(fmu)) { /* the map holds the voltage already */
        const double voltage = value[AT_VOLTAGE] > 0.0 ? value[AT_VOLTAGE] : 0.0;
        factor = pow(voltage/value[AT_REFERENCE_VOLTAGE], value[AT_EXPONENT]);
    }
    low = value[AT_LOWEST];
    high = value[AT_HIGHEST]*factor;
    command *= factor;
    command = command > low ? command : low;
    return command < high ? command : high;
}

/* roll, pitch, yaw of a quaternion; at a pitch of +-90 degrees roll and yaw are one angle, which yaw holds */
static void euler_angles(double w, double x, double y, double z, double *angles)
{
    const double north = 1.0 - 2.0*(y*y + z*z), east = 2.0*(w*z + x*y), level = sqrt(north*north + east*east);
    angles[1] = atan2(2.0*(w*y - z*x), level);
    if (level < 1e-8) {
        angles[0] = 0.0;
        angles[2] = atan2(2.0*(w*z - x*y), 1.0 - 2.0*(x*x + z*z));
    } else {
        angles[0] = atan2(2.0*(w*x + y*z), 1.0 - 2.0*(x*x + y*y));
        angles[2] = atan2(east, north);
    }
}

/* Forces and moments in a state, and its derivative. */
static void derivative(const Instance *fmu, const double *x, const double *target, double *slope, double *loads)
{
    const double *value = fmu->data.value, *body = fmu->data.memory.inverse, *i = value + AT_INERTIA;
    const double w = x[0], rx = x[1], ry = x[2], rz = x[3], vx = x[4], vy = x[5], vz = x[6];
    const double p = x[7], q = x[8], r = x[9], mass = value[AT_MASS];
    const double gravity = GRAVITY_ADDED ? MODEL(gravity) : 0.0;
    const double ax = value[AT_WIND], ay = value[AT_WIND + 1], az = value[AT_WIND + 2];
    double state[12], tx, ty, tz, hx, hy, hz, mx, my, mz;
    int k;
    for (k = 0; k < 4; k++) {
        const double gap = target[k] - x[ROTORS + k];
        slope[ROTORS + k] = gap/(gap > 0.0 ? value[AT_UP + k] : value[AT_DOWN + k]);
    }
    euler_angles(w, rx, ry, rz, state);
    /* velocity through the air: less the wind, turned into body axes */
    tx = 2.0*(rz*ay - ry*az);
    ty = 2.0*(rx*az - rz*ax);
    tz = 2.0*(ry*ax - rx*ay);
    state[3] = vx - (ax + w*tx + rz*ty - ry*tz);
    state[4] = vy - (ay + w*ty + rx*tz - rz*tx);
    state[5] = vz - (az + w*tz + ry*tx - rx*ty);
    for (k = 6; k < 12; k++) {
        state[k] = x[k + 1];
    }
    MODEL(forces_and_moments)(state, x + ROTORS, slope + ROTORS, value + AT_VOLTAGE, loads, loads + 3);
    slope[0] = 0.5*(-rx*p - ry*q - rz*r);
    slope[1] = 0.5*(w*p + ry*r - rz*q);
    slope[2] = 0.5*(w*q + rz*p - rx*r);
    slope[3] = 0.5*(w*r + rx*q - ry*p);
    tx = -2.0*ry*gravity;
    ty = 2.0*rx*gravity;
    slope[4] = loads[0]/mass - (q*vz - r*vy) + (w*tx + rz*ty);
    slope[5] = loads[1]/mass - (r*vx - p*vz) + (w*ty - rz*tx);
    slope[6] = loads[2]/mass - (p*vy - q*vx) + (gravity + ry*tx - rx*ty);
    hx = i[0]*p + i[3]*q + i[4]*r;
    hy = i[3]*p + i[1]*q + i[5]*r;
    hz = i[4]*p + i[5]*q + i[2]*r;
    mx = loads[3] - (q*hz - r*hy);
    my = loads[4] - (r*hx - p*hz);
    mz = loads[5] - (p*hy - q*hx);
    for (k = 0; k < 3; k++) {
        slope[OMEGA + k] = body[3*k]*mx + body[3*k + 1]*my + body[3*k + 2]*mz;
    }
    tx = 2.0*(ry*vz - rz*vy);
    ty = 2.0*(rz*vx - rx*vz);
    tz = 2.0*(rx*vy - ry*vx);
    slope[10] = vx + w*tx + ry*tz - rz*ty;
    slope[11] = vy + w*ty + rz*tx - rx*tz;
    slope[12] = vz + w*tz + rx*ty - ry*tx;
}

static void calculate(Instance *fmu)
{
    double *value = fmu->data.value, target[4], now[4], loads[6], x[17], w, rx, ry, rz, down[3];
    int k;
    asked(fmu, now);
    memcpy(x, value + AT_X, sizeof x);
    if (!fmu->data.begun) { /* as it will begin; the states that were set stay as they are until then */
        make_unit(x);
        start_memory(fmu);
    }
    w = x[0];
    rx = x[1];
    ry = x[2];
    rz = x[3];
    for (k = 0; k < 4; k++) {
        if (fmu->data.memory.stepped) {
            target[k] = fmu->data.memory.target[k];
        } else if (value[AT_DELAY] > 0.0 && fmu->data.memory.count > 0) {
            target[k] = settled(fmu, command_at(fmu, k, fmu->data.time - value[AT_DELAY]));
        } else {
            target[k] = settled(fmu, now[k]);
        }
    }
    derivative(fmu, x, target, value + AT_SLOPE, loads);
    for (k = 0; k < 6; k++) {
        value[AT_LOADS + k] = loads[k];
    }
    euler_angles(w, rx, ry, rz, value + AT_ANGLES);
    /* an accelerometer at the centre of gravity does not feel gravity, which net forces hold */
    down[0] = 2.0*(rx*rz - w*ry);
    down[1] = 2.0*(ry*rz + w*rx);
    down[2] = 1.0 - 2.0*(rx*rx + ry*ry);
    for (k = 0; k < 3; k++) {
        value[AT_FELT + k] = loads[k]/value[AT_MASS] - (GRAVITY_ADDED ? 0.0 : down[k]*MODEL(gravity));
    }
}

/* Co-simulation: classical Runge-Kutta steps. Commands are held over the communication step; where they come late, each
 * part of it takes their mean over its own time. */
static fmi2Status advance(Instance *fmu, double step)
{
    double *value = fmu->data.value, *x = value + AT_X, *target = fmu->data.memory.target;
    const double delay = value[AT_DELAY], from = fmu->data.time - delay;
    const double parts = ceil(step/value[AT_LONGEST] - 1e-9);
    const int count = parts > 1.0 ? (int)parts : 1;
    const double dt = step/count;
    double now[4], slope[4][17], middle[17], loads[6];
    int k, n, stage;
    asked(fmu, now);
    if (delay > 0.0 && note(fmu, fmu->data.time) != fmi2OK) {
        return fmi2Error;
    }
    fmu->data.memory.stepped = 1;
    for (n = 0; n < count; n++) {
        for (k = 0; k < 4; k++) {
            const double command = delay > 0.0
                ? mean_command(&fmu->data.memory, k, from + n*dt, n + 1 == count ? from + step : from + (n + 1)*dt)
                : now[k];
            target[k] = settled(fmu, command);
        }
        for (stage = 0; stage < 4; stage++) {
            const double share = stage == 0 ? 0.0 : stage == 3 ? dt : 0.5*dt;
            for (k = 0; k < 17; k++) {
                middle[k] = stage == 0 ? x[k] : x[k] + share*slope[stage - 1][k];
            }
            derivative(fmu, middle, target, slope[stage], loads);
        }
        for (k = 0; k < 17; k++) {
            x[k] += dt/6.0*(slope[0][k] + 2.0*slope[1][k] + 2.0*slope[2][k] + slope[3][k]);
        }
        make_unit(x);
    }
    for (k = 0; k < 17; k++) {
        if (!(x[k] - x[k] == 0.0)) {
            say(fmu, fmi2Error, "the state has become infinite: the quadrotor left what its model can tell");
            return fmi2Error;
        }
    }
    return fmi2OK;
}

/* Model exchange: commands are remembered where the integrator stands. */
static fmi2Status remember(Instance *fmu)
{
    return fmu->data.value[AT_DELAY] > 0.0 ? note(fmu, fmu->data.time) : fmi2OK;
}

/* Model exchange: whether the quaternion has left unit length. */
static int astray(const Instance *fmu)
{
    const double *x = fmu->data.value + AT_X;
    const double square = x[0]*x[0] + x[1]*x[1] + x[2]*x[2] + x[3]*x[3];
    return !(square > 0.999999 && square < 1.000001);
}

/* Model exchange: brings the quaternion back to unit length. */
static void mend(Instance *fmu)
{
    make_unit(fmu->data.value + AT_X);
}
