"""Structure outside the catalogue: generic changes that compete under the name `unknown`.

They name no physics; where one of them wins, the answer says what is followed and stops there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects import curves
from stillcal.calib_core.diagnosis.effects.bias import SIZE
from stillcal.calib_core.diagnosis.effects.by_force import FEWEST_OF_DEGREE, seen_in
from stillcal.calib_core.diagnosis.effects.by_rate import TURN_PENALTY
from stillcal.calib_core.diagnosis.effects.temperature import known
from stillcal.calib_core.diagnosis.effects.timed import DRIFT_PENALTY, Step
from stillcal.calib_core.diagnosis.effects.warmup import TAUS, relaxation
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import (
    BLOCKS_ACROSS,
    Dictionary,
    Effect,
    Grid,
    Linear,
    centred,
    on_axes,
)
from stillcal.calib_core.diagnosis.model.moments import Moments
from stillcal.calib_core.diagnosis.model.records import only_unknown
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT

COSINES = 6
MARGIN = 1.2
"""Half-period of the slowest cosine, in ranges of the driver: the edges are free."""

LENGTHS = (0.2, 0.6, np.inf)
"""Correlation lengths, as parts of the driver's range; the last leaves a straight line."""

HEATING_WIDTHS = (0.0, 60.0, 200.0)
"""s over which a rate of heating is averaged: heat takes minutes, noise of a thermometer does not."""

SHAKEN = "vibration power"
"""What is followed by structure that goes with how much the device is shaken."""

OF_JUMPS = (curves.pulses, curves.switches)
"""Dictionaries whose courses are several jumps."""

EIGHTHS = 8
"""Parts of a recording between which a gain in turns is first taken to change: few turns tell it no finer."""

GAIN = Linear("gain", "1", 3, 0.02)
SLOPE = Linear("slope", "1/K", 3, 1e-3)


def unknown_sentence(follows: str, what: str = "bias") -> str:
    """Return what is said of an effect without a name. what: "bias" or "gain"; follows: its driver."""
    return only_unknown(f"on the {what} of {{axes}}", follows)


class Unknown(Effect):
    """A change without a name. follows: its driver; penalty: score that it must give away."""

    name = "unknown"
    grid_units = {"t_start": "s", "t_end": "s", "period_s": "s"}  # noqa: RUF012 - a constant of the class
    what = "bias"

    def __init__(self, sensor: str, follows: str, parameter: Linear, penalty: float = 0.0) -> None:
        self.sensor, self.follows, self.parameters = sensor, follows, (parameter,)
        self.sentence = unknown_sentence(follows, self.what)
        self.prior_penalty = penalty + thresholds.UNKNOWN_PENALTY


class UnknownCurve(Unknown):
    """A bias that follows one of many curves."""

    blind = BLOCKS_ACROSS

    def __init__(
        self, sensor: str, follows: str, many: Callable[[Moments], Dictionary | None], width: int = 1
    ) -> None:
        super().__init__(sensor, follows, Linear("amplitude", UNIT[sensor], 3 * width, SIZE[sensor]))
        self.many = many
        self.several_of = f"{sensor}_bias_step" if many in OF_JUMPS else ""

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return none: the curves are a dictionary."""
        return []

    def dictionary(self, moments: Moments) -> Dictionary | None:
        """Return the curves."""
        return self.many(moments)


class Cycle(UnknownCurve):
    """A bias that comes and goes with a period."""

    def __init__(self, sensor: str) -> None:
        super().__init__(sensor, "a period in time", curves.periods, 2)

    def finer(self, moments: Moments, grid: Grid) -> Sequence[Grid]:
        """Return periods within a step of the dictionary's."""
        return [{"period_s": period} for period in curves.periods_near(moments, grid["period_s"])]

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the sine on each axis, then the cosine, (n, 3, 6)."""
        sine, cosine = curves.cycle(moments, grid["period_s"])
        return np.concatenate([on_axes(sine), on_axes(cosine)], axis=2)


class SmoothCurve(Unknown):
    """A bias that is a smooth function of a driver, and nobody knows which: its discrepancy.

    A Gaussian process over the driver (Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 425 (2001)), as cosines
    over its range whose variances are the spectral density of a squared exponential covariance (Solin and
    Sarkka, Stat. Comput. 30, 419 (2020)). Over time it would be what noise is; there, see `curves`.
    """

    def __init__(
        self,
        sensor: str,
        follows: str,
        of: str,
        driver: curves.Driver,
        lags: Sequence[float] = (0.0,),
        *,
        between: Sequence[float] = (),
    ) -> None:
        """Take what it follows, and the driver (`of`) that named effects follow and this one departs from.

        between: further lags, of a straight line alone.
        """
        super().__init__(sensor, follows, Linear("amplitude", UNIT[sensor], 3 * COSINES, SIZE[sensor]))
        self.of, self.driver, self.lags, self.between = of, driver, lags, between

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return the correlation lengths and lags, where the driver changes."""
        if self.driver(moments, self.lags[0]) is None:
            return []
        bends = [{"length": length, "lag_s": lag} for length, lag in product(LENGTHS, self.lags)]
        return [*bends, *({"length": np.inf, "lag_s": lag} for lag in self.between)]

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return each cosine on each axis in turn, (n, 3, 3 COSINES), with the process' deviations."""
        x = self.driver(moments, grid["lag_s"])
        assert x is not None, "no grid points without it"
        if np.isinf(grid["length"]):
            line = on_axes(centred(x))
            return np.concatenate([line, np.zeros((len(moments), 3, 3 * COSINES - 3))], axis=2)
        place = (x - x.min()) / max(float(np.ptp(x)), 1e-300)
        return waves_on_axes(np.repeat(place[:, None], 3, axis=1), grid["length"])


def waves_on_axes(place: Array, length: float) -> Array:
    """Return each cosine on each axis in turn (n, 3, 3 COSINES), at each axis' place (n, 3) in its range."""
    frequency = np.pi * np.arange(1, COSINES + 1) / MARGIN
    density = np.sqrt(2.0 * np.pi) * length * np.exp(-0.5 * (length * frequency) ** 2)
    waves = np.cos(place[:, :, None] * frequency) * np.sqrt(2.0 / MARGIN * density)
    return np.asarray((waves[:, :, :, None] * np.eye(3)[:, None, :]).reshape(len(place), 3, -1))


class ForceCurve(Unknown):
    """An error of the accelerometer that is some smooth curve of the force on its own axis."""

    def __init__(self) -> None:
        size = Linear("amplitude", UNIT["accel"], 3 * COSINES, SIZE["accel"])
        super().__init__("accel", "own force, not as a polynomial", size)

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return the correlation lengths that bend, where attitudes suffice for more than a polynomial."""
        enough = seen_in(moments, max(FEWEST_OF_DEGREE.values()))
        return [{"length": length} for length in LENGTHS if enough and length < np.inf]

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return each cosine on each axis in turn, over the force from -g to g."""
        assert moments.up is not None, "no grid points without attitudes"
        return waves_on_axes((moments.up + 1.0) / 2.0, grid["length"])


class GainBySign(Unknown):
    """An accelerometer's gain that differs between the two signs of the force: a kink, no polynomial."""

    what = "gain"

    def __init__(self) -> None:
        super().__init__("accel", "size of the own force", GAIN)

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where attitudes suffice."""
        return [{}] if seen_in(moments, FEWEST_OF_DEGREE[2]) else []

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the size of the force on each axis."""
        assert moments.force is not None, "no grid points without it"
        return on_axes(np.abs(moments.force))


class Settling(Unknown):
    """A bias that settles after the start in any way: a sum of first-order courses of many time constants.

    A Gaussian process again, over the time since the start: the courses' sizes are independent, and together
    as large as one of them alone may be. Their time constants are a factor of two or of four apart.
    """

    blind = BLOCKS_ACROSS

    def __init__(self, sensor: str) -> None:
        size = Linear("amplitude", UNIT[sensor], 3 * len(TAUS), SIZE[sensor] / float(np.sqrt(len(TAUS))))
        # Slow wander looks like this as often as it looks like a ramp.
        super().__init__(sensor, "time since start", size, DRIFT_PENALTY)

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return both spacings, where more than one time constant can show."""
        start, end = moments.history.span
        return [{"every": 1}, {"every": 2}] if TAUS[1] <= (end - start) / 2.0 else []

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return each course on each axis in turn, (n, 3, 3 len(TAUS)); nothing for those left out."""
        courses = [relaxation(moments, tau) for tau in TAUS]
        return np.concatenate([on_axes(c * (i % grid["every"] == 0)) for i, c in enumerate(courses)], axis=2)


class GainInStretch(Unknown):
    """Another gain of each axis in a stretch of time."""

    what = "gain"
    blind = BLOCKS_ACROSS

    def __init__(self) -> None:
        super().__init__("accel", "own force in a stretch of time", GAIN)
        self.jump = Step("accel")

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return none: the stretches are a dictionary."""
        return []

    def dictionary(self, moments: Moments) -> Dictionary | None:
        """Return the stretches in which a bias may be another, where attitudes suffice."""
        return _of_force(curves.pulses(moments), moments)

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the force on each axis between the two moments."""
        assert moments.force is not None, "no grid points without it"
        after = (self.jump.curve(moments, {"t_start": grid[end]}) for end in ("t_start", "t_end"))
        return on_axes(moments.force * np.subtract(*after)[:, None])


class GainFromMoment(Unknown):
    """Another gain of each axis from a moment on: at the moments at which a bias may jump."""

    what = "gain"
    blind = BLOCKS_ACROSS
    grid_units = {"t_start": "s"}  # noqa: RUF012 - a constant of the class

    def __init__(self) -> None:
        super().__init__("accel", "own force from a moment on", GAIN)
        self.jump = Step("accel")

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return none: the moments are a dictionary."""
        return []

    def dictionary(self, moments: Moments) -> Dictionary | None:
        """Return the moments at which a bias may jump, where attitudes suffice."""
        return _of_force(self.jump.dictionary(moments), moments)

    def finer(self, moments: Moments, grid: Grid) -> Sequence[Grid]:
        """Return moments near one, more finely."""
        return self.jump.finer(moments, grid)

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the force on each axis after the moment."""
        assert moments.force is not None, "no grid points without it"
        return on_axes(moments.force * self.jump.curve(moments, grid)[:, None])


def _of_force(many: Dictionary | None, moments: Moments) -> Dictionary | None:
    """Return a dictionary of biases as one of gains; None where attitudes are too few."""
    return None if many is None or not seen_in(moments, 4) else replace(many, driven=moments.force)


class GainInTime(Unknown):
    """A gain of each axis that grows with time, by so much in the whole recording."""

    what = "gain"
    blind = BLOCKS_ACROSS

    def __init__(self) -> None:
        super().__init__("accel", "own force, with time", GAIN)

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where attitudes suffice."""
        return [{}] if seen_in(moments, 4) else []

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the force on each axis times the age, in the age's range."""
        assert moments.force is not None, "no grid points without it"
        return on_axes(moments.force * centred(moments.age)[:, None])


class CrossedForce(Unknown):
    """What each axis and the next take up of each other's force, by temperature.

    The norm of gravity sees no more of misalignment than what the two axes have in common.
    """

    what = "gain"

    def __init__(self) -> None:
        super().__init__("accel", "temperature x another axis' force", SLOPE)

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where attitudes suffice and temperature changed."""
        return known(moments) if seen_in(moments, 4) else []

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return half the other axis' force on each of two axes, by temperature, (n, 3, 3)."""
        assert moments.force is not None and moments.temperature is not None, "no grid points without them"
        errors = np.zeros((len(moments), 3, 3))
        for a, b in ((0, 1), (1, 2), (2, 0)):
            errors[:, a, a], errors[:, b, a] = 0.5 * moments.force[:, b], 0.5 * moments.force[:, a]
        return np.asarray(errors * moments.temperature[:, None, None])


class AttitudeSquared(Unknown):
    """Bias by squares and products of gravity's components, the same five on each axis."""

    by_row = True

    def __init__(self, sensor: str) -> None:
        super().__init__(sensor, "attitude, nonlinearly", Linear("amplitude", UNIT[sensor], 15, SIZE[sensor]))

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where attitudes suffice."""
        return [{}] if seen_in(moments, 8) else []

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the five terms on each axis, (n, 3, 15), row by row."""
        u = moments.up
        assert u is not None, "no grid points without attitudes"
        x, y, z = u.T
        terms = np.stack([x**2, y**2, x * y, x * z, y * z], axis=1)
        rows = np.eye(3)[None, :, :, None] * terms[:, None, None, :]
        return np.asarray(rows.reshape(len(moments), 3, 15))


class GainInTurns(Unknown):
    """A gyroscope's gain that grows with time, by so much in the whole recording."""

    what = "gain"
    in_turns = True

    def __init__(self) -> None:
        super().__init__("gyro", "time x rate of turn", GAIN)

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the rate on each axis times the age, in the recording's length."""
        assert moments.rate is not None, "a turn has a rate"
        start, end = moments.history.span
        return on_axes(moments.rate * (moments.age / (end - start) - 0.5)[:, None])


class GainFromMomentInTurns(Unknown):
    """A gyroscope's gain that is another from a moment on, first at one of its eighths."""

    what = "gain"
    in_turns = True

    def __init__(self) -> None:
        super().__init__("gyro", "rate of turn from a moment on", GAIN, TURN_PENALTY)

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return the moments between the eighths of the recording."""
        return [{"t_start": float(t)} for t in np.linspace(*moments.history.span, EIGHTHS + 1)[1:-1]]

    def finer(self, moments: Moments, grid: Grid) -> Sequence[Grid]:
        """Return moments within an eighth, an eighth of it apart."""
        start, end = moments.history.span
        away = np.linspace(-1.0, 1.0, 2 * EIGHTHS + 1) * (end - start) / EIGHTHS
        return [{"t_start": float(t)} for t in grid["t_start"] + away]

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the rate on each axis after the moment."""
        assert moments.rate is not None, "a turn has a rate"
        return on_axes(moments.rate * (moments.t >= grid["t_start"])[:, None])


class GainByDirection(Unknown):
    """A gyroscope's gain that differs between the two directions of rotation."""

    what = "gain"
    in_turns = True

    def __init__(self) -> None:
        super().__init__("gyro", "size of the rate of turn", GAIN, TURN_PENALTY)

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the size of the rate on each axis."""
        assert moments.rate is not None, "a turn has a rate"
        return on_axes(np.abs(moments.rate))


def unknown_effects(sensor: str) -> list[Effect]:
    """Return the nameless effects of one sensor, in rests and in turns."""
    own: list[Effect] = [
        SmoothCurve(
            sensor,
            "temperature's past or bend",
            "temperature",
            curves.warmth,
            curves.LAGS,
            between=curves.BETWEEN,
        ),
        SmoothCurve(sensor, "rate of heating", "temperature", curves.heating, HEATING_WIDTHS),
        SmoothCurve(sensor, "the past of charging", "charging", curves.plugged, curves.HEATS),
        SmoothCurve(sensor, SHAKEN, SHAKEN, curves.shaking),
        Settling(sensor),
        AttitudeSquared(sensor),
    ]
    if sensor == "accel":
        own += [ForceCurve(), GainBySign(), GainInStretch(), GainFromMoment(), GainInTime(), CrossedForce()]
    else:
        own += [GainByDirection(), GainInTurns(), GainFromMomentInTurns()]
    many = (
        ("a stretch of time", curves.pulses, 1),
        ("two levels in time", curves.switches, 1),
        ("time from a moment on", curves.onsets, 1),
        ("a sawtooth in time", curves.sawteeth, 1),
        ("time since the phone was moved", curves.since_moves, 1),
        ("time since the last change of attitude", curves.strains, 3),
    )
    return [
        *own,
        Cycle(sensor),
        *(UnknownCurve(sensor, follows, make, width) for follows, make, width in many),
    ]
