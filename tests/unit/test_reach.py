"""The reachable set of a made quadrotor: what free fall and full thrust allow; impossible numbers are named."""

import json

import numpy as np
import plain_plant as plain
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from quasi.errors import ConfigError
from quasi.model.model import Model
from quasi.simulation.loop.setup import make_setup
from quasi.simulation.tools.reach import _distances as distances
from quasi.simulation.tools.reach import find_hull, find_reachable, place_targets
from quasi.simulation.tools.reach_figure import draw_reach

SETTINGS = {"model": {"model ID": "made"}, "noise": {"add": False}}


@pytest.fixture(scope="module")
def found():
    return find_reachable(SETTINGS, plain.made_model(), horizon=0.8, radius=4.0, spacing=45.0)


def test_targets_lie_evenly_on_the_sphere_with_each_pole_once():
    points = place_targets(4.0, 20.0)
    assert len(points) == 18 * 8 + 2 and np.allclose(np.linalg.norm(points, axis=1), 4.0)
    assert len(np.unique(points.round(9), axis=0)) == len(points)
    assert np.allclose(points.mean(axis=0), 0.0, atol=1e-12)
    assert np.allclose(points[-2:], [[0, 0, 4], [0, 0, -4]])


def test_each_simulation_goes_towards_its_target_and_none_faster_than_physics_allows(found):
    ends = found.at(0.8)
    assert len(ends) == len(found.targets) and not found.ended
    assert np.all(np.sum(ends * found.targets, axis=1) > 0.0)
    # full thrust is (2693/1500)^2 = 3.2 times the weight; half of a t^2, less the rotors' and the body's own time
    thrust = (1800 * 1.4959965 / 1500) ** 2 * 9.81
    assert np.max(np.linalg.norm(ends[:, :2], axis=1)) < 0.5 * thrust * 0.8**2
    assert ends[:, 2].max() < 0.5 * 9.81 * 0.8**2 and ends[:, 2].min() > -0.5 * (thrust - 9.81) * 0.8**2
    assert np.ptp(ends[:, 0]) > 1.0 and np.ptp(ends[:, 2]) > 1.0


def test_a_symmetric_vehicle_in_still_air_reaches_as_far_to_either_side(found):
    ends = found.at(0.8)
    assert ends[:, 1].max() == pytest.approx(-ends[:, 1].min(), rel=0.03)


def test_the_summary_is_plain_and_its_volume_that_of_the_hull(found):
    summary = json.loads(json.dumps(found.summary()))
    ends = found.at(0.8)
    assert summary["at the horizon"]["volume"]["value"] == pytest.approx(find_hull(ends).volume)
    assert summary["at the horizon"]["extremes"]["x"]["max"] == pytest.approx(ends[:, 0].max())
    assert summary["at half"]["volume"]["value"] < summary["at the horizon"]["volume"]["value"]
    table = found.table()
    assert len(table) == found.positions[..., 0].size and table["t"].max() == pytest.approx(0.8)


def test_a_failing_rotor_shrinks_what_can_be_reached(found):
    faults = {"inject failure": True, "time of failure": 0.0, "rotor effectiveness after failure": [0.6, 1, 1, 1]}
    weak = find_reachable({**SETTINGS, "faults": faults}, plain.made_model(), horizon=0.8, spacing=45.0)
    assert weak.summary()["at the horizon"]["volume"]["value"] < found.summary()["at the horizon"]["volume"]["value"]


def test_the_figure_is_drawn(found):
    assert FigureCanvasAgg(draw_reach(found)).print_to_buffer()[0]


def test_flat_sets_have_no_hull():
    assert find_hull(np.zeros((10, 3))) is None and find_hull(np.ones((2, 3))) is None


@pytest.mark.parametrize("change", [{"horizon": 0.0}, {"radius": -1.0}, {"spacing": 120.0}, {"horizon": float("nan")}])
def test_impossible_numbers_are_named(change):
    with pytest.raises(ConfigError, match=next(iter(change))):
        find_reachable(SETTINGS, plain.made_model(), **change)


def test_how_far_outside_the_region_counts_the_wind_and_what_else_the_model_reads():
    document = plain.made_model().document
    terms = document["axes"]["Fz"]["terms"]
    unread = "0*battery_voltage"
    terms.append({**terms[0], "given": True, "name": unread, "expression": unread})
    still = {"50": 0.0}
    covered = {n: {"percentiles": still, "min": -1.0, "max": 1.0} for n in ("u", "v", "w")}
    covered["battery_voltage"] = {"percentiles": {"50": 15.0}, "min": 14.0, "max": 16.0}
    model = Model({**document, "envelope": covered})
    setup = make_setup({**SETTINGS, "wind": {"steady": [3.0, 0.0, 0.0]}, "battery": {"voltage": 15.0}}, model)
    rows = np.zeros((1, 2, 17))
    rows[:, :, 0], rows[:, :, 13:] = 1.0, 1500.0
    seen = {}
    setup.model.distance = lambda state, speeds, extra: seen.update(state=state, extra=extra) or (np.zeros(2), None)
    distances(setup, np.array([0.0, 1.0]), rows)
    np.testing.assert_allclose(seen["state"][:, 3:6], [[-3.0, 0.0, 0.0]] * 2)
    np.testing.assert_allclose(seen["extra"]["battery_voltage"], 15.0)
