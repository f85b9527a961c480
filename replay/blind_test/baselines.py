"""Two baselines that answer in the same layout: forward selection by BIC, and sparse regression.

Both use ten-second means of rests, with the affine errors taken off, and covariates. Both know that noise has
a colour: a part of it with a correlation time, fitted by its likelihood, by which everything is whitened.
This is what a competent engineer would try. They find slow biases only; noise, values, stamps and motion are
not examined.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.events import Charging
from stillcal.replay.formats.trace import Recording

Rows = NDArray[np.intp]

WINDOW_S = 10.0
"""Length of a window, s."""

TAUS_S = (100.0, 300.0, 1000.0)
"""Time constants of a warm-up that are tried, s."""

STEPS = 15
"""Number of times at which a step is tried."""

LEAST_WINDOWS = 16
"""Fewer still windows leave too little beside the nine columns of the affine calibration."""

MOST = 3
"""Most effects that forward selection takes for each sensor."""

TAUS_OF_NOISE_S = (40.0, 200.0, 1000.0)
SHARES_OF_NOISE = (0.0, 0.1, 0.5, 2.0, 10.0, 50.0)
"""Correlation times of slow noise that are tried, s, and its variance in units of a window's own."""

RIDGE = 0.01
"""Ridge on standardised columns."""

FOLDS = 5
"""Blocks of the cross-validation."""

THRESHOLDS = (0.05, 0.1, 0.2, 0.4, 0.8, np.inf)
"""Standardised coefficients below which a term is dropped: the largest within one standard error of the
best in cross-validation (Hastie, Tibshirani and Friedman 2009, 7.10). Infinity keeps no term."""


@dataclass(frozen=True, slots=True, eq=False)
class StillWindows:
    """The m static windows of a recording.

    t: (m,) s. up: (m, 3) unit direction of gravity. norm: (m,) m/s^2, norm of the force minus gravity. rate:
    (m, 3) rad/s, None without a gyroscope. g: m/s^2, gravity. baseline: (m, 9) columns of bias, scale and
    misalignment in the norm. drivers: covariates (m,) by name.
    """

    t: Array
    up: Array
    norm: Array
    rate: Array | None
    g: float
    baseline: Array
    drivers: dict[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A hypothesis: an effect's regressors, columns (m, k), for one sensor.

    parameter, unit: of the coefficients. fixed: parameters that are not fitted, by name.
    """

    effect: str
    sensor: str
    driver: str
    parameter: str
    unit: str
    columns: Array
    fixed: dict[str, float]


def still_windows(recording: Recording) -> StillWindows | None:
    """Return the still windows of a recording, None where there are too few."""
    accel, gyro = recording.accelerometer, recording.gyroscope
    window = np.floor(accel.t / WINDOW_S).astype(np.int64)
    kinds, first, counts = np.unique(window, return_index=True, return_counts=True)
    mean, spread = _moments(accel.xyz, first, counts)
    rate = _moments(gyro.xyz, first, counts)[0] if gyro is not None and len(gyro) == len(accel) else None
    still = (spread < 2.0 * np.quantile(spread, 0.2)) & (counts > 0.8 * np.median(counts))
    if still.sum() < LEAST_WINDOWS:
        return None
    t, mean = np.asarray(kinds[still] + 0.5, dtype=np.float64) * WINDOW_S, mean[still]
    g = recording.claims.gravity or 9.80665
    length = np.linalg.norm(mean, axis=1)
    up = mean / length[:, None]
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    baseline = np.column_stack([up, *(up[:, i] * up[:, j] for i, j in pairs)])
    warmth = None if accel.temperature is None else _moments(accel.temperature[:, None], first, counts)[0]
    temperature = None if warmth is None else warmth[still][:, 0]
    return StillWindows(
        t,
        up,
        length - g,
        None if rate is None else rate[still],
        g,
        baseline,
        _drivers(t, temperature, [e for e in recording.events if isinstance(e, Charging)]),
    )


def _moments(values: Array, first: Rows, counts: Rows) -> tuple[Array, Array]:
    """Return means (w, k) and the largest standard deviation (w,) of consecutive groups of rows."""
    mean = np.add.reduceat(values, first, axis=0) / counts[:, None]
    square = np.add.reduceat(values**2, first, axis=0) / counts[:, None]
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0)).max(axis=1)


def _drivers(t: Array, temperature: Array | None, charging: list[Charging]) -> dict[str, Array]:
    drivers = {"time": t, **{f"warmup {tau:g}": -np.expm1(-t / tau) for tau in TAUS_S}}
    if temperature is not None and np.ptp(temperature) > 0.2:
        drivers["temperature"] = temperature - temperature.mean()
    if charging:
        times, on = np.array([e.t for e in charging]), np.array([float(e.on) for e in charging])
        index = np.searchsorted(times, t, side="right") - 1
        drivers["charging"] = np.where(index >= 0, on[np.maximum(index, 0)], 1.0 - on[0])
    for at in np.quantile(t, np.linspace(0.1, 0.9, STEPS)):
        drivers[f"step {at:g}"] = (t >= at).astype(np.float64)
    return {name: course for name, course in drivers.items() if np.ptp(course) > 0.0}


_NAMES = {
    "temperature": ("bias_temperature", "slope", "/K"),
    "time": ("bias_drift", "rate", "/s"),
    "charging": ("charging_bias", "step", ""),
    "warmup": ("warmup", "amplitude", ""),
    "step": ("bias_step", "step", ""),
}


def candidates(windows: StillWindows, sensor: str) -> list[Candidate]:
    """Return all hypotheses about a sensor; a gyroscope's columns are those of one axis."""
    unit = "m/s^2" if sensor == "accel" else "rad/s"
    hypotheses = []
    for driver, course in windows.drivers.items():
        kind, _, shape = driver.partition(" ")
        name, parameter, per = _NAMES[kind]
        columns = windows.up * course[:, None] if sensor == "accel" else course[:, None]
        fixed = (
            {"tau_s": float(shape)} if kind == "warmup" else {"at_s": float(shape)} if kind == "step" else {}
        )
        hypotheses.append(Candidate(f"{sensor}_{name}", sensor, kind, parameter, unit + per, columns, fixed))
    if sensor == "gyro":
        matrix = windows.g * windows.up
        return [
            *hypotheses,
            Candidate("gyro_g_sensitivity", "gyro", "gravity", "matrix", "(rad/s)/(m/s^2)", matrix, {}),
        ]
    if "temperature" in windows.drivers:
        columns = windows.g * windows.up**2 * windows.drivers["temperature"][:, None]
        hypotheses.append(
            Candidate("accel_scale_temperature", "accel", "temperature", "slope", "1/K", columns, {})
        )
    cube = windows.up * (windows.g * windows.up) ** 2
    return [
        *hypotheses,
        Candidate("accel_nonlinearity", "accel", "gravity", "quadratic", "1/(m/s^2)", cube, {}),
    ]


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A candidate's coefficients (k, channels) with their standard errors."""

    candidate: Candidate
    values: Array
    errors: Array


def _channels(windows: StillWindows, sensor: str) -> tuple[Array, Array]:
    """Return a sensor's values (m, channels) and what calibration takes off (m, p)."""
    if sensor == "accel":
        return windows.norm[:, None], windows.baseline
    assert windows.rate is not None, "a gyroscope is only asked about where there is one"
    return windows.rate, np.ones((windows.t.size, 1))


def _solved(design: Array, values: Array) -> tuple[Array, float]:
    """Return least-squares coefficients and the residual sum of squares."""
    coefficients = np.asarray(np.linalg.lstsq(design, values, rcond=1e-9)[0], dtype=np.float64)
    return coefficients, float(((values - design @ coefficients) ** 2).sum())


def _whitener(t: Array, design: Array, values: Array) -> Array:
    """Return the matrix (m, m) that whitens windows at t (m,) s, by the likeliest noise of those tried.

    The noise is white plus one that forgets exponentially, left by a design (m, k) of values (m, channels).
    """
    lag = np.abs(t[:, None] - t[None, :])
    best, chosen = np.inf, np.eye(t.size)
    for tau in TAUS_OF_NOISE_S:
        for share in SHARES_OF_NOISE:
            root = np.linalg.cholesky(np.eye(t.size) + share * np.exp(-lag / tau))
            inverse = np.linalg.inv(root)
            rss = _solved(inverse @ design, inverse @ values)[1]
            loss = values.size * float(np.log(max(rss, 1e-300)))
            loss += 2.0 * values.shape[1] * float(np.log(np.diag(root)).sum())
            if loss < best:
                best, chosen = loss, inverse
    return np.asarray(chosen)


def _bic(rss: float, n: int, parameters: int) -> float:
    """Return Schwarz's criterion of whitened values of unknown variance (Schwarz 1978)."""
    return n * float(np.log(max(rss, 1e-300) / n)) + parameters * float(np.log(n))


def by_bic(recording: Recording, name: str) -> dict[str, Any]:
    """Answer by forward selection under coloured noise, as long as BIC falls."""
    return _answer(recording, name, _forward)


def _forward(windows: StillWindows, sensor: str) -> list[Fitted]:
    values, base = _channels(windows, sensor)
    design, chosen, pool = base, list[Candidate](), candidates(windows, sensor)
    while True:
        white = _whitener(windows.t, design, values)
        free, target = white @ design, white @ values
        score = _candidate_bic(free, target, shaped=False)
        scores = [_candidate_bic(np.hstack([free, white @ c.columns]), target, bool(c.fixed)) for c in pool]
        best = int(np.argmin(scores)) if scores else 0
        if not scores or len(chosen) == MOST or scores[best] >= score:
            return _fits(chosen, base, values, white)
        design = np.hstack([design, pool[best].columns])
        chosen.append(pool[best])
        pool = [c for c in pool if c.effect != pool[best].effect]


def _candidate_bic(design: Array, values: Array, shaped: bool) -> float:
    rss = _solved(design, values)[1]
    return _bic(rss, values.size, _rank(design) * values.shape[1] + shaped)


def _rank(design: Array) -> int:
    return int(np.linalg.matrix_rank(design, rtol=1e-9))


def _fits(chosen: list[Candidate], base: Array, values: Array, white: Array) -> list[Fitted]:
    """Fit all chosen candidates together, whitened."""
    base, values = white @ base, white @ values
    design = np.hstack([base, *(white @ c.columns for c in chosen)])
    coefficients, rss = _solved(design, values)
    n = values.size
    spread = np.sqrt(
        rss / max(n - design.shape[1], 1) * np.diag(np.linalg.pinv(design.T @ design, rtol=1e-12))
    )
    fits, at = [], base.shape[1]
    for candidate in chosen:
        rows = slice(at, at + candidate.columns.shape[1])
        errors = np.repeat(spread[rows, None], values.shape[1], axis=1)
        fits.append(Fitted(candidate, coefficients[rows], errors))
        at = rows.stop
    return fits


def by_sparse_regression(recording: Recording, name: str) -> dict[str, Any]:
    """Answer by sequentially thresholded least squares over all columns at once (Brunton et al. 2016)."""
    return _answer(recording, name, _sparse)


def _sparse(windows: StillWindows, sensor: str) -> list[Fitted]:
    values, base = _channels(windows, sensor)
    pool = candidates(windows, sensor)
    columns = np.hstack([c.columns for c in pool])
    owner = np.repeat(np.arange(len(pool)), [c.columns.shape[1] for c in pool])
    # The noise is what all columns together leave, or it would take a strong effect for its own.
    white = _whitener(windows.t, np.hstack([base, columns]), values)
    free = _without(white @ base, white @ columns)
    target = _without(white @ base, white @ values)
    free, target = free / (free.std(axis=0) + 1e-12), target / (target.std(axis=0) + 1e-12)
    chosen = [owner[_sparsest(free, target[:, channel, None])] for channel in range(target.shape[1])]
    names = {pool[i].effect: pool[i] for i in np.concatenate(chosen)}
    return _fits(list(names.values()), base, values, white)


def _sparsest(design: Array, target: Array) -> Rows:
    """Return the columns that the sparsest model of one channel (m, 1) keeps, within an error of the best."""
    losses = np.array([_cross_validated_losses(design, target, threshold) for threshold in THRESHOLDS])
    best = int(np.argmin(losses.mean(axis=1)))
    bound = losses[best].mean() + losses[best].std(ddof=1) / np.sqrt(FOLDS)
    sparsest = int(np.flatnonzero(losses.mean(axis=1) <= bound)[-1])
    return np.flatnonzero(_thresholded(design, target, THRESHOLDS[sparsest]).any(axis=1))


def _without(base: Array, values: Array) -> Array:
    return np.asarray(values - base @ np.linalg.lstsq(base, values, rcond=1e-9)[0])


def _ridged(design: Array, target: Array) -> Array:
    """Return ridge coefficients, as thresholding among look-alikes needs (Rudy et al. 2017, STRidge)."""
    normal = design.T @ design + RIDGE * len(design) * np.eye(design.shape[1])
    return np.asarray(np.linalg.solve(normal, design.T @ target))


def _thresholded(design: Array, target: Array, threshold: float) -> Array:
    """Return which coefficients (k, channels) remain after ten rounds of least squares and thresholding."""
    selected = np.ones((design.shape[1], target.shape[1]), dtype=np.bool_)
    for _ in range(10):
        for channel in range(target.shape[1]):
            rows = np.flatnonzero(selected[:, channel])
            selected[rows, channel] = np.abs(_ridged(design[:, rows], target[:, channel])) >= threshold
    return np.asarray(selected)


def _cross_validated_losses(design: Array, target: Array, threshold: float) -> Array:
    """Return the mean square left on each left-out block, in units of what there was on average."""
    losses = []
    for block in np.array_split(np.arange(len(target)), FOLDS):
        inside = np.delete(np.arange(len(target)), block)
        selected = _thresholded(design[inside], target[inside], threshold)
        residual = target[block].copy()
        for channel in range(target.shape[1]):
            rows = np.flatnonzero(selected[:, channel])
            solved = _ridged(design[np.ix_(inside, rows)], target[inside, channel])
            residual[:, channel] -= design[np.ix_(block, rows)] @ solved
        losses.append(float((residual**2).mean() / (target**2).mean()))
    return np.array(losses)


def _answer(
    recording: Recording, name: str, select: Callable[[StillWindows, str], list[Fitted]]
) -> dict[str, Any]:
    windows = still_windows(recording)
    sensors = [] if windows is None else ["accel"] + (["gyro"] if windows.rate is not None else [])
    findings = [_finding(f, windows) for s in sensors if windows is not None for f in select(windows, s)]
    return {
        "schema": 2,
        "recording": name,
        "simulation": "built-in",
        "verdict": "identified" if findings else "match",
        "findings": findings,
    }


def _finding(fitted: Fitted, windows: StillWindows) -> dict[str, Any]:
    c = fitted.candidate
    values, errors = fitted.values, fitted.errors
    if c.parameter == "matrix":
        values, errors = values.T, errors.T
    else:
        values, errors = values.ravel(), errors.ravel()
    spread = 1.96 * errors
    size = np.abs(values / np.maximum(errors, 1e-300)).reshape(3, -1).max(axis=1)
    interval = np.stack([values - spread, values + spread], axis=-1)
    parameters: dict[str, Any] = {
        c.parameter: {"value": values.tolist(), "ci95": interval.tolist(), "unit": c.unit},
        **{key: {"value": value, "ci95": None, "unit": "s"} for key, value in c.fixed.items()},
    }
    return {
        "effect": c.effect,
        "sensor": c.sensor,
        "axes": [axis for axis, s in zip("xyz", size, strict=True) if s > 2.6],
        "where": {
            "t_start": c.fixed.get("at_s", float(windows.t[0])),
            "t_end": float(windows.t[-1]),
            "band_hz": [0.0, 0.05],
            "driver": c.driver,
        },
        "parameters": parameters,
        "alternatives": [],
        "statement": f"{c.effect} by {c.driver}",
    }


SOLVERS: dict[str, Callable[[Recording, str], dict[str, Any]]] = {
    "affine_coloured_bic": by_bic,
    "sparse_regression": by_sparse_regression,
}
"""The baselines by name."""
