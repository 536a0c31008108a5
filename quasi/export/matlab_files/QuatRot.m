function rotated = QuatRot(q, vectors)
%QUATROT  Turn vectors N x 3 by unit quaternions N x 4 (w x y z): body to earth; with QuatConj(q), earth to body.
w = q(:, 1);
x = q(:, 2);
y = q(:, 3);
z = q(:, 4);
tx = 2*(y.*vectors(:, 3) - z.*vectors(:, 2));
ty = 2*(z.*vectors(:, 1) - x.*vectors(:, 3));
tz = 2*(x.*vectors(:, 2) - y.*vectors(:, 1));
rotated = [vectors(:, 1) + w.*tx + y.*tz - z.*ty, ...
    vectors(:, 2) + w.*ty + z.*tx - x.*tz, ...
    vectors(:, 3) + w.*tz + x.*ty - y.*tx];
end
