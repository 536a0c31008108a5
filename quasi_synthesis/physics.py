"""Equations of motion of the made vehicle: per-rotor blade-element momentum theory and a rigid body, compiled.

Not of the polynomial family that is fitted to flights: the thrust of a rotor follows from blade angle, inflow and
airspeed through an induced velocity that is a state of its own.

State x (27): 0:3 position of the cg (earth NED, m); 3:6 its velocity (earth, m/s); 6:10 attitude w x y z;
10:13 body rates (rad/s); 13:17 rotor speeds W (rad/s); 17:21 induced velocities (m/s);
21:24 position and 24:27 velocity of a hung load (earth).

Signs (body x forward, y right, z down; thrust points along -z, spin s = +1 clockwise from above = about +z):
  thrust at hub r       M = r x F, so a rotor on the left rolls right (+Mx), one in front pitches up (+My)
  aerodynamic torque    the air holds the rotor back and the motor passes that on: Mz = -s Q
  rotor acceleration    Mz = -s J dW/dt
  gyroscopic            M = -omega x (J sum s W z)
  in-plane drag         along -V at each hub; hubs above the cg, so forward flight pitches up
  hub moment            k W (z x V) = k W (-v, u, 0): nose up at u > 0, left side down at v > 0
Sources: Leishman, Principles of Helicopter Aerodynamics, 2nd ed., 2006, chapters 2, 3 and 5 (Glauert inflow in oblique
flow, blade element torque); Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., 2016, section 1.7.
"""

import math

from numba import njit

from quasi.attitude import GRAVITY
from quasi_synthesis.vehicle import BASE_HOVER_SPEED, Physics

PLANT_STATES = 27
CONTACT_STIFFNESS = 2200.0  # N/m per foot
CONTACT_DAMPING = 9.0  # N s/m per foot
CONTACT_FRICTION = 6.0  # N s/m per foot
LOAD_STIFFNESS = 900.0  # N/m, of the line
PENDULUM_DAMPING = 1.0  # N s/m
BEAT = 0.4  # Hz, of the pull that comes and goes
FAN = (1.2, -0.8)  # m north and east, place of the fan
FAN_WIDTH = 1.0  # m
SHIFT = 14.0  # s, when something comes loose


@njit(cache=True, error_model="numpy")
def induced_velocity(speed, climb, inplane, start, p: Physics):
    """Equilibrium induced velocity, m/s, of one rotor: blade-element thrust equals momentum thrust (Glauert).

    speed rad/s; climb m/s along the thrust; inplane m/s; start m/s, first guess. On the branch that continues the
    normal working state into descent; what the vortex ring costs beyond it is `vortex_loss`.
    """
    area = math.pi * p.radius**2
    disc = 2.0 * p.density * area
    tip = speed * p.radius
    gain = 0.25 * p.density * p.lift_slope * p.solidity * area * tip
    if gain < 1e-9:
        return 0.0
    advance = inplane / max(tip, 1.0)
    top = 2.0 / 3.0 * p.pitch * tip * (1.0 + 1.5 * advance * advance)
    v = start
    for _ in range(6):
        through = climb + v
        flow = math.sqrt(inplane * inplane + through * through + 1e-6)
        value = gain * (top - climb - v) - disc * v * flow
        # the bound on the slope keeps the step sane where descent turns the flow through the disc round
        slope = gain + disc * max(flow + v * through / flow, 0.1 * flow)
        step = value / slope
        v += step
        if abs(step) < 1e-7:
            break
    return v


@njit(cache=True, error_model="numpy")
def vortex_loss(climb, inplane, hover_induced):
    """Share of the vortex-ring depth felt: 0 outside descent ratios (0, 2), 1 at 1; swept away by in-plane flow."""
    ratio = -climb / hover_induced
    if ratio <= 0.0 or ratio >= 2.0:
        return 0.0
    return math.sin(0.5 * math.pi * ratio) ** 2 * math.exp(-((inplane / hover_induced) ** 2))


@njit(cache=True, error_model="numpy")
def body_to_earth(w, x, y, z):
    """Rotation (3, 3), as rows, of the unit quaternion w x y z."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@njit(cache=True, error_model="numpy")
def derivative(t, x, wanted, air, p: Physics, dx, out):
    """Time derivative of the state.

    t s since the log began; x (27,); wanted (4,) steady rotor speeds of the present command, rad/s;
    air (7,) gust in earth axes, m/s, and four unit-variance buffets (one a rotor);
    dx (27,) is filled; out (14,) is filled with force about the cg without gravity (N, body), moment (N m, body),
    thrust of each rotor (N), shaft torque of each rotor (N m).
    """
    # no array is made here: with one, every call would count the references to all arrays of `p`, a third of its time
    rot = body_to_earth(x[6], x[7], x[8], x[9])
    north, east, down = x[3] - p.wind[0] - air[0], x[4] - p.wind[1] - air[1], x[5] - p.wind[2] - air[2]
    # velocity through the air, body
    vx = rot[0][0] * north + rot[1][0] * east + rot[2][0] * down
    vy = rot[0][1] * north + rot[1][1] * east + rot[2][1] * down
    vz = rot[0][2] * north + rot[1][2] * east + rot[2][2] * down
    wx, wy, wz = x[10], x[11], x[12]
    area = math.pi * p.radius**2
    fx = fy = fz = mx = my = mz = 0.0
    momentum = 0.0  # of all rotors about z
    plane = math.sqrt(vx**2 + vy**2)
    hover = math.sqrt(p.mass * GRAVITY / (8.0 * p.density * area))
    wake = plane / hover
    wake = wake * wake / (0.16 + wake * wake)
    for i in range(4):
        rx, ry, rz = p.hubs[i, 0], p.hubs[i, 1], p.hubs[i, 2]
        nx, ny, nz = p.thrust_axis[i, 0], p.thrust_axis[i, 1], p.thrust_axis[i, 2]
        speed, induced = x[13 + i], x[17 + i]
        ux = vx + wy * rz - wz * ry
        uy = vy + wz * rx - wx * rz
        uz = vz + wx * ry - wy * rx
        climb = ux * nx + uy * ny + uz * nz
        ux -= climb * nx
        uy -= climb * ny
        uz -= climb * nz
        inplane = math.sqrt(ux * ux + uy * uy + uz * uz)
        tip = speed * p.radius
        advance = inplane / max(tip, 1.0)
        gain = 0.25 * p.density * p.lift_slope * p.solidity * area * tip
        thrust = gain * (2.0 / 3.0 * p.pitch * tip * (1.0 + 1.5 * advance * advance) - climb - induced)
        if p.thrust_exponent != 2.0:
            thrust *= (max(speed, 1.0) / BASE_HOVER_SPEED) ** (p.thrust_exponent - 2.0)
        turning = min(speed / 300.0, 1.0)
        thrust += turning * (p.thrust_constant + p.thrust_per_speed * speed) - p.axial_gain * speed * climb
        thrust += 0.25 * p.translational_gain * inplane * inplane

        loss = p.vortex_depth * vortex_loss(climb, inplane, hover)
        factor = p.thrust_gain[i] * (1.0 + p.thrust_drift * t) * (1.0 - loss * (1.0 + p.vortex_buffet * air[3 + i]))
        if plane > 1e-6:
            behind = -(rx * vx + ry * vy) / (plane * math.sqrt(rx * rx + ry * ry))
            if behind > 0.0:
                factor *= 1.0 - p.interference * wake * behind * behind
        hub_x = x[0] + rot[0][0] * rx + rot[0][1] * ry + rot[0][2] * rz
        hub_y = x[1] + rot[1][0] * rx + rot[1][1] * ry + rot[1][2] * rz
        height = -(x[2] + rot[2][0] * rx + rot[2][1] * ry + rot[2][2] * rz)
        if p.ground_gain > 0.0:
            near = p.ground_gain * (p.radius / (4.0 * max(height, 0.2 * p.radius))) ** 2
            factor /= 1.0 - min(near, 0.6)
        if p.proximity_gain != 0.0:
            wall = min(p.room[0] - abs(hub_x), p.room[1] - abs(hub_y))
            factor *= 1.0 - p.proximity_gain * math.exp(-(max(wall, 0.0) ** 2))
        if p.unlisted[0] != 0.0:  # thrust that depends on the heading
            factor *= 1.0 + p.unlisted[0] * math.sin(2.0 * math.atan2(rot[1][0], rot[0][0]))
        thrust *= factor

        # torque on the shaft: profile, and the power that thrust takes from the flow through the disc
        profile = 0.125 * p.density * p.solidity * p.profile_drag * area * tip * tip * p.radius
        torque = profile * (1.0 + 4.6 * advance * advance)
        torque += thrust * (climb + p.induced_factor * induced) / max(speed, 100.0) * turning
        drag = p.h_force * speed
        if tip > 1.0:
            drag += thrust * p.disc_tilt / tip * (1.0 - 0.5 * advance)
        gx = thrust * nx - drag * ux
        gy = thrust * ny - drag * uy
        gz = thrust * nz - drag * uz
        lag = p.lag_up if wanted[i] > speed else p.lag_down
        acceleration = (wanted[i] - speed) / lag
        reaction = p.spin[i] * (torque + p.rotor_inertia * acceleration)
        flap = p.flapping_moment * speed
        damp = p.flapping_damping * speed
        fx += gx
        fy += gy
        fz += gz
        # the shaft's axis about which spin counts is -thrust axis
        mx += ry * gz - rz * gy + reaction * nx - flap * uy - damp * wx
        my += rz * gx - rx * gz + reaction * ny + flap * ux - damp * wy
        mz += rx * gy - ry * gx + reaction * nz
        momentum += p.spin[i] * p.gyroscopic_inertia * speed
        dx[13 + i] = acceleration
        dx[17 + i] = (induced_velocity(speed, climb, inplane, induced, p) - induced) / p.inflow_lag
        out[6 + i] = thrust
        out[10 + i] = torque
    mx -= wy * momentum
    my += wx * momentum

    total = math.sqrt(vx**2 + vy**2 + vz**2)
    bx, by, bz = -p.body_drag[0] * total * vx, -p.body_drag[1] * total * vy, -p.body_drag[2] * total * vz
    bz -= p.body_lift * total * vx
    c = p.drag_centre
    fx += bx
    fy += by
    fz += bz
    mx += c[1] * bz - c[2] * by
    my += c[2] * bx - c[0] * bz
    mz += c[0] * by - c[1] * bx

    mz += p.unlisted[4] * x[0]  # a yaw moment that grows northwards
    my -= p.unlisted[5] * wy * wy * wy  # pitching is braked by the cube of its rate
    if t > SHIFT:  # something comes loose and from then on rolls the vehicle
        mx += p.unlisted[6]
    ex = ey = ez = 0.0  # what acts in earth axes: feet on the floor, tether, load, and what no known cause explains
    if p.unlisted[1] != 0.0:  # a push along body y that grows with height
        fy -= p.unlisted[1] * x[2]
    if p.unlisted[2] != 0.0:  # a pull northwards that comes and goes with time
        ex += p.unlisted[2] * math.sin(2.0 * math.pi * BEAT * t)
    if p.unlisted[3] != 0.0:  # a fan below one place of the room
        away = (x[0] - FAN[0]) ** 2 + (x[1] - FAN[1]) ** 2
        ez -= p.unlisted[3] * math.exp(-away / FAN_WIDTH**2)
    if -x[2] < 0.3:
        for foot in range(4):
            rx = p.leg[0] if foot < 2 else -p.leg[0]
            ry = p.leg[1] if foot % 2 == 0 else -p.leg[1]
            rz = p.leg[2]
            depth = x[2] + rot[2][0] * rx + rot[2][1] * ry + rot[2][2] * rz
            if depth <= 0.0:
                continue
            cx, cy, cz = wy * rz - wz * ry, wz * rx - wx * rz, wx * ry - wy * rx
            sx = x[3] + rot[0][0] * cx + rot[0][1] * cy + rot[0][2] * cz
            sy = x[4] + rot[1][0] * cx + rot[1][1] * cy + rot[1][2] * cz
            sz = x[5] + rot[2][0] * cx + rot[2][1] * cy + rot[2][2] * cz
            hold = CONTACT_STIFFNESS * depth + CONTACT_DAMPING * sz
            hold = max(hold, 0.0)
            qx, qy = -CONTACT_FRICTION * sx, -CONTACT_FRICTION * sy
            gx = rot[0][0] * qx + rot[1][0] * qy - rot[2][0] * hold
            gy = rot[0][1] * qx + rot[1][1] * qy - rot[2][1] * hold
            gz = rot[0][2] * qx + rot[1][2] * qy - rot[2][2] * hold
            fx += gx
            fy += gy
            fz += gz
            mx += ry * gz - rz * gy
            my += rz * gx - rx * gz
            mz += rx * gy - ry * gx
    ex -= p.tether * x[0]
    ey -= p.tether * x[1]
    ez -= p.tether * x[2]
    for k in range(21, 27):
        dx[k] = 0.0
    if p.load_mass > 0.0:
        lx, ly, lz = x[21] - x[0], x[22] - x[1], x[23] - x[2]
        length = max(math.sqrt(lx * lx + ly * ly + lz * lz), 1e-6)
        lx, ly, lz = lx / length, ly / length, lz / length
        rate = (x[24] - x[3]) * lx + (x[25] - x[4]) * ly + (x[26] - x[5]) * lz
        pull = LOAD_STIFFNESS * (length - p.load_length) + PENDULUM_DAMPING * rate
        if length < p.load_length:
            pull = 0.0
        pull = max(pull, 0.0)
        ex += pull * lx
        ey += pull * ly
        ez += pull * lz
        dx[21], dx[22], dx[23] = x[24], x[25], x[26]
        dx[24] = -pull * lx / p.load_mass
        dx[25] = -pull * ly / p.load_mass
        dx[26] = -pull * lz / p.load_mass + GRAVITY
        if x[23] > 0.0:  # the load lies on the floor
            dx[24] -= 20.0 * x[24]
            dx[25] -= 20.0 * x[25]
            dx[26] -= 4000.0 * x[23] + 60.0 * x[26]
    fx += rot[0][0] * ex + rot[1][0] * ey + rot[2][0] * ez
    fy += rot[0][1] * ex + rot[1][1] * ey + rot[2][1] * ez
    fz += rot[0][2] * ex + rot[1][2] * ey + rot[2][2] * ez

    for k in range(3):
        dx[k] = x[3 + k]
    dx[3] = (rot[0][0] * fx + rot[0][1] * fy + rot[0][2] * fz) / p.mass
    dx[4] = (rot[1][0] * fx + rot[1][1] * fy + rot[1][2] * fz) / p.mass
    dx[5] = (rot[2][0] * fx + rot[2][1] * fy + rot[2][2] * fz) / p.mass
    dx[5] += GRAVITY
    qw, qx, qy, qz = x[6], x[7], x[8], x[9]
    dx[6] = 0.5 * (-qx * wx - qy * wy - qz * wz)
    dx[7] = 0.5 * (qw * wx + qy * wz - qz * wy)
    dx[8] = 0.5 * (qw * wy + qz * wx - qx * wz)
    dx[9] = 0.5 * (qw * wz + qx * wy - qy * wx)
    inertia = p.inertia
    hx = inertia[0, 0] * wx + inertia[0, 1] * wy + inertia[0, 2] * wz
    hy = inertia[1, 0] * wx + inertia[1, 1] * wy + inertia[1, 2] * wz
    hz = inertia[2, 0] * wx + inertia[2, 1] * wy + inertia[2, 2] * wz
    nx, ny, nz = mx - (wy * hz - wz * hy), my - (wz * hx - wx * hz), mz - (wx * hy - wy * hx)
    inverse = p.inverse_inertia
    for k in range(3):
        dx[10 + k] = inverse[k, 0] * nx + inverse[k, 1] * ny + inverse[k, 2] * nz
    out[0], out[1], out[2] = fx, fy, fz
    out[3], out[4], out[5] = mx, my, mz


@njit(cache=True, error_model="numpy")
def advance(t, x, wanted, air, dt, p: Physics, k1, k2, k3, k4, y, out, spare):
    """One classical Runge-Kutta step in place; k1 and out keep derivative and loads at the step's beginning."""
    derivative(t, x, wanted, air, p, k1, out)
    for i in range(PLANT_STATES):
        y[i] = x[i] + 0.5 * dt * k1[i]
    derivative(t, y, wanted, air, p, k2, spare)
    for i in range(PLANT_STATES):
        y[i] = x[i] + 0.5 * dt * k2[i]
    derivative(t, y, wanted, air, p, k3, spare)
    for i in range(PLANT_STATES):
        y[i] = x[i] + dt * k3[i]
    derivative(t, y, wanted, air, p, k4, spare)
    for i in range(PLANT_STATES):
        x[i] += dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    norm = math.sqrt(x[6] ** 2 + x[7] ** 2 + x[8] ** 2 + x[9] ** 2)
    for i in range(6, 10):
        x[i] /= norm
