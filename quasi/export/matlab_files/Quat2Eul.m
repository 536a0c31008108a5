function angles = Quat2Eul(q)
%QUAT2EUL  Euler angles N x 3 (roll pitch yaw, rad, order 3-2-1) of quaternions N x 4 (w x y z, body to earth).
w = q(:, 1);
x = q(:, 2);
y = q(:, 3);
z = q(:, 4);
north = 1 - 2*(y.*y + z.*z);
east = 2*(w.*z + x.*y);
level = sqrt(north.*north + east.*east);
angles = [atan2(2*(w.*x + y.*z), 1 - 2*(x.*x + y.*y)), atan2(2*(w.*y - z.*x), level), atan2(east, north)];
% at a pitch of +-90 degrees roll and yaw are one angle: roll is 0, yaw holds it
pole = level < 1e-8;
together = atan2(2*(w.*z - x.*y), 1 - 2*(x.*x + z.*z));
angles(pole, 1) = 0;
angles(pole, 3) = together(pole);
end
