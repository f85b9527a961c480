"""What not knowing the noise costs: the gain of an observer who knows an effect's exact course.

    stillcal prove --trials 240 --seed 20261201 --keep FOLDER --stage recordings
    python -m tests.support.diagnosis.known_course FOLDER

In every recording of a slow effect its true course is put in at several d', and the log likelihood compared
with that of no effect, the noise averaged over all its shapes in both. Only the course's size is fitted. Then
the same for a ramp in white noise against a random walk of the likeliest strength.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from stillcal.calib_core.diagnosis.effects.catalogue import effects_in
from stillcal.calib_core.diagnosis.inference.likelihood import highest, null_log_likelihood, reduce_residuals
from stillcal.calib_core.diagnosis.inference.score import degrees, score
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect, Linear
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Parameters, SensorResiduals
from stillcal.replay.blind_test.keys import Key, key_of
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.formats.trace import read_all

Array = np.ndarray
SIZES = (6.0, 7.0, 8.0, 10.0, 12.0, 16.0, 20.0)


def courses(folder: Path) -> Iterator[tuple[SensorResiduals, Hypothesis, Effect, float]]:
    """Yield the residuals of every slow effect that is alone on its sensor, its true course, and its d'."""
    for path in sorted((folder / "keys").glob("*.key")):
        key = key_of(path.read_bytes().partition(b"\n")[2], path.name)
        if key.kind not in ("single", "pair") or key.exam is None:
            continue
        sensors = [e.sensor for e in key.effects]
        sensors = None
        for truth in key.effects:
            if sensors.count(truth.sensor) > 1 or not truth.d_prime:
                continue
            if sensors is None:
                recording = read_all(folder / "recordings" / f"{path.stem}.csv")
                sensors = examined(recording, sought=()).sensors
            for residuals in sensors:
                named = [
                    e for e in effects_in(residuals) if e.name == truth.effect and e.sensor == truth.sensor
                ]
                if named and truth.effect != "accel_nonlinearity":  # not proportional to its own size
                    yield residuals, course(residuals, key), named[0], truth.d_prime


def course(residuals: SensorResiduals, key: Key) -> Hypothesis:
    """Return what was truly added to a sensor as one hypothesis of one size."""
    assert key.exam is not None
    added = np.asarray(getattr(key.exam, residuals.sensor))
    curve = np.stack([np.interp(residuals.bins.t, key.exam.t, a) for a in added.T], axis=1)
    one = Parameters("course", residuals.sensor, (Linear("size", "1", 1, 3.0),))
    return Hypothesis(one, {}, residuals.columns_of(curve[:, :, None]))


def resized(residuals: SensorResiduals, true: Hypothesis, factor: float) -> SensorResiduals:
    """Return a sensor's residuals in which the true course is `factor` times as large."""
    changed = [
        replace(v, y=v.y + (factor - 1.0) * c[:, :, 0])
        for v, c in zip(residuals.views, true.columns, strict=True)
    ]
    for new, old in zip(changed, residuals.views, strict=True):
        new.memo.update(old.memo)
    return replace(residuals, views=tuple(changed))


def passes(gain: float, dof: float, residuals: SensorResiduals, effect: Effect) -> bool:
    """Whether the effect, on its axes and its own grid, would score enough with this gain."""
    many = effect.dictionary(residuals.moments)
    tried = 2.0 * max(1 if many is None else many.multiplicity, len(residuals.hypotheses(effect)))
    return score(gain, effect.parameters[0].count, dof, tried) - effect.prior_penalty >= thresholds.SCORE


def ramp_against_walk(d: float, n: int = 75, trials: int = 20) -> float:
    """Return the mean gain of a known ramp of d' `d` in n bins of white noise over the likeliest walk."""
    rng, walk = np.random.default_rng(0), np.minimum.outer(np.arange(1.0, n + 1), np.arange(1.0, n + 1))
    shapes = [np.eye(n) + q * walk for q in 10.0 ** np.arange(-5.0, 1.1, 0.25)]
    ramp = np.linspace(-1.0, 1.0, n)
    ramp *= d / np.linalg.norm(ramp)
    gains = []
    for _ in range(trials):
        noise = rng.normal(size=n)
        gains.append(max(_log(noise, c) for c in shapes) - max(_log(noise + ramp, c) for c in shapes))
    return float(np.mean(gains))


def _log(y: Array, shape: Array) -> float:
    """Return the restricted log likelihood of y about an unknown constant."""
    lower = np.linalg.cholesky(shape)
    both = np.linalg.solve(lower, np.column_stack([y, np.ones(y.size)]))
    one = both[:, 1] / np.linalg.norm(both[:, 1])
    left = both[:, 0] - one * (one @ both[:, 0])
    return float(-np.log(lower.diagonal()).sum() - np.log(np.linalg.norm(both[:, 1])) - 0.5 * left @ left)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    gains: dict[float, list[float]] = {d: [] for d in SIZES}
    seen: dict[float, list[tuple[bool, bool]]] = {d: [] for d in SIZES}
    for residuals, true, effect, d_prime in courses(folder):
        for d in SIZES:
            reduced = reduce_residuals(resized(residuals, true, d / d_prime), [true])
            gain, dof = highest(reduced, 0) - null_log_likelihood(reduced), degrees(reduced, 0)
            gains[d].append(gain)
            seen[d].append(
                (passes(gain, dof, residuals, effect), passes(d * d / 2.0, dof, residuals, effect))
            )
    for d in SIZES:
        unknown, known = np.mean(seen[d], axis=0)
        print(
            f"d' {d:4.1f}: gains {d * d / 2:5.1f} nats if the noise is known and passes {known:.0%}; if not,"
            f" a median of {np.median(gains[d]):.1f} in {len(gains[d])} and passes {unknown:.0%};"
            f" a ramp over a walk {ramp_against_walk(d):.1f}"
        )


if __name__ == "__main__":
    main()
