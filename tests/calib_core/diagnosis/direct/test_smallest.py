"""The smallest size that is stated is found nine times in ten where it is put in."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.direct import smallest_direct
from stillcal.calib_core.diagnosis.direct.smallest import of_stamps_and_values, smallest_number
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import NINE_IN_TEN, Measured, of_measured
from stillcal.calib_core.diagnosis.model.records import Claims
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.stamps.clock import timing_findings
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE, N, TRIALS = 50.0, 3000, 100
SOUND = sound_phones()
NOMINAL = Claims(nominal_rate_hz=RATE)


def stream(t: np.ndarray) -> Samples:
    return Samples.checked(Sensor.ACCELEROMETER, t, np.zeros((t.size, 3)))


def jittered(rng: np.random.Generator, sigma: float) -> np.ndarray:
    return np.asarray(np.sort(np.arange(N) / RATE + rng.normal(0.0, sigma, N)))


def thinned(rng: np.random.Generator, fraction: float) -> np.ndarray:
    kept = rng.random(N) >= fraction
    return np.asarray((np.arange(N) / RATE + rng.normal(0.0, 1e-4, N))[kept])


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "put_in"), [("timestamp_jitter", jittered), ("dropped_samples", thinned)])
def test_the_smallest_size_is_found_nine_times_in_ten(
    effect: str, put_in: Callable[[np.random.Generator, float], np.ndarray]
) -> None:
    rng = np.random.default_rng(4)
    own = put_in(rng, 4e-4 if effect == "timestamp_jitter" else 0.0)
    size = {s.effect: s.value for s in of_stamps_and_values(stream(own), SOUND, RATE)}[effect]

    def share(times: float) -> float:
        found = [timing_findings(stream(put_in(rng, times * size)), NOMINAL, SOUND) for _ in range(TRIALS)]
        return float(np.mean([effect in {f.effect for f in one} for one in found]))

    assert 0.8 <= share(1.0) <= 0.99, "of 100 trials; 0.85 to 0.95 and more than one standard error"
    assert share(0.5) < 0.2


def test_more_samples_show_smaller_losses() -> None:
    short, long = (
        {s.effect: s.value for s in of_stamps_and_values(stream(np.arange(n) / RATE), SOUND, RATE)}
        for n in (1000, 100_000)
    )
    assert long["dropped_samples"] < 0.3 * short["dropped_samples"]


def test_a_loss_that_hardly_any_fault_is_as_large_as_says_why_it_is_not_shown() -> None:
    """Sound phones whose rate is not declared lose up to a quarter of their samples."""
    even = stream(np.arange(N) / RATE)
    undeclared, declared = (
        {s.effect: s.reason for s in of_stamps_and_values(even, SOUND, nominal)} for nominal in (None, RATE)
    )
    assert "real devices show up to 26%" in undeclared["dropped_samples"]
    assert declared["dropped_samples"] == ""


def test_what_no_size_shows_has_none() -> None:
    assert smallest_number(SOUND["excess_kurtosis"], lambda number, side: Measured(number, 50.0)) is None


@pytest.mark.parametrize("error", [0.001, 0.004])
def test_the_smallest_delay_that_motion_shows_is_told(error: float) -> None:
    """The built-in simulation's answer had none, though it looked for a delay."""
    exam = SimpleNamespace(is_table=False, claims=Claims(), streams=[], delay=Measured(0.0, error))
    (told,) = smallest_direct(cast(Examination, exam))
    assert (told.effect, told.sensor, told.unit) == ("accel_gyro_time_offset", "timing", "s")
    unlucky = (
        of_measured(Measured(x - NINE_IN_TEN * error, error), SOUND["time_offset"])
        for x in (told.value, 0.9 * told.value)
    )
    assert [seen.stated for seen in unlucky] == [True, False]
    exam.delay = None
    assert smallest_direct(cast(Examination, exam)) == []
