"""Effects that two sensors' readings of one motion show sample by sample, and what they are not taken for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.pair.alignment import Alignment, KnownBefore, _drivers, align
from stillcal.calib_core.diagnosis.comparison.pair.delay import late as late_of
from stillcal.calib_core.diagnosis.comparison.pair.turns import Turns
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.motion.block_regression import of_arm
from stillcal.replay.diagnosis.pair.readings import mean_readings, readings_of
from stillcal.replay.formats.trace import Recording
from tests.support.diagnosis.turned_pairs import RATE, Flaw, perfect, turned

NOISE = KnownBefore(noise={"accel": np.full(3, 0.008**2), "gyro": np.full(3, 5e-4**2)})


def one_way(force: Array, rate: Array) -> tuple[Array, Array]:
    """Return what a device reads that is turned about y in one direction only."""
    return force, np.column_stack([rate[:, 0], np.abs(rate[:, 1]), rate[:, 2]])


def seen(flaw: Flaw = perfect, seed: int = 1) -> Alignment:
    """Return what a flawed device shows in motion beside one without a flaw."""
    own = turned(seed, flaw)
    return align(readings_of(own), mean_readings(own, [turned(100 + seed)]), NOISE)


def squared(force: Array, rate: Array) -> tuple[Array, Array]:
    return force, rate + rate**2 * np.array([0.0, 2e-3, -1e-3])


def cubed(force: Array, rate: Array) -> tuple[Array, Array]:
    return force, rate + rate**3 * np.array([1.5e-3, 0.0, 0.0])


def by_direction(force: Array, rate: Array) -> tuple[Array, Array]:
    return force, rate + 0.015 * np.maximum(rate, 0.0)


def on_an_arm(force: Array, rate: Array) -> tuple[Array, Array]:
    t = np.arange(len(rate)) / RATE
    return force + of_arm(t, rate) @ np.array([0.02, 0.0, 0.04]), rate


def one_axis_late(force: Array, rate: Array) -> tuple[Array, Array]:
    moved = rate.copy()
    moved[1:, 2] = 0.8 * rate[1:, 2] + 0.2 * rate[:-1, 2]
    return force, moved


def late(force: Array, rate: Array) -> tuple[Array, Array]:
    moved = rate.copy()
    moved[1:] = 0.8 * rate[1:] + 0.2 * rate[:-1]
    return force, moved


def test_a_delay_that_may_be_that_of_low_passes_is_told_and_not_stated() -> None:
    own = turned(1, late)
    shown = align(readings_of(own), mean_readings(own, [turned(101)]), KnownBefore(unsure=0.004))
    assert shown.found == []
    (why,) = shown.hidden.values()
    assert why.startswith("the gyroscope is 7.9 ms further behind the accelerometer")


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_sensors_that_read_alike_show_nothing(seed: int) -> None:
    assert seen(seed=seed).found == []


@pytest.mark.parametrize(
    ("flaw", "effect", "driver", "name", "value"),
    [
        (squared, "gyro_nonlinearity", "rate of turn", "quadratic", [0.0, 2e-3, -1e-3]),
        (cubed, "gyro_nonlinearity", "rate of turn", "cubic", [1.5e-3, 0.0, 0.0]),
        (by_direction, "unknown", "size of the rate of turn", "gain", [7.5e-3] * 3),
        (on_an_arm, "lever_arm", "rate of turn", "position", [0.02, 0.0, 0.04]),
        (one_axis_late, "unknown", "rate of turn, axis by axis", "delay", [-0.0027, -0.0027, 0.0053]),
    ],
)
def test_each_is_found_alone_with_its_size_and_taken_out(
    flaw: Flaw, effect: str, driver: str, name: str, value: list[float]
) -> None:
    shown = seen(flaw)
    (said,) = (s.finding for s in shown.found)
    assert (said.effect, said.where.driver) == (effect, driver)
    found = np.asarray(said.parameters[name].value, dtype=np.float64)
    np.testing.assert_allclose(found, value, atol=0.06 * np.abs(value).max())
    own = turned(1, flaw)
    assert align(readings_of(own), shown.readings).found == []
    assert [q.effect for q in shown.quantities] == ([] if effect == "unknown" else [effect])


@pytest.mark.parametrize(("gain", "told"), [(0.012, False), (0.03, True)])
def test_what_motion_dithers_of_coarse_steps_is_no_effect_of_turns(gain: float, told: bool) -> None:
    """Of a bias of half a step a gain by direction and a nonlinearity were made."""
    step = 0.02

    def in_steps(recording: Recording) -> Recording:
        assert recording.gyroscope is not None
        xyz = frozen(step * np.rint(recording.gyroscope.xyz / step))
        return replace(recording, gyroscope=replace(recording.gyroscope, xyz=xyz))

    own = in_steps(turned(1, lambda force, rate: (force, rate + gain * np.maximum(rate, 0.0))))
    mean = mean_readings(own, [in_steps(turned(101))])
    assert len(align(readings_of(own), mean).found) == 1
    shown = align(readings_of(own), mean, KnownBefore(rounding={"gyro": np.full(3, step / np.sqrt(6.0))}))
    assert len(shown.found) == told
    assert list(shown.hidden) == ([] if told else [("unknown", "gyro")])


def test_where_all_turns_are_in_one_direction_noise_is_no_gain_by_direction() -> None:
    """What parted the size of a rate from the rate was noise: a gain of 64 %, and a scale that undid it."""

    own, other = turned(1, one_way), turned(101, one_way)
    assert align(readings_of(own), mean_readings(own, [other]), NOISE).found == []


def test_what_noise_makes_of_a_gain_by_direction_is_taken_off_and_as_unsure_as_it_is_large() -> None:
    own, other = turned(1, one_way), turned(101, one_way)
    assert own.gyroscope is not None and other.gyroscope is not None
    seen = late_of(own.gyroscope, other.gyroscope, "gyro")
    assert seen is not None
    drivers = _drivers(own.gyroscope, readings_of(other))
    noise = NOISE.noise["gyro"]
    turns = Turns(own.gyroscope, other.gyroscope, seen.pieces, drivers, filtered=False, noise=noise)
    gain = next(e for e in effects_of("gyro", in_turns=True) if e.follows == "size of the rate of turn")
    as_read, made = (t._fitted(gain, []) for t in (replace(turns, noise=0.0 * noise), turns))
    assert abs(as_read.value[1]) > 0.3 and abs(made.value[1]) < 0.1
    assert np.sqrt(made.covariance[1, 1]) > 0.9 * abs(as_read.value[1] - made.value[1])


def test_a_bias_of_both_gyroscopes_makes_no_square_of_a_cube() -> None:
    """(w + b)^3 holds 3 b w^2: the power is that of the rate without what is read at rest."""
    bias = np.array([0.05, -0.03, 0.04])

    def with_bias(force: Array, rate: Array) -> tuple[Array, Array]:
        return cubed(force, rate)[0], cubed(force, rate)[1] + bias

    own, other = turned(1, with_bias), turned(101, lambda force, rate: (force, rate + bias))
    (one,) = align(readings_of(own), mean_readings(own, [other]), KnownBefore(at_rest=bias)).quantities
    assert one.effect == "gyro_nonlinearity"
    np.testing.assert_array_less(np.abs(one.value[:3]), 3.0 * one.sigma[:3] + 1e-5)
