"""Vibrations of two recordings of one motion, told by what the one reads less the other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.compare_samples import compare_samples
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.vibrations import (
    IN_MOTION,
    of_the_difference,
    shakes_both,
)
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.noise.lines.line import middle_hz
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE, COUNT, TONE = 100.0, 9000, 17.3
T = np.arange(COUNT) / RATE


def moved() -> Array:
    """Return what a hand makes of a force, up to 5 Hz and never at rest, (n, 3)."""
    shake = lfilter(*butter(2, 5.0, fs=RATE), np.random.default_rng(1).normal(0.0, 5.0, (COUNT, 3)), axis=0)
    return np.asarray(shake + np.array([0.0, 0.0, 9.8]))


def hum(size: float, hz: float = TONE) -> Array:
    return np.outer(np.sin(2.0 * np.pi * hz * T), [size, 0.0, 0.0])


def noise(seed: int) -> Array:
    return np.random.default_rng(seed).normal(0.0, 0.02, (COUNT, 3))


def pair(first: Array, second: Array) -> Any:
    """Return both as examinations hold them, each with noise of its own."""

    def one(xyz: Array, seed: int) -> Any:
        made = Samples(Sensor.ACCELEROMETER, T, xyz + noise(seed))
        return SimpleNamespace(accelerometer=made, gyroscope=None)

    return one(first, 2), one(second, 3)


@pytest.mark.parametrize("of_recording", [True, False])
def test_a_vibration_of_one_of_the_two_is_told_though_neither_rests(*, of_recording: bool) -> None:
    """Rests of eight seconds were needed: a vibration of three times the noise was a match."""
    shaken, plain = 1.02 * moved() + 0.1 + hum(0.06), moved()
    said = of_the_difference(pair(*((shaken, plain) if of_recording else (plain, shaken))), "accel", [])
    assert said is not None
    (((line, whose),), of_both) = said
    assert of_both == []
    assert whose == of_recording and line.where.driver == IN_MOTION
    assert float(np.asarray(line.parameters["frequency"].value)) == pytest.approx(TONE, abs=0.01)
    assert np.asarray(line.parameters["amplitude"].value) == pytest.approx([0.06, 0.0, 0.0], abs=4e-3)


def test_a_vibration_of_the_motion_is_none_of_the_difference() -> None:
    exams = pair(moved() + hum(0.06), moved() + hum(0.06))
    assert of_the_difference(exams, "accel", []) == ([], [])
    assert of_the_difference(pair(moved(), moved()), "accel", []) == ([], [])


def test_what_is_known_is_taken_off_before() -> None:
    exams = pair(moved() + hum(0.06) + hum(0.05, 31.0), moved())
    said = of_the_difference(exams, "accel", [TONE])
    assert said is not None
    assert [round(middle_hz(line), 1) for line, _ in said[0]] == [31.0]


def later(xyz: Array, cutoff: float) -> Array:
    """Return what a first-order low-pass makes of it. cutoff: Hz."""
    return np.asarray(lfilter(*butter(1, cutoff, fs=RATE), xyz - xyz[0], axis=0) + xyz[0])


@pytest.mark.parametrize("flaw", ["phase", "half", "filter"])
def test_a_vibration_that_both_read_is_neither_s_alone(flaw: str) -> None:
    """One of the same size and another phase was lacking, of 1.7 times that size; of half the size, it was
    to be added, or to be taken out; and one of the motion, behind a low-pass, was the other recording's."""
    own = moved() + hum(0.06)
    other = {
        "phase": moved() + np.roll(hum(0.06), 20, axis=0),
        "half": moved() + hum(0.03),
        "filter": later(own, 20.0),
    }[flaw]
    for exams in (pair(own, other), pair(other, own)):
        said = of_the_difference(exams, "accel", [])
        assert said is not None and said[0] == []
        assert [middle_hz(line) for line in said[1]] == pytest.approx([TONE], abs=0.01)


def test_of_a_vibration_that_both_read_it_is_said_that_it_is_not_compared() -> None:
    def read(late: int, seed: int) -> Examination:
        xyz = moved() + np.roll(hum(0.06), late, axis=0) + noise(seed)
        return examine(Samples(Sensor.ACCELEROMETER, T, xyz), None, sought=())

    said = compare_samples((read(0, 2), read(20, 3)), ("rec", "sim"))
    assert [d.effect for d in said.discrepancies] == []
    (why,) = (n.reason for n in said.not_compared if n.effect == "vibration_tone" and n.sensor == "accel")
    assert why.startswith("rec and sim both read one of 17.3 Hz")


def test_nothing_is_told_of_readings_without_noise_or_of_another_length() -> None:
    one, other = pair(moved(), moved())
    assert of_the_difference((one, one), "accel", []) is None
    assert of_the_difference((one, other), "gyro", []) is None
    short = SimpleNamespace(accelerometer=other.accelerometer[:-1], gyroscope=None)
    assert of_the_difference((one, short), "accel", []) is None  # type: ignore[arg-type]


@pytest.mark.parametrize(("other", "shared"), [(0.06, True), (0.05, True), (0.02, False), (0.0, False)])
def test_a_vibration_that_one_alone_seems_to_have_shakes_both_if_the_difference_lacks_it(
    other: float, *, shared: bool
) -> None:
    """An engine's line of 50 Hz that both read was lacking in the simulation of the same motion."""
    where = Where(10.0, 60.0, (TONE, TONE), "nothing")
    frequency = {"frequency": Parameter(TONE, [TONE, TONE], "Hz")}
    line = Finding("vibration_tone", "accel", ["x"], where, frequency, Evidence(0.0), [], "")
    assert shakes_both(line, pair(moved() + hum(0.06), moved() + hum(other))) == shared
    gone = Finding("vibration_tone", "gyro", ["x"], where, frequency, Evidence(0.0), [], "")
    assert not shakes_both(gone, pair(moved() + hum(0.06), moved() + hum(other)))
