function angles = Quat2Eul(q)
%QUAT2EUL  Euler angles N x 3 (roll pitch yaw, rad, order 3-2-1) of quaternions N x 4 (w x y z, body to earth).
w = q(:, 1);
x = q(:, 2);
y = q(:, 3);
z = q(:, 4);
angles = [atan2(2*(w.*x + y.*z), 1 - 2*(x.*x + y.*y)), ...
    asin(min(max(2*(w.*y - z.*x), -1), 1)), ...
    atan2(2*(w.*z + x.*y), 1 - 2*(y.*y + z.*z))];
end
