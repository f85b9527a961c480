"""The work on one recording: calibrate and diagnose it, without raising for a bad recording.

Task and outcome are plain values, so that both can be sent to another process or machine.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stillcal.calib_core.accelerometer.parameters import AXES, LOWER
from stillcal.calib_core.calibration.record import SensorRecord
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.errors import NotSupported
from stillcal.replay.diagnosis.diagnose import diagnose_recording
from stillcal.replay.fleet.discovery import FoundRecording
from stillcal.replay.formats.recognition.opened import is_rest_table
from stillcal.replay.formats.rest_table import read_rest_table
from stillcal.replay.formats.trace import Recording, Trace, open_trace, whole
from stillcal.replay.runner import Outcome, replay, replay_rests, with_choices

CALIBRATED, REFUSED, ERROR, LOST = "calibrated", "refused", "error", "lost"
"""Statuses of a recording. Refused: it allows no calibration. Lost: the workers that had it died."""

_UNMIRRORED = {low: high for high, low in LOWER.items()}


@dataclass(frozen=True, slots=True)
class Task:
    """A recording to be examined. format: as for `stillcal replay`; watch: when the sensors are on."""

    recording: FoundRecording
    format: str = "csv"
    watch: str = "continuous"
    diagnose: bool = True


@dataclass(slots=True)
class Examined:
    """The outcome of a task: the columns of its row (parquet.py), and its rows of findings."""

    row: dict[str, Any]
    findings: list[dict[str, Any]] = field(default_factory=list)


def examine(task: Task) -> Examined:
    """Calibrate and diagnose one recording; an error becomes the status and reason of its row."""
    outcome = Examined(identity(task))
    try:
        outcome.row["content"] = content(task.recording)
        with np.errstate(all="ignore"):  # of a bad recording; its row says what matters
            _examine(task, outcome)
    except Exception as error:  # one bad recording must not stop thousands of others
        outcome.row |= {"status": ERROR, "reason": f"{type(error).__name__}: {error}"}
    return outcome


def identity(task: Task) -> dict[str, Any]:
    """Return the columns known before a recording is opened."""
    model, device = task.recording.owner(None)
    return {"name": task.recording.name, "model": model, "device": device, "format": task.format}


def content(recording: FoundRecording) -> str:
    """Return a digest of all files of a recording."""
    digest = hashlib.blake2b(digest_size=16)
    for file in recording.files:
        with file.open("rb") as opened:
            sized = os.fstat(opened.fileno()).st_size > 0  # a file of /proc has no size, and may wait
            while sized and (block := opened.read(1 << 20)):
                digest.update(block)
        digest.update(b"\0")
    return digest.hexdigest()


def _examine(task: Task, outcome: Examined) -> None:
    row, began = outcome.row, time.perf_counter()
    if is_rest_table(task.recording.path, task.format):
        row |= _calibration(replay_rests(read_rest_table(task.recording.path), _engine(task, None), _ignore))
        row["calibrate_s"] = time.perf_counter() - began
        return
    trace = open_trace(task.recording.path, task.format)
    row["model"], row["device"] = task.recording.owner(trace.claims.device)
    chunks = list(trace.chunks())
    row |= _stamps(whole([c.accelerometer for c in chunks]).t)
    row |= _calibration(replay(chunks, _engine(task, trace), _ignore))
    row["calibrate_s"] = time.perf_counter() - began
    if task.diagnose:
        began = time.perf_counter()
        gyroscope = whole([c.gyroscope for c in chunks]) if trace.has_gyroscope else None
        accelerometer = whole([c.accelerometer for c in chunks])
        recording = Recording(
            accelerometer,
            gyroscope,
            trace.events,
            trace.claims,
            trace.notes,
            delivered_twice=trace.delivered_twice(accelerometer),
        )
        _diagnosis(recording, outcome)
        row["diagnose_s"] = time.perf_counter() - began


def _ignore(_: object) -> None:
    return None


def _engine(task: Task, trace: Trace | None) -> Engine:
    claimed = (lambda: None) if trace is None else trace.claimed_gravity
    return Engine(with_choices(EngineSettings(), watch=task.watch, claimed=claimed))


def _stamps(t: np.ndarray) -> dict[str, Any]:
    """Return the sampling rate and how it scatters: sd of the steps over their median, gaps left out."""
    steps = np.diff(t)
    period = float(np.median(steps))
    steps_without_gaps = steps[(steps > 0) & (steps < 3 * period)]
    if period <= 0 or steps_without_gaps.size == 0:
        return {}
    return {"rate_hz": 1.0 / period, "rate_jitter": float(steps_without_gaps.std()) / period}


def _calibration(outcome: Outcome) -> dict[str, Any]:
    """Return the columns that a replay gives."""
    state, record = outcome.state, outcome.record
    assert state is not None
    rests = state.pool.rests
    row: dict[str, Any] = {
        "duration_s": outcome.duration,
        "samples": outcome.samples,
        "rests": state.counters.rests,
        "turns": state.counters.turns,
        "attitudes": state.attitudes,
        "noise": float(np.median([np.mean(r.force_sd) for r in rests])) if rests else None,
    }
    if record is None or record.accelerometer is None:
        refusal = state.refusal
        missing = [] if refusal is None else list(refusal.missing)
        reason = "no rest was found" if refusal is None else refusal.reason
        return row | {"status": REFUSED, "reason": reason, "missing": missing}
    accel = record.accelerometer
    row |= {
        "status": CALIBRATED,
        "gravity": accel.gravity,
        "temperature_min": record.validity.temperature_min,
        "temperature_max": record.validity.temperature_max,
        "most_helpful_attitude": accel.most_helpful_attitude,
        **dict(_columns("accel", accel)),
    }
    return row | ({} if record.gyroscope is None else dict(_columns("gyro", record.gyroscope)))


def _columns(sensor: str, part: SensorRecord) -> Iterator[tuple[str, Any]]:
    """Return one sensor's parameters, each with its standard deviation where it was estimated."""
    covariance = np.empty((0, 0)) if part.covariance is None else part.covariance
    variances: dict[str, float] = dict(zip(part.names, np.diag(covariance).tolist(), strict=False))

    def sd(name: str) -> float | None:
        variance = variances.get(name, variances.get(_UNMIRRORED.get(name, "")))
        return None if variance is None or not variance >= 0.0 else float(np.sqrt(variance))

    yield f"{sensor}_parameters", part.parameters
    yield f"{sensor}_rms_residual", part.rms_residual
    for i, axis in enumerate(AXES):
        yield f"{sensor}_bias_{axis}", float(part.bias[i])
        yield f"{sensor}_bias_{axis}_sd", sd(f"b_{axis}")
        for j, other in enumerate(AXES):
            yield f"{sensor}_scale_{axis}{other}", float(part.scale[i, j])
            yield f"{sensor}_scale_{axis}{other}_sd", sd(f"S_{axis}{other}")
    if part.covariance is not None and np.isfinite(part.covariance).all():
        yield f"{sensor}_names", list(part.names)
        yield f"{sensor}_covariance", part.covariance.ravel().tolist()


def _diagnosis(recording: Recording, outcome: Examined) -> None:
    row = outcome.row
    try:
        answer = diagnose_recording(recording, row["name"])
    except NotSupported as refusal:
        row["verdict"] = f"too little data: {refusal}"
        return
    outcome.findings = [_finding(row, finding) for finding in answer["findings"]]
    limits = [f"{n['effect']}: {n['reason']}" for n in answer["not_compared"]]
    row |= {"verdict": answer["verdict"], "findings": len(outcome.findings), "limits": limits}


def _finding(row: dict[str, Any], finding: dict[str, Any]) -> dict[str, Any]:
    """Return a finding's row: its first parameter in columns of its own."""
    parameters: dict[str, dict[str, Any]] = finding["parameters"]
    name = next(iter(parameters), None)
    first = {} if name is None else parameters[name]
    where, evidence = finding["where"], finding["evidence"]
    return {
        **{k: row[k] for k in ("name", "model", "device")},
        **{k: finding[k] for k in ("effect", "sensor", "axes", "statement")},
        **{k: where[k] for k in ("t_start", "t_end", "driver")},
        "probability": finding["probability"],
        "heldout_log_score_gain": evidence.get("heldout_log_score_gain"),
        "parameter": name,
        "value": None if name is None else np.ravel(first["value"]).astype(float).tolist(),
        "unit": first.get("unit"),
        "indistinguishable": [a["effect"] for a in finding["alternatives"] if a["indistinguishable"]],
    }
