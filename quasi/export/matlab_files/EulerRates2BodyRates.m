function rates = EulerRates2BodyRates(angles, eulerRates)
%EULERRATES2BODYRATES  p q r N x 3 (rad/s) from angles N x 3 (rad, order 3-2-1) and rates of roll pitch yaw N x 3.
level = eulerRates(:, 3).*cos(angles(:, 2));
rates = [eulerRates(:, 1) - eulerRates(:, 3).*sin(angles(:, 2)), ...
    eulerRates(:, 2).*cos(angles(:, 1)) + level.*sin(angles(:, 1)), ...
    level.*cos(angles(:, 1)) - eulerRates(:, 2).*sin(angles(:, 1))];
end
