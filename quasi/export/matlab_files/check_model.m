function worst = check_model(tolerance)
%CHECK_MODEL  Compare getFM and get_PQRDiffSys with the numbers that the model gave where it was exported.
%
%   worst = check_model()             greatest relative differences, fields F M A B
%   worst = check_model(tolerance)    an error where one is greater (default 1e-12)
%
%   Differences are relative to each number, or to a thousandth of the greatest of its kind where that is more.
if nargin < 1
    tolerance = 1e-12;
end
here = fileparts(mfilename('fullpath'));
found = load(fullfile(here, 'reference.mat'));
reference = found.reference;
[modelParams, droneParams] = model_init();
[F, M, d] = getFM(reference.state, reference.inputs, modelParams, droneParams, reference.extra);
worst.F = difference(F, reference.F);
worst.M = difference(M, reference.M);
if isfield(reference, 'A')
    [A, B] = get_PQRDiffSys(d);
    worst.A = difference(A, reference.A);
    worst.B = difference(B, reference.B);
end
names = fieldnames(worst);
for k = 1:numel(names)
    fprintf('%s: greatest relative difference %.3g\n', names{k}, worst.(names{k}));
    if worst.(names{k}) > tolerance
        error('quasi:check', '%s of model %s differs by %.3g of its value, more than %.3g', names{k}, ...
            modelParams.modelID, worst.(names{k}), tolerance);
    end
end
end

function worst = difference(a, b)
if ~isequal(size(a), size(b)) || ~isequal(isfinite(a), isfinite(b)) || ~isequal(isnan(a), isnan(b))
    worst = Inf;
    return
end
a = columns(a);
b = columns(b);
worst = 0;
for k = 1:size(b, 2)
    good = isfinite(b(:, k));
    value = b(good, k);
    scale = max(abs(value), 1e-3*max([abs(value); 0]));
    error_ = abs(a(good, k) - value);
    error_(error_ > 0) = error_(error_ > 0)./scale(error_ > 0);
    worst = max([worst; error_]);
end
end

function x = columns(x)
% pages of matrices as rows
if ndims(x) > 2
    x = reshape(x, [], size(x, 3)).';
end
end
