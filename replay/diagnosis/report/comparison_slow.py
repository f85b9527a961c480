"""The slow half of the comparison: effects on bias, mean rate, slow scatter, affine calibration.

Coefficients are fitted to each recording with the coloured noise of the diagnosis, so that slow noise common
to both is not a difference.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Scene
from stillcal.calib_core.diagnosis.model.likelihood import fit_hypothesis
from stillcal.calib_core.diagnosis.model.residuals import View, fit_baseline, rest_means
from stillcal.calib_core.diagnosis.model.scenes import scenes
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.diagnosis.slow.search import reduce_scene

Row = tuple[str, str, float, float, str, float]
"""statistic, channel, recorded, simulated, unit, p."""

COMPARED_EFFECTS = (
    "bias_temperature", "scale_temperature", "warmup", "thermal_latent", "charging_bias", "bias_drift",
    "g_sensitivity", "nonlinearity",
)  # fmt: skip
"""Effects whose coefficients are compared, by the end of their names."""

PARAMETER_TOLERANCE = 3e-3
"""Standard deviation between phones of one make, as a share of a parameter's physical size."""

WANDER_TOLERANCE = 0.7
"""Difference of the logarithm of scatter that two draws of the same slow noise may have."""

CALIBRATION_TOLERANCE = 1e-3
"""Difference of two affine calibrations that does not count, relative to gravity."""

RATE_TOLERANCE = 2e-4
"""Difference of gyroscope biases that does not count, rad/s (0.011 deg/s)."""

THERMAL_EFFECTS = ("bias_temperature", "thermal_latent")
"""Effects that are fitted first, because charging, time and attitude may correlate with them."""

DIRECTION_VIEW = "turn"
"""The name of the residuals of gravity's direction after rotations, rad; others have the sensor's unit."""

TAU = 300.0
"""Time constant, s: of an effect's grid, the curve nearest to it is compared."""

LEAST_RESTS = 14
"""Rests that an affine calibration is compared from: its nine parameters and five more."""


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """The fitted coefficients of one effect. value: (k,), covariance: (k, k), in `unit`."""

    effect: str
    sensor: str
    value: Array
    covariance: Array
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class SlowSide:
    """The slow statistics of one recording, to be compared with another's.

    coefficients: by effect, sensor and time constant in s; empty where there are too few static bins.
    """

    bins: Bins
    gravity: float
    scenes: tuple[Scene, ...]
    coefficients: dict[tuple[str, str, float], Coefficients]


def slow_side(bins: Bins, gravity: float) -> SlowSide:
    """Return the slow statistics of a recording's static bins."""
    slow_scenes = scenes(bins, gravity) if len(bins) >= thresholds.LEAST_BINS else []
    coefficients = {key: c for scene in slow_scenes for key, c in _fitted_coefficients(scene)}
    return SlowSide(bins, gravity, tuple(slow_scenes), coefficients)


def slow_differences(recorded: SlowSide, simulated: SlowSide) -> list[Row]:
    """Return the comparisons of two recordings; none where either has too few still bins."""
    if not (recorded.scenes and simulated.scenes):
        return []
    both = recorded.coefficients.keys() & simulated.coefficients.keys()
    rows = [_wald(recorded.coefficients[key], simulated.coefficients[key]) for key in sorted(both)]
    for a, b in zip(recorded.scenes, simulated.scenes, strict=False):
        rows += _wander(a, b)
    return [*rows, *_calibration(recorded, simulated)]


def _fitted_coefficients(scene: Scene) -> Iterator[tuple[tuple[str, str, float], Coefficients]]:
    """Yield the coefficients of every effect compared; thermal ones first, then the others with them."""
    curves = [h for effect in effects_of(scene.sensor) for h in _proposed(effect, scene)]
    heat = [h for h in curves if h.effect.name.endswith(THERMAL_EFFECTS)][:1]
    others = [h for h in curves if h not in heat]
    for group, also_fitted in ((heat, []), (others, heat)):
        if not group:
            continue
        reduced = reduce_scene(scene, group, also_fitted)
        for index, h in enumerate(group):
            fit = fit_hypothesis(reduced, index)
            covariance = fit.covariance * np.outer(h.sizes, h.sizes) + np.diag(
                (PARAMETER_TOLERANCE * h.sizes) ** 2
            )
            unit = h.effect.parameters[0].unit
            key = (h.effect.name, scene.sensor, h.grid.get("tau_s", 0.0) + h.sizes.size)
            name = " and ".join(
                [h.effect.name, *(p.name for p in h.effect.parameters[1:] if p.name != "tau_s")]
            )
            yield key, Coefficients(name, scene.sensor, fit.beta * h.sizes, covariance, unit)


def _proposed(effect: Effect, scene: Scene) -> list[Hypothesis]:
    """Return an effect's hypothesis, of a grid the one of the middle time constant."""
    if not effect.name.endswith(COMPARED_EFFECTS):
        return []
    hypotheses = scene.hypotheses(effect)
    return sorted(hypotheses, key=lambda h: abs(h.grid.get("tau_s", TAU) - TAU))[:1]


def _wald(one: Coefficients, other: Coefficients) -> Row:
    """Compare two estimates by Wald's statistic."""
    from scipy.stats import chi2  # noqa: PLC0415 - the daemon stays light

    distance = one.value - other.value
    covariance = one.covariance + other.covariance
    p = float(chi2.sf(distance @ np.linalg.solve(covariance, distance), distance.size))
    worst = int(np.argmax(np.abs(one.value) / np.sqrt(one.covariance.diagonal())))
    axis = "xyz"[(worst // 3 if distance.size == 9 else worst) % 3]
    return one.effect, f"{one.sensor} {axis}", float(one.value[worst]), float(other.value[worst]), one.unit, p


def _wander(one: Scene, other: Scene) -> Iterator[Row]:
    """Compare the scatter of static bins about their mean, over the whole recording."""
    for a, b in zip(one.views, other.views, strict=False):
        if a.name != b.name:
            continue
        log_scatters = [np.log(max(_scatter(v), 1e-12)) for v in (a, b)]
        # Slow noise has few independent pieces however many bins: about ten determine its variance.
        error = np.sqrt(1.0 / 10.0)
        sigmas = max(abs(log_scatters[0] - log_scatters[1]) - WANDER_TOLERANCE, 0.0) / error
        from scipy.special import erfc  # noqa: PLC0415 - the daemon stays light

        p = float(erfc(sigmas / np.sqrt(2.0)))
        name = f"{one.sensor} {a.name.removeprefix('rate_')}"
        unit = "rad" if a.name == DIRECTION_VIEW else UNIT[one.sensor]
        yield (
            "scatter of still bins",
            name,
            float(np.exp(log_scatters[0])),
            float(np.exp(log_scatters[1])),
            unit,
            p,
        )


def _scatter(view: View) -> float:
    """Return the root mean square of a view's residuals, with the baseline phone projected out."""
    columns = [view.nuisance(b) for b in range(len(view.y))]
    residuals = [r - x @ np.linalg.lstsq(x, r, rcond=None)[0] for r, x in zip(view.y, columns, strict=True)]
    return float(np.sqrt(np.mean(np.square(residuals))))


def _calibration(recorded: SlowSide, simulated: SlowSide) -> Iterator[Row]:
    """Compare affine calibrations: whether one fits both recordings' rests as well as two do (Chow 1960)."""
    from scipy.stats import f as f_distribution  # noqa: PLC0415 - the daemon stays light

    sides = [_mean_of_rests(side.bins) for side in (recorded, simulated)]
    if min(len(force) for force, _ in sides) >= LEAST_RESTS:
        known = (recorded.gravity, simulated.gravity)
        gravity = sum(known) / 2.0
        force, variance = (np.concatenate([s[i] for s in sides]) for i in (0, 1))
        floor = (CALIBRATION_TOLERANCE * gravity) ** 2
        common_chi2 = _chi2(force, variance + floor, gravity)
        separate_chi2 = sum(_chi2(f, v + floor, g) for (f, v), g in zip(sides, known, strict=True))
        dof = len(force) - 18
        ratio = max(common_chi2 - separate_chi2, 0.0) / 9.0 / max(separate_chi2 / dof, 1.0)
        p = float(f_distribution.sf(ratio, 9, dof))
        norms = [float(np.median(np.linalg.norm(f, axis=1))) for f, _ in sides]
        yield "affine calibration, by norms of rests", "accel", norms[0], norms[1], "m/s^2", p
    one, other = recorded.bins.rate, simulated.bins.rate
    if one is not None and other is not None:
        yield from _mean_rates(one, other)


def _mean_of_rests(bins: Bins) -> tuple[Array, Array]:
    """Return the mean force (k, 3) of every rest and its white variance (k, 3)."""
    first = np.unique(bins.rest, return_index=True)[1]
    counts = np.bincount(bins.rest)[np.unique(bins.rest)][:, None]
    return rest_means(bins.force, bins.rest)[first], bins.force_variance[first] / counts


def _chi2(force: Array, variance: Array, gravity: float) -> float:
    fit = fit_baseline(force, variance, np.arange(len(force)), gravity)
    return float((((fit.norm - gravity) ** 2) / variance.mean(axis=1)).sum())


def _mean_rates(one: Array, other: Array) -> Iterator[Row]:
    """Compare the mean rate at rest; its error comes from ten spans of time, so slow noise is in it."""
    from scipy.stats import t as student  # noqa: PLC0415 - the daemon stays light

    for a, axis in enumerate("xyz"):
        parts = [np.array([p.mean() for p in np.array_split(b[:, a], 10)]) for b in (one, other)]
        error = np.hypot(*(p.std(ddof=1) / np.sqrt(10.0) for p in parts))
        distance = max(abs(parts[0].mean() - parts[1].mean()) - RATE_TOLERANCE, 0.0)
        p = 2.0 * float(student.sf(distance / error, 9))
        yield "mean rate at rest", f"gyro {axis}", float(parts[0].mean()), float(parts[1].mean()), "rad/s", p
