"""A clock whose rate swings is found by arrivals; sound clocks with every kind of delivery are silent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.stamps.clock_wander import wander

RATE, LENGTH = 50.0, 1800.0
WHERE = Where(0.0, LENGTH, (0.0, 25.0), "time stamps")
Array = np.ndarray


def swinging(t: Array, relative: float) -> Array:
    """Return what a clock is behind whose rate swings by +-`relative` with a period of 1100 s."""
    return np.asarray(np.cumsum(relative * np.sin(2.0 * np.pi * t / 1100.0)) / RATE)


def jumping(rng: np.random.Generator, t: Array) -> Array:
    jumps = rng.normal(0.0, 0.02, 8)
    return np.asarray((t[:, None] > rng.uniform(0.0, LENGTH, 8)) @ jumps)


DELIVERIES: dict[str, Callable[[np.random.Generator, Array], Array]] = {
    "at once": lambda _rng, t: 0.0 * t,
    "a crystal in a pocket": lambda _rng, t: swinging(t, 8e-6),
    "every second": lambda _rng, t: np.ceil(t) - t,
    "another buffer now and then": jumping,
    "a busy host from the middle on": lambda rng, t: rng.exponential(0.05, t.size) * (t > LENGTH / 2.0),
}


@pytest.mark.parametrize("kind", DELIVERIES)
def test_a_sound_clock_is_silent_however_its_samples_are_delivered(kind: str) -> None:
    t = np.arange(0.0, LENGTH, 1.0 / RATE)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        arrival = t + rng.exponential(0.002, t.size) + DELIVERIES[kind](rng, t)
        assert wander(t, np.maximum.accumulate(arrival), sound_phones()["clock_wander"], WHERE) is None


def test_a_clock_whose_rate_swings_is_found_and_sized() -> None:
    t, rng = np.arange(0.0, LENGTH, 1.0 / RATE), np.random.default_rng(1)
    behind = swinging(t, 3e-4)
    arrival = t + behind + rng.exponential(0.002, t.size) + jumping(rng, t)
    found = wander(t, np.maximum.accumulate(arrival), sound_phones()["clock_wander"], WHERE)
    assert found is not None and (found.effect, found.sensor) == ("unknown", "timing")
    low, high = found.parameters["relative"].ci95
    assert low < 3e-4 / np.sqrt(2.0) < high
    line = np.polyval(np.polyfit(t, behind, 1), t)
    assert found.parameters["swing"].value == pytest.approx(np.ptp(behind - line), rel=0.1)
