"""Two sensors on one motion: a paired simulation, and witnesses on the same body."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.pair import compare
from stillcal.calib_core.diagnosis.comparison.pair.measured import Alone, each_alone
from stillcal.calib_core.diagnosis.comparison.pair.mounting import shared_as_it_is
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import pair_residuals
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, subtract
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.likelihood import fit_hypothesis, reduce_residuals
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.errors import NotSupported, UserError
from stillcal.calib_core.streams.resample import read_later, temperature_at
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.diagnosis.pair.as_both import MEAN_S, as_both, unsure_delay
from stillcal.replay.diagnosis.pair.paired import judge_paired
from stillcal.replay.diagnosis.pair.readings import (
    less,
    mean_readings,
    readings_of,
    refuse_itself,
    refuse_other_motion,
)
from stillcal.replay.diagnosis.pair.witnesses import MISMATCH, judge_with_witnesses
from stillcal.replay.diagnosis.sample_changes import held_at
from stillcal.replay.diagnosis.words.summary import summary
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording, read_all
from tests.support.diagnosis import turned_pairs
from tests.support.diagnosis.turned_pairs import low_passed, turned

RATE, LENGTH = 20.0, 320.0
SLOPE = np.array([4e-4, 0.0, -2e-4])
"""Of the gyroscope's bias, rad/s/K."""
DELAY = 0.04
"""s"""


def motion(t: Array) -> tuple[Array, Array]:
    """Return force and rate (n, 3) of a device that is turned to and fro in the hand."""
    half = 0.5 / RATE
    before, now, after = (_attitude(t + shift) for shift in (-half, 0.0, half))
    rate = (before.inv() * after).as_rotvec() * RATE
    return now.inv().apply([0.0, 0.0, 9.80665]), np.asarray(rate)


def _attitude(t: Array) -> Rotation:
    angles = np.stack([0.11 * t, 1.2 * np.sin(0.4 * t), np.sin(0.9 * t)], axis=1)
    return Rotation.from_euler("ZYX", angles)


def recording(
    seed: int,
    *,
    name: str = "real.csv",
    slope: Array | None = None,
    bias: Array | None = None,
    noise: float = 1.0,
    about: float = 30.0,
) -> Recording:
    """Return a device that is never still, and warms and cools twice; seed: of its noise, not its motion.

    about: degC at which the slope adds nothing.
    """
    t = np.arange(0.0, LENGTH, 1.0 / RATE)
    force, rate = motion(t)
    temperature = 30.0 + 4.0 * np.sin(4.0 * np.pi * t / LENGTH)
    rng = np.random.default_rng(seed)
    rate = rate + (0.0 if slope is None else np.outer(temperature - about, slope))
    rate = rate + noise * rng.normal(0.0, 1e-3, rate.shape)
    force = force + (0.0 if bias is None else bias) + noise * rng.normal(0.0, 0.01, force.shape)
    accel = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force), frozen(temperature))
    gyro = Samples(Sensor.GYROSCOPE, frozen(t), frozen(rate))
    return Recording(accel, gyro, [], Claims(), [], name=name)


@pytest.mark.slow
def test_what_a_paired_simulation_lacks_is_found_though_nothing_is_at_rest() -> None:
    bias = np.array([0.05, 0.0, 0.0])
    shown: list[tuple[str, float]] = []
    said = judge_paired(
        recording(1, slope=SLOPE, bias=bias, about=26.0),
        recording(2, name="sim.csv", noise=0.0),
        lambda stage, done: shown.append((stage, done)),
    ).answer
    pair = "comparing the readings of one motion"
    assert [done for stage, done in shown if stage == pair] == [0.0, 0.5, 1.0]
    assert shown[-1][0] == "comparing again, without what was found"
    found = {f["effect"]: f for f in said["findings"]}
    assert set(found) == {"accel_bias", "gyro_bias_temperature"}
    assert {f["relation"] for f in found.values()} == {"lacking"}
    for effect, name, truth in (("accel_bias", "bias", bias), ("gyro_bias_temperature", "slope", SLOPE)):
        low, high = np.asarray(found[effect]["difference"][name]["ci95"]).T
        assert (np.abs(truth - (low + high) / 2.0) < 0.75 * (high - low)).all()
    assert said["verdict"] == "identified"
    assert said["fit"]["p_before"] < 1e-6 and said["fit"]["p_after"] > 0.01
    reasons = {n["effect"]: n["reason"] for n in said["not_compared"]}
    assert {"gyro_nonlinearity", "lever_arm", "accel_gyro_time_offset"}.isdisjoint(reasons)


@pytest.mark.slow
def test_samples_that_one_of_the_two_holds_leave_nothing_that_follows_motion() -> None:
    real = turned(1)
    assert real.gyroscope is not None
    again = np.random.default_rng(3).random(len(real.gyroscope)) < 0.2
    held = replace(
        real,
        accelerometer=held_at(real.accelerometer, again),
        gyroscope=held_at(real.gyroscope, again),
    )
    said = judge_paired(held, turned(2)).answer
    assert {(f["effect"], f["relation"]) for f in said["findings"]} == {("held_samples", "lacking")}
    assert said["verdict"] == "identified" and said["fit"]["p_after"] > 0.01


def test_a_delay_is_right_where_one_of_the_two_holds_samples() -> None:
    """What is held has no rate of change, by which a delay is known: of 40 ms it made 36, and 3e-37."""
    real = turned(1)
    assert real.gyroscope is not None
    again = np.random.default_rng(3).random(len(real.gyroscope)) < 0.2
    late = replace(real, gyroscope=held_at(read_later(real.gyroscope, DELAY), again))
    said = judge_paired(late, turned(2)).answer
    found = {(f["effect"], f["sensor"]): f for f in said["findings"]}
    assert set(found) == {("accel_gyro_time_offset", "timing"), ("held_samples", "gyro")}
    delay = found["accel_gyro_time_offset", "timing"]["difference"]["delay"]
    assert delay["value"] == pytest.approx(DELAY, abs=np.ptp(delay["ci95"]))
    assert said["fit"]["p_after"] > 0.01


@pytest.mark.slow
def test_a_paired_simulation_that_is_right_is_a_match() -> None:
    said = judge_paired(
        recording(1, slope=SLOPE), recording(2, name="sim.csv", slope=SLOPE, noise=0.0)
    ).answer
    assert (said["verdict"], said["findings"]) == ("match", [])


@pytest.mark.slow
def test_the_earths_rotation_that_a_simulation_leaves_out_is_no_effect_of_the_gyroscope() -> None:
    real, sim = recording(1, noise=0.05), recording(2, noise=0.05, name="sim.csv")
    assert real.gyroscope is not None
    earth = _attitude(real.gyroscope.t).inv().apply([0.0, 4.9e-5, 5.4e-5])
    turned_too = replace(real.gyroscope, xyz=frozen(real.gyroscope.xyz + earth))
    said = judge_paired(replace(real, gyroscope=turned_too), sim).answer
    assert said["findings"] == [] and said["verdict"] == "match"


@pytest.mark.slow
def test_a_scale_is_that_of_the_correction_however_large() -> None:
    """A sensor that reads 5 % too much is corrected by 1 / 1.05, which is not 5 % less."""
    real, sim = recording(1, noise=0.05), recording(2, noise=0.05, name="sim.csv")
    assert real.gyroscope is not None
    gains = np.array([[1.05, 0.01, 0.0], [-0.02, 0.97, 0.0], [0.0, 0.0, 1.0]])
    wrong = replace(real.gyroscope, xyz=frozen(real.gyroscope.xyz @ gains.T))
    said = judge_paired(replace(real, gyroscope=wrong), sim).answer
    (found,) = said["findings"]
    assert found["effect"] == "gyro_scale"
    truth = np.linalg.inv(gains) - np.eye(3)
    np.testing.assert_allclose(found["difference"]["scale"]["value"], truth, atol=3e-4)


@pytest.mark.slow
def test_what_fits_no_model_in_motion_is_no_bias_and_no_scale() -> None:
    """The gyroscope takes up force that only motion has; at rest, three quarters of the time, nothing is."""

    def taken_up(force: Array, rate: Array) -> tuple[Array, Array]:
        return force, rate + 0.01 * np.tanh(np.linalg.norm(rate, axis=1) ** 2 * rate[:, [1, 2, 0]].T).T

    said = judge_paired(turned(1, taken_up), turned(2)).answer
    found = {(f["effect"], f["sensor"]): f for f in said["findings"]}
    assert found["unknown", "gyro"]["of_either"] and ("gyro_bias", "gyro") not in found
    assert said["fit"]["p_after"] < 1e-6
    said = judge_paired(turned(1), turned(2)).answer
    assert (said["verdict"], said["findings"]) == ("match", [])


def warmed(made: Recording, name: str, slope: float, scale: float = 0.0) -> Recording:
    """Return a recording whose force on x follows temperature, m/s^2/K, and reads a part too much."""
    accel = made.accelerometer
    warmth = 6.0 * np.sin(4.0 * np.pi * accel.t / accel.t[-1])
    xyz = accel.xyz * np.array([1.0 + scale, 1.0, 1.0]) + np.outer(warmth, [slope, 0.0, 0.0])
    changed = replace(accel, xyz=frozen(xyz), temperature=frozen(30.0 + warmth))
    return replace(made, accelerometer=changed, name=name)


@pytest.mark.slow
def test_a_simulation_that_has_more_of_an_effect_does_not_lack_it() -> None:
    """By its own rests it has twice the slope, and a scale that the recording has nothing of."""
    recorded, simulated = 0.01, 0.02
    real, sim = warmed(turned(1), "real.csv", recorded), warmed(turned(2), "sim.csv", simulated, 0.02)
    said = judge_paired(real, sim).answer
    found = {f["effect"]: f for f in said["findings"]}
    assert {effect: f["relation"] for effect, f in found.items()} == {
        "accel_bias_temperature": "too_large",
        "accel_scale": "superfluous",
    }
    slope = found["accel_bias_temperature"]
    assert "lacks" not in slope["statement"]
    for side, truth in (("simulated", simulated), ("difference", recorded - simulated)):
        low, high = slope[side]["slope"]["ci95"][0]
        assert low <= truth <= high
    assert said["verdict"] == "identified"


def bent(force: Array, rate: Array) -> tuple[Array, Array]:
    return force, rate + rate**3 * np.array([1.5e-3, 0.0, 0.0])


@pytest.mark.slow
def test_an_effect_of_turns_is_found_put_in_and_gone() -> None:
    """A cube in the rate: in means over bins it would be a wrong scale."""
    said = judge_paired(turned(1, bent), turned(2)).answer
    assert [(f["effect"], f["axes"], f["relation"]) for f in said["findings"]] == [
        ("gyro_nonlinearity", ["x"], "lacking")
    ]
    low, high = said["findings"][0]["difference"]["cubic"]["ci95"][0]
    assert low <= 1.5e-3 <= high < 1.8e-3
    assert (said["verdict"], said["fit"]["not_put_in"]) == ("identified", [])


def with_noise(made: Recording, accel: float, gyro: float = 0.0) -> Recording:
    """Return a recording with more white noise, of these standard deviations."""
    rng = np.random.default_rng(77)
    assert made.gyroscope is not None
    force, rate = made.accelerometer.xyz, made.gyroscope.xyz
    return replace(
        made,
        accelerometer=replace(made.accelerometer, xyz=frozen(force + rng.normal(0.0, accel, force.shape))),
        gyroscope=replace(made.gyroscope, xyz=frozen(rate + rng.normal(0.0, gyro, rate.shape))),
    )


@pytest.mark.slow
def test_noise_at_rest_is_compared_as_of_two_recordings() -> None:
    """Twice the accelerometer's noise; put into the simulation, it differs no longer."""
    said = judge_paired(with_noise(turned(1), 0.008 * np.sqrt(3.0)), turned(2)).answer
    assert [(f["effect"], f["sensor"], f["relation"]) for f in said["findings"]] == [
        ("noise_level", "accel", "too_small")
    ]
    own = said["findings"][0]
    ratio = np.divide(own["parameters"]["density"]["value"], own["simulated"]["density"]["value"])
    assert ratio == pytest.approx([2.0, 2.0, 2.0], rel=0.1)
    assert (said["verdict"], said["fit"]["p_before"] < 1e-6, said["fit"]["p_after"] > 0.01) == (
        "identified",
        True,
        True,
    )
    assert ("noise_level", "gyro") in {(a["effect"], a["sensor"]) for a in said["agreed"]}
    said = judge_paired(turned(1), with_noise(turned(2), 0.0, 1e-3)).answer
    assert [(f["effect"], f["sensor"], f["relation"]) for f in said["findings"]] == [
        ("noise_level", "gyro", "too_large")
    ]
    assert said["fit"]["not_put_in"] == ["noise_level"]


def with_rate(made: Recording, change: Callable[[Samples], Samples]) -> Recording:
    """Return a recording whose gyroscope is another one."""
    assert made.gyroscope is not None
    return replace(made, gyroscope=change(made.gyroscope))


def clipped(samples: Samples) -> Samples:
    """Return readings that stop at 1.2 rad/s."""
    return replace(samples, xyz=frozen(np.clip(samples.xyz, -1.2, 1.2)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "effect", "sizes"),
    [
        (lambda rate: read_later(rate, 0.03), "accel_gyro_time_offset", {"delay": 0.03}),
        (lambda rate: low_passed(rate, 0.2), "bandwidth", {"cutoff": 0.2 * turned_pairs.RATE}),
        (clipped, "gyro_saturation", {"limit": 1.2}),
    ],
)
def test_a_delay_a_filter_and_a_limit_are_found_put_in_and_gone(
    change: Callable[[Samples], Samples], effect: str, sizes: dict[str, float]
) -> None:
    """Nothing else is told beside them: what they do to motion is no wrong scale, and nothing unknown."""
    said = judge_paired(with_rate(turned(1), change), turned(2)).answer
    assert [(f["effect"], f["relation"]) for f in said["findings"]] == [(effect, "lacking")]
    for name, size in sizes.items():
        low, high = said["findings"][0]["parameters"][name]["ci95"]
        assert low <= size <= high
    assert said["findings"][0]["alternatives"] == []
    assert (said["verdict"], said["fit"]["not_put_in"]) == ("identified", [])
    assert said["fit"]["p_before"] < 1e-6 and said["fit"]["p_after"] > 0.01


@pytest.mark.slow
def test_a_delay_of_the_simulation_alone_is_its_own() -> None:
    """Its own turns show it, so it is to be taken out, and nothing is to be added to make it good."""
    sim = with_rate(turned(2), lambda rate: read_later(rate, 0.03))
    (said,) = judge_paired(turned(1), sim).answer["findings"]
    assert (said["effect"], said["relation"]) == ("accel_gyro_time_offset", "superfluous")
    low, high = said["simulated"]["delay"]["ci95"]
    assert low <= 0.03 <= high


def test_other_stamps_are_refused_with_the_first_that_differs() -> None:
    real, other = recording(1), recording(2, name="sim.csv")
    t = other.accelerometer.t.copy()
    t[100:] += 0.02
    late = replace(other, accelerometer=replace(other.accelerometer, t=frozen(t)))
    with pytest.raises(
        UserError, match=r"sim.csv: sample 101 of the accelerometer is stamped 5.02 s, not 5 s"
    ):
        judge_paired(real, late)
    short = replace(other, accelerometer=other.accelerometer[:-1])
    with pytest.raises(UserError, match=r"it has 6399 samples of the accelerometer, not 6400"):
        judge_paired(real, short)


def test_another_motion_and_values_that_are_late_are_refused() -> None:
    real = turned(1)
    with pytest.raises(UserError, match=r"3.csv: is of another motion .* shares \d+% of the motion"):
        judge_paired(real, turned(3, motion=1))

    def late(samples: Samples) -> Samples:
        return replace(samples, xyz=frozen(np.roll(samples.xyz, 25, axis=0)))

    sim = with_rate(turned(2), late)
    with pytest.raises(UserError, match=r"2.csv: is of another motion .* late against it"):
        judge_paired(real, replace(sim, accelerometer=late(sim.accelerometer)))


@pytest.mark.parametrize("change", [0.5 * np.eye(3), np.diag([-1.0, 1.0, 1.0]), np.eye(3)[[0, 2, 1]]])
def test_a_gyroscope_of_another_range_or_with_other_axes_is_not_another_motion(change: Array) -> None:
    """It shared 0 % of the motion by its rates, though both accelerometers read the same of it."""
    sim = with_rate(turned(2), lambda rate: replace(rate, xyz=frozen(rate.xyz @ change)))
    refuse_other_motion(turned(1), sim)
    shared = shared_as_it_is(readings_of(turned(1)), readings_of(sim))
    assert shared is not None and shared > 0.99


@pytest.mark.parametrize(("by", "said"), [(0.05, "50 ms later"), (-0.05, "50 ms earlier")])
def test_a_simulation_whose_two_sensors_are_shifted_alike_is_refused(by: float, said: str) -> None:
    sim = with_rate(turned(2), lambda rate: read_later(rate, by))
    with pytest.raises(UserError, match=rf"2.csv: reads the motion {said} than 1.csv"):
        judge_paired(turned(1), replace(sim, accelerometer=read_later(sim.accelerometer, by)))


def test_a_short_pair_is_too_little_data() -> None:
    def brief(one: Recording) -> Recording:
        assert one.gyroscope is not None
        return replace(one, accelerometer=one.accelerometer[:600], gyroscope=one.gyroscope[:600])

    with pytest.raises(NotSupported, match="30 s of the same motion"):
        judge_paired(brief(recording(1)), brief(recording(2)))


@pytest.mark.slow
def test_how_a_witness_is_mounted_is_no_finding() -> None:
    """Its bias and scale are its own. What changes with the temperature of both may be of either."""
    witness = recording(2, name="witness.csv", bias=np.array([0.3, 0.0, 0.1]))
    turned = frozen(
        witness.accelerometer.xyz @ np.array([[1.0, 0.02, 0.0], [-0.02, 1.01, 0.0], [0.0, 0.0, 1.0]])
    )
    witness = replace(witness, accelerometer=replace(witness.accelerometer, xyz=turned))
    said = judge_with_witnesses(recording(1, slope=SLOPE), [witness]).answer
    (told,) = said["findings"]
    assert told["effect"] == "gyro_bias_temperature"
    assert told["probability"] == pytest.approx(0.5 * 0.97, abs=1e-3) and said["fit"]["p_before"] > 0.1
    assert told["owners"] == {"real.csv": pytest.approx(0.5), "witness.csv": pytest.approx(0.5)}
    assert told["statement"].startswith("Of real.csv or witness.csv, which these sensors do not decide: ")
    assert "not all of them surely the recording's" in summary(said)[0]


def test_a_witness_of_another_time_is_refused() -> None:
    witness = recording(2, name="witness.csv")
    assert witness.gyroscope is not None
    later = replace(
        witness,
        accelerometer=replace(witness.accelerometer, t=frozen(witness.accelerometer.t + 400.0)),
        gyroscope=replace(witness.gyroscope, t=frozen(witness.gyroscope.t + 400.0)),
    )
    with pytest.raises(
        UserError, match=r"witness.csv: recorded the accelerometer from 400 to .* at least half"
    ):
        judge_with_witnesses(recording(1), [later])


def test_carbonix_third_sensor_with_the_others_as_witnesses(data_dir: Path) -> None:
    """ArduPilot's polynomial of temperature, undone, moves the estimated slopes by as much as it holds."""
    log = data_dir / "carbonix/flight_three_imus.npz"
    third, *others = (read_all(log, sensor=sensor) for sensor in ("2", "0", "1"))
    settings = json.loads(str(np.load(log)["parameters"]))
    logged, undone = (_slope(one, others) for one in (third, _undone(third, settings)))
    warm = temperature_at(third.accelerometer, third.accelerometer.t)
    assert warm is not None
    truth = np.polyfit(warm - warm.mean(), _polynomial(settings, warm), 1)[0]
    error = np.maximum(logged[1], undone[1])
    assert (np.abs(undone[0] - logged[0] - truth) < 1.96 * error).all()
    assert (error < 0.7 * np.abs(truth).max()).all()


def _polynomial(settings: dict[str, float], warm: Array) -> Array:
    """Return what ArduPilot takes off the third gyroscope (n, 3), rad/s, about 35 degC."""
    k = np.arange(1, 4)
    of = np.array([[settings[f"INS_TCAL3_GYR{power}_{axis}"] for power in k] for axis in "XYZ"])
    return np.asarray((warm[:, None] - 35.0) ** k @ (1e-6 * of).T)


def _undone(one: Recording, settings: dict[str, float]) -> Recording:
    gyro = one.gyroscope
    assert gyro is not None
    warm = temperature_at(one.accelerometer, gyro.t)
    assert warm is not None
    return replace(one, gyroscope=replace(gyro, xyz=frozen(gyro.xyz + _polynomial(settings, warm))))


def _slope(one: Recording, others: list[Recording]) -> tuple[Array, Array]:
    """Return the slope of the gyroscope's bias in temperature (3,) and its standard errors, rad/s/K."""
    true = mean_readings(one, others)
    _, sensors = pair_residuals(less(one, true), true, [], MISMATCH)
    wanted = sensors[1].hypothesis(BiasTemperature("gyro"), {})
    fit = fit_hypothesis(reduce_residuals(sensors[1], [wanted]), 0)
    return fit.beta * wanted.sizes, np.sqrt(fit.covariance.diagonal()) * wanted.sizes


def test_the_recording_itself_is_no_witness_and_no_simulation() -> None:
    own = recording(1)
    again = replace(own, name="again.csv")
    for judge in (lambda: judge_paired(own, again), lambda: judge_with_witnesses(own, [recording(2), again])):
        with pytest.raises(UserError, match=r"again\.csv: holds the very samples of real\.csv"):
            judge()


def test_a_simulation_may_differ_in_its_gyroscope_alone() -> None:
    own, other = recording(1, slope=SLOPE), recording(1, name="sim.csv")
    assert np.array_equal(own.accelerometer.xyz, other.accelerometer.xyz)
    refuse_itself(own, [other], simulated=True)
    with pytest.raises(UserError, match=r"sim\.csv: holds the very samples of real\.csv"):
        refuse_itself(own, [other])


@pytest.mark.slow
def test_what_only_the_gyroscope_of_a_simulation_lacks_is_found() -> None:
    said = judge_paired(recording(1, slope=SLOPE), recording(1, name="sim.csv")).answer
    assert [(f["effect"], f["relation"]) for f in said["findings"]] == [("gyro_bias_temperature", "lacking")]


BIAS = np.array([0.2, -0.3, 0.0])


def biased(force: Array, rate: Array) -> tuple[Array, Array]:
    return force + BIAS, rate


@pytest.mark.slow
def test_exchanged_axes_of_one_of_a_pair_are_put_right_before_all_else() -> None:
    """Its bias was said to differ as well, by what the exchange makes of it."""

    def exchanged(force: Array, rate: Array) -> tuple[Array, Array]:
        return (force + BIAS) * [1.0, -1.0, 1.0], rate

    said = judge_paired(turned(1, exchanged), turned(2, biased)).answer
    assert [(f["effect"], f["sensor"], f["relation"]) for f in said["findings"]] == [
        ("axis_exchange", "accel", "lacking")
    ]
    assert "All else was compared with these axes put right." in said["findings"][0]["statement"]
    assert said["verdict"] == "identified" and said["fit"]["p_after"] > 0.01
    agreed = {a["effect"]: a["parameters"] for a in said["agreed"]}
    assert agreed["accel_bias"]["bias"]["value"] == pytest.approx(BIAS, abs=0.05)
    said = judge_paired(turned(2, biased), turned(1, exchanged)).answer
    assert [(f["effect"], f["relation"]) for f in said["findings"]] == [("axis_exchange", "superfluous")]


@pytest.mark.slow
def test_bias_and_scale_of_which_a_pair_agrees_are_listed_as_both_have_them() -> None:
    """They were neither stated, nor agreed, nor among what is not compared."""
    said = judge_paired(turned(1, biased), turned(2, biased)).answer
    assert said["findings"] == []
    agreed = {a["effect"]: a["parameters"] for a in said["agreed"]}
    assert agreed["accel_bias"]["bias"]["value"] == pytest.approx(BIAS, abs=0.05)


@pytest.mark.parametrize(("rate", "least"), [(50.0, 3e-3), (400.0, 1.9e-3)])
def test_what_a_low_pass_delays_is_as_unsure_as_digital_and_analogue_ones_differ(
    rate: float, least: float
) -> None:
    """An analogue one of 12 Hz and the second order delays by 18.8 ms, a digital one at 50 Hz by 15.1 ms."""
    part = (Part("cutoff", "Hz", 1),)
    one = Quantity("bandwidth", "accel", part, np.log([12.0]), np.eye(1), np.ones(1), np.ones(1),
                   np.zeros(1, dtype=int), reference={"order": 2.0}, logarithmic=True)  # fmt: skip
    assert least < unsure_delay(one, rate) < 1.2 * least


def test_what_a_cutoff_is_not_known_by_is_left_in_means_of_motion() -> None:
    """Beside a low-pass of 9.8 Hz, known by 2 %, 0.04 mg of a wrist's motion were "something unknown"."""
    both, part = (turned(1), turned(2)), (Part("cutoff", "Hz", 1),)
    found = Quantity("bandwidth", "gyro", part, np.log([2.0]), np.array([[0.02**2]]), np.ones(1), np.ones(1),
                     np.zeros(1, dtype=int), reference={"order": 1.0}, logarithmic=True)  # fmt: skip
    exams = [examined(one, sought=()) for one in both]
    behind = [replace(found, value=found.value + more) for more in (0.0, 0.04)]
    made, off = (as_both(both, exams, [subtract(one, replace(one, none=True))]) for one in behind)
    assert made.simulation.gyroscope is not None and off.simulation.gyroscope is not None
    apart = off.simulation.gyroscope.xyz - made.simulation.gyroscope.xyz
    size = int(MEAN_S * turned_pairs.RATE)
    means = np.abs(apart[: len(apart) // size * size].reshape(-1, size, 3).mean(axis=1))
    assert list(made.left) == ["gyro"]
    assert made.left["gyro"] == pytest.approx(np.quantile(means, 0.9, axis=0), rel=0.1)


@pytest.mark.parametrize("effect", ["bias", "scale"])
def test_at_one_attitude_what_differs_all_along_is_told_with_what_it_may_be(effect: str) -> None:
    """Neither is known beside the other: 15 mg between two recordings of one motion were no difference."""
    t = np.arange(0.0, 60.0, 0.02)
    held = np.array([-6.0, 1.0, 7.7])

    def lying(seed: int, error: Array) -> Recording:
        rng = np.random.default_rng(seed)
        force = held + error + 0.02 * rng.normal(size=(t.size, 3))
        rate = 1e-3 * rng.normal(size=(t.size, 3))
        both = (Sensor.ACCELEROMETER, force), (Sensor.GYROSCOPE, rate)
        accel, gyro = (Samples(sensor, frozen(t), frozen(xyz)) for sensor, xyz in both)
        return Recording(accel, gyro, [], Claims(), [], name=f"{seed}.csv")

    error = np.array([0.0, 0.0, 0.15]) if effect == "bias" else 0.02 * held
    said = judge_paired(lying(1, error), lying(2, np.zeros(3))).answer
    (one,) = said["findings"]
    assert one["relation"] == "lacking" and said["fit"]["p_after"] > 0.01
    assert one["effect"] == "accel_bias"
    assert {a["effect"] for a in one["alternatives"] if a["indistinguishable"]} == {"accel_scale"}
    text = "\n".join(summary(said))
    assert "cannot tell it from" in text and "Rests in more attitudes decide it" in text
    assert judge_paired(lying(1, np.zeros(3)), lying(2, np.zeros(3))).answer["verdict"] == "match"


def test_a_bias_within_what_is_alike_anyway_is_none_at_one_attitude() -> None:
    """0.0135 % of scale were told beside a slope of temperature that made them."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 200.0, 0.02)

    def lying(error: float) -> Recording:
        force = np.array([-6.0, 1.0, 7.7 + error]) + 0.002 * rng.normal(size=(t.size, 3))
        accel = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force))
        gyro = Samples(Sensor.GYROSCOPE, frozen(t), frozen(1e-3 * rng.normal(size=(t.size, 3))))
        return Recording(accel, gyro, [], Claims(), [], name=f"{error}.csv")

    assert judge_paired(lying(5e-4), lying(0.0)).answer["verdict"] == "match"


@pytest.mark.slow
def test_a_vibration_is_told_of_a_pair_that_is_never_still_and_taken_off_the_difference() -> None:
    real, simulated = recording(1), recording(2, name="sim.csv")
    t = real.accelerometer.t
    shaken = real.accelerometer.xyz + np.outer(np.sin(2.0 * np.pi * 6.3 * t), [0.0, 0.05, 0.0])
    real = replace(real, accelerometer=replace(real.accelerometer, xyz=frozen(shaken)))
    for pair, relation in (((real, simulated), "lacking"), ((simulated, real), "superfluous")):
        said = judge_paired(*pair).answer
        (found,) = said["findings"]
        assert (found["effect"], found["relation"]) == ("vibration_tone", relation)
        assert said["fit"]["p_before"] < 1e-6 and said["fit"]["p_after"] > 0.01


def laid(places: list[list[float]], bias: list[float], error: list[float]) -> tuple[Recording, Recording]:
    """Return a recording and a simulation of a phone laid in `places` one after the other, for 66 s."""
    rng, t = np.random.default_rng(3), np.arange(0.0, 66.0, 0.05)
    place = t * len(places) / 66.0 - 0.5
    place = np.floor(place) + np.clip(15.0 * (place % 1.0 - 0.5) + 0.5, 0.0, 1.0)
    held = np.stack([np.interp(place, np.arange(len(places)), axis) for axis in zip(*places, strict=True)], 1)

    def read(force: Array) -> Recording:
        accel = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force + 0.03 * rng.normal(size=force.shape)))
        gyro = Samples(Sensor.GYROSCOPE, frozen(t), frozen(2e-3 * rng.normal(size=force.shape)))
        return Recording(accel, gyro, [], Claims(), [], name="laid.csv")

    return read(held * (1.0 + np.array(error)) + bias), read(held)


ERROR = [-0.0083, 0.0037, 0.0296]
PLACES = [[2.0, 8.6, 4.27], [-1.5, 3.0, -9.2]]


def test_a_scale_that_may_have_a_bias_beside_it_is_as_unsure_as_that() -> None:
    """At two attitudes 8.9 % were told with 1.2 %, for 0.8 %: a scale alone fitted as well as both."""
    (found,) = judge_paired(*laid(PLACES, [0.173, -0.161, 0.086], ERROR)).answer["findings"]
    assert found["effect"] == "accel_scale"
    by_axis = np.array(found["parameters"]["scale"]["ci95"])[range(3), range(3)]
    true = 1.0 / (1.0 + np.array(ERROR)) - 1.0
    assert ((by_axis[:, 0] < true) & (true < by_axis[:, 1])).all()


def test_what_is_put_in_without_the_other_is_as_it_is_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scale as it is beside a bias that was nearly sure, and was not put in, mended nothing."""
    scales = list[Array]()

    def less_sure(exam: Examination, residuals: SensorResiduals) -> list[Alone]:
        found = [replace(one, nats=one.both - 5.0) for one in each_alone(exam, residuals)]
        scales.append(found[1].quantity.value)
        return found

    monkeypatch.setattr(compare, "each_alone", less_sure)
    (found,) = judge_paired(*laid(PLACES, [0.173, -0.161, 0.086], ERROR)).answer["findings"]
    assert found["effect"] == "accel_scale"
    assert np.ravel(found["parameters"]["scale"]["value"]) == pytest.approx(scales[0])
