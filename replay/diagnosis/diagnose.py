"""From a recording, or a table of rests, to its diagnosis as plain values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.codec import plain
from stillcal.calib_core.diagnosis import diagnose as diagnosis
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.model.records import Claims, Diagnosis, Finding, verdict_of
from stillcal.calib_core.diagnosis.model.scenes import scenes
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.findings import findings_of
from stillcal.calib_core.diagnosis.slow.search import forward
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Charging
from stillcal.replay.diagnosis.coverage import Facts, checks, facts_of, limits
from stillcal.replay.formats.trace import Recording

LEAST_UNCERTAINTY = 1e-4
"""m/s^2: the least uncertainty of a row's mean specific force, whether a table states less or none."""

LEAST_ROWS = 7
"""Fewer rests than the affine accelerometer has parameters to spare show nothing beyond it."""

WITHOUT_TIME = ("time", "time since start", "charging", "charging and use", "time from a moment on")
"""What an effect may not follow in a table whose rows have no time."""


def claims_of(recording: Recording) -> Claims:
    """Return what the maker says, as the diagnosis takes it."""
    claims = msgspec.to_builtins(recording.claims)
    return Claims(**{k: claims[k] for k in Claims.__slots__ if claims.get(k) is not None})


def charging_events(recording: Recording) -> list[Charging]:
    """Return the recording's charging events."""
    return [e for e in recording.events if isinstance(e, Charging)]


def bins_of(recording: Recording) -> Bins:
    """Return the recording's still bins."""
    return diagnosis.still_bins(recording.accelerometer, recording.gyroscope, charging_events(recording))


def diagnosis_of(
    recording: Recording, name: str, claims: Claims | None = None, without: str | None = None
) -> Diagnosis:
    """Return the diagnosis of a recording. claims: other than its maker's; without: an effect left out.

    Raises NotSupported on too little data.
    """
    removed = () if without is None else (without,)
    return diagnosis.diagnose(
        recording.accelerometer,
        recording.gyroscope,
        charging_events(recording),
        claims or claims_of(recording),
        name,
        without=removed,
    )


def diagnose_recording(recording: Recording, name: str, without: str | None = None) -> dict[str, Any]:
    """Return the diagnosis of a recording as plain values. Raises NotSupported on too little data."""
    return answer_of(diagnosis_of(recording, name, without=without), facts(recording, bins_of(recording)))


def facts(recording: Recording, bins: Bins) -> Facts:
    """Return what a recording offers to be checked on."""
    accel = recording.accelerometer
    return facts_of(
        bins,
        len(accel),
        arrivals=accel.t_arrival is not None,
        thermometer=accel.temperature is not None,
        gyroscope=recording.gyroscope is not None,
    )


def answer_of(result: Diagnosis, facts: Facts) -> dict[str, Any]:
    """Return a diagnosis as plain values, with the checks that were made and those that were not possible."""
    answer: dict[str, Any] = plain(result)
    answer["limits"] = [*limits(facts), *answer["limits"]]
    answer["checked"] = [plain(check) for check in checks(facts)]
    return answer


def rest_bins(rests: Sequence[RestState]) -> Bins:
    """Return a table of rests as bins, one a row: no vibration, no motion, every row a rest of its own.

    Rows without a duration count as one second.
    """
    start = np.array([r.t_start for r in rests])
    duration = np.maximum([r.duration for r in rests], 1.0)
    rate = _stacked([r.rate for r in rests])
    warm = [r.temperature for r in rests]
    return Bins(
        t=start + duration / 2.0,
        duration=duration,
        rest=np.arange(len(rests)),
        force=np.array([r.specific_force for r in rests]),
        force_variance=np.maximum(np.array([r.force_uncertainty for r in rests]), LEAST_UNCERTAINTY) ** 2,
        vibration=np.ones(len(rests)),
        activity=np.stack([start, np.zeros(len(rests))], axis=1),
        span=(float(start.min()), float((start + duration).max())),
        rate=rate,
        rate_variance=None if rate is None else _variances(rests),
        temperature=None if any(w is None for w in warm) else np.array(warm, dtype=np.float64),
    )


def _stacked(values: Sequence[Array | None]) -> Array | None:
    return None if any(v is None for v in values) else np.array(values, dtype=np.float64)


def _variances(rests: Sequence[RestState]) -> Array:
    uncertainty = _stacked([r.rate_uncertainty for r in rests])
    return np.maximum(1e-18 if uncertainty is None else uncertainty**2, 1e-18)


def diagnose_rests(rests: Sequence[RestState], name: str, claims: Claims | None = None) -> dict[str, Any]:
    """Return what a table of rests shows: how gravity's norm and the rate at rest depart from affine sensors.

    Raises NotSupported with fewer than `LEAST_ROWS` rows.
    """
    if len(rests) < LEAST_ROWS:
        raise NotSupported(f"{len(rests)} rests", (f"at least {LEAST_ROWS}, in different attitudes",))
    bins, timed = rest_bins(rests), _timed(rests)
    findings = _findings_of_rests(bins, claims or Claims(), timed=timed)
    facts = facts_of(bins, 0, stamps=timed)
    thermometer, gyroscope = bins.temperature is not None, bins.rate is not None
    core_limits = diagnosis.limits(bins, gyroscope=gyroscope, thermometer=thermometer, table=True)
    return answer_of(Diagnosis(1, name, verdict_of(findings), findings, core_limits), facts)


def _findings_of_rests(bins: Bins, claims: Claims, *, timed: bool) -> list[Finding]:
    findings = []
    for scene in scenes(bins, claims.gravity):
        effects = [e for e in effects_of(scene.sensor) if timed or _without_time(e.follows)]
        findings += findings_of(scene, forward(scene, effects))
    return findings


def _without_time(follows: str) -> bool:
    return follows not in WITHOUT_TIME and "time" not in follows


def _timed(rests: Sequence[RestState]) -> bool:
    """Whether rows have a time of their own: those without are numbered."""
    return any(r.t_start != i for i, r in enumerate(rests))
