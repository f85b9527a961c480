"""The result of a replay: as rows of text for a person, and put into a store as the daemon would."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.catalogue import ADOPT
from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.engine.actions import Publish, Reject
from stillcal.calib_core.gravity import STANDARD, Gravity
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.streams.beginning import Beginning
from stillcal.daemon.store.document import StoreDocument
from stillcal.daemon.store.files import StoreError, piped
from stillcal.daemon.store.store import Store, StoreSettings
from stillcal.daemon.system.files import input_name, is_read_once
from stillcal.replay.runner import Outcome

_DEG = 180 / np.pi


def keep_in_store(
    path: Path | str, actions: Iterable[Publish | Reject], settings: StoreSettings | None = None
) -> list[str]:
    """Put the calibrations that a replay accepted and rejected into a store, in order, by one write.

    Returns the store's notes, one line each. Raises StoreError where the store is damaged, or another process
    holds it.
    """
    with Store(path, settings) as opened:
        before = opened.load_if_any()
        outcome = opened.change(lambda document: _after(document, actions, opened.settings.history))
    lost = _lost_terms(None if before is None else before.current, outcome.document.current)
    return [*outcome.notes, *lost]


def _after(document: StoreDocument, actions: Iterable[Publish | Reject], limit: int) -> StoreDocument:
    """Return a store's contents after all actions. limit: entries that its history keeps."""
    for action in actions:
        if isinstance(action, Publish):
            document = document.after_publishing(action.record, limit, action.reason, action.t)
        else:
            document = document.after_rejecting(action.record, action.reason, limit, action.t)
    return document


def _lost_terms(before: CalibrationRecord | None, after: CalibrationRecord | None) -> list[str]:
    """Say which effects the calibration before corrected and the one after it does not."""
    if before is None or after is None:
        return []
    lost = {term.effect for term in before.terms} - {term.effect for term in after.terms}
    if not lost:
        return []
    return [
        f"calibration {before.id}, which is replaced, also corrected {', '.join(sorted(lost))}: take that up"
        f" again with {ADOPT}, or go back with stillcal store rollback"
    ]


def from_recording(
    record: CalibrationRecord, source: str, beginning: Beginning | None = None
) -> CalibrationRecord:
    """Return a calibration that says which recording it comes from, by name and, if known, by beginning."""
    return replace(record, provenance=replace(record.provenance, source=source, beginning=beginning))


def full(actions: Iterable[Publish | Reject]) -> list[Publish | Reject]:
    """Return the actions on calibrations that have an accelerometer part.

    A gyroscope's bias from before the first full calibration is of use while the phone lives on. A recording
    is over: it must not replace a store's full calibration by less.
    """
    return [action for action in actions if action.record.accelerometer is not None]


def current_in_store(path: Path | str) -> CalibrationRecord:
    """Return the current calibration of a store, which may come through a pipe ('-': standard input).

    Raises StoreError where there is none.
    """
    document = piped(Path(path)) if is_read_once(path) else Store(path).load()
    record = None if document is None else document.current
    if record is None:
        raise StoreError(f"{input_name(path)}: has no calibration; run stillcal replay or the daemon first")
    return record


def why_not(outcome: Outcome) -> str:
    """Return in a phrase why a replay ended without a calibration, and what is needed for one."""
    if outcome.refusal is not None:
        needed = ", ".join(outcome.refusal.missing)
        return f"{outcome.refusal.reason}{f'; needed: {needed}' if needed else ''}"
    rests = outcome.state.counters.rests if outcome.state else 0
    if rests == 0:
        return "no rest was found: the phone never lay still for long enough"
    return f"{rests} rests were found, but the recording ended before a calibration was due"


def outcome_rows(outcome: Outcome, store: Path | None = None) -> list[tuple[str, str]]:
    """Return the recording's length, its rests, the calibration and its store, as (name, value)."""
    rows = [("Recording", _length(outcome)), ("Rests", _rests(outcome))]
    record = outcome.record
    if record is None:
        return rows
    rows += [*record_rows(record), ("Accepted", record.acceptance.reason)]
    return rows if store is None else [*rows, ("Stored in", f"{store} as {record.id}")]


def record_rows(record: CalibrationRecord) -> list[tuple[str, str]]:
    """Return what a calibration says, as (name, value)."""
    rows = []
    if record.gravity is not None:
        rows.append(("Gravity", _gravity(record.gravity)))
    if record.accelerometer is not None:
        rows += _accelerometer(record, record.accelerometer)
    if record.gyroscope is not None:
        rows += _gyroscope(record.gyroscope)
    valid = record.validity
    if valid.temperature_min is not None and valid.temperature_max is not None:
        span = f"{valid.temperature_min:.1f} to {valid.temperature_max:.1f} °C"
        rows.append(("Measured at", f"{span}; outside, it is extrapolated"))
    return rows


def _length(outcome: Outcome) -> str:
    if outcome.ledger.accel_samples == 0:
        return f"{outcome.state.counters.rests if outcome.state else 0} rows of a rest table"
    return f"{_span(outcome.duration)}, {outcome.samples:,} samples"


def _span(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min {rest} s"


def _rests(outcome: Outcome) -> str:
    state, ledger = outcome.state, outcome.ledger
    if state is None or ledger.accel_samples == 0:
        return "the rows of the table"
    share = 100 * min(1.0, ledger.asked_s / outcome.duration) if outcome.duration else 100.0
    counts = f"{state.counters.rests} found, {state.counters.turns} rotations between them"
    if state.counters.undersampled:
        counts = f"{counts}, {state.counters.undersampled} more too fast for the gyroscope's sampling rate"
    return f"{counts}, sensors on {share:.1f} % of the time"


def _gravity(gravity: Gravity) -> str:
    sources = {
        "default": "standard value, as the location is unknown",
        "location": "from the location",
        "given": "as given",
    }
    common = f"; adds {100 * gravity.scale_uncertainty:.2g} % uncertainty to all scales"
    return f"{gravity.value:.5f} m/s² ({sources[gravity.source]}{common if gravity.uncertainty else ''})"


def _accelerometer(record: CalibrationRecord, part: AccelerometerRecord) -> list[tuple[str, str]]:
    rows = [
        (f"Accelerometer, {part.parameters} parameters", f"{part.n_rests} rests, {part.n_states} attitudes"),
        ("  bias", f"{_vector(part.bias, '.4f')} m/s²"),
        ("  scale", _vector(np.diag(part.scale), ".5f")),
    ]
    if part.parameters > 6:
        rows.append(("  cross-axis", f"{_vector(part.scale[np.triu_indices(3, 1)], '.5f')} (xy, xz, yz)"))
    before = _raw_rms(record, part.gravity)
    if part.rms_residual is not None:
        rows.append(
            ("  |force| - g at rest", f"{_milli_g(before)} before, {_milli_g(part.rms_residual)} after (rms)")
        )
    return rows


def _raw_rms(record: CalibrationRecord, gravity: float) -> float:
    norms = np.array([np.linalg.norm(s.specific_force) for s in record.states])
    return rms(norms - gravity) if norms.size else float("nan")


def _gyroscope(part: GyroscopeRecord) -> list[tuple[str, str]]:
    rows = [
        (f"Gyroscope, {part.parameters} parameters", f"{part.n_rests} rests"),
        ("  bias", f"{_vector(part.bias * _DEG, '.4f')} °/s"),
    ]
    if part.parameters > 3:
        rows.append(("  scale", _vector(np.diag(part.scale), ".5f")))
    if part.rms_nominal is not None and part.rms_residual is not None:
        before, after = _DEG * part.rms_nominal, _DEG * part.rms_residual
        rows.append(
            (
                "  gravity after a rotation",
                f"{before:.3g}° before, {after:.3g}° after (rms), {part.n_turns} rotations",
            )
        )
    if part.rotation_admitted is not None and np.isfinite(part.rotation_admitted).all():
        hourly = float(np.max(part.rotation_admitted)) * _DEG * 3600.0
        rows.append(("  slow rotation unseen", f"up to {hourly:.2g} °/h may be in the bias"))
    if part.missing:
        rows.append(("  to improve", "; ".join(part.missing)))
    return rows


def _milli_g(value: float) -> str:
    return f"{1000 * value / STANDARD:.3g} mg"


def _vector(values: Array, form: str) -> str:
    return "  ".join(f"{v:{form}}" for v in values)
