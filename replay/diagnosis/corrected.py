"""A simulated recording with the differences that were found put into its samples.

What an effect adds is its response in the catalogue, at samples that exist already. Others change the samples
(`sample_changes`). What cannot be put into samples (another rate, less noise) is left out and named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import OF_DENSITY
from stillcal.calib_core.diagnosis.comparison.pair.turns import Arm
from stillcal.calib_core.diagnosis.comparison.quantity import Difference, Quantity
from stillcal.calib_core.diagnosis.comparison.records import Discrepancy
from stillcal.calib_core.diagnosis.effects.catalogue import named_effects
from stillcal.calib_core.diagnosis.effects.covariate import CovariateBias, covariate_effects
from stillcal.calib_core.diagnosis.model.moments import History, Moments, at_samples
from stillcal.calib_core.diagnosis.model.records import AXES, Finding
from stillcal.calib_core.diagnosis.model.residuals import fit_baseline
from stillcal.calib_core.diagnosis.model.settings import LEAST_BINS
from stillcal.calib_core.diagnosis.noise.lines.even_stamps import evened
from stillcal.calib_core.diagnosis.noise.lines.line import TONE
from stillcal.calib_core.diagnosis.segments.overview import Overview
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.windows import Windows
from stillcal.calib_core.diagnosis.slow.relinearised import HALVINGS
from stillcal.calib_core.diagnosis.slow.taken_off import Known
from stillcal.calib_core.diagnosis.slow.wander import WALK
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.resample import temperature_at
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.condense import LongRecording
from stillcal.replay.diagnosis.judged import bins_of, charging_events, claims_of
from stillcal.replay.diagnosis.phone.case import with_errors
from stillcal.replay.diagnosis.sample_changes import changes, limit_of, rate_of, sensors_of
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
    span: tuple[float, float] | None = None,
) -> Corrected:
    """Return the simulation's recording with every difference added that samples can take.

    biases: by sensor, (3,) m/s^2 or rad/s, the simulation's own, which a scale does not act on; a sensor that
    is not in it is taken to have none. seed: of the noise that is added where the simulation has too little.
    span: s, first and last stamp of the recording, None where they are the simulation's: what lasts for a
    part of it lasts for the same part of the simulation.
    """
    of_simulation = span_of(simulation.accelerometer)
    discrepancies = [_on_clock(d, span or of_simulation, of_simulation) for d in discrepancies]
    corrected = _with_added(simulation, discrepancies, biases, seed)
    if not isinstance(simulation, LongRecording) or simulation.overview is None:
        return corrected
    seconds = _seconds(simulation, simulation.overview)
    of_samples = [id(one) for one, _ in changes(discrepancies, seed) if limit_of(one) is None]
    slow = [d for d in discrepancies if id(d) not in of_samples and _new_line(d) is None]
    changed = _with_added(seconds, slow, biases, seed).recording
    white = [d for d in discrepancies if d.effect in OF_DENSITY and d.difference is not None]
    known = simulation.overview
    power = {s: np.zeros((len(known), 3)) for s in ("accel", "gyro")}
    for one in white:
        samples = simulation.accelerometer if one.sensor == "accel" else simulation.gyroscope
        if samples is not None and (_missing(one) >= 0.0).all():
            power[one.sensor] += _missing(one) / 2.0 * rate_of(samples)
    for line in filter(None, map(_new_line, discrepancies)):
        there = _there(known.force.t, line)
        power[line.sensor] += np.outer(there, np.square(line.parameters["amplitude"].value) / 2.0)
    held = corrected.recording
    assert isinstance(held, LongRecording), "made of one"
    overview = _changed_overview(known, changed, power)
    return Corrected(replace(held, overview=overview), corrected.left_out)


def with_echoes(
    simulation: Recording, found: Sequence[Discrepancy], compared: Sequence[Difference] = ()
) -> list[Discrepancy]:
    """Return differences, also the part of another sensor in a vibration that only the recording has.

    compared: what both have; a sensor whose part of this vibration is among them has its own. A simulation
    without a gyroscope has no part of it.
    """
    if simulation.gyroscope is None:
        return list(found)
    own = [d.recorded for d in compared if d.recorded.effect == TONE]
    lines = [(d, echo) for d in found if (line := _new_line(d)) is not None for echo in line.echoes]
    new = ((d, e) for d, e in lines if not any(_is_part(one, e) for one in own))
    return [*found, *(replace(d, sensor=e.sensor, axes=e.axes, recorded=e) for d, e in new)]


def _is_part(one: Quantity, echo: Finding) -> bool:
    """Whether a vibration that both have is this part of another one, of the same sensor and frequency."""
    if one.sensor != echo.sensor or one.where is None:
        return False
    (low, high), (least, most) = one.where.band_hz, echo.where.band_hz
    return low <= most and least <= high


def with_known(simulation: Recording, known: Sequence[Known]) -> Recording:
    """Return a simulation with what the known effects add put into samples and, of a long one, seconds."""
    changed = with_errors(simulation, known)
    if not isinstance(changed, LongRecording) or changed.overview is None:
        return changed
    # The seconds are as they were.
    seconds = with_errors(_seconds(changed, changed.overview), known)
    none = np.zeros((len(changed.overview), 3))
    overview = _changed_overview(changed.overview, seconds, {"accel": none, "gyro": none})
    return replace(changed, overview=overview)


def _changed_overview(overview: Overview, changed: Recording, power: Mapping[str, Array]) -> Overview:
    """Return every second with other means. changed: those; power: (n, 3) by sensor, of what is added."""
    rate = overview.rate
    if rate is not None and changed.gyroscope is not None:
        rate = _windows(rate, changed.gyroscope, power["gyro"])
    return replace(overview, force=_windows(overview.force, changed.accelerometer, power["accel"]), rate=rate)


def _seconds(simulation: LongRecording, overview: Overview) -> Recording:
    """Return the means of every second in the place of samples."""

    def means(sensor: Sensor, windows: Windows) -> Samples:
        warm = overview.thermometer
        temperature = None if warm is None else frozen(np.interp(windows.t, *warm.T))
        return Samples(sensor, frozen(windows.t), frozen(windows.mean), temperature)

    accel = means(Sensor.ACCELEROMETER, overview.force)
    gyro = None if overview.rate is None else means(Sensor.GYROSCOPE, overview.rate)
    return replace(simulation, accelerometer=accel, gyroscope=gyro)


def _windows(windows: Windows, changed: Samples, power: Array) -> Windows:
    """Return windows with other means. power: (n, 3) of what is added within a second."""
    added = changed.xyz - windows.mean
    return replace(
        windows,
        mean=changed.xyz,
        variance=windows.variance + power,
        calm_mean=windows.calm_mean + added,
        calm_variance=windows.calm_variance + power,
    )


def _with_added(
    simulation: Recording, discrepancies: Sequence[Discrepancy], biases: Mapping[str, Array], seed: int
) -> Corrected:
    """Return the simulation with every difference added to the samples that are held."""
    rng, drivers = np.random.default_rng(seed), _Drivers(simulation)
    left_out: list[str] = []
    streams: dict[str, Samples | None] = {
        "accel": simulation.accelerometer,
        "gyro": simulation.gyroscope,
    }
    changed = changes(discrepancies, seed)
    # A scale acts on what the simulation's sensor read, hence before anything is added to that.
    linear = [d for d in discrepancies if all(d is not one for one, _ in changed)]
    for one in sorted(linear, key=lambda d: not d.effect.endswith("_scale")):
        samples = streams.get(one.sensor)
        if samples is not None and one.effect.endswith(WALK):
            added = _walk(samples, one, span_of(simulation.accelerometer), seed)
        else:
            added = None if samples is None else _added(drivers, samples, one, biases, rng)
        if samples is None or added is None:
            left_out.append(one.effect)
        else:
            streams[one.sensor] = replace(samples, xyz=frozen(samples.xyz + added))
    for one, change in changed:
        for sensor in sensors_of(one):
            samples = streams[sensor]
            streams[sensor] = None if samples is None else change(samples)
    accelerometer = streams["accel"]
    assert accelerometer is not None, "every recording has an accelerometer"
    return Corrected(replace(simulation, accelerometer=accelerometer, gyroscope=streams["gyro"]), left_out)


def _added(
    drivers: _Drivers,
    samples: Samples,
    one: Discrepancy,
    biases: Mapping[str, Array],
    rng: np.random.Generator,
) -> Array | None:
    """Return what a difference adds to the samples, (n, 3); None where it cannot be added."""
    if (line := _new_line(one)) is not None:
        return _tone(samples, line)
    if one.difference is None:
        return _step(samples, one)
    if one.effect in OF_DENSITY:
        return _noise(samples, one, rng)
    kind = one.effect.partition("_")[2]
    if kind == "scale":
        return _scale(samples.xyz - biases.get(one.sensor, np.zeros(3)), one)
    if kind == "bias":
        return np.asarray(np.broadcast_to(one.difference.value, samples.xyz.shape))
    return _by_physics(drivers, samples, one.difference, biases)


def _new_line(one: Discrepancy) -> Finding | None:
    """Return the vibration of a difference that only the recording has; None of any other difference."""
    return one.recorded if one.effect == TONE and one.relation == "lacking" else None


def _step(samples: Samples, one: Discrepancy) -> Array | None:
    """Return a step of the bias of the recording alone, or what takes out one of the simulation alone.

    None of all else.
    """
    step, sign = (one.recorded, 1.0) if one.recorded is not None else (one.simulated, -1.0)
    if step is None or not one.effect.endswith("_bias_step"):
        return None
    return sign * np.outer(samples.t >= step.where.t_start, np.asarray(step.parameters["step"].value))


def _tone(samples: Samples, found: Finding) -> Array | None:
    """Return a sine of the frequency and amplitudes found, while it lasts, its axes in phase.

    None where the samples are too slow for it: they would show another frequency.
    """
    frequency, amplitude = (np.asarray(found.parameters[n].value) for n in ("frequency", "amplitude"))
    if frequency >= rate_of(samples) / 2.0:
        return None
    wave = np.sin(2.0 * np.pi * frequency * evened(samples.t).t) * _there(samples.t, found)
    return np.asarray(np.outer(wave, amplitude))


def _there(t: Array, found: Finding) -> Array:
    """Return 1 at the moments t (n,), s, at which what was found lasts, 0 at others."""
    return ((t >= found.where.t_start) & (t <= found.where.t_end)).astype(np.float64)


def span_of(samples: Samples) -> tuple[float, float]:
    """Return first and last stamp, s."""
    return float(samples.t[0]), float(samples.t[-1])


def _on_clock(one: Discrepancy, own: tuple[float, float], other: tuple[float, float]) -> Discrepancy:
    """Return a difference whose finding lasts for the same part of another recording's span, s."""
    if one.recorded is None:
        return one
    where = one.recorded.where
    start, end = np.interp([where.t_start, where.t_end], own, other)
    return replace(one, recorded=replace(one.recorded, where=replace(where, t_start=start, t_end=end)))


def _by_physics(
    drivers: _Drivers, samples: Samples, difference: Difference, biases: Mapping[str, Array]
) -> Array | None:
    """Return the response of an effect of the catalogue to the differing parameters; None without drivers.

    What goes with the rate goes with the true one, without the simulation's own part of the effect.
    """
    recorded = difference.recorded
    names, grid = tuple(part.name for part in recorded.parts), dict(recorded.reference)
    for effect in (*named_effects(), *drivers.of_columns(recorded.sensor), Arm()):
        own = (effect.name, effect.sensor, tuple(p.name for p in effect.parameters))
        if own != (recorded.effect, recorded.sensor, names):
            continue
        if isinstance(effect, CovariateBias) and bool(effect.grid_units) != ("tau_s" in grid):
            continue
        moments = drivers.at(samples, grid)
        if not effect.can_play(moments, grid):
            return None
        own_part, change = _numbers(difference.simulated), _numbers(recorded) - _numbers(difference.simulated)
        if effect.in_turns and effect.sensor == "gyro" and moments.rate is not None:
            read = moments.rate - biases.get("gyro", np.zeros(3))
            error = np.zeros_like(read)
            for _ in range(HALVINGS):
                moments = replace(moments, rate=read - error)
                error = 0.5 * (error + effect.response(moments, grid) @ own_part)
        return np.asarray(effect.response(moments, grid) @ change)
    return None


def _numbers(quantity: Quantity) -> Array:
    """Return the numbers (k,) of a quantity, also where it holds their logarithms."""
    return np.exp(quantity.value) if quantity.logarithmic else quantity.value


@dataclass(frozen=True, eq=False)
class _Drivers:
    """What drives effects at a sensor's samples.

    The simulation's own samples stand for its true input, free of the bias and the scale that its rests show
    of the accelerometer: a sensitivity to force times a bias would be a bias of the gyroscope.
    """

    simulation: Recording

    @cached_property
    def plugs(self) -> list[Charging]:
        """The charging events."""
        return charging_events(self.simulation)

    @cached_property
    def activity(self) -> Array:
        """When the phone moved, (w, 2)."""
        return self.bins.activity

    @cached_property
    def bins(self) -> Bins:
        """The static bins."""
        return bins_of(self.simulation)

    @cached_property
    def affine(self) -> tuple[Array, Array]:
        """Scale (3, 3) and bias (3,) of the accelerometer: the force is scale (sample - bias)."""
        if len(self.bins) < LEAST_BINS:
            return np.eye(3), np.zeros(3)
        gravity = claims_of(self.simulation).gravity
        fitted = fit_baseline(self.bins.force, self.bins.force_variance, self.bins.rest, gravity)
        return fitted.scale, fitted.bias

    def of_columns(self, sensor: str) -> list[CovariateBias]:
        """Return the effects that follow further logged columns."""
        return [e for name in self.simulation.covariates for e in covariate_effects(sensor, name, 1.0)]

    def at(self, samples: Samples, about: Mapping[str, float]) -> Moments:
        """Return the drivers at a sensor's samples.

        about: the values that drivers count from, of temperature as `temperature_c`, of columns by name.
        """
        accel, gyro, plugs = self.simulation.accelerometer, self.simulation.gyroscope, self.plugs
        states = np.array([0.0, *(float(e.on) for e in plugs)])
        warm = temperature_at(accel, samples.t)
        reference = about.get("temperature_c")
        if warm is not None:
            reference = float(warm.mean()) if reference is None else reference
            warm = np.asarray(warm - reference)
        columns = {
            name: replace(course, values=course.values - about.get(name, 0.0))
            for name, course in self.simulation.covariates.items()
        }
        span = (float(samples.t[0]), float(samples.t[-1]))
        switches = np.array([[e.t, float(e.on)] for e in plugs]) if plugs else None
        made = at_samples(
            samples.t,
            History(span, self.activity, switches, reference, columns),
            (accel, gyro),
            warm,
            states[np.searchsorted([e.t for e in plugs], samples.t, side="right")] if plugs else None,
        )
        assert made.force is not None, "of an accelerometer"
        scale, bias = self.affine
        return replace(made, force=(made.force - bias) @ scale.T)


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
    missing = _missing(one)
    if (missing < 0.0).any():
        return None
    return np.asarray(rng.normal(size=samples.xyz.shape) * np.sqrt(missing * rate_of(samples) / 2.0))


def _walk(samples: Samples, one: Discrepancy, span: tuple[float, float], seed: int) -> Array | None:
    """Return the random walk that is missing; None where the simulation has too much of one.

    It is drawn second by second of a `span`, s, so that samples and means of seconds get the same one.
    """
    if one.difference is None or (_missing(one) < 0.0).any():
        return None
    t = np.arange(span[0], span[1] + 1.0)
    steps = np.random.default_rng(seed).normal(size=(t.size, len(AXES))) * np.sqrt(_missing(one))
    course = np.cumsum(steps, axis=0) - steps[0]
    return np.stack([np.interp(samples.t, t, axis) for axis in course.T], axis=1)


def _missing(one: Discrepancy) -> Array:
    """Return by how much the square of a density (3,) is larger in the recording than in the simulation.

    Of white noise that is its one-sided power density. On an axis on which they do not differ, chance alone
    sets it below: nothing is missing there.
    """
    assert one.difference is not None, "noise is compared as a density"
    recorded, simulated = np.exp(one.difference.recorded.value), np.exp(one.difference.simulated.value)
    missing = recorded**2 - simulated**2
    alike = [axis not in one.axes for axis in AXES]
    return np.asarray(np.where(alike, np.maximum(missing, 0.0), missing))
