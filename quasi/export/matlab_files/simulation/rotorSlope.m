function slope = rotorSlope(omega, target, given, simParams)
%ROTORSLOPE  Accelerations of the rotors, 1 x 4 rad/s2: first-order lag towards target, within the rate limit.
gap = target - omega;
tau = simParams.tausDown;
tau(gap > 0) = simParams.tausUp(gap > 0);
slope = min(max(gap./tau, -simParams.rateLimit), simParams.rateLimit);
slope(~isnan(given)) = given(~isnan(given));
end
