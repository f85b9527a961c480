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

from stillcal.calib_core.misfit.bins import Bins

Array = NDArray[np.float64]
FAMILIES = ("white", "flicker", "gm50", "gm300", "gm1500", "walk_weak", "walk_strong", "mixture")
WHITE = {"accel": 0.003, "gyro": 1.5e-4}
G = 9.80665


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


def wander(rng: np.random.Generator, family: str, n: int, white: float) -> Array:
    """Bias wander (n, 3) beside white noise of sd `white` at 1 s."""

    def gm(tau: float, sd: float) -> Array:
        a = np.exp(-1.0 / tau)
        start = rng.normal(size=(1, 3)) * sd
        drive = rng.normal(size=(n, 3)) * sd * np.sqrt(1 - a * a)
        drive[0] = start[0]
        return lfilter([1.0], [1.0, -a], drive, axis=0)

    size = white * 10 ** rng.uniform(-1.0, 0.7)
    if family == "white":
        return np.zeros((n, 3))
    if family == "flicker":
        return pink(rng, n) * size * 0.3
    if family.startswith("gm"):
        return gm(float(family[2:]), size)
    if family.startswith("walk"):
        density = white * (0.003 if family == "walk_weak" else 0.05)
        return np.cumsum(rng.normal(size=(n, 3)) * density, axis=0)
    return (
        pink(rng, n) * size * 0.1
        + gm(200.0, size * 0.3)
        + np.cumsum(rng.normal(size=(n, 3)), axis=0) * size * 0.004
    )


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


def bins_of(
    rng: np.random.Generator, day: Day, family: str, accel_error: Array | None = None,
    gyro_error: Array | None = None, thermometer: bool = True, charger: bool = True, length: float = 18.0,
) -> Bins:  # fmt: skip
    """Average a day into bins. accel_error, gyro_error: (seconds, 3) added to the true readings."""
    n = day.t.size
    zero = np.zeros((n, 3))
    scale = np.eye(3) + rng.normal(0, 0.01, (3, 3))
    force = G * day.up @ scale.T + rng.normal(0, 0.1, 3) + wander(rng, family, n, WHITE["accel"])
    force = force + rng.normal(0, WHITE["accel"], (n, 3)) + (zero if accel_error is None else accel_error)
    rate = (
        rng.normal(0, 0.01, 3) + wander(rng, family, n, WHITE["gyro"]) + rng.normal(0, WHITE["gyro"], (n, 3))
    )
    rate = rate + (zero if gyro_error is None else gyro_error)
    edges, owner = [], []
    for r in range(day.rest.max() + 1):
        rows = np.flatnonzero(day.rest == r)
        if rows.size < 5:
            continue
        cuts = np.linspace(rows[0], rows[-1] + 1, max(1, round(rows.size / length)) + 1).round().astype(int)
        edges += list(pairwise(cuts))
        owner += [r] * (len(cuts) - 1)
    mean = lambda x: np.array([x[a:b].mean(axis=0) for a, b in edges])  # noqa: E731
    duration = np.array([float(b - a) for a, b in edges])
    switches = np.flatnonzero(np.diff(day.charging)) + 1
    return Bins(
        t=np.array([(a + b) / 2 for a, b in edges]), duration=duration, rest=np.array(owner),
        force=mean(force), force_variance=np.repeat(WHITE["accel"] ** 2 / duration[:, None], 3, axis=1),
        vibration=np.ones(len(edges)) + rng.normal(0, 0.01, len(edges)),
        activity=np.stack([day.t, (day.rest < 0).astype(float)], axis=1), span=(0.0, float(n)),
        rate=mean(rate), rate_variance=np.repeat(WHITE["gyro"] ** 2 / duration[:, None], 3, axis=1),
        temperature=mean(day.temperature) if thermometer else None,
        charging=mean(day.charging) if charger else None,
        charging_switches=np.array([[0.0, day.charging[0]], *([float(i), day.charging[i]] for i in switches)])
        if charger else None,
    )  # fmt: skip
