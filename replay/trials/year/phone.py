"""A phone that lives for a year and costs little to simulate: laid down, taken up, charged at night.

Between two places it is turned about a horizontal axis in three seconds. Its biases follow temperature, which
follows the day and the season, and wander from day to day. Noise is drawn once and used again from other
places on. The engine needs no more to rest, turn, drift and recalibrate; for its accuracy there is the week.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.phone.simulation import Chunk

HOUR_S, DAY_S, YEAR_DAYS = 3600.0, 86400.0, 365
EVENING_H, MORNING_H = 23, 7
UPTIME_S = 100_000.37
"""How long it has been up when the daemon meets it: no round number, as of any phone."""

TURN_S, HANDLED_S = 3.0, (10.0, 60.0)
SHORTEST_S, LONGEST_S = 120.0, 5400.0
"""How long it lies where it was laid by day; the exponent of the time is drawn evenly."""

FORCE_NOISE, RATE_NOISE, SHAKEN = 0.02, 0.002, 0.5
"""Standard deviations of a sample, m/s^2 and rad/s; m/s^2 while it is in the hand."""

FORCE_SCALE, RATE_SCALE = np.diag([1.012, 0.991, 1.006]), np.diag([0.995, 1.008, 1.003])
FORCE_BIAS, RATE_BIAS = np.array([0.35, -0.25, 0.2]), np.array([0.01, -0.02, 0.005])
FORCE_SLOPE, RATE_SLOPE = np.array([2e-3, -1e-3, 4e-3]), np.array([1e-4, 2e-4, -1e-4])
"""Of the biases, a K."""

FORCE_WANDER, RATE_WANDER = 2e-3, 2e-4
"""Of the biases in a day: a random walk that is drawn back by a hundredth a day."""

_DRAWN_H = 8
"""Hours of noise that are drawn."""


class YearPhone:
    """The phone. rate_hz: of both sensors."""

    def __init__(self, seed: int, rate_hz: float) -> None:
        self._rng = np.random.default_rng(seed)
        self.rate_hz = rate_hz
        self._noise = self._rng.normal(size=(round(_DRAWN_H * HOUR_S * rate_hz), 6))
        self._up = _unit(self._rng)
        self._turn: tuple[Array, Array, float, float] | None = None
        self._until = 0.0
        self._laid_at = 0.0
        self._wander = np.zeros(6)

    def chunks(self, days: int, midnight: Callable[[int], None]) -> Iterator[Chunk]:
        """Yield the phone's life hour by hour. midnight: is told each day that is over."""
        for hour in range(24 * days):
            if hour and hour % 24 == 0:
                midnight(hour // 24)
                self._wander *= 0.99
                self._wander += self._rng.normal(size=6) * ([FORCE_WANDER] * 3 + [RATE_WANDER] * 3)
            events = {EVENING_H: True, MORNING_H: False}
            start, clock = UPTIME_S + hour * HOUR_S, hour % 24
            plugged = (Charging(start, events[clock]),) if clock in events else ()
            yield self._hour(start, plugged, by_night=not MORNING_H <= clock < EVENING_H)

    def _hour(self, start: float, events: tuple[Charging, ...], *, by_night: bool) -> Chunk:
        n = round(HOUR_S * self.rate_hz)
        t = start + np.arange(n) / self.rate_hz
        up, rate, shaken = np.empty((n, 3)), np.zeros((n, 3)), np.zeros(n)
        at = 0
        while at < n:
            if t[at] >= self._until:
                self._take_up(float(t[at]), by_night=by_night)
            stop = int(np.searchsorted(t, self._until))
            part = slice(at, stop)
            up[part], rate[part], shaken[part] = self._moved(t[part])
            at = stop
        season, day = 2 * math.pi * t / (DAY_S * YEAR_DAYS), 2 * math.pi * t / DAY_S
        celsius = 24.0 - 6.0 * np.cos(season) - 3.0 * np.cos(day) + 4.0 * by_night
        first = int(self._rng.integers(len(self._noise) - n))
        noise = self._noise[first : first + n]
        force = STANDARD * up @ FORCE_SCALE + FORCE_BIAS + self._wander[:3]
        force += (celsius - 25.0)[:, None] * FORCE_SLOPE
        force += noise[:, :3] * np.hypot(FORCE_NOISE, shaken)[:, None]
        turning = rate @ RATE_SCALE + RATE_BIAS + self._wander[3:]
        turning += (celsius - 25.0)[:, None] * RATE_SLOPE + noise[:, 3:] * RATE_NOISE
        runs = (
            Samples(sensor, frozen(t), frozen(values), frozen(celsius))
            for sensor, values in ((Sensor.ACCELEROMETER, force), (Sensor.GYROSCOPE, turning))
        )
        accelerometer, gyroscope = runs
        return Chunk(start + HOUR_S, accelerometer, gyroscope, events)

    def _take_up(self, t: float, *, by_night: bool) -> None:
        """Take the phone up at t (s), turn it, and lay it down until `_until`."""
        to = _unit(self._rng)
        axis = np.cross(self._up, to)
        axis /= np.linalg.norm(axis)
        angle = math.acos(float(np.clip(self._up @ to, -1.0, 1.0)))
        held = self._rng.uniform(*HANDLED_S)
        self._turn, self._laid_at = (self._up, axis, angle, t + held / 2), t + held
        lies = math.exp(self._rng.uniform(math.log(SHORTEST_S), math.log(LONGEST_S)))
        self._until = self._laid_at + (LONGEST_S if by_night else lies)
        self._up = to

    def _moved(self, t: Array) -> tuple[Array, Array, Array]:
        """Return up (n, 3), the body's rate (n, 3) rad/s, and how much it is shaken (n,) m/s^2."""
        assert self._turn is not None
        before, axis, angle, begins = self._turn
        share = np.clip((t - begins) / TURN_S, 0.0, 1.0)
        turned = angle * share**2 * (3 - 2 * share)
        across = np.cross(axis, before)
        up = np.cos(turned)[:, None] * before + np.sin(turned)[:, None] * across
        speed = angle * 6 * share * (1 - share) / TURN_S
        return up, -speed[:, None] * axis, np.where(t < self._laid_at, SHAKEN, 0.0)


def _unit(rng: np.random.Generator) -> Array:
    """Return a direction: more often one of six faces, as furniture has it, than any."""
    if rng.random() < 0.7:
        up = np.zeros(3)
        up[rng.integers(3)] = rng.choice([-1.0, 1.0])
        up += rng.normal(size=3) * 0.05
    else:
        up = rng.normal(size=3)
    return np.asarray(up / np.linalg.norm(up))
