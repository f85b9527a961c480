"""What samples show without a name: order, repetition, stale axes, codes, places; sound ones are silent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from stillcal.calib_core.diagnosis.diagnose import diagnose, examine
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding
from stillcal.calib_core.diagnosis.model.records import Finding, Parameter, Where
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.diagnosis.sequence.codes import lattice
from stillcal.calib_core.diagnosis.sequence.findings import beside_names, sequence_findings
from stillcal.calib_core.diagnosis.sequence.neighbours import without_outliers
from stillcal.calib_core.diagnosis.sequence.places import Noise, batch, by_count
from stillcal.calib_core.diagnosis.sequence.recurrence import delivered_again, stale_axes
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.hhar_still import recordings

STEP, RATE = 1.33e-4, 50.0
Change = Callable[[np.ndarray, np.random.Generator], None]


def turning(seed: int, minutes: float = 6.0) -> np.ndarray:
    """Codes (n, 3) of a gyroscope: rests of 17 s, turns of 3 s of up to 2 rad/s, noise of six codes."""
    rng = np.random.default_rng(seed)
    n, length = int(minutes * 60 * RATE), 1000
    x = np.clip((np.arange(n) % length - 850) / 150.0, 0.0, 1.0)
    speed = 16.0 * x**2 * (1.0 - x) ** 2
    course = np.repeat(rng.uniform(-2.0, 2.0, (n // length + 1, 3)), length, axis=0)[:n] * speed[:, None]
    return np.rint(course / STEP + rng.normal(0.0, 6.0, (n, 3)) + rng.uniform(-40, 40, 3))


def said(codes: np.ndarray) -> list[Finding]:
    samples = Samples.checked(Sensor.GYROSCOPE, np.arange(len(codes)) / RATE, codes * STEP)
    force = np.random.default_rng(9).normal([0.0, 0.0, 9.8], 0.01, codes.shape)
    turned = np.abs(codes).max(axis=1) > 300
    force[turned] += np.random.default_rng(8).normal(0.0, 1.0, (int(turned.sum()), 3))
    bins = cut(Samples.checked(Sensor.ACCELEROMETER, samples.t, force), samples)
    return sequence_findings(samples, without_outliers(samples), "gyro", bins)


def exchanged(x: np.ndarray, rng: np.random.Generator) -> None:
    for i in np.flatnonzero(rng.random(len(x) - 1) < 0.004):
        x[[i, i + 1]] = x[[i + 1, i]]


def backwards(x: np.ndarray, rng: np.random.Generator) -> None:
    for i in np.flatnonzero(rng.random(len(x) // 8) < 0.1) * 8:
        x[i : i + 8] = x[i : i + 8][::-1].copy()


def crosswise(x: np.ndarray, rng: np.random.Generator) -> None:
    for i in np.flatnonzero(rng.random(len(x) // 8) < 0.1) * 8:
        x[i : i + 8] = np.roll(x[i : i + 8], 4, axis=0)


def again(x: np.ndarray, rng: np.random.Generator) -> None:
    for i in rng.integers(100, len(x) - 100, 3):
        x[i : i + 12] = x[i - 40 : i - 28]


def stale(x: np.ndarray, rng: np.random.Generator) -> None:
    rows = 1 + np.flatnonzero(rng.random(len(x) - 1) < 0.02)
    x[rows, 2] = x[rows - 1, 2]


def torn(x: np.ndarray, rng: np.random.Generator) -> None:
    high = np.vstack([x[:1], x[:-1]]) // 256
    hit = (rng.random(x.shape) < 0.3) & (x // 256 != high)
    x[hit] = (256 * high + x % 256)[hit]


def mixed(x: np.ndarray, rng: np.random.Generator) -> None:
    x[16::16] = np.rint(0.4 * x[16::16] + 0.6 * x[15:-1:16][: len(x[16::16])])


@pytest.mark.parametrize(
    ("change", "driver"),
    [
        (exchanged, "order of the samples"),
        (backwards, "order of the samples"),
        (crosswise, "order of the samples"),
        (again, "values delivered before"),
        (stale, "axes read before they are new"),
        (torn, "own code"),
        (mixed, "count of the samples"),
    ],
)
def test_what_a_bus_does_to_samples_is_unknown_with_what_it_follows(change: Change, driver: str) -> None:
    codes = turning(3)
    change(codes, np.random.default_rng(4))
    found = said(codes)
    assert driver in {f.where.driver for f in found}
    assert {f.effect for f in found} == {"unknown"}


def test_where_a_motion_begins_the_last_sample_of_the_rest_is_not_late() -> None:
    """Rests in steps that hide the noise; axes set off one after another, faster than they are sampled."""
    rng, codes = np.random.default_rng(5), np.zeros((9000, 3))
    for start in range(100, 9000, 150):
        for axis, later in enumerate(rng.permutation(3)):
            since = np.arange(50 - later)
            course = rng.uniform(200.0, 600.0) * np.sin(
                rng.uniform(0.4, 0.9) * (since + rng.uniform(0.2, 1.0))
            )
            codes[start + later : start + 50, axis] = np.rint(course)
    samples = Samples.checked(Sensor.GYROSCOPE, np.arange(len(codes)) / 25.0, codes * STEP)
    dropped = np.zeros(codes.shape, dtype=bool)
    assert stale_axes(samples, "gyro", dropped) is None
    stale(codes, rng)
    late = Samples.checked(Sensor.GYROSCOPE, samples.t, codes * STEP)
    found = stale_axes(late, "gyro", dropped)
    assert found is not None and found.axes == ["z"]


@pytest.mark.parametrize("seed", range(3))
def test_sound_samples_are_silent(seed: int) -> None:
    """As they are, in coarse steps, and held as drivers hold them, which has a name."""
    codes = turning(seed)
    assert said(codes) == []
    assert said(20.0 * np.rint(codes / 20.0)) == []
    late = 1 + np.flatnonzero(np.random.default_rng(seed).random(len(codes) - 1) < 0.03)
    codes[late] = codes[late - 1]
    assert said(codes) == []


def test_coarse_steps_of_two_gains_stay_by_chance() -> None:
    """The grid of both is fifty times as fine as either: values were said to be read before they are new."""
    codes = 400.0 * np.rint(turning(3) / 400.0)
    codes[len(codes) // 2 :] *= 1.02
    assert said(codes) == []


@pytest.mark.parametrize(("part", "size"), [(0.452, (150.0, 100.0, 300.0)), (0.458, (62.0, 64.0, 66.0))])
def test_a_machine_that_shakes_some_rests_has_no_code(part: float, size: tuple[float, ...]) -> None:
    """A line near half the sample rate; its samples were values off by multiples of 512 codes, or 1024."""
    codes = turning(3)
    t = np.arange(len(codes)) / RATE
    shaken = (t % 60.0) < 20.0
    codes[shaken] += np.rint(np.outer(np.sin(2.0 * np.pi * part * RATE * t[shaken]), size))
    assert "own code" not in {f.where.driver for f in said(codes)}


@pytest.mark.parametrize(("bit", "size"), [(9, 62.0), (10, 62.0), (8, 0.0)])
def test_single_values_off_by_a_bit_are_found_in_noise_beside_a_machine(bit: int, size: float) -> None:
    """One value in 500, up or down; the machine shakes a third of the time, as above."""
    rng, t = np.random.default_rng(6), np.arange(20_000) / RATE
    shaken = size * np.sin(2.0 * np.pi * 0.458 * RATE * t) * ((t % 60.0) < 20.0)
    off = 2.0**bit * rng.choice([-1.0, 1.0], t.size) * (rng.random(t.size) < 0.002)
    found = lattice(np.rint(rng.normal(0.0, 3.0, t.size) + shaken + off).astype(np.int64))
    assert found is not None and found.bit == bit and found.nats > 5.0


def test_a_simulated_motion_that_repeats_itself_without_noise_is_not_delivered_again() -> None:
    t = np.arange(6000) / RATE
    assert said(np.rint(15000.0 * np.sin(2.0 * np.pi * np.outer(t, [0.1, 0.2, 0.3])))) == []


def test_coarse_steps_in_motion_alone_come_again_by_chance() -> None:
    codes = turning(1)
    moved = np.abs(codes).max(axis=1) > 300
    codes[moved] = 2000.0 * np.rint(np.random.default_rng(1).normal(0.0, 1.0, (int(moved.sum()), 3)))
    assert "values delivered before" not in {f.where.driver for f in said(codes)}


@pytest.mark.parametrize("seed", range(3))
def test_values_that_a_low_pass_leaves_come_again_by_chance_in_rows(seed: int) -> None:
    """Of noise that passes 5 Hz of 100, three values in a row come again a thousand times as often."""
    noise = np.random.default_rng(seed).normal(0.0, 12.0, (40_000, 3))
    codes = np.rint(lfilter(*butter(2, 0.1), noise, axis=0))
    still = np.ones(len(codes), dtype=np.bool_)

    def told(rows: np.ndarray) -> Finding | None:
        samples = Samples.checked(Sensor.GYROSCOPE, np.arange(len(rows)) / 100.0, rows * STEP)
        return delivered_again(samples, "gyro", still)

    assert told(codes) is None
    codes[20_000:20_080] = codes[10_000:10_080]
    found = told(codes)
    assert found is not None and found.parameters["stretches"].value == 1.0


def test_places_and_longest_are_told() -> None:
    codes = 4.0 * turning(5)
    for first in (900, 1900, 2900):
        codes[first : first + 6] = codes[first : first + 6][::-1].copy()
    (found,) = said(codes)
    assert {name: p.value for name, p in found.parameters.items()} == {
        "places": 3.0, "samples": 18.0, "longest": 6.0,
    }  # fmt: skip
    assert found.where.t_start == pytest.approx(900 / RATE)


def test_batches_that_all_run_backwards_are_found_though_each_still_misses_the_next() -> None:
    """A FIFO of 16 samples that is read newest first, all along. Where the rate is steady no order tells."""
    codes = turning(5)
    assert said(codes) == []
    codes = codes[: len(codes) // 16 * 16].reshape(-1, 16, 3)[:, ::-1].reshape(-1, 3)
    (found,) = (f for f in said(codes) if f.where.driver == "order of the samples")
    assert found.parameters["longest"].value == 16.0
    assert float(found.parameters["places"].value) >= 8.0


def finding(effect: str, driver: str, sensor: str = "gyro") -> Finding:
    where = Where(0.0, 1.0, (0.0, 1.0), driver)
    made = direct_finding(effect, sensor, [0], where, {}, statement="", seen=DirectEvidence(99.0))
    assert made is not None
    return made


def test_a_name_that_fits_is_kept_and_one_that_only_looks_like_it_goes() -> None:
    coded, missing = finding("unknown", "own code"), finding("missing_codes", "values")
    heavy, other = finding("noise_heavy_tailed", "noise"), finding("noise_heavy_tailed", "noise", "accel")
    assert beside_names([coded], [heavy, other]) == [coded, other]
    assert beside_names([coded], [missing]) == [missing]


@pytest.mark.parametrize(("own", "hz", "driver", "samples", "kept"), [
    ("time", 11.3, "count of the samples", 8.0, True),
    ("time", 12.52, "count of the samples", 8.0, False),
    ("time", 11.3, "count of the samples", 8.3, False),
    ("time", 11.3, "order of the samples", 8.0, False),
    ("a steady period", 6.25, "count of the samples", 8.0, False),
    ("a steady period", 3.3, "count of the samples", 8.0, True),
    ("a steady period", 6.25, "order of the samples", 8.0, True),
])  # fmt: skip
def test_a_batch_hides_vibrations_at_its_overtones_alone(
    own: str, hz: float, driver: str, samples: float, kept: bool
) -> None:
    """One of 8 samples at 50 Hz has them at 6.25, 12.5 and 18.75 Hz; a beat gives vibrations sidebands."""
    where = Where(0.0, 1.0, (0.0, 25.0), driver)
    size = {"period_samples": Parameter(samples, None, "samples")}
    counted = replace(finding("unknown", driver), where=where, parameters=size)
    name = "vibration_tone" if own == "time" else "unknown"
    line = replace(finding(name, own), parameters={"frequency": Parameter(hz, [hz, hz], "Hz")})
    assert beside_names([counted], [line]) == ([counted, line] if kept else [counted])


def test_real_phones_on_a_table_are_silent(data_dir: Path) -> None:
    for one in recordings(data_dir / "hhar_still")[::24]:
        calm = without_outliers(one.samples)
        assert sequence_findings(one.samples, calm, "accel", cut(one.samples, None)) == []


def test_a_value_that_is_off_in_every_batch_is_no_vibration() -> None:
    codes = turning(6)
    codes[::20] += 5.0
    (found,) = said(codes)
    assert found.where.driver == "count of the samples"
    assert found.parameters["period_samples"].value == 20.0
    wave = np.rint(turning(6) + 5.0 * np.sin(2.0 * np.pi * np.arange(18000) / 10.0)[:, None])
    assert said(wave) == []


def shaken(frequency: float, spreads: float, on: float, seed: int) -> np.ndarray:
    """Codes of what lies on a machine; on: s of every five times as long in which it runs, at any moment."""
    codes, rng = turning(seed, 10.0), np.random.default_rng(seed)
    t = np.arange(len(codes)) / RATE
    begins = np.arange(0.0, t[-1], 5.0 * on)
    begins += rng.uniform(0.0, 4.0 * on, begins.size)
    runs = ((t[:, None] >= begins) & (t[:, None] < begins + on)).any(axis=1)
    wave = 6.0 * spreads * np.sin(2.0 * np.pi * frequency * t) * runs
    return np.rint(codes + wave[:, None] * [0.3, 0.2, 0.93])


@pytest.mark.parametrize(("frequency", "spreads", "on"), [(11.3, 5.0, 2.0), (15.3, 10.0, 2.0)])
def test_a_vibration_in_bursts_does_not_follow_the_count(frequency: float, spreads: float, on: float) -> None:
    """It gives the size of the noise a line at twice its frequency."""
    for seed in range(2):
        assert said(shaken(frequency, spreads, on, seed)) == []


@pytest.mark.parametrize("frequency", [11.3, 13.1, 17.3])
@pytest.mark.parametrize("amplitude", [0.05, 1.0])
def test_a_loud_vibration_does_not_follow_the_count(frequency: float, amplitude: float) -> None:
    """It leaks to all frequencies, as rests begin and end."""
    t = np.arange(45_000) / RATE
    xyz = np.random.default_rng(7).normal(0.0, 0.002, (t.size, 3))
    xyz[:, 2] += amplitude * np.sin(2.0 * np.pi * frequency * t)
    noise = Noise.of(xyz, np.arange(t.size) % 1875 > 150)
    assert noise is not None
    assert by_count(Samples.checked(Sensor.ACCELEROMETER, t, xyz), "accel", noise) is None


def test_two_vibrations_of_whole_hz_do_not_follow_the_count() -> None:
    """Of 11 and 17 Hz at 50 Hz every second has the same samples: both are overtones of a batch of 50."""
    t = np.arange(45_000) / 50.0
    xyz = np.random.default_rng(7).normal(0.0, 0.02, (t.size, 3))
    xyz[:, 2] += 0.03 * np.sin(2.0 * np.pi * 11.0 * t) + 0.02 * np.sin(2.0 * np.pi * 17.0 * t)
    noise = Noise.of(xyz, np.arange(t.size) % 1875 > 150, (11.0 / 50.0, 17.0 / 50.0))
    assert noise is not None
    assert by_count(Samples.checked(Sensor.ACCELEROMETER, t, xyz), "accel", noise) is None


@pytest.mark.parametrize("ratio", [1.04, 1.23])
def test_a_sensor_resampled_by_interpolation_beats(ratio: float) -> None:
    codes = turning(3, 8.0)
    at = np.arange(0.0, len(codes) - 1.0, ratio)
    row, part = at.astype(int), (at % 1.0)[:, None]
    (found,) = said((1.0 - part) * codes[row] + part * codes[row + 1])
    assert found.where.driver == "count of the samples"
    assert found.parameters["period_samples"].value == pytest.approx(1.0 / (ratio % 1.0), rel=1e-3)


def test_one_overtone_alone_is_no_batch() -> None:
    """A weak vibration gives the size of the noise a line; a batch gives it all the overtones."""
    size = np.random.default_rng(9).exponential(size=13_001)
    overtones = np.rint(np.arange(1, 6) * 26_000 / 11).astype(int)
    size[overtones[2]] = 30.0
    assert batch([size])[1] > 5.0 > batch([size], tones=1)[1]
    size[overtones] = 8.0
    period, nats = batch([size], tones=1)
    assert period == 11 and nats > 10.0


@pytest.mark.parametrize("samples", [5, 6, 8, 10])
def test_a_batch_is_told_with_its_own_size(samples: int) -> None:
    """One of 5 was told as 10 samples, one of 6 as 12; two of its overtones are taken for vibrations too."""
    line = np.random.default_rng(samples).exponential(size=13_001)
    line[np.rint(np.arange(1, (samples - 1) // 2 + 1) * 26_000 / samples).astype(int)] = 60.0
    for tones in (1, 2):
        period, nats = batch([line], tones=tones)
        assert period == samples and nats > 20.0


@pytest.mark.parametrize(
    ("size", "why"),
    [
        (5, ", or the phone vibrates at 10 and 20 Hz."),
        (7, ", or the phone vibrates at 7.143, 14.29 and 21.43 Hz."),
        (8, ", or the phone vibrates at 6.25, 12.5 and 18.75 Hz."),
        (10, ", as motion makes it only if it keeps in step with the samples."),
    ],
)
@pytest.mark.parametrize("hole", [0.0, 300.0])
def test_vibrations_that_a_small_batch_may_be_are_told(size: int, why: str, hole: float) -> None:
    """Two of 10 and 20 Hz at 50 Hz were a batch of five samples, 'as no motion makes it'.

    With a hole in the recording they were told as 5.3 and 10.6 Hz.
    """
    rng, n = np.random.default_rng(1), 30_000
    values = rng.normal(size=(n, 3)) + np.tile(rng.normal(0.0, 0.5, (size, 3)), (n // size + 1, 1))[:n]
    noise = Noise.of(values, np.ones(n, dtype=np.bool_))
    stamps = np.arange(n) / 50.0 + np.where(np.arange(n) < n // 2, 0.0, hole)
    samples = Samples.checked(Sensor.ACCELEROMETER, stamps, values)
    assert noise is not None
    found = by_count(samples, "accel", noise)
    assert found is not None and f"every {size} samples" in found.statement
    assert found.statement.endswith(why) and found.where.band_hz == pytest.approx((0.0, 25.0))


def test_noise_that_is_never_calm_on_all_axes_at_once_has_no_size_to_follow() -> None:
    rng, n = np.random.default_rng(2), 20_000
    loud = (np.arange(n) // 256 % 3)[:, None] == np.arange(3)
    noise = Noise.of(rng.normal(size=(n, 3)) * np.where(loud, 4.0, 1.0), np.ones(n, dtype=np.bool_))
    assert noise is not None
    assert not noise.calm.any()
    assert noise.lines_of_size().max() == 0.0


def test_a_spike_at_regular_times_is_one_finding() -> None:
    """Its overtones are lines in the spectrum, and it bends the slow course of a rest."""
    rng, n = np.random.default_rng(2), 30000
    xyz = np.array([0.3, -0.2, 9.8]) + 0.01 * rng.normal(size=(n, 3))
    xyz[250::500, 0] += 4.0
    t = np.arange(n) / 50.0
    turned = 1e-3 * rng.normal(size=(n, 3))
    gyroscope = Samples.checked(Sensor.GYROSCOPE, t, turned)
    found = diagnose(Samples.checked(Sensor.ACCELEROMETER, t, xyz), gyroscope).findings
    assert [(f.effect, f.sensor, f.axes) for f in found] == [("unknown", "accel", ["x"])]
    assert found[0].parameters["count"].value == pytest.approx(60.0, abs=3.0)


def test_two_vibrations_that_change_sign_with_the_attitude_are_no_noise_by_the_count() -> None:
    """The spectrum of all rests has neither, and the size of both goes up and down at their sum."""
    rng, t = np.random.default_rng(2), np.arange(40000) / 100.0
    up = rng.normal(size=(20, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    toward = np.repeat(np.concatenate([up, -up])[rng.permutation(40)], 1000, axis=0)
    shaken = 0.3 * np.sin(2.0 * np.pi * 11.3 * t) + 0.2 * np.sin(2.0 * np.pi * 17.9 * t)
    xyz = toward * (9.81 + shaken)[:, None] + rng.normal(0.0, 0.015, (t.size, 3))
    exam = examine(Samples(Sensor.ACCELEROMETER, t, xyz), None, sought=())
    assert [s.finding.effect for s in exam.statements] == ["vibration_tone"] * 2
