"""The diagnosis of a table of rests: how gravity's norm and the rate at rest depart from ideal sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.effects.followed import follows_time
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.records import Claims, Finding
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.model.settings import LEAST_BINS
from stillcal.calib_core.diagnosis.segments.merged_rests import merged, rising
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.thermometer import reconstructed
from stillcal.calib_core.diagnosis.slow.about_force import about_nonlinearity, searched
from stillcal.calib_core.diagnosis.slow.search import forward
from stillcal.calib_core.diagnosis.slow.standing import statements_of
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.temperature.charger import FULL_K
from stillcal.replay.diagnosis.answer import Fit, answer_of
from stillcal.replay.diagnosis.phone.phone_effects import map_findings
from stillcal.replay.diagnosis.phone.twin import conditions_of, fit_affine
from stillcal.replay.diagnosis.words.names import BUILT_IN
from stillcal.replay.diagnosis.words.relation_text import told_of_sensor
from stillcal.replay.formats.checks.units import DEGREE
from stillcal.replay.formats.rest_table import rounding_sd

LEAST_UNCERTAINTY = 1e-4
"""m/s^2: the least uncertainty of a row's mean specific force, whether a table states less or none."""

LEAST_RATE_UNCERTAINTY = 1e-6
"""rad/s, 0.2 deg/h: the same of its mean rate, whose bias wanders by more from rest to rest in any phone."""

LEAST_ROWS = 7
"""Fewer rests than the affine accelerometer has parameters to spare show nothing beyond it."""


def diagnose_kept(rests: Sequence[RestState], name: str) -> dict[str, Any]:
    """Return what the rests show that a daemon has kept, in words about the sensor: nobody simulated it.

    Raises NotSupported as `diagnose_rests`.
    """
    answer = diagnose_rests(rests, name)
    return answer | {"findings": [finding | told_of_sensor(finding) for finding in answer["findings"]]}


def diagnose_rests(rests: Sequence[RestState], name: str, claims: Claims | None = None) -> dict[str, Any]:
    """Return what a table of rests shows, as plain values.

    Raises NotSupported with fewer than `LEAST_ROWS` rows.
    """
    if len(rests) < LEAST_ROWS:
        raise NotSupported(f"{len(rests)} rests", (f"at least {LEAST_ROWS}, in different attitudes",))
    claims, timed = claims or Claims(), _timed(rests)
    exam = _examined(merged(rest_bins(_with_temperature(rests))), claims, timed=timed)
    before = compare_with_ideal(exam)
    fit = Fit.of(before, before)
    if before.discrepancies:
        findings = [d.recorded for d in before.discrepancies if d.recorded is not None]
        corrected, left_out = _without_effects(exam.bins, findings, claims.gravity)
        fit = Fit.of(before, compare_with_ideal(_examined(corrected, claims, timed=timed)), left_out)
    return answer_of(before, (name, BUILT_IN), fit, {}, exam.bins.temperature)


def _with_temperature(rests: Sequence[RestState]) -> Sequence[RestState]:
    """Return the rests whose temperature is known where enough are such; one without would cost them all.

    Half of a short table and a quarter of a long one are enough: what follows temperature would have no name.
    """
    known = [r for r in rests if r.temperature is not None]
    enough = max(LEAST_ROWS, min(LEAST_BINS, len(rests) / 2), len(rests) / 4)
    return known if len(known) >= enough else rests


def told_of_temperatures(rests: Sequence[RestState]) -> list[str]:
    """Return what is to be said where only some rests have a temperature, a line each."""
    missing = sum(r.temperature is None for r in rests)
    if missing in (0, len(rests)):
        return []
    used = _with_temperature(rests) is not rests
    what = "these are left out" if used else "too few have one, so temperatures are not used"
    return [f"{missing} of {len(rests)} rests have no temperature: {what}"]


def _without_effects(bins: Bins, findings: Sequence[Finding], gravity: float) -> tuple[Bins, list[str]]:
    """Return the table without what the effects found add to it, and the effects that have no equation.

    What an ideal sensor leaves of this is what a simulation with these effects leaves of the table: both are
    linear in them.
    """
    conditions = conditions_of(bins)
    mapped = map_findings(findings, bins, conditions)
    effects = [m.effect for m in mapped if m.effect is not None]
    affine = fit_affine(bins, effects, conditions, gravity)
    rate = None if bins.rate is None else bins.rate - affine.gyro
    left_out = [m.finding.effect for m in mapped if m.effect is None]
    return replace(bins, force=bins.force - affine.accel, rate=rate), left_out


def rest_bins(rests: Sequence[RestState]) -> Bins:
    """Return a table of rests as bins in order of time, one a row: no vibration, no motion, each row a rest.

    Rows without a duration count as one second. Of rows at the same time the later ones are a little later.
    What a coarse thermometer rounded is undone where the rows have times.
    """
    rests = sorted(rests, key=lambda r: r.t_start)
    start = np.array([r.t_start for r in rests])
    duration = np.maximum([r.duration for r in rests], 1.0)
    rate = _stacked([r.rate for r in rests])
    rounding = 0.0 if rate is None else max(u * rounding_sd(rate / u) for u in (1.0, DEGREE))
    warm = _stacked([r.temperature for r in rests])
    return Bins(
        t=rising(start + duration / 2.0),
        duration=duration,
        rest=np.arange(len(rests)),
        force=np.array([r.specific_force for r in rests]),
        force_variance=np.maximum(np.array([r.force_uncertainty for r in rests]), LEAST_UNCERTAINTY) ** 2,
        vibration=np.ones(len(rests)),
        activity=np.stack([start, np.zeros(len(rests))], axis=1),
        span=(float(start.min()), float((start + duration).max())),
        rate=rate,
        rate_variance=None if rate is None else _variances(rests, rounding),
        rate_rounding=None if rate is None else np.full(3, rounding),
        temperature=None if warm is None else reconstructed(start, warm) if _timed(rests) else warm,
        charging=_charging(rests),
    )


def _charging(rests: Sequence[RestState]) -> Array | None:
    """Return 1 on the charger and 0 off it, (n,); None where that is not known of every rest."""
    charged = _stacked([None if r.charged is None else r.charged[0] for r in rests])
    return None if charged is None or np.isnan(charged).any() else charged / FULL_K


def _stacked(values: Sequence[Array | float | None]) -> Array | None:
    return None if any(v is None for v in values) else np.array(values, dtype=np.float64)


def _variances(rests: Sequence[RestState], rounding: float) -> Array:
    """Return the variances (n, 3) of the mean rates beside that of their rounding, which stands by itself."""
    uncertainty = _stacked([r.rate_uncertainty for r in rests])
    square = 0.0 if uncertainty is None else uncertainty**2 - rounding**2
    return np.maximum(square, LEAST_RATE_UNCERTAINTY**2)


def _examined(bins: Bins, claims: Claims, *, timed: bool) -> Examination:
    """Return the examination of a table: slow effects only, and no samples."""
    none = Samples.checked(Sensor.ACCELEROMETER, np.empty(0), np.empty((0, 3)))
    made = about_nonlinearity(by_sensor(bins, claims.gravity))
    statements: list[Stated] = []
    for done, residuals in enumerate(made):
        made[done], found = searched(residuals, partial(_stated, timed=timed))
        statements += found
    gyroscope = None if bins.rate is None else replace(none, sensor=Sensor.GYROSCOPE)
    return Examination(none, gyroscope, claims, bins, [], made, None, None, statements, timed)


def _stated(residuals: SensorResiduals, *, timed: bool) -> list[Stated]:
    """Return what the rows show of one sensor; without times nothing that follows time is looked for."""
    effects = [e for e in effects_of(residuals.sensor) if timed or not follows_time(e.follows)]
    return statements_of(residuals, forward(residuals, effects))


def _timed(rests: Sequence[RestState]) -> bool:
    """Whether rows have a time of their own: those without are numbered."""
    return any(r.t_start != i for i, r in enumerate(rests))
