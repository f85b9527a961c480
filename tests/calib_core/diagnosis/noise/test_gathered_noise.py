"""A line that is at another frequency in every rest is no noise, as much power as it adds on the average."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.noise.gathered_noise import gathered_noise, gathered_noise_finding
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import tones
from stillcal.calib_core.diagnosis.noise.low_pass import Quiet, judged
from stillcal.calib_core.diagnosis.noise.noise_level import levels, noise_findings
from stillcal.calib_core.streams.samples import Samples, Sensor

WHERE = Where(0.0, 1.0, (0.0, 1.0), "noise at rest")
PIECES, LONG, RATE = 40, 1000, 100.0


def rests(frequencies: Array, amplitude: float) -> Quiet:
    """Return rests of white noise with a line on y, at one of `frequencies` (P,), Hz, in each."""
    noise = np.random.default_rng(4).normal(size=(PIECES, LONG, 3))
    t = np.arange(LONG) / RATE
    noise[..., 1] += amplitude * np.sin(2.0 * np.pi * frequencies[:, None] * t)
    return Quiet(tuple(noise), tuple(10.0 * np.arange(PIECES)), RATE)


def told(still: Quiet) -> Finding | None:
    seen = judged(still)
    assert seen is not None
    return gathered_noise_finding(gathered_noise(seen), "gyro", sound_phones()["noise_gathered"], WHERE)


@pytest.mark.parametrize("amplitude", [0.6, 3.0])
def test_a_line_that_moves_has_no_name_and_its_axis_is_told(amplitude: float) -> None:
    found = told(rests(np.linspace(12.0, 38.0, PIECES), amplitude))
    assert found is not None
    assert (found.effect, found.axes) == ("unknown", ["y"])
    assert found.where.driver == "frequencies that change from rest to rest"


@pytest.mark.parametrize(("frequency", "amplitude"), [(0.0, 0.0), (22.0, 3.0)])
def test_white_noise_and_a_line_that_stays_are_not_gathered(frequency: float, amplitude: float) -> None:
    assert told(rests(np.full(PIECES, frequency), amplitude)) is None


def test_it_is_not_called_the_noise_of_an_axis() -> None:
    """As a whole recording, in which the same power would be an axis ten times as loud as the others."""
    still = rests(np.linspace(12.0, 38.0, PIECES), 12.0)
    seen = judged(still)
    assert seen is not None
    named = noise_findings("gyro", levels(seen), None, sound_phones(), WHERE)
    assert [f.effect for f in named] == ["noise_unequal_axes"], "alone, the level cannot tell"
    rate = 1e-3 * np.concatenate(still.pieces)
    force = np.random.default_rng(5).normal(size=rate.shape) * 0.01 + [0.0, 0.0, 9.81]
    t = np.arange(len(rate)) / RATE
    exam = examine(Samples(Sensor.ACCELEROMETER, t, force), Samples(Sensor.GYROSCOPE, t, rate), sought=())
    found = {(s.finding.effect, s.finding.where.driver) for s in exam.statements}
    assert ("unknown", "frequencies that change from rest to rest") in found
    assert "noise_unequal_axes" not in {effect for effect, _ in found}


def test_lines_that_come_back_beside_it_are_not_named_besides() -> None:
    """A tone that goes with the reading comes back in the attitudes that are taken again."""
    rate = 1e-3 * np.concatenate(rests(np.resize([12.0, 17.0, 23.0, 29.0, 34.0, 38.0], PIECES), 3.0).pieces)
    force = np.random.default_rng(5).normal(size=rate.shape) * 0.01 + [0.0, 0.0, 9.81]
    t = np.arange(len(rate)) / RATE
    gyroscope = Samples(Sensor.GYROSCOPE, t, rate)
    assert tones(gyroscope, "gyro"), "by themselves they are lines"
    exam = examine(Samples(Sensor.ACCELEROMETER, t, force), gyroscope, sought=())
    found = {(s.finding.effect, s.finding.where.driver) for s in exam.statements}
    assert ("unknown", "frequencies that change from rest to rest") in found
    assert "vibration_tone" not in {effect for effect, _ in found}
