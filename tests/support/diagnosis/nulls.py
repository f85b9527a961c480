"""Simple phones that lie still: bins with noise of known families and, if wanted, an effect.

Written apart from the estimator: noise is made sample by sample (one a second) and averaged, not drawn
from the covariances that the estimator assumes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from stillcal.calib_core.diagnosis.segments.static_bins import Bins

Array = NDArray[np.float64]
FAMILIES = ("white", "flicker", "gm50", "gm300", "gm1500", "walk_weak", "walk_strong", "mixture")
WHITE = {"accel": 0.003, "gyro": 1.5e-4}
G = 9.80665
EARTH = 7.292e-5


@dataclass
class Day:
    """A schedule: seconds, which rest (-1: moving), body gravity, temperature, charger, all per second."""

    t: Array
    rest: NDArray[np.int64]
    up: Array
    temperature: Array
    charging: Array


def pink(rng: np.random.Generator, n: int, m: int = 3) -> Array:
    """Flicker noise by shaping white noise in frequency, unit power at 1 mHz-ish scale; (n, m)."""
    spectrum = np.fft.rfft(rng.normal(size=(2 * n, m)), axis=0)
    f = np.fft.rfftfreq(2 * n, 1.0)
    f[0] = f[1]
    return np.fft.irfft(spectrum / np.sqrt(f)[:, None], n=2 * n, axis=0)[:n] / np.sqrt(2 * np.log(2) * 2)


@dataclass
class Wander:
    """How one sensor's bias wanders: pink: scale of flicker; gm: (tau s, sd) each; walk: per sqrt(s)."""

    pink: float = 0.0
    gm: tuple[tuple[float, float], ...] = ()
    walk: float = 0.0

    def series(self, rng: np.random.Generator, n: int) -> Array:
        """Draw the bias of three axes, second by second (n, 3)."""
        out = pink(rng, n) * self.pink if self.pink else np.zeros((n, 3))
        for tau, sd in self.gm:
            a = np.exp(-1.0 / tau)
            drive = rng.normal(size=(n, 3)) * sd * np.sqrt(1 - a * a)
            drive[0] = rng.normal(size=3) * sd
            out = out + lfilter([1.0], [1.0, -a], drive, axis=0)
        return out + np.cumsum(rng.normal(size=(n, 3)) * self.walk, axis=0) if self.walk else out

    def covariance(self, average: Array) -> Array:
        """Covariance (m, m) of averages (m, n) over the seconds."""
        n = average.shape[1]
        f = np.fft.rfftfreq(2 * n, 1.0)
        f[0] = f[1]
        acf = np.fft.irfft(self.pink**2 / (4 * np.log(2)) / f, n=2 * n)[: n + 1]
        lag = np.arange(n + 1.0)
        acf = acf + sum(sd**2 * np.exp(-lag / tau) for tau, sd in self.gm)
        around = np.fft.rfft(np.concatenate([acf, acf[-2:0:-1]]))
        blurred = np.fft.irfft(np.fft.rfft(average, 2 * n, axis=1) * around, n=2 * n, axis=1)[:, :n]
        summed = np.cumsum(average[:, ::-1], axis=1)[:, ::-1] * self.walk
        return blurred @ average.T + summed @ summed.T


def wander(rng: np.random.Generator, family: str, white: float) -> Wander:
    """Draw how a bias wanders beside white noise of sd `white` at 1 s."""
    size = white * 10 ** rng.uniform(-1.0, 0.7)
    if family == "white":
        return Wander()
    if family == "flicker":
        return Wander(pink=size * 0.3)
    if family.startswith("gm"):
        return Wander(gm=((float(family[2:]), size),))
    if family.startswith("walk"):
        return Wander(walk=white * (0.003 if family == "walk_weak" else 0.05))
    return Wander(size * 0.1, ((200.0, size * 0.3),), size * 0.004)


def schedule(rng: np.random.Generator, seconds: int = 3600) -> Day:
    """Draw a day of one hour: from one long rest to a hundred short ones, thermometer and charger."""
    kind = rng.choice(["one", "few", "many"], p=[0.2, 0.3, 0.5])
    t = np.arange(seconds, dtype=float)
    rest = np.full(seconds, -1)
    up = np.zeros((seconds, 3))
    length = {"one": (seconds, seconds + 1), "few": (300, 900), "many": (25, 120)}[kind]
    faces = random_attitudes(rng, 1 if kind == "one" else int(rng.integers(2, 20)))
    start, index = 0, 0
    while start < seconds:
        stop = min(seconds, start + int(rng.integers(*length)))
        tilt = faces[index % len(faces)] + rng.normal(0, 0.02, 3)
        rest[start:stop] = index
        up[start:stop] = tilt / np.linalg.norm(tilt)
        gap = int(rng.integers(5, 20))
        start, index = stop + gap, index + 1
    charging = (np.sin(2 * np.pi * t / rng.uniform(900, 4000) + rng.uniform(0, 6.28)) > 0).astype(float)
    heat = lfilter([1 / 300], [1, -(1 - 1 / 300)], charging) * rng.uniform(2, 8)
    room = rng.uniform(-2, 2) * (1 - np.exp(-t / rng.uniform(200, 1500)))
    return Day(t, rest, up, 25 + heat + room, charging)


def random_attitudes(rng: np.random.Generator, n: int) -> Array:
    """Return n directions of gravity in the body, the first face up."""
    v = rng.normal(size=(n, 3))
    v[0] = (0, 0, 1)
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def earth(rng: np.random.Generator, day: Day) -> Array:
    """Return the Earth's rate in the body, second by second (n, 3): one latitude, a heading a rest.

    Half of the phones lie again as they lay: with one heading to every attitude.
    """
    latitude = np.arcsin(rng.uniform(-1.0, 1.0))
    aside = rng.normal(size=(day.rest.max() + 2, 3))
    aside = aside[:1] if rng.random() < 0.5 else aside[day.rest]
    horizontal = np.cross(day.up, aside)
    north = horizontal / np.maximum(np.linalg.norm(horizontal, axis=1, keepdims=True), 1e-12)
    return EARTH * (np.sin(latitude) * day.up + np.cos(latitude) * north)


def cut(day: Day, length: float = 18.0) -> tuple[Array, Array, Array]:
    """Cut a day's rests into bins: edges (m, 2) s, the rest (m,) of each, averages (m, n) over seconds."""
    edges: list[tuple[int, int]] = []
    owner: list[int] = []
    for r in range(day.rest.max() + 1):
        rows = np.flatnonzero(day.rest == r)
        if rows.size < 5:
            continue
        cuts = np.linspace(rows[0], rows[-1] + 1, max(1, round(rows.size / length)) + 1).round().astype(int)
        edges += list(pairwise(cuts))
        owner += [r] * (len(cuts) - 1)
    average = np.zeros((len(edges), day.t.size))
    for row, (a, b) in zip(average, edges, strict=True):
        row[a:b] = 1.0 / (b - a)
    return np.array(edges), np.array(owner), average


def bins_of(
    rng: np.random.Generator, day: Day, family: str | dict[str, Wander], accel_error: Array | None = None,
    gyro_error: Array | None = None, thermometer: bool = True, charger: bool = True,
) -> Bins:  # fmt: skip
    """Average a day into bins. accel_error, gyro_error: (seconds, 3) added to the true readings."""
    n = day.t.size
    if isinstance(family, str):
        family = {sensor: wander(rng, family, WHITE[sensor]) for sensor in WHITE}
    scale = np.eye(3) + rng.normal(0, 0.01, (3, 3))
    force = G * day.up @ scale.T + rng.normal(0, 0.1, 3) + family["accel"].series(rng, n)
    force = force + rng.normal(0, WHITE["accel"], (n, 3)) + (0.0 if accel_error is None else accel_error)
    rate = rng.normal(0, 0.01, 3) + family["gyro"].series(rng, n) + rng.normal(0, WHITE["gyro"], (n, 3))
    rate = rate + earth(rng, day) + (0.0 if gyro_error is None else gyro_error)
    edges, owner, average = cut(day)
    duration = np.diff(edges, axis=1)[:, 0].astype(float)
    switches = np.flatnonzero(np.diff(day.charging)) + 1
    return Bins(
        t=edges.mean(axis=1), duration=duration, rest=owner,
        force=average @ force, force_variance=np.repeat(WHITE["accel"] ** 2 / duration[:, None], 3, axis=1),
        vibration=np.ones(len(edges)) + rng.normal(0, 0.01, len(edges)),
        activity=np.stack([day.t, (day.rest < 0).astype(float)], axis=1), span=(0.0, float(n)),
        rate=average @ rate, rate_variance=np.repeat(WHITE["gyro"] ** 2 / duration[:, None], 3, axis=1),
        temperature=average @ day.temperature if thermometer else None,
        charging=average @ day.charging if charger else None,
        charging_switches=np.array([[0.0, day.charging[0]], *([float(i), day.charging[i]] for i in switches)])
        if charger else None,
    )  # fmt: skip
