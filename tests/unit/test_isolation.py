"""Regions of excitation on signals whose manoeuvres are known, against a plain row-by-row version."""

import numpy as np
import pandas as pd
import pytest
from flights import AIRFRAME, flight
from made_model import SHARED, TERMS, part
from programs import script

from quasi.airframe import to_plain
from quasi.errors import DataError
from quasi.identification.isolation import excited, peaked, varied, widened
from quasi.identification.partition import EXCITED, PARTITION_UNITS, TRAINING, UNUSED, from_table, partition, to_table
from quasi.tables import read_json, write_json, write_table


def plain_varied(values, threshold, spread):
    n = len(values)
    window = max(int(0.01 * n), 2)
    history = np.concatenate([values[1:window][::-1], values])
    deviation = np.array([np.std(history[k : k + window]) for k in range(n)])
    kept = sorted(deviation)[: n - int(0.05 * n)]
    return plain_widened(deviation >= threshold * kept[-1], int(spread * n))


def plain_widened(rows, reach):
    out = np.zeros(len(rows), bool)
    for k in np.flatnonzero(rows):
        out[max(k - reach, 0) : k + reach + 1] = True
    return out


def plain_peaked(values, threshold, spread, floor):
    size = np.abs(values)
    hits = np.zeros(len(values), bool)
    for k in range(1, len(values) - 1):
        if not size[k - 1] < size[k] > size[k + 1]:
            continue
        # prominence: how far down on either side before something higher comes
        left = k
        while left > 0 and size[left - 1] <= size[k]:
            left -= 1
        right = k
        while right < len(size) - 1 and size[right + 1] <= size[k]:
            right += 1
        prominence = size[k] - max(size[left : k + 1].min(), size[k : right + 1].min())
        hits[k] = size[k] >= max(floor, 0.5 * threshold * size.max()) and prominence >= 0.9 * threshold * size.max()
    return plain_widened(hits, int(spread * len(values)))


def signal(seed, n=1500):
    r = np.random.default_rng(seed)
    t = np.arange(n) / n
    bumps = np.exp(-((t - 0.3) ** 2) / 2e-4) - 0.8 * np.exp(-((t - 0.7) ** 2) / 3e-4)
    return 0.02 * r.standard_normal(n) + bumps


@pytest.mark.parametrize(("threshold", "spread"), [(0.5, 0.02), (0.15, 0.0), (0.9, 0.1), (0.0, 0.01), (1.0, 0.02)])
def test_both_algorithms_equal_their_plain_versions(threshold, spread):
    for seed in range(3):
        values = signal(seed)
        np.testing.assert_array_equal(
            varied(values - 5, threshold, spread), plain_varied(values - 5, threshold, spread)
        )
        np.testing.assert_array_equal(
            peaked(values, threshold, spread, 0.1), plain_peaked(values, threshold, spread, 0.1)
        )


def test_widening_equals_its_plain_version():
    rows = np.random.default_rng(0).random(200) < 0.03
    for reach in (0, 1, 7, 300):
        np.testing.assert_array_equal(widened(rows, reach), plain_widened(rows, reach))


def test_manoeuvres_are_kept_and_hover_is_not():
    values = signal(1)
    for region in (varied(values, 0.5, 0.02), peaked(values, 0.5, 0.02, 0.0)):
        assert region[int(0.3 * 1500)]
        assert region[int(0.7 * 1500)]
        assert not region[700:800].any()
        assert 0.02 < region.mean() < 0.4
    assert not peaked(0.01 * signal(2), 0.5, 0.02, 0.02).any()  # a hover flight's noise is no manoeuvre
    assert not varied(np.full(500, 3.0), 0.5, 0.02).any()


def flights():
    table = pd.DataFrame({"t": np.arange(1500) / 500.0, "Fz": signal(3), "Mx": 0.2 * signal(4)})
    return {"a": table, "b": table.assign(Mx=1e-4 * signal(5))}


def test_only_training_rows_are_set_aside_and_each_axis_has_its_own():
    tables = flights()
    roles = partition(tables, options={"usable data ratio": 1.0, "partition ratio": 0.6})
    roles["a"][:100] = UNUSED
    regions = excited(tables, roles, AIRFRAME, ["Fz", "Mx"], {"excitation threshold": 0.5, "spread": 0.02})
    table = to_table(roles, regions)
    counts = {key: len(t) for key, t in tables.items()}
    whole = from_table(table, counts)
    for axis in ("Fz", "Mx"):
        own = from_table(table, counts, axis)
        for key in tables:
            np.testing.assert_array_equal(
                own[key], np.where((roles[key] == TRAINING) & ~regions[axis][key], UNUSED, whole[key])
            )
    assert not (from_table(table, counts, "Mx")["b"] == TRAINING).any()
    assert np.any(regions["Fz"]["a"] != regions["Mx"]["a"])
    assert not regions["Fz"]["a"][:100].any()
    # an axis that isolation did not look at keeps its rows
    np.testing.assert_array_equal(from_table(table, counts, "Fx")["a"], whole["a"])


def test_no_training_rows_after_isolation_is_a_sentence():
    tables = {"b": flights()["b"]}
    roles = partition(tables)
    options = {"excitation threshold": 0.5, "spread": 0.02}
    table = to_table(roles, excited(tables, roles, AIRFRAME, ["Fz", "Mx"], options))
    with pytest.raises(DataError, match="Mx: no training rows are left after isolation.*lower 'excitation threshold'"):
        from_table(table, {"b": 1500}, "Mx")
    assert (from_table(table, {"b": 1500}, "Fz")["b"] == TRAINING).any()


def test_missing_axis_and_missing_values():
    tables = flights()
    tables["a"].loc[200:240, "Fz"] = np.nan
    roles = partition(tables, options={"random partition": False})
    options = {"excitation threshold": 0.5, "spread": 0.02}
    regions = excited(tables, roles, AIRFRAME, ["Fz"], options)
    assert not regions["Fz"]["a"][200:241].any()
    assert regions["Fz"]["a"].any()
    with pytest.raises(DataError, match="flight a has no column 'My'"):
        excited(tables, roles, AIRFRAME, ["My"], options)


def test_the_covered_region_is_that_of_the_rows_that_were_fitted(tmp_path):
    main = script("standalone_model").main
    table = flight(3, rows=2000).assign(u=np.linspace(0.0, 20.0, 2000))
    parts = {axis: part(axis, TERMS[axis]) for axis in ("Fx", "Fz")}
    # calm rows are 1200 on, and those of My, which the model does not identify
    regions = {"Fx": slice(0, 600), "Fz": slice(400, 1200), "My": slice(1500, 2000)}
    inside = {axis: {"a": np.isin(np.arange(2000), np.arange(2000)[where])} for axis, where in regions.items()}
    roles = partition({"a": table}, options={"usable data ratio": 1.0, "random partition": False})
    files = {key: str(tmp_path / key) for key in ("shared.json", "partition.parquet", "a.parquet", "model.json")}
    write_table(files["a.parquet"], table)
    write_json(files["shared.json"], {**SHARED, "airframe": to_plain(AIRFRAME), "logged to rad/s": None})
    for axis, found in parts.items():
        write_json(tmp_path / f"{axis}.json", found)

    units = PARTITION_UNITS | dict.fromkeys([f"{EXCITED}{axis}" for axis in regions], ("", "", "inside"))

    def covered(excitation):
        write_table(files["partition.parquet"], to_table(roles, excitation), units)
        main(
            [str(tmp_path / f"{axis}.json") for axis in parts], files["shared.json"], files["partition.parquet"],
            [files["a.parquet"]], {"validation": []}, {"file": None, "u": None}, "m", files["model.json"],
        )  # fmt: skip
        return read_json(files["model.json"])["envelope"]["u"]

    assert covered(None)["max"] == 20.0
    assert covered(inside)["min"] == 0.0 and covered(inside)["max"] == table["u"][1199]
