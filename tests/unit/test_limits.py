"""A made flight beyond its gyro's range, from the raw log on: named with times, in metadata, notes and verdict."""

import numpy as np
import pytest
from made_recordings import written

from quasi.errors import DataError
from quasi.importing.flight import import_flight
from quasi.importing.limits import End, describe_clipping, facts, spoiled
from quasi_synthesis import campaign as campaigns


def flown(folder, monkeypatch, limit):
    """An aggressive flight whose gyro's range is `limit` rad/s, and what the import is to read."""
    nominal = campaigns.nominal

    def narrow(*arguments):
        setup = nominal(*arguments)
        return setup._replace(inertial=setup.inertial._replace(gyro_range=limit))

    monkeypatch.setattr(campaigns, "nominal", narrow)
    campaign = campaigns.read_campaign(
        {"duration": 40.0, "nuisance": 0.0, "flights": [{"key": "a", "profile": "aggressive", "seed": 5}]}
    )
    flight = campaigns.make_flight(campaign, campaign.flights[0])
    return flight, written(folder, "a", flight), campaigns.quadrotor_configuration(campaign)


def test_a_clipped_gyro_is_named_with_times_in_notes_metadata_and_verdict(tmp_path, monkeypatch):
    flight, asked, quadrotor = flown(tmp_path, monkeypatch, 10.0)
    frame, about = import_flight(asked, quadrotor, {})
    found = about["saturation"]["p +"]
    assert found["level"]["value"] == pytest.approx(10.0, abs=0.02) and found["full scale"] is None
    truth = flight.truth
    t = truth["t"].to_numpy() - about["start"]["value"]
    beyond = truth["p"].to_numpy() > 10.3
    covered = np.zeros(len(t), bool)
    for a, b in found["spans"]:
        covered |= (t > a - 0.004) & (t < b + 0.004)
    assert beyond.sum() > 100 and covered[beyond].mean() > 0.98
    assert about["verdict"] == "usable with care" and "the gyro (p, q) was clipped" in about["verdict because"]
    assert any("gyro channel 'p' is clipped at 573" in note for note in about["notes"])
    marked = frame["imu_clipped"].to_numpy() > 0
    assert np.interp(frame["t"], t, beyond.astype(float))[~marked].max() < 0.5 and marked.mean() < 0.05


def test_a_gyro_too_narrow_for_the_clocks_to_be_tied_is_said(tmp_path, monkeypatch):
    _, asked, quadrotor = flown(tmp_path, monkeypatch, 4.3)
    with pytest.raises(DataError, match="the gyro was clipped at the end of its range, which may be why"):
        import_flight(asked, quadrotor, {})


def test_spans_and_spoiled_grid_points():
    at = 10.0 + np.arange(500) / 500.0
    t = np.array([10.1, 10.101, 10.102, 10.5, 10.501, 12.0])
    notes: list[str] = []
    end = End("gyro", "q", -34.9, np.radians(2000.0), t, 0.001)
    found = facts([end], at, "flight", notes)["q -"]
    assert found["spans"] == [pytest.approx([0.1, 0.102]), pytest.approx([0.5, 0.501])]
    assert found["samples"] == 5 and found["seconds"] == pytest.approx(0.005)
    assert "its full scale of 2000 deg/s" in notes[0] and "at 0.10 to 0.10 s, 0.50 to 0.50 s" in notes[0]
    expected = [np.abs(t - x).min() < 0.005 for x in at]
    np.testing.assert_array_equal(spoiled([end], at), expected)
    assert describe_clipping({"q -": found}) == ["the gyro (q) was clipped at the end of its range for 0.005 s"]
    assert describe_clipping({}) == [] and not spoiled([], at).any()
