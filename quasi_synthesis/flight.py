"""The compiled loop of one made flight: physics, sensors, controller and logging at their own rates."""

import math

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi_synthesis.controller import Control, mix, outer_loop, rate_loop, steady_speed
from quasi_synthesis.physics import CONTACT_STIFFNESS, PLANT_STATES, advance, body_to_earth
from quasi_synthesis.pilot import REFERENCE_RATE
from quasi_synthesis.sensors import (
    LOST,
    REPEATED_PACKET,
    Inertial,
    Telemetry,
    delay_and_add_noise,
    filter_coefficients,
    filter_step,
    read_inertial,
    shake_modes,
    start_filter,
)
from quasi_synthesis.vehicle import Drive, Physics

LOOP = 4000.0  # Hz: physics step, sensor step and rate loop
OUTER = 16  # loop steps of the position and attitude loop (250 Hz)
AIR_RATE = 200.0  # Hz of the gust table
HISTORY = 512  # loop steps of memory for delays
MOTOR_LOW, MOTOR_HIGH = 158, 2047  # output range of the flight controller

TRUTH = (
    *("t", "x", "y", "z", "vx", "vy", "vz", "qw", "qx", "qy", "qz", "p", "q", "r", "p_dot", "q_dot", "r_dot"),
    *("w1", "w2", "w3", "w4", "w1_dot", "w2_dot", "w3_dot", "w4_dot"),
    *("Fx", "Fy", "Fz", "Mx", "My", "Mz", "thrust1", "thrust2", "thrust3", "thrust4"),
    *("torque1", "torque2", "torque3", "torque4", "v_in1", "v_in2", "v_in3", "v_in4"),
    *("gust_north", "gust_east", "gust_down", "command1", "command2", "command3", "command4"),
    *("battery_voltage", "battery_current"),
)
LOGGED_SIGNALS = (
    *("gyro0", "gyro1", "gyro2", "raw0", "raw1", "raw2", "acc0", "acc1", "acc2"),
    *("motor0", "motor1", "motor2", "motor3", "erpm0", "erpm1", "erpm2", "erpm3"),
    *(
        "wish0",
        "wish1",
        "wish2",
        "throttle",
        "P0",
        "P1",
        "P2",
        "I0",
        "I1",
        "I2",
        "F0",
        "F1",
        "F2",
        "voltage",
        "current",
    ),
)


@njit(cache=True, error_model="numpy")
def open_voltage(used, d: Drive):
    """Voltage of the resting battery, V, when the share `used` of its charge is gone (lithium polymer, per cell)."""
    used = min(max(used, 0.0), 1.2)
    return d.cells * (4.18 - 0.62 * used - 0.08 * (1.0 - math.exp(-used / 0.04)) - 0.6 * max(used - 0.85, 0.0))


@njit(cache=True, error_model="numpy")
def fly(steps, every, table, air, noise, p: Physics, d: Drive, c: Control, s: Inertial, g: Telemetry, truth, log):
    """Fly `steps` loop steps; each `every` steps a row of truth (M, len(TRUTH)) and of log (M, len(LOG)) is filled.

    table: the pilot's; air (n, 7) at AIR_RATE: gusts (m/s, earth) and buffets; noise (steps, 9)
    standard normal, of gyro, accelerometer and structural modes.
    Returns the number of rows and the largest tilt, rad (more than a right angle means that the vehicle was lost).
    """
    dt = 1.0 / LOOP
    x = np.zeros(PLANT_STATES)
    x[2] = p.mass * GRAVITY / (4.0 * CONTACT_STIFFNESS) - p.leg[2]  # settled on its feet
    x[6] = 1.0
    # the payload lies next to the vehicle, its line slack
    x[21], x[22], x[23] = (0.0, min(0.3, 0.8 * p.load_length), 0.0)
    k1, k2, k3, k4, y = (
        np.empty(PLANT_STATES),
        np.empty(PLANT_STATES),
        np.empty(PLANT_STATES),
        np.empty(PLANT_STATES),
        np.empty(PLANT_STATES),
    )
    before, out, spare = np.empty(PLANT_STATES), np.zeros(14), np.empty(14)
    wind, wanted = np.zeros(7), np.zeros(4)
    phases, raw, gyro, acc = np.zeros(4), np.zeros(6), np.zeros(3), np.zeros(3)
    readings, modes, memory = np.zeros((HISTORY, 6)), np.zeros((3, 2)), np.zeros((3, 3, 2))
    sent, applied = np.zeros((HISTORY, 4)), np.zeros(4)
    speeds, places = np.zeros((HISTORY, 4)), np.zeros((HISTORY, 6))
    commands, motor, erpm, report = np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4)
    sensed = np.array([1.0, 0.0, 0.0, 0.0])  # attitude as known on board
    integral, rate_integral, rates, wish, old = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    forward, terms, ref = np.zeros(3), np.zeros((3, 3)), np.zeros(16)
    force, acceleration = np.zeros(3), np.zeros(3)
    stage_1 = filter_coefficients(s.gyro_kind_1, s.gyro_cut_1, dt)
    stage_2 = filter_coefficients(s.gyro_kind_2, s.gyro_cut_2, dt)
    stage_a = filter_coefficients(s.acc_kind, s.acc_cut, dt)
    used = d.capacity - d.charge
    voltage, current, collective, tilt = open_voltage(used / d.capacity, d), 0.5, 0.0, 0.0
    hover = c.mass * GRAVITY
    late, age = int(d.command_delay * LOOP + 0.5), int(g.age * LOOP + 0.5)
    seen_late = 32  # loop steps, 8 ms, from a motion to the position the controller flies on
    row = 0
    for step in range(steps):
        t = step * dt
        place = min(t * AIR_RATE, air.shape[0] - 1.001)
        j = int(place)
        near = place - j
        gusty = min(max((-x[2] - 0.1) / 0.5, 0.0), 1.0)  # the air at the floor is still
        for k in range(7):
            wind[k] = (1.0 - near) * air[j, k] + near * air[j + 1, k]
        for k in range(3):
            wind[k] = wind[k] * gusty - (1.0 - gusty) * p.wind[k]
        mode = ref[15]
        for i in range(4):
            applied[i] = sent[(step - 1 - late) % HISTORY, i] if step > late else 0.0
            if mode > 0.5:
                speed = steady_speed(applied[i], d.idle_speed, d.max_speed, d.curvature)
                wanted[i] = speed * (voltage / d.reference_voltage) ** d.sag_exponent
            else:
                wanted[i] = 0.0
        for k in range(PLANT_STATES):
            before[k] = x[k]
        advance(t, x, wanted, wind, dt, p, k1, k2, k3, k4, y, out, spare)

        # battery: shaft power over efficiency, and the electronics
        power = 0.0
        for i in range(4):
            power += (out[10 + i] + p.rotor_inertia * max(k1[13 + i], 0.0)) * before[13 + i]
            phases[i] = (phases[i] + before[13 + i] * dt) % (2.0 * math.pi)
            speeds[step % HISTORY, i] = before[13 + i]
        current += (max(power, 0.0) / (d.efficiency * voltage) + 0.6 - current) * min(dt / 0.01, 1.0)
        used += current * dt
        voltage = open_voltage(used / d.capacity, d) - d.resistance * current

        for k in range(3):
            force[k] = out[k] / p.mass
            acceleration[k] = k1[10 + k]
            places[step % HISTORY, k], places[step % HISTORY, 3 + k] = before[k], before[3 + k]
        read_inertial(before[10:13], acceleration, force, before[13:17], phases, s, raw)
        shake_modes(before[13:17], noise[step, 6:9], dt, s, modes, raw)
        if step == 0:  # sensors have been running since power came on
            for k in range(6):
                readings[:, k] = raw[k]
        for k in range(6):
            readings[step % HISTORY, k] = raw[k]
        delay_and_add_noise(readings, step, noise[step, :6], dt, s, raw)
        if step == 0:
            for k in range(3):
                start_filter(raw[k], s.gyro_kind_1, stage_1, memory[k, 0])
                start_filter(raw[k], s.gyro_kind_2, stage_2, memory[k, 1])
                start_filter(raw[3 + k], s.acc_kind, stage_a, memory[k, 2])
        for k in range(3):
            once = filter_step(raw[k], s.gyro_kind_1, stage_1, memory[k, 0])
            gyro[k] = filter_step(once, s.gyro_kind_2, stage_2, memory[k, 1])
            acc[k] = filter_step(raw[3 + k], s.acc_kind, stage_a, memory[k, 2])
        if step % g.interval == 0:
            number = step // g.interval
            for i in range(4):
                heard = speeds[(step - age) % HISTORY, i] if step >= age else 0.0
                new = math.floor(heard * g.scale * g.to_log + 0.5)
                fault = g.faults[number, i] if number < g.faults.shape[0] else 0
                if fault == REPEATED_PACKET:
                    erpm[i] = report[i]
                elif fault != LOST:
                    erpm[i] = new
                report[i] = new

        # attitude on board: the gyro integrated, drawn to the truth as a good estimator would
        sw, sx, sy, sz = sensed[0], sensed[1], sensed[2], sensed[3]
        sensed[0] += 0.5 * dt * (-sx * gyro[0] - sy * gyro[1] - sz * gyro[2])
        sensed[1] += 0.5 * dt * (sw * gyro[0] + sy * gyro[2] - sz * gyro[1])
        sensed[2] += 0.5 * dt * (sw * gyro[1] + sz * gyro[0] - sx * gyro[2])
        sensed[3] += 0.5 * dt * (sw * gyro[2] + sx * gyro[1] - sy * gyro[0])
        if step % OUTER == 0:
            sign = 0.0
            for k in range(4):
                sign += sensed[k] * before[6 + k]
            norm = 0.0
            for k in range(4):
                sensed[k] += 0.01 * ((before[6 + k] if sign >= 0.0 else -before[6 + k]) - sensed[k])
                norm += sensed[k] ** 2
            for k in range(4):
                sensed[k] /= math.sqrt(norm)
            spot = min(t * REFERENCE_RATE, table.shape[0] - 1.001)
            j = int(spot)
            near = spot - j
            for k in range(15):
                ref[k] = (1.0 - near) * table[j, k] + near * table[j + 1, k]
            ref[15] = table[j, 15]
            if ref[15] > 1.5:
                was = (step - seen_late) % HISTORY if step >= seen_late else step % HISTORY
                collective = outer_loop(ref, places[was, :3], places[was, 3:], sensed, integral, OUTER * dt, c, rates)
                collective += ref[14] * hover
                for k in range(3):
                    new = rates[k] + ref[11 + k]
                    forward[k] += 0.5 * ((new - old[k]) / (OUTER * dt) - forward[k])
                    wish[k], old[k] = new, new
        if ref[15] > 1.5:
            rate_loop(wish, gyro, forward, rate_integral, dt, c, terms)
            mix(collective, terms, d.command_limit, c, commands)
        else:
            for k in range(3):
                wish[k] = integral[k] = rate_integral[k] = forward[k] = old[k] = 0.0
                for j in range(3):
                    terms[j, k] = 0.0
            for i in range(4):
                commands[i] = 0.0
            collective = 0.0
        for i in range(4):
            motor[i] = math.floor(MOTOR_LOW + commands[i] * (MOTOR_HIGH - MOTOR_LOW) + 0.5)
            sent[step % HISTORY, i] = (motor[i] - MOTOR_LOW) / (MOTOR_HIGH - MOTOR_LOW)

        if step % every == 0:
            rot = body_to_earth(before[6], before[7], before[8], before[9])
            tilt = max(tilt, math.acos(min(max(rot[2][2], -1.0), 1.0)))
            truth[row, 0] = t
            for k in range(6):
                truth[row, 1 + k] = before[k]
            for k in range(4):
                truth[row, 7 + k] = before[6 + k]
                truth[row, 17 + k] = before[13 + k]
                truth[row, 21 + k] = k1[13 + k]
                truth[row, 31 + k] = out[6 + k]
                truth[row, 35 + k] = out[10 + k]
                truth[row, 39 + k] = before[17 + k]
                truth[row, 46 + k] = applied[k]
            for k in range(3):
                truth[row, 11 + k] = before[10 + k]
                truth[row, 14 + k] = k1[10 + k]
                truth[row, 43 + k] = wind[k]
                log[row, k], log[row, 3 + k], log[row, 6 + k] = gyro[k], raw[k], acc[k]
                log[row, 17 + k], log[row, 21 + k] = wish[k], terms[0, k]
                log[row, 24 + k], log[row, 27 + k] = terms[1, k], terms[2, k]
            for k in range(6):
                truth[row, 25 + k] = out[k]
            truth[row, 50], truth[row, 51] = voltage, current
            for k in range(4):
                log[row, 9 + k], log[row, 13 + k] = motor[k], erpm[k]
            log[row, 20] = min(max(collective / (4.0 * c.thrust_factor * c.max_speed**2), 0.0), 1.0)
            log[row, 30], log[row, 31] = voltage, current
            row += 1
    return row, tilt
