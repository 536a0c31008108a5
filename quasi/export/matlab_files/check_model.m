function worst = check_model(tolerance)
%CHECK_MODEL  Compare getFM and get_PQRDiffSys with the numbers that the model gave where it was exported.
%
%   worst = check_model()             greatest relative differences, fields F M A B
%   worst = check_model(tolerance)    an error where one is greater (default 1e-12)
%
%   Differences are relative to the greatest of the forces, moments or entries compared.
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
        error('quasi:check', '%s of model %s differs by %.3g of its greatest value, more than %.3g', names{k}, ...
            modelParams.modelID, worst.(names{k}), tolerance);
    end
end
end

function worst = difference(a, b)
if ~isequal(size(a), size(b)) || ~isequal(isfinite(a), isfinite(b)) || ~isequal(isnan(a), isnan(b))
    worst = Inf;
    return
end
good = isfinite(b);
scale = max(abs(b(good)));
if isempty(scale) || scale == 0
    scale = 1;
end
worst = max([0; abs(a(good) - b(good))])/scale;
end
