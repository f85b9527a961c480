"""The whole diagnosis on simulated phones: silent on a sound one, and right about one that is not."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import HARDLY, checks_of
from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import sought
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import density
from stillcal.calib_core.diagnosis.diagnose import MEASURED, SEARCHED, diagnose, examine
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Claims, Diagnosis
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.phone.phone import Phone, load_phone
from stillcal.replay.phone.scenario import load_scenario
from stillcal.replay.phone.simulation import simulate


def diagnosed(*effects: dict[str, object], minutes: float = 20.0, rate: float = 50.0) -> Diagnosis:
    base = load_phone("typical")
    table = msgspec.to_builtins(base)
    for sensor in ("accel", "gyro"):
        table[sensor]["rate_hz"] = rate
    phone = msgspec.convert(table | {"effect": list(effects)}, type=Phone)
    day = msgspec.structs.replace(load_scenario("tables"), duration_s=60.0 * minutes)
    made = simulate(day, phone, 3).whole()
    told = {k: v for k, v in base.claimed().items() if k in Claims.__slots__} | {"nominal_rate_hz": rate}
    return diagnose(made.accelerometer, made.gyroscope, (), Claims(**told), "made")


def test_a_sound_phone_shows_nothing() -> None:
    assert diagnosed().findings == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "parameter", "truth", "tolerance"),
    [
        ({"name": "accel_gyro_time_offset", "delay": 0.015}, "delay", 0.015, 0.003),
        (
            {"name": "gyro_nonlinearity", "quadratic": [0.01, 0.0, 0.01]},
            "quadratic",
            [0.01, 0.0, 0.01],
            0.002,
        ),
        ({"name": "lever_arm", "position": [0.03, 0.06, 0.0]}, "position", [0.03, 0.06, 0.0], 0.02),
        ({"name": "bandwidth", "sensor": "gyro", "cutoff": 10.0}, "cutoff", 10.0, 1.0),
        ({"name": "timestamp_jitter", "sigma": 0.002}, "sigma", 0.002, 1e-4),
        ({"name": "noise_heavy_tailed", "sensor": "accel", "ratio": 5.0}, "ratio", 5.0, 0.6),
    ],
)
def test_one_fault_is_named_and_measured(
    effect: dict[str, object], parameter: str, truth: float | list[float], tolerance: float
) -> None:
    answer = diagnosed(effect)
    assert [f.effect for f in answer.findings] == [effect["name"]]
    value = answer.findings[0].parameters[parameter].value
    np.testing.assert_allclose(value, truth, atol=tolerance)


@pytest.mark.slow
def test_two_faults_are_both_named() -> None:
    matrix = [[2e-4, 0.0, 0.0], [0.0, 0.0, 2e-4], [0.0, 0.0, 0.0]]
    answer = diagnosed(
        {"name": "gyro_g_sensitivity", "matrix": matrix},
        {"name": "accel_bias_step", "step": [0.05, 0.0, 0.05], "at_s": 600.0},
    )
    assert {f.effect for f in answer.findings} == {"gyro_g_sensitivity", "accel_bias_step"}


def test_too_little_is_refused_and_no_gyroscope_is_said() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(6000) / 50.0
    samples = Samples.checked(Sensor.ACCELEROMETER, t, rng.normal(0, 0.01, (6000, 3)) + np.array([0, 0, 9.8]))
    with pytest.raises(NotSupported, match="at least 200, or the format rest"):
        diagnose(samples[:100], None)
    with pytest.raises(NotSupported, match="at least 10 s"):
        diagnose(samples[:400], None)
    done: list[float] = []
    exam = examine(samples, None, progress=done.append)
    assert exam.statements == []
    assert done == [MEASURED, SEARCHED]
    reasons = {(c.effect, c.sensor): c.reason for c in checks_of(exam, sought(exam))}
    assert reasons["gyro_bias_drift", "gyro"] == "no gyroscope"
    assert reasons["accel_bias_drift", "accel"] == HARDLY
    assert reasons["accel_bias_step", "accel"] is None
    assert reasons["accel_warmup", "accel"] == "it lasts 119 s, 120 s are needed"


def test_an_axis_that_never_changes_breaks_nothing() -> None:
    rng = np.random.default_rng(1)
    force = rng.normal(0, 0.01, (6000, 3)) + np.array([0, 0, 9.8])
    force[:, 1] = 0.25
    exam = examine(Samples.checked(Sensor.ACCELEROMETER, np.arange(6000) / 50.0, force), None)
    reasons = {(c.effect, c.sensor): c.reason for c in checks_of(exam, sought(exam))}
    assert reasons["accel_nonlinearity", "accel"] == "1 attitude at rest, 6 are needed"


@pytest.mark.slow
def test_what_a_simulation_without_noise_has_is_found() -> None:
    """It ended in a traceback, and a settling was told as something that no name explains."""
    t = np.arange(12000) / 10.0
    warm = 25.0 + 8.0 * np.sin(t / 180.0)
    force = np.array([0.3, 0.2, 9.8]) + np.outer(np.exp(-t / 150.0), [0.2, 0.05, 0.1])
    rate = np.outer(warm - 25.0, [5e-4, 1e-3, -3e-4])
    accelerometer = Samples.checked(Sensor.ACCELEROMETER, t, np.round(force, 6), warm)
    exam = examine(accelerometer, Samples.checked(Sensor.GYROSCOPE, t, np.round(rate, 7)))
    assert {s.finding.effect for s in exam.statements} == {"accel_warmup", "gyro_bias_temperature"}
    levels = [density(stream) for stream in exam.streams]
    assert len(levels) == 2 and all(level is not None and level.none for level in levels)


def test_of_a_simulation_without_noise_it_is_said_why_it_shows_no_tails_and_no_repeats() -> None:
    """Its values repeat at rest, held or not, and it was said to lack the repeats of the recording."""
    t, rng = np.arange(6000) / 10.0, np.random.default_rng(4)
    force = np.array([0.3, 0.2, 9.8]) + np.outer(np.maximum(np.sin(t / 9.0) - 0.9, 0.0), [5.0, 1.0, 2.0])
    held = (force + rng.normal(0.0, 0.02, force.shape))[np.arange(6000) // 2 * 2]
    noisy, ideal = (Samples.checked(Sensor.ACCELEROMETER, t, x) for x in (held, force))
    found = compare(examine(noisy, None, sought=()), examine(ideal, None, sought=()), ("rec", "sim"))
    why = {n.effect: n.reason for n in found.not_compared if n.sensor == "accel"}
    assert why["held_samples"] == "sim: it has no noise at all"
    assert why["noise_heavy_tailed"].endswith("sim: it has no noise at all")


@pytest.mark.parametrize("attitudes", [1, 8])
def test_a_simulation_without_noise_breaks_nothing(attitudes: int) -> None:
    """Eight attitudes ended in a singular matrix: beside such precision nothing of the priors was left."""
    rng, each = np.random.default_rng(9), 12000 // attitudes
    up = rng.normal(size=(attitudes, 3))
    force = np.repeat(9.81 * up / np.linalg.norm(up, axis=1, keepdims=True), each, axis=0)
    t, bias = np.arange(len(force)) / 5.0, np.array([0.1, 0.0, -0.05])
    ideal = examine(Samples.checked(Sensor.ACCELEROMETER, t, np.round(force, 6)), None)
    assert ideal.statements == []
    if attitudes > 1:
        noisy = Samples.checked(Sensor.ACCELEROMETER, t, force + bias + rng.normal(0, 0.02, force.shape))
        found = compare(examine(noisy, None), ideal, ("rec", "sim"))
        lacking = {(d.effect, d.relation) for d in found.discrepancies}
        assert lacking == {("accel_bias", "lacking"), ("noise_level", "lacking")}


@pytest.mark.parametrize("rate", [2.0, 5.0])
def test_a_slow_log_tells_its_noise_by_whole_rests(rate: float) -> None:
    """A bin of 10 s has too few samples for a spectrum; without a filter all noise is in the narrow band."""
    sd, each = 0.05, round(70.0 * rate)
    up = np.random.default_rng(3).normal(size=(20, 3))
    force = np.repeat(9.81 * up / np.linalg.norm(up, axis=1, keepdims=True), each, axis=0)
    t = np.arange(len(force)) / rate

    def noisy(seed: int) -> Examination:
        noise = np.random.default_rng(seed).normal(0.0, sd, force.shape)
        return examine(Samples.checked(Sensor.ACCELEROMETER, t, force + noise), None, sought=())

    level = density(noisy(1).streams[0])
    assert level is not None
    assert np.exp(level.value) == pytest.approx(sd * np.sqrt(2.0 / rate), rel=0.12)
    assert "noise_level" in [d.recorded.effect for d in compare(noisy(1), noisy(2), ("rec", "sim")).agreed]
