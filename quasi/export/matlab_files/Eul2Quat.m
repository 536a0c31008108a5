function q = Eul2Quat(angles)
%EUL2QUAT  Quaternions N x 4 (w x y z, body to earth) of Euler angles N x 3: roll pitch yaw, rad, order 3-2-1.
half = 0.5*angles;
cr = cos(half(:, 1));
sr = sin(half(:, 1));
cp = cos(half(:, 2));
sp = sin(half(:, 2));
cy = cos(half(:, 3));
sy = sin(half(:, 3));
q = [cr.*cp.*cy + sr.*sp.*sy, sr.*cp.*cy - cr.*sp.*sy, cr.*sp.*cy + sr.*cp.*sy, cr.*cp.*sy - sr.*sp.*cy];
end
