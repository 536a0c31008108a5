function [omegaCommand, memory] = controller(dt, seen, goal, memory, simParams)
%CONTROLLER  Rotor speeds, 1 x 4 rad/s, that fly towards a goal: outer loops by PID, inner loops by INDI.
%
%   seen    see measure; goal: position, velocity, acceleration (1 x 3, earth axes), yaw (rad), yawRate (rad/s)
%   memory  from controllerStart, carried from step to step
%
%   Smeur, Chu, de Croon, Adaptive incremental nonlinear dynamic inversion for attitude control of micro air vehicles,
%   J. Guidance, Control and Dynamics 39(3), 2016; Smeur, de Croon, Chu, Cascaded incremental nonlinear dynamic
%   inversion for MAV disturbance rejection, Control Engineering Practice 73, 2018.
[acceleration, memory, errors] = positionLoop(dt, seen, goal, memory, simParams);
[attitude, thrust, disturbance, memory] = accelerationINDI(dt, seen, goal, acceleration, memory, simParams);
memory = integrateVelocity(dt, errors, disturbance, memory, simParams);
wantedRates = attitudeLoop(dt, seen, goal, attitude, memory, simParams);
memory.lastAcceleration = goal.acceleration;
[moments, memory] = rateINDI(dt, seen, wantedRates, memory, simParams);
[omegaCommand, memory] = controlAllocation(dt, seen, moments, thrust, memory, simParams);
end
