function [force, moment] = quadrotorLoads(x, omegaDot, modelParams, droneParams, simParams)
%QUADROTORLOADS  Forces and moments of the model, 1 x 3 N and N m, in the state x (1 x 17, see quadrotorStart).
extra = struct();
if modelParams.usesRotorAccelerations
    extra.w1_dot = omegaDot(1);
    extra.w2_dot = omegaDot(2);
    extra.w3_dot = omegaDot(3);
    extra.w4_dot = omegaDot(4);
end
if ~isnan(simParams.batteryVoltage)
    extra.battery_voltage = simParams.batteryVoltage;
end
air = x(5:7);
if any(simParams.wind)
    air = air - QuatRot(QuatConj(x(1:4)), simParams.wind);
end
[force, moment] = getFM([Quat2Eul(x(1:4)) air x(8:13)], x(14:17), modelParams, droneParams, extra);
force = force - simParams.offset(1:3);
moment = moment - simParams.offset(4:6);
end
