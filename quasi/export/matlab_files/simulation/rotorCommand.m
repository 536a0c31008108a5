function [vehicle, target, given] = rotorCommand(vehicle, omegaCommand, dt, simParams)
%ROTORCOMMAND  From commanded rotor speeds to what the rotors move to during a step: delay and saturation.
%
%   target  1 x 4 rad/s; given 1 x 4 rotor accelerations, rad/s2, where no lag decides, else NaN
vehicle.commands = [vehicle.commands(2:end, :); omegaCommand];
whole = simParams.delay/dt;
late = floor(whole + 1e-9);
share = max(whole - late, 0);
wanted = vehicle.commands(end - late, :);
if share > 0
    wanted = (1 - share)*wanted + share*vehicle.commands(end - late - 1, :);
end
target = min(max(wanted, simParams.lowestSpeed), simParams.highestSpeed);
given = NaN(1, 4);
for i = 1:4
    if simParams.tausUp(i) <= 0
        if isinf(simParams.rateLimit)
            vehicle.x(13 + i) = target(i);
            given(i) = 0;
        else
            given(i) = min(max((target(i) - vehicle.x(13 + i))/dt, -simParams.rateLimit), simParams.rateLimit);
        end
    end
end
end
