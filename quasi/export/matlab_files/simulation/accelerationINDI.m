function [attitude, thrust, disturbance, memory] = accelerationINDI(dt, seen, goal, acceleration, memory, simParams)
%ACCELERATIONINDI  Attitude and thrust for a wanted acceleration, by what the accelerometer and rotor speeds tell.
%
%   attitude     3 x 3 wanted attitude, body to earth
%   thrust       N, upwards in the body
%   disturbance  struct: push (1 x 3 m/s2, wanted thrust per mass, earth axes) and whether limits held it
c = simParams.controller;
R = bodyToEarth(seen.quaternion);
% acceleration that is not the thrust's, by accelerometer and rotor speeds of the same moment, filtered alike
squares = seen.omega.^2;
force = -c.mass*simParams.g + c.effectiveness(4, :)*(squares - c.hoverSpeed^2).';
other = R*[seen.specificForce(1); seen.specificForce(2); seen.specificForce(3) - force/c.mass];
memory.otherFilter = lowPass(memory.otherFilter, other.', dt, memory);
other = memory.otherFilter.value;
% thrust per mass: at least a fifth of the weight upwards, and no more tilt than allowed
down = min(acceleration(3) - simParams.g - other(3), -0.2*simParams.g);
wide = acceleration(1:2) - other(1:2);
level = shorten(wide, -down*tan(c.tilt));
push = [level down];
attitude = attitudeOfThrust(push, goal.yaw);
% thrust along the present axis only: none of it is spent sideways while the body still turns
thrust = max(-c.mass*(push*R(:, 3)), 0);
disturbance.push = push;
disturbance.wide = wide;
disturbance.inside = isequal(level, wide);
disturbance.free = down < -0.2*simParams.g;
memory.push = push;
end

function attitude = attitudeOfThrust(push, yaw)
% z axis against the thrust, x axis above or below the heading
z = -push/sqrt(sum(push.^2));
x = [cos(yaw)*z(3), sin(yaw)*z(3), -sin(yaw)*z(2) - cos(yaw)*z(1)];
x = x/sqrt(sum(x.^2));
y = [z(2)*x(3) - z(3)*x(2), z(3)*x(1) - z(1)*x(3), z(1)*x(2) - z(2)*x(1)];
attitude = [x.' y.' z.'];
end
