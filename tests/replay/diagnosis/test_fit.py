"""The answer's numbers: how well a simulation fits, before and after, and how its scales differ."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import Smallest
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, subtract
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy
from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.answer import Fit, answer_of
from stillcal.replay.diagnosis.built_in import judge_built_in
from stillcal.replay.diagnosis.given_simulation import judge_simulation
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording


def test_what_is_unknown_counts_in_both_and_a_rate_that_cannot_be_put_in_in_neither() -> None:
    both = Comparison(evidence=[("unknown", 20.0), ("sample_rate", 90.0)])
    fit = Fit.of(both, both, ["unknown", "sample_rate"])
    assert fit.p_before == fit.p_after == pytest.approx(np.exp(-20.0))
    rate = Comparison(evidence=[("accel_bias", -3.0), ("sample_rate", 90.0)])
    assert Fit.of(rate, rate, ["sample_rate"]).p_before == 1.0


def test_what_is_unknown_differs_afterwards_though_the_second_comparison_does_not_see_it() -> None:
    where = Where(0.0, 900.0, (0.0, 0.05), "time")
    found = [Discrepancy(name, "gyro", [], where, "lacking", 1.0, 20.0) for name in ("unknown", "gyro_bias")]
    evidence = [("unknown", 20.0), ("gyro_bias", 30.0)]
    before, after = Comparison(found, evidence=evidence), Comparison(evidence=[("gyro_bias", -3.0)])
    fit = Fit.of(before, after, ["unknown"])
    assert fit.p_after == pytest.approx(2.0 * np.exp(-20.0)) and fit.still_different == [("unknown", "gyro")]
    nothing = Fit.of(Comparison(found[:1], evidence=evidence), after, ["unknown"])
    assert nothing.p_after == nothing.p_before < 1e-8
    assert Fit.of(before, after).p_after == 1.0


def test_scales_that_share_gravitys_error_are_told_against_their_mean() -> None:
    """The difference of one scale alone was 0.49 +- 0.55 % beside a probability above 0.999."""
    common, own = 0.002**2 * np.ones((6, 6)), 1e-8 * np.eye(6)
    common[3:] = common[:, 3:] = 0.0
    parts = (Part("scale", "1", 3), Part("misalignment", "rad", 3))
    where = Where(0.0, 900.0, (0.0, 0.05), "nothing")

    def scale(x: float) -> Quantity:
        value = np.array([x, 0.002, -0.001, 0.0, 0.0, 0.0])
        alike = (np.full(6, 0.03), np.full(6, 2e-4), np.arange(6) % 3)
        return Quantity("accel_scale", "accel", parts, value, common + own, *alike, where=where)

    apart = subtract(scale(-0.003), scale(-0.008))
    one = Discrepancy("accel_scale", "accel", ["x"], where, apart.relation(), 1.0, 300.0, apart)
    (said,) = answer_of(Comparison([one]), ("real.csv", "sim.csv"), Fit(1e-9, 1.0), {}, None)["findings"]
    against = said["difference"]["scale_against_mean"]
    np.testing.assert_allclose(against["value"], [0.01 / 3.0, -0.005 / 3.0, -0.005 / 3.0])
    assert np.ptp(against["ci95"], axis=1).max() < 6e-4
    assert "The difference is scale against the mean of the axes x 0.333 ± 0.023 %." in said["statement"]


@pytest.mark.parametrize(("smallest", "said"), [(2e-3, True), (None, True), (1e-4, False)])
def test_a_bias_that_attitudes_do_not_tell_from_a_nonlinearity_says_so(
    smallest: float | None, said: bool
) -> None:
    """Rests on a phone's faces alone: 0.05 m/s^2 of bias do what 5.2e-4 of the force's square do."""
    where, parts = Where(0.0, 900.0, (0.0, 0.05), "nothing"), (Part("bias", "m/s^2", 3),)

    def bias(x: float) -> Quantity:
        alike = (np.full(3, 0.5), np.full(3, 2e-3), np.arange(3))
        return Quantity(
            "accel_bias", "accel", parts, np.array([x, 0.0, 0.0]), 1e-8 * np.eye(3), *alike, where=where
        )

    apart = subtract(bias(0.05), bias(0.0))
    one = Discrepancy("accel_bias", "accel", ["x"], where, apart.relation(), 1.0, 300.0, apart)
    unit = "1/(m/s^2)"
    seen = [] if smallest is None else [Smallest("accel_nonlinearity", "accel", "quadratic", smallest, unit)]
    answer = answer_of(Comparison([one], smallest=seen), ("real.csv", "sim.csv"), Fit(1e-9, 1.0), {}, None)
    (finding,) = answer["findings"]
    assert ("do not tell it from a nonlinearity of 0.00052 1/(m/s^2)" in finding["statement"]) is said


def test_a_difference_beyond_doubt_is_stated_with_how_often_such_statements_are_true() -> None:
    where = Where(0.0, 900.0, (0.0, 0.05), "time")
    sure, nearly = (Discrepancy("unknown", "gyro", [], where, "lacking", odds, 20.0) for odds in (1.0, 0.96))
    assert sure.true == pytest.approx(0.97) and nearly.true == pytest.approx(0.96 * 0.97)


def test_a_phone_that_is_played_is_stamped_when_it_samples_whatever_stamps_the_recording() -> None:
    n = 20_000
    force = np.array([0.0, 0.0, 9.81]) + np.random.default_rng(1).normal(0.0, 0.02, (n, 3))
    delivered = np.repeat(np.arange(4, n, 5) / 50.0, 5) + 1e-3 * np.tile(np.arange(-4, 1), n // 5)
    accelerometer = Samples(Sensor.ACCELEROMETER, frozen(delivered), frozen(force))
    said = judge_built_in(Recording(accelerometer, None, [], Claims(), [], name="log.csv")).answer
    assert [f["effect"] for f in said["findings"]] == ["arrival_bursts"]
    assert said["fit"]["still_different"] == [] and said["fit"]["p_after"] > 0.01


def test_a_vibration_put_into_the_gyroscope_alone_is_there_afterwards() -> None:
    """The accelerometers of both have it too, and state it; the gyroscope's was lost from what was put in."""

    def shaken(seed: int, gyro: float) -> Recording:
        rng, t = np.random.default_rng(seed), np.arange(0.0, 240.0, 0.02)
        wave = np.sin(2.0 * np.pi * 11.0 * t)[:, None]
        force = np.array([0.3, -0.5, 9.78]) + rng.normal(0.0, 0.02, (t.size, 3)) + 0.02 * wave
        rate = rng.normal(0.0, 1.5e-3, (t.size, 3)) + gyro * wave
        streams = ((Sensor.ACCELEROMETER, force), (Sensor.GYROSCOPE, rate))
        samples = [Samples(sensor, frozen(t), frozen(xyz)) for sensor, xyz in streams]
        return Recording(*samples, [], Claims(), [], name=f"{seed}.csv")

    judged = judge_simulation(shaken(1, 4e-3), shaken(2, 0.0))
    assert [(f["effect"], f["sensor"]) for f in judged.answer["findings"]] == [("vibration_tone", "gyro")]
    assert judged.answer["fit"]["p_before"] < 1e-9 and judged.answer["fit"]["p_after"] == 1.0
    assert judged.answer["verdict"] == "identified"


@pytest.mark.slow
def test_a_vibration_of_both_sensors_behind_a_low_pass_is_all_that_they_lack() -> None:
    """The gyroscope's part is told with the accelerometer's; of few frequencies the vibration is the most."""
    rng, t = np.random.default_rng(3), np.arange(0.0, 240.0, 0.02)
    wave = np.sin(2.0 * np.pi * 4.7 * t)[:, None]
    white = rng.normal(0.0, 1.0, (2, t.size, 3)) * np.array([0.02, 1.5e-3])[:, None, None]
    noise = lfilter(*butter(2, 6.0 / 25.0), white, axis=1)
    force, rate = np.array([0.3, -0.5, 9.78]) + noise[0] + 0.04 * wave, noise[1] + 3e-3 * wave
    streams = ((Sensor.ACCELEROMETER, force), (Sensor.GYROSCOPE, rate))
    samples = [Samples(sensor, frozen(t), frozen(xyz)) for sensor, xyz in streams]
    judged = judge_built_in(Recording(*samples, [], Claims(), [], name="fan.csv"))
    found = sorted((f["effect"], f["sensor"]) for f in judged.answer["findings"])
    assert found == [("bandwidth", "accel"), ("bandwidth", "gyro"), ("vibration_tone", "accel")]
    assert judged.answer["verdict"] == "identified"
