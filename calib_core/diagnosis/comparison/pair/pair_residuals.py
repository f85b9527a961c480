"""The difference of two sensors' readings, cut into bins: the residuals of each sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.linear.quantities import MODEL_ERROR
from stillcal.calib_core.diagnosis.comparison.pair.alignment import Readings
from stillcal.calib_core.diagnosis.comparison.pair.earth import of_ground
from stillcal.calib_core.diagnosis.effects.by_force import FEWEST_OF_DEGREE
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.residuals import (
    MISALIGNMENT_SIZE,
    SCALE_SIZE,
    View,
    axis_view,
    of_groups,
)
from stillcal.calib_core.diagnosis.model.sensor_residuals import EARTH
from stillcal.calib_core.diagnosis.segments.static_bins import Bins, cut_all, in_motion, shaking
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples

GAIN_SIZES = MISALIGNMENT_SIZE + (SCALE_SIZE - MISALIGNMENT_SIZE) * np.eye(3)
"""Prior size of what one sensor reads of the other's input: scale on the diagonal, misalignment beside it."""

EXACTLY = 1e6
"""Degrees of freedom with which an accelerometer's noise of coarse steps is known: the steps are, and that
all bins of a rest read one code does not make them smaller. What motion dithers of a gyroscope is learnt."""


def pair_residuals(
    difference: Readings,
    true: Readings,
    events: Sequence[Charging],
    mismatch: float,
    added: Readings | None = None,
    *,
    rounding: Mapping[str, Array] | None = None,
    unsure: Mapping[str, Array] | None = None,
) -> tuple[Bins, list[SensorResiduals]]:
    """Return the bins of a whole recording and the residuals of each sensor.

    difference: what the recording reads less what the other does, with the recording's temperature; true:
    what the other reads, which stands for the true input. mismatch: part of what shakes both within a bin by
    which their means differ; where it is 0, they should agree in motion as they do at rest, which is judged
    where rests suffice. added: what effects of turns are of what the other reads; they are not exactly of
    their form. rounding: by sensor, the sd (3,) that coarse steps leave in a mean of what they differ by, the
    same in all of a rest (`_of_steps`). At rest both may read one code: no bin is known better for that than
    if each sample had such an error of its own. unsure: by sensor, as in `SensorResiduals`.
    Where the motion is the same (mismatch 0) the other may lack the Earth's rotation. Raises
    NotSupported where it is too short.
    """
    t = difference.force.t
    span = (float(t[0]), float(t[-1]))
    moved = cut_all(true.force, true.rate, events, span)
    moving = in_motion(true.force, true.rate, moved) if mismatch == 0.0 else np.ones(len(moved))
    moved = _turned_in_motion(moved, moving == 0.0)
    judged = moving if np.sum(moving == 0.0) >= thresholds.LEAST_BINS else None
    left = cut_all(difference.force, difference.rate, events, span, judged)
    if len(left) < thresholds.LEAST_BINS:
        least = thresholds.LEAST_BINS * 4
        raise NotSupported(f"{span[1] - span[0]:.0f} s of the same motion", (f"at least {least} s",))
    known = None if added is None else cut_all(added.force, added.rate, events, span)
    powers = {p: cut_all(_power(true.force, p), true.rate, events, span).force for p in FEWEST_OF_DEGREE}
    cut = _Cut(_with_inputs(left, moved, rounding or {}), left, moving, judged, mismatch)
    inputs = (moved.force, None if known is None else known.force)
    force = cut.views("accel", (left.force, left.force_variance), true.force, inputs)
    up = moved.force / STANDARD
    sensors = [SensorResiduals("accel", cut.bins, force, STANDARD, up, force_powers=powers)]
    if left.rate is not None and left.rate_variance is not None and moved.rate is not None:
        assert true.rate is not None, "it was cut"
        inputs = (moved.rate, None if known is None else known.rate)
        rate = cut.views("gyro", (left.rate, left.rate_variance), true.rate, inputs)
        gyro = SensorResiduals("gyro", cut.bins, rate, STANDARD, up, force_powers=powers)
        sensors.append(gyro if mismatch else _with_earth(gyro, true.rate, moving == 0.0))
    return cut.bins, [replace(s, unsure=(unsure or {}).get(s.sensor)) for s in sensors]


def _turned_in_motion(moved: Bins, still: NDArray[np.bool_]) -> Bins:
    """Return bins whose rate is what turns the gyroscope: none where it is `still` (n,).

    Elsewhere it is the reading less what is read at rest, which is an error of its own. As an input, an error
    in which both differ by a factor, as a sensitivity to gravity that is too large, would be a wrong scale,
    and only turns would speak against it.
    """
    if moved.rate is None or not still.any():
        return moved
    turns = moved.rate - np.median(moved.rate[still], axis=0)
    return replace(moved, rate=np.where(still[:, None], 0.0, turns))


def _with_inputs(left: Bins, moved: Bins, rounding: Mapping[str, Array]) -> Bins:
    """Return the bins of a difference with the true input, and with what coarse steps leave in means."""
    return replace(
        left,
        force=moved.force,
        rate=moved.rate,
        vibration=moved.vibration,
        force_rounding=rounding.get("accel"),
        rate_rounding=rounding.get("gyro"),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Cut:
    """How a difference of readings is cut.

    bins: with the true input; left: the same bins with the difference; moving: (n,) 0 at rest; judged: the
    same, None where all bins are judged alike; mismatch: as in `pair_residuals`.
    """

    bins: Bins
    left: Bins
    moving: Array
    judged: Array | None
    mismatch: float

    def views(
        self, sensor: str, seen: tuple[Array, Array], true: Samples, inputs: tuple[Array, Array | None]
    ) -> tuple[View, ...]:
        """Return the views of a sensor's three axes.

        seen: the difference's means and their variance (n, 3); true: what the other reads; inputs: the true
        ones (n, 3), and what effects of turns added there.
        """
        mean, variance = seen
        rounded = self.bins.force_rounding if sensor == "accel" else self.bins.rate_rounding
        error = np.zeros(3) if rounded is None else rounded
        start, end = self.left.span
        count = len(true) * self.left.duration / (end - start)
        shaken = self.mismatch**2 * shaking(true, self.left)[:, None]
        variance = np.maximum(variance, error**2 / count[:, None]) + shaken
        views = _views(self.left, mean, variance, inputs, self.judged)
        return tuple(
            replace(
                v,
                shared=_of_steps(sensor, self.moving, e),
                known=EXACTLY if sensor == "accel" and e > 0.0 else v.known,
            )
            for v, e in zip(views, error, strict=True)
        )


def _power(samples: Samples, exponent: int) -> Samples:
    """Return a power of each value. In motion its mean over a bin is another than that of the mean."""
    return replace(samples, xyz=frozen(samples.xyz**exponent))


def _with_earth(residuals: SensorResiduals, rate: Samples, still: NDArray[np.bool_]) -> SensorResiduals:
    """Return the gyroscope's residuals, free by the Earth's rotation, which the other sensor may lack."""
    columns = residuals.columns_of(of_ground(rate, residuals.bins, still))
    return replace(residuals, shared=Hypothesis(EARTH, {}, columns))


def _of_steps(sensor: str, moving: Array, error: float) -> tuple[Array, ...]:
    """Return the errors of coarse steps that bins share, as columns (n, m) of `View.shared`.

    moving: (n,) 0 at rest; error: sd that steps leave in the mean of a rest. Each rest has one, for its
    attitude makes it. A bin in which the device moves has one of its own: how much of it the motion dithers
    is not known. A gyroscope reads its bias in all rests, and whenever it moves little: all bins share one.
    An accelerometer's bin in motion has parts of what the rests before and after it have, which are two.
    """
    if error <= 0.0:
        return ()
    moves = moving > 0.0
    rest = np.cumsum(moves | np.append(True, moves[:-1]))
    if sensor == "accel":
        return (of_groups(rest, np.where(moves, np.sqrt(2.0), 1.0) * error),)
    return of_groups(rest, np.full(moves.size, error)), np.full((moves.size, 1), error)


def _views(
    bins: Bins, left: Array, variance: Array, inputs: tuple[Array, Array | None], moving: Array | None
) -> tuple[View, ...]:
    """Return the views of three axes. inputs: the true ones (n, 3), and what effects of turns added there."""
    true, added = inputs
    roughly = np.zeros((len(bins), 3)) if added is None else MODEL_ERROR * added
    return tuple(
        axis_view(
            "pair",
            a,
            bins,
            left,
            variance,
            absorbed=np.column_stack([true * GAIN_SIZES[a], roughly[:, a]]),
            moving=moving,
        )
        for a in range(3)
    )
