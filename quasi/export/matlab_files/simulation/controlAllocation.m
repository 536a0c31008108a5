function [omegaCommand, memory] = controlAllocation(dt, seen, moments, thrust, memory, simParams)
%CONTROLALLOCATION  Rotor speeds, 1 x 4 rad/s, for moments (N m) and thrust (N), within the rotors' limits.
%
%   Where the rotors cannot give all, roll and pitch are kept, then thrust, and yaw is given up first: weighted least
%   squares by an active set (Harkegard, CDC 2002). A rotor that stays behind what its lag explains for 50 ms is taken
%   to have reached its limit.
c = simParams.controller;
wanted = [moments, -thrust + c.mass*simParams.g + c.hoverSpeed^2*sum(c.effectiveness(4, :))].';
wanted(3) = wanted(3) + (c.yawReaction*memory.sent.')/(2*c.hoverSpeed*dt);
if c.learnRotorLimits
    memory = learnLimits(dt, seen, memory, c);
end
low = c.lowestSpeed^2*ones(4, 1);
high = memory.highest.'.^2;
u = memory.inverse*wanted;
inside = all(u >= low & u <= high);
if ~inside
    u = min(max(u, low), high);
    if c.weighted
        u = allocate(memory.effectiveness, wanted, c.weights, low, high, c.hoverSpeed^2, u);
    end
end
memory.saturated = ~inside;
memory.sent = u.';
memory.sentSpeeds = sqrt(u.');
omegaCommand = memory.sentSpeeds;
end

function memory = learnLimits(dt, seen, memory, c)
memory.expected = memory.expected + (memory.sentSpeeds - memory.expected)*memory.follow;
% what the best rotor lacks is a lag or a voltage that all rotors share, and no limit
alike = min(max(seen.omega./max(memory.expected, 1e-3)), 1);
behind = alike*memory.expected - seen.omega > 0.03*c.hoverSpeed;
memory.late = max(memory.late + dt*(2*behind - 1), 0);
for i = 1:4
    if memory.late(i) > 0.05
        memory.highest(i) = max(1.01*seen.omega(i), 1.001*c.lowestSpeed);
        memory.expected(i) = seen.omega(i);
        memory.late(i) = 0;
    elseif memory.highest(i) < c.highestSpeed && ~behind(i)
        memory.highest(i) = min(memory.highest(i)*(1 + dt/0.5), c.highestSpeed);
    end
end
end

function u = allocate(effectiveness, wanted, weights, low, high, scale, u)
% least squares of the weighted rows, each divided by what it can do; x = u/scale
A = effectiveness*scale;
w2 = (weights(:)./sum(abs(A), 2)).^2;
H = A.'*diag(w2)*A + 1e-8*eye(4);
g = A.'*(w2.*wanted) + 1e-8*u/scale;
low = low/scale;
high = high/scale;
x = min(max(u/scale, low), high);
side = zeros(4, 1);
side(x <= low) = -1;
side(x > low & x >= high) = 1;
for attempt = 1:24
    free = side == 0;
    best = x;
    best(free) = H(free, free)\(g(free) - H(free, ~free)*x(~free));
    step = 1;
    hit = 0;
    at = 0;
    for i = find(free).'
        move = best(i) - x(i);
        if move < 0 && x(i) + move < low(i)
            share = (low(i) - x(i))/move;
            if share < step
                step = share;
                hit = i;
                at = -1;
            end
        elseif move > 0 && x(i) + move > high(i)
            share = (high(i) - x(i))/move;
            if share < step
                step = share;
                hit = i;
                at = 1;
            end
        end
    end
    x(free) = x(free) + step*(best(free) - x(free));
    if hit > 0
        side(hit) = at;
        if at < 0
            x(hit) = low(hit);
        else
            x(hit) = high(hit);
        end
        continue
    end
    % at the best of this set: release the rotor that is held most against its will
    worst = -1e-9;
    rotor = 0;
    for i = find(~free).'
        held = -side(i)*(H(i, :)*x - g(i));
        if held < worst*(1 + abs(g(i)))
            worst = held/(1 + abs(g(i)));
            rotor = i;
        end
    end
    if rotor == 0
        break
    end
    side(rotor) = 0;
end
u = min(max(x, low), high)*scale;
end
