"""Entries of the simulator's arrays: the state x, the inputs of one step, the constants of the body."""

STATE_SIZE = 17
ATTITUDE, POSITION, ROTOR_SPEEDS = 0, 10, 13  # first entries in the state

# first entries in the step inputs, which are constant over one step
TARGET_SPEED = 0  # (4,) target speeds of the rotors, rad/s
GIVEN_ACCELERATION = 4  # (4,) rotor accelerations prescribed for the step, rad/s2; NaN where the lag determines them
ROOT_EFFECTIVENESS = 8  # (4,) square roots of the rotors' effectiveness
SPEED_CAP = 12  # (4,) highest speeds that the rotors can reach, rad/s; inf without a fault
WIND_VELOCITY = 16  # (3,) velocity of the air, m/s, earth NED
EXTRA_INPUTS = 19  # further inputs of the model, in the order of its kernel
STEP_INPUTS_SIZE = EXTRA_INPUTS

# first entries in `body`, the constants of the rigid body and its rotors
MASS = 0  # kg
ADDED_GRAVITY = 1  # m/s2, 0 where the model's forces include the whole weight
INERTIA = 2  # (9,) kg m2, row by row, body axes about the cg
INVERSE_INERTIA = 11  # (9,) its inverse
LOADS_OFFSET = 20  # (6,) N, N m, subtracted from the model's forces and moments
LAG_UP, LAG_DOWN = 26, 30  # (4,) s, time constants of the rotors when speeding up and slowing down; 0 for no lag
MAX_ROTOR_ACCELERATION = 34  # rad/s2, the greatest |dW/dt|
USES_ANGLES = 35  # 1 where a term of the model uses roll, pitch or yaw
# parts with states of their own, see `parts`: how many states, 0 for none; then their constants
EXTRA_STATES, INFLOW_LAG, INFLOW_GAIN, LOAD_MASS, LOAD_LENGTH, LOAD_DAMPING = 36, 37, 38, 39, 40, 41
HUB_POSITIONS = 42  # (8,) m, x and y of the rotors' hubs
BODY_SIZE = 50
