"""The smallest size that is stated is found nine times in ten: effects of that size are put in."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import sought
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Claims
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.search import forward
from stillcal.calib_core.streams.samples import Samples, Sensor

G = 9.80665
TRIALS = 12


def rests(seed: int) -> Bins:
    """Twenty-four bins in eight attitudes, warming and cooling by 8 K, with white noise only."""
    rng = np.random.default_rng(seed)
    up = rng.normal(size=(8, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    rest, t = np.repeat(np.arange(8), 3), 20.0 * np.arange(24) + 5.0
    return Bins(
        t=t,
        duration=np.full(24, 10.0),
        rest=rest,
        force=G * up[rest] + rng.normal(0.0, 1e-3, (24, 3)),
        force_variance=np.full((24, 3), 1e-6),
        vibration=np.ones(24),
        activity=np.stack([t, np.zeros(24)], axis=1),
        span=(0.0, float(t[-1] + 5.0)),
        rate=rng.normal(0.0, 1e-4, (24, 3)),
        rate_variance=np.full((24, 3), 1e-8),
        temperature=25.0 + 4.0 * np.sin(t / 80.0),
    )


def examined(bins: Bins) -> Examination:
    none = Samples.checked(Sensor.ACCELEROMETER, np.empty(0), np.empty((0, 3)))
    return Examination(none, None, Claims(), bins, [], by_sensor(bins, G)[1:], None, None, [])


@cache
def smallest(seed: int) -> float:
    rows = [row for one in sought(examined(rests(seed))) for row in one.smallest]
    return min(r.value for r in rows if (r.effect, r.parameter) == ("gyro_bias_temperature", "slope"))


@pytest.mark.slow
@pytest.mark.parametrize(("share", "least", "most"), [(1.0, 9, 12), (0.4, 0, 4)])
def test_an_effect_of_the_stated_size_is_found_nine_times_in_ten(share: float, least: int, most: int) -> None:
    """Of twelve nine or more are found (all but 1 time in 60, at 90 %); at two fifths of the size few are."""
    found = 0
    for seed in range(TRIALS):
        bins = rests(seed)
        assert bins.temperature is not None and bins.rate is not None
        warm = bins.temperature - bins.temperature.mean()
        added = np.outer(warm, share * smallest(seed) * np.eye(3)[seed % 3])
        residuals = examined(replace(bins, rate=bins.rate + added)).sensors[0]
        found += bool(forward(residuals, [BiasTemperature("gyro")]))
    assert least <= found <= most


def test_a_size_that_no_device_has_is_not_stated() -> None:
    """With twenty times the noise a slope shows over 8 K; over 2.4 K none that one in ten phones has."""
    bins = rests(1)
    assert bins.temperature is not None and bins.rate is not None and bins.rate_variance is not None
    loud = replace(bins, rate=20.0 * bins.rate, rate_variance=400.0 * bins.rate_variance)
    steady = replace(loud, temperature=25.0 + 0.3 * (bins.temperature - 25.0))
    stated = [{r.effect for one in sought(examined(b)) for r in one.smallest} for b in (loud, steady)]
    assert "gyro_bias_temperature" in stated[0] and "gyro_bias_temperature" not in stated[1]
    assert "gyro_bias_step" in stated[1]


def test_what_a_recording_could_be_asked_for_is_worked_out_once_and_anew_where_it_changes() -> None:
    exam = examined(rests(1))
    once = sought(exam)
    assert sought(exam) is once and once
    assert sought(replace(exam, sensors=[])) == []


def test_an_axis_across_gravity_in_every_rest_is_said_not_to_show_what_its_support_does_too() -> None:
    """Three long rests about x, which warm as a support gives way; y and z are along gravity in turn."""
    tilt, per = np.array([0.0, 0.6, -0.9]), 60
    up = np.column_stack([np.zeros(3), np.sin(tilt), np.cos(tilt)])
    rest, t = np.repeat(np.arange(3), per), 10.0 * np.arange(3 * per) + 5.0
    rng = np.random.default_rng(4)
    lying = Bins(
        t=t,
        duration=np.full(t.size, 10.0),
        rest=rest,
        force=G * up[rest] + rng.normal(0.0, 1e-3, (t.size, 3)),
        force_variance=np.full((t.size, 3), 1e-6),
        vibration=np.ones(t.size),
        activity=np.stack([t, np.zeros(t.size)], axis=1),
        span=(0.0, float(t[-1] + 5.0)),
        temperature=45.0 - 20.0 * np.exp(-t / 500.0),
    )
    residuals = by_sensor(lying, G)[0]
    none = Samples.checked(Sensor.ACCELEROMETER, np.empty(0), np.empty((0, 3)))
    exam = Examination(none, None, Claims(), lying, [], [residuals], None, None, [])
    rows = [row for one in sought(exam) for row in one.smallest]
    slope = next(r for r in rows if (r.effect, r.parameter) == ("accel_bias_temperature", "slope"))
    assert slope.hidden == ("x",)
    told = Comparison(smallest=rows).on_some_axes()
    reason = "not on x: the attitudes and turns do not show it there"
    assert ("accel_bias_temperature", reason) in {(one.effect, one.reason) for one in told}
    everywhere = [row for one in sought(examined(rests(1))) for row in one.smallest]
    assert Comparison(smallest=everywhere).on_some_axes() == []
