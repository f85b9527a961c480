"""Checks whether a recording can be in m/s^2 and rad/s, and names the unit it seems to have if not.

Acceleration is judged by its norm: for the first samples together it must not be what g, mg or raw
counts would give, and at rest it must hold gravity. Rates are judged by gravity: as the phone turns,
gravity's direction turns against it, so the factor between the rates and the turning shows the unit.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.formats.checks.axes import Turning, turnings
from stillcal.replay.formats.clock import SLOWEST_STEP_S
from stillcal.replay.formats.errors import TraceError

OPENING, ENOUGH = 200, 2000
"""Samples after which the acceleration is checked: first its beginning, which is often a rest, then more."""

FEWEST = 10
"""With fewer samples, nothing is checked."""

_NO_GRAVITY = 2.0
"""m/s^2, rms over a second: a smaller force holds no gravity."""

_CALM = 0.5
"""m/s^2, rms about the mean of a second: what shakes less is at rest, on a table or in a vehicle."""

_TURNING = 0.2
"""rad/s, mean of a second: what turns faster may be falling. A gyroscope's bias is less."""

_LONGEST_FALL = 3.0
"""s: nobody drops a phone by 44 m."""

_MOSTLY = 9.0
"""Times longer without gravity at rest than with it: a flight in parabolas is not."""

DEGREE = float(np.pi / 180)
"""rad."""

_VOTES = 3
"""Stretches that must show a unit, and be the most of those that show anything, before it is believed."""

_CLEARLY = 10.0
"""One unit must leave this many times the squared misfit of another to be ruled out: more than the 4 that
a gyroscope turned against the accelerometer's axes gives (residual twice the turning)."""

_LEAST_TURNING = 2e-3
"""rad, rms over pairs of bins: smaller turning shows nothing."""

_TILT = 0.2
"""rad: how far biases and misalignment may tilt the force from gravity as the gyroscope's axes have it; a
fast spin about the vertical then seems to turn gravity by this much of its angle."""

_EXPLAINED = 2.0
"""Rates in deg/s that turn the phone leave gravity's direction this many times less to turn, squared, than
no rates at all."""

_SMOOTHLY, _SWUNG = 0.6, 0.02
"""On a swing the force keeps along the ropes, so that rates seem not to turn it. They change from one quarter
of a second to the next by so much of what they turn, squared (noise: by twice that; a swing of 2 s: by 0.59),
and turn by 0.14 rad in it at most, root of the second. Phones of 30 people at rest, read in deg/s, are
noisier or turn more in most stretches; a child's swing does, too, and is taken for deg/s."""

_MAP = "in a column map given as --format (docs/formats.md)"


@dataclass(slots=True)
class UnitCheck:
    """Checks a recording chunk by chunk, and raises TraceError when its units cannot be right."""

    path: Path
    _norms: list[Array] = field(default_factory=list)
    _samples: int = 0
    _votes: Counter[str] = field(default_factory=Counter)
    _settled: bool = False
    _without: list[float] = field(default_factory=list)
    """Rms force, m/s^2, of every second at rest that holds no gravity."""
    _with_gravity: int = 0
    """Seconds at rest that hold it."""

    def see(self, accelerometer: Samples, gyroscope: Samples) -> None:
        """Take in the next stretch of the recording. Raises TraceError."""
        before, self._samples = self._samples, self._samples + len(accelerometer)
        if before == 0:
            self._judge_time(accelerometer.t)
        if before < ENOUGH:
            self._norms.append(np.linalg.norm(accelerometer.xyz, axis=1))
        if before < OPENING <= self._samples:
            self._judge_size(np.concatenate(self._norms)[:OPENING])
        if before < ENOUGH <= self._samples:
            self._judge_opening()
        self._see_gravity(accelerometer, gyroscope)
        if not self._settled:
            self._votes.update(map(shown_unit, turnings(accelerometer, gyroscope)))
            self._judge_rates()

    def finish(self) -> None:
        """Check the acceleration by all samples; a second call does nothing. Raises TraceError."""
        self._judge_opening()
        seconds = len(self._without)
        if seconds > max(_LONGEST_FALL, _MOSTLY * self._with_gravity):
            size = float(np.median(self._without))
            what = f"the acceleration is about {size:.4g} in size at rest: gravity was taken out of it"
            raise TraceError(self.path, what, "give the accelerometer with gravity")

    def _judge_opening(self) -> None:
        """Check the first samples so far, once."""
        if self._norms and self._samples >= FEWEST:
            norms = np.concatenate(self._norms)[:ENOUGH]
            if not norms.any():
                what = f"the accelerometer reads zero in all of the first {norms.size} samples"
                raise TraceError(self.path, what, "check that it was on and that the columns are its own")
            self._judge_size(norms)
        self._norms = []

    def _see_gravity(self, accelerometer: Samples, gyroscope: Samples) -> None:
        """Count the seconds at rest with and without gravity; those that a chunk begins or ends in too."""
        second, mean, power = _seconds(accelerometer)
        size = np.sqrt(power)
        calm = power - (mean**2).sum(axis=1) < _CALM**2
        held = size >= _NO_GRAVITY
        turning = np.zeros(second.size, dtype=np.bool_)
        if len(gyroscope) and not held.all():
            at, rate, _ = _seconds(gyroscope)
            turning = np.isin(second, at[np.linalg.norm(rate, axis=1) > _TURNING])
        self._without += size[~held & ~turning].tolist()
        self._with_gravity += int(np.count_nonzero(held & calm))

    def _judge_time(self, t: Array) -> None:
        """Refuse stamps that cannot be seconds: of a sensor that gives less than a sample a second."""
        step = float(np.median(np.diff(t))) if t.size > FEWEST else 0.0
        if step > SLOWEST_STEP_S:
            what = f"the time stamps step by {step:.6g}, where a sensor's step by 1 s at most"
            remedy = f'give s, or set unit = "ns", "us" or "ms" {_MAP}; a table of rests needs --format rest'
            raise TraceError(self.path, what, remedy)

    def _judge_size(self, norms: Array) -> None:
        low, middle = np.quantile(norms, (0.05, 0.5))
        description = f"the acceleration is about {middle:.4g} in size where m/s^2 would give 9.8"
        if unit := multiples_of(norms):
            what = f"{description}: it seems to be {unit}"
            raise TraceError(self.path, what, f'give m/s^2, or set unit = "{unit}" {_MAP}')
        if low > 60:
            what = f"{description}: raw counts?"
            remedy = f'say accel_unit (m/s^2 in one count) in NAME.json, or unit = "counts" {_MAP}'
            raise TraceError(self.path, what, remedy)

    def _judge_rates(self) -> None:
        votes = self._votes
        for unit, assumed in (("deg/s", "rad/s"), ("rad/s", "deg/s")):
            if votes[unit] >= _VOTES and votes[unit] > votes["as stated"] + votes["unclear"]:
                what = f"the rates are not {assumed}: gravity's direction turns as if they were {unit}"
                raise TraceError(self.path, what, f'give rad/s, or set unit = "{unit}" {_MAP}')
        self._settled = votes["as stated"] >= _VOTES


def multiples_of(norms: Array) -> str | None:
    """Return the unit, g or mg, that accelerations of sizes `norms` (n,) are in; None for another."""
    low, middle, high = np.quantile(norms, (0.05, 0.5, 0.95))
    for unit, one in (("g", 1.0), ("mg", 1000.0)):
        if 0.7 * one < middle < 1.4 * one and 0.2 * one < low and high < 4 * one:
            return unit
    return None


def shown_unit(turning: Turning) -> str:
    """Return the unit that a stretch shows the rates to have.

    "deg/s" where they were read as rad/s, "rad/s" where they were read as deg/s, else "as stated",
    "unclear", or "silent" where too little turns.
    """
    none, degrees, as_stated, radians = (turning.misfit(k) for k in (0.0, DEGREE, 1.0, 1 / DEGREE))
    least = turning.pairs * _LEAST_TURNING**2
    if as_stated > max(_CLEARLY * degrees, least, _TILT**2 * turning.spread):
        smooth = turning.change < _SMOOTHLY * turning.spread < _SMOOTHLY * _SWUNG * turning.pairs
        swings = smooth and none < _EXPLAINED * degrees
        return "unclear" if swings else "deg/s"
    if as_stated > max(_CLEARLY * radians, least):
        return "rad/s"
    if degrees > max(_CLEARLY * as_stated, least):
        return "as stated"
    return "silent" if max(as_stated, degrees) < least else "unclear"


def _seconds(samples: Samples) -> tuple[Array, Array, Array]:
    """Return the seconds (n,) that samples lie in, their means (n, 3) and their norms' mean squares (n,)."""
    if not len(samples):
        return np.empty(0), np.empty((0, 3)), np.empty(0)
    whole = np.floor(samples.t)
    starts = np.concatenate(([0], np.flatnonzero(whole[1:] != whole[:-1]) + 1))
    count = np.diff(starts, append=len(samples))[:, None]
    mean = np.add.reduceat(samples.xyz, starts) / count
    power = np.add.reduceat(samples.xyz**2, starts) / count
    return whole[starts], mean, power.sum(axis=1)
