"""Flights that differ by a constant: slopes come from within flights as far as flights differ, and no further."""

import numpy as np
import pytest
import statsmodels.api as sm
from flights import AIRFRAME, HOVER, PITCH, flight

from quasi.identification import map_error
from quasi.identification.candidates import read_specification
from quasi.identification.fit import fit_axis
from quasi.identification.offsets import LessOffsets, fit_with_offsets, less_means, shares
from quasi.identification.partition import partition
from quasi.identification.products import Pool
from quasi.identification.shared import shared
from quasi.terms.expressions import parse


def made(seed, offset, flights=6, rows=400):
    """Columns with a constant last, target and series of flights whose regressors follow the flight's offset."""
    rng = np.random.default_rng(seed)
    columns, target, series = [], [], []
    for k in range(flights):
        n = rows + 40 * k
        shift = offset * rng.normal()
        # trim: the regressor's mean balances the flight's offset, as rotors do with a displaced cg
        x = np.column_stack([rng.normal(-shift / 2.0, 0.3, n), rng.normal(0.5, 1.0, n), np.ones(n)])
        columns.append(x)
        target.append(x @ [2.0, -0.7, 0.1] + shift + rng.normal(0.0, 0.5, n))
        series.append(np.arange(n))
    return np.concatenate(columns), np.concatenate(target), series


def test_tau_and_coefficients_equal_the_mixed_model_of_statsmodels():
    columns, target, series = made(3, 0.4)
    share = shares(columns, target, series)
    sizes = np.array([len(rows) for rows in series])
    psi = 1.0 - (1.0 - share) ** 2
    ratio = psi / (sizes * (1.0 - psi))  # of tau2 to the variance of a row, for residuals without memory
    groups = np.repeat(np.arange(len(sizes)), sizes)
    reference = sm.MixedLM(target, columns, groups).fit(reml=True)
    np.testing.assert_allclose(ratio, float(np.ravel(reference.cov_re)[0]) / reference.scale, rtol=0.1)
    both = less_means(np.column_stack([columns, target]), sizes, share)
    found = np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=None)[0]
    np.testing.assert_allclose(found, reference.fe_params, atol=0.02 * np.max(reference.bse_fe))


def test_a_share_of_the_means_is_generalised_least_squares():
    columns, target, series = made(4, 0.3, rows=60)
    sizes = np.array([len(rows) for rows in series])
    ratio = 0.02
    dense = np.eye(len(target))
    start = 0
    for n in sizes:
        dense[start : start + n, start : start + n] += ratio
        start += n
    inverse = np.linalg.inv(dense)
    expected = np.linalg.solve(columns.T @ inverse @ columns, columns.T @ inverse @ target)
    both = less_means(np.column_stack([columns, target]), sizes, 1.0 - 1.0 / np.sqrt(1.0 + ratio * sizes))
    np.testing.assert_allclose(np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=None)[0], expected, rtol=1e-8)


def test_products_less_means_are_those_of_the_columns_less_means():
    rng = np.random.default_rng(0)
    trees = [("number", 1.0), *(parse(e) for e in ("u", "v", "u*v", "u^2"))]
    blocks = [{n: rng.normal(3.0, 1.0, 300 + 50 * k) for n in "uv"} for k in range(3)]
    targets = [rng.normal(1.0, 1.0, len(b["u"])) for b in blocks]
    share, sizes = np.array([0.2, 0.7, 0.95]), [len(z) for z in targets]
    pool = Pool(trees, 2, blocks, targets)
    products = LessOffsets(pool, share)
    x = np.concatenate([[np.ones(len(b["u"])), b["u"], b["v"], b["u"] * b["v"], b["u"] ** 2] for b in blocks], axis=1).T
    x, z = (
        less_means(x - pool.shift, sizes, share),
        less_means(np.concatenate(targets) - pool.target_shift, sizes, share),
    )
    gram = np.array([products.cross(k).sum(axis=0) for k in range(5)])
    np.testing.assert_allclose(gram, x.T @ x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(products.square.sum(axis=0), np.diag(x.T @ x), rtol=1e-9)
    np.testing.assert_allclose(products.target.sum(axis=0), x.T @ z, rtol=1e-9, atol=1e-9)
    assert products.target_square.sum() == pytest.approx(z @ z)
    assert products.target_sum.sum() == pytest.approx(z.sum())
    part = products.subset([0, 1, 4])
    np.testing.assert_allclose(part.cross(2).sum(axis=0), (x.T @ x)[4, [0, 1, 4]], rtol=1e-9, atol=1e-9)


def test_products_less_bends_are_those_of_targets_less_what_thrust_changes_of_offsets():
    rng = np.random.default_rng(2)
    trees = [("number", 1.0), *(parse(e) for e in ("u", "v", "u*v"))]
    blocks = [{n: rng.normal(3.0, 1.0, 300 + 50 * k) for n in "uv"} for k in range(3)]
    targets = [rng.normal(5.0, 1.0, len(b["u"])) for b in blocks]
    shapes = [b["u"] / b["u"].mean() for b in blocks]
    offsets = np.array([0.4, -1.3, 2.0])
    found = Pool(trees, 2, blocks, targets, shapes=shapes).less_bends(offsets)
    expected = Pool(trees, 2, blocks, [z - o * (g - 1.0) for z, o, g in zip(targets, offsets, shapes)])
    # both are kept about means over all rows, which offsets of mean 0 leave as they were
    assert found.target_shift == pytest.approx(expected.target_shift)
    for name in ("target", "target_square", "target_sum", "square"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-9)
    theta = np.array([0.3, 1.0, -0.5, 0.1])
    np.testing.assert_allclose(found.residuals(range(4), theta), expected.residuals(range(4), theta), rtol=1e-9)


def test_slopes_are_right_within_their_errors_where_trim_balances_offsets():
    inside, off = [], []
    for seed in range(60):
        columns, target, series = made(seed, 0.5)
        fit = fit_with_offsets(columns[:, :-1], target, series)
        std = np.sqrt(np.diag(fit.covariance))
        inside.append(np.abs(fit.coefficients[:2] - [2.0, -0.7]) < 2.0 * std[:2])
        off.append(abs(np.linalg.lstsq(columns, target, rcond=None)[0][0] - 2.0))
    assert 0.88 <= np.mean(inside) <= 0.99
    assert np.median(off) > 0.3  # one intercept for all flights: a quarter of the slope is missing


def test_flights_at_constant_speeds_keep_what_they_show_between_them():
    """As in a wind tunnel: a speed per flight, hardly any variation within it."""
    rng = np.random.default_rng(1)
    speeds = np.linspace(-6.0, 6.0, 9)
    errors, taken = [], []
    for _ in range(30):
        x = [np.column_stack([rng.normal(v, 0.05, 500), np.ones(500)]) for v in speeds]
        z = np.concatenate([part @ [-0.3, 0.2] + rng.normal(0.0, 0.2, 500) for part in x])
        series = [np.arange(500)] * len(x)
        columns = np.concatenate(x)
        fit = fit_with_offsets(columns[:, :1], z, series)
        plain = sm.OLS(z, columns).fit()
        errors.append([fit.coefficients[0] + 0.3, plain.params[0] + 0.3])
        taken.append(shares(columns, z, series).mean())
    random, plain = np.std(errors, axis=0)
    assert random < 1.3 * plain
    assert np.median(taken) < 0.3


def test_one_flight_has_no_offset_and_neither_has_a_fit_without_errors():
    columns, target, series = made(0, 0.5, flights=1)
    assert shares(columns, target, series).tolist() == [0.0]
    columns, _, series = made(0, 0.0)
    assert shares(columns, columns @ [2.0, -0.7, 0.1], series).tolist() == [0.0] * 6


@pytest.fixture(scope="module")
def seated():
    """Flights with a battery seated elsewhere, whose moment about y the rotors balance: the moment stays as it was."""
    flights = {key: flight(seed, rows=4000) for seed, key in enumerate("abcdef")}
    for table, moment in zip(flights.values(), (0.03, -0.04, 0.015, 0.05, -0.03, -0.02)):
        speeds = table[["w1", "w2", "w3", "w4"]].to_numpy()
        side = np.sign(AIRFRAME.hubs[:, 0])
        thrust = (speeds**2).sum(axis=1, keepdims=True)
        table[["w1", "w2", "w3", "w4"]] = np.sqrt(speeds**2 - side * moment * thrust / thrust.mean() / (4.0 * PITCH))
    return flights


def test_the_lever_is_right_though_a_battery_is_seated_elsewhere_every_flight(seated):
    specification = read_specification({"My": {"fixed": ["U_q", "q"], "candidates": []}}, "My", "s.json", True)
    known = {"hover speed": {"value": HOVER}}
    for config, right in (({}, True), ({"entry test": "F"}, False)):
        found = fit_axis("My", seated, partition(seated), AIRFRAME, known, config, specification)
        lever = next(t for t in found["terms"] if t["name"] == "U_q")
        assert (abs(lever["coefficient"] - PITCH) < 3.0 * lever["std"] < 0.05 * PITCH) == right
        taken = list(found["share of flight means taken off"].values())
        assert (min(taken) > 0.9) if right else (max(taken) == 0.0)


def test_a_flight_without_usable_rows_leaves_the_others_as_they_are(seated):
    specification = read_specification({"My": {"fixed": ["U_q", "q"], "candidates": []}}, "My", "s.json", True)
    lost = {key: table.assign(My=np.nan) if key == "b" else table for key, table in seated.items()}
    known, found = {"hover speed": {"value": HOVER}}, []
    for flights in (lost, {key: table for key, table in seated.items() if key != "b"}):
        axis = fit_axis("My", flights, partition(flights), AIRFRAME, known, {}, specification)
        axis["share of flight means taken off"].pop("b", None)
        found.append(axis)
    assert found[0]["share of flight means taken off"] == pytest.approx(
        found[1]["share of flight means taken off"], rel=1e-4
    )
    for one, other in zip(*(f["terms"] for f in found)):
        assert one["coefficient"] == pytest.approx(other["coefficient"], rel=1e-9)
        assert one["std"] == pytest.approx(other["std"], rel=1e-6)


def test_so_is_the_simple_model(seated):
    found = shared(seated, partition(seated), AIRFRAME)
    kappa = found["simple model"]["kappaMy"]
    assert abs(kappa["value"] - PITCH) < 3.0 * kappa["std"] < 0.05 * PITCH


def test_no_term_stands_for_the_places_of_batteries(seated):
    """Wind that differs from flight to flight as the places do may not be taken for them."""
    seated = {key: table.assign(u=table["u"] + wind, v=table["v"] - wind)
              for (key, table), wind in zip(seated.items(), (2.0, -3.0, 1.5, 3.5, -1.0, -3.0))}  # fmt: skip
    section = {
        "fixed": ["U_q", "q"],
        "candidates": [{"vars": ["u", "v", "w", "p", "r"], "degree": 2, "sets": [1, "U_q", "w_tot"]}],
    }
    specification = read_specification({"My": section}, "My", "s.json", True)
    found = fit_axis("My", seated, partition(seated), AIRFRAME, {"hover speed": {"value": HOVER}}, {}, specification)
    assert [t["name"] for t in found["terms"]] == ["bias", "U_q", "q"]


def test_the_error_of_a_map_moves_coefficients_as_a_fit_anew_does(seated, monkeypatch):
    """Speeds that a map makes a little higher, and by more in one flight: both with intercepts of their own."""
    specification = read_specification({"My": {"fixed": ["U_q", "q"], "candidates": []}}, "My", "s.json", True)
    roles, known = partition(seated), {"hover speed": {"value": HOVER}}

    def speeds(drive):
        rotors = ["w1", "w2", "w3", "w4"]
        return {
            k: t.assign(**{w: t[w] * (1.0 + drive["moved"] * (1.0 + 0.5 * i)) for w in rotors})
            for i, (k, t) in enumerate(seated.items())
        }

    step, variance = 1e-3, 4.0
    monkeypatch.setattr(map_error, "moved_drives", lambda _: [({"moved": step}, {"moved": -step}, 2.0 * step)])
    ends = [fit_axis("My", speeds({"moved": x}), roles, AIRFRAME, known, {}, specification) for x in (step, -step)]
    slope = np.subtract(*([t["coefficient"] for t in end["terms"]] for end in ends)) / (2.0 * step)
    result = fit_axis("My", seated, roles, AIRFRAME, known, {}, specification)
    plain = np.array(result["covariance"])
    made = map_error.add_map_error(result, "My", {"covariance": [[variance]]}, speeds, roles, AIRFRAME, HOVER)
    added = np.diag(np.array(made["covariance"]) - plain)
    np.testing.assert_allclose(added, variance * slope**2, rtol=0.02)
