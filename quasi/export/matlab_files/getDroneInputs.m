function d = getDroneInputs(state, inputs, modelParams, droneParams, extra)
%GETDRONEINPUTS  Variables of the polynomial models from states and rotor speeds.
%
%   d = getDroneInputs(state, inputs, modelParams, droneParams)
%   d = getDroneInputs(state, inputs, modelParams, droneParams, extra)
%
%   state   N x 12: roll pitch yaw (rad), u v w (m/s, body axes, through the air), p q r (rad/s), x y z (m, earth);
%           or N x 9 without the position. Body axes: x forward, y right, z down. Earth axes: north, east, down.
%           One state may be a column.
%   inputs  N x 4 mechanical rotor speeds, rad/s (not eRPM; droneParams.loggedToRadS converts logged units)
%   extra   optional struct of further N x 1 columns: w1_dot .. w4_dot (rad/s2; 0 without), battery_voltage (V), v_in
%           (m/s), and others that modelParams.extraInputs names
%
%   d       struct with one field for each variable, N x 1: w1 .. w4, w2_1 .. w2_4 (squares), w_tot, w_avg (root mean
%           square), u_p u_q u_r and U_p U_q U_r (sums of speeds, of squares, with signs left, front, spin), d_w1 ..,
%           d_w_tot (from hover), u v w, mu_x mu_y mu_z (over the tip speed), roll pitch yaw (within +-pi), p q r,
%           x y z, rotor accelerations. Where modelParams.isNormalized they are the non-dimensional ones, and F_den,
%           M_den are the scales of forces and moments.
%           w_avg_flown, w_tot_flown, w1_flown .. are the speeds, not below the lowest of the training flights.
%           d.base holds the SI columns themselves, d.n the number of rows N.

if nargin < 5 || isempty(extra)
    extra = struct();
end
if size(state, 2) == 1 && (size(state, 1) == 12 || size(state, 1) == 9)
    state = reshape(state, 1, []);
    inputs = reshape(inputs, 1, []);
end
n = size(state, 1);
if ndims(state) > 2 || ~any(size(state, 2) == [9 12])
    error('quasi:shape', 'state is %d x %d, expected N x 12 (or N x 9): roll pitch yaw u v w p q r x y z', ...
        size(state, 1), size(state, 2));
end
if ~isequal(size(inputs), [n 4])
    error('quasi:shape', 'inputs is %d x %d, expected %d x 4 rotor speeds in rad/s, a row for each state', ...
        size(inputs, 1), size(inputs, 2), n);
end

% base columns, SI
b.roll = state(:, 1);
b.pitch = state(:, 2);
b.yaw = state(:, 3);
b.u = state(:, 4);
b.v = state(:, 5);
b.w = state(:, 6);
b.p = state(:, 7);
b.q = state(:, 8);
b.r = state(:, 9);
if size(state, 2) == 12
    b.x = state(:, 10);
    b.y = state(:, 11);
    b.z = state(:, 12);
end
b.w1 = inputs(:, 1);
b.w2 = inputs(:, 2);
b.w3 = inputs(:, 3);
b.w4 = inputs(:, 4);
if ~any(isfield(extra, {'w1_dot', 'w2_dot', 'w3_dot', 'w4_dot'}))
    b.w1_dot = zeros(n, 1);
    b.w2_dot = b.w1_dot;
    b.w3_dot = b.w1_dot;
    b.w4_dot = b.w1_dot;
end
given = fieldnames(extra);
for k = 1:numel(given)
    value = extra.(given{k});
    if ~(isscalar(value) || numel(value) == n)
        error('quasi:shape', 'extra.%s has %d values, expected one or %d, one for each state', given{k}, ...
            numel(value), n);
    end
    if isfield(b, given{k})
        error('quasi:shape', 'extra.%s stands in state or inputs already; leave it out of extra', given{k});
    end
    b.(given{k}) = value(:) + zeros(n, 1);
end
if ~all(isfield(b, {'w1_dot', 'w2_dot', 'w3_dot', 'w4_dot'}))
    error('quasi:missing', 'extra names some rotor accelerations; give all of w1_dot, w2_dot, w3_dot, w4_dot');
end
for k = 1:size(modelParams.extraInputs, 1)
    if ~isfield(b, modelParams.extraInputs{k, 2})
        error('quasi:missing', 'model %s has terms in %s; give it as extra.%s', modelParams.modelID, ...
            modelParams.extraInputs{k, 1}, modelParams.extraInputs{k, 2});
    end
end
if modelParams.usesPosition && size(state, 2) < 12
    error('quasi:missing', 'model %s has terms in the position; give states of 12 columns', modelParams.modelID);
end

% variables, SI
d = b;
d.base = b;
d.n = n;
d.roll = wrapAngle(b.roll);
d.pitch = wrapAngle(b.pitch);
d.yaw = wrapAngle(b.yaw);
d.w2_1 = b.w1.*b.w1;
d.w2_2 = b.w2.*b.w2;
d.w2_3 = b.w3.*b.w3;
d.w2_4 = b.w4.*b.w4;
s = droneParams.left;
d.u_p = s(1)*b.w1 + s(2)*b.w2 + s(3)*b.w3 + s(4)*b.w4;
d.U_p = s(1)*d.w2_1 + s(2)*d.w2_2 + s(3)*d.w2_3 + s(4)*d.w2_4;
s = droneParams.front;
d.u_q = s(1)*b.w1 + s(2)*b.w2 + s(3)*b.w3 + s(4)*b.w4;
d.U_q = s(1)*d.w2_1 + s(2)*d.w2_2 + s(3)*d.w2_3 + s(4)*d.w2_4;
s = droneParams.spin;
d.u_r = s(1)*b.w1 + s(2)*b.w2 + s(3)*b.w3 + s(4)*b.w4;
d.U_r = s(1)*d.w2_1 + s(2)*d.w2_2 + s(3)*d.w2_3 + s(4)*d.w2_4;
d.w_tot = b.w1 + b.w2 + b.w3 + b.w4;
w_avg = sqrt(0.25*d.w2_1 + 0.25*d.w2_2 + 0.25*d.w2_3 + 0.25*d.w2_4);
d.w_avg = w_avg;
hover = droneParams.wHover;
d.d_w1 = b.w1 - hover;
d.d_w2 = b.w2 - hover;
d.d_w3 = b.w3 - hover;
d.d_w4 = b.w4 - hover;
d.d_w_tot = d.w_tot - 4*hover;
s = droneParams.left;
d.u_p_dot = s(1)*b.w1_dot + s(2)*b.w2_dot + s(3)*b.w3_dot + s(4)*b.w4_dot;
s = droneParams.front;
d.u_q_dot = s(1)*b.w1_dot + s(2)*b.w2_dot + s(3)*b.w3_dot + s(4)*b.w4_dot;
s = droneParams.spin;
d.u_r_dot = s(1)*b.w1_dot + s(2)*b.w2_dot + s(3)*b.w3_dot + s(4)*b.w4_dot;
d.w_tot_dot = b.w1_dot + b.w2_dot + b.w3_dot + b.w4_dot;
if modelParams.isNormalized
    d = normalise(d, b, modelParams);
else
    % speeds that stand in denominators are not taken below the lowest of the training flights
    d.w_avg_flown = lowest(w_avg, modelParams.lowestSpeeds(1));
    d.w_tot_flown = lowest(d.w_tot, modelParams.lowestSpeeds(2));
    d.w1_flown = lowest(b.w1, modelParams.lowestSpeeds(3));
    d.w2_flown = lowest(b.w2, modelParams.lowestSpeeds(4));
    d.w3_flown = lowest(b.w3, modelParams.lowestSpeeds(5));
    d.w4_flown = lowest(b.w4, modelParams.lowestSpeeds(6));
    tip = d.w_avg_flown*droneParams.R;
    d.mu_x = b.u./tip;
    d.mu_y = b.v./tip;
    d.mu_z = b.w./tip;
    if isfield(b, 'v_in')
        d.mu_vin = b.v_in./tip;
    end
end
end

function value = lowest(value, limit)
unknown = isnan(value);
value = max(value, limit);
value(unknown) = NaN;
end

function d = normalise(d, b, modelParams)
% the modified helicopter scheme: rotor speeds over their root mean square a (at least idle), velocities over the
% airspeed (at least 0.01 m/s)
top = modelParams.topSpeed;
a = max(d.w_avg, modelParams.idleSpeed);
a(isnan(d.w_avg)) = NaN;
d.F_den = modelParams.forceScale./(top + d.w_avg).^2;
d.M_den = modelParams.momentScale./(top + d.w_avg).^2;
over_top = {'w_tot', 'w_avg', 'd_w_tot', 'd_w1', 'd_w2', 'd_w3', 'd_w4'};
for k = 1:numel(over_top)
    d.(over_top{k}) = d.(over_top{k})/top;
end
over_a = {'w1', 'w2', 'w3', 'w4', 'u_p', 'u_q', 'u_r', 'w1_CMD', 'w2_CMD', 'w3_CMD', 'w4_CMD'};
for k = 1:numel(over_a)
    if isfield(d, over_a{k})
        d.(over_a{k}) = d.(over_a{k})./a;
    end
end
over_a2 = {'w2_1', 'w2_2', 'w2_3', 'w2_4', 'U_p', 'U_q', 'U_r', 'w1_dot', 'w2_dot', 'w3_dot', 'w4_dot', ...
    'w_tot_dot', 'u_p_dot', 'u_q_dot', 'u_r_dot'};
for k = 1:numel(over_a2)
    if isfield(d, over_a2{k})
        d.(over_a2{k}) = d.(over_a2{k})./(a.*a);
    end
end
d.p = b.p*modelParams.armOverRadius./a;
d.q = b.q*modelParams.armOverRadius./a;
d.r = b.r*modelParams.armOverRadius./a;
airspeed = sqrt(b.u.*b.u + b.v.*b.v + b.w.*b.w);
speed = max(airspeed, modelParams.leastAirspeed);
speed(isnan(airspeed)) = NaN;
d.u = b.u./speed;
d.v = b.v./speed;
d.w = b.w./speed;
tip = a*modelParams.rotorRadius;
d.mu_x = b.u./tip;
d.mu_y = b.v./tip;
d.mu_z = b.w./tip;
if isfield(b, 'v_in')
    d.v_in = b.v_in./tip;
    d.mu_vin = d.v_in;
end
end
