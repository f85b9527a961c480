"""Single samples that fall too far out: noise with heavy tails, and rare spikes.

The quiet rests tell: what shakes the phone in others adds samples that follow each other, on several axes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import blocks
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.measurement import (
    NORMAL_95,
    DirectEvidence,
    HeldOut,
    Measured,
    direct_finding,
    of_counts,
    of_measured,
    share_of,
    sized,
)
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.noise.low_pass import Quiet
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.maths.robust import MAD_TO_SD

AXES = [0, 1, 2]
FAR = 4.0
BOUND = 6.0
"""Spreads at which samples are held for their fourth moment: no normal one is beyond.

Below eight degrees of freedom Student's has no variance: its error would grow with the moment itself."""

TOGETHER = 0.2
AT_ONCE = "outliers of several axes at once"
RINGS = 3
"""Samples within which another far one is of the same knock."""
CLUSTERED = 0.05
MOST_WIDE = 0.35
SPIKE, RARE = 8.0, 2e-3
"""Far samples are spikes, no noise, above this ratio if fewer than this part (more at a larger ratio)."""
LEAST_SPIKES = 5
OUTLIER, LONE = 20.0, 2e-6
"""Spreads from which a single value is an outlier by itself, and the part of a sound phone's that may be: of
1.9 million samples none was, in 126 recordings of 28 phones and watches on a table (HHAR)."""

UNLIKE_NOISE = 4.0
"""Standard deviations by which far samples must be on one side, or rise from one size to the next."""

SMALL_STEP = 0.6
"""Spreads that a step may be: of coarser ones a spread holds too few."""

QUIETEST = 0.1
"""Part of the pieces whose spread is the sensor's own, where others are shaken."""

LOUDER = 1.1
"""Times that spread up to which a piece is quiet, chance aside: a fifth of its variance may be shaking."""

CHANCE = 4.0
"""Standard errors of a spread by which a quiet piece may seem louder."""

FEWEST_QUIET = 6
LEAST_LEVELS = 6
"""Levels that a rest must take on every axis: fewer than one a standard deviation have no tails to show."""

EDGES = 400
FARTHEST = 60.0
MODEL = 0.01
"""Relative error of a ratio for steps, and spreads that differ by axis and rest."""


def fast(piece: Array) -> Array:
    """Return a piece (n, 3) free of its slow course, a cubic in time, which far samples do not bend."""
    x = np.linspace(-1.0, 1.0, len(piece))
    course = np.polynomial.legendre.legvander(x, 3)
    away = piece - np.median(piece, axis=0)
    near = np.clip(away, -(limit := BOUND * _spread(away)), limit)
    return np.asarray(away - course @ np.linalg.lstsq(course, near, rcond=None)[0])


def _spread(quick: Array) -> Array:
    """Return the spread (3,) by the mean absolute deviation, far samples cut; steps do not make it jump."""
    size = np.abs(quick)
    limit = 3.0 * np.maximum(MAD_TO_SD * np.median(size, axis=0), size.mean(axis=0))
    return np.asarray(np.sqrt(np.pi / 2.0) * np.minimum(size, limit).mean(axis=0))


def _chance(pieces: Sequence[Array]) -> float:
    """Return the relative standard error of a spread: mean absolute deviations of n have 0.76 / sqrt(n)."""
    return float(0.76 / np.sqrt(np.median([len(p) for p in pieces])))


def _quiet(quick: Sequence[Array], own: Array) -> NDArray[np.bool_]:
    """Return which pieces are as quiet as the quietest on every axis; all where hardly any are.

    own: (P, 3) their spreads.
    """
    least = np.maximum(np.quantile(own, QUIETEST, axis=0), 1e-300)
    calm = (own < least * (LOUDER + CHANCE * _chance(quick))).all(axis=1)
    return np.asarray(calm if calm.sum() >= FEWEST_QUIET else np.ones_like(calm))


def standardised(pieces: Sequence[Array]) -> tuple[list[Array], Array]:
    """Return the quiet pieces free of their slow course in units of robust spread, and the typical one (3,).

    The unit is the spread of all of them, where they are alike.
    """
    every = [fast(p) for p in pieces]
    spreads = np.array([_spread(q) for q in every])
    calm = _quiet(every, spreads)
    quick, own = [q for q, use in zip(every, calm, strict=True) if use], spreads[calm]
    typical = np.maximum(np.median(own, axis=0), 1e-300)
    alike = MAD_TO_SD * np.median(np.abs(own / typical - 1.0), axis=0) < 1.5 * _chance(quick) + 0.03
    units = [np.where(alike, typical, np.maximum(s, 1e-300)) for s in own]
    return [q / unit for q, unit in zip(quick, units, strict=True)], typical


def excess_kurtosis(still: Quiet) -> Measured | None:
    """Return the excess kurtosis of single samples on all axes, those beyond `BOUND` spreads held there.

    None where large samples come together: something shook the phone.
    """
    scaled, _ = standardised(still.pieces)
    everything = np.concatenate(scaled)
    if _few_levels(still) or _clustered(everything) or _together(everything) or _gathered(scaled):
        return None
    return _kurtosis([np.clip(z, -BOUND, BOUND) for z in scaled], AXES)


def tails(still: Quiet, sensor: str, usual: Usual, where: Where, step: float) -> Finding | None:
    """Find far samples that come alone, not with others in time; on several axes at once they have no name.

    usual: of the excess kurtosis. step: of the values; its share of the variance is taken off.
    """
    scaled, spread = standardised(still.pieces)
    kurtosis = [_kurtosis(scaled, [a]) for a in range(3)]
    bounded = [np.clip(z, -BOUND, BOUND) for z in scaled]
    held = [_kurtosis(bounded, [a]) for a in range(3)]
    every = (*kurtosis, *held, _kurtosis(scaled, AXES), _kurtosis(bounded, AXES))
    best = max((of_measured(k, usual) for k in every), key=lambda s: s.log_bayes_factor)
    axes = [a for a in AXES if best.stated and (_heavy(kurtosis[a], usual) or _heavy(held[a], usual))]
    everything = np.concatenate(scaled)
    if _few_levels(still) or _clustered(everything[:, axes or AXES]):
        return None
    gain = best.log_bayes_factor - float(np.log(len(every)))
    together = _together(everything)
    if together or not axes or _gathered([z[:, axes] for z in scaled]):
        seen = DirectEvidence(gain, _left_out(scaled), best.unusual) if together and best.stated else best
        return _at_once(sensor, scaled, where, seen) if together else _lone(sensor, scaled, where)
    values = np.abs(everything[:, axes]).ravel()
    fit = contaminated(values, (step / float(spread[axes].mean())) ** 2 / 12.0)
    if fit.fraction.value > MOST_WIDE:
        return None
    share = fit.fraction.value
    say = f"{share:.1%} of the {NAME[sensor]}'s samples have {fit.ratio.value:.1f} times the usual noise."
    parameters = {
        "ratio": fit.ratio.parameter("1"),
        "fraction": fit.fraction.parameter("1"),
        "excess_kurtosis": Parameter(
            [k.value for k in kurtosis],
            [[k.value - NORMAL_95 * k.error, k.value + NORMAL_95 * k.error] for k in kurtosis],
            "1",
        ),
    }
    seen = DirectEvidence(gain, _left_out([z[:, axes] for z in scaled]), best.unusual)
    if fit.ratio.value > SPIKE and share < RARE * fit.ratio.value / SPIKE:
        # A few spikes tell their moments badly, the more so the larger they are; their count is sure.
        return _spikes(sensor, axes, everything, where, seen) or _lone(sensor, scaled, where)
    if (odd := unlike_noise(everything[:, axes], step / float(spread[axes].min()))) != "":
        say = f"{share:.1%} of the {NAME[sensor]}'s samples at rest are outliers, {odd}: they are no noise."
        return direct_finding("unknown", sensor, axes, where, parameters, statement=say, seen=seen)
    return direct_finding("noise_heavy_tailed", sensor, axes, where, parameters, statement=say, seen=seen)


def _at_once(sensor: str, scaled: Sequence[Array], where: Where, seen: DirectEvidence) -> Finding | None:
    """State far samples that come on several axes at once, each alone in time; None of what lasts.

    Noise of the axes' own elements does not come so, and a knock rings for more than a sample.
    """
    rows = [np.flatnonzero((np.abs(z) > FAR).any(axis=1)) for z in scaled]
    followed = sum(int((np.diff(r) <= RINGS).sum()) for r in rows)
    count = sum(r.size for r in rows)
    if followed > TOGETHER * count or _ringing(scaled):
        return None
    several = sum(int(((np.abs(z) > FAR).sum(axis=1) > 1).sum()) for z in scaled)
    share = share_of(float(several), float(sum(len(z) for z in scaled)))
    say = (
        f"{share.value:.2%} of the {NAME[sensor]}'s samples at rest are outliers on several axes at once,"
        f" each alone in time: no noise of single axes, and no knock, which lasts."
    )
    own = replace(where, driver=AT_ONCE)
    parameters = {"fraction": share.parameter("1")}
    return direct_finding("unknown", sensor, AXES, own, parameters, statement=say, seen=seen)


def _ringing(scaled: Sequence[Array]) -> bool:
    """Whether the samples beside far ones are louder than others: a knock dies away there.

    A knock whose ring has sunk below `FAR` by the next sample, as at a low rate, looks alone by its
    size only.
    """
    beside, others = [], []
    for z in scaled:
        far = (np.abs(z) > FAR).any(axis=1)
        padded = np.pad(far, RINGS)
        near = np.any([padded[i : i + far.size] for i in range(2 * RINGS + 1)], axis=0) & ~far
        beside.append(z[near] ** 2)
        others.append(z[~near & ~far] ** 2)
    close, usual = np.concatenate(beside), np.concatenate(others)
    if not close.size or not usual.size:
        return False
    return bool(close.mean() > usual.mean() * (1.0 + CHANCE * np.sqrt(2.0 / close.size)))


def unlike_noise(z: Array, step: float = 0.0) -> str:
    """Say what far samples do that noise does not: most are on one side, or more are farther; "" for neither.

    z: (n, k) and step in spreads. Whatever the law of noise, its density falls from the middle outwards. It
    is counted over a spread, in whole steps.
    """
    far = z[np.abs(z) > FAR]
    sided = abs(float(np.sign(far).sum()))
    if sided > UNLIKE_NOISE * np.sqrt(far.size):
        return f"{0.5 + 0.5 * sided / far.size:.0%} of them to one side"
    if step > SMALL_STEP:
        return ""
    width = step * max(round(1.0 / step), 1) if step > 0.0 else 1.0
    count = np.bincount((np.abs(z) / width).astype(np.int64).ravel(), minlength=2).astype(np.float64)
    rise = np.diff(count) / np.sqrt(np.maximum(count[1:] + count[:-1], 1.0))
    if rise.max() > UNLIKE_NOISE:
        first = int(np.argmax(rise)) + 1
        size = (first + int(np.argmax(count[first:])) + 0.5) * width
        return f"many of about {size:.1f} times the noise"
    return ""


def _lone(sensor: str, scaled: Sequence[Array], where: Where) -> Finding | None:
    """Find outliers that are too few for a moment of the noise, by how many there are.

    They come on one axis, between neighbours that are none.
    """
    found = np.concatenate([_alone(z) for z in scaled])
    hits, axes = int(found.any(axis=1).sum()), np.flatnonzero(found.any(axis=0)).tolist()
    if not hits:
        return None
    seen = DirectEvidence(of_counts(float(hits), float(len(found)), LONE))
    return _spikes(sensor, axes, np.concatenate(scaled), where, seen)


def _alone(z: Array) -> NDArray[np.bool_]:
    """Return which values (n, 3), in spreads, are far from all about them."""
    size = np.abs(z)
    farthest = np.pad(size.max(axis=1), 2)
    near = np.max([farthest[i : i + len(z)] for i in (0, 1, 3, 4)], axis=0)
    lone = (near < FAR + 1.0) & (np.sort(size, axis=1)[:, 1] < FAR + 1.0)
    return np.asarray((size > OUTLIER) & lone[:, None])


def _spikes(sensor: str, axes: list[int], z: Array, where: Where, seen: DirectEvidence) -> Finding | None:
    far = np.abs(z[:, axes]) > FAR + 1.0
    if far.sum() < LEAST_SPIKES:
        return None
    size = float(np.median(np.abs(z[:, axes])[far]))
    n = int(far.sum())
    say = f"{n} single {NAME[sensor]} samples at rest are outliers, of about {size:.0f} times the noise."
    sizes = sized({"count": (float(far.sum()), "1"), "size": (size, "times the noise")})
    return direct_finding("unknown", sensor, axes, where, sizes, statement=say, seen=seen)


def _heavy(kurtosis: Measured, usual: Usual) -> bool:
    """Whether an axis, once far samples are sure on one or all together, is among those that have them."""
    return kurtosis.value > max(usual.middle, thresholds.AXIS_SIGMA * kurtosis.error)


def _kurtosis(scaled: list[Array], axes: list[int]) -> Measured:
    """Return the excess kurtosis of some axes together over all pieces.

    Its error from the pieces left out in tenths.
    """
    squares = [z[:, axes] ** 2 for z in scaled]
    fourth = np.array([(s**2).mean(axis=1).sum() for s in squares])
    second = np.array([s.mean(axis=1).sum() for s in squares])
    count = np.array([len(z) for z in scaled])
    part = np.arange(len(scaled)) % min(20, len(scaled))

    def of(rows: NDArray[np.bool_]) -> float:
        n = float(count[rows].sum())
        return float(fourth[rows].sum() / n / (second[rows].sum() / n) ** 2 - 3.0)

    whole = of(np.ones(part.size, dtype=bool))
    left = np.array([of(part != k) for k in np.unique(part)])
    spread = float(np.sqrt((left.size - 1) / left.size * ((left - left.mean()) ** 2).sum()))
    return Measured(whole, max(spread, float(np.sqrt(24.0 / (len(axes) * count.sum())))))


def _few_levels(still: Quiet) -> bool:
    """Whether values at rest take so few levels on an axis that single samples show no tails."""
    typical = still.pieces[len(still.pieces) // 2]
    return min(np.unique(typical[:, a]).size for a in AXES) < LEAST_LEVELS


def _together(z: Array) -> bool:
    """Whether far samples come with far samples on other axes: a knock, not noise of the sensor."""
    far = np.abs(z) > FAR
    several = float((far.sum(axis=1) > 1).sum()) / max(float(far.any(axis=1).sum()), 1.0)
    return several > TOGETHER


def _gathered(scaled: Sequence[Array]) -> bool:
    """Whether far samples are gathered in some of the pieces (n_i, k): somebody types beside the phone there.

    Noise of the sensor has them everywhere, Poisson distributed. More than by chance (Pearson's statistic,
    its variance by Haldane 1940), and so that their rate scatters by more than its mean: the unit of a piece
    is known to a tenth, which changes the rate less.
    """
    count = np.array([(np.abs(z) > FAR).any(axis=1).sum() for z in scaled], dtype=np.float64)
    part = np.array([len(z) for z in scaled]) / sum(len(z) for z in scaled)
    total, n = count.sum(), count.size
    if n < FEWEST_QUIET or total < LEAST_SPIKES:
        return False
    expected = total * part
    away = (count - expected) ** 2
    variance = 2.0 * (n - 1) + (float((1.0 / part).sum()) - n**2 - 2.0 * n + 2.0) / total
    sure = float((away / expected).sum()) - (n - 1) > CHANCE * np.sqrt(variance)
    return bool(sure and away.sum() - total > (expected**2).sum())


def _clustered(z: Array) -> bool:
    """Whether large samples follow large ones: something shook the phone, or its noise changes."""
    size = np.minimum(np.abs(z), 3.0)
    size = size - size.mean(axis=0)
    power = float((size**2).mean())
    near = [float((size[k:] * size[:-k]).mean()) / power for k in (1, 2, 3, 5)]
    return max(near) > CLUSTERED


@dataclass(frozen=True, slots=True)
class Contaminated:
    """(1 - fraction) N(0, spread^2) + fraction N(0, (ratio spread)^2)."""

    ratio: Measured
    fraction: Measured
    spread: float


def contaminated(size: Array, steps: float = 0.0) -> Contaminated:
    """Fit a mixture of two normals of mean 0 to absolute values (n,) by maximum likelihood.

    Errors by its curvature.

    steps: variance of the steps in the same unit, which both components have.
    """
    from scipy.optimize import minimize  # noqa: PLC0415 - the daemon stays light

    counts, middles = _histogram(size)

    def cost(x: Array) -> float:
        return -float(counts @ np.log(_density(middles, x) + 1e-300))

    start = np.array([np.log(0.8), np.log(3.0), np.log(0.03)])
    fitted = minimize(
        cost, start, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-3, "maxiter": 2000}
    )
    x = np.asarray(fitted.x)
    error = np.sqrt(np.maximum(np.linalg.pinv(_curvature(cost, x)).diagonal(), 0.0))
    narrow = np.exp(2.0 * x[0])
    wide = narrow * np.exp(2.0 * x[1])
    ratio = float(np.sqrt(max(wide - steps, 1e-12) / max(narrow - steps, 1e-12)))
    share = float(1.0 / (1.0 + np.exp(-x[2])))
    return Contaminated(
        Measured(ratio, ratio * float(np.hypot(error[1], MODEL))),
        Measured(share, share * (1.0 - share) * float(error[2])),
        float(np.sqrt(narrow)),
    )


def _histogram(size: Array) -> tuple[Array, Array]:
    edges = np.concatenate([np.linspace(0.0, 6.0, EDGES), np.geomspace(6.02, FARTHEST, EDGES // 4)])
    counts, _ = np.histogram(np.minimum(size, FARTHEST * 0.999), edges)
    return counts.astype(np.float64), 0.5 * (edges[1:] + edges[:-1])


def _density(z: Array, x: Array) -> Array:
    """Return the mixture's density at z; x: log spread, log ratio, logit of the fraction."""
    spread, wide, share = np.exp(x[0]), np.exp(x[0] + x[1]), 1.0 / (1.0 + np.exp(-x[2]))
    narrow = np.exp(-0.5 * (z / spread) ** 2) / spread
    return np.asarray((1.0 - share) * narrow + share * np.exp(-0.5 * (z / wide) ** 2) / wide)


def _curvature(cost: Callable[[Array], float], x: Array) -> Array:
    """Return the matrix of second derivatives by central differences."""
    n, h = x.size, 0.02
    steps = h * np.eye(n)
    out = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            a, b = steps[i], steps[j]
            out[i, j] = (cost(x + a + b) - cost(x + a - b) - cost(x - a + b) + cost(x - a - b)) / (
                4.0 * h * h
            )
    return out


def _left_out(scaled: list[Array]) -> HeldOut:
    """Predict the samples of rests left out by the mixture fitted to the others, and by one normal."""
    fold = blocks(len(scaled))
    gain, before, after = 0.0, [], []
    for k in np.unique(fold):
        train = np.abs(np.concatenate([z for z, f in zip(scaled, fold, strict=True) if f != k])).ravel()
        test = np.abs(np.concatenate([z for z, f in zip(scaled, fold, strict=True) if f == k])).ravel()
        fit = contaminated(train)
        share = min(max(fit.fraction.value, 1e-6), 1.0 - 1e-6)
        x = np.array([np.log(fit.spread), np.log(fit.ratio.value), np.log(share / (1.0 - share))])
        s = rms(train)
        gain += float(np.log(_density(test, x) + 1e-300).sum() + (0.5 * (test / s) ** 2 + np.log(s)).sum())
        seen, model = (
            float(np.mean(test**4)),
            3.0 * fit.spread**4 * (1.0 + share * (fit.ratio.value**4 - 1.0)),
        )
        before.append(seen / 3.0 - 1.0)
        after.append((seen - model) / 3.0)
    return HeldOut(gain, rms(np.array(before)), rms(np.array(after)))
