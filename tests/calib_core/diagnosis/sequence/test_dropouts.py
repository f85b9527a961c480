"""Values that drop to one and the same number, and jumps that look like it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.diagnosis.sequence.dropouts import dropouts
from stillcal.calib_core.diagnosis.sequence.findings import sequence_findings
from stillcal.calib_core.diagnosis.sequence.neighbours import without_outliers
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.hhar_still import recordings

N, RATE, LSB, NOISE = 30_000, 50.0, 0.0012, 0.01


def turned(seed: int = 0) -> Array:
    """Return ten minutes of a phone that is turned over for a second every twenty seconds, m/s^2."""
    t, rng = np.arange(N) / RATE, np.random.default_rng(seed)
    angle = np.floor(t / 20.0) + np.clip(t % 20.0, 0.0, 1.0)
    force = 9.8 * np.column_stack([np.sin(angle), np.cos(angle) * 0.6, np.cos(angle) * 0.8])
    return np.asarray(force + rng.normal(0.0, NOISE, (N, 3)))


def samples(force: Array, lsb: float = LSB) -> Samples:
    rounded = np.rint(force / lsb) * lsb
    return Samples(Sensor.ACCELEROMETER, frozen(np.arange(N) / RATE), frozen(rounded))


def said(force: Array) -> list[Finding]:
    made = samples(force)
    return sequence_findings(made, without_outliers(made), "accel", cut(made, None))


@pytest.mark.parametrize("value", [0.0, 3.0])
@pytest.mark.parametrize("length", [1, 2, 20])
def test_values_that_drop_are_told_with_their_share_and_are_no_stale_axes(value: float, length: int) -> None:
    force = turned()
    rows = np.random.default_rng(3).choice(N // 100, 60, replace=False) * 100 + 7
    rows = (rows[:, None] + np.arange(length)).ravel()
    force[rows, 2] = value
    (found,) = said(force)
    assert (found.effect, found.axes, found.where.driver) == ("unknown", ["z"], "single values")
    assert found.parameters["value"].value == pytest.approx(value)
    low, high = found.parameters["fraction"].ci95  # type: ignore[misc]
    assert low <= rows.size / N <= high, "but for drops from a value that is near by"


def test_where_nothing_was_read_all_axes_drop() -> None:
    force = turned()
    force[700::1000] = 0.0
    (found,) = said(force)
    assert found.axes == ["x", "y", "z"] and found.parameters["fraction"].value == pytest.approx(1e-3)


@pytest.mark.parametrize(("times", "stated"), [(1, False), (2, False), (4, True)])
def test_one_drop_may_end_anywhere_and_some_not_at_one_number(times: int, *, stated: bool) -> None:
    force = turned()
    force[np.arange(times) * 5000 + 333, 0] = 2.0
    finding, dropped = dropouts(samples(force), "accel")
    assert (finding is not None) == stated
    assert dropped.sum() == (times if stated else 0)


@pytest.mark.parametrize("lsb", [LSB, 0.15])
def test_knocks_end_elsewhere_each_and_at_a_limit_they_do_not_drop(lsb: float) -> None:
    rng, force = np.random.default_rng(5), turned()
    rows = rng.choice(N // 20, 400, replace=False) * 20 + 11
    force[rows] += rng.laplace(0.0, 3.0, (rows.size, 3))
    assert dropouts(samples(force, lsb), "accel")[0] is None
    assert dropouts(samples(np.clip(force, -11.0, 11.0), lsb), "accel")[0] is None


def test_real_phones_whose_values_hardly_change_are_silent(data_dir: Path) -> None:
    """Steps of 0.15 m/s^2 that most samples repeat: any other value is a jump, but a small one."""
    coarse = [r for r in recordings(data_dir / "hhar_still") if r.model == "Samsung-Galaxy-S+"]
    assert len(coarse) == 24
    for one in coarse:
        assert dropouts(one.samples, "accel")[0] is None


def test_where_a_shaken_axis_turns_back_is_no_value_that_was_not_read() -> None:
    """A table shakes the phone by a sine of a quarter of the sample rate, less far than it was turned."""
    t, rng = np.arange(N) / RATE, np.random.default_rng(0)
    force = turned()
    shaken = (t > 200.0) & (t < 260.0)
    still = np.array([force[shaken].mean(axis=0)]) + rng.normal(0.0, 0.002, (shaken.sum(), 3))
    force[shaken] = still + 3.0 * np.sin(2.0 * np.pi * 12.49 * t[shaken])[:, None] * [0.6, 0.8, 0.1]
    assert dropouts(samples(force, 0.0024), "accel")[0] is None
