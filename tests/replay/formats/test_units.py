"""Mistaken units are recognised; real sensors, free fall and thrust raise no false alarm."""

from __future__ import annotations

from copy import deepcopy
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.formats.checks.axes import Turning
from stillcal.replay.formats.checks.units import DEGREE
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.settling.counts import counts_per_degree
from stillcal.replay.formats.trace import Recording, read_all

HEADER = "t,ax,ay,az,gx,gy,gz"
SCENES = ["turning", "walking", "still"]


@cache
def turned(scene: str, n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """Return rates (n, 3) rad/s and up (n, 3) of a phone at 100 Hz, and the generator that drew them."""
    rng = np.random.default_rng(seed)
    amplitude = {"turning": 1.0, "walking": 0.5, "still": 0.0}[scene]
    phases = rng.uniform(0, 2 * np.pi, 3)
    rate = amplitude * np.sin(np.outer(np.arange(n) / 100, [0.7, 1.1, 1.7]) + phases)
    up = np.empty((n, 3))
    up[0] = 0.0, 0.0, 1.0
    for i, turn in enumerate(Rotation.from_rotvec(rate[:-1] / 100).as_matrix()):
        np.matmul(up[i], turn, out=up[i + 1])
    return rate, up, rng


def phone(
    scene: str, n: int = 3000, seed: int = 0, scale: float = 1.0, gyro_bias: float = 0.01
) -> np.ndarray:
    """Return rows of a phone that is turned by hand, walked with or left lying, in SI units.

    Noise is that of a phone's sensors: 0.02 m/s^2 and 0.002 rad/s a sample at 100 Hz.
    """
    rate, up, drawn = turned(scene, n, seed)
    t, force, rng = np.arange(n) / 100, 9.81 * up, deepcopy(drawn)
    if scene == "walking":
        force += np.column_stack([np.zeros(n), np.zeros(n), 1.5 * np.sin(2 * np.pi * 1.8 * t)])
    force = scale * force + 0.2 + rng.normal(0, 0.02, (n, 3))
    return np.column_stack([t, force, rate + gyro_bias + rng.normal(0, 0.002, (n, 3))])


def read(path: Path, rows: np.ndarray) -> Recording:
    text = "".join(",".join(map(repr, row)) + "\n" for row in rows.tolist())
    path.write_text(HEADER + "\n" + text)
    return read_all(path)


def taken_as_given(path: Path, rows: np.ndarray) -> bool:
    """Whether a recording is read, and its values are taken for m/s^2 and rad/s."""
    held = read(path, rows)
    assert held.gyroscope is not None
    same = (held.accelerometer.xyz == rows[:, 1:4]).all() and (held.gyroscope.xyz == rows[:, 4:7]).all()
    return bool(same)


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("scale", [0.92, 1.0, 1.25])
@pytest.mark.parametrize("gyro_bias", [0.01, 0.35])
def test_real_errors_of_phones_raise_no_alarm(
    tmp_path: Path, scene: str, scale: float, gyro_bias: float
) -> None:
    assert taken_as_given(tmp_path / "r.csv", phone(scene, scale=scale, gyro_bias=gyro_bias))


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("n", [100, 3000])
@pytest.mark.parametrize(("unit", "per_si"), [("g", 1 / 9.80665), ("mg", 1000 / 9.80665)])
def test_g_and_mg_are_recognised(tmp_path: Path, scene: str, n: int, unit: str, per_si: float) -> None:
    rows = phone(scene, n)
    rows[:, 1:4] *= per_si
    with pytest.raises(TraceError, match=f'seems to be {unit}; give m/s\\^2, or set unit = "{unit}"'):
        read(tmp_path / "r.csv", rows)


def test_stamps_too_far_apart_may_be_those_of_rests(tmp_path: Path) -> None:
    rows = phone("still", 30)
    rows[:, 0] *= 2000.0
    with pytest.raises(
        TraceError, match=r'step by 20, .* or "ms" in .*; a table of rests needs --format rest'
    ):
        read(tmp_path / "r.csv", rows)


def test_a_log_at_1_hz_may_have_a_slow_clock_and_uneven_stamps(tmp_path: Path) -> None:
    rows = phone("still", 600)
    rows[:, 0] *= 100.0 * (1.0 + 50e-6)
    assert taken_as_given(tmp_path / "slow.csv", rows)
    rows[:, 0] += np.random.default_rng(2).uniform(-0.3, 0.3, 600)
    assert np.median(np.diff(rows[:, 0])) > 1.001
    assert taken_as_given(tmp_path / "uneven.csv", rows)


@pytest.mark.parametrize("scene", ["turning", "walking", "still"])
def test_degrees_are_recognised(tmp_path: Path, scene: str) -> None:
    """Also of a phone that lies still: as radians its noise alone would turn gravity visibly."""
    rows = phone(scene)
    rows[:, 4:7] = np.rad2deg(rows[:, 4:7])
    with pytest.raises(TraceError, match="the rates are not rad/s"):
        read(tmp_path / "r.csv", rows)


def test_a_late_first_turn_still_shows_degrees(tmp_path: Path) -> None:
    rows = np.vstack([phone("still", 12_000), phone("turning", 3000)])
    rows[:, 0] = np.arange(len(rows)) / 100
    rows[:, 4:7] = np.rad2deg(rows[:, 4:7] * np.r_[np.zeros(12_000), np.ones(3000)][:, None])
    with pytest.raises(TraceError, match="the rates are not rad/s"):
        read(tmp_path / "r.csv", rows)


def test_raw_counts_are_recognised(tmp_path: Path) -> None:
    rows = phone("still")
    rows[:, 1:4] *= 1670
    with pytest.raises(TraceError, match=r"raw counts\?; say accel_unit"):
        read(tmp_path / "r.csv", rows)


def test_axes_of_the_gyroscope_turned_against_the_accelerometer_s_are_not_taken_for_degrees(
    tmp_path: Path,
) -> None:
    rows = phone("turning")
    rows[:, 4:7] *= -1
    assert taken_as_given(tmp_path / "r.csv", rows)


def test_tumbling_in_free_fall_and_thrust_raise_no_alarm(tmp_path: Path) -> None:
    """A bias alone is left of the force in free fall and does not turn with the rates."""
    rows = phone("still", 6000)
    rows[2500:4000, 1:4] -= [0.0, 0.0, 9.81]
    rows[2000:2500, 1:4] *= 8
    rows[2000:4000, 4:7] += [5.0, 1.0, 0.0]
    assert taken_as_given(tmp_path / "r.csv", rows)


@pytest.mark.parametrize("rate", [5, 20, 100])
def test_shaking_faster_than_can_be_followed_raises_no_alarm(tmp_path: Path, rate: int) -> None:
    """A pocket's shaking at 3 and 4.1 Hz, 0.15 rad wide, sampled at 5 Hz too: the rates do not add up."""
    t = np.arange(60 * rate) / rate
    phase = 2 * np.pi * np.outer(t, [3.0, 4.1, 0.2])
    angle = np.sin(phase) * [0.15, 0.1, 0.2]
    rates = np.cos(phase) * [0.15, 0.1, 0.2] * (2 * np.pi * np.array([3.0, 4.1, 0.2]))
    force = Rotation.from_rotvec(-angle).apply([0.0, 0.0, 9.81])
    noise = np.random.default_rng(0).normal(0, 1, (len(t), 6)) * np.repeat([0.02, 0.002], 3)
    assert taken_as_given(tmp_path / "r.csv", np.column_stack([t, np.column_stack([force, rates]) + noise]))


def test_a_turntable_about_the_vertical_raises_no_alarm(tmp_path: Path) -> None:
    rows = phone("still", 3000)
    rows[500:, 6] += 3.5
    assert taken_as_given(tmp_path / "r.csv", rows)


def test_a_swing_whose_force_keeps_along_its_ropes_raises_no_alarm(tmp_path: Path) -> None:
    """A hammock or a swing turns the phone to and fro, and its acceleration hides that from the force."""
    rows = phone("still", 6000)
    rows[500:, 4] += 0.3 * np.sin(2 * np.pi * rows[500:, 0] / 3.0)
    assert taken_as_given(tmp_path / "r.csv", rows)


@pytest.mark.parametrize("scene", ["still", "walking"])
def test_an_accelerometer_without_gravity_is_refused_wherever_it_rests(tmp_path: Path, scene: str) -> None:
    """It rests in one attitude at (0, 0, 0), or is first shaken for longer than the opening."""
    rows = phone("still")
    rows[:, 1:4] -= [0.2, 0.2, 10.01]
    if scene == "walking":
        rows[:2500, 1:4] += 5.0 * np.sin(2 * np.pi * 1.8 * rows[:2500, :1])
    with pytest.raises(TraceError, match="at rest: gravity was taken out"):
        read(tmp_path / "r.csv", rows)


def test_free_fall_and_shaking_without_rests_are_read(tmp_path: Path) -> None:
    falling, shaken = phone("turning"), phone("still")
    falling[:, 1:4] = 0.01
    assert taken_as_given(tmp_path / "falling.csv", falling)
    shaken[:, 1:4] += 20.0 * np.sin(2 * np.pi * 1.3 * shaken[:, :1]) - [0.2, 0.2, 10.01]
    assert taken_as_given(tmp_path / "shaken.csv", shaken)
    dropped = phone("still", 1000)
    dropped[200:499, 1:4] -= [0.2, 0.2, 10.01]
    assert taken_as_given(tmp_path / "dropped.csv", dropped)


def counts_of(scene: str, per_g: float, per_degree: float) -> str:
    """Return the log of a chip that gives raw counts, as hobbyists' boards print it."""
    one_si = [1e3, *[per_g / STANDARD] * 3, *[per_degree / DEGREE] * 3]
    rows = np.rint(phone(scene, scale=1.01) * one_si).astype(int)
    lines = (",".join(map(str, row)) + "\n" for row in rows.tolist())
    return "millis,accX,accY,accZ,gyroX,gyroY,gyroZ\n" + "".join(lines)


OF_CHIPS = [
    *((16384, 131.072), (8192, 65.536), (4096, 32.768), (2048, 16.384), (16384, 262.144)),
    *((16393, 1e3 / 8.75), (4098, 1e3 / 35.0), (256, 14.375)),
]
"""Counts in g and in deg/s by data sheets: MPU-6050 and BMI160; LSM6DS3; ADXL345 with an ITG-3200."""


@pytest.mark.parametrize(("per_g", "per_degree"), OF_CHIPS)
@pytest.mark.parametrize("named", [True, False])
def test_raw_counts_are_told_by_gravity_and_how_it_turns(
    tmp_path: Path, per_g: float, per_degree: float, named: bool
) -> None:
    path = tmp_path / "mpu.csv"
    text = counts_of("turning", per_g, per_degree)
    path.write_text(text if named else text.split("\n", 1)[1])
    recording, true = read_all(path), phone("turning", scale=1.01)
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz, true[:, 1:4], rtol=2e-3, atol=0.03)
    np.testing.assert_allclose(recording.gyroscope.xyz, true[:, 4:], rtol=0.01, atol=2e-3)
    assert "in g (by the size of gravity)" in recording.notes[0]
    assert "in deg/s (as gravity's direction turns)" in recording.notes[0]


@pytest.mark.parametrize(("force", "rate"), [(1.0, 131.072), (1e3, 16.384), (16384.0, 1.0), (4096.0, 1.0)])
def test_one_sensor_in_counts_says_nothing_of_the_other(tmp_path: Path, force: float, rate: float) -> None:
    """Rates in counts beside g or mg were read as mdeg/s, those in deg/s beside counts left out."""
    rows = phone("turning", scale=1.01) * [1e3, *[force / STANDARD] * 3, *[rate / DEGREE] * 3]
    forms = ["%d", *["%.5f" if force == 1.0 else "%d"] * 3, *["%.4f" if rate == 1.0 else "%d"] * 3]
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, forms, ",", header="millis,accX,accY,accZ,gyroX,gyroY,gyroZ", comments="")
    gyroscope, true = read_all(path).gyroscope, phone("turning", scale=1.01)[:, 4:]
    assert gyroscope is not None
    np.testing.assert_allclose(gyroscope.xyz, true, rtol=0.01, atol=2e-3)


def test_raw_rates_that_nothing_turns_by_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "mpu.csv"
    path.write_text(counts_of("still", 16384, 131.072))
    recording = read_all(path)
    assert recording.gyroscope is None and len(recording.accelerometer) == 3000
    assert (
        "gyroX gyroY gyroZ not read: raw counts, and turns do not show the value of one" in recording.notes[0]
    )


@pytest.mark.parametrize(("per_g", "per_degree", "told"), [(12000, 131.072, False), (16384, 90.0, True)])
def test_counts_of_no_known_chip_are_not_guessed(
    tmp_path: Path, per_g: float, per_degree: float, told: bool
) -> None:
    path = tmp_path / "mpu.csv"
    path.write_text(counts_of("turning", per_g, per_degree))
    if told:
        assert read_all(path).gyroscope is None
        return
    with pytest.raises(TraceError, match="gravity in no unit"):
        read_all(path)


@pytest.mark.parametrize(
    ("turned", "left", "factor", "told"),
    [(1.0, 0.05, 1.0, True), (1.0, 0.2, 1.0, False), (0.2, 0.05, 1.0, False), (1.0, 0.05, -1.0, False)],
)
def test_counts_are_told_by_rates_that_explain_enough_turning(
    turned: float, left: float, factor: float, told: bool
) -> None:
    """turned: rad of gravity; left: part that rates leave of it, squared; factor: -1 for rates reversed."""
    per_count = factor * DEGREE / 65.536
    explained = turned**2 * (1.0 - left)
    squares = np.array(
        [[turned**2, -explained / per_count], [-explained / per_count, explained / per_count**2]]
    )
    assert counts_per_degree([Turning(8, 1.0, 1.0, squares)]) == (65.536 if told else None)
