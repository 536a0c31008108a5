function [vehicle, force, moment, slope] = quadrotorModel(vehicle, omegaCommand, dt, move, modelParams, droneParams, ...
    simParams)
%QUADROTORMODEL  One time step of the quadrotor: rotor dynamics, aerodynamic model, equations of motion, integration.
%
%   vehicle       from quadrotorStart; comes back at the end of the step
%   omegaCommand  1 x 4 commanded rotor speeds, rad/s
%   move          false: only forces, moments and slope at the present state are wanted
%
%   force, moment  1 x 3 N, N m, body axes; slope 1 x 17 derivative of vehicle.x; at the beginning of the step
[vehicle, target, given] = rotorCommand(vehicle, omegaCommand, dt, simParams);
if ~move
    [slope, force, moment] = equationsOfMotion(vehicle.x, target, given, modelParams, droneParams, simParams);
    return
end
h = dt/simParams.substeps;
for part = 1:simParams.substeps
    x = vehicle.x;
    [first, f, m] = equationsOfMotion(x, target, given, modelParams, droneParams, simParams);
    if part == 1
        force = f;
        moment = m;
        slope = first;
    end
    if simParams.rungeKutta
        second = equationsOfMotion(x + 0.5*h*first, target, given, modelParams, droneParams, simParams);
        third = equationsOfMotion(x + 0.5*h*second, target, given, modelParams, droneParams, simParams);
        [fourth, f] = equationsOfMotion(x + h*third, target, given, modelParams, droneParams, simParams);
        x = x + h/6*(first + 2*second + 2*third + fourth);
    else
        x = x + h*first;
        [~, f] = equationsOfMotion(x, target, given, modelParams, droneParams, simParams);
    end
    x(1:4) = x(1:4)/sqrt(sum(x(1:4).^2));
    vehicle.x = x;
    vehicle.lastForce = f;
end
vehicle.step = vehicle.step + 1;
end
