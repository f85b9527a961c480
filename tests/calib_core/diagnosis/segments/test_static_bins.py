"""Rests as the diagnosis cuts them: a knock ends one, coarse steps do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import PLUG_LATE, RestEdges, rest_edges
from stillcal.calib_core.diagnosis.segments.static_bins import Bins, cut, cut_all, overview_of
from stillcal.calib_core.diagnosis.segments.windows import windows
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor

N = 15_000


def resting(noise: float = 0.005) -> np.ndarray:
    return np.random.default_rng(1).normal(0, noise, (N, 3)) + np.array([0.0, 0.0, 9.81])


def bins(force: np.ndarray) -> Bins:
    return cut(Samples.checked(Sensor.ACCELEROMETER, np.arange(N) / 50.0, force), None)


def test_bins_within_the_rests_of_others_have_their_middle_there() -> None:
    every = bins(resting())
    others = every.chosen((np.abs(every.t - 60.0) < 20.0) | (np.abs(every.t - 200.0) < 20.0))
    split = replace(others, rest=(others.t > 100.0).astype(np.int64))
    kept = every.within(split)
    assert np.array_equal(kept.t, others.t), "not the bins between the two rests"
    assert np.array_equal(every.within(others).t, every.t[(every.t > 40.0) & (every.t < 220.0)])
    assert len(every.within(every.chosen(np.zeros(len(every), dtype=np.bool_)))) == 0


def test_a_knock_ends_a_rest_and_is_in_no_bin() -> None:
    knocked = resting()
    knocked[7000:7040, 0] += 0.06 * np.sin(np.arange(40))
    whole, cut_up = bins(resting()), bins(knocked)
    assert np.unique(whole.rest).size == 1 and np.unique(cut_up.rest).size == 2
    assert cut_up.vibration.max() < 1.5 * np.median(cut_up.vibration)


def test_bins_that_are_shaken_are_as_uncertain_as_they_are_and_the_others_no_more() -> None:
    """An eighth is shaken four times as much: the mean of all would make its means too sure by half."""
    shaken = resting()
    shaken[12_000:14_000] += np.random.default_rng(2).normal(0.0, 0.005 * np.sqrt(15.0), (2000, 3))
    seen = bins(shaken)
    louder = seen.vibration / np.median(seen.vibration)
    assert (louder > 12.0).sum() >= 3
    for which, noise in ((louder > 12.0, 0.02), (louder < 2.0, 0.005)):
        expected = noise**2 / 50.0 / seen.duration[which, None]
        assert (seen.force_variance[which] / expected).mean() == pytest.approx(1.0, rel=0.25)


def test_a_spike_of_one_sensor_is_in_no_mean_and_ends_no_rest() -> None:
    rng, force, t = np.random.default_rng(2), resting(), np.arange(N) / 50.0
    quiet = rng.normal(0, 1e-3, (N, 3))
    spiked = quiet.copy()
    spiked[700::700, 1] += 0.04

    def both(rate: np.ndarray) -> Bins:
        accel, gyro = Sensor.ACCELEROMETER, Sensor.GYROSCOPE
        return cut(Samples.checked(accel, t, force), Samples.checked(gyro, t, rate))

    whole, spiky = both(quiet), both(spiked)
    assert np.unique(spiky.rest).size == 1 and whole.rate is not None and spiky.rate is not None
    np.testing.assert_allclose(spiky.rate, whole.rate, atol=1e-5)


def test_values_that_toggle_between_two_steps_are_still() -> None:
    coarse = np.round(resting(0.02) / 0.1) * 0.1
    assert np.unique(bins(coarse).rest).size == 1


def test_a_phone_that_is_carried_all_day_rests_only_where_it_is_put_down() -> None:
    """Steps of a walk, even ones, but for the last twentieth."""
    walked = np.arange(N) < 0.95 * N
    t = np.arange(N) / 50.0
    steps = np.stack([np.sin(2 * np.pi * f * t) for f in (1.0, 2.0, 4.0)], axis=1)
    seen = bins(resting() + 2.5 * steps * walked[:, None])
    assert len(seen) and seen.t.min() > 0.95 * t[-1]


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_a_slow_log_rests_where_it_is_not_turned(rate: float) -> None:
    """An hour in two attitudes, turned over in a quarter of an hour between; stamps jitter."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 3600.0, 1.0 / rate)
    t = np.sort(t + rng.normal(0.0, 0.05 / rate, t.size))
    moving = (t > 1500.0) & (t < 2100.0)
    angle = np.clip((t - 1500.0) / 600.0, 0.0, 1.0) * np.pi
    force = 9.81 * np.stack([np.zeros(t.size), np.sin(angle), np.cos(angle)], axis=1)
    force += rng.normal(0.0, 0.01, force.shape) + moving[:, None] * rng.normal(0.0, 1.0, force.shape)
    spin = moving * np.pi / 600.0 + moving * rng.normal(0.0, 0.5, t.size)
    turning = np.outer(spin, [1.0, 0.0, 0.0]) + rng.normal(0.0, 1e-3, force.shape)
    found = cut(
        Samples.checked(Sensor.ACCELEROMETER, t, force), Samples.checked(Sensor.GYROSCOPE, t, turning)
    )
    inside = (found.t > 1500.0) & (found.t < 2100.0)
    assert not inside.any() and np.unique(found.rest).size == 2
    assert found.duration.sum() > 0.9 * 3000.0
    np.testing.assert_allclose(np.abs(found.force[:, 2]), 9.81, atol=0.02)


RATE_HZ = 100.0


def held_by_hand(rest_s: float, count: int = 20) -> tuple[Samples, Samples]:
    """A sensor held still for rest_s in one attitude after another, turned for a second between."""
    rng, turn_s = np.random.default_rng(3), 1.0
    t = np.arange(0.0, count * (rest_s + turn_s), 1.0 / RATE_HZ)
    number, within = np.divmod(t, rest_s + turn_s)
    ease = np.clip((within - rest_s) / turn_s, 0.0, 1.0)
    angle = 0.9 * (number + ease**2 * (3.0 - 2.0 * ease))  # about the axis y
    force = 9.81 * np.stack([np.sin(angle), np.zeros(t.size), np.cos(angle)], axis=1)
    rate = np.stack([np.zeros(t.size), np.gradient(angle, t), np.zeros(t.size)], axis=1)
    noises = rng.normal(0.0, [[[0.01]], [[1e-3]]], (2, t.size, 3))
    return (
        Samples.checked(Sensor.ACCELEROMETER, t, force + noises[0]),
        Samples.checked(Sensor.GYROSCOPE, t, rate + noises[1]),
    )


@pytest.mark.parametrize("rest_s", [2.0, 3.0, 4.5])
def test_rests_of_few_seconds_are_found_whole_and_known_as_brief(rest_s: float) -> None:
    accelerometer, gyroscope = held_by_hand(rest_s)
    seen = cut(accelerometer, gyroscope)
    assert len(seen) == np.unique(seen.rest).size == 20 and seen.held
    np.testing.assert_allclose(np.linalg.norm(seen.force, axis=1), 9.81, atol=0.01)
    into = seen.t % (rest_s + 1.0)
    assert (into - seen.duration / 2 > -1e-6).all() and (into + seen.duration / 2 < rest_s).all()
    assert seen.duration.min() > 0.2 * rest_s


def test_rests_of_a_minute_are_cut_in_seconds_and_nothing_turns_them() -> None:
    seen = cut(*held_by_hand(60.0))
    assert not seen.held and (seen.duration == np.rint(seen.duration)).all()


def test_brief_rests_have_their_own_temperature_and_end_before_a_plug() -> None:
    brief, _ = held_by_hand(3.0)
    warming = replace(brief, temperature=frozen(20.0 + 0.05 * brief.t))
    seen = cut(warming, None)
    assert seen.temperature is not None and len(seen) == 20
    np.testing.assert_allclose(seen.temperature, 20.0 + 0.05 * seen.t, atol=0.02)
    plug = 4.0 * 8 + 2.0  # in the middle of the ninth rest
    plugged = cut(warming, None, (Charging(0.0, False), Charging(plug, True)))
    begin, end = plugged.t - plugged.duration / 2.0, plugged.t + plugged.duration / 2.0
    assert len(plugged) >= 19 and not ((begin < plug - 1e-6) & (end > plug - PLUG_LATE)).any()


def test_rests_in_the_attitude_before_are_no_stops() -> None:
    """A table that is knocked every few seconds is no calibration by hand."""
    force, rate = resting(), np.random.default_rng(2).normal(0.0, 1e-3, (N, 3))
    knocked = np.arange(N) % 150 < 25
    force[knocked] += np.random.default_rng(3).normal(0.0, 2.0, (int(knocked.sum()), 3))
    t = np.arange(N) / 50.0
    samples = (Samples.checked(Sensor.ACCELEROMETER, t, force), Samples.checked(Sensor.GYROSCOPE, t, rate))
    seconds = overview_of(*samples)
    brief = [windows(one, *seconds.span, 0.25) for one in samples]
    edges = rest_edges(brief[0], brief[1], seconds.span, width=0.25)
    assert len(edges.runs) > 50 and edges.stops == 1


def test_briefer_windows_are_taken_for_far_more_stops_or_for_bins_enough() -> None:
    def edges(stops: int, bins: int) -> RestEdges:
        none = np.zeros(bins)
        return RestEdges(np.zeros(0, dtype=np.bool_), [], none, none, none.astype(np.int64), stops=stops)

    assert edges(30, 30).shows_more_than(edges(20, 20))
    assert not edges(29, 29).shows_more_than(edges(20, 20))
    assert edges(6, 12).shows_more_than(edges(6, 11))
    assert not edges(5, 12).shows_more_than(edges(5, 11))
    assert not edges(6, 13).shows_more_than(edges(6, 12))


def test_brief_rests_are_not_sought_where_only_part_of_the_samples_is_there() -> None:
    accelerometer, gyroscope = held_by_hand(3.0)
    half = accelerometer.xyz.shape[0] // 2
    part = Samples.checked(Sensor.ACCELEROMETER, accelerometer.t[:half], accelerometer.xyz[:half])
    assert len(cut(part, gyroscope, overview=overview_of(accelerometer, gyroscope))) == 0


def test_six_rests_are_cut_into_enough_bins_and_fewer_are_not() -> None:
    for count, rest_s, least in ((6, 5.0, 12), (6, 18.0, 12), (5, 18.0, 0)):
        seen = cut(*held_by_hand(rest_s, count))
        assert np.unique(seen.rest).size == count
        assert len(seen) >= least and (least or len(seen) < 12)


@pytest.mark.parametrize(("roll_deg", "swings"), [(0.2, True), (0.0, False)])
def test_a_ship_that_rolls_swings_and_a_gyroscope_that_walks_does_not(roll_deg: float, swings: bool) -> None:
    rng, t = np.random.default_rng(4), np.arange(N) / 50.0
    angle = np.radians(roll_deg) * np.sin(2.0 * np.pi * t / 9.0)
    force = resting() + 9.81 * np.stack([np.sin(angle), np.zeros(N), np.cos(angle) - 1.0], axis=1)
    rate = rng.normal(0.0, 1e-3, (N, 3)) + np.cumsum(rng.normal(0.0, 1e-5, (N, 3)), axis=0)
    rate[:, 1] += np.gradient(angle, t)
    seen = cut(Samples.checked(Sensor.ACCELEROMETER, t, force), Samples.checked(Sensor.GYROSCOPE, t, rate))
    assert len(seen) >= 12 and seen.swings is swings


def test_what_only_one_sensor_shows_is_no_swing() -> None:
    rng, t = np.random.default_rng(4), np.arange(N) / 50.0
    rate = rng.normal(0.0, 1e-3, (N, 3))
    rate[:, 1] += 2e-3 * np.sin(2.0 * np.pi * t / 14.0)
    force = Samples.checked(Sensor.ACCELEROMETER, t, resting())
    assert not cut(force, Samples.checked(Sensor.GYROSCOPE, t, rate)).swings


@pytest.mark.parametrize("rest_s", [300.0, 48.0])
def test_biases_that_are_heated_do_not_swing(rest_s: float) -> None:
    """3 K a minute, as in a chamber, up and down, in a whole rest as in several of five bins."""
    rng, t = np.random.default_rng(5), np.arange(N) / 50.0
    kelvin = 0.05 * np.abs((t + 60.0) % 240.0 - 120.0)
    force = resting(0.002) + kelvin[:, None] * np.array([6e-3, -3e-3, 5e-3])
    rate = rng.normal(0.0, 3e-4, (N, 3)) + kelvin[:, None] * np.array([7e-4, -2e-4, 3e-4])
    moved = t % rest_s > rest_s - 2.0
    force[moved] += rng.normal(0.0, 2.0, (int(moved.sum()), 3))
    seen = cut(Samples.checked(Sensor.ACCELEROMETER, t, force), Samples.checked(Sensor.GYROSCOPE, t, rate))
    assert len(seen) >= 12 and not seen.swings


def test_the_mean_of_a_bin_that_swings_is_as_uncertain_as_it_is() -> None:
    """What windows change by made it too sure by a factor of four, in both sensors."""
    rng, t = np.random.default_rng(6), np.arange(N) / 50.0
    angle = np.radians(0.5) * np.sin(2.0 * np.pi * t / 14.0)
    force = 9.81 * np.stack([np.sin(angle), np.zeros(N), np.cos(angle)], axis=1)
    rate = rng.normal(0.0, 1e-3, (N, 3))
    rate[:, 1] += np.gradient(angle, t)
    force += rng.normal(0.0, 0.005, (N, 3))
    seen = cut(Samples.checked(Sensor.ACCELEROMETER, t, force), Samples.checked(Sensor.GYROSCOPE, t, rate))
    assert seen.swings and seen.rate is not None and seen.rate_variance is not None
    for mean, variance in (
        (seen.rate[:, 1], seen.rate_variance[:, 1]),
        (seen.force[:, 0], seen.force_variance[:, 0]),
    ):
        assert 0.3 < (mean**2 / variance).mean() < 3.0


@pytest.mark.filterwarnings("error")
def test_a_sensor_that_reads_nothing_rests_in_one_attitude() -> None:
    assert np.unique(bins(np.zeros((N, 3))).rest).size == 1


@pytest.mark.parametrize(
    ("change", "still"),
    [
        ((0.05, 0.0, 0.0), True),  # no phone turns so and keeps gravity where it is
        ((0.04, -0.05, 0.03), True),
        ((0.0, 0.0, 0.05), False),  # a turntable turns so
        ((0.02, 0.0, 0.05), False),  # and so does what leans in a bend
    ],
)
def test_a_bias_that_changed_is_no_turn_where_gravity_stays(
    change: tuple[float, float, float], still: bool
) -> None:
    """Two degrees a second and more are no noise of a bias, but what gravity contradicts is no turn."""
    t, later = np.arange(N) / 50.0, (np.arange(N) >= 0.6 * N)[:, None]
    rate = np.random.default_rng(2).normal(0.0, 1e-3, (N, 3)) + later * np.array(change)
    seen = cut(
        Samples.checked(Sensor.ACCELEROMETER, t, resting()), Samples.checked(Sensor.GYROSCOPE, t, rate)
    )
    assert ((seen.t > 190.0).sum() >= 8) == still
    assert (seen.t < 180.0).sum() >= 14


def test_what_leans_on_a_centrifuge_turns() -> None:
    """Its force is 1.8 times gravity, and turns with it: that stays, though the rate is across it."""
    t, later = np.arange(N) / 50.0, (np.arange(N) >= 0.6 * N)[:, None]
    force = resting() + later * np.array([15.0, 0.0, 0.0])
    rate = np.random.default_rng(2).normal(0.0, 1e-3, (N, 3)) + later * np.array([0.0, 0.0, 10.0])
    seen = cut(Samples.checked(Sensor.ACCELEROMETER, t, force), Samples.checked(Sensor.GYROSCOPE, t, rate))
    assert not (seen.t > 182.0).any()


@pytest.mark.parametrize(
    ("sway", "toggles", "breathes"), [(0.0, 0.0, False), (0.003, 0.0, True), (0.0, 0.01, False)]
)
def test_a_phone_on_a_chest_is_turned_to_and_fro_in_its_rests(
    sway: float, toggles: float, *, breathes: bool
) -> None:
    """A gyroscope's bias that toggles turns nothing. Breaths were told as one that follows the rests."""
    t = np.arange(0.0, 600.0, 0.04)
    rng, phase = np.random.default_rng(3), 2.0 * np.pi * 0.25 * t
    tilt, rate = sway * np.sin(phase), sway * 2.0 * np.pi * 0.25 * np.cos(phase)
    force = 9.8 * np.column_stack([np.zeros_like(t), np.sin(tilt), np.cos(tilt)])
    read = np.column_stack([rate + toggles * (np.sin(phase / 2.0) > 0.0), np.full_like(t, 0.01), 0.0 * t])
    bins = cut(
        Samples(Sensor.ACCELEROMETER, t, force + rng.normal(0.0, 0.01, force.shape)),
        Samples(Sensor.GYROSCOPE, t, read + rng.normal(0.0, 1e-3, read.shape)),
    )
    assert len(bins) > 10 and bins.breathes == breathes and not bins.swings


def test_what_a_quiet_gyroscope_reads_beside_a_noisy_accelerometer_turns_nothing() -> None:
    """By chance the force went as its noise does: of 120 recordings on a table 14 seemed to breathe."""
    t = np.arange(0.0, 600.0, 0.04)
    level = np.tile([0.0, 0.0, 9.8], (t.size, 1))
    for seed in range(8):
        rng = np.random.default_rng(seed)
        bins = cut(
            Samples(Sensor.ACCELEROMETER, t, level + rng.normal(0.0, 0.03, level.shape)),
            Samples(Sensor.GYROSCOPE, t, rng.normal(0.0, 1e-4, level.shape)),
        )
        assert len(bins) > 10 and not bins.breathes


def test_white_noise_of_brief_bins_is_told_by_as_many_as_the_model_takes_it_to_be() -> None:
    """Of bins of 4 s, five tell it to a half only: some residuals seem to be twice as large as they are."""
    noise, t = np.random.default_rng(3).normal(size=(2, 60_000, 3)), np.arange(60_000) / 100.0
    force = Samples.checked(Sensor.ACCELEROMETER, t, [0.0, 0.0, 9.81] + 0.01 * noise[0])
    rate = Samples.checked(Sensor.GYROSCOPE, t, 1e-3 * noise[1])
    moving = (np.arange(150) % 3 > 0).astype(float)
    for bins in (cut_all(force, rate, [], (0.0, 600.0)), cut_all(force, rate, [], (0.0, 600.0), moving)):
        assert bins.duration[0] == 4.0 and bins.rate_variance is not None
        for variance, white in ((bins.force_variance, 1e-4), (bins.rate_variance, 1e-6)):
            least, middle, most = np.quantile(variance / (white / 400.0), [0.1, 0.5, 0.9])
            assert least > 0.55 and 0.8 < middle < 1.2 and most < 1.6
