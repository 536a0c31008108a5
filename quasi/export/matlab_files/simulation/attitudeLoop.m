function rates = attitudeLoop(dt, seen, goal, attitude, memory, simParams)
%ATTITUDELOOP  Body rates, 1 x 3 rad/s, that turn towards an attitude: tilt by the shortest way, then yaw.
c = simParams.controller;
R = bodyToEarth(seen.quaternion);
e = R.'*attitude;  % the wanted axes in body axes
sine = sqrt(e(1, 3)^2 + e(2, 3)^2);
if sine > 1e-9
    factor = atan2(sine, e(3, 3))/sine;
    rates = [-c.attitude*factor*e(2, 3), c.attitude*factor*e(1, 3), 0];
elseif e(3, 3) > 0
    rates = [0 0 0];
else
    rates = [c.attitude*pi, 0, 0];  % upside down: any axis will do
end
rates(3) = c.yaw*atan2(e(2, 1) - e(1, 2), e(1, 1) + e(2, 2));
% rates that the fed forward acceleration and heading ask for by themselves; a jump has none
jerk = (goal.acceleration - memory.lastAcceleration)/dt;
if sum(jerk.^2) < 80^2
    size_ = sqrt(sum(memory.push.^2));
    rates(1) = rates(1) + (jerk*R(:, 2))/size_;
    rates(2) = rates(2) - (jerk*R(:, 1))/size_;
end
rates = rates + R(3, :)*goal.yawRate;
rates = [shorten(rates(1:2), c.rate), min(max(rates(3), -c.yawRate), c.yawRate)];
end
