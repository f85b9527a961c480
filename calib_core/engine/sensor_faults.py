"""Sensors that stop, stick or tell something else than they should: by the detector's counts and by rests."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.suspicion import Innovation
from stillcal.calib_core.engine.actions import Level, Log
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import Label, Ledger
from stillcal.calib_core.streams.samples import Sensor

_LEAST_S = 60.0
"""s of windows that must have been looked at for anything to be said of a sensor."""

_LEAST_PROBES = 20
"""Probes, minutes apart, that do as well: one that meets a fault ends with its first window."""

_SHARE = 0.5
"""Share of the windows that must have the same fault."""

_ONE_VALUE = "it shows one value again and again"
_MOVES_ALONE = "it shows motion while the accelerometer lies still: check its unit, its range and its noise"
_ALONE_SHARE = 2.0 / 3.0
"""Share of the windows in which the gyroscope must move alone; in a calm hand it does in nearly half."""

_OF_WINDOWS = {
    Label.FROZEN: _ONE_VALUE,
    Label.IMPLAUSIBLE: "its readings at rest are not of gravity's size: check its unit and its range",
}
NO_SAMPLES = "it sends no samples, although the other sensor does"
NONE_OF_USE = "it sends no samples, too few of them, or one value again and again"

MOST_BIAS = math.radians(40.0)
"""rad/s, by axis: twice the zero-rate offset of coarse sensors (20 deg/s, InvenSense MPU-6050 data sheet)."""
_TOO_LARGE = "its readings at rest are too large for a bias: check its unit and its range"

_LEAST_FACTOR = 1.5
"""A range or a unit that changes multiplies readings by 2 or more, a sensor's own scale never by as much."""

_LEAST_BIAS = 10.0
"""Standard uncertainties: only a bias that is as large shows a factor."""

_FAR = 4.0 * math.sqrt(12.0)
"""Uncertainties of a rest on one code, four steps of the quantiser: a bias drifts by less between rests."""

_HOLDS = 1e-9
"""rad/s: an axis whose samples scatter by less than this shows one value."""


def failure(sensor: Sensor, fault: str) -> str:
    """Return what is said of a sensor that has failed."""
    return f"the {sensor} fails: {fault}"


def sensor_faults(
    then: Ledger, now: Ledger, has_gyroscope: bool, silent: bool, before: Mapping[Sensor, str]
) -> dict[Sensor, str]:
    """Return what is wrong with each sensor by the windows looked at between two moments.

    has_gyroscope: whether one has ever sent samples. silent: whether the accelerometer sends none. before:
    what was wrong by then, which stays where too little was looked at.
    """
    if silent:
        return {**before, Sensor.ACCELEROMETER: NO_SAMPLES}
    if not shows_enough(then, now):
        return dict(before)
    counts = _counts(then, now)
    found = {}
    for label, words in _OF_WINDOWS.items():
        if counts[label] > _SHARE * counts.total():
            found[Sensor.ACCELEROMETER] = words
    if has_gyroscope and now.gyro_on_s == then.gyro_on_s:
        found[Sensor.GYROSCOPE] = NONE_OF_USE
    elif counts[Label.GYRO_MOVING] > _ALONE_SHARE * counts.total() or (
        before.get(Sensor.GYROSCOPE) == _MOVES_ALONE and counts[Label.STILL] <= counts[Label.GYRO_MOVING]
    ):
        found[Sensor.GYROSCOPE] = _MOVES_ALONE
    return found


def is_deaf(then: Ledger, now: Ledger) -> bool:
    """Tell whether the gyroscope showed motion in most windows while the accelerometer lay still.

    Then its noise floor may be one that it never comes down to again.
    """
    counts = _counts(then, now)
    return shows_enough(then, now) and counts[Label.GYRO_MOVING] > _SHARE * counts.total()


def shows_enough(then: Ledger, now: Ledger) -> bool:
    """Tell whether enough was looked at between two moments for anything to be said of a sensor."""
    return now.accel_on_s - then.accel_on_s >= _LEAST_S or now.probes - then.probes >= _LEAST_PROBES


def _counts(then: Ledger, now: Ledger) -> Counter[Label]:
    """Return how many windows had each label between two moments."""
    return Counter(now.windows) - Counter(then.windows)


def told(t: float, before: Mapping[Sensor, str], now: Mapping[Sensor, str]) -> list[Log]:
    """Return the log's lines at t (s) on which sensors have failed since, and which are well again."""
    lines = []
    for sensor in Sensor:
        if sensor in now and now[sensor] != before.get(sensor):
            lines.append(Log(t, Level.WARNING, "sensor", failure(sensor, now[sensor])))
        elif sensor in before and sensor not in now:
            lines.append(Log(t, Level.INFO, "sensor", f"the {sensor} works again"))
    return lines


def rate_fault(
    rest: RestState, missed: Innovation | None, earlier: Sequence[RestState], significance: float
) -> str:
    """Return why the rates of a rest are no gyroscope's bias; empty where they may be one.

    missed: by how much they miss what is stated of the bias, None where nothing is. earlier: rests before it.
    significance: standard uncertainties.
    """
    if rest.rate is None or rest.rate_sd is None or rest.rate_uncertainty is None:
        return ""
    if np.abs(rest.rate).max() > MOST_BIAS:
        return _TOO_LARGE
    if missed is None or not missed.surprises(significance):
        return ""
    noise = np.array([r.rate_sd for r in earlier if r.rate_sd is not None]).reshape(-1, 3)
    lively = np.mean(noise > _HOLDS, axis=0) > _SHARE if len(noise) else np.zeros(3, dtype=bool)
    far = np.abs(missed.missed) > np.maximum(significance * missed.sd, _FAR * rest.rate_uncertainty)
    if (far & lively & (rest.rate_sd < _HOLDS)).any():
        return f"an axis of it sticks: {_ONE_VALUE}"
    factor = _factor(rest.rate, missed, significance)
    if factor is None or not len(noise) or not _is_as_noisy(factor, rest.rate_sd, noise):
        return ""
    return f"its readings are {factor:.2g} times as large as before: its unit or range has changed"


def without_rates(rest: RestState) -> RestState:
    """Return a rest as if there were no gyroscope."""
    return replace(
        rest, rate=None, rate_sd=None, rate_uncertainty=None, rate_level=None, undetected_rotation_bound=None
    )


def _factor(rate: Array, missed: Innovation, significance: float) -> float | None:
    """Return what has multiplied a bias to give the rates (3,) of a rest, rad/s; None where nothing has."""
    bias = rate - missed.missed
    if np.linalg.norm(bias) < _LEAST_BIAS * np.linalg.norm(missed.sd):
        return None
    factor = float(rate @ bias / (bias @ bias))
    left = np.abs(rate - factor * bias)
    if factor <= 0.0 or (left > significance * max(factor, 1.0) * missed.sd).any():
        return None
    return factor if abs(math.log(factor)) > math.log(_LEAST_FACTOR) else None


def _is_as_noisy(factor: float, sd: Array, before: Array) -> bool:
    """Tell whether the noise sd (3,), rad/s, is nearer to `factor` times that of before (n, 3) than to it."""
    usual = float(np.median(np.linalg.norm(before, axis=1)))
    grown = math.log(max(float(np.linalg.norm(sd)), _HOLDS) / max(usual, _HOLDS))
    return abs(grown - math.log(factor)) < abs(grown)
