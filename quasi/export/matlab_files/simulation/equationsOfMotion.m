function [slope, force, moment] = equationsOfMotion(x, target, given, modelParams, droneParams, simParams)
%EQUATIONSOFMOTION  Derivative of the state x (1 x 17: attitude w x y z, u v w, p q r, x y z, rotor speeds).
%
%   Rigid body in body axes: v' = F/m + R'g - omega x v, omega' = I^-1 (M - omega x I omega), position' = R v.
omegaDot = rotorSlope(x(14:17), target, given, simParams);
[force, moment] = quadrotorLoads(x, omegaDot, modelParams, droneParams, simParams);
q = x(1:4);
v = x(5:7);
w = x(8:10);
weight = QuatRot(QuatConj(q), [0 0 simParams.gravityAdded]);
turn = [w(2)*v(3) - w(3)*v(2), w(3)*v(1) - w(1)*v(3), w(1)*v(2) - w(2)*v(1)];
h = (simParams.inertia*w.').';
spin = [w(2)*h(3) - w(3)*h(2), w(3)*h(1) - w(1)*h(3), w(1)*h(2) - w(2)*h(1)];
slope = [0.5*QuatMul(q, [0 w]), force/simParams.mass - turn + weight, ...
    (simParams.inverseInertia*(moment - spin).').', QuatRot(q, v), omegaDot];
end
