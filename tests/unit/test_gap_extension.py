"""What the instruments would show if an extended model were right: recordings put right, a load that swings."""

from dataclasses import replace

import numpy as np
import pytest
from plain_plant import made_model

from quasi.gap.catalogue import catalogue
from quasi.gap.effect import vehicle_of
from quasi.gap.extension import extend
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.instruments import shown
from quasi.gap.flights.pendulum import pull_of
from quasi.gap.levels.forces.polynomial_baseline import polynomial
from quasi.model.model import AXES, Model

CATALOGUE = catalogue()
N = 600


def base_of(gravity):
    model = made_model(reaction=0.0, gravity=gravity)
    simple = {"kappaFz": {"value": 0.43 * 9.81 / (4 * 1500.0**2)}, "kappaMz": {"value": -5.6e-9}}
    return Model({**model.document, "simple model": simple})


def flight(model, speeds_of=lambda speeds, slopes: speeds):
    """A flight whose columns hold recorded rotor speeds, and the wrench of the true ones."""
    t = 0.01 * np.arange(N)
    phase = np.arange(1, 5)[:, None] * t + np.arange(4)[:, None]
    speeds, slopes = 1500.0 + 60.0 * np.sin(phase), 60.0 * np.arange(1, 5)[:, None] * np.cos(phase)
    columns = {"t": t, "x": 0.0 * t, "y": 0.0 * t, "z": -2.0 + 0.0 * t,
               "roll": 0.2 * np.sin(2 * t), "pitch": 0.3 * np.sin(1.3 * t), "yaw": 0.2 * t,
               "u": np.sin(t), "v": np.cos(t), "w": 0.3 * np.sin(3 * t),
               "p": 0.4 * np.cos(2 * t), "q": 0.39 * np.cos(1.3 * t), "r": 0.2 + 0.0 * t}  # fmt: skip
    columns |= {f"w{i + 1}": speeds[i] for i in range(4)} | {f"w{i + 1}_dot": slopes[i] for i in range(4)}
    truth = model.predict_columns(columns)[list(AXES)].to_numpy()
    recorded = {**columns, **{f"w{i + 1}": speeds_of(speeds[i], slopes[i]) for i in range(4)}}
    frame = model.airframe
    predicted = model.predict_columns(recorded)[list(AXES)].to_numpy()
    evidence = Evidence("a", frame, model, frame.mass, np.asarray(frame.inertia), recorded, truth, predicted)
    return evidence, truth


def with_cause(model, name, values):
    return Model(extend(model, [(CATALOGUE[name], values)], vehicle_of(model), "x", "test"))


@pytest.mark.parametrize(
    "name, values, recorded",
    [
        # one sample of 10 ms; the last value is held
        ("telemetry_delay", {"delay": 0.01}, lambda w, slope: np.append(w[0] - 0.01 * slope[0], w[:-1])),
        ("rotor_speed_scale", {"scale": 0.08}, lambda w, slope: 1.08 * w),
    ],
)
def test_a_wrong_recording_is_put_right(name, values, recorded):
    model = base_of("withGravity")
    evidence, truth = flight(model, recorded)
    found = shown(with_cause(model, name, values), model, evidence)
    assert np.abs(found - truth)[:-1].max() < 1e-9
    assert np.abs(evidence.predicted - truth).max() > 0.005


@pytest.mark.parametrize("gravity", ["withGravity", "noGravity"])
def test_a_load_swings_instead_of_hanging_at_rest(gravity):
    model = base_of(gravity)
    evidence, truth = flight(model)
    found = shown(with_cause(model, "payload_swing", {"mass at 0.5 m": 0.03}), model, evidence)
    np.testing.assert_allclose(found[:, :3] - truth[:, :3], 0.03 * pull_of(evidence, 0.5), atol=1e-9)
    np.testing.assert_allclose(found[:, 3:], truth[:, 3:], atol=1e-12)


@pytest.mark.parametrize("gravity", ["withGravity", "noGravity"])
def test_a_load_beside_another_mass_is_read_with_the_configured_one(gravity):
    """What the accelerometer feels is all but the weight over the true mass; import makes a force of it by the
    configured mass, and of the net force what that mass weighs."""
    model = base_of(gravity)
    document = {**model.document, "configured mass": 0.43, "airframe": {**model.document["airframe"], "mass": 0.45}}
    evidence, truth = flight(model)
    loaded = with_cause(Model(document), "payload_swing", {"mass at 0.5 m": 0.03})
    weight = 0.0 if gravity == "withGravity" else 9.81 * evidence.down
    predicted = Model(document).predict_columns(evidence.columns)[list(AXES[:3])].to_numpy()
    specific = (predicted - 0.45 * weight + 0.03 * pull_of(evidence, 0.5)) / 0.45
    found = shown(loaded, model, evidence)[:, :3]
    np.testing.assert_allclose(found, 0.43 * (specific + weight), atol=1e-9)
    causes = [(CATALOGUE["mass"], {"mass": 0.02}), (CATALOGUE["payload_swing"], {"mass at 0.5 m": 0.03})]
    if gravity == "withGravity":
        both = shown(Model(extend(model, causes, vehicle_of(model), "x", "test")), model, evidence)[:, :3]
        np.testing.assert_allclose(both, found, atol=1e-9)


def test_a_model_without_a_hover_speed_is_compared_with_a_polynomial_as_well():
    bare = base_of("withGravity")
    bare = Model({**bare.document, "hover speed": {"value": None, "unit": "rad/s"}})
    evidence, _ = flight(bare)
    noise = np.random.default_rng(0).standard_normal(evidence.measured.shape)
    evidence = replace(evidence, measured=evidence.measured + noise)
    left = polynomial([evidence], 2)(evidence)
    assert np.isfinite(left).all() and np.sum(left**2) <= np.sum(evidence.residual**2)
