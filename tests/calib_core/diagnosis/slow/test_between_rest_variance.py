"""A bias that is another in every rest: found where it is, and told from the Earth and from names."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.inference.likelihood import reduce_residuals
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.slow.between_rest_variance import DRIVER, jumps
from stillcal.calib_core.diagnosis.slow.search import ranking
from tests.support.diagnosis import nulls
from tests.support.diagnosis.said import slow_findings

SIZE = np.array([6e-4, 6e-4, 6e-4])


def short_rests(seed: int) -> tuple[np.random.Generator, nulls.Day]:
    """Draw a day of twenty rests and more."""
    rng = np.random.default_rng([seed, 77])
    while True:
        day = nulls.schedule(rng)
        if day.rest.max() > 20 and np.unique(day.up.round(1), axis=0).shape[0] > 12:
            return rng, day


def by_rest(rng: np.random.Generator, day: nulls.Day, size: np.ndarray) -> np.ndarray:
    """Return an error (seconds, 3) that is drawn anew for every rest."""
    return np.asarray(rng.normal(size=(day.rest.max() + 2, 3))[day.rest] * size)


def found(seed: int, family: str, size: np.ndarray, slope: float = 0.0) -> list[Finding]:
    rng, day = short_rests(seed)
    error = by_rest(rng, day, size) + slope * (day.temperature - day.temperature.mean())[:, None]
    return slow_findings(by_sensor(nulls.bins_of(rng, day, family, gyro_error=error), nulls.G)[1])


@pytest.mark.slow
def test_jumps_are_found_as_large_as_they_are() -> None:
    findings = found(1, "flicker", SIZE)
    assert [(f.effect, f.where.driver) for f in findings] == [("unknown", DRIVER)]
    low, high = np.array(findings[0].parameters["size"].ci95).T
    assert (low < SIZE).all() and (high > SIZE).all()
    assert findings[0].axes == ["x", "y", "z"]


def test_jumps_are_as_large_on_a_support_that_turns() -> None:
    """Many courses are free within its rests, which take nothing off their means."""
    rng, day = short_rests(1)
    turn = 0.05 * 2.0 * np.pi / 180.0 * np.cos(2.0 * np.pi * day.t / 180.0)
    error = by_rest(rng, day, SIZE) + day.up * turn[:, None]
    findings = slow_findings(by_sensor(nulls.bins_of(rng, day, "white", gyro_error=error), nulls.G)[1])
    assert [f.where.driver for f in findings] == [DRIVER]
    size = np.array(findings[0].parameters["size"].value)
    assert (size < 2.0 * SIZE).all() and (size > 0.5 * SIZE).all(), size


@pytest.mark.slow
def test_what_towers_above_the_jumps_keeps_its_name_and_what_does_not_loses_it() -> None:
    large, small = found(2, "white", SIZE, 1.5e-3), found(2, "white", SIZE, 1e-4)
    assert {f.effect for f in large} == {"gyro_bias_temperature", "unknown"}
    assert {f.where.driver for f in small} == {DRIVER}


@pytest.mark.slow
def test_the_earth_and_all_wander_are_no_jumps() -> None:
    for family in nulls.FAMILIES:
        for seed in range(3):
            rng, day = short_rests(10 + seed)
            for residuals in by_sensor(nulls.bins_of(rng, day, family), nulls.G):
                assert jumps(residuals, [], reduce_residuals(residuals)) is None, (
                    family,
                    seed,
                )


def test_a_heading_that_is_a_matter_of_attitude_is_no_g_sensitivity(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the equator, as if the phone were turned about one line only: the Earth's rate is linear in up."""

    def turned_about_one_line(rng: np.random.Generator, day: nulls.Day) -> np.ndarray:
        aside = np.cross(day.up, rng.normal(size=3))
        length = np.linalg.norm(aside, axis=1, keepdims=True)
        return np.asarray(nulls.EARTH * aside / np.maximum(length, 1e-12))

    monkeypatch.setattr(nulls, "earth", turned_about_one_line)
    entries = [e for e in effects_of("gyro") if e.name == "gyro_g_sensitivity"]
    for seed in range(6):
        rng, day = short_rests(20 + seed)
        ranked = ranking(by_sensor(nulls.bins_of(rng, day, "white"), nulls.G)[1], entries)
        assert not ranked or ranked[0].score < thresholds.SCORE
