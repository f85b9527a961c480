"""A low-pass is seen in the noise at rest, however it was made; noise without one has none."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, firwin, lfilter, sosfilt

from stillcal.calib_core.diagnosis.direct.quantisation import Steps
from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.noise.low_pass import (
    OF_MEDIAN,
    Quiet,
    _of_most_axes,
    bandwidth,
    judged,
    may_be_behind,
)
from stillcal.calib_core.diagnosis.noise.low_pass import quiet as quiet_of
from stillcal.calib_core.diagnosis.stream import _noise_of
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 100.0
WHITE = np.random.default_rng(8).normal(size=(20, 1000, 3))


def quiet(pieces: np.ndarray) -> Quiet:
    return Quiet(tuple(pieces), tuple(10.0 * i for i in range(len(pieces))), RATE)


def averaged(cutoff: float) -> np.ndarray:
    """Return y[n] = (1 - a) x[n] + a y[n - 1], 3 dB down at a cutoff, Hz."""

    c = 1.0 - np.cos(2.0 * np.pi * cutoff / RATE)
    new = np.sqrt(c**2 + 2.0 * c) - c
    return np.asarray(lfilter([new], [1.0, new - 1.0], WHITE, axis=1))


@pytest.mark.parametrize("cutoff", [8.0, 20.0])
def test_an_exponential_average_is_a_low_pass(cutoff: float) -> None:
    found = judged(quiet(averaged(cutoff)))
    assert found is not None and found.low_pass is not None and found.low_pass.order == 1
    assert found.low_pass.cutoff.value == pytest.approx(cutoff, rel=0.1)


@pytest.mark.parametrize("cutoff", [8.0, None])
def test_an_engine_that_idles_hides_no_low_pass_and_is_none(cutoff: float | None) -> None:
    """Its peak, 0.6 Hz wide, is no line; beside it "the noise is not white" was all that was said."""
    pieces = WHITE if cutoff is None else averaged(cutoff)
    idling = sosfilt(butter(3, [23.7, 24.3], "band", fs=RATE, output="sos"), WHITE[::-1], axis=1)
    found = judged(quiet(pieces + 5.0 * idling * [1.0, 0.5, 2.0]))
    assert found is not None and (found.low_pass is None) == (cutoff is None)
    if found.low_pass is not None:
        assert found.low_pass.cutoff.value == pytest.approx(cutoff, rel=0.1)


def test_a_wrist_that_trembles_below_three_hz_hides_neither_a_low_pass_nor_that_there_is_none() -> None:
    """What one watch alone had was not compared: the other's noise "may be behind it as well"."""
    slow = sosfilt(butter(6, 2.8, fs=RATE, output="sos"), WHITE[::-1], axis=1)
    behind, white = (judged(quiet(pieces + 10.0 * slow)) for pieces in (averaged(8.0), WHITE))
    assert behind is not None and white is not None
    assert behind.low_pass is not None and white.low_pass is None
    assert behind.low_pass.cutoff.value == pytest.approx(8.0, rel=0.1)
    for cutoff in (8.0, 20.0):
        plain = judged(quiet(averaged(cutoff)))
        assert plain is not None and plain.low_pass is not None
        assert not may_be_behind(white, plain.low_pass, range(3))
    assert may_be_behind(behind, behind.low_pass, range(3))


@pytest.mark.parametrize(("still", "stated"), [(slice(0, 4), True), (slice(0, 18), False)])
def test_rests_in_which_coarse_values_hold_still_have_no_spectrum(still: slice, stated: bool) -> None:
    pieces = averaged(5.0)
    spectrum = judged(quiet(pieces))
    assert spectrum is not None
    spectrum.power[still, :, 0] = 0.0
    found = bandwidth(
        spectrum, "gyro", sound_phones()["bandwidth"], Where(0.0, 200.0, (0.0, 50.0), "frequency")
    )
    assert (found is not None) == stated


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("times", [2, 4, 16])
@pytest.mark.parametrize("cutoff", [20.0, 30.0])
def test_what_a_faster_filter_leaves_folds_back(order: int, times: int, cutoff: float) -> None:
    """Sensors filter before samples are read: of a cutoff of 30 Hz 33 were told, with an error of 2 %."""
    noise = np.random.default_rng(times).normal(size=(30, 1000 * times, 3))
    filtered = lfilter(*butter(order, cutoff, fs=times * RATE), noise, axis=1)[:, ::times]
    found = judged(quiet(filtered))
    assert found is not None and found.low_pass is not None and found.low_pass.order == order
    told = found.low_pass.cutoff
    assert told.value == pytest.approx(cutoff, abs=2.5 * told.error) and told.error < 0.07 * cutoff


@pytest.mark.parametrize(
    ("taps", "poles", "cutoff", "samples_late"),
    [
        ([1.0 / 7.0] * 7, 0, 6.39, 3.0),
        ([0.53], 2, 8.0, 2 * 0.47 / 0.53),
        ([0.6], 3, 7.78, 3 * 0.4 / 0.6),
    ],
)
def test_smoothing_by_software_is_told_by_its_own_cutoff_and_delay(
    taps: list[float], poles: int, cutoff: float, samples_late: float
) -> None:
    """Of two exponential averages in a row, half of the power at 8 Hz, 4.99 Hz were told, +- 0.2."""
    filtered = np.random.default_rng(1).normal(size=(40, 1300, 3))
    for _ in range(max(poles, 1)):
        recursion = [1.0, sum(taps) - 1.0] if poles else [1.0]
        filtered = lfilter(taps, recursion, filtered, axis=1)
    found = judged(quiet(filtered[:, 300:]))
    assert found is not None and found.low_pass is not None
    assert found.low_pass.cutoff.value == pytest.approx(cutoff, rel=0.03)
    assert found.low_pass.late.value * RATE == pytest.approx(samples_late, rel=0.06)


@pytest.mark.parametrize("order", [6, 8])
def test_a_steep_low_pass_is_told(order: int) -> None:
    """Nothing was, nor of the means of 51 samples that fall as steeply."""
    for filtered in (
        lfilter(
            *butter(order, 15.0, fs=RATE), np.random.default_rng(order).normal(size=(30, 1300, 3)), axis=1
        ),
        lfilter(
            firwin(51, 15.0, fs=RATE), 1.0, np.random.default_rng(order).normal(size=(30, 1300, 3)), axis=1
        ),
    ):
        found = judged(quiet(filtered[:, 300:]))
        assert found is not None and found.low_pass is not None
        assert found.low_pass.cutoff.value == pytest.approx(15.0, rel=0.08)


@pytest.mark.parametrize("width", [1.5, 3.0])
@pytest.mark.parametrize("rounded", [False, True])
def test_a_filter_like_a_bell_curve_is_told_by_its_own_cutoff(width: float, rounded: bool) -> None:
    """Of 4.42 Hz 6.02 were told, +- 0.23. What is left of its power may be the steps' or nothing at all."""
    noise = np.random.default_rng(0).normal(size=(40, 1300, 3))
    filtered = gaussian_filter1d(noise, width, axis=1)[:, 150:-150]
    if rounded:
        filtered = 0.25 * np.round(4.0 * filtered)
    found = judged(quiet(filtered), 0.25**2 / 6.0 / RATE if rounded else 0.0)
    assert found is not None and found.low_pass is not None
    cutoff = np.sqrt(np.log(2.0)) / (2.0 * np.pi * width) * RATE
    assert found.low_pass.cutoff.value == pytest.approx(cutoff, rel=0.03)
    late = found.low_pass.late
    assert abs(late.value) <= late.error


@pytest.mark.parametrize("step", [0.25, 0.5, 0.8])
def test_a_low_pass_is_seen_above_the_noise_of_the_steps(step: float) -> None:
    """What is left of white noise of 1 at 5 Hz is 0.32: steps of 0.5 and more hid the filter."""
    noise = np.random.default_rng(1).normal(size=(40, 1300, 3))
    filtered = lfilter(*butter(2, 5.0, fs=RATE), noise, axis=1)[:, 300:]
    found = judged(quiet(step * np.round(filtered / step)), step**2 / 6.0 / RATE)
    assert found is not None and found.low_pass is not None
    told = found.low_pass.cutoff
    assert told.value == pytest.approx(5.0, abs=2.0 * told.error) and told.error < 0.6


@pytest.mark.parametrize("behind", ["white", "hum"])
def test_what_one_axis_alone_has_behind_the_filter_hides_none(behind: str) -> None:
    """A hum of one axis of a real gyroscope hid a filter of 25 Hz; white noise on one moved 31 Hz to 44."""
    noise = np.random.default_rng(5).normal(size=(30, 1000, 3))
    filtered = lfilter(*butter(2, 25.0, fs=RATE), noise, axis=1)
    rng = np.random.default_rng(6)
    white = rng.normal(size=(30, 1000))
    hum = lfilter(*butter(1, [30.0, 33.0], "band", fs=RATE), white, axis=1)
    filtered[:, :, 2] += white if behind == "white" else hum
    for levels in ([1.0, 1.0, 1.0], [3.0, 0.3, 1.0]):
        found = judged(quiet(filtered * np.array(levels)))
        assert found is not None and found.low_pass is not None
        assert found.low_pass.cutoff.value == pytest.approx(25.0, rel=0.08)


@pytest.mark.parametrize("behind", [0.0, 0.3])
def test_of_few_rests_two_axes_that_are_alike_tell_the_cutoff_as_it_is(behind: float) -> None:
    """The median of three is the larger of two beside one that has more: of 20 Hz 20.8 were told, +- 0.4."""
    told = []
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(size=(4, 1000, 3))
        filtered = lfilter(*butter(2, 20.0, fs=RATE), noise, axis=1)
        other = np.random.default_rng(100 + seed).normal(size=(4, 1000))
        filtered[:, :, 2] = filtered[:, :, 2] + behind * other if behind else other
        found = judged(quiet(filtered))
        assert found is not None and found.low_pass is not None
        told.append(found.low_pass.cutoff.value)
    assert np.mean(told) == pytest.approx(20.0, abs=0.4)


def test_axes_that_differ_by_chance_are_taken_together_and_one_that_differs_by_more_is_left_out() -> None:
    """The median of three alike axes scatters more than their mean: white noise had a filter by it."""
    rng, band = np.random.default_rng(3), np.arange(200) >= 40
    size, hum = np.array([1.0, 2.0, 4.0]), np.where(np.arange(200) % 10 == 0, np.exp(2.5), 1.0)

    def seen(averages: float, scatter: float, more: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        power = size * np.exp(scatter * rng.normal(size=(200, 3)))
        power[:40] *= [1.0, 1.0, 1e3]
        return power * more, *_of_most_axes(power * more, band, averages)

    one, two = (np.stack([np.ones(200), *more], axis=1) for more in ((np.ones(200), hum), (hum, 1.0 / hum)))
    for averages, scatter in ((27.0, np.sqrt(0.5 * np.pi / 27.0)), (1e4, 0.1)):
        power, together, variance = seen(averages, scatter, np.ones((200, 3)))
        assert together == pytest.approx(power.mean(axis=1)) and variance == 1.0
    power, together, variance = seen(27.0, np.sqrt(0.5 * np.pi / 27.0), one)
    level = np.median(power[band], axis=0)
    assert together == pytest.approx(level.mean() * (power / level)[:, :2].mean(axis=1)) and variance == 1.5
    power, together, variance = seen(1e4, 0.01, two)
    level = np.median(power[band], axis=0)
    assert (
        together == pytest.approx(level.mean() * np.median(power / level, axis=1)) and variance == OF_MEDIAN
    )


def test_white_noise_has_none() -> None:
    found = judged(quiet(WHITE))
    assert found is not None and found.low_pass is None


@pytest.mark.parametrize("seed", range(4))
def test_a_cutoff_is_less_sure_where_steps_are_as_coarse_as_the_noise(seed: int) -> None:
    """Rounding leaves noise of its own, which a filter's output makes anything but white."""

    rng = np.random.default_rng(seed)
    noise = lfilter(*butter(2, 0.24), rng.normal(size=(40, 1000, 3)), axis=1)
    step = 1.5 * float(noise.std())
    means = rng.uniform(0.0, step, (40, 1, 3))
    rounded = np.rint((noise + means) / step) * step - means
    fine, coarse = (judged(quiet(p), floor) for p, floor in ((noise, 0.0), (rounded, step**2 / 6.0 / RATE)))
    assert fine is not None and fine.low_pass is not None
    assert coarse is not None and coarse.low_pass is not None
    for one, least in ((fine.low_pass.cutoff, 0.02), (coarse.low_pass.cutoff, 0.04)):
        assert abs(one.value - 12.0) < 3.0 * one.error and one.error >= 0.99 * least * one.value


def test_what_shakes_the_phone_leaves_the_sensors_own_noise_and_is_no_filter() -> None:
    """A vehicle's vibration falls with frequency as a filter does, down to noise that is not filtered."""

    shaking = lfilter(*butter(2, 0.1), WHITE, axis=1)
    found = judged(quiet(shaking))
    assert found is not None and found.low_pass is not None
    own = 0.03 * np.random.default_rng(9).normal(size=WHITE.shape)
    found = judged(quiet(shaking + own))
    assert found is not None and found.low_pass is None


def test_noise_louder_than_any_sensors_tells_no_filter() -> None:
    shaking = lfilter(*butter(2, 0.2), WHITE, axis=1)
    for size, own in ((0.05, True), (0.5, False)):
        spectra, levels = _noise_of(quiet(size * shaking), Steps(np.zeros(3), size * np.ones(3)), "accel")
        assert spectra is not None and levels is not None
        assert levels.own == own and (spectra.low_pass is not None) == own


def test_rests_that_follow_each_other_are_not_one_piece() -> None:
    """At 4 Hz a bin of 10 s has 40 samples of the 64 that a piece needs: two of one rest make one."""
    noise = np.random.default_rng(3).normal(size=(160, 3))
    samples = Samples(Sensor.ACCELEROMETER, np.arange(160) / 4.0, noise)
    for rest, count in (([0, 0, 0, 0], 2), ([0, 1, 1, 2], 1)):
        bins = SimpleNamespace(t=4.875 + 10.0 * np.arange(4), duration=np.full(4, 10.0), rest=np.array(rest))
        assert len(quiet_of(samples, cast(Any, bins)).pieces) == count


@pytest.mark.parametrize(("rests", "order", "size"), [(8, 2, 5.0), (11, 1, 3.0)])
@pytest.mark.parametrize("cutoff", [None, 20.0])
def test_a_hand_that_trembles_in_some_rests_is_no_low_pass(
    rests: int, order: int, size: float, cutoff: float | None
) -> None:
    """Of watches worn in 11 of 20 and of 26 rests a low-pass was told, that none of the others shows."""
    pieces = WHITE.copy() if cutoff is None else averaged(cutoff)
    hand = np.random.default_rng(5).normal(size=(rests, 1000, 3))
    pieces[:rests] += size * lfilter(*butter(order, 2.0 * 10.0 / RATE), hand, axis=1)
    found = judged(quiet(pieces))
    assert found is not None
    if cutoff is None:
        assert found.low_pass is None
    else:
        assert found.low_pass is not None
        assert found.low_pass.cutoff.value == pytest.approx(cutoff, rel=0.1)


@pytest.mark.parametrize(("order", "cutoff"), [(1, 5.0), (2, 5.0), (2, 20.0)])
def test_a_low_pass_shows_in_quiet_rests_though_a_hand_trembles_in_most(order: int, cutoff: float) -> None:
    """No filter fits the median of all rests; it was not asked of the quiet ones then."""
    noise = np.random.default_rng(6).normal(size=(20, 1000, 3))
    pieces = lfilter(*butter(order, 2.0 * cutoff / RATE), noise, axis=1)
    shaking = np.random.default_rng(5).normal(size=(12, 1000, 3))
    pieces[:12] += 4.0 * lfilter(*butter(1, 2.0 * 3.0 / RATE), shaking, axis=1)
    found = judged(quiet(pieces))
    assert found is not None and found.low_pass is not None
    assert found.low_pass.cutoff.value == pytest.approx(cutoff, rel=0.1)


def test_a_few_quiet_rests_that_tremble_are_no_low_pass() -> None:
    """Of 20 rests 17 are loud and flat; the three quiet ones alone would show a filter at 3 Hz."""
    pieces = 10.0 * WHITE
    pieces[:3] = 0.1 * WHITE[:3] + lfilter(*butter(1, 2.0 * 3.0 / RATE), WHITE[:3, ::-1], axis=1)
    found = judged(quiet(pieces))
    assert found is not None and found.low_pass is None


def test_rests_in_which_coarse_values_hold_still_are_not_the_quietest() -> None:
    """Four that hold still were all that was asked beside a hand, and have no spectrum."""
    pieces = averaged(20.0)
    shaking = np.random.default_rng(5).normal(size=(8, 1000, 3))
    pieces[:8] += 4.0 * lfilter(*butter(1, 2.0 * 3.0 / RATE), shaking, axis=1)
    pieces[8:12] = 0.0
    found = judged(quiet(pieces))
    assert found is not None and found.low_pass is not None
    assert found.low_pass.cutoff.value == pytest.approx(20.0, rel=0.1)
