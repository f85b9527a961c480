"""A simulated recording with the differences that were found put into its samples.

The forward equations are those of `stillcal.replay.phone`'s sensors, written for samples that exist already.
What cannot be put into samples (another rate, less noise) is left out and named.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.compare import Discrepancy
from stillcal.calib_core.streams.resample import interpolate, temperature_at
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.judged import charging_events
from stillcal.replay.formats.trace import Recording

MATRIX_NUMBERS = 9


@dataclass(frozen=True, slots=True, eq=False)
class Corrected:
    """The recording with the differences in it, and the effects that could not be put into samples."""

    recording: Recording
    left_out: list[str]


@dataclass(frozen=True, slots=True, eq=False)
class _Stream:
    """One sensor's samples, which stand for its input, with what its errors follow. force: (n, 3) m/s^2."""

    samples: Samples
    force: Array
    age: Array
    temperature: Array | None
    charging: Array | None


def correct(
    simulation: Recording,
    discrepancies: Sequence[Discrepancy],
    biases: Mapping[str, Array],
    seed: int = 0,
) -> Corrected:
    """Return the simulation's recording with every difference added that samples can take.

    biases: by sensor, (3,) m/s^2 or rad/s, the simulation's own, which a scale does not act on; a sensor that
    is not in it is taken to have none. seed: of the noise that is added where the simulation has too little.
    """
    rng = np.random.default_rng(seed)
    left_out: list[str] = []
    streams: dict[str, Samples | None] = {
        "accel": simulation.accelerometer,
        "gyro": simulation.gyroscope,
    }
    # A scale acts on what the simulation's sensor read, hence before anything is added to that.
    for one in sorted(discrepancies, key=lambda d: not d.effect.endswith("_scale")):
        samples = streams.get(one.sensor)
        added = None if samples is None else _added(simulation, samples, one, biases, rng)
        if samples is None or added is None:
            left_out.append(one.effect)
        else:
            streams[one.sensor] = replace(samples, xyz=frozen(samples.xyz + added))
    accelerometer = streams["accel"]
    assert accelerometer is not None, "every recording has an accelerometer"
    return Corrected(replace(simulation, accelerometer=accelerometer, gyroscope=streams["gyro"]), left_out)


def _added(
    simulation: Recording,
    samples: Samples,
    one: Discrepancy,
    biases: Mapping[str, Array],
    rng: np.random.Generator,
) -> Array | None:
    """Return what a difference adds to the samples, (n, 3); None where it cannot be added."""
    if one.difference is None:
        return None
    if one.effect == "noise_level":
        return _noise(samples, one, rng)
    kind = one.effect.partition("_")[2]
    if kind == "scale":
        return _scale(samples.xyz - biases.get(one.sensor, np.zeros(3)), one)
    if one.effect.startswith(("accel_", "gyro_")) and kind in TERMS:
        return TERMS[kind](_stream(simulation, samples), one)
    return None


def _stream(simulation: Recording, samples: Samples) -> _Stream:
    accel = simulation.accelerometer
    plugs = charging_events(simulation)
    states = np.array([0.0, *(float(e.on) for e in plugs)])
    charging = states[np.searchsorted([e.t for e in plugs], samples.t, side="right")] if plugs else None
    force = interpolate(samples.t, accel.t, accel.xyz)
    return _Stream(samples, force, samples.t - samples.t[0], temperature_at(accel, samples.t), charging)


def _part(one: Discrepancy, name: str) -> Array:
    """Return the difference of one named parameter, recorded less simulated."""
    assert one.difference is not None, "only differences have parameters to add"
    first = 0
    for part in one.difference.recorded.parts:
        if part.name == name:
            return np.asarray(one.difference.value[first : first + part.count])
        first += part.count
    return np.zeros(3)


def _bias(stream: _Stream, one: Discrepancy) -> Array:
    return np.broadcast_to(_part(one, "bias"), stream.samples.xyz.shape)


def _scale(unbiased: Array, one: Discrepancy) -> Array:
    """Return the change of the readings (n, 3) when the correction's matrix becomes the recording's.

    A reading without its bias is inv(C) x, with the true x and the correction's matrix C: the simulation's
    becomes inv(C_recorded) C_simulated times what it was.
    """
    assert one.difference is not None, "only differences are added"
    recorded, simulated = (_matrix(q.value) for q in (one.difference.recorded, one.difference.simulated))
    change = np.linalg.solve(recorded, simulated) - np.eye(3)
    return np.asarray(unbiased @ change.T)


def _matrix(value: Array) -> Array:
    """Return a correction's matrix from nine numbers less unity, or three scales and xy, xz, yz."""
    if value.size == MATRIX_NUMBERS:
        return np.asarray(np.eye(3) + value.reshape(3, 3))
    out = np.diag(1.0 + value[:3])
    for x, (a, b) in zip(value[3:], ((0, 1), (0, 2), (1, 2)), strict=True):
        out[a, b] = out[b, a] = x
    return np.asarray(out)


def _bias_temperature(stream: _Stream, one: Discrepancy) -> Array | None:
    if stream.temperature is None:
        return None
    return np.outer(stream.temperature - _reference(stream, one), _part(one, "slope"))


def _scale_temperature(stream: _Stream, one: Discrepancy) -> Array | None:
    if stream.temperature is None:
        return None
    warmer = (stream.temperature - _reference(stream, one))[:, None]
    return np.asarray(stream.samples.xyz * warmer * _part(one, "slope"))


def _reference(stream: _Stream, one: Discrepancy) -> float:
    assert one.difference is not None and stream.temperature is not None, "asked for where both are known"
    return float(one.difference.recorded.reference.get("temperature_c", stream.temperature.mean()))


def _warmup(stream: _Stream, one: Discrepancy) -> Array | None:
    assert one.difference is not None, "only differences are added"
    tau = one.difference.recorded.reference.get("tau_s")
    return None if tau is None else np.outer(-np.expm1(-stream.age / tau), _part(one, "amplitude"))


def _drift(stream: _Stream, one: Discrepancy) -> Array:
    return np.outer(stream.age, _part(one, "rate"))


def _charging(stream: _Stream, one: Discrepancy) -> Array | None:
    return None if stream.charging is None else np.outer(stream.charging, _part(one, "step"))


def _g_sensitivity(stream: _Stream, one: Discrepancy) -> Array:
    return np.asarray(stream.force @ _part(one, "matrix").reshape(3, 3).T)


def _nonlinearity(stream: _Stream, one: Discrepancy) -> Array:
    return np.asarray(
        stream.samples.xyz**2 * _part(one, "quadratic") + stream.samples.xyz**3 * _part(one, "cubic")
    )


TERMS: dict[str, Callable[[_Stream, Discrepancy], Array | None]] = {
    "bias": _bias,
    "bias_temperature": _bias_temperature,
    "scale_temperature": _scale_temperature,
    "warmup": _warmup,
    "bias_drift": _drift,
    "charging_bias": _charging,
    "g_sensitivity": _g_sensitivity,
    "nonlinearity": _nonlinearity,
}
"""What a difference adds to the samples, by the effect's name without its sensor."""


def _noise(samples: Samples, one: Discrepancy, rng: np.random.Generator) -> Array | None:
    """Return white noise of the power that is missing; None where the simulation has too much of it.

    Samples at f Hz with a one-sided density d have a standard deviation of d sqrt(f / 2).
    """
    assert one.difference is not None, "noise is compared as a density"
    recorded, simulated = np.exp(one.difference.recorded.value), np.exp(one.difference.simulated.value)
    missing = recorded**2 - simulated**2
    if (missing < 0.0).any():
        return None
    rate = (len(samples) - 1) / float(samples.t[-1] - samples.t[0])
    return np.asarray(rng.normal(size=samples.xyz.shape) * np.sqrt(missing * rate / 2.0))
