function seen = measure(vehicle, simParams)
%MEASURE  What the controller sees: the state, rotor speeds and the specific force of the accelerometer, m/s2.
x = vehicle.x;
seen.quaternion = x(1:4);
seen.velocity = x(5:7);
seen.rates = x(8:10);
seen.position = x(11:13);
seen.omega = x(14:17);
seen.specificForce = vehicle.lastForce/simParams.mass;
if simParams.gravityAdded == 0
    seen.specificForce = seen.specificForce - QuatRot(QuatConj(x(1:4)), [0 0 simParams.g]);
end
end
