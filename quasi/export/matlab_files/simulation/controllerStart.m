function memory = controllerStart(vehicle, dt, simParams)
%CONTROLLERSTART  Memory of the controller before its first step: filters begin at what is seen.
c = simParams.controller;
omega = vehicle.x(14:17);
rates = vehicle.x(8:10);
memory.effectiveness = c.effectiveness;
% the yaw moment of rotor accelerations within one step
memory.effectiveness(3, :) = memory.effectiveness(3, :) + c.yawReaction/(2*c.hoverSpeed*dt);
memory.inverse = inv(memory.effectiveness);
memory.sent = omega.^2;
memory.sentSpeeds = omega;
memory.expected = omega;
memory.highest = c.highestSpeed*ones(1, 4);
memory.late = zeros(1, 4);
memory.integral = zeros(1, 3);
memory.lastAcceleration = zeros(1, 3);
memory.saturated = false;
memory.ratesFilter = lowPassStart(rates);
memory.squaresFilter = lowPassStart(omega.^2);
memory.otherFilter = lowPassStart(zeros(1, 3));
half = 0.5*dt;
damp = 2*c.damping*c.cutOff*half;
stiff = (c.cutOff*half)^2;
memory.keep = (1 - damp - stiff)/(1 + damp + stiff);
memory.gain = c.cutOff*c.cutOff*half/(1 + damp + stiff);
memory.follow = 1 - exp(-dt/c.lag);
end

function filter = lowPassStart(value)
filter.value = value;
filter.slope = zeros(size(value));
filter.input = value;
end
