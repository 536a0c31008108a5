function [modelParams, droneParams] = model_init(modelID)
%MODEL_INIT  Parameters of the model in this folder.
%
%   [modelParams, droneParams] = model_init(modelID)
%
%   modelID may be left out; a model of another name is an error. droneParams.FM2OmegaMapping (4 x 4) turns
%   [Mx My Mz Fz]' of the simple model into squared rotor speeds, (rad/s)^2; NaN where the simple model is unknown.
%   droneParams.units and modelParams.units tell the units.
here = fileparts(mfilename('fullpath'));
found = load(fullfile(here, 'modelParams.mat'));
modelParams = found.modelParams;
found = load(fullfile(here, 'droneParams.mat'));
droneParams = found.droneParams;
if nargin > 0 && ~strcmp(modelID, modelParams.modelID)
    error('quasi:model', 'the folder %s holds model %s, not %s; add the folder of that model to the path', here, ...
        modelParams.modelID, modelID);
end
effect = [droneParams.M2OmegaMapping; -droneParams.kappaFz*ones(1, 4)];
if all(isfinite(effect(:)))
    droneParams.FM2OmegaMapping = inv(effect);
else
    droneParams.FM2OmegaMapping = NaN(4, 4);
end
end
