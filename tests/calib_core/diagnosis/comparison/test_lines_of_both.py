"""A vibration that one of two recordings states is absent from the other only where that would show it."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.noise.lines.line_put_in import same_line, would_show
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import tones
from stillcal.calib_core.streams.samples import Samples, Sensor

NAMES = ("real.csv", "sim.csv")


def resting(seed: int, seconds: float, lines: dict[float, float], rate: float = 50.0) -> Samples:
    """Return an accelerometer at rest with lines on x: amplitude (m/s^2) by frequency (Hz)."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    force = np.array([0.3, -0.5, 9.78]) + np.random.default_rng(seed).normal(0.0, 0.02, (t.size, 3))
    force[:, 0] += sum(size * np.sin(2.0 * np.pi * f * t + seed) for f, size in lines.items())
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force))


def compared(one: Samples, other: Samples) -> Comparison:
    def examined(samples: Samples) -> Examination:
        return examine(samples, None, sought=())

    return compare(examined(one), examined(other), NAMES)


def differing(found: Comparison) -> list[tuple[str, str]]:
    return [(d.effect, d.relation) for d in found.discrepancies if d.sensor == "accel"]


@pytest.mark.parametrize("there", [True, False])
def test_a_short_rest_does_not_show_that_a_faint_line_is_absent(there: bool) -> None:
    """The line of half an hour was called superfluous beside a minute that has the same one."""
    long, short = resting(1, 1500.0, {11.0: 2.5e-3}), resting(2, 70.0, {11.0: 2.5e-3 * there})
    (line,) = tones(long, "accel")
    assert tones(short, "accel") == [] and not would_show(short, "accel", line)
    assert would_show(resting(2, 1500.0, {}), "accel", line)


def test_a_line_that_is_absent_is_told_where_it_would_show_alone() -> None:
    faint = {11.0: 2.5e-3}
    assert differing(compared(resting(1, 1500.0, {}), resting(2, 1500.0, faint))) == [
        ("vibration_tone", "superfluous")
    ]
    found = compared(resting(1, 70.0, faint), resting(2, 1500.0, faint))
    assert differing(found) == []
    untold = [m.reason for m in found.not_compared if (m.effect, m.sensor) == ("vibration_tone", "accel")]
    assert untold == ["real.csv: its rests would not show one of this size"]


def test_a_line_and_its_alias_may_be_one() -> None:
    assert same_line(33.0, 17.0, 50.0) and not same_line(33.0, 17.0, 100.0)
    assert not same_line(33.0, 18.0, 50.0)
    found = compared(resting(1, 400.0, {33.0: 0.01}), resting(2, 400.0, {33.0: 0.01}, rate=100.0))
    assert "vibration_tone" not in [effect for effect, _ in differing(found)]
    untold = [m.reason for m in found.not_compared if m.effect == "vibration_tone"]
    assert "sim.csv: its vibration at 33 Hz may be the same one, folded back" in untold


@pytest.mark.parametrize("gated", [0, 1])
def test_a_line_that_comes_and_goes_in_one_of_two_is_told_once(gated: int) -> None:
    """It was lacking and superfluous, by two names."""
    pair = [resting(seed, 900.0, {12.0: 0.01}) for seed in (1, 2)]
    pair[gated] = _off_every_other(pair[gated], resting(1 + gated, 900.0, {}))
    (told,) = compared(*pair).discrepancies
    assert (told.effect, told.relation) == ("unknown", ("lacking", "superfluous")[gated])
    own = (told.recorded, told.simulated)[gated]
    assert own is not None and own.remark.endswith(f"In {NAMES[1 - gated]} the vibration at 12 Hz is steady.")


def _off_every_other(on: Samples, off: Samples, seconds: float = 40.0) -> Samples:
    every: Array = (on.t // seconds) % 2.0
    return Samples(on.sensor, on.t, frozen(np.where(every[:, None] == 0.0, on.xyz, off.xyz)))
