"""A simulated recording with the differences that were found put into its samples.

What an effect adds is its response in the catalogue, at samples that exist already.
What cannot be put into samples (another rate, less noise) is left out and named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.compare import Discrepancy
from stillcal.calib_core.diagnosis.comparison.quantity import Difference
from stillcal.calib_core.diagnosis.diagnose import still_bins
from stillcal.calib_core.diagnosis.effects.catalogue import named_effects
from stillcal.calib_core.diagnosis.model.moments import History, Moments
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
    if kind == "bias":
        return np.asarray(np.broadcast_to(one.difference.value, samples.xyz.shape))
    return _by_physics(simulation, samples, one.difference)


def _by_physics(simulation: Recording, samples: Samples, difference: Difference) -> Array | None:
    """Return the response of an effect of the catalogue to the differing parameters; None without drivers."""
    recorded = difference.recorded
    names = tuple(part.name for part in recorded.parts)
    for effect in named_effects():
        own = (effect.name, effect.sensor, tuple(p.name for p in effect.parameters))
        if own != (recorded.effect, recorded.sensor, names):
            continue
        grid = dict(recorded.reference)
        drivers = _drivers(simulation, samples, grid.get("temperature_c"))
        if not effect.can_play(drivers, grid):
            return None
        return np.asarray(effect.response(drivers, grid) @ difference.value)
    return None


def _drivers(simulation: Recording, samples: Samples, reference_c: float | None) -> Moments:
    """Return what drives effects at a sensor's samples; its own samples stand for its true input."""
    accel, gyro = simulation.accelerometer, simulation.gyroscope
    plugs = charging_events(simulation)
    states = np.array([0.0, *(float(e.on) for e in plugs)])
    warm = temperature_at(accel, samples.t)
    reference = reference_c
    if warm is not None:
        reference = float(warm.mean()) if reference is None else reference
        warm = np.asarray(warm - reference)
    span = (float(samples.t[0]), float(samples.t[-1]))
    switches = np.array([[e.t, float(e.on)] for e in plugs]) if plugs else None
    return Moments(
        samples.t,
        np.zeros(len(samples)),
        History(span, still_bins(accel, gyro, plugs).activity, switches, reference),
        interpolate(samples.t, accel.t, accel.xyz),
        interpolate(samples.t, gyro.t, gyro.xyz) if gyro else None,
        warm,
        states[np.searchsorted([e.t for e in plugs], samples.t, side="right")] if plugs else None,
    )


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
