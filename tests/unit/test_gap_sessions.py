"""Sessions: where they come from, when they are the witnesses of a change, and what one session leaves open."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2
from test_unexplained import flight, ground  # noqa: F401

from quasi.attitude import GRAVITY
from quasi.gap.causes import cg_offset, rotor_effectiveness
from quasi.gap.constant_loads import LOADS, _covariances
from quasi.gap.flights import level
from quasi.gap.flights.sessions import SESSION_THRUST, date_of, seating_spread, session_sentence, sessions_of, units
from quasi.gap.levels.forces.identify import compute_leading_p
from quasi.gap.levels.forces.nuisance import session_nuisances
from quasi.gap.profile import Profile
from quasi.gap.statistics import mixed
from quasi.gap.statistics.candidates import Candidate, Columns
from quasi.gap.statistics.clustered import ClusteredMixedModel


@pytest.mark.parametrize(
    ("capture", "header", "expected"),
    [
        ("2024-10-12 09.25.45.123 AM", None, "2024-10-12"),
        ("", "2024-11-16T09:25:45.000+00:00", "2024-11-16"),
        ("", "0000-01-01T00:00:00.000+00:00", ""),
        ("", None, ""),
    ],
)
def test_a_recording_s_date_is_read_where_a_clock_wrote_one(capture, header, expected):
    sources = {"capture": {"capture start": capture}, "onboard": {"header": {"Log start datetime": header}}}
    assert date_of({"imported": {"sources": sources}}) == expected
    assert date_of({"sources": sources}) == expected


def test_the_logbook_goes_before_the_date():
    about = {"sources": {"capture": {"capture start": "2024-10-12 09.25.45 AM"}}}
    assert sessions_of({"a": "hall", "b": ""}, {"a": about, "b": about}) == {"a": "hall", "b": "2024-10-12"}


def test_sessions_are_witnesses_only_where_each_group_has_two():
    flags = [False] * 4 + [True] * 4
    assert units(list("aabbccdd"), flags) == [[0, 1], [2, 3], [4, 5], [6, 7]]
    assert units(list("aaaabbbb"), flags) is None
    assert units(["", "", "", ""], [True] * 4) is None
    assert units(list("abcd"), [True] * 4) is None  # every flight its own session: flights are the witnesses


def test_one_reference_session_is_stated_where_the_compared_flights_are_of_another():
    roles = {"a": "reference", "b": "reference", "c": "compared"}
    assert "column 'Session'" in session_sentence({"a": "1", "b": "1", "c": "2"}, roles)
    assert session_sentence({"a": "1", "b": "2", "c": "3"}, roles) == ""
    assert session_sentence({"a": "1", "b": "1", "c": "1"}, roles) == ""
    assert session_sentence({}, {"c": "compared"}) == ""


def test_what_sessions_differ_by_is_no_change():
    """Each session has its own value, alike in all its flights; nothing changed between the groups."""
    layout = Columns([1], [], np.zeros(0), {"a": [2]})
    flags = [False] * 6 + [True] * 6
    members = [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]]
    small = {"flights": 0, "sessions": 0}
    for seed in range(60):
        rng = np.random.default_rng(seed)
        sizes = np.repeat(0.3 * rng.standard_normal(4), 3)
        grams = []
        for size in sizes:
            blocks = []
            for _ in range(3):
                x = rng.standard_normal((80, 2))
                z = np.column_stack([x[:, 0] + size * x[:, 1] + rng.standard_normal(80), x])
                blocks.append(z.T @ z)
            grams.append(np.array(blocks))
        offer = Candidate("a", "changed", (0,))
        small["flights"] += ClusteredMixedModel(grams, flags, layout).test(offer, pooled=["a"]).p < 0.01
        small["sessions"] += ClusteredMixedModel(grams, flags, layout, members).test(offer, pooled=["a"]).p < 0.01
    assert small["flights"] > 15
    assert small["sessions"] < small["flights"] / 2


def change_between_sessions(seed, jump, sessions, spread=0.3):
    """p of a change of "a" between two reference sessions and a compared one, of 3 flights each."""
    layout = Columns([1], [], np.zeros(0), {"a": [2]}, session=(2,), session_spread=(0.3,))
    rng = np.random.default_rng(seed)
    flags, grams = [False] * 6 + [True] * 3, []
    for size in np.repeat(spread * rng.standard_normal(3) + [0.0, 0.0, jump], 3):
        x = rng.standard_normal((200, 2))
        z = np.column_stack([x[:, 0] + size * x[:, 1] + rng.standard_normal(200), x])
        grams.append(z.T @ z)
    return ClusteredMixedModel(grams, flags, layout, sessions=sessions).test(
        Candidate("a", "changed", (0,)), pooled=["a"]
    )


def test_a_change_has_to_exceed_the_known_spread_of_sessions_though_one_session_is_compared():
    names = list("aaabbbccc")
    healthy = [change_between_sessions(seed, 0.0, names) for seed in range(80)]
    assert np.mean([t.p < 0.01 for t in healthy]) <= 0.05
    assert np.mean([change_between_sessions(seed, 0.0, ()).p < 0.01 for seed in range(80)]) > 0.3
    # of three values with spread s, the third less the mean of the others has the spread sqrt(3/2) s
    assert np.median([t.std[0] for t in healthy]) == pytest.approx(0.3 * np.sqrt(1.5), rel=0.2)
    assert all(change_between_sessions(seed, 2.5, names).p < 0.01 for seed in range(20))


def test_flights_of_one_session_are_compared_as_if_sessions_were_unknown():
    once = [change_between_sessions(seed, 0.2, sessions).p for seed in range(5) for sessions in ((), ["a"] * 9)]
    assert once[0::2] == once[1::2]


def test_a_battery_that_is_seated_elsewhere_is_what_sessions_differ_by(ground):  # noqa: F811
    """Sessions differ by what the causes of a moved centre of gravity and of weak rotors make, in the same columns."""
    seen = flight(ground, 0, rows=1200)
    moved = cg_offset.EFFECT.columns(seen, {})["x"]
    session = {name: (column, spread) for name, column, spread in session_nuisances(seen)}
    np.testing.assert_array_equal(session["session: centre of gravity, x"][0], moved)
    pattern, spread = session["session: thrust, front and rear"]
    rotors = rotor_effectiveness.EFFECT.columns(seen, {})
    ahead = np.sign(np.asarray(seen.airframe.hubs)[:, 0])
    np.testing.assert_allclose(pattern, sum(s * rotors[f"rotor{i}"] for i, s in enumerate(ahead, 1)), atol=1e-12)
    # place of the weight and propellers together make the spread that trims show
    sizes = [np.abs(column[:, 4]).mean() * size for column, size in (session["session: centre of gravity, x"],
                                                                    (pattern, spread))]  # fmt: skip
    thrust = -seen.force[:, 2].mean()
    arm = np.hypot(*seen.hubs[0, :2])
    assert np.hypot(*sizes) == pytest.approx(seating_spread(arm) * arm * thrust, rel=0.02)
    scaled = {n: size for n, _, size in session_nuisances(replace(seen, session_scales=(0.5, 3.0)))}
    for name, (_, size) in session.items():
        assert scaled[name] == pytest.approx(size * (3.0 if name.endswith("along the spin") else 0.5))


def test_a_vector_whose_axes_differ_is_judged_as_a_whole():
    """One of three components beyond two widened standard errors is no rare chance."""
    profile = Profile(leading=(True, True, True))
    test = mixed.Test(Candidate("a", "changed", (0, 1, 2)), np.array([6.6, 0.0, 0.0]), np.eye(3), 1.0, 43.6, 1e-6, 0.0)
    assert compute_leading_p(profile, test, 3.0) == pytest.approx(0.184, abs=0.002)
    alone = mixed.Test(Candidate("a", "changed", (0,)), np.array([6.6]), np.eye(1), 1.0, 43.6, 1e-6, 0.0)
    assert compute_leading_p(profile, alone, 3.0) == pytest.approx(0.028, abs=0.001)
    # parameters that only accompany others do not count
    assert compute_leading_p(Profile(leading=(False, True, True)), test, 3.0) == 1.0


def test_what_one_session_has_in_all_its_flights_is_no_fault_of_them():
    """A bias as large as healthy sessions have it, the same in all flights of the only session."""
    layout = Columns([], [1], np.array([0.012]), {"bias": [2]})
    rng, grams = np.random.default_rng(3), []
    for _ in range(5):
        x = 1e4 * np.repeat(rng.standard_normal((200, 1)), 2, axis=1)
        z = np.column_stack([0.024 * x[:, 0] + rng.standard_normal(200), x])
        grams.append(z.T @ z)
    offer = Candidate("bias", "always", (0,))
    known, unknown = (
        level.SensorMixedModel(grams, [True] * 5, layout, 1e6, sessions=s).test(offer) for s in (["hall"] * 5, [""] * 5)
    )
    assert unknown.p < 0.01
    assert known.p > 0.05
    assert known.std[0] == pytest.approx(
        0.0142, rel=0.05
    )  # of the session, and of five flights with twice its variance
    large = [g * np.outer([1, 0.1, 0.1], [1, 0.1, 0.1]) for g in grams]  # ten times the bias
    assert level.SensorMixedModel(large, [True] * 5, layout, 1e6, sessions=["hall"] * 5).test(offer).p < 1e-6


def test_compared_and_reference_flights_of_unknown_sessions_may_be_of_two():
    """Where they were, the seating of the battery alone made a constant force ten times as often as the level says."""
    rng, load, weight = np.random.default_rng(0), LOADS[1], 0.43 * GRAVITY
    unknown = [SimpleNamespace(mass=0.43, session="") for _ in range(6)]
    alarms = 0
    for _ in range(1000):
        seats = np.repeat(SESSION_THRUST * rng.standard_normal(2), 3)
        force = weight * (seats + load.spread * rng.standard_normal(6))
        spread = np.array([force[3:].std(ddof=1)])
        (covariance,) = _covariances(load, unknown[:3], unknown[3:], spread)
        away = force[:3] - force[3:].mean()
        alarms += chi2.sf(away @ np.linalg.solve(covariance, away), 3) < 0.0025
    assert alarms < 8  # 2.5 and three standard deviations; there had been 27
