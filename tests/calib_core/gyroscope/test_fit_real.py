"""The gyroscope fitted on real recordings: gravity propagated before and after, and held-out segments."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.spatial.transform import Rotation
from scipy.stats import f as f_distribution

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.gyroscope.fit import GyroscopeFit, GyroscopeSettings, Parameters
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment, cut_rotation_segment
from stillcal.calib_core.maths import rotation
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import RestState, force_uncertainties, forces
from stillcal.calib_core.static.settings import DetectorSettings
from stillcal.calib_core.streams.samples import Samples, Sensor

G = 9.80665


@dataclass(frozen=True)
class Calibrated:
    """A recording's turns, its accelerometer, and its gyroscope fitted to all turns."""

    rests: list[RestState]
    turns: list[RotationSegment]
    accel: SensorModel
    fitted: GyroscopeFit


def calibrated(force: Samples, rate: Samples) -> Calibrated:
    detector = StationaryDetector(DetectorSettings())
    rests = [*detector.feed(force, rate), *detector.finish()]
    accel = accelerometer.fit(forces(rests), force_uncertainties(rests), G, parameters=9).model
    cut = [cut_rotation_segment(a, b, rate) for a, b in pairwise(rests)]
    turns = [turn for turn in cut if isinstance(turn, RotationSegment)]
    return Calibrated(rests, turns, accel, gyroscope.fit(turns, accel, G, rests=rests))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module")
def xsens(data_dir: Path) -> Calibrated:
    """Raw counts with the nominal scale of the recording's format: 411 per m/s^2, 6258 per rad/s."""

    def read(name: str, sensor: Sensor, counts: float) -> Samples:
        with gzip.open(data_dir / "imu_tk" / name) as file:
            rows = np.loadtxt(file)
        return Samples.checked(sensor, rows[:, 0], (rows[:, 1:] - 32768) / counts)

    return calibrated(
        read("xsens_acc.mat.gz", Sensor.ACCELEROMETER, 411.0),
        read("xsens_gyro.mat.gz", Sensor.GYROSCOPE, 6258.0),
    )


def test_xsens_gravity_arrives_a_hundred_times_closer(xsens: Calibrated) -> None:
    fitted = xsens.fitted
    assert len(fitted.after) >= 34
    assert fitted.parameters is Parameters.FULL9
    assert fitted.rejected == ()
    assert fitted.gravity_rms_before > 10 * fitted.gravity_rms_after
    assert fitted.gravity_rms_after < 0.03
    assert fitted.scale_uncertainty.max() < 0.002


def test_xsens_still_ten_times_closer_where_the_nominal_scale_is_only_rescaled(xsens: Calibrated) -> None:
    """The nominal 6258 is 31 % off; the best single factor alone takes that away."""
    factors = np.linspace(0.74, 0.79, 51) ** -1
    best = min(rms(gyroscope.residuals(xsens.turns, xsens.accel, f * np.eye(3))) for f in factors)
    assert best > 10 * xsens.fitted.rms_after


def test_xsens_bias_follows_force(xsens: Calibrated) -> None:
    """Taking the g-sensitivity off halves what the fit leaves; it shows at more than ten standard errors."""
    blind = gyroscope.fit(xsens.turns, xsens.accel, G, settings=GyroscopeSettings(g_sensitivity=1e-9))
    assert xsens.fitted.rms_after < blind.rms_after / 2
    z = xsens.fitted.g_sensitivity / xsens.fitted.g_sensitivity_uncertainty
    assert np.abs(z).max() > 10


def test_xsens_left_out_turns_arrive_nearly_as_close(xsens: Calibrated) -> None:
    """Nine folds: every ninth turn left out in its turn, all of them judged by a fit that never saw them."""
    left_out = np.full(len(xsens.turns), np.nan)
    for fold in range(9):
        others = [turn for k, turn in enumerate(xsens.turns) if k % 9 != fold]
        fitted = gyroscope.fit(others, xsens.accel, G, parameters=Parameters.FULL9)
        angles = gyroscope.residuals(xsens.turns, xsens.accel, fitted.model.scale, fitted.shift)
        left_out[fold::9] = angles[fold::9]
    assert rms(left_out) < 1.3 * xsens.fitted.rms_after


@pytest.mark.parametrize("first", [0, 1])
def test_xsens_halves_predict_each_other_as_well_as_chance_allows(xsens: Calibrated, first: int) -> None:
    """Held-out over fitted mean square, times (1 - p/n) / (1 + p/n), n residuals, p = 9, is F-distributed."""
    fitted_turns, held_out = xsens.turns[first::2], xsens.turns[1 - first :: 2]
    fitted = gyroscope.fit(fitted_turns, xsens.accel, G, parameters=Parameters.FULL9)
    after = gyroscope.residuals(held_out, xsens.accel, fitted.model.scale, fitted.shift)
    n, m = 2 * len(fitted_turns), 2 * len(held_out)
    ratio = (rms(after) / fitted.rms_after) ** 2 * (1 - 9 / n) / (1 + 9 / n)
    assert ratio < f_distribution.ppf(0.99, m, n - 9)
    assert rms(gyroscope.residuals(held_out, xsens.accel, np.eye(3))) > 10 * rms(after)


@pytest.mark.parametrize("name", ["imu0", "imu1", "imu2"])
def test_mpu9150_gravity_arrives_closer(data_dir: Path, name: str) -> None:
    """MPU-9150, factory-scaled: within 1 % already, what is left is misalignment."""
    rows = np.loadtxt(data_dir / "mikoff" / f"{name}.log")
    t = np.arange(len(rows)) / 100.0
    result = calibrated(
        Samples.checked(Sensor.ACCELEROMETER, t, rows[:, :3]),
        Samples.checked(Sensor.GYROSCOPE, t, rows[:, 3:6]),
    )
    fitted = result.fitted
    assert fitted.parameters is Parameters.FULL9
    assert fitted.rms_before > 3 * fitted.rms_after
    assert np.abs(fitted.model.scale - np.eye(3)).max() < 0.02
    half = gyroscope.fit(result.turns[::2], result.accel, G, settings=GyroscopeSettings(max_uncertainty=0.02))
    held_out = result.turns[1::2]
    after = gyroscope.residuals(held_out, result.accel, half.model.scale, half.shift)
    assert rms(gyroscope.residuals(held_out, result.accel, np.eye(3))) > 1.5 * rms(after)


@pytest.fixture(scope="module")
def broad(data_dir: Path) -> tuple[Array, Array, Array, float]:
    """Trial 01 of BROAD: t, rates less the first rest's mean, gravity in the body, start of motion."""
    trial = loadmat(data_dir / "broad" / "01_undisturbed_slow_rotation_A.mat")
    rate_hz = float(trial["sampling_rate"].item())
    t = np.arange(len(trial["imu_gyr"])) / rate_hz
    moving = np.flatnonzero(trial["movement"].ravel())
    quaternions = trial["opt_quat"][:, [1, 2, 3, 0]]
    seen = np.isfinite(quaternions).all(axis=1)
    up = np.full((len(t), 3), np.nan)
    up[seen] = Rotation.from_quat(quaternions[seen]).inv().apply([0.0, 0.0, 1.0])
    return t, trial["imu_gyr"] - trial["imu_gyr"][: moving[0] - 500].mean(axis=0), up, float(t[moving[0]])


def propagated_errors(broad: tuple[Array, Array, Array, float], every: int, scale: Array) -> Array:
    """Angles between optical gravity and gravity propagated over spans of 5 s, every so many samples used."""
    t, rates, up, start = broad
    errors = []
    for begin in np.arange(start, start + 120.0, 5.0):
        span = slice(*np.searchsorted(t, (begin, begin + 5.0)), every)
        truth = up[span]
        if np.isfinite(truth[[0, -1]]).all():
            arrived = rotation.rotation(t[span], rates[span] @ scale.T) @ truth[0]
            errors.append(np.arctan2(np.linalg.norm(np.cross(arrived, truth[-1])), arrived @ truth[-1]))
    return np.array(errors)


def test_optical_truth_is_met_within_the_uncalibrated_sensors_scale(
    broad: tuple[Array, Array, Array, float],
) -> None:
    """An uncalibrated gyroscope over up to 5 s of turning: about a degree, at 286 Hz and at 36 Hz alike."""
    full, eighth = (rms(propagated_errors(broad, every, np.eye(3))) for every in (1, 8))
    assert full < np.radians(1.5)
    assert eighth < 1.2 * full
