"""What real phones do to stamps is no difference from the built-in simulation, and is said."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.model.records import Claims
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.support.diagnosis.turned_pairs import turned


def still(lost: float) -> Samples:
    """Return two minutes on a table with a part of the samples lost."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 120.0, 0.02)
    t = t[rng.random(t.size) >= lost]
    xyz = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.01, (t.size, 3))
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz))


def test_a_tenth_of_the_samples_lost_is_said_and_no_finding() -> None:
    said = compare_with_ideal(examine(still(0.1), None))
    assert "dropped_samples" not in {d.effect for d in said.discrepancies}
    (one,) = [c for c in said.common if c.quantity.effect == "dropped_samples"]
    assert abs(np.exp(one.quantity.value[0]) - 0.1) < 0.01
    assert one.note == "within what 40 real devices show; 7 of them show as much"


def test_what_is_declared_otherwise_is_a_finding_and_not_common() -> None:
    said = compare_with_ideal(examine(still(0.1), None, claims=Claims(nominal_rate_hz=50.0)))
    assert "dropped_samples" in {d.effect for d in said.discrepancies}
    assert "dropped_samples" not in {c.quantity.effect for c in said.common}


def test_what_most_devices_show_is_not_worth_telling() -> None:
    """Nor is what is as good as nothing: one sample in 12 000 that repeats the one before."""
    sound = still(0.0)
    twice = np.repeat(sound.xyz, 2, axis=0) + np.random.default_rng(5).normal(0.0, 0.01, (12000, 3))
    twice[6000] = twice[5999]
    samples = Samples(Sensor.ACCELEROMETER, frozen(np.arange(12000) / 100.0), frozen(twice))
    said = compare_with_ideal(examine(samples, None, sought=()))
    assert {"dropped_samples", "held_samples"}.isdisjoint(c.quantity.effect for c in said.common)


@pytest.mark.parametrize(("factor", "told"), [(1.0, False), (2.0, True)])
def test_a_gyroscope_of_another_range_is_said(factor: float, told: bool) -> None:
    """The ideal sensor has any scale, and nothing was said of one twice too large."""
    made = turned(1)
    assert made.gyroscope is not None
    rates = Samples(Sensor.GYROSCOPE, made.gyroscope.t, frozen(factor * made.gyroscope.xyz))
    said = compare_with_ideal(examine(made.accelerometer, rates, sought=()))
    notes = [c for c in said.common if c.quantity.effect == "gyro_scale"]
    assert len(notes) == int(told)
    for one in notes:
        np.testing.assert_allclose(one.quantity.value, -0.5, atol=0.02)


def test_claims_that_are_read_as_two_sided_are_said() -> None:
    """Noise of 0.01 at 50 Hz has the one-sided density 0.002; a claim of two-sided ones is sqrt(2) below."""
    force = still(0.0)
    rate = Samples(Sensor.GYROSCOPE, force.t, frozen(force.xyz - np.array([0.0, 0.0, 9.81])))
    for density, said_so in ((0.002 / np.sqrt(2.0), 2), (0.002, 0)):
        claims = Claims(accel_noise_density=density, gyro_noise_density=density)
        said = compare_with_ideal(examine(force, rate, claims=claims))
        notes = [c.note for c in said.common if c.quantity.effect == "noise_level"]
        assert len(notes) == said_so and all("two-sided" in note for note in notes)
