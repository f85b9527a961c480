"""Effects injected into real recordings: what the readings, or stamps, would have been with them.

Slow effects are the examiner's own forward equations (stillcal.replay.blind_test.world.forward_model),
played on the recording's readings in place of the unknown truth, which is wrong by the readings' own
errors, a few per cent of the effect. Where an effect needs a plug, the switching is invented along with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.segments.value_grid import comb_step
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.resample import interpolate
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.blind_test.world.day import World
from stillcal.replay.blind_test.world.forward_model import FORWARD, played, sensor_of
from stillcal.replay.blind_test.world.phones import low_passed
from stillcal.replay.formats.trace import Recording

STRENGTHS = (1.0 / 3.0, 1.0, 3.0)
"""Parts of the sizes below; shares of samples and cutoffs are scaled likewise."""

PLUGS = (0.15, 0.3, 0.5, 0.6, 0.8)
"""Where in the recording the plug goes in and out, as parts of its span."""

_UNEVEN = np.array([1.0, -0.7, 0.0])
"""Slow effects act on two axes, not alike, and spare the third."""


@dataclass(frozen=True, slots=True)
class Injection:
    """An effect at its middle size. needs: of a recording, `gyroscope`, `temperature` or `attitudes`."""

    effect: str
    parameters: dict[str, Any]
    needs: tuple[str, ...] = ()


SLOW = (
    Injection("accel_bias_temperature", {"slope": 5e-3}, ("temperature",)),
    Injection("gyro_bias_temperature", {"slope": 1.7e-4}, ("temperature", "gyroscope")),
    Injection("accel_warmup", {"amplitude": 2e-2, "tau_s": 60.0}),
    Injection("gyro_warmup", {"amplitude": 2e-3, "tau_s": 60.0}, ("gyroscope",)),
    Injection("accel_bias_step", {"step": 3e-2, "at_s": 0.55}),
    Injection("gyro_bias_step", {"step": 3e-3, "at_s": 0.55}, ("gyroscope",)),
    Injection("accel_charging_bias", {"step": 2e-2}),
    Injection("gyro_charging_bias", {"step": 1e-3}, ("gyroscope",)),
    Injection("accel_nonlinearity", {"quadratic": 3e-4}, ("attitudes",)),
    Injection("gyro_g_sensitivity", {"matrix": 1.8e-4}, ("gyroscope", "attitudes")),
)
"""Slow effects; one number stands for the axes' (x, -0.7 x, 0), for a matrix its scale."""

DIRECT = (
    Injection("noise_unequal_axes", {"ratio": 2.0}),
    Injection("noise_heavy_tailed", {"ratio": 5.0}),
    Injection("vibration_tone", {"amplitude": 0.05}),
    Injection("accel_quantisation", {"step": 0.1}),
    Injection("gyro_quantisation", {"step": 0.01}, ("gyroscope",)),
    Injection("accel_saturation", {"fraction": 3e-3}, ("attitudes",)),
    Injection("gyro_saturation", {"fraction": 3e-3}, ("gyroscope", "attitudes")),
    Injection("bandwidth", {"cutoff": 0.15}),
    Injection("timestamp_jitter", {"sigma": 0.2}),
    Injection("dropped_samples", {"fraction": 0.02}),
    Injection("accel_gyro_time_offset", {"delay": 0.03}, ("gyroscope", "attitudes")),
)
"""Effects on samples and stamps; cutoff and sigma are parts of the rate and of the period."""


def injected(recording: Recording, what: Injection, strength: float, seed: int) -> tuple[Recording, Any]:
    """Return a recording with an effect in it, and the main parameter's true value."""
    if what.effect in FORWARD:
        return _slow(recording, what, strength)
    size = float(next(iter(what.parameters.values())))
    return _DIRECT[what.effect](recording, size, strength, np.random.default_rng(seed))


def control(recording: Recording, what: Injection) -> Recording:
    """Return the untouched twin: the same recording, with the same invented switching of a plug."""
    if not what.effect.endswith("charging_bias"):
        return recording
    t = recording.accelerometer.t
    plugs = [Charging(e.t + float(t[0]), e.on) for e in _switches(float(t[-1] - t[0]))]
    return replace(recording, events=[*recording.events, *plugs])


def supports(recording: Recording, what: Injection) -> bool:
    """Whether a recording has what an effect needs: without a driver there is nothing to inject."""
    has = {
        "gyroscope": recording.gyroscope is not None,
        "temperature": recording.accelerometer.temperature is not None,
        "attitudes": float(np.ptp(recording.accelerometer.xyz, axis=0).min()) > 10.0,
    }
    return all(has[need] for need in what.needs)


def _slow(recording: Recording, what: Injection, strength: float) -> tuple[Recording, Any]:
    sensor = sensor_of(what.effect)
    samples = _of(recording, sensor)
    span = samples.t[-1] - samples.t[0]
    name = next(iter(what.parameters))
    size = strength * what.parameters[name]
    value = size * (np.array([[0, 1, 0], [-1, 0, 1], [0.5, 0, 0]]) if name == "matrix" else _UNEVEN)
    parameters = {**what.parameters, name: value}
    if "at_s" in parameters:
        parameters["at_s"] = parameters["at_s"] * span
    switches = _switches(span) if what.effect.endswith("charging_bias") else []
    world = _world(recording, samples, switches)
    changed = _added(recording, sensor, played(world, what.effect, parameters))
    return replace(changed, events=control(recording, what).events), value


def _switches(span: float) -> list[Charging]:
    return [Charging(0.0, False), *(Charging(p * span, i % 2 == 0) for i, p in enumerate(PLUGS))]


def _world(recording: Recording, samples: Samples, switches: list[Charging]) -> World:
    """Return the readings of a recording as if they were what happened, at one sensor's times."""
    t = samples.t - samples.t[0]
    rate = recording.gyroscope or recording.accelerometer
    warm = recording.accelerometer.temperature
    on = np.array([[e.t, float(e.on)] for e in switches] or [[0.0, 0.0]])
    state = on[np.maximum(np.searchsorted(on[:, 0], t, side="right") - 1, 0), 1]
    return World(
        t=t,
        force=_at(samples.t, recording.accelerometer),
        rate=_at(samples.t, rate),
        rate_dot=np.zeros((t.size, 3)),
        north=np.zeros((t.size, 3)),
        temperature=np.full(t.size, 25.0)
        if warm is None
        else np.interp(samples.t, recording.accelerometer.t, warm),
        charging=state,
        drive=on,
        rests=np.empty((0, 2)),
        turns=np.empty((0, 6)),
    )


def _at(t: Array, samples: Samples) -> Array:
    return interpolate(t, samples.t, samples.xyz)


def _of(recording: Recording, sensor: str) -> Samples:
    if sensor == "accel":
        return recording.accelerometer
    assert recording.gyroscope is not None
    return recording.gyroscope


def _with(recording: Recording, sensor: str, xyz: Array) -> Recording:
    changed = replace(_of(recording, sensor), xyz=frozen(xyz))
    return (
        replace(recording, accelerometer=changed)
        if sensor == "accel"
        else replace(recording, gyroscope=changed)
    )


def _added(recording: Recording, sensor: str, change: Array) -> Recording:
    """Return a recording whose sensor read more by `change` (n, 3), its values on the grid they were on."""
    xyz = _of(recording, sensor).xyz
    changed = xyz + change
    for axis in range(3):
        step = comb_step(xyz[:, axis])
        if step is not None:
            changed[:, axis] = xyz[0, axis] + np.rint((changed[:, axis] - xyz[0, axis]) / step) * step
    return _with(recording, sensor, changed)


def _level(samples: Samples) -> Array:
    """Return the standard deviation (3,) of white noise, by medians that do not see motion."""
    bent = np.diff(samples.xyz, n=2, axis=0)
    return np.asarray(np.median(np.abs(bent), axis=0) / 0.6745 / np.sqrt(6.0) + 1e-9)


Direct = Callable[[Recording, float, float, np.random.Generator], tuple[Recording, Any]]


def _unequal(r: Recording, size: float, strength: float, rng: np.random.Generator) -> tuple[Recording, Any]:
    ratio = 1.0 + (size - 1.0) * strength
    extra = np.zeros_like(r.accelerometer.xyz)
    extra[:, 1] = rng.standard_normal(len(extra)) * _level(r.accelerometer)[1] * np.sqrt(ratio**2 - 1.0)
    return _added(r, "accel", extra), ratio


def _tails(r: Recording, size: float, strength: float, rng: np.random.Generator) -> tuple[Recording, Any]:
    fraction = 0.03 * strength
    far = rng.random((len(r.accelerometer), 3)) < fraction
    extra = _level(r.accelerometer) * size * rng.standard_normal((len(r.accelerometer), 3))
    return _added(r, "accel", np.where(far, extra, 0.0)), fraction


def _tone(r: Recording, size: float, strength: float, rng: np.random.Generator) -> tuple[Recording, Any]:
    rate = (len(r.accelerometer) - 1) / float(r.accelerometer.t[-1] - r.accelerometer.t[0])
    wave = size * strength * np.sin(2.0 * np.pi * 0.31 * rate * r.accelerometer.t + rng.uniform(0.0, 6.28))
    return _added(r, "accel", wave[:, None] * np.array([0.0, 0.0, 1.0])), 0.31 * rate


def _coarse(sensor: str) -> Direct:
    def apply(r: Recording, size: float, strength: float, _: np.random.Generator) -> tuple[Recording, Any]:
        step = size * strength
        return _with(r, sensor, np.round(_of(r, sensor).xyz / step) * step), step

    return apply


def _clipped(sensor: str) -> Direct:
    def apply(r: Recording, size: float, strength: float, _: np.random.Generator) -> tuple[Recording, Any]:
        xyz = _of(r, sensor).xyz
        limit = float(np.quantile(np.abs(xyz).max(axis=1), 1.0 - size * strength))
        return _with(r, sensor, np.clip(xyz, -limit, limit)), limit

    return apply


def _smoothed(r: Recording, size: float, strength: float, _: np.random.Generator) -> tuple[Recording, Any]:
    rate = (len(r.accelerometer) - 1) / float(r.accelerometer.t[-1] - r.accelerometer.t[0])
    cutoff = size * rate / strength**0.5
    return _with(r, "accel", low_passed(r.accelerometer.xyz, cutoff, rate)), cutoff


def _scattered(r: Recording, size: float, strength: float, rng: np.random.Generator) -> tuple[Recording, Any]:
    period = float(np.median(np.diff(r.accelerometer.t)))
    sigma = size * strength * period
    shift = np.clip(sigma * rng.standard_normal(len(r.accelerometer)), -0.45 * period, 0.45 * period)

    def moved(samples: Samples) -> Samples:
        own = shift[: len(samples)] if len(samples) == shift.size else np.zeros(len(samples))
        return replace(samples, t=frozen(np.maximum.accumulate(samples.t + own)))

    gyroscope = None if r.gyroscope is None else moved(r.gyroscope)
    return replace(r, accelerometer=moved(r.accelerometer), gyroscope=gyroscope), sigma


def _dropped(r: Recording, size: float, strength: float, rng: np.random.Generator) -> tuple[Recording, Any]:
    fraction = size * strength

    def thinned(samples: Samples, delivered: NDArray[np.bool_]) -> Samples:
        def of(values: Array | None) -> Array | None:
            return None if values is None else frozen(values[delivered])

        return replace(
            samples,
            t=frozen(samples.t[delivered]),
            xyz=frozen(samples.xyz[delivered]),
            temperature=of(samples.temperature),
            t_arrival=of(samples.t_arrival),
        )

    delivered = rng.random(len(r.accelerometer)) >= fraction
    same = r.gyroscope is not None and len(r.gyroscope) == delivered.size
    gyroscope = thinned(r.gyroscope, delivered) if same and r.gyroscope is not None else r.gyroscope
    return replace(r, accelerometer=thinned(r.accelerometer, delivered), gyroscope=gyroscope), fraction


def _late(r: Recording, size: float, strength: float, _: np.random.Generator) -> tuple[Recording, Any]:
    assert r.gyroscope is not None
    delay = size * strength
    earlier = interpolate(r.gyroscope.t - delay, r.gyroscope.t, r.gyroscope.xyz)
    return _with(r, "gyro", earlier), delay


_DIRECT: dict[str, Direct] = {
    "noise_unequal_axes": _unequal,
    "noise_heavy_tailed": _tails,
    "vibration_tone": _tone,
    "accel_quantisation": _coarse("accel"),
    "gyro_quantisation": _coarse("gyro"),
    "accel_saturation": _clipped("accel"),
    "gyro_saturation": _clipped("gyro"),
    "bandwidth": _smoothed,
    "timestamp_jitter": _scattered,
    "dropped_samples": _dropped,
    "accel_gyro_time_offset": _late,
}
