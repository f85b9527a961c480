"""A name that the stamps suggest stands only where samples and their count bear it out."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.sequence.stamps import gone_on, judged
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 50.0


def swinging(t: np.ndarray, stamps: np.ndarray) -> Samples:
    """Swing about all axes at 0.4 to 0.9 Hz, at times t, with noise."""
    phase = 2.0 * np.pi * np.outer(t, [0.4, 0.6, 0.9])
    return Samples.checked(
        Sensor.GYROSCOPE, stamps, np.sin(phase) + np.random.default_rng(2).normal(0.0, 1e-3, (t.size, 3))
    )


def named(effect: str) -> Finding:
    where = Where(0.0, 100.0, (0.0, 25.0), "time stamps")
    found = direct_finding(effect, "timing", [], where, {}, statement="", seen=DirectEvidence(50.0))
    assert found is not None
    return found


def test_gaps_over_which_motion_went_on_are_lost_samples_and_others_are_not() -> None:
    t = np.arange(5000) / RATE
    keep = np.ones(t.size, dtype=bool)
    keep[400::400] = False
    lost = swinging(t[keep], t[keep])
    leaping = swinging(t, t + 0.04 * (np.arange(t.size) // 400))
    assert gone_on(lost) == pytest.approx(1.0, abs=0.2)
    assert gone_on(leaping) == pytest.approx(0.0, abs=0.2)
    drops = named("dropped_samples")
    assert judged([drops], lost, [lost]) == [drops]
    (leap,) = judged([drops], leaping, [leaping])
    assert (leap.effect, leap.where.driver) == ("unknown", "stamps that leap")
    assert leap.evidence.log_bayes_factor == 50.0


def test_motion_that_speaks_for_both_takes_no_name_away() -> None:
    """Over a third of the gaps samples are missing, at the others stamps leap: 14 against 7 is no rule."""
    t = np.arange(9000) / RATE
    at = 40 * np.sort(np.random.default_rng(4).choice(np.arange(1, 225), 22, replace=False))
    leaps, losses = at[np.arange(22) % 3 != 2], at[np.arange(22) % 3 == 2]
    stamps = t + 0.04 * np.searchsorted(leaps, np.arange(t.size), side="right")
    keep = np.ones(t.size, dtype=bool)
    keep[losses] = False
    both = swinging(t[keep], stamps[keep])
    assert (gone_on(both) < 0.25).sum() > (gone_on(both) > 0.5).sum() + 4
    assert judged([named("dropped_samples")], both, [both]) == [named("dropped_samples")]


def test_gaps_that_no_motion_shows_are_lost_samples() -> None:
    t = np.arange(5000) / RATE
    noise = np.random.default_rng(1).normal(size=(t.size, 3))
    still = Samples.checked(Sensor.GYROSCOPE, t + 0.04 * (np.arange(t.size) // 400), noise)
    assert [f.effect for f in judged([named("dropped_samples")], still, [still])] == ["dropped_samples"]


@pytest.mark.parametrize(
    ("off", "driver"),
    [
        (np.random.default_rng(3).normal(0.0, 0.002, 5000), None),
        (0.008 * ((np.arange(5000) % 8) / 8.0 - 0.5), "count of the samples"),
        (0.008 * (np.random.default_rng(4).random(5000) < 0.01), "few late stamps"),
    ],
)
def test_stamps_scatter_only_where_each_is_off_by_itself(off: np.ndarray, driver: str | None) -> None:
    t = np.arange(5000) / RATE
    (found,) = judged([named("timestamp_jitter")], swinging(t, t + off), [])
    assert (found.effect, found.where.driver) == (
        ("timestamp_jitter", "time stamps") if driver is None else ("unknown", driver)
    )
