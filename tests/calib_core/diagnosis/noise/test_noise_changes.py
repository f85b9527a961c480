"""Noise whose level follows time, temperature or charging is found; what shakes the phone is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.low_pass import judged, quiet
from stillcal.calib_core.diagnosis.noise.noise_changes import by_force, changing, parabola_of_force
from stillcal.calib_core.diagnosis.noise.noise_level import levels
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor

Array = np.ndarray
RATE, LENGTH = 25.0, 2400.0
T = np.arange(round(RATE * LENGTH)) / RATE
WARM = 25.0 + 5.0 * np.sin(T / 400.0) + np.where(T % 900.0 < 350.0, 2.0, 0.0)
PLUGS = [Charging(t, bool(i % 2 == 0)) for i, t in enumerate(np.arange(200.0, LENGTH, 330.0))]
ON = (np.searchsorted([p.t for p in PLUGS], T, side="right") % 2).astype(float)
REST = (T // 80.0).astype(int)


def noise(seed: int) -> Array:
    return np.asarray(np.random.default_rng(seed).normal(0.0, 0.005, (T.size, 3)))


def forces() -> Array:
    """Return gravity (n, 3) in thirty rests of 80 s."""
    up = np.random.default_rng(1).normal(size=(REST.max() + 1, 3))
    return np.asarray(9.81 * (up / np.linalg.norm(up, axis=1, keepdims=True))[REST])


def found(white: Array, warm: Array = WARM) -> Finding | None:
    """Diagnose the accelerometer: the rests, apart by turns of 3 s, and white noise (n, 3)."""
    rng = np.random.default_rng(3)
    force = forces()
    moved = ((T % 80.0) < 3.0)[:, None]
    force = force + moved * rng.normal(0.0, 2.0, force.shape)
    accel = Samples.checked(Sensor.ACCELEROMETER, T, force + white, warm, None)
    gyro = Samples.checked(
        Sensor.GYROSCOPE, T, rng.normal(0.0, 1e-3, force.shape) + moved * rng.normal(0.0, 1.0, force.shape)
    )
    bins = cut(accel, gyro, PLUGS)
    spectrum = judged(quiet(accel, bins))
    assert spectrum is not None
    seen = spectrum, levels(spectrum), "accel", bins
    return changing(*seen) or by_force(*seen)


def driver(white: Array) -> str | None:
    seen = found(white)
    return None if seen is None else seen.where.driver


@pytest.mark.parametrize("seed", range(4))
def test_even_noise_is_silent(seed: int) -> None:
    assert found(noise(seed)) is None


@pytest.mark.parametrize("slope", [0.05, 0.025])
def test_noise_that_follows_temperature(slope: float) -> None:
    """The weaker one changes by a third from coldest to warmest, between two halves by a fifth."""
    seen = found(noise(1) * np.exp(slope * (WARM - 25.0))[:, None])
    assert seen is not None and seen.where.driver == "temperature" and seen.axes == ["x", "y", "z"]
    assert seen.parameters["ratio"].value == pytest.approx(np.exp(slope * np.ptp(WARM)), rel=0.1)


def test_noise_that_grows_while_a_phone_warms_up_soon() -> None:
    """Most rests are at the highest temperature, and most of the change at few others."""
    warm = 45.0 - 20.0 * np.exp(-T / 400.0)
    seen = found(noise(1) * (1.0 + 0.4 * (warm - 25.0))[:, None], warm)
    assert seen is not None and seen.where.driver == "temperature"
    assert 5.0 < seen.parameters["ratio"].value < 9.0, "9 from the first moment on"


def test_noise_added_beside_what_a_filter_passed_follows_charging() -> None:
    b, a = butter(2, 0.8)
    passed = lfilter(b, a, noise(1), axis=0)
    assert driver(passed + 1.2 * noise(2) * ON[:, None]) == "charging"


@pytest.mark.parametrize("ratio", [0.5, 1.6])
def test_noise_of_another_level_for_a_while(ratio: float) -> None:
    while_ = (T > 900.0) & (T < 1500.0)
    seen = found(noise(1) * np.where(while_, ratio, 1.0)[:, None])
    assert seen is not None and seen.where.driver == "time"
    assert (seen.where.t_start, seen.where.t_end) == pytest.approx((900.0, 1500.0), abs=25.0)
    assert seen.parameters["ratio"].value == pytest.approx(ratio, rel=0.03)


def test_a_filter_that_is_another_for_a_while() -> None:
    b, a = butter(2, 0.25)
    filtered = lfilter(b, a, noise(1), axis=0) + 0.05 * noise(2)
    seen = found(np.where(((T > 900.0) & (T < 1500.0))[:, None], filtered, noise(1)))
    assert seen is not None and seen.where.driver == "time"
    assert seen.parameters["ratio"].value < 1.0


@pytest.mark.parametrize("band", [(0.1, 0.6), (0.3, 0.9)])
def test_a_charger_that_hums_is_no_change_of_the_sensor(band: tuple[float, float]) -> None:
    b, a = butter(2, band, "bandpass")
    assert found(noise(1) + 2.0 * ON[:, None] * lfilter(b, a, noise(2), axis=0)) is None


def test_rests_that_are_shaken_each_in_its_way_are_no_change_of_the_sensor() -> None:
    """Even where the shaking is white: by temperature, by charging, and from a moment on."""
    rng = np.random.default_rng(3)
    by_rest = rng.uniform(1.0, 3.0, REST.max() + 1)[REST]
    for when in (WARM > 27.0, ON > 0.5, T > 1300.0):
        assert found(noise(1) * np.where(when, by_rest, 1.0)[:, None]) is None


def test_noise_of_a_reference_follows_the_force_on_its_own_axis() -> None:
    share = np.hypot(1.0, [0.0, 0.0, 1.0] * forces() / 9.81)
    seen = found(noise(4) * share)
    assert seen is not None and (seen.effect, seen.where.driver, seen.axes) == ("unknown", "own force", ["z"])
    assert seen.parameters["ratio"].value == pytest.approx(np.sqrt(2.0), rel=0.1)
    any_rest = np.random.default_rng(2).uniform(0.7, 1.4, REST.max() + 1)[REST]
    assert found(noise(4) * any_rest[:, None]) is None


def test_a_hand_that_tilts_the_phone_to_and_fro_is_no_reference() -> None:
    """Gravity moves on the axes across it, so their noise falls with the force along them."""
    tilts = np.random.default_rng(3).normal(0.0, 5e-4, (T.size, 3))
    assert found(noise(4) + np.cross(tilts, forces())) is None


def test_one_short_rest_far_from_the_others_is_no_parabola_more_often_than_stated() -> None:
    """It has the largest error and the most leverage: 7 % of even noise were beyond odds of 150 to 1."""
    pieces = np.r_[[2, 3, 4, 5] * 8, 1]
    by_chance, beyond = 0.01 / pieces, 0
    for seed in range(1000):
        rng = np.random.default_rng(seed)
        force = np.r_[rng.normal(0.0, 0.06, 32), -0.6]
        level = rng.normal(0.0, np.sqrt(by_chance))
        beyond += parabola_of_force(level, force, by_chance).nats > np.log(150.0)
    assert beyond <= 17  # 7 are expected: one in a thousand such tests finds more


def test_one_shaken_rest_in_another_attitude_than_all_others_is_no_parabola() -> None:
    """All others lie flat; that one, in a car and 1.2 times as loud, tells by itself where the curve goes."""
    rng = np.random.default_rng(1)
    by_chance = np.full(27, 1e-4)
    force, level = np.r_[rng.normal(0.0, 0.02, 26), -0.2], rng.normal(0.0, 0.02, 27)
    level[-1] += 0.2
    assert parabola_of_force(level, force, by_chance).nats < np.log(150.0)
    force[20:] = rng.uniform(-0.25, -0.15, 7)
    level[20:26] += 0.2
    assert parabola_of_force(level, force, by_chance).nats > np.log(1000.0)


def test_a_place_that_is_shaken_and_where_the_phone_lies_alike_is_no_force() -> None:
    """Rests with z up are in a car: their noise is larger, and of another size in every ten seconds."""
    in_car = forces()[:, 2] > 4.0
    by_piece = np.random.default_rng(7).uniform(1.2, 3.0, T.size)[(T // 10.0).astype(int)]
    assert found(noise(5) * np.where(in_car, by_piece, 1.0)[:, None]) is None
