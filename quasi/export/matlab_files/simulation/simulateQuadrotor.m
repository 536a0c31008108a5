function simdata = simulateQuadrotor(Tmax, dt, initialState, initialOmega, reference, modelParams, ...
    droneParams, simParams)
%SIMULATEQUADROTOR  Closed loop of controller and quadrotor model, from initial conditions to an end time.
%
%   Tmax, dt       s
%   initialState   12 x 1: roll pitch yaw (rad), u v w (m/s, body), p q r (rad/s), x y z (m, earth, z down)
%   initialOmega   4 x 1 rotor speeds, rad/s
%   reference      struct as made in main.m: time (s), signals.values (x y z yaw), and optionally velocity (vx vy vz),
%                  acceleration (ax ay az) and yawRate, one row for each time; the row at or before a time holds
%   simParams      see simParameters
%
%   simdata        what is logged, one row for each time: time, state (as initialState), stateDerivative, omegaCommand
%                  and omega (rad/s), force (N), moment (N m), reference, quaternion (w x y z)
%
%   The blocks: controller (attitude and rate loops by INDI, position and velocity loops by PID) and quadrotorModel.
%   Replace either by a function of your own with the same arguments.
steps = round(Tmax/dt);
reference = completeReference(reference);
vehicle = quadrotorStart(initialState, initialOmega, dt, simParams);
memory = controllerStart(vehicle, dt, simParams);
[force, ~] = quadrotorLoads(vehicle.x, zeros(1, 4), modelParams, droneParams, simParams);
vehicle.lastForce = force;

simdata.time = (0:steps).'*dt;
simdata.state = zeros(steps + 1, 12);
simdata.stateDerivative = zeros(steps + 1, 12);
simdata.omegaCommand = zeros(steps + 1, 4);
simdata.omega = zeros(steps + 1, 4);
simdata.force = zeros(steps + 1, 3);
simdata.moment = zeros(steps + 1, 3);
simdata.reference = zeros(steps + 1, 4);
simdata.quaternion = zeros(steps + 1, 4);
for k = 0:steps
    t = k*dt;
    seen = measure(vehicle, simParams);
    goal = goalAt(reference, t);
    [omegaCommand, memory] = controller(dt, seen, goal, memory, simParams);
    if ~all(isfinite(omegaCommand))
        error('quasi:command', 'the controller gave no number at t = %g s', t);
    end
    x = vehicle.x;
    [vehicle, force, moment, slope] = quadrotorModel(vehicle, omegaCommand, dt, k < steps, modelParams, ...
        droneParams, simParams);
    row = k + 1;
    attitude = Quat2Eul(x(1:4));
    simdata.state(row, :) = [attitude x(5:13)];
    simdata.stateDerivative(row, :) = [BodyRates2EulerRates(attitude, x(8:10)) slope(5:13)];
    simdata.omegaCommand(row, :) = omegaCommand;
    simdata.omega(row, :) = x(14:17);
    simdata.force(row, :) = force;
    simdata.moment(row, :) = moment;
    simdata.reference(row, :) = [goal.position goal.yaw];
    simdata.quaternion(row, :) = x(1:4);
    if any(~isfinite(vehicle.x)) || any(abs(vehicle.x(5:10)) > 300)
        error('quasi:diverged', 'the simulation diverged at t = %g s; use a shorter time step or gentler gains', t);
    end
end
end

function reference = completeReference(reference)
rows = numel(reference.time);
if size(reference.signals.values, 1) ~= rows || size(reference.signals.values, 2) < 4
    error('quasi:reference', 'reference.signals.values is %d x %d, expected %d x 4: x y z yaw', ...
        size(reference.signals.values, 1), size(reference.signals.values, 2), rows);
end
if ~isfield(reference, 'velocity')
    reference.velocity = zeros(rows, 3);
end
if ~isfield(reference, 'acceleration')
    reference.acceleration = zeros(rows, 3);
end
if ~isfield(reference, 'yawRate')
    reference.yawRate = zeros(rows, 1);
end
end

function goal = goalAt(reference, t)
row = max(sum(reference.time(:) <= t), 1);
goal.position = reference.signals.values(row, 1:3);
goal.yaw = reference.signals.values(row, 4);
goal.velocity = reference.velocity(row, :);
goal.acceleration = reference.acceleration(row, :);
goal.yawRate = reference.yawRate(row);
end
