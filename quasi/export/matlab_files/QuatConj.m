function c = QuatConj(q)
%QUATCONJ  Conjugates of quaternions N x 4, w x y z: the inverse rotation of unit quaternions.
c = [q(:, 1), -q(:, 2), -q(:, 3), -q(:, 4)];
end
