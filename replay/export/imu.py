"""What is known of an inertial sensor, independent of any file format: the input and output of every target.

The model is the store's: calibrated = scale @ (raw - bias - slope (T - T_ref) - matrix @ force), less what
terms add that follow the reading itself, in SI units and the axes of the recording (Android's: x right, y up,
z out of the screen). A field that is None is not known; a target that does not hold it leaves it so when it
is read back.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.bias_temperature import POWER_NAMES, followed_between
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.calibration.record import CalibrationRecord, SensorRecord
from stillcal.calib_core.noise.allan import FLOOR
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.export.of_reading import is_of_reading
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.settings import SensorSettings, per_axis

SENSORS = ("accelerometer", "gyroscope")

CORRECTION = ("scale", "misalignment", "bias", "bias slope", "bias curve", "g-sensitivity")
"""Kinds of facts that correct samples; the others are noise, rate and delay."""

LAG_S = 100.0
"""s: slow noise of any kind becomes the random walk of the same Allan deviation at this averaging time.

Rests last some minutes, so this is where a recording shows slow noise best."""

ALIKE = 1e-3
"""Relative spread of three densities below which one number stands for all axes."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SensorNoise:
    """Noise of one sensor, by axis.

    white: (3,) one-sided density, unit/sqrt(Hz); samples at f Hz then have a standard deviation of
    white sqrt(f / 2). random_walk: (3,) unit/sqrt(s). flicker: (3,) bias instability of IEEE Std 952, unit.
    gauss_markov: pairs of a standard deviation (3,), unit, and a correlation time, s. rate_hz: of samples.
    """

    white: Array
    rate_hz: float
    random_walk: Array = field(default_factory=lambda: np.zeros(3))
    flicker: Array = field(default_factory=lambda: np.zeros(3))
    gauss_markov: tuple[tuple[Array, float], ...] = ()

    @property
    def two_sided(self) -> Array:
        """The density (3,) by which samples at f Hz have a standard deviation of density sqrt(f)."""
        return np.asarray(self.white / np.sqrt(2.0))

    @property
    def sample_sd(self) -> Array:
        """Standard deviation (3,) of white noise in one sample."""
        return np.asarray(self.white * np.sqrt(self.rate_hz / 2.0))

    @property
    def slow(self) -> bool:
        """Whether there is any noise that averaging does not remove."""
        return bool(
            self.random_walk.any() or self.flicker.any() or any(s.any() for s, _ in self.gauss_markov)
        )

    def slow_deviation(self, lag: float = LAG_S) -> Array:
        """Return the Allan deviation (3,) of all slow noise, without the white, at the time `lag`, s.

        Allan variances by IEEE Std 952-1997, Annex C: K^2 tau / 3 of a random walk, B^2 2 ln 2 / pi of
        flicker noise (C.16), and that of a first-order Gauss-Markov process.
        """
        variance = self.random_walk**2 * lag / 3.0 + (FLOOR * self.flicker) ** 2
        for sigma, tau in self.gauss_markov:
            variance = variance + sigma**2 * gauss_markov_allan(tau, lag)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def walk_alike(self, lag: float = LAG_S) -> Array:
        """Return the random walk (3,), unit/sqrt(s), with the Allan deviation of all slow noise at `lag`."""
        return np.asarray(self.slow_deviation(lag) * np.sqrt(3.0 / lag))


def gauss_markov_allan(tau: float | Array, lag: float = LAG_S) -> Array:
    """Return the Allan variance at `lag` s of a Gauss-Markov process of unit variance; tau: its time, s.

    IEEE Std 952-1997, Annex C, C.1.6.
    """
    x = lag / np.asarray(tau, dtype=np.float64)
    exact = (2.0 / x) * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x))
    # With a much longer time it is as good as a random walk, and the exact form loses its digits.
    return np.asarray(np.where(x < 1e-3, 2.0 * x / 3.0 - x**2 / 2.0, exact))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SensorPart:
    """One sensor. scale: (3, 3). bias: (3,) in m/s^2 or rad/s, at reference_c where that is known.

    slope, quadratic, cubic: (3,) bias per K, K^2 and K^3 from reference_c. limits: degC, beyond which the
    curve stays as it is, None where it goes on. matrix: (3, 3) (rad/s)/(m/s^2), the gyroscope's only: its
    reading per true force. terms: those that follow what an axis reads (of_reading.py). by_axis: whether the
    file holds of the scale what is on its diagonal only.
    """

    scale: Array | None = None
    bias: Array | None = None
    slope: Array | None = None
    quadratic: Array | None = None
    cubic: Array | None = None
    reference_c: float | None = None
    limits: tuple[float, float] | None = None
    matrix: Array | None = None
    terms: tuple[Term, ...] = ()
    noise: SensorNoise | None = None
    by_axis: bool = False

    @property
    def gain(self) -> Array:
        """The forward matrix (3, 3): raw = gain @ true + bias."""
        return np.eye(3) if self.scale is None else np.asarray(np.linalg.inv(self.scale))

    @property
    def crossed(self) -> Array:
        """What is off the diagonal of the scale, (3, 3), zeros where that is not known."""
        return np.zeros((3, 3)) if self.scale is None else self.scale - np.diag(np.diag(self.scale))

    @property
    def offset(self) -> Array:
        """The bias (3,), zeros where it is not known."""
        return np.zeros(3) if self.bias is None else self.bias

    def bias_at(self, temperature: float) -> Array:
        """Return the bias (3,) at a temperature, degC."""
        if self.reference_c is None:
            return self.offset
        held = temperature if self.limits is None else np.clip(temperature, *self.limits)
        warmer = float(held) - self.reference_c
        curve = sum(c * warmer**power for power, c in enumerate(self.powers, start=1))
        return np.asarray(self.offset + curve)

    @property
    def powers(self) -> Array:
        """The curve's coefficients of K, K^2 and K^3, (3, 3), a row each."""
        known = (self.slope, self.quadratic, self.cubic)
        return np.array([np.zeros(3) if c is None else c for c in known])

    @property
    def bent(self) -> bool:
        """Whether the bias follows temperature by more than a straight line."""
        return bool(self.powers[1:].any())


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ImuParameters:
    """Both sensors.

    delay_s: s, by which the gyroscope is late; None where unknown. other: what else the store holds, by name.
    """

    accelerometer: SensorPart | None = None
    gyroscope: SensorPart | None = None
    delay_s: float | None = None
    device: str = ""
    identity: str = ""
    other: tuple[tuple[str, str], ...] = ()

    def parts(self) -> Iterator[tuple[str, SensorPart]]:
        """Yield the name and the part of each sensor that is there."""
        for name, part in zip(SENSORS, (self.accelerometer, self.gyroscope), strict=True):
            if part is not None:
                yield name, part

    def named(self, *kinds: str) -> set[str]:
        """Return the facts of these kinds for each sensor that is there, such as "gyroscope bias"."""
        return {f"{name} {kind}" for name, _ in self.parts() for kind in kinds}

    def of_reading(self) -> set[str]:
        """Return the facts that are terms which follow what an axis reads."""
        return {term.effect for _, part in self.parts() for term in part.terms}

    @property
    def rate_hz(self) -> float | None:
        """The sample rate, Hz, where noise is known."""
        return next((part.noise.rate_hz for _, part in self.parts() if part.noise is not None), None)


def of_record(record: CalibrationRecord, phone: Phone | None = None) -> ImuParameters:
    """Return a stored calibration, with the noise of a phone file where one is given."""
    parts = {}
    for sensor, name in zip((Sensor.ACCELEROMETER, Sensor.GYROSCOPE), SENSORS, strict=True):
        stored = record.accelerometer if sensor is Sensor.ACCELEROMETER else record.gyroscope
        settings = None if phone is None else phone.sensor(sensor)
        if stored is not None or settings is not None:
            part = SensorPart() if stored is None else _of_sensor(record, stored, sensor)
            parts[name] = part if settings is None else replace(part, noise=noise_of(settings))
    delay = None if phone is None else phone.effective_clock().gyro_delay_s
    return ImuParameters(
        accelerometer=parts.get("accelerometer"),
        gyroscope=parts.get("gyroscope"),
        delay_s=delay or None,
        device=record.provenance.device,
        identity=record.id,
        other=tuple(_other(record)),
    )


_BIAS_CURVE, _BY_FORCE = "_bias_temperature", "gyro_g_sensitivity"
"""Terms that some target has a place for: the end of their names, or the name."""


def _stored(record: CalibrationRecord) -> Iterator[tuple[str, SensorRecord]]:
    for name, stored in zip(SENSORS, (record.accelerometer, record.gyroscope), strict=True):
        if stored is not None:
            yield name, stored


def _of_sensor(record: CalibrationRecord, stored: SensorRecord, sensor: Sensor) -> SensorPart:
    part = SensorPart(scale=np.asarray(stored.scale), bias=np.asarray(stored.bias))
    for term in record.terms:
        if term.sensor == sensor and term.effect.endswith(_BIAS_CURVE):
            part = replace(part, **_curve(term))
        elif term.sensor == sensor and term.effect == _BY_FORCE:
            part = replace(part, matrix=np.asarray(term.parameters["matrix"].value))
        elif term.sensor == sensor and is_of_reading(term):
            part = replace(part, terms=(*part.terms, term))
    return part


def _other(record: CalibrationRecord) -> Iterator[tuple[str, str]]:
    """Yield what a store holds and no target does, by name."""
    for name, stored in _stored(record):
        if stored.covariance is not None:
            yield f"{name} uncertainties", "the covariance of its parameters"
    for sensor in record.forecast:
        yield f"{sensor} forecast", "how uncertain its bias is at other times and temperatures"
    for term in record.terms:
        if not has_place(term):
            yield term.effect, _words(term)


def has_place(term: Term) -> bool:
    """Tell whether some target holds a term; what no target holds is named by all of them."""
    return can_be_read(term) or is_of_reading(term)


def can_be_read(term: Term) -> bool:
    """Tell whether a term comes back from some target's file."""
    return term.effect.endswith((_BIAS_CURVE, _BY_FORCE))


def _words(term: Term) -> str:
    return ", ".join(f"{k} {numbers(p.value)} {p.unit}" for k, p in term.parameters.items())


def _curve(term: Term) -> dict[str, Any]:
    """Return a temperature term as fields of a part."""
    out: dict[str, Any] = {
        name: np.asarray(p.value) for name, p in term.parameters.items() if name in POWER_NAMES
    }
    low, high = (term.reference.get(f"temperature_{end}") for end in ("min", "max"))
    limits = None if low is None or high is None else followed_between(low, high)
    return out | {"reference_c": term.reference["temperature"], "limits": limits}


def noise_of(settings: SensorSettings) -> SensorNoise:
    """Return the noise of a phone file's sensor; samples that lie in heavy tails count by their power."""
    noise = settings.noise
    tails = 1.0 + noise.tail_fraction * (noise.tail_ratio**2 - 1.0)
    return SensorNoise(
        white=per_axis(noise.white) * np.sqrt(tails),
        rate_hz=settings.rate_hz,
        random_walk=per_axis(noise.random_walk),
        flicker=per_axis(noise.flicker),
        gauss_markov=tuple((per_axis(g.sigma), g.tau_s) for g in noise.gauss_markov),
    )


def facts(imu: ImuParameters) -> dict[str, str]:
    """Return everything that is known, by name, each with its numbers: what a target may or may not hold."""
    out: dict[str, str] = {}
    for name, part in imu.parts():
        unit = "m/s^2" if name == "accelerometer" else "rad/s"
        if part.scale is not None:
            out[f"{name} scale"] = numbers(np.diag(part.scale))
            if part.crossed.any():
                out[f"{name} misalignment"] = f"off the diagonal of its scale, {numbers(part.crossed)}"
        if part.bias is not None:
            out[f"{name} bias"] = f"{numbers(part.bias)} {unit}"
        if part.slope is not None:
            out[f"{name} bias slope"] = f"{numbers(part.slope)} {unit}/K from {part.reference_c!r} degC"
        if part.bent:
            bends = f"{numbers(part.powers[1])} {unit}/K^2, {numbers(part.powers[2])} {unit}/K^3"
            out[f"{name} bias curve"] = f"{bends} from {part.reference_c!r} degC"
        if part.matrix is not None:
            out[f"{name} g-sensitivity"] = f"{numbers(part.matrix)} (rad/s)/(m/s^2)"
        out |= {term.effect: _words(term) for term in part.terms}
        out |= _noise_facts(name, part.noise, unit)
    if imu.delay_s is not None:
        out["gyroscope delay"] = f"{imu.delay_s!r} s"
    return out | dict(imu.other)


def _noise_facts(name: str, noise: SensorNoise | None, unit: str) -> dict[str, str]:
    if noise is None:
        return {}
    out = {f"{name} white noise": f"{numbers(noise.white)} {unit}/sqrt(Hz), one-sided density"}
    if noise.slow:
        out[f"{name} slow noise"] = (
            f"as a random walk of {numbers(noise.walk_alike())} {unit}/sqrt(s), which has the same Allan"
            f" deviation at {LAG_S:g} s"
        )
    return out


def numbers(values: Array) -> str:
    """Return numbers as a list whose members read back to the last bit."""
    return repr(np.asarray(values, dtype=np.float64).tolist())


def limits_of(low: float | None, high: float | None, wide: tuple[float, float]) -> tuple[float, float] | None:
    """Return the limits that a file states; None where it states none, or those that mean none."""
    return None if low is None or high is None or (low, high) == wide or low >= high else (low, high)


def spread(values: Array) -> bool:
    """Whether three densities are too different for one number to stand for them."""
    return bool(np.ptp(values) > ALIKE * np.max(np.abs(values), initial=0.0))
