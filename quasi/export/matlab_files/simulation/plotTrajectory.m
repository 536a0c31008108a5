function plotTrajectory(simdata, droneParams)
%PLOTTRAJECTORY  Three-dimensional path of a simulation with stills of the quadrotor, and its reference.
%
%   Axes: east to the right, north ahead, height (-z) upwards, m, so that nothing is drawn mirrored.
position = simdata.state(:, 10:12);
wanted = simdata.reference(:, 1:3);
figure('Name', 'Trajectory');
plot3(wanted(:, 2), wanted(:, 1), -wanted(:, 3), '--', 'Color', [0.5 0.5 0.5]);
hold on
plot3(position(:, 2), position(:, 1), -position(:, 3), 'Color', [0 0.35 0.7], 'LineWidth', 1.5);
% stills are drawn larger than life so that they can be seen
span = max([max(position) - min(position), 1]);
grow = max(0.06*span/droneParams.b, 1);
for k = round(linspace(1, size(position, 1), 12))
    for rotor = 1:4
        hub = QuatRot(simdata.quaternion(k, :), grow*droneParams.hubs(rotor, :));
        at = position(k, :) + hub;
        if droneParams.front(rotor) > 0
            colour = [0.85 0.3 0.1];
        else
            colour = [0.2 0.2 0.2];
        end
        plot3([position(k, 2) at(2)], [position(k, 1) at(1)], -[position(k, 3) at(3)], 'Color', colour, ...
            'LineWidth', 1.5);
    end
end
hold off
grid on
axis equal
view(30, 25);
xlabel('y, east (m)');
ylabel('x, north (m)');
zlabel('height (m)');
legend({'reference', 'flown'}, 'Location', 'northeast');
end
