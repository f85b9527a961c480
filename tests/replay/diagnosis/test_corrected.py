"""What is put into a simulation's samples is the recording's: a scale to second order, a limit, a clip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from stillcal.calib_core.diagnosis.comparison.direct import why_not_shown
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, Relation, subtract
from stillcal.calib_core.diagnosis.comparison.records import Discrepancy
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.motion.block_regression import of_arm
from stillcal.calib_core.diagnosis.segments.static_bins import overview_of
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.condense import LongRecording
from stillcal.replay.diagnosis.corrected import correct, with_echoes
from stillcal.replay.diagnosis.given_simulation import with_own_values
from stillcal.replay.diagnosis.sample_changes import in_runs, low_passed
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording
from tests.support.diagnosis.turned_pairs import turned as shaken

MIS = ((0, 1), (0, 2), (1, 2))


def quantity(sensor: str, matrix: np.ndarray) -> Quantity:
    if sensor == "gyro":
        value, parts = (matrix - np.eye(3)).ravel(), (Part("scale", "1", 9),)
    else:
        value = np.array([*(matrix.diagonal() - 1.0), *(matrix[p] for p in MIS)])
        parts = (Part("scale", "1", 3), Part("misalignment", "rad", 3))
    k = value.size
    where = Where(0.0, 1.0, (0.0, 1.0), "nothing")
    return Quantity(
        f"{sensor}_scale", sensor, parts, value, 1e-8 * np.eye(k), np.full(k, 0.1), np.full(k, 1e-4),
        np.full(k, -1), where=where,
    )  # fmt: skip


@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_readings_become_those_of_the_recorded_sensor(sensor: str) -> None:
    rng = np.random.default_rng(4)
    true, bias = rng.normal(size=(50, 3)), np.array([0.2, -0.1, 0.3])
    both = [np.eye(3) + 0.05 * rng.normal(size=(3, 3)) for _ in range(2)]
    both = [(m + m.T) / 2.0 for m in both] if sensor == "accel" else both
    recorded, simulated = (true @ np.linalg.inv(m).T + bias for m in both)
    t = np.arange(50) / 50.0
    samples = {s: Samples(kind, t, simulated) for s, kind in zip(("accel", "gyro"), Sensor, strict=True)}
    recording = Recording(samples["accel"], samples["gyro"], [], Claims(), [])
    difference = subtract(*(quantity(sensor, m) for m in both))
    one = Discrepancy(
        f"{sensor}_scale",
        sensor,
        [],
        Where(0.0, 1.0, (0.0, 1.0), "nothing"),
        "too_small",
        1.0,
        9.0,
        difference,
    )
    done = correct(recording, [one], {sensor: bias})
    out = done.recording.accelerometer if sensor == "accel" else done.recording.gyroscope
    assert out is not None and done.left_out == []
    np.testing.assert_allclose(out.xyz, recorded, rtol=0.0, atol=1e-12)


def test_what_follows_force_goes_by_the_force_and_not_by_what_is_read() -> None:
    """A bias of the accelerometer times a sensitivity to force is no bias of the gyroscope."""
    bias, matrix = np.array([0.3, 0.0, -0.3]), 5e-4 * np.eye(3)
    true = shaken(1)
    assert true.gyroscope is not None
    read = shaken(1, lambda force, rate: (force + bias, rate))
    part = (Part("matrix", "(rad/s)/(m/s^2)", 9),)
    gyro, where = ("gyro_g_sensitivity", "gyro"), Where(0.0, 1.0, (0.0, 1.0), "attitude")
    had = [
        Quantity(*gyro, part, value.ravel(), 1e-14 * np.eye(9), np.full(9, 1e-3), np.full(9, 1e-12),
                 np.repeat(np.arange(3), 3), where=where)
        for value in (matrix, 0.0 * matrix)
    ]  # fmt: skip
    done = correct(read, [Discrepancy(*gyro, [], where, "lacking", 1.0, 50.0, subtract(*had))], {})
    assert done.recording.gyroscope is not None and done.left_out == []
    added = done.recording.gyroscope.xyz - true.gyroscope.xyz
    away = (added - true.accelerometer.xyz @ matrix.T).mean(axis=0)
    assert np.abs(away).max() < 0.1 * 5e-4 * 0.3


EVERYWHERE = Where(0.0, 60.0, (0.0, 25.0), "rate of turn")


def clipped_at(limit: float) -> Finding:
    """Return that a gyroscope stops at a limit."""
    parameter = Parameter(limit, [limit - 1e-3, limit + 1e-3], "rad/s")
    return Finding(
        "gyro_saturation", "gyro", ["x"], EVERYWHERE, {"limit": parameter}, Evidence(50.0), [], "It stops."
    )


def turned(most: float) -> Recording:
    """Return a minute in which a device turns to and fro, at `most` rad/s."""
    t = np.arange(0.0, 60.0, 0.02)
    rate = most * np.sin(0.5 * t)[:, None] * np.array([1.0, 0.2, 0.1])
    force = np.tile([0.0, 0.0, 9.8], (t.size, 1))
    accel, gyro = (
        Samples(kind, t, xyz) for kind, xyz in ((Sensor.ACCELEROMETER, force), (Sensor.GYROSCOPE, rate))
    )
    return Recording(accel, gyro, [], Claims(), [])


def test_a_limit_that_the_simulation_lacks_clips_it_and_does_not_count_as_left_out() -> None:
    found = clipped_at(3.0)
    one = Discrepancy("gyro_saturation", "gyro", ["x"], EVERYWHERE, "lacking", 1.0, 50.0, recorded=found)
    done = correct(turned(5.0), [one], {})
    assert done.recording.gyroscope is not None and done.left_out == []
    assert np.abs(done.recording.gyroscope.xyz).max() == 3.0


@pytest.mark.parametrize(("most", "speaks_against"), [(2.0, False), (3.0, False), (5.0, True)])
def test_only_motion_beyond_a_limit_speaks_against_it(most: float, speaks_against: bool) -> None:
    """A corrected simulation stops at the limit itself, where too few samples may lie to find it."""
    made = turned(most)
    exam = examine(made.accelerometer, made.gyroscope, sought=())
    reason = why_not_shown(clipped_at(3.0), exam)
    assert reason == (None if speaks_against else "its motion does not go beyond the limit")


def test_a_delay_is_put_in_with_its_sign() -> None:
    """The readings themselves stay: between two samples the noise would be a mean, as behind a low-pass."""
    late = Finding(
        "accel_gyro_time_offset",
        "timing",
        [],
        EVERYWHERE,
        {"delay": Parameter(0.1, None, "s")},
        Evidence(50.0),
        [],
        "",
    )
    made, rate = turned(5.0), turned(5.0).gyroscope
    assert rate is not None
    for relation, own, other in (("lacking", late, None), ("superfluous", None, late)):
        one = Discrepancy(
            late.effect, "timing", [], EVERYWHERE, relation, 1.0, 50.0, recorded=own, simulated=other
        )
        done = correct(made, [one], {})
        assert done.recording.gyroscope is not None and done.left_out == []
        shift = 0.1 if own else -0.1
        np.testing.assert_allclose(done.recording.gyroscope.t, rate.t + shift)
        np.testing.assert_array_equal(done.recording.gyroscope.xyz, rate.xyz)
        np.testing.assert_array_equal(done.recording.accelerometer.t, made.accelerometer.t)


@pytest.mark.parametrize(("recorded", "simulated"), [(0.1, 0.02), (-0.05, 0.02)])
def test_a_delay_that_both_have_is_put_in_as_far_as_they_differ(recorded: float, simulated: float) -> None:
    key, part, one = ("accel_gyro_time_offset", "timing"), (Part("delay", "s", 1),), np.ones(1)
    had = [
        Quantity(*key, part, x * one, 1e-8 * np.eye(1), one, 0.05 * one, np.array([-1]), where=EVERYWHERE)
        for x in (recorded, simulated)
    ]
    differs = Discrepancy(*key, [], EVERYWHERE, "too_small", 1.0, 50.0, subtract(*had))
    made, done = turned(5.0), correct(turned(5.0), [differs], {}).recording
    assert made.gyroscope is not None and done.gyroscope is not None
    np.testing.assert_allclose(done.gyroscope.t - made.gyroscope.t, recorded - simulated)


def low_pass(cutoff: float, order: int) -> Quantity:
    """Return a low-pass of a gyroscope as a comparison measures it; no cutoff is known without an error."""
    one, part = np.ones(1), (Part("cutoff", "Hz", 1),)
    value, where = np.array([np.log(cutoff)]), Where(0.0, 1.0, (0.0, 25.0), "noise at rest")
    return Quantity("bandwidth", "gyro", part, value, 1e-4 * np.eye(1), one, 0.05 * one, np.array([-1]),
                    logarithmic=True, reference={"order": order}, where=where)  # fmt: skip


@pytest.mark.parametrize(("cutoff", "own"), [(6.0, 15.0), (15.0, 6.0)])
@pytest.mark.parametrize("order", [1, 2, 4])
def test_one_low_pass_takes_the_place_of_another(cutoff: float, own: float, order: int) -> None:
    rng = np.random.default_rng(1)
    white = Samples(Sensor.GYROSCOPE, np.arange(2000) / 50.0, rng.normal(size=(2000, 3)))
    wanted = low_passed(white, low_pass(cutoff, order)).xyz
    behind = low_passed(white, low_pass(own, order))
    found = low_passed(behind, low_pass(cutoff, order), low_pass(own, order)).xyz
    np.testing.assert_allclose(found[200:], wanted[200:], atol=1e-6)


def test_a_low_pass_of_another_order_leaves_no_gain_behind() -> None:
    rng = np.random.default_rng(1)
    steady = Samples(Sensor.GYROSCOPE, np.arange(2000) / 50.0, 1.0 + 0.01 * rng.normal(size=(2000, 3)))
    behind = low_passed(steady, low_pass(15.0, 4))
    found = low_passed(behind, low_pass(6.0, 1), low_pass(15.0, 4)).xyz
    assert found[200:].mean() == pytest.approx(1.0, abs=1e-3)
    assert found[200:].std() < 0.01


def hum(t_start: float, t_end: float) -> Discrepancy:
    where = Where(t_start, t_end, (16.9, 17.1), "time")
    parameters = {
        "frequency": Parameter(17.3, None, "Hz"),
        "amplitude": Parameter([0.01, 0.0, 0.02], None, "m/s^2"),
    }
    found = Finding("vibration_tone", "accel", ["z"], where, parameters, Evidence(9.0), [], "")
    return Discrepancy("vibration_tone", "accel", ["z"], where, "lacking", 1.0, 9.0, recorded=found)


def test_what_the_gyroscope_has_of_a_vibration_is_put_in_with_it_unless_it_has_its_own() -> None:
    t = np.arange(5000) / 50.0
    still = (Samples(kind, t, np.zeros((t.size, 3))) for kind in (Sensor.ACCELEROMETER, Sensor.GYROSCOPE))
    felt = hum(0.0, 100.0)
    assert felt.recorded is not None
    size = {"amplitude": Parameter([0.0, 0.003, 0.0], None, "rad/s")}
    echo = replace(felt.recorded, sensor="gyro", axes=["y"], parameters=felt.recorded.parameters | size)
    one = replace(felt, recorded=replace(felt.recorded, echoes=(echo,)))
    simulation = Recording(*still, [], Claims(), [])
    done = correct(simulation, with_echoes(simulation, [one]), {}).recording
    assert done.gyroscope is not None
    spread = np.std(done.gyroscope.xyz, axis=0)
    assert spread == pytest.approx(np.array([0.0, 0.003, 0.0]) / np.sqrt(2.0), rel=0.01)
    none, axis_of = np.zeros(0), np.zeros(0, dtype=np.int64)
    own = Quantity(
        "vibration_tone", "gyro", (), none, np.zeros((0, 0)), none, none, axis_of, where=echo.where
    )
    assert with_echoes(simulation, [one], [subtract(own, own)]) == [one]
    other = replace(own, where=replace(echo.where, band_hz=(11.9, 12.1)))
    assert with_echoes(replace(simulation, gyroscope=None), [one]) == [one]
    assert len(with_echoes(simulation, [one], [subtract(other, other)])) == 2, (
        "another vibration of it is not this one"
    )


def test_a_vibration_for_a_while_is_in_the_same_part_of_the_simulation() -> None:
    t = 1000.0 + np.arange(5000) / 50.0
    simulation = Recording(Samples(Sensor.ACCELEROMETER, t, np.zeros((t.size, 3))), None, [], Claims(), [])
    done = correct(simulation, [hum(50.0, 80.0)], {}, span=(0.0, 100.0))
    there = (t >= 1050.0) & (t <= 1080.0)
    out = done.recording.accelerometer.xyz
    assert np.abs(out[~there]).max() == 0.0
    assert np.std(out[there], axis=0) == pytest.approx(np.array([0.01, 0.0, 0.02]) / np.sqrt(2.0), rel=0.01)


def test_a_vibration_that_the_simulation_is_too_slow_for_is_left_out() -> None:
    slow = Samples(Sensor.ACCELEROMETER, np.arange(500) / 25.0, np.zeros((500, 3)))
    done = correct(Recording(slow, None, [], Claims(), []), [hum(0.0, 100.0)], {})
    assert done.left_out == ["vibration_tone"]
    assert (done.recording.accelerometer.xyz == 0.0).all()


def test_a_vibration_leaves_the_means_of_a_long_simulation_and_adds_to_their_variance() -> None:
    t = np.arange(5000) / 50.0
    still = Samples(Sensor.ACCELEROMETER, t, np.zeros((t.size, 3)))
    seconds = overview_of(still, None)
    simulation = LongRecording(still, None, [], Claims(), [], overview=seconds)
    done = correct(simulation, [hum(30.0, 60.0)], {}).recording
    assert isinstance(done, LongRecording) and done.overview is not None
    force, there = done.overview.force, (seconds.force.t > 30.0) & (seconds.force.t < 60.0)
    np.testing.assert_array_equal(force.mean, seconds.force.mean)
    np.testing.assert_allclose(force.variance[:, 2], 0.5 * 0.02**2 * there)


def louder(recorded: list[float], axes: list[str]) -> Discrepancy:
    """Return white noise of which the simulation has 0.002 m/s^2/sqrt(Hz) on each axis."""
    where = Where(0.0, 1.0, (0.0, 25.0), "noise at rest")
    had = [
        Quantity(
            "noise_level", "accel", (Part("density", "m/s^2/sqrt(Hz)", 3),), np.log(np.array(values)),
            1e-6 * np.eye(3), np.full(3, 1.0), np.full(3, 0.01), np.arange(3), logarithmic=True, where=where,
        )
        for values in (recorded, [2e-3, 2e-3, 2e-3])
    ]  # fmt: skip
    return Discrepancy("noise_level", "accel", axes, where, "too_small", 1.0, 50.0, subtract(*had))


def test_noise_is_added_to_one_axis_though_by_chance_another_has_less() -> None:
    recording = turned(2.0)
    done = correct(recording, [louder([1.999e-3, 4e-3, 2.001e-3], ["y"])], {})
    assert done.left_out == []
    added = (done.recording.accelerometer.xyz - recording.accelerometer.xyz).std(axis=0)
    rate = (len(recording.accelerometer) - 1) / np.ptp(recording.accelerometer.t)
    assert added[1] == pytest.approx(np.sqrt((4e-3**2 - 2e-3**2) * rate / 2.0), rel=0.1)
    assert added[0] == 0.0 and added[2] < 0.05 * added[1]
    assert correct(recording, [louder([1e-3, 4e-3, 2e-3], ["x", "y"])], {}).left_out == ["noise_level"]


def alone(effect: str, values: dict[str, Parameter], *, of_recording: bool) -> Discrepancy:
    """Return what one of the two has from 4 s on, on x and y."""
    where = Where(4.0, 10.0, (0.0, 0.1), "time")
    found = Finding(effect, "accel", ["x", "y"], where, values, Evidence(9.0), [], "")
    relation: Relation = "lacking" if of_recording else "superfluous"
    own = (found, None) if of_recording else (None, found)
    return Discrepancy(effect, "accel", ["x", "y"], where, relation, 1.0, 9.0, None, *own)


def fine() -> Recording:
    t = np.arange(500) / 50.0
    xyz = np.random.default_rng(5).normal(size=(500, 3))
    return Recording(Samples(Sensor.ACCELEROMETER, t, xyz), None, [], Claims(), [])


def test_values_that_are_coarse_in_the_recording_are_rounded_on_its_axes() -> None:
    coarse = alone("accel_quantisation", {"step": Parameter(0.04, [0.04, 0.04], "m/s^2")}, of_recording=True)
    done, before = correct(fine(), [coarse], {}), fine().accelerometer.xyz
    steps = done.recording.accelerometer.xyz / 0.04
    assert done.left_out == []
    np.testing.assert_allclose(steps[:, :2], np.rint(before[:, :2] / 0.04), rtol=0.0, atol=1e-9)
    assert (done.recording.accelerometer.xyz[:, 2] == before[:, 2]).all()


def test_values_that_are_coarse_in_the_simulation_cannot_be_made_fine() -> None:
    coarse = alone("accel_quantisation", {"step": Parameter(0.04, [0.04, 0.04], "m/s^2")}, of_recording=False)
    assert correct(fine(), [coarse], {}).left_out == ["accel_quantisation"]


@pytest.mark.parametrize(("of_recording", "sign", "first"), [(False, -1.0, 200), (True, 1.0, 100)])
def test_a_step_of_one_of_the_two_is_put_in_or_taken_out(of_recording: bool, sign: float, first: int) -> None:
    """The recording lasts twice as long: its step comes after the same part of either."""
    size = Parameter([0.1, -0.2, 0.0], [[0.1, 0.1], [-0.2, -0.2], [0.0, 0.0]], "m/s^2")
    step = alone("accel_bias_step", {"step": size}, of_recording=of_recording)
    done = correct(fine(), [step], {}, span=(0.0, 2.0 * float(fine().accelerometer.t[-1])))
    away = done.recording.accelerometer.xyz - fine().accelerometer.xyz
    assert done.left_out == []
    np.testing.assert_allclose(away[:first], 0.0, atol=1e-12)
    np.testing.assert_allclose(away[first:], np.tile(sign * np.array([0.1, -0.2, 0.0]), (500 - first, 1)))


def less(effect: str, sensor: str, recorded: float = 0.6, simulated: float = 0.4) -> Discrepancy:
    """Return that the simulation has less of what is a number, such as a share, or more of it."""
    where = Where(0.0, 10.0, (0.0, 0.0), "time stamps")
    had = [
        Quantity(
            effect, sensor, (Part("number", "1", 1),), np.log([number]), np.array([[1e-4]]), np.ones(1),
            np.full(1, 0.05), np.array([-1]), logarithmic=True, where=where, reference={"longest": 2.0},
        )
        for number in (recorded, simulated)
    ]  # fmt: skip
    relation: Relation = "too_small" if simulated < recorded else "too_large"
    return Discrepancy(effect, sensor, [], where, relation, 1.0, 50.0, subtract(*had))


@pytest.mark.parametrize(
    ("effect", "sensor"),
    [
        ("dropped_samples", "timing"),
        ("accel_held_samples", "accel"),
        ("timestamp_jitter", "timing"),
        ("accel_quantisation", "accel"),
    ],
)
def test_what_the_simulation_has_more_of_cannot_be_taken_out(effect: str, sensor: str) -> None:
    done, before = correct(fine(), [less(effect, sensor, 0.1, 0.2)], {}), fine().accelerometer
    assert done.left_out == [effect]
    assert np.array_equal(done.recording.accelerometer.xyz, before.xyz)


def test_a_low_pass_that_only_the_simulation_has_cannot_be_taken_out() -> None:
    none = replace(low_pass(25.0, 2), none=True, reference={})
    found = subtract(none, low_pass(6.0, 2))
    one = Discrepancy("bandwidth", "gyro", [], EVERYWHERE, "superfluous", 1.0, 50.0, found)
    assert correct(turned(2.0), [one], {}).left_out == ["bandwidth"]


def test_a_limit_above_the_simulations_leaves_it_as_it_is() -> None:
    done = correct(turned(2.0), [less("gyro_saturation", "gyro", 1.5, 1.0)], {})
    assert done.left_out == ["gyro_saturation"]


def test_values_behind_a_low_pass_come_in_steps_and_from_the_first_one_on() -> None:
    """What was filtered is rounded; a filter that begins at nothing would begin with a jump."""
    slow = subtract(low_pass(6.0, 2), replace(low_pass(25.0, 2), none=True, reference={}))
    filtered = Discrepancy("bandwidth", "gyro", [], EVERYWHERE, "lacking", 1.0, 50.0, slow)
    coarse = less("gyro_quantisation", "gyro", 0.01, 0.001)
    made, (t, xyz) = turned(2.0), (turned(2.0).accelerometer.t, np.tile([1.0, -2.0, 0.5], (3000, 1)))
    still = replace(made, gyroscope=Samples(Sensor.GYROSCOPE, t, xyz))
    for one, found in ((made, [coarse, filtered]), (still, [filtered])):
        done = correct(one, found, {})
        assert done.left_out == [] and done.recording.gyroscope is not None
        out = done.recording.gyroscope.xyz
        if one is still:
            np.testing.assert_allclose(out, xyz, atol=1e-9)
        else:
            np.testing.assert_allclose(out / 0.01, np.rint(out / 0.01), rtol=0.0, atol=1e-6)


def test_samples_of_a_long_simulation_are_lost_and_its_seconds_are_not() -> None:
    seconds = overview_of(fine().accelerometer, None)
    held = fine()
    simulation = LongRecording(held.accelerometer, None, [], Claims(), [], overview=seconds)
    done = correct(simulation, [less("dropped_samples", "timing")], {}).recording
    assert isinstance(done, LongRecording) and done.overview is not None
    assert len(done.accelerometer) < 400
    np.testing.assert_array_equal(done.overview.force.mean, seconds.force.mean)


def test_samples_are_lost_until_as_many_are_missing_as_in_the_recording() -> None:
    whole = turned(2.0)
    done = correct(whole, [less("dropped_samples", "timing")], {})
    assert done.left_out == [] and done.recording.gyroscope is not None
    left = done.recording.accelerometer
    assert len(left) / len(whole.accelerometer) == pytest.approx(0.4 / 0.6, abs=0.03)
    rows = np.searchsorted(whole.accelerometer.t, left.t)
    assert (left.xyz == whole.accelerometer.xyz[rows]).all()
    assert np.array_equal(left.t, done.recording.gyroscope.t), "both are read together"


def test_values_are_held_until_as_many_are_as_in_the_recording() -> None:
    done, before = correct(fine(), [less("held_samples", "accel")], {}), fine().accelerometer
    after = done.recording.accelerometer
    held = (np.diff(after.xyz, axis=0) == 0.0).all(axis=1)
    assert done.left_out == [] and np.array_equal(after.t, before.t)
    assert held.mean() == pytest.approx(1.0 - 0.4 / 0.6, abs=0.07)
    assert (after.xyz[1:][~held] == before.xyz[1:][~held]).all()
    assert not sliding_window_view(held, 3).all(axis=1).any(), "no longer than in the recording"


@pytest.mark.parametrize(
    ("share", "longest"), [(0.5, 1), (0.75, 3), (0.4, 1), (0.04, 3), (0.6, 4), (0.3, 20)]
)
def test_what_is_held_is_held_no_longer_than_in_the_recording(share: float, longest: int) -> None:
    """Of a sensor read twice for each value runs of any length were put in, and its noise then differed."""
    chosen = in_runs(50_000, share, longest, np.random.default_rng(3))
    assert chosen.mean() == pytest.approx(share, abs=0.01)
    assert not sliding_window_view(chosen, longest + 1).all(axis=1).any()


def test_as_many_of_the_samples_that_are_left_are_held() -> None:
    """Where some were repeated first and lost then, too few repeated the one before."""
    lost_and_held = [less("held_samples", "accel"), less("dropped_samples", "timing")]
    white = Samples(
        Sensor.ACCELEROMETER, np.arange(9000) / 50.0, np.random.default_rng(5).normal(size=(9000, 3))
    )
    done = correct(Recording(white, None, [], Claims(), []), lost_and_held, {}).recording.accelerometer
    assert len(done) / 9000 == pytest.approx(0.4 / 0.6, abs=0.03)
    assert (np.diff(done.xyz, axis=0) == 0.0).all(axis=1).mean() == pytest.approx(1.0 - 0.4 / 0.6, abs=0.02)


def test_stamps_jitter_as_far_as_the_recordings_and_stay_in_order() -> None:
    whole = turned(2.0)
    done = correct(whole, [less("timestamp_jitter", "timing", 5e-3, 3e-3)], {})
    stamps = done.recording.accelerometer.t
    assert done.left_out == [] and done.recording.gyroscope is not None
    assert (stamps - whole.accelerometer.t).std() == pytest.approx(4e-3, rel=0.1)
    assert np.array_equal(stamps, done.recording.gyroscope.t), "both are read together"
    wild = correct(whole, [less("timestamp_jitter", "timing", 0.1, 1e-3)], {}).recording.accelerometer.t
    assert (np.diff(wild) >= 0.0).all()


@pytest.mark.parametrize("logarithmic", [False, True])
def test_an_arm_is_put_in_by_the_rate_and_as_far_as_both_differ(logarithmic: bool) -> None:
    """Of positions on the positive side of all axes the quantity has the logarithms."""
    made = turned(5.0)
    rate = made.gyroscope
    assert rate is not None
    arms = np.array([0.01, 0.08, 0.05]), np.array([0.01, 0.05, 0.03])
    key, part = ("lever_arm", "accel"), (Part("position", "m", 3),)
    had = [
        Quantity(*key, part, np.log(x) if logarithmic else x, 1e-8 * np.eye(3), np.full(3, 1.0),
                 np.full(3, 0.05), np.arange(3), logarithmic=logarithmic, where=EVERYWHERE)
        for x in arms
    ]  # fmt: skip
    one = Discrepancy(*key, ["y", "z"], EVERYWHERE, "too_small", 1.0, 50.0, subtract(*had))
    done = correct(made, [one], {})
    added = done.recording.accelerometer.xyz - made.accelerometer.xyz
    expected = of_arm(rate.t, rate.xyz) @ (arms[0] - arms[1])
    np.testing.assert_allclose(added, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_an_arm_is_looked_for_anew_in_a_corrected_simulation() -> None:
    """It is told by single samples, and not by how these are rounded."""
    exam = examine(turned(5.0).accelerometer, turned(5.0).gyroscope, sought=())
    arm = Finding("lever_arm", "accel", ["x"], EVERYWHERE, {}, Evidence(50.0), [], "")
    simulated, measured = replace(exam, statements=[Stated(arm)]), replace(exam, statements=[])
    assert with_own_values(measured, simulated, set()).statements == []
    assert [s.finding for s in with_own_values(simulated, measured, set()).statements] == [arm]


def test_a_random_walk_that_a_simulation_lacks_is_put_in() -> None:
    """It was left out, and nothing showed that the fit improved. Seconds and samples get the same one."""
    t, k = np.arange(200_000) / 10.0, 3
    gyro = Samples(Sensor.GYROSCOPE, t, np.zeros((t.size, 3)))
    accel = Samples(Sensor.ACCELEROMETER, t, np.full((t.size, 3), 5.7))
    where, part = Where(0.0, t[-1], (0.0, 0.01), "nothing"), (Part("density", "rad/s/sqrt(s)", 3),)
    own, other = (
        Quantity(
            "gyro_bias_random_walk", "gyro", part, np.log(np.full(k, size)), 0.01 * np.eye(k), np.ones(k),
            np.full(k, 0.1), np.arange(k), logarithmic=True, where=where,
        )
        for size in (5e-5, 3e-5)
    )  # fmt: skip
    lacks = Discrepancy(
        own.effect, "gyro", ["x", "y", "z"], where, "too_small", 1.0, 50.0, subtract(own, other)
    )
    made = correct(Recording(accel, gyro, [], Claims(), []), [lacks], {})
    assert made.left_out == [] and made.recording.gyroscope is not None
    course = made.recording.gyroscope.xyz
    assert (course[0] == 0.0).all()
    steps = np.diff(course[::1000], axis=0)
    assert steps.std(axis=0) == pytest.approx(np.full(3, 4e-5 * np.sqrt(100.0)), rel=0.2)
    few = correct(Recording(accel[::10], gyro[::10], [], Claims(), []), [lacks], {}).recording.gyroscope
    assert few is not None and few.xyz == pytest.approx(course[::10], abs=1e-12)
    less_on_z = replace(other, value=np.log(np.array([3e-5, 3e-5, 8e-5])))
    for simulated, recorded in ((own, other), (less_on_z, own)):
        more = replace(lacks, relation="too_large", difference=subtract(recorded, simulated))
        assert correct(Recording(accel, gyro, [], Claims(), []), [more], {}).left_out == [own.effect]
