"""Campaigns: the made files against the truth, and the files in the repository against the campaign."""

import csv
import io
import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from plain_blackbox import Plain

from quasi import attitude, tables
from quasi.attitude import GRAVITY
from quasi.errors import ConfigError
from quasi_synthesis import campaign as campaigns
from quasi_synthesis.vehicle import base_vehicle, hover_factors

ROOT = Path(__file__).parents[2]
SHORT = {"duration": 18, "nuisance": 0.0, "noise": 0.0}


def make(profile="mixed", key="a", **changes):
    config = {"quadrotor": "MadeBeetle", "seed": 3, **SHORT, "flights": [{"key": key, "profile": profile}], **changes}
    campaign = campaigns.read_campaign(config, "test")
    return campaigns.make_flight(campaign, campaign.flights[0])


@pytest.fixture(scope="module")
def clean():
    return make()


@pytest.fixture(scope="module")
def usual():
    return make("aggressive", nuisance=1.0, noise=1.0, effects={"timestamp_fault": {"gaps": 2}})


def decoded(made):
    names, frames = Plain(made.onboard).frames()
    return names, np.array([row for kind, row in frames if kind in "IP"]), frames


def test_truth_is_consistent_with_newton_and_with_the_kinematics(clean):
    truth = clean.truth
    t = truth["t"].to_numpy()
    q = truth[["qw", "qx", "qy", "qz"]].to_numpy()
    v = truth[["vx", "vy", "vz"]].to_numpy()
    flying = (t > 6.5) & (t < 11.0)
    mass = clean.metadata["physics"]["mass"]
    force = attitude.rotate_inverse(q, np.gradient(v, t, axis=0) - [0, 0, GRAVITY]) * mass
    np.testing.assert_allclose(force[flying], truth.loc[flying, ["Fx", "Fy", "Fz"]], atol=0.05)
    rates = attitude.body_rates(q, t)
    np.testing.assert_allclose(rates[flying], truth.loc[flying, ["p", "q", "r"]], atol=0.02)
    inertia = np.array(clean.metadata["physics"]["inertia"])
    w, dw = truth[["p", "q", "r"]].to_numpy(), truth[["p_dot", "q_dot", "r_dot"]].to_numpy()
    moment = dw @ inertia.T + np.cross(w, w @ inertia.T)
    np.testing.assert_allclose(moment, truth[["Mx", "My", "Mz"]], atol=1e-9)
    np.testing.assert_allclose(truth[["ax", "ay", "az"]] * mass, truth[["Fx", "Fy", "Fz"]])


def test_the_flight_rests_takes_off_manoeuvres_and_lands(clean):
    truth = clean.truth
    rest = truth["t"] < 3.4
    assert np.abs(truth.loc[rest, ["w1", "w2", "w3", "w4"]].to_numpy()).max() == 0
    np.testing.assert_allclose(truth.loc[rest & (truth["t"] > 1), "az"], -GRAVITY, atol=1e-3)
    assert truth["z"].min() < -1.0 and truth["z"].iloc[-1] > -0.06
    assert clean.metadata["verdict"] == "flown"


def test_the_log_holds_the_truth_in_the_logs_axes_units_and_delays(clean):
    names, rows, _ = decoded(clean)
    column = {name: rows[:, k].astype(float) for k, name in enumerate(names)}
    truth = clean.truth
    assert len(rows) == len(truth) == 18000
    t = (column["time"] - column["time"][0]) * 1e-6
    np.testing.assert_allclose(t, truth["t"], atol=2e-6)

    def early(name, seconds):
        return np.interp(t - seconds, truth["t"], truth[name])

    # group delays: two PT1 at 250 and 500 Hz; two PT1 at 1.554 x 100 Hz
    gyro = 1 / (2 * math.pi * 250) + 1 / (2 * math.pi * 500)
    acc = 2 / (2 * math.pi * 100 * 1.5538)
    for k, (rate, axis, sign) in enumerate(zip("pqr", ("ax", "ay", "az"), (1, -1, -1))):
        error = column[f"gyroADC[{k}]"] - sign * np.degrees(early(rate, gyro))
        assert np.sqrt(np.mean(error**2)) < 2.0, rate  # deg/s: half a count, and what the filter takes from doublets
        error = column[f"accSmooth[{k}]"] / 2048 * GRAVITY - sign * early(axis, acc)
        assert np.sqrt(np.mean(error**2)) < 0.2, axis  # 0.1 of it is what the filter takes from throttle steps
    assert column["accSmooth[2]"][1000] == 2048
    for i in range(1, 5):
        expected = early(f"w{i}", clean.metadata["telemetry"]["age"] + 0.0) * 60 / (2 * math.pi) * 7 / 100
        assert np.abs(column[f"eRPM[{i - 1}]"] - expected)[20:].max() < 6
        command = (column[f"motor[{i - 1}]"] - 158) / (2047 - 158)
        # what the motors get is what was logged one loop earlier
        assert np.mean(np.abs(command[5:] - truth[f"command{i}"].to_numpy()[5:])) < 0.005
    np.testing.assert_allclose(column["vbatLatest"] / 100, truth["battery_voltage"], atol=0.0051)


def test_the_capture_shows_the_truth_at_the_stated_clock(clean):
    rows = [line.split(",") for line in clean.capture.split("\n")[7:] if line]
    time = np.array([float(r[1]) for r in rows])
    clock = clean.metadata["clock"]
    at = (time - clock["capture offset"]) / clock["capture rate"]
    inside = (at > 0) & (at < 17.9)
    xyz = np.array([[float(r[8]), -float(r[6]), -float(r[7])] for r in rows])  # x_E = z_G, y_E = -x_G, z_E = -y_G
    truth = clean.truth
    q = attitude.interpolate(truth[["qw", "qx", "qy", "qz"]].to_numpy(), truth["t"].to_numpy(), at)
    cg = np.column_stack([np.interp(at, truth["t"], truth[a]) for a in "xyz"])
    expected = cg + attitude.rotate(q, np.array([0, -0.01, -0.048]))
    np.testing.assert_allclose(xyz[inside], expected[inside], atol=2e-5)


def test_the_same_seed_makes_the_same_files_and_another_key_does_not(usual):
    again = make("aggressive", nuisance=1.0, noise=1.0, effects={"timestamp_fault": {"gaps": 2}})
    assert again.onboard == usual.onboard and again.capture == usual.capture
    other = make("aggressive", key="b", nuisance=1.0, noise=1.0)
    assert other.onboard != usual.onboard


def test_the_usual_flight_carries_its_faults_and_says_so(usual):
    _, rows, frames = decoded(usual)
    steps = np.diff(rows[:, 0])
    assert len(usual.metadata["lost spans"]) == 2 and (steps > 4).sum() == 2
    assert [f[1][0] for f in frames if f[0] == "E"] == [0, 30, 15, 255]
    assert usual.metadata["capture"]["faults"]["drop-outs"]
    drawn = usual.metadata["nuisance"]
    assert usual.metadata["physics"]["mass"] == pytest.approx(0.433 * drawn["mass"])
    assert drawn["mass"] != 1.0 and 0.1 <= drawn["gust"] <= 0.4
    assert usual.metadata["hover factors"]["thrust"] == pytest.approx(2.408e-7 * drawn["thrust factor"], rel=1e-3)
    assert usual.truth[["p_dot", "q_dot"]].abs().to_numpy().max() > 100


def test_vibration_and_noise_stay_out_when_switched_off_and_come_when_on(clean, usual):
    def rough(made):
        names, rows, _ = decoded(made)
        k = names.index("gyroUnfilt[0]")
        return np.std(np.diff(rows[8000:12000, k], n=2))

    assert rough(clean) < 2.0 < rough(usual)


def test_written_files_are_read_back(tmp_path, usual):
    campaigns.write_flight(usual, tmp_path / "a.bbl", tmp_path / "a.csv", tmp_path / "a.parquet")
    assert (tmp_path / "a.bbl").read_bytes() == usual.onboard
    truth = tables.read_table(tmp_path / "a.parquet")
    np.testing.assert_array_equal(truth["Fz"], usual.truth["Fz"])
    made = tables.read_made(tmp_path / "a.parquet")
    assert made["schema"] == "quasi.truth/1" and made["effects"]["timestamp_fault"]["gaps"] == 2
    assert tables.read_fields(tmp_path / "a.parquet")["thrust1"]["unit"] == "N"


def test_planted_effects_reach_the_flight():
    scaled = make("hover", effects={"rotor_speed_scale": {"scale": 1.1}, "clock_drift": {"rate": 1e-3}})
    names, rows, _ = decoded(scaled)
    erpm = rows[7000:11000, names.index("eRPM[0]")].mean() / (60 / (2 * math.pi) * 7 / 100)
    assert erpm / scaled.truth["w1"][7000:11000].mean() == pytest.approx(1.1, abs=2e-3)
    assert (rows[-1, 1] - rows[0, 1]) * 1e-6 == pytest.approx(17.999 * 1.001, abs=1e-4)
    assert scaled.truth["t"].iloc[-1] == pytest.approx(17.999 * 1.001, abs=1e-6)
    assert scaled.metadata["clock"]["capture rate"] == pytest.approx(1 / 1.001)
    heavy = make("hover", effects={"mass": {"mass": 0.47}, "payload_swing": {"mass": 0.02, "length": 0.4}})
    hanging = heavy.truth[(heavy.truth["t"] > 7) & (heavy.truth["t"] < 11)]
    assert hanging[[f"thrust{i}" for i in range(1, 5)]].sum(axis=1).mean() == pytest.approx(0.49 * GRAVITY, rel=0.03)


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"flight": []}, ["unknown key 'flight'", "'flights'"]),
        ({"flights": []}, ["'flights'", "a list of flights"]),
        ({"flights": [{"key": "a"}, {"key": "a"}]}, ["flight 2", "taken"]),
        ({"flights": [{"key": "a b"}]}, ["flight 1", "'a b'"]),
        ({"flights": [{"key": "a", "profil": "mixed"}]}, ["'profil'", "'profile'"]),
        ({"flights": [{"key": "a", "profile": "mixd"}]}, ["'mixd'", "'mixed'"]),
        ({"flights": [{"key": "a", "effects": {"winds": {}}}]}, ["flight 1", "'winds'", "'wind'"]),
        ({"flights": [{"key": "a"}], "log rate": 900}, ["'log rate'", "900"]),
        ({"flights": [{"key": "a"}], "nuisance": "much"}, ["'nuisance'", "'much'"]),
        ({"flights": ["a"]}, ["flight 1", "'key'"]),
    ],
)
def test_a_wrong_campaign_is_refused_by_name(config, words):
    with pytest.raises(ConfigError) as error:
        campaigns.read_campaign(config, "c")
    assert all(word in str(error.value) for word in words), str(error.value)


def test_a_flight_too_short_to_land_is_refused():
    with pytest.raises(ConfigError, match="18 s"):
        make(duration=10)


def test_a_flights_own_effects_win_over_the_campaigns():
    config = {
        "effects": {"wind": {"north": 1.0, "east": 2.0}},
        "flights": [{"key": "a"}, {"key": "b", "effects": {"wind": {"north": 3.0}, "tether": {"k": 0.1}}}],
    }
    first, second = campaigns.read_campaign(config).flights
    assert first.effects == {"wind": {"north": 1.0, "east": 2.0, "down": 0.0}}
    assert second.effects["wind"] == {"north": 3.0, "east": 2.0, "down": 0.0} and second.effects["tether"] == {"k": 0.1}


def test_logbook_and_configuration_in_the_repository_are_what_the_example_campaign_writes():
    campaign = campaigns.read_campaign(tables.read_json(ROOT / "config/synthesis/example.json"), "example")
    assert len(campaign.flights) >= 6
    for path, text in campaigns.project_files(campaign).items():
        assert (ROOT / path).read_text() == text, f"{path} differs; write it anew from the campaign"
    rows = list(csv.DictReader(io.StringIO(campaigns.logbook_csv(campaign))))
    for row, flight in zip(rows, campaign.flights):
        paths = campaigns.raw_paths(campaign, flight.key)
        assert f"{row['OB Path']}/{row['Onboard Name']}.bbl" == paths["onboard"]
        assert f"{row['Raw OT Path']}/{row['Raw OptiTrack Name']}.csv" == paths["capture"]


def monomials(variables: list[np.ndarray], degree: int) -> list[np.ndarray]:
    found = []
    for total in range(1, degree + 1):
        for pick in itertools.combinations_with_replacement(variables, total):
            found.append(np.prod(pick, axis=0))
    return found


def vertical_pool(truth) -> np.ndarray:
    """Every candidate of the manual's listing 17 for Fz, and its fixed terms and bias; scaled columns."""
    w = truth[["w1", "w2", "w3", "w4"]].to_numpy() / 2100.0
    left, front, spin = np.array([-1, -1, 1, 1]), np.array([-1, 1, -1, 1]), np.array([1, -1, -1, 1])
    u, v, down, p, q, r = (truth[c].to_numpy() / 5.0 for c in "uvwpqr")
    one, d_tot = np.ones(len(w)), w.sum(axis=1) - 4.0
    sets = [one, d_tot, *(abs(x) for x in (p, q, r, w**2 @ left, w**2 @ front, w**2 @ spin))]
    columns = [one, down, (w**2).sum(axis=1)]
    columns += [m * s for m in monomials([abs(u), abs(v), down], 4) for s in sets]
    columns += [m * s for m in monomials([abs(p), abs(q), abs(r)], 3) for s in (one, d_tot)]
    columns += monomials([d_tot], 4)
    return np.column_stack(columns)


@pytest.mark.slow
def test_the_full_polynomial_pool_leaves_a_percent_of_fz_unexplained_and_hover_thrust_follows_the_factor():
    config = tables.read_json(ROOT / "config/synthesis/example.json") | {"nuisance": 0.0, "noise": 0.0}
    campaign = campaigns.read_campaign(config, "example")
    parts = []
    for flight in campaign.flights[:3]:
        truth = campaigns.make_flight(campaign, flight).truth
        parts.append(truth[(truth["t"] > 9) & (truth["t"] < 84)].iloc[::16])
    pool = np.vstack([vertical_pool(part) for part in parts])
    pool /= np.abs(pool).max(axis=0)
    fz = np.concatenate([part["Fz"] for part in parts])
    left = fz - pool @ np.linalg.lstsq(pool, fz, rcond=1e-10)[0]
    assert np.sqrt(np.mean(left**2) / np.mean(fz**2)) > 0.01
    squares = np.concatenate([(part[["w1", "w2", "w3", "w4"]] ** 2).sum(axis=1) for part in parts])
    kappa = -(fz @ squares) / (squares @ squares)
    assert kappa == pytest.approx(hover_factors(base_vehicle().physics)["thrust"], rel=0.02)
