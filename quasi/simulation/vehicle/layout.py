"""Where things stand in the simulator's arrays: the state x, what is held over a step, the constants of the body."""

STATES = 17
Q, V, OMEGA, POSITION, ROTORS = 0, 4, 7, 10, 13  # first entries in the state

# first entries in `held`
TARGET = 0  # (4,) rotor speeds that the rotors move to, rad/s
SLOPE = 4  # (4,) rotor accelerations that are given for the step, rad/s2; NaN where the lag decides
SHARE = 8  # (4,) square roots of the rotors' effectiveness
CAP = 12  # (4,) greatest speeds that the rotors reach, rad/s; inf without a fault
WIND = 16  # (3,) velocity of the air, m/s, earth NED
EXTRAS = 19  # further inputs of the model, in the order of its kernel
HELD = EXTRAS

# first entries in `body`, the constants of the rigid body and its rotors
MASS = 0  # kg
GRAVITY_ADDED = 1  # m/s2, 0 where the model's forces hold gravity
INERTIA = 2  # (9,) kg m2, row by row, body axes about the cg
INVERSE = 11  # (9,) its inverse
OFFSET = 20  # (6,) N, N m, subtracted from the model's forces and moments
UP, DOWN = 26, 30  # (4,) s, time constants of the rotors when speeding up and slowing down; 0 for no lag
RATE = 34  # rad/s2, the greatest |dW/dt|
ANGLES = 35  # 1 where a term of the model asks for roll, pitch or yaw
# parts with states of their own, see `parts`: how many states, 0 for none; then their constants
OWN, INFLOW_LAG, INFLOW_GAIN, LOAD_MASS, LOAD_LENGTH, LOAD_DAMPING = 36, 37, 38, 39, 40, 41
HUBS = 42  # (8,) m, x and y of the rotors' hubs
BODY = 50
