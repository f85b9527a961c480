"""Effects that samples, values and stamps show directly, compared where one recording or both have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import Smallest
from stillcal.calib_core.diagnosis.comparison.linear.wanted import transferable
from stillcal.calib_core.diagnosis.comparison.quantity import TIMES, Key, Part, Quantity
from stillcal.calib_core.diagnosis.direct import quantities, smallest
from stillcal.calib_core.diagnosis.direct import repeated_values as repeats
from stillcal.calib_core.diagnosis.direct.repeated_values import LEAST_SHARE as LEAST_HELD
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95, Measured
from stillcal.calib_core.diagnosis.model.records import AXES, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.motion.axis_delays import ALIKE as ALIKE_DELAY
from stillcal.calib_core.diagnosis.motion.group_delay import DELAY
from stillcal.calib_core.diagnosis.motion.unseen_tilt import DRIVER as UNSEEN_TILT
from stillcal.calib_core.diagnosis.noise import noise_level
from stillcal.calib_core.diagnosis.noise.coloured_noise import DRIVER as COLOURED
from stillcal.calib_core.diagnosis.noise.coloured_noise import Coloured
from stillcal.calib_core.diagnosis.noise.lines.line import is_line
from stillcal.calib_core.diagnosis.segments.sample_period import bunched, sample_period
from stillcal.calib_core.diagnosis.segments.value_grid import keeps_to
from stillcal.calib_core.diagnosis.slow.turns.turn_errors import DRIVER as TURNS
from stillcal.calib_core.diagnosis.stamps.clock import LEAST_SHARE as LEAST_BURSTS
from stillcal.calib_core.diagnosis.stamps.clock import stamped_share
from stillcal.calib_core.diagnosis.stamps.timestamps import LEAST_JITTER
from stillcal.calib_core.diagnosis.stamps.timestamps import LEAST_SHARE as LEAST_DROPPED
from stillcal.calib_core.streams.samples import Samples

MEASURED_ELSEWHERE = (
    "noise_level",
    "noise_unequal_axes",
    "bias_random_walk",
    "timestamp_jitter",
    "dropped_samples",
    "arrival_bursts",
    "held_samples",
    "bandwidth",
    "time_offset",
)
"""Findings of one recording by itself whose quantity is measured in both, whether it is a finding or not."""

HELD = "held_samples"

COARSE = "_quantisation"
"""How the effects of coarse values end, of either sensor."""

LINE = "frequency"
"""Parameter that tells two lines of one sensor apart."""

ALIKE = 0.05
"""Relative difference of jitter, a share, a limit, a step or a frequency that is none."""


def direct_statements(exam: Examination) -> list[Finding]:
    """Return the findings that state no slow hypothesis, and those that no other recording can have.

    Values in steps coarser than their noise are among them, however many sound phones have such steps:
    another recording may have none.
    """
    found = [
        s.finding
        for s in exam.statements
        if (s.hypothesis is None or not transferable(s.hypothesis))
        and not s.finding.effect.endswith(MEASURED_ELSEWHERE)
    ]
    stated = {f.sensor for f in found if f.effect.endswith(COARSE)}
    coarse = (s.coarse_values(None, None) for s in exam.streams if s.sensor not in stated)
    return [*found, *(one for one in coarse if one is not None)]


DELAY_SIZE = 0.01
"""Prior size of a delay that a simulation may be off by, s: a sample of a phone's usual rate."""


def delay_quantity(exam: Examination) -> dict[Key, Quantity]:
    """Return the delay between the sensors as far as motion tells it, whether sound phones have it or not."""
    if exam.delay is None:
        return {}
    one = of_delay(exam.delay, exam.accelerometer)
    return {(one.effect, one.sensor): one}


def of_delay(delay: Measured, samples: Samples) -> Quantity:
    """Return a delay of the gyroscope against the accelerometer, s, as a quantity. samples: its own."""
    one, where = np.ones(1), Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), "rate of turn")
    return Quantity(
        DELAY, "timing", (Part("delay", "s", 1),), np.array([delay.value]), np.array([[delay.error**2]]),
        DELAY_SIZE * one, ALIKE_DELAY * one, np.array([-1]), where=where,
    )  # fmt: skip


def stamp_quantities(exam: Examination, period: float = 0.0) -> dict[Key, Quantity]:
    """Return what stamps and deliveries measure, logarithms; by effect and sensor, as far as they show it.

    period: s, of the samples among which deliveries in bursts are counted, at least their own.
    """
    return {key: quantity for key, (_, quantity) in measured_directly(exam, period).items()}


def measured_directly(exam: Examination, period: float = 0.0) -> dict[Key, tuple[Measured, Quantity]]:
    """Return the same, each with the number on the scale of the populations of sound phones.

    A sensor without any noise repeats its values at rest, whether it holds samples or not.
    """
    samples = exam.accelerometer
    out = {}
    for effect, measured in quantities.of_stamps(samples, period).items():
        key = (effect, "timing")
        if effect == "timestamp_jitter":
            sigma = _linear(measured, LEAST_JITTER, sample_period(samples.t))
            quantity = _logarithm(key, Part("sigma", "s", 1), sigma, LEAST_SIGMA, samples)
        else:
            floor = LEAST_DROPPED if effect == "dropped_samples" else LEAST_BURSTS
            share = _linear(measured, floor, 1.0)
            quantity = _logarithm(key, Part("fraction", "1", 1), share, LEAST_SHARE, samples)
        out[key] = measured, quantity
    for stream in (s for s in exam.streams if not (s.silent or s.hidden)):
        for effect, measured in quantities.of_values(stream.samples).items():
            key, share = (effect, stream.sensor), _linear(measured, LEAST_HELD, 1.0)
            quantity = _logarithm(key, Part("fraction", "1", 1), share, LEAST_SHARE, stream.samples)
            longest = float(repeats.usual_longest(stream.samples))
            out[key] = measured, replace(quantity, reference={"longest": longest})
    return out


def stamped_in_bursts(exams: Sequence[Examination]) -> list[dict[Key, Quantity]]:
    """Return the shares of samples stamped in bursts, where the stamps of one of two are of deliveries."""
    if any(exam.is_table for exam in exams) or not any(bunched(exam.accelerometer.t) for exam in exams):
        return [{} for _ in exams]
    key, out = ("arrival_bursts", "timing"), []
    for samples in (exam.accelerometer for exam in exams):
        share = stamped_share(samples.t, sample_period(samples.t))
        out.append({key: _logarithm(key, Part("fraction", "1", 1), share, LEAST_SHARE, samples)})
    return out


class StampFaults(NamedTuple):
    """Scatter of stamps, s, and the shares of samples that arrive in bursts and that are missing."""

    jitter_s: float
    bursts: float
    missing: float


def stamps_as_compared(samples: Samples) -> StampFaults:
    """Return what stamps and arrivals show: 0 for none, and where stamps come in bursts."""
    measured, out = quantities.of_stamps(samples), []
    for effect, floor, unit, least in (
        ("timestamp_jitter", LEAST_JITTER, sample_period(samples.t), LEAST_SIGMA),
        ("arrival_bursts", LEAST_BURSTS, 1.0, LEAST_SHARE),
        ("dropped_samples", LEAST_DROPPED, 1.0, LEAST_SHARE),
    ):
        value = _linear(measured[effect], floor, unit).value if effect in measured else 0.0
        out.append(value if value > least else 0.0)
    return StampFaults(*out)


def held_as_compared(exam: Examination) -> dict[str, float]:
    """Return the shares of samples that are held, by sensor; a sensor that holds none is not among them."""
    seen = ((key, quantity) for key, quantity in stamp_quantities(exam).items() if key[0] == HELD)
    return {sensor: float(f"{np.exp(q.value[0]):.3g}") for (_, sensor), q in seen if not q.none}


LEAST_SHARE, LEAST_SIGMA = 1e-4, 1e-6
"""Share of samples, and s of jitter, that are as good as none."""


def _linear(measured: Measured, floor: float, unit: float) -> Measured:
    """Return a number, times `unit`, whose common logarithm with `floor` added was measured."""
    whole = 10.0**measured.value
    return Measured(max(whole - floor, 0.0) * unit, measured.error * whole * float(np.log(10.0)) * unit)


def _logarithm(key: Key, part: Part, measured: Measured, floor: float, samples: Samples) -> Quantity:
    """Return a number of 0 or more as a logarithmic quantity, below `floor` as the floor.

    Where nothing lies within two standard deviations, one of the logarithm reaches down to the floor, and two
    as far up as two of the number.
    """
    value = max(measured.value, floor)
    error, perhaps_none = measured.error / value, measured.value < 2.0 * measured.error
    if perhaps_none:
        error = max(0.5 * float(np.log1p(2.0 * error)), float(np.log(value / floor)))
    return Quantity(
        *key, (part,), np.array([np.log(value)]), np.array([[error**2]]),
        np.array([TIMES]), np.array([ALIKE]), np.array([-1]), logarithmic=True,
        where=Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), "time stamps"),
        none=measured.value <= floor, error=measured.error if perhaps_none else 0.0,
        counted=len(samples) if part.name == "fraction" else 0,
    )  # fmt: skip


def smallest_direct(exam: Examination) -> list[Smallest]:
    """Return how small an effect of stamps, values and noise the recording would have shown."""
    if exam.is_table:
        return []
    sound, claims, out = sound_phones(), exam.claims, []
    for stream in exam.streams:
        sizes = smallest.of_stamps_and_values(stream.samples, sound, claims.nominal_rate_hz)
        claim = noise_level.claimed(stream.sensor, claims)
        sizes += smallest.of_noise(stream.measured(), sound, stream.sensor, stream.still.rate, claim)
        for one in sizes:
            timing = one.effect in TIMING
            if not timing or stream.sensor == "accel":
                sensor = "timing" if timing else stream.sensor
                out.append(_smallest(one, sensor))
    if exam.delay is not None:
        out.extend(_smallest(one, "timing") for one in smallest.of_delay(exam.delay, sound))
    return out


def _smallest(one: smallest.SmallestSize, sensor: str) -> Smallest:
    return Smallest(one.effect, sensor, one.parameter, one.value, one.unit, reason=one.reason)


TIMING = ("clock_skew", "timestamp_jitter", "dropped_samples", "arrival_bursts")


def pair_of(finding: Finding, others: Sequence[Finding]) -> Finding | None:
    """Return the finding of another recording that is of the same cause; None without one.

    Effect and sensor are the same; so is the driver of what has no name, and a line's frequency or a period,
    also one of samples, for two lines are two vibrations. Of several lines it is the nearest in frequency.
    One vibration may be steady in one recording, and come and go in the other.
    """
    same = [o for o in others if o.sensor == finding.sensor and _same_kind(finding, o)]
    if finding.where.driver == COLOURED:
        same = [o for o in same if _overlap(finding.where.band_hz, o.where.band_hz)]
    same = [o for o in same if all(_alike(finding, o, name) for name in (LINE, "period_s", "period_samples"))]
    return min(same, key=lambda o: _octaves(finding, o), default=None)


def _overlap(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two bands, Hz, have most of the narrower one in common."""
    common = min(one[1], other[1]) - max(one[0], other[0])
    return common > 0.5 * min(one[1] - one[0], other[1] - other[0])


def _same_kind(one: Finding, other: Finding) -> bool:
    if is_line(one) and is_line(other):
        return True
    return one.effect == other.effect and (one.effect != "unknown" or one.where.driver == other.where.driver)


def partner(finding: Finding, own: Sequence[Finding], others: Sequence[Finding]) -> Finding | None:
    """Return what `pair_of` does, but of a line only one that is nearest to it among `own` lines too.

    A line of the one recording is one line of the other: where this has two near it, one of them is lacking.
    """
    pair = pair_of(finding, others)
    if pair is None or LINE not in finding.parameters:
        return pair
    return pair if pair_of(pair, own) is finding else None


def step_of_other(finding: Finding, other: Examination) -> Finding | None:
    """Return a finding of coarse values with the step of another recording, where that has coarse steps too.

    Under louder noise, as at a higher rate, the same step is no finding, and one coarser than its noise may
    be a usual one; codes that were rounded a second time have two. None where the step is another, and finer
    than its noise.
    """
    streams = [s for s in other.streams if s.sensor == finding.sensor]
    if not finding.effect.endswith(COARSE) or not streams:
        return None
    own = finding.parameters["step"]
    axes, steps = [AXES.index(a) for a in finding.axes], streams[0].steps
    step, noise = (float(np.median(each[axes])) for each in (steps.step, steps.sd))
    whole = float(np.asarray(own.value))
    ratio = step / whole
    if abs(ratio - 1.0) > ALIKE and not 0.0 < noise < step:
        return finding if any(keeps_to(values, whole) for values in streams[0].samples.xyz.T) else None
    low, high = np.ravel(own.ci95) * ratio
    return replace(finding, parameters={"step": Parameter(step, [float(low), float(high)], own.unit)})


def band_of_other(finding: Finding, other: Examination) -> Finding | None:
    """Return a finding of a band of noise with what another recording has in that band.

    None where that does not tell it, or has no more there than sound phones have.
    """
    found = _in_band(finding, other)
    if found is None or found.size().value <= sound_phones()["noise_coloured"].highest:
        return None
    return replace(finding, parameters={"ratio": found.ratio().parameter("1")})


def why_no_band(finding: Finding, other: Examination) -> str | None:
    """Say why another recording does not tell what its noise has in a band; None where it does."""
    if finding.where.driver != COLOURED or _in_band(finding, other) is not None:
        return None
    return "its noise at rest does not tell what it has in that band"


def _in_band(finding: Finding, other: Examination) -> Coloured | None:
    """Return what another recording's noise has in a finding's band; None of a finding that is in none."""
    if finding.where.driver != COLOURED:
        return None
    streams = (s for s in other.streams if s.sensor == finding.sensor)
    return next((s.coloured(finding.where.band_hz) for s in streams), None)


def _octaves(one: Finding, other: Finding) -> float:
    """Return how far apart two lines are; nothing where either is none."""
    if any(LINE not in f.parameters for f in (one, other)):
        return 0.0
    numbers = (np.asarray(f.parameters[LINE].value, dtype=np.float64) for f in (one, other))
    return float(np.abs(np.log2(np.divide(*numbers))).max())


def _alike(one: Finding, other: Finding, name: str) -> bool:
    """Whether two findings have the same number of a name, or one of them none."""
    if name not in one.parameters or name not in other.parameters:
        return True
    numbers = (np.asarray(f.parameters[name].value, dtype=np.float64) for f in (one, other))
    return bool((np.abs(np.log(np.divide(*numbers))) <= ALIKE).all())


def quantities_of(one: Finding, other: Finding) -> tuple[Quantity, Quantity] | None:
    """Return two findings' parameters as quantities; None where they have not the same ones with intervals.

    They are logarithms where every number of both is surely positive: one that may be nothing has none.
    """
    names = [_with_interval(finding) for finding in (one, other)]
    values = [_numbers(f, n) for f, n in zip((one, other), names, strict=True)]
    if not names[0] or names[0] != names[1] or values[0].shape != values[1].shape:
        return None
    errors = [_errors(f, n) for f, n in zip((one, other), names, strict=True)]
    positive = all(bool((v > NORMAL_95 * e).all()) for v, e in zip(values, errors, strict=True))
    return _quantity(one, names[0], positive), _quantity(other, names[1], positive)


def of_any_direction(line: Quantity) -> Quantity:
    """Return a line of which only the size of its amplitude (3,) is known, and not its direction.

    What shakes a device from where it lies shakes other axes of it in another attitude. The covariance grows
    by the quantity's own size, but not along the amplitude: the variance of its length stays.
    """
    starts = np.cumsum([0, *(part.count for part in line.parts)])
    rows = next(slice(a, a + 3) for a, p in zip(starts, line.parts, strict=False) if p.name == "amplitude")
    size, amplitude = line.size[rows], line.value[rows]
    along = size * (np.exp(2.0 * amplitude) if line.logarithmic else amplitude)
    along = along / np.linalg.norm(along)
    covariance = line.covariance.copy()
    covariance[rows, rows] += np.outer(size, size) * (np.eye(3) - np.outer(along, along))
    return replace(line, covariance=covariance)


def _with_interval(finding: Finding) -> list[str]:
    return [n for n, p in finding.parameters.items() if _interval(p) is not None]


def _numbers(finding: Finding, names: Sequence[str]) -> Array:
    values = [np.asarray(finding.parameters[n].value, dtype=np.float64).ravel() for n in names]
    return np.concatenate(values) if values else np.empty(0)


def _errors(finding: Finding, names: Sequence[str]) -> Array:
    errors = [_interval(finding.parameters[n]) for n in names]
    return np.concatenate([e for e in errors if e is not None])


def _quantity(finding: Finding, names: Sequence[str], logarithmic: bool) -> Quantity:
    value, sigma = _numbers(finding, names), _errors(finding, names)
    own = finding.parameters
    parts = tuple(Part(n, own[n].unit, np.size(own[n].value)) for n in names)
    if logarithmic:
        size, alike = np.full(value.size, TIMES), np.full(value.size, ALIKE)
        value, sigma = np.log(value), sigma / value
    else:
        size, alike = np.maximum(3.0 * np.abs(value), 10.0 * sigma), ALIKE * np.abs(value)
    return Quantity(
        finding.effect, finding.sensor, parts, value, np.diag(sigma**2), size, alike,
        np.arange(value.size) % 3 if value.size % 3 == 0 else np.full(value.size, -1),
        logarithmic=logarithmic, where=finding.where,
    )  # fmt: skip


def _interval(parameter: Parameter) -> Array | None:
    """Return standard errors from a 95 % interval; None where there is no width to it."""
    if parameter.ci95 is None:
        return None
    value = np.atleast_1d(np.asarray(parameter.value, dtype=np.float64)).ravel()
    ci = np.asarray(parameter.ci95, dtype=np.float64).reshape(-1, 2)
    if ci.shape[0] != value.size:
        return None
    error = (ci[:, 1] - ci[:, 0]) / (2.0 * NORMAL_95)
    return error if bool((error > 0.0).all()) else None


def why_not_shown(finding: Finding, other: Examination) -> str | None:
    """Say why another recording could not show an effect at all; None where it could."""
    samples = other.gyroscope if finding.sensor == "gyro" else other.accelerometer
    between = finding.effect in ("accel_gyro_time_offset", "lever_arm")
    between = between or finding.where.driver == UNSEEN_TILT
    reasons = (
        ((finding.sensor == "gyro" or between) and other.gyroscope is None, "it has no gyroscope"),
        (
            finding.effect.endswith("saturation") and samples is not None and _below_limit(finding, samples),
            "its motion does not go beyond the limit",
        ),
        (
            finding.effect == "arrival_bursts" and other.accelerometer.t_arrival is None,
            "it has no times of arrival",
        ),
        (finding.effect == "unknown" and len(other.bins) == 0, "it is never at rest"),
        ((why := why_no_band(finding, other)) is not None, why or ""),
        (finding.where.driver == TURNS and other.turns is None, "its turns from rest to rest are too few"),
    )
    return next((text for applies, text in reasons if applies), None)


def _below_limit(finding: Finding, samples: Samples) -> bool:
    limit = float(np.min(finding.parameters["limit"].value))
    # What stops at the limit itself does not speak against it.
    return bool(np.abs(samples.xyz).max() <= limit * (1.0 + ALIKE))


def named(finding: Finding) -> list[str]:
    """Return the finding's axes in their order."""
    return [a for a in AXES if a in finding.axes]
