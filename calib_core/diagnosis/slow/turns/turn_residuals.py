"""The view of turns: what gravity carried from rest to rest tells of the gyroscope's scale and linearity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.noise_models import covariance_of
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.residuals import View, rest_means
from stillcal.calib_core.diagnosis.model.rotation_alignment import LEAST_TURNS, Aligned, Turn
from stillcal.calib_core.diagnosis.segments.static_bins import Bins

OUTLIER = 8.0
KNOWN = 4.0
"""Degrees of freedom with which the noise of turns is known beforehand.

Of 57 simulated recordings with nine to forty turns, eight in ten have 0.2 to 2.1 times this variance.
"""

TOLD = 3.0
"""Standard errors of gravity's direction by which the axis of a turn must lie off it."""

WAVES = 8
"""Of a bias that wanders: those left out have a fourteenth of a walk's variance."""


def turn_residuals(made: Aligned, bins: Bins, gravity: float) -> SensorResiduals | None:
    """Return the turns' residuals, one view, outliers dropped; None where fewer than `LEAST_TURNS` tell."""
    if telling(made) < LEAST_TURNS:
        return None
    for last in (False, False, True):
        if len(made.turns) < LEAST_TURNS:
            return None
        view = turn_view(made, bins)
        size = np.abs(_unforeseen(view)).reshape(-1, 2).max(axis=1)
        kept = [t for t, s in zip(made.turns, size, strict=True) if s < OUTLIER * np.median(size)]
        if last or len(kept) == len(made.turns):
            break
        made = replace(made, turns=kept)
    return SensorResiduals("gyro", bins, (view,), gravity, None, tuple(made.turns))


def telling(made: Aligned) -> int:
    """Return how many turns tell of the gyroscope's scale: those about no axis along gravity.

    About the vertical gravity stays, whatever the scale is: what the scale then seems to do is what the
    accelerometer has gravity's direction wrong by, and no rates at all would fit best.
    """
    return sum(_tells(t, made.unsure) for t in made.turns)


def _tells(turn: Turn, unsure: Array) -> bool:
    """Whether a scale of all rates would move gravity by more than an error of its direction seems to."""
    turned = float(np.linalg.norm(np.einsum("nij,nj->i", turn.carried, turn.rate)))
    return float(np.linalg.norm(turn.by_scale())) > TOLD * turned * _direction_error(turn, unsure)


def _direction_error(turn: Turn, unsure: Array) -> float:
    """Return the standard error of gravity's direction at the end of a turn, rad."""
    return float(np.sqrt(((turn.ends[1] @ unsure) ** 2).sum()))


def turn_view(made: Aligned, bins: Bins) -> View:
    """Two residuals a turn across gravity; the baseline is the nine numbers of scale and misalignment.

    Their variance is what is known of noise. Besides, the accelerometer's parameters may be off by as much as
    the norm of gravity leaves them unknown, its bias by how it wanders and by what every rest has anew, and
    the rate's bias by what coarse steps do to it at rest where the turn dithers them. Of stamps in bursts the
    time that each turn lasts is unsure. What happens between two samples goes with the course of the rates,
    as a gyroscope's nonlinearity does: it is allowed for in all turns alike, and as much again in each.
    `duration` holds the angle turned through, with which errors may grow.
    """
    found = made.turns
    across = np.array([t.across() for t in found])
    n = 2 * len(found)

    def seen(errors: Array) -> Array:
        return np.asarray(np.einsum("kbi,kip->kbp", across, errors).reshape(n, -1))

    unsure = seen(np.array([t.unsure for t in found]))
    between = seen(np.array([t.between for t in found])[:, :, None])
    # The accelerometer's parameters are fitted to the turns too: what they miss is counted from those that
    # the norm has, which know nothing of the turns.
    y = seen(np.array([t.miss for t in found])[:, :, None])[:, 0] + unsure @ made.away
    waves, rests = _at_rests(made, bins)
    absorbed = [unsure @ made.unsure, between, seen(waves)]
    if any(t.stretch > 0.0 for t in found):
        stretched = np.array([t.by_stretch() for t in found])
        absorbed.append(seen(np.eye(len(found))[:, None, :] * stretched[:, :, None]))
    if bins.rate_rounding is not None:
        errors = np.eye(3) * bins.rate_rounding
        absorbed.append(seen(np.array([t.columns(np.tile(errors, (t.t.size, 1, 1))) for t in found])))
    return View(
        "turn",
        y[None],
        seen(np.array([t.scale_columns() for t in found]))[None],
        np.repeat(known_variances(made, bins), 2),
        np.eye(n),
        across.reshape(1, n, 3),
        np.arange(n),
        np.repeat([t.end for t in found], 2),
        np.repeat([t.angle for t in found], 2),
        np.arange(n),
        shared=(seen(rests),),
        absorbed=np.hstack(absorbed),
        known=KNOWN,
    )


def _at_rests(made: Aligned, bins: Bins) -> tuple[Array, Array]:
    """Return what the accelerometer's bias does to turns by what it is at the rests before and after.

    The first are waves of a slow wander, the second what one rest alone has on one axis, noise included:
    (k, 3, m) each, a column one standard deviation.
    """
    ends = np.array([t.ends[:, :, :3] for t in made.turns])
    first = np.array([t.first for t in made.turns])
    at = np.stack([first, first + 1], axis=1)
    waves = made.unsteady.wander * _waves(bins.t[at])
    of_waves = np.einsum("keij,kew->kijw", ends, waves).reshape(len(at), 3, -1)
    rest, own = np.unique(bins.rest[at], return_inverse=True)
    noise = rest_means(bins.force_variance, bins.rest) / np.bincount(bins.rest)[bins.rest, None]
    sizes = np.sqrt(noise + made.unsteady.scatter**2)
    of_rests = np.zeros((len(at), 3, rest.size, 3))
    for e, which in enumerate(own.reshape(at.shape).T):
        of_rests[np.arange(len(at)), :, which] += ends[:, e] * sizes[at[:, e], None, :]
    return of_waves, of_rests.reshape(len(at), 3, -1)


def _waves(t: Array) -> Array:
    """Return a random walk about its mean as independent waves (..., `WAVES`) of variance 1 together.

    The walk's Karhunen-Loeve expansion over the times t (...): cosines of k half periods, sizes as 1 / k.
    """
    k = np.arange(1, WAVES + 1)
    phase = np.pi * (t - t.min()) / max(float(np.ptp(t)), 1e-9)
    return np.asarray(np.sqrt(12.0) / np.pi * np.cos(phase[..., None] * k) / k)


def known_variances(made: Aligned, bins: Bins) -> Array:
    """Return the variance (k,) rad^2 of a component that turns miss by the noise of each alone.

    Of the rate it is noise, a bias that is another before and after, and stamps that jitter; of gravity's
    direction it is what creeps in a rest.
    """
    assert bins.rate is not None and bins.rate_variance is not None, "turns are of a gyroscope"
    first = np.array([t.first for t in made.turns])
    ends = np.stack([first, first + 1])
    lasts = np.array([t.duration for t in made.turns])
    up = (bins.force - made.baseline.bias) @ made.baseline.scale.T
    up /= np.linalg.norm(up, axis=1)[:, None]
    crept = ((up - made.baseline.up) ** 2).sum(axis=1)[ends].sum(axis=0)
    noise = (bins.rate_variance.mean(axis=1) * bins.duration)[ends].mean(axis=0) * lasts
    bias = ((bins.rate[ends[1]] - bins.rate[ends[0]]) ** 2).mean(axis=1) / 4.0 * lasts**2
    between = np.array([float(t.between @ t.between) / 2.0 for t in made.turns])
    stamped = np.array([made.unsteady.jitter * t.by_stamps() for t in made.turns])
    return np.asarray(crept + noise + bias + between + stamped**2)


def _unforeseen(view: View) -> Array:
    """Return by how much each residual (n,) is off what all others tell of it, in standard deviations."""
    whiten = np.linalg.inv(np.linalg.cholesky(covariance_of(view)))
    scale, _ = np.linalg.qr(whiten @ view.baseline[0])
    free = whiten - scale @ (scale.T @ whiten)
    told = free.T @ free
    return np.asarray(told @ view.y[0] / np.sqrt(told.diagonal()))
