function [acceleration, memory, errors] = positionLoop(~, seen, goal, memory, simParams)
%POSITIONLOOP  PID loops of position and velocity: wanted acceleration, 1 x 3 m/s2, earth axes.
%
%   A far place is approached no faster than 40 % of the greatest acceleration (vertically, of gravity) can brake.
c = simParams.controller;
velocity = QuatRot(seen.quaternion, seen.velocity);
e = goal.position - seen.position;
near = approach(sqrt(e(1)^2 + e(2)^2), c.position, 0.4*c.acceleration, c.speed);
climb = approach(abs(e(3)), c.position, 0.4*simParams.g, c.climb);
errors = goal.velocity + [near*e(1), near*e(2), climb*e(3)] - velocity;
wanted = goal.acceleration + c.velocity*errors + memory.integral;
acceleration = [shorten(wanted(1:2), c.acceleration), min(max(wanted(3), -c.acceleration), 0.7*simParams.g)];
end

function speed = approach(distance, gain, brake, most)
% wanted speed per distance, 1/s
linear = brake/(gain*gain);
if distance <= linear
    speed = gain*distance;
else
    speed = sqrt(2*brake*distance - brake*linear);
end
if distance > 0
    speed = min(speed, most)/distance;
else
    speed = gain;
end
end
