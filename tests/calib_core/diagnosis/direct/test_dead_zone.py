"""A dead zone is found with its width; coarse steps, missing bits, limits and a silent start are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.direct.dead_zone import DRIVER, beside, dead_zone, hides_rest
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.support.diagnosis.turned_pairs import turned


def zoned(values: np.ndarray, zero: float, width: float) -> np.ndarray:
    return np.where(np.abs(values - zero) < width, zero, values)


def swing(seed: int) -> np.ndarray:
    """Thirty rests of 300 samples at 0.002 and turns of 100 at up to 2: (n, 3), in steps or not."""
    rng = np.random.default_rng(seed)
    slow = np.repeat(rng.normal(0.0, 0.7, (31, 3)), 400, axis=0)
    turning = np.sin(np.pi * np.clip(np.arange(len(slow)) % 400 - 300, 0, 100) / 100.0)[:, None]
    return np.asarray(0.002 + slow * turning + rng.normal(0.0, 1e-3, slow.shape))


@pytest.mark.parametrize("step", [0.0, 5e-4])
@pytest.mark.parametrize("seed", range(3))
def test_a_dead_zone_is_found_with_its_width(seed: int, step: float) -> None:
    values = swing(seed)
    values = np.rint(values / step) * step if step else values
    found = dead_zone(Samples.checked(Sensor.GYROSCOPE, np.arange(len(values)) / 50.0, values), "gyro")
    assert found is None
    values = zoned(values, 0.0019, 0.018)
    found = dead_zone(Samples.checked(Sensor.GYROSCOPE, np.arange(len(values)) / 50.0, values), "gyro")
    assert found is not None and found.effect == "unknown" and found.axes == ["x", "y", "z"]
    assert found.parameters["width"].value == pytest.approx(0.018, rel=0.15)


@pytest.mark.parametrize("codes", [2, 3])
def test_a_dead_zone_of_a_few_steps_is_found(codes: int) -> None:
    values = np.rint(swing(1) / 5e-4)
    values = zoned(values, 4.0, codes) * 5e-4
    found = dead_zone(Samples.checked(Sensor.GYROSCOPE, np.arange(len(values)) / 50.0, values), "gyro")
    assert found is not None and found.axes == ["x", "y", "z"]
    assert found.parameters["width"].value == pytest.approx(codes * 5e-4, rel=0.01)


def test_the_noise_that_is_left_beside_a_dead_zone_is_not_judged() -> None:
    def finding(effect: str, driver: str = "own input") -> Finding:
        where, seen = Where(0.0, 1.0, (0.0, 1.0), driver), DirectEvidence(99.0)
        made = direct_finding(effect, "gyro", [0], where, {}, statement="", seen=seen)
        assert made is not None
        return made

    level, limit, zone = finding("noise_level"), finding("gyro_saturation"), finding("unknown")
    assert beside([level, limit, finding("unknown", "noise at rest")], zone) == [zone, limit]
    assert beside([level, limit], None) == [level, limit]


@pytest.mark.parametrize("seed", range(3))
def test_coarse_steps_dead_bits_limits_and_an_axis_that_reads_nothing_at_first_are_no_dead_zone(
    seed: int,
) -> None:
    fine = swing(seed)
    coarse, started = np.rint(fine / 0.02) * 0.02, fine + 9.8
    started[:500] = 0.0
    bit = (np.rint(fine / 5e-4).astype(int) & ~8) * 5e-4
    for values in (coarse, bit, started, np.clip(fine, -0.3, 0.3)):
        samples = Samples.checked(Sensor.GYROSCOPE, np.arange(len(values)) / 50.0, values)
        assert dead_zone(samples, "gyro") is None


def test_rates_that_a_simulation_jumps_to_are_no_dead_zone() -> None:
    """Without any noise, and never between 0 and the slowest of them."""
    rng = np.random.default_rng(2)
    rates = rng.uniform(0.4, 1.6, (80, 3)) * rng.choice([-1.0, 1.0], (80, 3))
    values = np.repeat(np.stack([np.zeros_like(rates), rates], axis=1).reshape(-1, 3), 100, axis=0)
    assert dead_zone(Samples.checked(Sensor.GYROSCOPE, np.arange(len(values)) / 50.0, values), "gyro") is None


def test_a_zone_wider_than_noise_and_bias_is_found_though_rests_have_no_noise() -> None:
    """Such rests were given that of a quiet phone, which filled the zone; turns showed a nonlinearity."""
    recording = turned(1, lambda force, rate: (force, rate), turns=40, rest=15.0)
    gyro = recording.gyroscope
    assert gyro is not None
    gated = replace(gyro, xyz=frozen(zoned(gyro.xyz + np.array([0.004, -0.003, 0.002]), 0.0, 0.02)))
    exam = examine(recording.accelerometer, gated)
    zones = [s.finding for s in exam.statements if s.finding.sensor == "gyro"]
    assert [(f.effect, f.where.driver) for f in zones] == [("unknown", "inputs that are nearly none")]
    assert exam.turns is None and exam.zone_at_rest


@pytest.mark.parametrize("width", [0.0032, 0.02])
def test_what_a_zone_hides_at_rest_is_not_compared(width: float) -> None:
    """The bias and the noise of the simulation were called superfluous, or too large and too small."""
    recording = turned(1, lambda force, rate: (force, rate), turns=16)
    simulation = turned(2, lambda force, rate: (force, rate), turns=16, motion=1)
    bias = np.array([0.003, -0.0025, 0.002])
    exams = []
    for one, zone in ((recording, width), (simulation, 0.0)):
        assert one.gyroscope is not None
        gyro = replace(one.gyroscope, xyz=frozen(zoned(one.gyroscope.xyz + bias, 0.0, zone)))
        exams.append(examine(one.accelerometer, gyro))
    compared = compare(exams[0], exams[1], ("real.csv", "sim.csv"))
    assert [(d.effect, d.sensor) for d in compared.discrepancies] == [("unknown", "gyro")]
    untold = {m.effect: m.reason for m in compared.not_compared if m.sensor == "gyro"}
    for effect in ("gyro_bias", "gyro_scale", "gyro_slow_noise", "noise_level", "held_samples"):
        assert untold[effect] == "real.csv: a dead zone hides what it reads at rest"
    assert ("noise_level", "accel") in {(a.recorded.effect, a.recorded.sensor) for a in compared.agreed}


@pytest.mark.parametrize(
    ("axes", "hidden"), [(("x",), True), (("x", "y"), True), (("y",), False), ((), False)]
)
def test_one_axis_that_reads_one_value_at_rest_hides_the_rest(axes: tuple[str, ...], hidden: bool) -> None:
    """The zone's axes count, and of them one is enough."""
    rest = np.random.default_rng(1).normal(0.0, 1.0, (500, 3))
    rest[:25, 0] = 0.0
    where, seen = Where(0.0, 1.0, (0.0, 0.0), DRIVER), DirectEvidence(99.0)
    zone = direct_finding("unknown", "gyro", [0], where, {}, statement="", seen=seen)
    assert zone is not None
    found = replace(zone, axes=list(axes))
    assert hides_rest([found] if axes else [], "gyro", [rest]) is hidden
    assert not hides_rest([found], "accel", [rest]) and not hides_rest([found], "gyro", [])
