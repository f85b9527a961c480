"""A coarse thermometer's staircase is undone, noise does no harm, other thermometers are left alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.segments.static_bins import Bins, cut
from stillcal.calib_core.diagnosis.segments.thermometer import reconstructed
from stillcal.calib_core.streams.samples import Samples, Sensor

T = np.arange(0.0, 3600.0, 0.2)

Curve = Callable[[], np.ndarray]


def swinging() -> np.ndarray:
    """Temperature, degC: seven kelvins to and fro in 2000 s."""
    return np.asarray(25.3 + 3.5 * np.sin(2.0 * np.pi * T / 2000.0 + 0.4))


def warming() -> np.ndarray:
    """Temperature, degC: twelve kelvins, ever more slowly, and never back."""
    return np.asarray(20.1 - 12.0 * np.expm1(-T / 1500.0))


def charged() -> np.ndarray:
    """Temperature, degC, on the charger from 300 s to 1900 s: kinks, and first-order response of 500 s."""
    warm = 8.0 * -np.expm1(-np.clip(T - 300.0, 0.0, 1600.0) / 500.0)
    return np.asarray(22.2 + warm * np.exp(-np.clip(T - 1900.0, 0.0, None) / 500.0))


def rounded(values: np.ndarray, step: float) -> np.ndarray:
    return np.asarray(np.round(values / step) * step)


def off(found: np.ndarray, truth: np.ndarray) -> float:
    """Rms error, K, of what a slope is fitted to: bins of 18 s, about their mean."""
    return float((found - truth).reshape(-1, 90).mean(axis=1).std())


def noisy(values: np.ndarray, sd: float) -> np.ndarray:
    return np.asarray(values + np.random.default_rng(3).normal(0.0, sd, values.size))


def temperatures(column: np.ndarray | None) -> Bins:
    force = np.random.default_rng(1).normal(0, 0.005, (T.size, 3)) + np.array([0.0, 0.0, 9.81])
    return cut(Samples.checked(Sensor.ACCELEROMETER, T, force, temperature=column), None)


STEPS = pytest.mark.parametrize("step", [0.5, 1.0])


@STEPS
def test_a_curve_that_passes_levels_comes_back_several_times_better_than_its_staircase(step: float) -> None:
    stairs = rounded(warming(), step)
    assert off(reconstructed(T, stairs), warming()) < off(stairs, warming()) / 4.0


@STEPS
@pytest.mark.parametrize("curve", [swinging, charged])
def test_turning_points_and_both_ends_stay_within_the_level_shown(curve: Curve, step: float) -> None:
    truth = curve()
    stairs = rounded(truth, step)
    found = reconstructed(T, stairs)
    assert np.abs(found - stairs).max() < 0.5 * step + 1e-9
    assert off(found, truth) < off(stairs, truth) / 2.0


@STEPS
@pytest.mark.parametrize("curve", [warming, swinging, charged])
def test_flicker_between_two_levels_is_one_crossing(curve: Curve, step: float) -> None:
    truth = curve()
    clean, flickering = rounded(truth, step), rounded(noisy(truth, 0.05 * step), step)
    assert np.count_nonzero(np.diff(flickering)) > 3 * np.count_nonzero(np.diff(clean))
    assert off(reconstructed(T, flickering), truth) < off(flickering, truth) / 1.5


@pytest.mark.parametrize("at", [25.0, 25.2, 25.25, 25.4])
def test_noise_of_a_constant_temperature_makes_no_structure(at: float) -> None:
    truth = np.full(T.size, at)
    readings = rounded(noisy(truth, 0.03), 0.5)
    assert off(reconstructed(T, readings), truth) <= off(readings, truth) + 1e-12


def test_a_constant_temperature_stays() -> None:
    readings = np.full(T.size, 25.0)
    assert reconstructed(T, readings) is readings


def test_of_two_values_the_time_between_changes_tells() -> None:
    truth = 25.5 + 0.6 * np.sin(2.0 * np.pi * T / 1200.0 + 0.5)
    readings = np.where(truth < 25.5, 25.0, 26.0)
    assert off(reconstructed(T, readings), truth) < off(readings, truth) / 1.5


def test_of_one_change_a_ramp_is_made_no_step() -> None:
    found = reconstructed(T, np.where(T < 1800.0, 25.0, 26.0))
    np.testing.assert_allclose(found, 25.5 + (T - 1800.0) / 3600.0, atol=1e-3)


def test_across_a_gap_that_hides_changes_it_is_linear() -> None:
    truth = 20.2 + T / 200.0
    kept = (T < 1000.0) | (T > 1430.0)
    found = reconstructed(T[kept], rounded(truth, 1.0)[kept])
    inside = (T[kept] > 70.0) & (T[kept] < 3450.0)
    assert np.abs(found - truth[kept])[inside].max() < 0.5
    assert np.abs(found - truth[kept])[inside].mean() < 0.1


@pytest.mark.parametrize(
    "readings",
    [
        swinging(),
        rounded(swinging(), 0.1),
        rounded(noisy(swinging(), 0.03), 0.02),
        rounded(noisy(swinging(), 0.3), 1.0),
    ],
    ids=["unrounded", "tenths", "noisy", "dithered"],
)
def test_other_thermometers_stay_bit_for_bit(readings: np.ndarray) -> None:
    assert reconstructed(T, readings) is readings


def test_bins_have_the_reconstructed_temperature_also_where_readings_are_missing() -> None:
    stairs = rounded(warming(), 1.0)
    sparse = np.where(np.arange(T.size) % 25 == 0, stairs, np.nan)
    for column in (stairs, sparse):
        bins = temperatures(column)
        assert bins.temperature is not None
        truth, shown = np.interp(bins.t, T, warming()), np.interp(bins.t, T, stairs)
        assert np.std(bins.temperature - truth) < np.std(shown - truth) / 4.0
    assert temperatures(None).temperature is None
    assert temperatures(np.full(T.size, np.nan)).temperature is None


@pytest.mark.parametrize("held_s", [60, 120])
@pytest.mark.parametrize("curve", [swinging, warming, charged])
def test_readings_that_are_repeated_belong_to_the_first_moment(
    curve: Callable[[], np.ndarray], held_s: int
) -> None:
    """A thermometer that is read seldom, beside samples of other sensors, seemed late by half of it."""
    held = rounded(np.repeat(curve()[:: 5 * held_s], 5 * held_s), 0.1)
    assert off(reconstructed(T, held), curve()) < 0.4 * off(held, curve())


def test_temperatures_that_a_chamber_was_set_to_are_no_readings_of_a_slow_thermometer() -> None:
    held = np.repeat(20.0 + 10.0 * (np.arange(20) % 7), T.size // 20)
    np.testing.assert_array_equal(reconstructed(T[: held.size], held), held)


def test_a_thermometer_read_with_each_sample_is_left_alone() -> None:
    readings = rounded(warming(), 0.01)
    np.testing.assert_array_equal(reconstructed(T, readings), readings)


def test_readings_at_one_moment_are_left_alone() -> None:
    """Rows of a table of rests may share a time."""
    readings = 20.0 + np.arange(24.0) % 5
    assert reconstructed(np.zeros(24), readings) is readings


@pytest.mark.parametrize("shown", [85.0, 0.0])
def test_slips_of_a_thermometer_are_passed_over(shown: float) -> None:
    """Two seconds in ten minutes without a reading moved the temperature of a bin by kelvins."""
    slipping = np.where(T % 600.0 < 2.0, shown, swinging())
    slipping[T < 10.0] = swinging()[T < 10.0]
    assert np.abs(reconstructed(T, slipping) - swinging()).max() < 0.02


@pytest.mark.parametrize("part", [T < 3.0, T[-1] - T < 3.0, (T < 3.0) | (T[-1] - T < 3.0)])
def test_what_a_chip_tells_before_it_has_measured_or_at_the_end_is_passed_over(part: np.ndarray) -> None:
    found = reconstructed(T, np.where(part, 85.0, swinging()))
    assert np.abs(found - swinging()).max() < 0.1


def test_a_chip_may_tell_two_values_before_it_has_measured() -> None:
    found = reconstructed(T, np.where(T < 2.0, 85.0, np.where(T < 4.0, 0.0, swinging())))
    assert np.abs(found - swinging()).max() < 0.1


def test_a_tenth_of_a_recording_may_be_what_a_chip_tells_before_it_has_measured() -> None:
    t, truth = T[T < 40.0], swinging()[T < 40.0]
    assert np.abs(reconstructed(t, np.where(t < 3.0, 85.0, truth)) - truth).max() < 0.1


def test_readings_that_scatter_do_not_slip() -> None:
    readings = noisy(swinging(), 2.0)
    assert np.array_equal(reconstructed(T, readings), readings)


@pytest.mark.parametrize(("every", "passed"), [(30, True), (31, False)])
def test_a_first_reading_lasts_to_the_next_and_a_last_one_from_that_before(every: int, passed: bool) -> None:
    t = np.arange(0.0, 1800.0, every)
    for wrong in (0, -1):
        readings = 20.0 + 0.01 * np.arange(t.size)
        truth = readings.copy()
        readings[wrong] = 85.0
        assert bool(np.abs(reconstructed(t, readings) - truth).max() < 0.02) is passed


def test_a_bin_has_the_mean_of_all_readings_in_it() -> None:
    """Of five a second, of 1 K noise, one was taken: means of 18 s were off by 0.24 K."""
    bins, exact = temperatures(noisy(swinging(), 1.0)), temperatures(swinging())
    assert bins.temperature is not None and exact.temperature is not None
    assert np.std(bins.temperature - exact.temperature) == pytest.approx(1.0 / np.sqrt(18.0 * 5.0), rel=0.2)


def test_a_chamber_that_is_set_time_and_again_has_no_slip() -> None:
    """Levels of 29 s: each that was left out made the next one the first."""
    t = T[T < 600.0]
    steps = 20.0 + 12.0 * np.floor(t / 29.0)
    assert np.array_equal(reconstructed(t, steps), steps)


def test_a_chamber_that_is_set_at_the_start_is_no_slip() -> None:
    """Forty seconds at the first setting, and short recordings a good part of which is at either."""
    for t, change in ((T, 40.0), (T[T < 40.0], 20.0), (T[T < 100.0], 15.0)):
        steps = np.where(t < change, 60.0, 25.0)
        assert np.array_equal(reconstructed(t, steps), steps)


def test_a_temperature_that_was_set_and_set_back_is_left_alone() -> None:
    set_to = np.where(T % 600.0 < 560.0, 20.0, 35.0)
    assert np.array_equal(reconstructed(T, set_to), set_to)
