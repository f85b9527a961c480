"""Simulated people and phones for item 7, whose bias is known at any moment.

The bias is drawn as one table of time, by this module alone: it shares no formula with the estimators, and
none with the noise of `replay.phone`. The simulated phone adds the table to its samples; the same table is
the truth. The spreads are assumed, of the order that data sheets and users state for phones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone import Phone, Scenario, Simulation, load_scenario, simulate
from stillcal.replay.phone.effects.base import OnEither
from stillcal.replay.phone.settings import ClockSettings, HeatSettings, Noise, SensorSettings

MG = 9.80665e-3
GRID_S = 10.0
RATE_HZ = 25.0
FLICKER_TAUS_S = tuple(16.0 * 4.0**k for k in range(7))
"""Correlation times of the flicker: two a decade, 16 s to 18 h, each of the same variance."""

PER_PROCESS = np.sqrt(np.log(4.0) / np.pi)
"""Standard deviation of each process, of the bias instability (IEEE Std 952-1997, Annex C)."""

TEMPCO = {Sensor.ACCELEROMETER: (0.2 * MG, 0.9 * MG), Sensor.GYROSCOPE: np.radians((0.005, 0.03))}
"""Length of the bias' slope with temperature: m/s^2/K, rad/s/K."""

FLICKER = {Sensor.ACCELEROMETER: (0.02 * MG, 0.06 * MG), Sensor.GYROSCOPE: np.radians((2, 8)) / 3600}
"""Bias instability, m/s^2 and rad/s."""

WALK = {Sensor.ACCELEROMETER: (0.02 * MG, 0.2 * MG), Sensor.GYROSCOPE: np.radians((0.001, 0.01))}
"""Random walk of a day, m/s^2 and rad/s."""

KNOCK = {Sensor.ACCELEROMETER: 3 * MG, Sensor.GYROSCOPE: np.radians(0.05)}
"""Standard deviation by axis of the step that a knock leaves."""

THERMOMETERS_K = (0.01, 0.1, 0.5, 1.0)
"""Steps of a thermometer, K, equally common."""


class TrueBias(OnEither, frozen=True, kw_only=True, tag="true_bias"):
    """A sensor's bias by time: added to its samples. table: sensor -> (n, 3) every GRID_S from 0 on."""

    table: Any

    def output_term(self, sensor: Sensor, circumstances: Any) -> Any:
        """Return the term that reads the table."""
        return lambda moment: read(self.table[sensor], moment.t)


@dataclass(frozen=True, slots=True)
class Sizes:
    """How large what moves a bias is. slope: (3,) per K, at 25 degC. flicker, walk: as FLICKER and WALK."""

    slope: Array
    flicker: float
    walk: float


@dataclass(frozen=True, slots=True)
class Life:
    """One person's days with one phone. bias: sensor -> (n, 3) every GRID_S, all of the true bias.

    sizes: what the bias was drawn with. kinds: what is special about the phone, in words.
    """

    simulation: Simulation
    bias: dict[Sensor, Array]
    sizes: dict[Sensor, Sizes]
    kinds: tuple[str, ...]

    def bias_at(self, sensor: Sensor, t: float) -> Array:
        """Return the true bias (3,) at t, s."""
        return read(self.bias[sensor], np.array([t]))[0]

    def forward(self, sensor: Sensor) -> Array:
        """Return the true matrix: raw = forward @ true + bias."""
        settings = self.simulation.phone.sensor(sensor)
        assert settings is not None
        return np.asarray(settings.scale)


def read(table: Array, t: Array) -> Array:
    """Return a table's values at times (n,) s, between its rows as a straight line."""
    place = np.clip(t / GRID_S, 0.0, len(table) - 1.001)
    row = place.astype(int)
    share = (place - row)[:, None]
    return table[row] * (1 - share) + table[row + 1] * share


def live(number: int, seed: int, days: float) -> Life:
    """Draw one life. number, seed: it depends on nothing else but the days."""
    rng = np.random.default_rng([seed, number])
    scenario = _scenario(rng, days)
    heat = HeatSettings(
        use_k=rng.uniform(5, 10),
        charge_k=rng.uniform(4, 12),
        fast_tau_s=rng.uniform(60, 150),
        slow_tau_s=rng.uniform(800, 1800),
        thermometer_lsb_c=float(rng.choice(THERMOMETERS_K)),
        thermometer_noise_c=0.02,
    )
    n = int(days * 86400 / GRID_S) + 10
    t = np.arange(n) * GRID_S
    celsius = simulate(scenario, Phone(heat=heat), number).temperature_at(t)
    curved, lagging, knocked = rng.random() < 1 / 3, rng.random() < 1 / 3, rng.random() < 1 / 2
    kinds = [f"thermometer {heat.thermometer_lsb_c:g} K"]
    kinds += [word for word, is_so in (("curved", curved), ("lag", lagging), ("knock", knocked)) if is_so]
    felt = _lagged(celsius, rng.uniform(60, 600)) if lagging else celsius
    knock_row = int(rng.uniform(0.2, 0.9) * n) if knocked else n
    bias, sizes = {}, {}
    for sensor, offset in ((Sensor.ACCELEROMETER, 0.03 * 9.8), (Sensor.GYROSCOPE, np.radians(1.0))):
        constant = offset * rng.standard_normal(3)
        thermal, slope = _thermal(felt - 25.0, TEMPCO[sensor], curved, rng)
        slow, flicker, walk = _slow(n, FLICKER[sensor], WALK[sensor], rng)
        table, sizes[sensor] = constant + thermal + slow, Sizes(slope, flicker, walk)
        table[knock_row:] += KNOCK[sensor] * rng.standard_normal(3)
        bias[sensor] = table
    phone = Phone(
        description=f"phone {number}",
        accel=_sensor(rng, 0.00147, 0.0012, 39.2266),
        gyro=_sensor(rng, 0.000122, 0.00107, 34.9),
        clock=ClockSettings(shared=True, jitter_s=1e-4, latency_s=0.002, latency_jitter_s=0.001),
        heat=heat,
        effects=(TrueBias(table=bias),),
    )
    return Life(simulate(scenario, phone, number), bias, sizes, tuple(kinds))


def _scenario(rng: np.random.Generator, days: float) -> Scenario:
    """Return the week of config/scenarios in a climate, and with rooms, of its own."""
    week, season = load_scenario("week"), rng.normal(0.0, 3.0)
    segments = tuple(
        s
        if s.ambient_c is None
        else msgspec.structs.replace(s, ambient_c=s.ambient_c + season + rng.normal(0.0, 1.5))
        for s in week.segments
    )
    return msgspec.structs.replace(
        week, segments=segments, duration_s=days * 86400.0, ambient_c=week.ambient_c + season
    )


def _sensor(rng: np.random.Generator, white: float, lsb: float, reach: float) -> SensorSettings:
    scale = np.eye(3) + np.diag(0.01 * rng.standard_normal(3))
    scale += 0.004 * rng.standard_normal((3, 3)) * (1 - np.eye(3))
    return SensorSettings(
        rate_hz=RATE_HZ, scale=scale.tolist(), noise=Noise(white=white), lsb=lsb, range=reach
    )


def _thermal(warmth: Array, tempco: Any, curved: bool, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a bias (n, 3) by warmth (n,), K, and its slope, (3,) per K.

    It is straight, or bent by about half of its rise in 20 K.
    """
    direction = rng.standard_normal(3)
    slope = rng.uniform(*tempco) * direction / np.linalg.norm(direction)
    u = warmth / 20.0
    bend = np.outer(u**2, 0.5 * rng.standard_normal(3)) + np.outer(u**3, 0.2 * rng.standard_normal(3))
    return np.outer(warmth, slope) + (20.0 * np.linalg.norm(slope) * bend if curved else 0.0), slope


def _slow(n: int, flicker: Any, walk: Any, rng: np.random.Generator) -> tuple[Array, float, float]:
    """Return flicker (IEEE Std 952-1997, Annex C: B^2 ln r / pi a process) and a random walk, (n, 3).

    With it what their sizes are.
    """
    from scipy.signal import lfilter  # noqa: PLC0415 - the engine's processes do without

    instability, of_a_day = rng.uniform(*flicker), rng.uniform(*walk)
    sigma = instability * PER_PROCESS
    total = np.cumsum(of_a_day * np.sqrt(GRID_S / 86400.0) * rng.standard_normal((n, 3)), axis=0)
    for tau in FLICKER_TAUS_S:
        keep = np.exp(-GRID_S / tau)
        shocks = rng.standard_normal((n, 3)) * sigma * np.sqrt(1 - keep**2)
        shocks[0] = sigma * rng.standard_normal(3)
        total += lfilter([1.0], [1.0, -keep], shocks, axis=0)
    return total, instability, of_a_day


def _lagged(values: Array, tau: float) -> Array:
    from scipy.signal import lfilter  # noqa: PLC0415

    keep = np.exp(-GRID_S / tau)
    return lfilter([1 - keep], [1.0, -keep], values, zi=[keep * values[0]])[0]
