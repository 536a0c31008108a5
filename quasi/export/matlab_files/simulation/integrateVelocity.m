function memory = integrateVelocity(dt, errors, disturbance, memory, simParams)
%INTEGRATEVELOCITY  Integral part of the velocity loop, m/s2 (0 by default: INDI needs none).
%
%   It stands still where more of it would only push further against a limit, and counts large errors as small ones.
c = simParams.controller;
gain = c.velocityIntegral*dt;
if gain <= 0
    return
end
slight = 0.4;
if disturbance.inside || errors(1:2)*disturbance.wide.' < 0
    memory.integral(1:2) = shorten(memory.integral(1:2) + gain*shorten(errors(1:2), slight), c.integral);
end
if (disturbance.free || errors(3) < 0) && ~memory.saturated
    z = memory.integral(3) + gain*min(max(errors(3), -slight), slight);
    memory.integral(3) = min(max(z, -c.integral), c.integral);
end
end
