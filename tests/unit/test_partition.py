"""Roles of rows: which train, test, validate."""

import numpy as np
import pandas as pd
import pytest

from quasi.errors import DataError
from quasi.identification.partition import TEST, TRAINING, UNUSED, VALIDATION, from_table, partition, to_table, usable


def flight(rows=1000, **more):
    return pd.DataFrame({"t": np.arange(rows) / 100.0, **more})


@pytest.mark.parametrize(
    ("rows", "ratio", "start", "stop"), [(1000, 0.9, 50, 950), (1000, 1.0, 0, 1000), (7, 0.5, 2, 5)]
)
def test_the_usable_part_is_centred(rows, ratio, start, stop):
    assert usable(rows, ratio) == slice(start, stop)


def test_random_samples_come_in_the_asked_ratio_and_with_the_seed():
    flights = {"a": flight(), "b": flight()}
    roles = partition(flights, [], {"usable data ratio": 0.9, "partition ratio": 0.75, "seed": 3})
    assert np.count_nonzero(roles["a"] == TRAINING) == 675
    assert np.count_nonzero(roles["a"] == TEST) == 225
    assert np.all(roles["a"][:50] == UNUSED)
    again = partition(flights, [], {"usable data ratio": 0.9, "partition ratio": 0.75, "seed": 3})
    np.testing.assert_array_equal(roles["a"], again["a"])
    assert np.any(roles["a"] != roles["b"])
    assert np.any(roles["a"] != partition(flights, [], {"seed": 4})["a"])


def test_another_flight_leaves_a_flights_draw_as_it_was():
    alone = partition({"a": flight()}, [])
    np.testing.assert_array_equal(alone["a"], partition({"b": flight(500), "a": flight()}, ["b"])["a"])


def test_validation_flights_neither_train_nor_test():
    roles = partition({"a": flight(), "b": flight()}, ["b"])
    assert set(roles["b"]) == {UNUSED, VALIDATION}
    assert not np.any(roles["a"] == VALIDATION)


def test_without_a_random_partition_every_usable_row_trains():
    roles = partition({"a": flight()}, [], {"random partition": False, "usable data ratio": 1})
    assert np.all(roles["a"] == TRAINING)


def test_blocks_stay_whole():
    roles = partition({"a": flight(2000)}, [], {"partition by": "blocks", "block length": 1.0, "usable data ratio": 1})
    by_block = roles["a"].reshape(-1, 100)
    assert np.all(by_block == by_block[:, :1])
    assert np.count_nonzero(by_block[:, 0] == TRAINING) == 15


def test_whole_flights_train_or_test():
    flights = {f"f{k}": flight(200) for k in range(8)}
    options = {"partition by": "flights", "partition ratio": 0.75, "usable data ratio": 1, "seed": 2}
    roles = partition(flights, ["f7"], options)
    kinds = {key: set(codes) for key, codes in roles.items()}
    assert all(len(k) == 1 for k in kinds.values())
    assert kinds["f7"] == {VALIDATION}
    assert sum(k == {TRAINING} for k in kinds.values()) == 5  # of seven
    assert sum(k == {TEST} for k in kinds.values()) == 2
    again = partition(flights, ["f7"], options)
    assert all(np.array_equal(roles[k], again[k]) for k in roles)
    drawn = {frozenset(k for k, c in partition(flights, ["f7"], {**options, "seed": s}).items() if c[0] == TEST)
             for s in range(8)}  # fmt: skip
    assert len(drawn) > 3
    two = partition({k: flights[k] for k in ("f0", "f1")}, [], {**options, "partition ratio": 0.99})
    assert sorted(c[0] for c in two.values()) == [TRAINING, TEST]


def test_one_flight_alone_cannot_be_drawn_whole():
    with pytest.raises(DataError, match=r"one training flight only \(a\); add flights, or draw 'blocks'"):
        partition({"a": flight(200)}, [], {"partition by": "flights"})
    assert np.any(partition({"b": flight()}, ["b"], {"partition by": "flights"})["b"] == VALIDATION)


def test_rows_flagged_unusable_take_no_part():
    flags = np.ones(1000)
    flags[200:300] = 0.0
    roles = partition({"a": flight(valid=flags, in_flight=np.roll(flags, 300))}, [])
    assert np.all(roles["a"][200:300] == UNUSED)
    assert np.all(roles["a"][500:600] == UNUSED)


def test_no_training_rows_is_an_error():
    with pytest.raises(DataError, match="no training rows are left: no row of flight a is valid"):
        partition({"a": flight(valid=np.zeros(1000)), "b": flight()}, ["b"])
    # held-out flights alone have none to lose
    assert np.any(partition({"b": flight()}, ["b"])["b"] == VALIDATION)


def test_ratios_are_advised_only_where_they_are_the_cause():
    barren, ends = flight(valid=np.zeros(1000)), flight(valid=np.r_[np.ones(40), np.zeros(960)])
    with pytest.raises(DataError) as caught:
        partition({"a": barren, "c": barren}, because={"a": "it is not in flight (100 % of the flight)"})
    text = str(caught.value)
    assert "flight a is valid for identification: it is not in flight (100 % of the flight); no row of flight c" in text
    assert "results/reports/<quadrotor>/<flight>.html" in text and "ratio'" not in text
    with pytest.raises(DataError, match=r"flights a, e; no row of flight a is.*'usable data ratio' cuts off; raise it"):
        partition({"a": barren, "e": ends})
    with pytest.raises(DataError, match="in the flights f; raise 'partition ratio', or add flights"):
        partition({"f": flight()}, [], {"partition ratio": 0.0005})


def test_the_table_gives_the_partition_back():
    flights = {"a": flight(300), "b": flight(200)}
    roles = partition(flights, ["b"])
    table = to_table(roles)
    again = from_table(table, {"a": 300, "b": 200})
    for key in roles:
        np.testing.assert_array_equal(again[key], roles[key])
    with pytest.raises(DataError, match="flight a.* 10 rows"):
        from_table(table, {"a": 10})
