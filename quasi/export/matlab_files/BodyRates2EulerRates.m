function eulerRates = BodyRates2EulerRates(angles, rates)
%BODYRATES2EULERRATES  Rates of roll pitch yaw N x 3 from angles N x 3 (rad, order 3-2-1) and p q r N x 3 (rad/s).
r = rates(:, 2).*sin(angles(:, 1)) + rates(:, 3).*cos(angles(:, 1));
eulerRates = [rates(:, 1) + r.*tan(angles(:, 2)), ...
    rates(:, 2).*cos(angles(:, 1)) - rates(:, 3).*sin(angles(:, 1)), ...
    r./cos(angles(:, 2))];
end
