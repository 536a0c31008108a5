function [moments, memory] = rateINDI(dt, seen, wantedRates, memory, simParams)
%RATEINDI  Moments of the rotors, 1 x 3 N m, for wanted body rates: an increment on what the rotors do now.
%
%   What is neither the rotors' nor the spinning body's is measured by rates and rotor speeds, filtered alike.
c = simParams.controller;
I = c.inertia;
w = seen.rates;
nu = c.rates.*(wantedRates - w);
% what is wanted stands still in earth axes, and so turns in the body's against its yaw rate
nu(1) = nu(1) + w(3)*wantedRates(2);
nu(2) = nu(2) - w(3)*wantedRates(1);
memory.ratesFilter = lowPass(memory.ratesFilter, w, dt, memory);
memory.squaresFilter = lowPass(memory.squaresFilter, seen.omega.^2, dt, memory);
h = (I*w.').';
m = (I*nu.').' + crossOf(w, h);
% the rotors' lag is led by its own share of a turn
lead = min(max(c.lag*w(3), -1), 1);
m = [m(1) + lead*m(2), m(2) - lead*m(1), m(3)];
slow = memory.ratesFilter.value;
m = m - (I*memory.ratesFilter.slope.').' - crossOf(slow, (I*slow.').');
moments = m + (c.effectiveness(1:3, :)*memory.squaresFilter.value.').';
moments(3) = moments(3) + (c.yawReaction*memory.squaresFilter.slope.')/(2*c.hoverSpeed);
end

function c = crossOf(a, b)
c = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)];
end
