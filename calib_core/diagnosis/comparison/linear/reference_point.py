"""Where constants of two recordings are compared: at which temperature, and on which side of a settling.

Where one bias follows temperature and the other does not, they differ at any temperature but one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.linear.shifts import SHIFTED, Shifted, moved_rows
from stillcal.calib_core.diagnosis.comparison.quantity import Key, Quantity, posterior, subtract
from stillcal.calib_core.diagnosis.model.settings import CERTAIN
from stillcal.calib_core.diagnosis.segments.static_bins import Bins

CROSSING_SPREAD_K = 10.0
"""K: how far from a recording's mean temperature the one lies at which a sensor was trimmed."""

FARTHEST = 2.6
"""Standard deviations of that temperature beyond which it is none (two-sided 1 %)."""

Side = dict[Key, Quantity]
Anew = Callable[[Mapping[str, float], bool], Sequence[Side]]
"""Makes constants and slow effects of two recordings at temperatures by sensor, degC, and whether settled."""


def where_both_agree(
    sides: Sequence[Side], means: Mapping[str, float], settling: Iterable[str], anew: Anew
) -> list[Side]:
    """Return what either recording shows, each sensor's constants where those of both agree best.

    They are those at the temperature where both agree best, if they do agree there: elsewhere they would only
    repeat that a slope differs. So of a bias that settles it is that of the start or the settled one, where
    both agree better: the other would only repeat the amplitude. sides: what they show at the temperatures
    `means`, degC by sensor; settling: the sensors of which a bias settles.
    """
    best, reference = list(sides), dict(means)
    for sensor, at in crossing_temperatures(sides, means).items():
        crossed = anew(reference | {sensor: at}, False)
        if all(agree(crossed, (effect.removesuffix("_temperature"), sensor)) for effect in SHIFTED):
            best, reference = _with_those_of(sensor, best, crossed), reference | {sensor: at}
    for sensor in settling:
        later, bias = anew(reference, True), (f"{sensor}_bias", sensor)
        if apart(later, bias) < apart(best, bias):
            best = _with_those_of(sensor, best, later)
    return best


def mean_temperatures(recorded: Bins, simulated: Bins, steady: Collection[str]) -> dict[str, float]:
    """Return, by sensor, the degC at which constants are compared, if both have a thermometer.

    That is the recording's mean, or the simulation's for the sensors in `steady`.
    """
    if (
        recorded.temperature is None
        or simulated.temperature is None
        or not (len(recorded) and len(simulated))
    ):
        return {}
    means = float(recorded.temperature.mean()), float(simulated.temperature.mean())
    return {sensor: means[sensor in steady] for sensor in ("accel", "gyro")}


def crossing_temperatures(
    sides: Sequence[Mapping[Key, Quantity]], reference: Mapping[str, float], shifted: Shifted = SHIFTED
) -> dict[str, float]:
    """Return, by sensor, the degC at which the constants of both agree best, where their slopes differ.

    A slope that is missing has a temperature at which it adds nothing. At any other one the bias (or scale)
    would seem to differ too. It is the least squares crossing of the lines of both, with a prior about the
    mean. Lines that meet beyond `FARTHEST` standard deviations of it differ anyway, and the mean is kept.
    shifted: the constants that temperature moves, by effect.
    """
    out = {}
    for sensor, mean in reference.items():
        lines = [a for effect in shifted if (a := _line(sides, effect, sensor, shifted)) is not None]
        pull = sum(float(slope @ weight @ away) for slope, weight, away in lines)
        steep = sum(float(slope @ weight @ slope) for slope, weight, _ in lines)
        warmer = -pull / (steep + CROSSING_SPREAD_K**-2.0)
        if lines and abs(warmer) <= FARTHEST * CROSSING_SPREAD_K:
            out[sensor] = mean + warmer
    return out


def _line(
    sides: Sequence[Mapping[Key, Quantity]], effect: str, sensor: str, shifted: Shifted
) -> tuple[Array, Array, Array] | None:
    """Return how two recordings' constants differ by temperature: None where an effect's slopes do not.

    That is the change by axis (3,) for each K, and of the difference at the reference its inverse covariance
    (3, 3) and its size (3,).
    """
    keys = ((effect, sensor), (effect.removesuffix("_temperature"), sensor))
    if not all(key in side for key in keys for side in sides):
        return None
    slope, constant = (subtract(sides[0][key], sides[1][key]) for key in keys)
    if posterior(slope.log_bayes_factor, len(sides[0])) < CERTAIN:
        return None
    rows = moved_rows(effect, shifted)
    spread = constant.covariance[np.ix_(rows, rows)] + np.diag(constant.recorded.tolerance[rows] ** 2)
    # A scale is that of the correction: what the sensor gains it loses.
    change = -slope.value[:3] if "_scale_" in effect else slope.value[:3]
    return change, np.asarray(np.linalg.inv(spread)), constant.value[rows]


def apart(sides: Sequence[Mapping[Key, Quantity]], key: Key) -> float:
    """Return the log Bayes factor, nats, for a difference of a quantity; none where one does not show it."""
    one, other = (side.get(key) for side in sides)
    return -np.inf if one is None or other is None else subtract(one, other).log_bayes_factor


def agree(sides: Sequence[Mapping[Key, Quantity]], key: Key) -> bool:
    """Whether two recordings are not sure to differ in a quantity that both show."""
    one, other = (side.get(key) for side in sides)
    if one is None or other is None:
        return True
    return posterior(subtract(one, other).log_bayes_factor, len(sides[0])) < CERTAIN


def _with_those_of(
    sensor: str, sides: Sequence[Mapping[Key, Quantity]], others: Sequence[Mapping[Key, Quantity]]
) -> list[dict[Key, Quantity]]:
    """Return both sides with one sensor's quantities taken from others."""
    return [
        dict(side) | {key: q for key, q in other.items() if key[1] == sensor}
        for side, other in zip(sides, others, strict=True)
    ]
