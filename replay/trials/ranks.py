"""Simulation-based calibration of the slow effects: the ranks of true parameters in their posteriors.

    python -m stillcal.replay.trials.ranks --trials 30 --seed 1

Days of sound phones are drawn as for the blind test (`stillcal.replay.blind_test`), so their noise is not
the estimator's. Into each day's residuals every slow effect is put in turn, with sizes from the prior of the
Bayes factor, and a time constant or a moment from the effect's own grid. The effect is then fitted as in a
diagnosis that has named it, and counts if it is significant there. If the stated posterior is right, the
probability that it gives to values below the true one is uniform between 0 and 1 (Talts et al. 2018, arXiv
1804.06788). Chi-squared over ten equal classes tells.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import click
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.catalogue import own_effects
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.bayes_factor import SIZES
from stillcal.calib_core.diagnosis.inference.likelihood import highest, reduce_residuals
from stillcal.calib_core.diagnosis.inference.noise_models import of_same_noise
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, estimate
from stillcal.calib_core.diagnosis.slow.screen import screened
from stillcal.calib_core.diagnosis.slow.search import proposals
from stillcal.calib_core.diagnosis.slow.standing import CHANCE
from stillcal.replay.blind_test.cases import make_case
from stillcal.replay.blind_test.designs import Design
from stillcal.replay.blind_test.world.noise import FAMILIES
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.formats.trace import Recording

CLASSES = 10
LEAST = 5.0
"""Ranks that a class must hold on average for chi-squared to be told."""


def residuals_of(trial: int, seed: int) -> list[SensorResiduals]:
    """Return the slow residuals of a day without effects: both sensors' rests, and the turns."""
    maker = ("simulator", "examiner")[trial % 2]
    design = Design(
        "decoy", FAMILIES[trial % len(FAMILIES)], maker, ("thermometer",), 10.0, full_length=False
    )
    made = make_case(design, seed, trial).recording
    recording = Recording(made.accelerometer, made.gyroscope, list(made.events), made.claims, [])
    exam: Examination = examined(recording, sought=())
    return [*exam.sensors, *([] if exam.turns is None else [exam.turns])]


def cold(residuals: SensorResiduals) -> SensorResiduals:
    """Return residuals without the thermometer, as effects of heat that was not recorded need them."""
    return replace(residuals, bins=replace(residuals.bins, temperature=None))


def drawn(
    residuals: SensorResiduals, effect: Effect, rng: np.random.Generator
) -> tuple[Hypothesis, Array] | None:
    """Draw an effect at a point of its grid, and its parameters (k,) in SI; None where it cannot show."""
    many = effect.dictionary(residuals.moments)
    points = [h.grid for h in residuals.hypotheses(effect)] if many is None else many.grids
    if not points:
        return None
    coarse = points[int(rng.integers(len(points)))]
    finer = effect.finer(residuals.moments, coarse)
    grid = finer[int(rng.integers(len(finer)))] if len(finer) else coarse
    true = in_every_view(residuals, effect, grid)
    return true, true.sizes * rng.choice(SIZES) * rng.standard_normal(true.sizes.size)


def in_every_view(residuals: SensorResiduals, effect: Effect, grid: Grid) -> Hypothesis:
    """Return what an effect does to all views, also to those that are blind to it while it is searched for.

    The estimate uses these too, so what is put into one of them must be in all.
    """
    if residuals.turns:
        return residuals.hypothesis(effect, grid)
    return Hypothesis(effect, grid, residuals.columns_of(effect.response(residuals.moments, grid)))


def with_effect(residuals: SensorResiduals, true: Hypothesis, value: Array) -> SensorResiduals:
    """Return residuals with an effect of parameters `value` (k,) put in."""
    views = (
        of_same_noise(replace(v, y=v.y + c @ value), v)
        for v, c in zip(residuals.views, true.columns, strict=True)
    )
    return replace(residuals, views=tuple(views))


def fitted(residuals: SensorResiduals, effect: Effect) -> Estimate:
    """Return an effect's estimate, about its likeliest grid point."""
    empty = reduce_residuals(residuals)
    tried = [*proposals(residuals, [effect]), *screened(residuals, [effect], empty, [])]
    reduced = reduce_residuals(residuals, tried)
    best = tried[int(np.argmax([highest(reduced, i) for i in range(len(tried))]))]
    return estimate(residuals, estimate(residuals, best, []).hypothesis, [])


def ranks(residuals: SensorResiduals, effect: Effect, rng: np.random.Generator) -> Array | None:
    """Return the posterior probability (k,) of values below the true ones; None where it does not show.

    What is not significant is not stated: the fit puts a jump that is too small at any jump of the noise.
    """
    from scipy.special import ndtr  # noqa: PLC0415 - as in the diagnosis

    made = drawn(residuals, effect, rng)
    if made is None:
        return None
    found = fitted(with_effect(residuals, *made), effect)
    if found.chance() >= CHANCE:
        return None
    return np.asarray(ndtr((made[1] - found.value) / np.maximum(found.sigma, 1e-300)))


def of_trial(trial: int, seed: int) -> Iterator[tuple[str, Array]]:
    """Yield each slow effect that a day can show with its ranks."""
    rng = np.random.default_rng([seed, trial])
    for residuals in residuals_of(trial, seed):
        for effect in own_effects():
            if effect.sensor != residuals.sensor or effect.in_turns != bool(residuals.turns):
                continue
            seen = cold(residuals) if effect.name == "thermal_latent" else residuals
            found = ranks(seen, effect, rng)
            if found is not None:
                degree = f", degree {len(effect.parameters)}" if len(effect.parameters) > 1 else ""
                yield f"{effect.name} ({effect.sensor}{degree})", found


def chi_squared(found: Array) -> float:
    """Return the probability of ranks (n,) as uneven as these by chance."""
    from scipy.special import chdtrc  # noqa: PLC0415 - as in the diagnosis

    counts = np.histogram(found, CLASSES, (0.0, 1.0))[0]
    expected = found.size / CLASSES
    return float(chdtrc(CLASSES - 1.0, float(((counts - expected) ** 2).sum() / expected)))


@click.command()
@click.option("--trials", type=click.IntRange(min=1), default=30, show_default=True, help="Number of days.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of all draws.")
def main(trials: int, seed: int) -> None:
    """Print for every slow effect how uniform the ranks of true parameters in their posteriors are."""
    every: dict[str, list[Array]] = defaultdict(list)
    for trial in range(trials):
        for name, found in of_trial(trial, seed):
            every[name].append(found)
    click.echo("| effect | days | ranks | classes of ten | p | inside 90 % |\n|---|---|---|---|---|---|")
    for name, parts in every.items():
        found = np.concatenate(parts)
        counts = " ".join(str(n) for n in np.histogram(found, CLASSES, (0.0, 1.0))[0])
        enough = found.size >= LEAST * CLASSES
        p = f"{chi_squared(found):.3f}" if enough else "too few"
        inside = float(((found > 0.05) & (found < 0.95)).mean())
        click.echo(f"| {name} | {len(parts)} | {found.size} | {counts} | {p} | {inside:.0%} |")


if __name__ == "__main__":
    main()
