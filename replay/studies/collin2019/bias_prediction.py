"""Predicting a 1/f bias by autoregressive models of finite order.

Collin et al. 2019, 2.1.3: Markov processes are suboptimal for 1/f noise, whose optimal model has infinitely
many states. The 1/f process is made here by its own definition (fractional integration of white noise by one
half; Kasdin 1995), not by the simulated phone's bank of Markov processes. Theory: Hosking 1981.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.formats.trace import open_trace
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import (
    Cause,
    Claim,
    Evidence,
    Progress,
    Study,
    Verdict,
    holds,
    picture,
    table,
)

NAME, TITLE, WORK, WHERE = "bias-prediction", "Predicting a 1/f bias", "Collin 2019", "2.1.3"
ORDERS = (1, 2, 4, 8, 16, 32)
RECORDING, SPAN_S, MEMORY, BLOCKS = "sunsided/still_10min.csv.gz", 1.0, 8, 12
"""A real gyroscope at rest; s that its rates are averaged over; values remembered; parts of the trial."""

STEPS, RUNS = 2**16, 24


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """Variance of one-step prediction over that of the driving noise.

    last: (runs,) where the next value is taken to be the last one (random walk). models: (runs, orders), by
    ORDERS, fitted to the first half of a run and tried on the second.
    """

    last: Array
    models: Array


def one_over_f(n: int, rng: np.random.Generator) -> Array:
    """Return n values of 1/f noise driven by unit white noise, after n others that let it settle.

    Its weights are those of (1 - B)^(-1/2): h(0) = 1, h(k) = h(k - 1) (k - 1/2) / k.
    """
    from scipy.signal import fftconvolve  # noqa: PLC0415 - for those who evaluate

    k = np.arange(1, 2 * n)
    weights = np.r_[1.0, np.cumprod((k - 0.5) / k)]
    return np.asarray(fftconvolve(rng.standard_normal(2 * n), weights)[n : 2 * n])


def theory(order: int) -> float:
    """Return the one-step variance of the best autoregressive model of so many values over the noise's.

    By the Durbin-Levinson recursion, with partial autocorrelations 1/2 / (k - 1/2), from the variance 4/pi of
    the process's own increments.
    """
    k = np.arange(2, order + 1)
    return float(4.0 / np.pi * np.prod(1.0 - (0.5 / (k - 0.5)) ** 2))


def predicted(runs: int, n: int, seed: int, progress: Progress) -> Predicted:
    """Fit and try the models on so many runs of n values."""
    last, models = [], []
    for run in range(runs):
        values = one_over_f(n, np.random.default_rng((seed, run)))
        half = n // 2
        last.append(float(np.mean(np.diff(values[half:]) ** 2)))
        models.append([_tried(values[:half], values[half:], order) for order in ORDERS])
        progress((run + 1) / runs)
    return Predicted(np.array(last), np.array(models))


def _tried(learn: Array, test: Array, order: int) -> float:
    """Fit an autoregressive model with a constant by least squares; return its squared error elsewhere."""
    past, future = _lagged(learn, order)
    coefficients = np.linalg.lstsq(past, future, rcond=None)[0]
    past, future = _lagged(test, order)
    return float(np.mean((future - past @ coefficients) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class Real:
    """Squared errors on the second half of a real recording over those of MEMORY values; each (3,), by axis.

    last: where the next value is taken to be the last one. one: of a fitted Gauss-Markov process. sure:
    (3, 2), the 95 % interval of the better of both, by parts of the half. together: neighbours' correlation.
    """

    last: Array
    one: Array
    sure: Array
    together: Array
    means: int


def on_real(data: Path) -> Real:
    """Predict the means over SPAN_S of a gyroscope at rest, from models fitted to the first half."""
    parts = [p.gyroscope for p in open_trace(data / RECORDING, "mpu6050").chunks()]
    rates = Samples.joined([p for p in parts if p is not None and len(p)])
    place = ((rates.t - rates.t[0]) / SPAN_S).astype(int)
    full = place < place[-1]
    count = np.maximum(np.bincount(place[full]), 1)
    means = np.stack([np.bincount(place[full], rates.xyz[full, k]) / count for k in range(3)], axis=1)
    half, rows = len(means) // 2, []
    for values in means.T:
        learn, test = values[:half], values[half - MEMORY :]
        squares = np.stack(
            [np.diff(test)[MEMORY - 1 :] ** 2, *(_squares(learn, test, p) for p in (1, MEMORY))]
        )
        blocks = np.stack([b.mean(axis=1) for b in np.array_split(squares, BLOCKS, axis=1)], axis=1)
        drawn = blocks[:, np.random.default_rng(0).integers(0, BLOCKS, (2000, BLOCKS))].mean(axis=2)
        last, one, many = squares.mean(axis=1)
        ends = np.percentile(drawn[:2].min(axis=0) / drawn[2], [2.5, 97.5])
        rows.append((last / many, one / many, *ends, np.corrcoef(values[1:], values[:-1])[0, 1]))
    found = np.array(rows)
    return Real(found[:, 0], found[:, 1], found[:, 2:4], found[:, 4], len(means))


def _squares(learn: Array, test: Array, order: int) -> Array:
    """Return squared errors of a model fitted to `learn` on `test`, whose first MEMORY values begin it."""
    past, future = _lagged(learn, order)
    coefficients = np.linalg.lstsq(past, future, rcond=None)[0]
    past, future = _lagged(test[MEMORY - order :], order)
    return np.asarray((future - past @ coefficients) ** 2)


def _lagged(values: Array, order: int) -> tuple[Array, Array]:
    """Return the last `order` values and a 1 before each value, (m, order + 1), and these values, (m,)."""
    past = np.lib.stride_tricks.sliding_window_view(values, order + 1)
    return np.column_stack((past[:, :-1], np.ones(len(past)))), past[:, -1]


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Predict 1/f noise by models of growing order, beside theory."""
    found = predicted(RUNS, STEPS, seed, progress)
    means, errors = found.models.mean(axis=0), found.models.std(axis=0, ddof=1) / np.sqrt(RUNS)
    rows = [
        (f"{order}", f"{mean:.4f} +- {error:.4f}", f"{theory(order):.4f}")
        for order, mean, error in zip(ORDERS, means, errors, strict=True)
    ]
    data_words = f"{RUNS} runs of {STEPS} values of fractional noise; fitted to one half, tried on the other"
    real = None if data is None else on_real(data)
    claims = (_suboptimal(found, data_words), _infinite(found, data_words), _real(real))
    file = _draw(means, errors, figures)
    text = "\n\n".join(
        [
            "One-step prediction of 1/f noise: variance of the error over that of the noise that drives the"
            " process, which a model with infinitely many states would reach. Taking the last value, as for a"
            f" random walk: {found.last.mean():.4f} (theory 4/pi = {4 / np.pi:.4f})."
            " Theory is of a process with an infinite past and no mean; a model fitted to a run knows the"
            " run's own mean, and lies below.",
            table(("values remembered", "variance", "theory"), rows),
            picture(file, "Excess of the prediction's variance by the number of values remembered"),
        ]
    )
    return Study(NAME, TITLE, claims, text, (file,), seed)


def _suboptimal(found: Predicted, data: str) -> Claim:
    best = found.models[:, -1]
    markov = np.minimum(found.last, found.models[:, 0])
    gain = markov / best
    error = float(gain.std(ddof=1) / np.sqrt(gain.size))
    return Claim(
        WORK,
        WHERE,
        "Markov processes are suboptimal for predicting 1/f noise",
        "suboptimal",
        f"their squared error is {gain.mean():.3f} +- {error:.3f} times that of {ORDERS[-1]} values",
        data,
        holds(bool(gain.mean() - 3.0 * error > 1.0)),
        "the better of random walk and fitted Gauss-Markov process; holds where three standard errors lie"
        f" above 1. Theory: {theory(1) / theory(ORDERS[-1]):.3f}",
        evidence=Evidence.SIMULATION,
    )


def _real(found: Real | None) -> Claim:
    claim = "Markov processes are suboptimal for predicting a real gyroscope's bias"
    if found is None:
        why = "the real recordings are not here (--data)"
        return Claim(
            WORK, WHERE, claim, "suboptimal", "", "none", Verdict.UNTESTED, why, evidence=Evidence.NONE
        )
    better = np.minimum(found.last, found.one)
    together = ", ".join(f"{axis} {value:+.2f}" for axis, value in zip("xyz", found.together, strict=True))
    return Claim(
        WORK,
        WHERE,
        claim,
        "suboptimal",
        ", ".join(
            f"{axis} {value:.2f} ({low:.2f} to {high:.2f})"
            for axis, value, (low, high) in zip("xyz", better, found.sure, strict=True)
        )
        + f" times that of {MEMORY} values",
        f"an MPU-6050 at rest for 11 min (sunsided): {found.means} means over {SPAN_S:g} s; fitted to one"
        " half, tried on the other",
        holds(bool((found.sure[:, 0] > 1.0).all())),
        "squared error of the better of random walk and fitted Gauss-Markov process, 95 % interval by"
        f" {BLOCKS} parts of the half; holds where it lies above 1 on every axis",
        evidence=Evidence.REAL,
        cause=Cause(
            f"neighbouring means correlate by {together}: where that is near zero the noise of a second is"
            " white, which nothing predicts, and a longer memory only has more to fit",
            shown=_only_where_correlated(found),
        ),
    )


def _only_where_correlated(found: Real) -> bool:
    """Return whether memory helps on the axes whose neighbouring means correlate the most, and only there."""
    helps = found.sure[:, 0] > 1.0
    return bool(helps.any() and found.together[helps].min() > found.together[~helps].max(initial=-1.0))


def _infinite(found: Predicted, data: str) -> Claim:
    falls = -np.diff(found.models, axis=1)
    means, errors = falls.mean(axis=0), falls.std(axis=0, ddof=1) / np.sqrt(len(falls))
    sure = int(np.sum(means > 3.0 * errors))
    return Claim(
        WORK,
        WHERE,
        "optimal modelling of 1/f noise takes infinitely many states",
        "infinite",
        f"{sure} of {means.size} doublings of the order lower the error, the last by {100 * means[-1]:.1f} %",
        data,
        holds(sure == means.size),
        "holds where each doubling up to 32 lowers it by more than three standard errors. By theory 1/(4 p)"
        f" is left with p values: {100 * (theory(ORDERS[-1]) - 1.0):.2f} % with 32, never zero",
        evidence=Evidence.SIMULATION,
    )


def _draw(means: Array, errors: Array, figures: Path) -> str:
    figure, (axis,) = drawing.panels(1)
    orders = np.arange(1, ORDERS[-1] + 1)
    axis.loglog(orders, [100.0 * (theory(int(p)) - 1.0) for p in orders], color="black", label="theory")
    axis.errorbar(
        ORDERS, 100.0 * (means - 1.0), 300.0 * errors, fmt="o", color=drawing.BLUE, label="measured, 3 errors"
    )
    axis.set(xlabel="values remembered", ylabel="excess of the variance, %")
    axis.legend()
    return drawing.save(figure, figures, NAME)
