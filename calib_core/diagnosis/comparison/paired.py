"""Two sensors on one motion: what one reads less what the other reads holds no motion.

All of the recording is judged, moved or not. The difference of the readings is the one's own error, as far as
the other has none; everything else is as in a recording of rests: the same effects, the same noise, the same
search. Bias, scale and misalignment of one against the other are nuisances of the search, and are measured
with what it found.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.calib_core.diagnosis.comparison.linear import (
    ALIKE_BIAS,
    ALIKE_SCALE,
    MODEL_ERROR,
    RATE_BIAS_SIZE,
    effect_quantity,
    rows_of,
    transferable,
)
from stillcal.calib_core.diagnosis.comparison.looked_for import MOTION, OF_TURNS
from stillcal.calib_core.diagnosis.comparison.pair_motion import left_in_motion
from stillcal.calib_core.diagnosis.comparison.pair_turns import Alignment, Readings
from stillcal.calib_core.diagnosis.comparison.quantity import (
    CERTAIN,
    Difference,
    Part,
    Quantity,
    subtract,
    weighed,
)
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy, NotCompared
from stillcal.calib_core.diagnosis.comparison.stated import axes_of
from stillcal.calib_core.diagnosis.diagnose import Examination
from stillcal.calib_core.diagnosis.effects.unknown import SHAKEN
from stillcal.calib_core.diagnosis.inference.likelihood import fit_hypothesis
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Linear, on_axes
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Parameters, Scene, together
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Where
from stillcal.calib_core.diagnosis.model.residuals import (
    BIAS_SIZE,
    MISALIGNMENT_SIZE,
    SCALE_SIZE,
    View,
)
from stillcal.calib_core.diagnosis.segments.static_bins import Bins, cut_all, in_motion, shaking
from stillcal.calib_core.diagnosis.slow.findings import Stated, slow_statements
from stillcal.calib_core.diagnosis.slow.search import reduce_scene
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples

BIAS = {"accel": Linear("bias", "m/s^2", 3, BIAS_SIZE), "gyro": Linear("bias", "rad/s", 3, RATE_BIAS_SIZE)}
GAIN_SIZES = MISALIGNMENT_SIZE + (SCALE_SIZE - MISALIGNMENT_SIZE) * np.eye(3)
"""Prior size of what one sensor reads of the other's input: scale on the diagonal, misalignment beside it."""


NOT_SOUGHT = "it is not looked for in a pair"


def pair_scenes(
    difference: Readings,
    true: Readings,
    events: Sequence[Charging],
    mismatch: float,
    added: Readings | None = None,
) -> tuple[Bins, list[Scene]]:
    """Return the bins of a whole recording and a scene of each sensor.

    difference: what the recording reads less what the other does, with the recording's temperature; true:
    what the other reads, which stands for the true input. mismatch: part of what shakes both within a bin by
    which their means differ; where it is 0, they should agree in motion as they do at rest, which is judged
    where rests suffice. added: what effects of turns are of what the other reads; they are not exactly of
    their form. Raises NotSupported where it is too short.
    """
    t = difference.force.t
    span = (float(t[0]), float(t[-1]))
    moved = cut_all(true.force, true.rate, events, span)
    moving = in_motion(true.force, true.rate, moved) if mismatch == 0.0 else np.ones(len(moved))
    judged = moving if np.sum(moving == 0.0) >= thresholds.LEAST_BINS else None
    left = cut_all(difference.force, difference.rate, events, span, judged)
    if len(left) < thresholds.LEAST_BINS:
        least = thresholds.LEAST_BINS * 4
        raise NotSupported(f"{span[1] - span[0]:.0f} s of the same motion", (f"at least {least} s",))
    known = None if added is None else cut_all(added.force, added.rate, events, span)
    bins = replace(left, force=moved.force, rate=moved.rate, vibration=moved.vibration)
    up = moved.force / STANDARD

    def scene(
        sensor: str, mean: Array, variance: Array, read: Samples, inputs: tuple[Array, Array | None]
    ) -> Scene:
        shaken = mismatch**2 * shaking(read, left)[:, None]
        return Scene(sensor, bins, _views(left, mean, variance + shaken, inputs, judged), STANDARD, up)

    inputs = (moved.force, None if known is None else known.force)
    scenes = [scene("accel", left.force, left.force_variance, true.force, inputs)]
    if left.rate is not None and left.rate_variance is not None and moved.rate is not None:
        assert true.rate is not None, "it was cut"
        inputs = (moved.rate, None if known is None else known.rate)
        scenes.append(scene("gyro", left.rate, left.rate_variance, true.rate, inputs))
    return bins, scenes


def _views(
    bins: Bins, left: Array, variance: Array, inputs: tuple[Array, Array | None], moving: Array | None
) -> tuple[View, ...]:
    """Return the views of three axes. inputs: the true ones (n, 3), and what effects of turns added there."""
    n, (true, added) = len(bins), inputs
    roughly = np.zeros((n, 3)) if added is None else MODEL_ERROR * added
    return tuple(
        View(
            name=f"pair_{'xyz'[a]}",
            y=left[None, :, a],
            baseline=np.ones((1, n, 1)),
            variance=variance[:, a],
            coupling=np.ones((n, n)),
            project=np.broadcast_to(np.eye(3)[a], (1, n, 3)),
            bins=np.arange(n),
            t=bins.t,
            duration=bins.duration,
            rest=bins.rest,
            absorbed=np.column_stack([true * GAIN_SIZES[a], roughly[:, a]]),
            moving=moving,
        )
        for a in range(3)
    )


def examined_in_pair(
    exam: Examination,
    bins: Bins,
    scenes: Sequence[Scene],
    direct: Sequence[Stated],
    progress: Callable[[float], None] = lambda _share: None,
) -> Examination:
    """Return an examination whose slow effects are those of the pair. direct: what single samples show.

    progress: is called with the share of the scenes that is searched.
    """
    slow: list[Stated] = []
    searched: list[Scene] = []
    for done, scene in enumerate(scenes, start=1):
        allowed, stated = _searched(scene)
        searched.append(allowed)
        slow += stated
        progress(done / len(scenes))
    return replace(exam, bins=bins, scenes=searched, turns=None, statements=[*direct, *slow])


def _searched(scene: Scene) -> tuple[Scene, list[Stated]]:
    """Return a scene whose bins in motion have the variance that they show, and what was found in it.

    That variance is estimated before the search, lest what does not fit in motion looks like an effect, and
    again beside what was found. What is left of it then is a finding itself.
    """
    motion = left_in_motion(scene)
    if motion is None:
        return scene, slow_statements(scene)
    stated = slow_statements(motion.allowed(scene))
    if motion.finding(scene) is not None:
        stated = [s for s in stated if not _of_shaking(s)]
    found = [s.hypothesis for s in stated if s.hypothesis is not None]
    motion = (left_in_motion(scene, found) if found else None) or motion
    allowed = motion.allowed(scene)
    stated = [s if s.hypothesis is None else replace(s, scene=allowed) for s in stated]
    lack = motion.finding(scene)
    return allowed, [*stated, *([] if lack is None else [Stated(lack, None, allowed)])]


def _of_shaking(stated: Stated) -> bool:
    """Whether a statement has no name and follows what shakes the device: one of motion says it already."""
    return stated.finding.effect == "unknown" and stated.finding.where.driver == SHAKEN


def compare_in_pair(exam: Examination, motion: Alignment | None = None) -> Comparison:
    """Return what the recording has and the other sensor has not. exam: from `examined_in_pair`.

    motion: what the two differ by in motion; without it (a witness) that, and bias, scale and misalignment of
    one against the other, are a matter of mounting.
    """
    found = compare_with_ideal(exam, samples=motion is None)
    found = _only_sought(found, motion, gyroscope=exam.gyroscope is not None)
    measured = [q for scene in exam.scenes for q in _measured(exam, scene)]
    measured += [] if motion is None else motion.quantities
    named = {(d.effect, d.sensor): d for d in found.discrepancies if d.effect != "unknown"}
    differences = [subtract(q, _none_of(q)) for q in measured]
    fitted = {(d.recorded.effect, d.recorded.sensor): d for d in differences}
    out = [_sized(d, fitted.get(key)) for key, d in named.items()]
    out += [d for d in found.discrepancies if d.effect == "unknown"]
    if motion is None:
        return replace(found, discrepancies=out)
    pairs = [d for key, d in fitted.items() if key[0].endswith(("_bias", "_scale"))]
    count = found.comparisons + len(pairs)
    pairs = weighed(pairs, max(count, 1))
    out += [_of_constant(d) for d in pairs if d.probability >= CERTAIN]
    return replace(
        found,
        discrepancies=sorted(out, key=lambda d: -d.log_bayes_factor),
        compared=pairs,
        comparisons=count,
        evidence=[*found.evidence, *((d.recorded.effect, d.log_bayes_factor) for d in pairs)],
    )


def _only_sought(found: Comparison, motion: Alignment | None, *, gyroscope: bool) -> Comparison:
    """Leave out what is not looked for in a pair: what motion shows where there is too little of it."""
    known = {(n.effect, n.sensor): n.reason for n in found.not_compared}
    of_turns = [(effect, "gyro") for effect in OF_TURNS if effect != "gyro_scale"] if gyroscope else []
    count = found.comparisons + len(known)
    if motion is None:
        reasons = known | dict.fromkeys(of_turns, NOT_SOUGHT)
        count -= len(reasons)
    else:
        still = "it moves too little in most of the recording" if gyroscope else "no gyroscope"
        every = [*of_turns, *MOTION]
        reasons = {key: why for key, why in known.items() if key not in every}
        missing = {key: known.get(key, still) for key in every if key not in motion.sought}
        count += len(MOTION) - len(reasons | missing)
        reasons |= missing
    return replace(
        found, not_compared=[NotCompared(*key, why) for key, why in reasons.items()], comparisons=count
    )


def without_found(
    exam: Examination, found: Comparison, direct: Sequence[Stated], motion: Alignment | None = None
) -> Comparison:
    """Take what was found out of the difference of readings, by its equations, and judge what is left.

    direct: what is stated besides; motion: what the corrected simulation differs by in motion.
    """
    names = {(d.effect, d.sensor) for d in found.discrepancies if d.difference is not None}
    scenes = [_taken_out(exam, scene, names) for scene in exam.scenes]
    after = examined_in_pair(exam, exam.bins, scenes, direct)
    return compare_in_pair(after, motion)


def without_equation(found: Comparison) -> list[str]:
    """Return the effects that no equation takes out of the difference of readings."""
    return [d.effect for d in found.discrepancies if d.difference is None]


def _constants(scene: Scene) -> Hypothesis:
    """Return bias and what the sensor reads of the other's input, nine numbers row by row."""
    true = scene.bins.force if scene.sensor == "accel" else scene.bins.rate
    assert true is not None, "a scene of the gyroscope has rates"
    n = len(scene.bins)
    gain = (np.eye(3)[None, :, :, None] * true[:, None, None, :]).reshape(n, 3, 9)
    response = np.concatenate([on_axes(np.ones(n)), gain], axis=2)
    parameters = (BIAS[scene.sensor], *(Linear("gain", "1", 1, float(s)) for s in GAIN_SIZES.ravel()))
    return Hypothesis(Parameters("constants", scene.sensor, parameters), {}, scene.columns_of(response))


def _fitted(exam: Examination, scene: Scene) -> tuple[list[Hypothesis], Array, Array]:
    """Fit constants and everything found; return hypotheses, values (k,) and covariance, in their units."""
    bare = tuple(replace(v, baseline=v.baseline[:, :, :0], absorbed=None) for v in scene.views)
    free = replace(scene, views=bare)
    own = [s.hypothesis for s in exam.statements if s.scene is scene and s.hypothesis is not None]
    every = [_constants(scene), *own]
    whole = together(scene, every)
    fit = fit_hypothesis(reduce_scene(free, [whole]), 0)
    return every, fit.beta * whole.sizes, fit.covariance * np.outer(whole.sizes, whole.sizes)


def _measured(exam: Examination, scene: Scene) -> list[Quantity]:
    """Return bias, scale and every effect found in a scene, of the one sensor less the other."""
    every, value, covariance = _fitted(exam, scene)
    where = Where(*scene.bins.span, SLOW_BAND, "nothing")
    reference = scene.moments.history.reference_c
    at = {} if reference is None else {"temperature_c": reference}
    # What turns between rests show is not sought, so a gyroscope's scale is one for all temperatures.
    warm = at if scene.sensor == "accel" else {}
    out = [
        _bias(scene.sensor, value, covariance, where, at),
        _scale(scene.sensor, value, covariance, where, warm),
    ]
    for hypothesis, rows in zip(every[1:], rows_of(every)[1:], strict=True):
        if transferable(hypothesis):
            one = effect_quantity(scene.bins.span, hypothesis, value[rows], covariance[np.ix_(rows, rows)])
            warm = at if one.effect.endswith("_temperature") else {}
            out.append(replace(one, reference={**one.reference, **warm}))
    return out


def _bias(sensor: str, value: Array, covariance: Array, where: Where, at: dict[str, float]) -> Quantity:
    own, axes = BIAS[sensor], np.arange(3)
    alike = np.full(3, ALIKE_BIAS[sensor])
    part = (Part("bias", own.unit, 3),)
    return Quantity(f"{sensor}_bias", sensor, part, value[:3], covariance[:3, :3], np.full(3, own.size),
                    alike, axes, reference=at, where=where)  # fmt: skip


def _scale(sensor: str, value: Array, covariance: Array, where: Where, at: dict[str, float]) -> Quantity:
    """Return the scale of the correction, nine numbers: what the sensor reads too much, negated."""
    rows = slice(3, 12)
    part = (Part("scale", "1", 9),)
    sizes, alike, axes = GAIN_SIZES.ravel(), np.full(9, ALIKE_SCALE), np.repeat(np.arange(3), 3)
    return Quantity(f"{sensor}_scale", sensor, part, -value[rows], covariance[rows, rows], sizes,
                    alike, axes, reference=at, where=where)  # fmt: skip


def _none_of(quantity: Quantity) -> Quantity:
    """Return the other sensor's part: nothing, for it is what the one is measured against."""
    k = quantity.value.size
    return replace(quantity, value=np.zeros(k), covariance=np.zeros((k, k)))


def _sized(found: Discrepancy, difference: Difference | None) -> Discrepancy:
    return found if difference is None else replace(found, difference=difference)


def _of_constant(difference: Difference) -> Discrepancy:
    one = difference.recorded
    assert one.where is not None, "constants say where they were measured"
    return Discrepancy(one.effect, one.sensor, axes_of(difference), one.where, "lacking",
                       difference.probability, difference.log_bayes_factor, difference)  # fmt: skip


def _taken_out(exam: Examination, scene: Scene, names: set[tuple[str, str]]) -> Scene:
    """Return a scene without the effects `names` and, where they are among them, the constants."""
    every, value, _ = _fitted(exam, scene)
    views = list(scene.views)
    for hypothesis, rows in zip(every, rows_of(every), strict=True):
        size = value[rows].copy()
        if hypothesis is every[0]:
            size[:3] *= (f"{scene.sensor}_bias", scene.sensor) in names
            size[3:] *= (f"{scene.sensor}_scale", scene.sensor) in names
        elif (hypothesis.effect.name, scene.sensor) not in names:
            continue
        views = [
            replace(v, y=v.y - columns @ size) for v, columns in zip(views, hypothesis.columns, strict=True)
        ]
    return replace(scene, views=tuple(views))
