"""Which effects a recording allows to look for, and why the others not: the reason that really decided.

Each condition is the one under which the diagnosis itself does not look for the effect, in the order in which
it is tested there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import Sought
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import BLURRED, HIDDEN, why_no_density
from stillcal.calib_core.diagnosis.direct.quantities import grid_of
from stillcal.calib_core.diagnosis.effects.by_force import FEWEST_OF_DEGREE, FEWEST_OF_G, distinct
from stillcal.calib_core.diagnosis.effects.catalogue import effects_in, named_effects
from stillcal.calib_core.diagnosis.effects.covariate import CovariateBias, copies, kind_of_column
from stillcal.calib_core.diagnosis.effects.followed import driver_of, follows_temperature
from stillcal.calib_core.diagnosis.effects.temperature import LEAST_SPAN
from stillcal.calib_core.diagnosis.effects.warmup import TAUS
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect
from stillcal.calib_core.diagnosis.model.moments import moves
from stillcal.calib_core.diagnosis.model.rotation_alignment import LEAST_TURNS
from stillcal.calib_core.diagnosis.motion.group_delay import DELAY
from stillcal.calib_core.diagnosis.motion.time_offset import DELIVERED, LEAST_WINDOWS, NOISY
from stillcal.calib_core.diagnosis.motion.turning_windows import WINDOW, turning_windows
from stillcal.calib_core.diagnosis.noise import noise_level
from stillcal.calib_core.diagnosis.noise.lines.line import middle_hz
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import BRIEF
from stillcal.calib_core.diagnosis.noise.lines.steady_segments import Places, stretches
from stillcal.calib_core.diagnosis.noise.low_pass import LEAST_PIECES
from stillcal.calib_core.diagnosis.segments.noiseless import MOVING
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import SHORTEST_BIN
from stillcal.calib_core.diagnosis.segments.sample_period import bunched
from stillcal.calib_core.diagnosis.slow.turns.turn_residuals import telling
from stillcal.calib_core.diagnosis.stream import LEAST_SAMPLES, Stream

OF_TIME = ("warmup", "bias_drift", "bias_step", "bias_random_walk", "charging_bias", "thermal_latent")
"""Slow effects, by the end of their names, for which it must be known when the phone was at rest."""

OF_TURNS = ("gyro_nonlinearity", "gyro_scale_temperature", "gyro_scale")

ATTITUDES = {"accel_nonlinearity": FEWEST_OF_DEGREE[2], "gyro_g_sensitivity": FEWEST_OF_G}
"""Attitudes that an effect of the force needs."""


@dataclass(frozen=True, slots=True)
class Check:
    """One effect. reason: why it could not be looked for; None where it was."""

    effect: str
    sensor: str
    reason: str | None = None


Condition = tuple[bool, str]
"""Whether something stands in the way, and what to say then."""


def checks_of(exam: Examination, found: Sequence[Sought]) -> list[Check]:
    """Return every effect of the catalogue with whether this recording was asked for it."""
    return [*direct_checks(exam), *slow_checks(exam, found)]


def slow_checks(exam: Examination, found: Sequence[Sought]) -> list[Check]:
    """Return the effects that rests and the turns between them can show. found: what was fitted there."""
    seen: dict[tuple[str, str], str | None] = {(s.effect, s.sensor): HARDLY for s in found if s.hardly}
    seen |= {(s.effect, s.sensor): None for s in found if s.smallest}
    stated = {(s.finding.effect, s.finding.sensor) for s in exam.statements}
    return [
        Check(effect, sensor, None if (effect, sensor) in stated else _why_slow(exam, effect, sensor, seen))
        for effect, sensor in slow_effects(exam)
    ]


def slow_effects(exam: Examination) -> Iterator[tuple[str, str]]:
    """Yield every slow effect with its sensor: the catalogue's, those of columns, a bias that walks."""
    named = dict.fromkeys(e.key for e in named_effects())
    # Where temperature is known, nothing has to stand for it.
    yield from (key for key in named if exam.bins.temperature is None or key[0] != "thermal_latent")
    yield from _of_columns(exam)
    yield from ((f"{sensor}_bias_random_walk", sensor) for sensor in ("accel", "gyro"))


def _of_columns(exam: Examination) -> dict[tuple[str, str], tuple[str, bool]]:
    """Return by effect and sensor the further columns that were logged, and whether each moves at rest."""
    return {
        (f"{residuals.sensor}_{kind_of_column(column)}", residuals.sensor): (
            column,
            moves(residuals.moments.column(column)),
        )
        for residuals in exam.sensors
        for column in residuals.covariates
    }


def _why_slow(
    exam: Examination, effect: str, sensor: str, seen: Mapping[tuple[str, str], str | None]
) -> str | None:
    """Say why a slow effect was not looked for; None where it was. seen: the reason of what was fitted."""
    copied = _copied(exam, effect, sensor)
    if (effect, sensor) in seen and seen[effect, sensor] is None:
        return copied
    first = obstacle(exam, effect, sensor)
    if first is not None:
        return first
    if effect.endswith("bias_random_walk"):
        return None
    return copied or seen.get((effect, sensor)) or uninformed(effect)


def _copied(exam: Examination, effect: str, sensor: str) -> str | None:
    """Say of what found effect's driver an effect's own is a copy; None where it is of none."""
    sensors = [residuals for residuals in exam.sensors if residuals.sensor == sensor and residuals.covariates]
    asked = [
        h
        for residuals in sensors
        for e in effects_in(residuals)
        if e.name == effect
        for h in residuals.hypotheses(e)
    ]
    found = [s.hypothesis for s in exam.statements if s.hypothesis is not None and s.residuals in sensors]
    others = [h for h in found if h.effect.name != effect]
    alike = ((own, other) for own in asked for other in others if copies(own, other))
    return next(
        (
            f"{own.effect.follows} is a copy of {other.effect.follows}, and cannot be told from it"
            for own, other in alike
        ),
        None,
    )


HARDLY = "it would show only at a size that one phone in ten has at most"


def uninformed(effect: str) -> str:
    """Say what is missing where all that an effect needs is there, and still too little."""
    if effect == DELAY:
        return "its turns do not tell it from how the hand moves it"
    if effect in (*ATTITUDES, "accel_bias", "accel_scale"):
        return "the attitudes are too few or too alike"
    if effect in OF_TURNS:
        return "the turns from rest to rest are too few or too alike"
    if effect.endswith(OF_TIME):
        return "the rests do not tell it from errors that go with attitude"
    return "what it depends on changes too little at rest"


def obstacle(exam: Examination, effect: str, sensor: str) -> str | None:
    """Return the first condition of a slow effect, of a bias or a scale that a recording does not meet."""
    return next((why for stands, why in _obstacles(exam, effect, sensor) if stands), None)


def _obstacles(exam: Examination, effect: str, sensor: str) -> Iterator[Condition]:
    bins = exam.bins
    if sensor == "gyro":
        yield exam.gyroscope is None, "no rates" if exam.is_table else "no gyroscope"
    column, moving = _of_columns(exam).get((effect, sensor), ("", True))
    yield not moving, f"{driver_of(column)} does not change at rest, so nothing can follow it"
    yield sensor == exam.exchanged, "its axes are exchanged"
    yield sensor == "gyro" and exam.zone_at_rest, HIDDEN
    yield from _of_rest(exam, sensor)
    if column:
        return
    yield not exam.timed and effect.endswith(OF_TIME), "the table's rows have no time"
    if "temperature" in effect:
        yield from _of_temperature(exam)
    if effect.endswith("charging_bias"):
        yield bins.charging is None, NO_CHARGING
        still = bins.charging is None or not moves(bins.charging, 0.5)
        yield still, "the charger is never switched between two rests"
    if effect.endswith("warmup"):
        lasts, needed = bins.span[1] - bins.span[0], 2.0 * TAUS[0]
        yield lasts < needed, f"it lasts {np.floor(lasts):.0f} s, {needed:.0f} s are needed"
    if effect in ATTITUDES:
        up = next((s.up for s in exam.sensors if s.sensor == sensor), None)
        have = 0 if up is None else distinct(up)
        yield (
            have < ATTITUDES[effect],
            f"{_counted(have, 'attitude')} at rest, {ATTITUDES[effect]} are needed",
        )
    if effect.endswith("bias_random_walk"):
        yield bins.swings, "what it lies on swings"
        why = "its rests are brief: a hand that holds it turns it by as much"
        yield bins.held and sensor == "gyro", why
        yield bins.breathes and sensor == "gyro", "it is turned to and fro in its rests by as much"
    if effect in OF_TURNS and exam.turns is None:
        have = 0 if exam.aligned is None else telling(exam.aligned)
        turns = _counted(have, "turn")
        yield (
            True,
            f"{turns} from rest to rest can be used, {LEAST_TURNS} are needed"
            " (those about the vertical do not count)",
        )


def _of_rest(exam: Examination, sensor: str) -> Iterator[Condition]:
    bins, least = exam.bins, thresholds.LEAST_BINS
    yield len(bins) == 0, "the phone never lies still for long enough"
    yield sensor == "gyro" and bins.rate is None, "vibration hides the rate at rest"
    if exam.is_table:
        yield len(bins) < least, f"only {_counted(len(bins), 'rest')}, {least} are needed"
    still = float(bins.duration.sum())
    needed = max(still * least / max(len(bins), 1), SHORTEST_BIN)
    yield len(bins) < least, f"only {still:.0f} s at rest, {needed:.0f} s are needed"


def why_not_logged(exam: Examination, effect: Effect) -> str | None:
    """Say why a recording does not tell what drives an effect; None where it does."""
    if isinstance(effect, CovariateBias):
        logged = any(effect.column in residuals.covariates for residuals in exam.sensors)
        return None if logged else f"no column {effect.column}"
    if follows_temperature(effect.follows) and exam.bins.temperature is None:
        return next(why for stands, why in _of_temperature(exam) if stands)
    return NO_CHARGING if "charging" in effect.follows and exam.bins.charging is None else None


NO_CHARGING = "no charging events"


def _of_temperature(exam: Examination) -> Iterator[Condition]:
    warm = exam.bins.temperature
    yield warm is None and exam.accelerometer.temperature is None, "no temperature"
    yield warm is None, "the temperature is not known at every rest"
    span = 0.0 if warm is None else float(np.ptp(warm))
    shown = np.floor(100.0 * span) / 100.0
    yield span < LEAST_SPAN, f"the temperature varies by {shown:.2g} K at rest, {LEAST_SPAN} K are needed"


def direct_checks(exam: Examination) -> Iterator[Check]:
    """Yield what samples, values, stamps and motion show directly."""
    if exam.is_table:
        why = "a table of rests has no samples"
        for sensor in ("accel", "gyro"):
            yield from (Check(name, sensor, why) for name in _of_samples(sensor))
        yield from (Check(name, "timing", why) for name in (*STAMPS, "clock_skew", "arrival_bursts"))
        return
    grid, arrivals = grid_of(exam.accelerometer), exam.accelerometer.t_arrival is not None
    untold = None if grid is None or grid.told else UNTOLD
    yield Check("timestamp_jitter", "timing")
    yield Check("dropped_samples", "timing", untold)
    unknown = "neither arrival times nor a nominal rate are known (add nominal_rate_hz to NAME.json)"
    no_rate = untold if exam.claims.nominal_rate_hz else unknown
    yield Check("clock_skew", "timing", None if arrivals else no_rate)
    yield Check("arrival_bursts", "timing", None if arrivals else "no arrival times")
    for stream in exam.streams:
        yield from _of_stream(exam, stream)
    if exam.gyroscope is None:
        yield from (Check(name, "gyro", "no gyroscope") for name in _of_samples("gyro"))
    yield from of_motion(exam)


STAMPS = ("timestamp_jitter", "dropped_samples")
UNTOLD = "its time stamps do not tell how many samples are missing between them"
LEVELS = ("noise_unequal_axes", "noise_heavy_tailed", "bandwidth", "noise_level")
MOTION = ((DELAY, "timing"), ("lever_arm", "accel"))


def _of_samples(sensor: str) -> tuple[str, ...]:
    return f"{sensor}_saturation", f"{sensor}_quantisation", "vibration_tone", *LEVELS


def _of_stream(exam: Examination, stream: Stream) -> Iterator[Check]:
    sensor, count = stream.sensor, len(stream.samples)
    stated = {s.finding.effect for s in exam.statements if s.finding.sensor == sensor}
    few = None if count >= LEAST_SAMPLES else f"{count} samples, {LEAST_SAMPLES} are needed"
    yield Check(f"{sensor}_saturation", sensor, few)
    pieces = len(stream.still.pieces)
    restless = (
        f"{_counted(pieces, 'static interval')}, {LEAST_PIECES} are needed" if pieces < LEAST_PIECES else None
    )
    moves = bool(np.ptp(stream.samples.xyz, axis=0).max() > MOVING[stream.samples.sensor])
    constant = "without noise and motion its values stay as they are" if stream.silent and not moves else None
    yield Check(f"{sensor}_quantisation", sensor, few or restless or constant)
    hidden = "its values come in steps that hide the noise" if pieces else restless
    coarse = hidden if stream.steps.hides_noise() else None
    tone = None if "vibration_tone" in stated else few or coarse or _no_stretch(stream) or _passing(stream)
    yield Check("vibration_tone", sensor, tone)
    noise = few or coarse or restless or _unjudged(stream)
    blurred = BLURRED if stream.steps.blurs_level() else None
    wide = None if "noise_heavy_tailed" not in stated else "heavy tails stand in the way"
    unclaimed = f"the datasheet's noise is not given (add {sensor}_noise_density to NAME.json)"
    claimed = noise_level.claimed(sensor, exam.claims) is not None
    reasons = {
        "noise_unequal_axes": noise or blurred or wide,
        "noise_heavy_tailed": noise or blurred,
        "bandwidth": noise,
        "noise_level": noise or blurred or wide or (None if claimed else unclaimed),
    }
    yield from (Check(name, sensor, None if name in stated else why) for name, why in reasons.items())


def _unjudged(stream: Stream) -> str | None:
    """Say why a stream's noise at rest is not judged; None where it is."""
    return None if stream.levels is not None and not stream.repeats_many else why_no_density(stream)


def _passing(stream: Stream) -> str | None:
    """Say which vibration the device only lay on; None without one."""
    if not stream.passing:
        return None
    line = stream.passing[0]
    share, when = line.parameters["fraction"].value, f"{line.where.t_start:.0f} to {line.where.t_end:.0f} s"
    hz = f"{middle_hz(line):.4g} Hz"
    return f"what the device lay on vibrated at {hz} for {share:.2%} of the time at rest, from {when}"


def _no_stretch(stream: Stream) -> str | None:
    """Say why no line can be looked for; None where steady segments are long enough."""
    if stretches(Places.of(stream.samples), stream.sensor, BRIEF) is not None:
        return None
    return f"there are no three steady segments of {BRIEF:.0f} s"


def of_motion(exam: Examination) -> Iterator[Check]:
    """Yield what motion shows of the time between the sensors and of where they sit."""
    stated = {s.finding.effect for s in exam.statements}
    why = None
    if exam.gyroscope is None:
        why = "no gyroscope"
    elif len(exam.gyroscope) < LEAST_SAMPLES:
        why = f"{len(exam.gyroscope)} samples of the gyroscope, {LEAST_SAMPLES} are needed"
    elif bunched(exam.accelerometer.t) or bunched(exam.gyroscope.t):
        why = DELIVERED
    else:
        limited = exam.on_limits
        have = len(turning_windows(exam.gyroscope, exam.aligned, limited))
        if have < LEAST_WINDOWS:
            within = " within the sensors' limits" if limited else ""
            spans = f"{_counted(have, 'span')} of {WINDOW:.0f} s that the samples follow{within}"
            why = f"the phone turns in {spans}, {LEAST_WINDOWS} are needed"
        elif exam.why_no_delay == NOISY:
            why = NOISY
    # Where the turns do not agree about a delay, none is known, though it was looked for.
    untold = {DELAY: exam.why_no_delay or None}
    yield from (
        Check(name, sensor, None if name in stated else why or untold.get(name)) for name, sensor in MOTION
    )


def _counted(count: int, one: str) -> str:
    return f"{count} {one}" if count == 1 else f"{count} {one}s"
