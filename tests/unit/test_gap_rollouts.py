"""Roll-outs of a gap: exact where the model is, commands by map and voltage, and shares that fall as they should."""

import numpy as np
import pandas as pd
import pytest
from plain_plant import made_model

from quasi.attitude import from_euler, rotate_inverse
from quasi.gap.flights.gathering import gather
from quasi.gap.levels.rollouts import error_reduction, open_loop
from quasi.gap.report.figures import figures, surest
from quasi.model.extensions import CONFIGURED_MASS_KEY, compute_flight_mass
from quasi.model.model import Model
from quasi.simulation.tools.rollout import rollout

RATE, SECONDS = 200.0, 6.0
N = int(RATE * SECONDS)


def flown(model, wind=None, mass=None):
    """A flight that the model itself flew with given rotor speeds, from hover. wind (3,) m/s; mass kg instead of its"""
    t = np.arange(N) / RATE
    states = np.zeros((N, 12))
    speeds = 1500.0 + 15.0 * np.sin(2.1 * t)[:, None] + 2.0 * np.sin(5.0 * t)[:, None] * np.array([1, -1, 1, -1])
    heavy = model if mass is None else weighing(model, mass)
    air = None if wind is None else np.tile(np.asarray(wind, float), (N, 1))
    states = rollout(heavy, t, states, speeds, np.array([0]), t[-1] - 0.5 / RATE, wind=air)[0]
    t, speeds = t[: len(states)], speeds[: len(states)]
    names = ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z")
    table = pd.DataFrame({"t": t, **dict(zip(names, states.T)), **{f"w{i + 1}": speeds[:, i] for i in range(4)}})
    if wind is not None:  # as import writes it where somebody told the wind
        through = states[:, 3:6] - rotate_inverse(from_euler(*states[:, :3].T), np.asarray(wind, float))
        table = table.assign(**dict(zip(("u_air", "v_air", "w_air"), through.T)))
    rows = model.predict_columns(table.assign(**{f"w{i}_dot": np.gradient(table[f"w{i}"], t) for i in range(1, 5)}))
    return table.assign(**{a: rows[a] for a in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")}, valid=1.0)


@pytest.fixture(scope="module")
def model():
    return made_model(reaction=0.0)


def ends_of(model, flight, horizons):
    """End errors with measured rotor speeds."""
    starts = open_loop.windows(flight, max(horizons))
    lags = np.array([round(h * RATE) for h in horizons])
    run = open_loop.simulated(model, flight, starts, max(horizons))
    return open_loop.table_of(flight, starts, open_loop.vectors(run, flight, starts, lags), horizons)


def weighing(model, mass):
    return Model({**model.document, "airframe": {**model.document["airframe"], "mass": mass}})


def test_a_wind_that_the_flight_knows_blows_in_its_simulations(model):
    table = flown(model, wind=(3.0, -1.0, 0.2))
    assert open_loop.rms(ends_of(model, open_loop.flight_of("a", table), [0.5]))["velocity"]["0.5"] < 1e-6
    over_ground = open_loop.flight_of("a", table.drop(columns=["u_air", "v_air", "w_air"]))
    assert open_loop.rms(ends_of(model, over_ground, [0.5]))["velocity"]["0.5"] > 0.2
    # a wind that an extension found comes on top of what the flight knew
    known = [1.0, 0.5, 0.0]
    partly = table.assign(**dict(zip(("u_air", "v_air", "w_air"), (
        table[["u", "v", "w"]].to_numpy() - rotate_inverse(from_euler(*table[["roll", "pitch", "yaw"]].to_numpy().T),
                                                            np.array(known))).T)))  # fmt: skip
    rest = {"id": "wind", "environment": {"wind": [2.0, -1.5, 0.2]}}
    found = Model({**model.document, "extensions": [rest]})
    assert open_loop.rms(ends_of(found, open_loop.flight_of("a", partly), [0.5]))["velocity"]["0.5"] < 1e-6


def test_a_flight_is_simulated_with_the_mass_that_it_was_logged_with(model):
    own = model.airframe.mass
    table = flown(model, mass=own + 0.05)
    logged = open_loop.flight_of("a", table, own + 0.05)
    assert open_loop.rms(ends_of(model, logged, [0.5]))["velocity"]["0.5"] < 1e-6
    unknown = open_loop.rms(ends_of(model, open_loop.flight_of("a", table), [0.5]))["velocity"]["0.5"]
    # lighter by 50 g the same thrust, of about the weight of 0.48 kg, lifts it: dv = a (1 - exp(-c t))/c
    assert unknown == pytest.approx(9.81 * 0.05 / own * 0.5, rel=0.2)
    # what an extension found is on top of the logged mass
    found = Model({**weighing(model, own + 0.01).document, CONFIGURED_MASS_KEY: own})
    assert compute_flight_mass(found, own + 0.04) == pytest.approx(own + 0.05)
    assert open_loop.rms(ends_of(found, logged._replace(mass=own + 0.04), [0.5]))["velocity"]["0.5"] < 1e-6
    assert compute_flight_mass(found, None) == compute_flight_mass(found, float("nan")) == pytest.approx(own + 0.01)


def heavier(model, share):
    document = {**model.document, "axes": {**model.document["axes"]}}
    axis = document["axes"]["Fz"]
    terms = [
        {**t, "coefficient": t["coefficient"] * (share if "w2_1" in t["expression"] else 1)} for t in axis["terms"]
    ]
    document["axes"]["Fz"] = {**axis, "terms": terms}
    return Model(document)


def test_the_model_that_flew_makes_no_error_and_another_makes_the_error_of_its_thrust(model):
    flight = open_loop.flight_of("a", flown(model))
    right = open_loop.rms(ends_of(model, flight, [0.2, 0.5]))
    assert right["velocity"]["0.5"] < 1e-6
    wrong = open_loop.rms(ends_of(heavier(model, 1.02), flight, [0.2, 0.5]))
    # 2 % of the weight too much thrust, against drag of 0.15 N per m/s on 0.43 kg: dv = a (1 - exp(-c t))/c
    a, c = 0.02 * 9.81, 0.15 / 0.43
    assert wrong["velocity"]["0.5"] == pytest.approx(a * (1 - np.exp(-c * 0.5)) / c, rel=0.08)
    assert wrong["position"]["0.5"] == pytest.approx(a * (0.5 - (1 - np.exp(-c * 0.5)) / c) / c, rel=0.08)


def test_the_share_that_fell_is_that_of_the_root_mean_squares(model):
    flight = open_loop.flight_of("a", flown(model))
    old, new = (ends_of(heavier(model, k), flight, [0.5]) for k in (1.02, 1.01))
    row = next(r for r in open_loop.fell(old, new) if r["quantity"] == "velocity")
    assert row["value"] == pytest.approx(0.5, abs=0.02) and row["low"] <= row["value"] <= row["high"]
    assert row["value"] == pytest.approx(1.0 - row["after"] / row["before"])


def test_commands_are_the_logged_speeds_or_what_the_map_and_the_voltage_make_of_shares(model):
    table = flown(model)
    logged = table.assign(**{f"w{i}_CMD": table[f"w{i}"] + 1.0 for i in range(1, 5)})
    found = open_loop.commands_of(model, open_loop.flight_of("a", logged))
    np.testing.assert_allclose(found, logged[[f"w{i}" for i in range(1, 5)]] + 1.0)
    assert open_loop.commands_of(Model({**model.document, "actuators": None}), open_loop.flight_of("a", table)) is None
    mapped = {"command map": {"coefficients": [400.0, 3000.0, -500.0], "powers": [0, 1, 2],
                              "voltage exponent": {"value": 0.5}, "reference voltage": 16.0}}  # fmt: skip
    other = Model({**model.document, "actuators": {**(model.document["actuators"] or {}), **mapped}})
    shares = table.assign(**{f"command{i}": 0.1 * i for i in range(1, 5)}, battery_voltage=14.0)
    found = open_loop.commands_of(other, open_loop.flight_of("a", shares))
    expected = [(400 + 300 * i - 5 * i**2) * (14 / 16) ** 0.5 for i in range(1, 5)]
    np.testing.assert_allclose(found[7], expected)
    extended = Model({**other.document, "extensions": [{"id": "battery_sag", "actuators": {"voltage exponent": 1.0}}]})
    found = open_loop.commands_of(extended, open_loop.flight_of("a", shares))
    np.testing.assert_allclose(found[7], np.array(expected) * (14 / 16) ** 0.5)


@pytest.mark.parametrize("own, reference", [(None, 16.8), (15.0, 15.0)])
def test_a_map_that_tells_no_voltage_takes_that_of_the_cause(model, own, reference):
    mapped = {"command map": {"coefficients": [0.0, 4500.0, 0.0], "powers": [0, 1, 2], "reference voltage": own,
                              "voltage exponent": {"value": 0.0, "std": None}}}  # fmt: skip
    told = {"voltage exponent": 1.0, "reference voltage": 16.8}
    lazy = Model({**model.document, "actuators": {**(model.document["actuators"] or {}), **mapped}})
    sagging = Model({**lazy.document, "extensions": [{"id": "battery_sag", "actuators": told}]})
    table = flown(model)
    volts = np.linspace(16.8, 14.8, len(table))
    flight = open_loop.flight_of("a", table.assign(**{f"command{i}": 0.5 for i in range(1, 5)}, battery_voltage=volts))
    np.testing.assert_allclose(open_loop.commands_of(lazy, flight), 2250.0)
    found = open_loop.commands_of(sagging, flight)
    np.testing.assert_allclose(found, np.tile(2250.0 * volts / reference, (4, 1)).T)


def test_windows_avoid_rows_that_are_not_valid(model):
    table = flown(model)
    table.loc[400:420, "valid"] = 0.0
    flight = open_loop.flight_of("a", table)
    starts, steps = open_loop.windows(flight, 0.5), 100
    assert len(starts) and not any(s <= 420 and s + steps >= 400 for s in starts)


def test_overlays_show_the_window_that_gained_most_and_are_drawn(model):
    flight = open_loop.flight_of("a", flown(model))
    found = open_loop.overlays({"before": heavier(model, 1.02), "after": model}, [flight], 0.5)
    first = found[found["window"] == 0]
    assert first["why"].iloc[0] == "the error falls most"
    np.testing.assert_allclose(first["w_after"], first["w_measured"], atol=1e-6)
    assert abs(first["w_before"].iloc[-1] - first["w_measured"].iloc[-1]) > 0.05
    drawn = figures({"rollouts_overlays": found})
    assert list(drawn) == ["overlays"] and len(drawn["overlays"].axes) == 18


def test_the_typical_window_is_one_of_those_that_the_extension_changes(model):
    """A lift that acts at speed alone: half of the windows are slow, and show nothing."""
    term = {**model.document["axes"]["Fz"]["terms"][0], "expression": "u^2", "coefficient": -0.05, "given": True}
    axes = {**model.document["axes"]}
    axes["Fz"] = {**axes["Fz"], "terms": [*axes["Fz"]["terms"], term]}
    lacking = Model({**model.document, "axes": axes})
    flight = open_loop.flight_of("a", flown(model))
    starts = open_loop.windows(flight, 0.5)
    ends = [open_loop.simulated(m, flight, starts, 0.5)[:, -1, 5] for m in (lacking, model)]
    usual = np.median(np.abs(ends[1] - ends[0]))
    found = open_loop.overlays({"before": lacking, "after": model}, [flight], 0.5)
    typical = found[found["why"] == open_loop.TYPICAL]
    assert abs(typical["w_before"].iloc[-1] - typical["w_after"].iloc[-1]) > 2.0 * usual
    np.testing.assert_allclose(typical["w_after"], typical["w_measured"], atol=1e-6)


def evidence_of(model, table):
    about = {"mass": model.airframe.mass, "inertia": model.airframe.inertia}
    dots = {f"w{i}_dot": np.gradient(table[f"w{i}"], table["t"]) for i in range(1, 5)}
    return gather("a", table.assign(**dots), about, model.airframe, model, 100.0)


def moved(model, of):
    """The model whose Fz is off by `of` N."""
    axes = {**model.document["axes"]}
    axes["Fz"] = {
        **axes["Fz"],
        "terms": [*axes["Fz"]["terms"], {**axes["Fz"]["terms"][0], "coefficient": of, "given": True}],
    }
    return Model({**model.document, "axes": axes})


def test_a_constant_error_goes_into_the_trim_of_the_seconds_before(model):
    wrong, table = moved(model, 0.05), flown(model)
    tracks = error_reduction.tracks_of([evidence_of(wrong, table)], {"a": table}, [0.5])
    found = error_reduction.simulated_errors(tracks, wrong, wrong)
    plain, trimmed = (error_reduction.end_table(tracks, found[line], [0.5]) for line in error_reduction.SPEED_LINES)
    # 0.05 N on 0.43 kg against drag of 0.15 N per m/s
    c = 0.15 / 0.43
    assert plain["velocity"].mean() == pytest.approx(0.05 / 0.43 * (1 - np.exp(-0.5 * c)) / c, rel=0.08)
    later = trimmed["start"] > error_reduction.TRIM_S + error_reduction.MARGIN
    assert later.any() and trimmed["velocity z"][later].max() < 0.02 * plain["velocity z"].mean()
    # before that only what was flown until then counts; without half a second of it there is no trim
    first = trimmed["start"] < error_reduction.MARGIN
    np.testing.assert_allclose(trimmed["velocity z"][first], plain["velocity z"][first])


def test_a_trim_turns_a_model_of_another_inertia_as_the_flight_was_turned():
    """A moment M turns the vehicle with I_m^-1 M, which is read as I_b I_m^-1 M by the configured inertia."""
    base = made_model(reaction=0.0)
    document = base.document
    own = np.asarray(document["airframe"]["inertia"])
    true = own + np.array([[2e-4, 3e-4, 0], [3e-4, 1e-4, 1e-4], [0, 1e-4, 2e-4]])
    told = {"airframe": {**document["airframe"], "inertia": true.tolist()}, "configured inertia": own.tolist()}
    extended = Model({**document, **told})
    axes = {**document["axes"]}
    for axis, moment in (("Mx", 6e-6), ("My", -9e-6)):
        term = {"name": "1", "expression": "1", "coefficient": moment, "std": 0.0, "unit": "", "given": True}
        axes[axis] = {**axes[axis], "terms": [*axes[axis]["terms"], term]}
    table = flown(Model({**extended.document, "axes": axes}))
    rates, moments = table[["p", "q", "r"]].to_numpy(), table[["Mx", "My", "Mz"]].to_numpy()
    turning = np.linalg.solve(true, (moments - np.cross(rates, rates @ true)).T).T
    read = turning @ own + np.cross(rates, rates @ own)
    table = table.assign(**{a: read[:, k] for k, a in enumerate(("Mx", "My", "Mz"))})
    tracks = error_reduction.tracks_of([evidence_of(base, table)], {"a": table}, [0.5])
    found = error_reduction.simulated_errors(tracks, extended, base)
    plain, trimmed = (error_reduction.end_table(tracks, found[line], [0.5]) for line in error_reduction.SPEED_LINES)
    later = trimmed["start"] > error_reduction.TRIM_S + error_reduction.MARGIN
    for name in ("rate x", "rate y"):
        assert trimmed[name][later].max() < 0.01 * plain[name][later].min()


def test_a_trim_pushes_a_model_of_another_mass_as_the_flight_was_pushed():
    """A force F pushes the vehicle with F/m, which is read as F m_c/m by the configured mass m_c, whatever an earlier
    gap found the mass to be."""
    document, heavy = made_model(reaction=0.0).document, 0.47
    base = Model(
        {
            **document,
            "airframe": {**document["airframe"], "mass": heavy},
            CONFIGURED_MASS_KEY: document["airframe"]["mass"],
        }
    )
    table = flown(moved(base, 0.05))
    read = {a: table[a] * document["airframe"]["mass"] / heavy for a in ("Fx", "Fy", "Fz")}
    evidence = evidence_of(Model(document), table.assign(**read))
    tracks = error_reduction.tracks_of([evidence], {"a": table}, [0.5])
    found = error_reduction.simulated_errors(tracks, base, base)
    plain, trimmed = (error_reduction.end_table(tracks, found[line], [0.5]) for line in error_reduction.SPEED_LINES)
    later = trimmed["start"] > error_reduction.TRIM_S + error_reduction.MARGIN
    assert trimmed["velocity z"][later].max() < 0.01 * plain["velocity z"].mean()


def test_errors_that_a_change_of_forces_moves_are_those_of_the_changed_model(model):
    wrong, table = moved(model, 0.05), flown(model)
    tracks = error_reduction.tracks_of([evidence_of(wrong, table)], {"a": table}, [0.2, 0.5])
    errors = error_reduction.simulated_errors(tracks, wrong, wrong)
    better = error_reduction.moved_errors(
        tracks, errors, lambda flight: flight.residual, lambda flight: flight.measured - predicted(model, flight)
    )
    for line in error_reduction.SPEED_LINES:
        assert np.abs(better[line][0]).max() < 0.02 * np.abs(errors["rollouts"][0]).max()


def predicted(model, flight):
    return model.predict_columns(pd.DataFrame(flight.columns))[["Fx", "Fy", "Fz", "Mx", "My", "Mz"]].to_numpy()


def test_shares_are_of_what_can_be_removed_and_silent_where_the_floor_holds_it_all():
    table = pd.DataFrame({"flight": "a", "start": np.arange(40) * 1.0, "horizon": 0.5, "rate x": 1.0})

    def share(last, floor, reached=None):
        tables = [table, *(table.assign(**{"rate x": e}) for e in (last, floor)), reached]
        return error_reduction.shares(*tables[:3], ["rate x"], tables[3])[0]

    row = share(0.8**0.5, 0.6**0.5)
    assert row["removable"] == pytest.approx(0.4)
    assert [row[k] for k in ("value", "low", "high")] == pytest.approx([0.5] * 3)
    assert share(0.8**0.5, 0.99)["value"] == 1.0
    assert share(1.0, 0.99)["value"] is None
    assert share(1.2, 0.6**0.5)["value"] == pytest.approx((1 - 1.44) / 0.4)
    # a yardstick is measured against the same removable error as the extension, which reached less than the floor here
    row = share(0.9**0.5, 0.99, table.assign(**{"rate x": 0.5**0.5}))
    assert row["removable"] == pytest.approx(0.5) and row["value"] == pytest.approx(0.2)


def test_what_a_cause_is_worth_is_told_by_line_channel_and_horizon(model):
    wrong, table = moved(model, 0.05), flown(model)
    evidence = evidence_of(wrong, table)
    yardsticks = error_reduction.Yardsticks(lambda f: f.measured - predicted(model, f))
    rolled = error_reduction.score(wrong, model, {"a": table}, [evidence], [0.2, 0.5], yardsticks)
    rows = error_reduction.worth(rolled, rolled["errors"]["before"], ("Fz", "My"), [0.2, 0.5])
    assert len(rows) == 8
    best = next(r for r in rows if (r["line"], r["quantity"], r["horizon"]) == ("rollouts", "velocity z", 0.5))
    assert best["value"] == pytest.approx(1.0, abs=0.01) and best["moved"] == pytest.approx(1.0, abs=0.01)
    assert set(rolled["rms"]) == {"before", "after", "noise_floor"}
    assert (
        rolled["rms"]["noise_floor"]["rollouts with trim"]["velocity z"]["0.5"]
        <= (rolled["rms"]["after"]["rollouts with trim"]["velocity z"]["0.5"])
    )


def test_the_first_picture_shows_what_falls_and_no_constant_error_that_stays():
    """Of a drag the picture had shown the vertical force, whose large constant error fell by a twentieth."""
    bins = pd.DataFrame({"where": "speed", "middle": [1.0, 2.0, 3.0], "std_before": 1.0})
    stays = bins.assign(channel="Fz", mean_before=20.0, mean_after=19.0)
    falls = bins.assign(channel="Fx", mean_before=[3.0, 4.0, 5.0], mean_after=0.5)
    grows = bins.assign(channel="Fy", mean_before=0.0, mean_after=9.0)
    assert surest(pd.concat([stays, falls, grows])) == ("Fx", "speed")
    assert surest(pd.concat([stays, grows])) is None
