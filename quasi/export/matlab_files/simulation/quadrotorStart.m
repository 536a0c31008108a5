function vehicle = quadrotorStart(initialState, initialOmega, dt, simParams)
%QUADROTORSTART  The quadrotor at its initial conditions, rotors in balance with their commands; see quadrotorModel.
initialState = reshape(initialState, 1, []);
initialOmega = reshape(initialOmega, 1, []);
if numel(initialState) ~= 12 || numel(initialOmega) ~= 4 || ~all(isfinite([initialState initialOmega]))
    error('quasi:initial', 'the initial state must be 12 finite numbers and the initial rotor speeds four');
end
% attitude w x y z, u v w, p q r, x y z, rotor speeds
vehicle.x = [Eul2Quat(initialState(1:3)) initialState(4:12) initialOmega];
vehicle.lastForce = zeros(1, 3);
vehicle.step = 0;
% the latest commands, newest last: enough of them for the delay
vehicle.commands = repmat(initialOmega, floor(simParams.delay/dt + 1e-9) + 2, 1);
end
