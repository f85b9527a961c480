"""What there is to draw of a recording or a store: the calibration, its rests, its history, a long rest.

Everything is arrays and records here; how they are drawn is the neighbours', each a figure's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord, StateRecord
from stillcal.calib_core.engine.actions import Publish, Reject
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import RestState, directions
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.trace import Trace
from stillcal.replay.runner import replay

JOINED_GAP_S = 1.0
"""Rests no further apart, s, that lie alike are one stretch of stillness to an Allan curve."""

JOINED_ANGLE = 0.02
"""rad; the same for their directions."""

LEAST_S, LEAST_SAMPLES = 30.0, 1000
"""The shortest stretch that an Allan curve is drawn of."""

GAP_S, GAP_STEPS = 1.0, 1.5
"""A step between samples longer than both (s, median steps) is a gap, across which nothing is averaged.

Shorter ones are left alone: a host's stamps of samples that were taken evenly come in bursts."""


@dataclass(frozen=True, slots=True, eq=False)
class Rests:
    """The rests of a calibration. t: (n,) s, their middles; up: (n, 3) raw directions.

    before, after: (n,) m/s^2, norm less gravity of the raw and of the corrected force (NaN where there is no
    calibration); uncertainty: (n,) m/s^2, of the rest's own mean along its direction.
    """

    t: Array
    up: Array
    before: Array
    after: Array
    uncertainty: Array

    @property
    def calibrated(self) -> bool:
        """Whether there is anything to hold `before` against."""
        return bool(np.isfinite(self.after).any())


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """A calibration of the history. what: current, replaced, rejected, ...; at: s, when it was made."""

    what: str
    at: float | None
    record: CalibrationRecord


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Even samples of one sensor at rest. xyz: (n, 3) SI; rate: Hz; t_start: s."""

    sensor: Sensor
    xyz: Array
    rate: float
    t_start: float


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """All inputs of the figures. stretches: one per sensor, none for a store, which has no samples."""

    name: str
    rests: Rests
    history: tuple[Moment, ...] = ()
    stretches: tuple[Stretch, ...] = ()


def rests_of(
    states: Sequence[StateRecord] | Sequence[RestState], part: AccelerometerRecord | None, gravity: float
) -> Rests:
    """Return rests as they are drawn; `part` is what they are corrected by, gravity m/s^2."""
    forces = np.array([s.specific_force for s in states]).reshape(-1, 3)
    sd = np.array([s.force_uncertainty for s in states]).reshape(-1, 3)
    up = directions(forces)
    after = np.full(len(forces), np.nan)
    if part is not None:
        after = np.linalg.norm(part.model.apply(forces), axis=1) - gravity
    before = np.linalg.norm(forces, axis=1) - gravity
    middles = np.array([(s.t_start + s.t_end) / 2.0 for s in states])
    return Rests(middles, up, before, after, np.asarray(np.linalg.norm(up * sd, axis=1)))


def of_record(record: CalibrationRecord | None, name: str, history: tuple[Moment, ...]) -> Material:
    """Return what a calibration holds itself. Raises NotSupported where there is none of an accelerometer."""
    if record is None or record.accelerometer is None or not record.states:
        raise NotSupported(f"{name} has no calibration with its rests", ["a calibration"])
    part = record.accelerometer
    return Material(name, rests_of(record.states, part, part.gravity), history)


def of_trace(trace: Trace, engine: Engine, progress: Callable[[], None], noise: bool = True) -> Material:
    """Replay a recording and return what there is to draw. progress: called now and then.

    noise: whether to look for a long rest, which takes two more readings.

    Where it supports no calibration its rests are drawn all the same.
    """
    calibrations: list[Publish | Reject] = []
    outcome = replay(trace.chunks(), engine, calibrations.append, progress)
    history = tuple(
        Moment("accepted" if isinstance(k, Publish) else "rejected", k.t, k.record) for k in calibrations
    )
    record, state = outcome.record, outcome.state
    name = short_name(trace.path)
    if record is not None and record.accelerometer is not None and record.states:
        drawn = of_record(record, name, history)
        rests = drawn.rests
    else:
        rests = rests_of([] if state is None else state.pool.rests, None, engine.present.gravity.value)
    return Material(name, rests, history, tuple(_stretches(trace, progress)) if noise else ())


# A long rest


def _stretches(trace: Trace, progress: Callable[[], None]) -> list[Stretch]:
    """Return the longest stretch of stillness of each sensor, if it is long enough."""
    span = longest(_scanned(trace, progress))
    if span is None:
        return []
    runs: dict[Sensor, list[Samples]] = {sensor: [] for sensor in Sensor}
    for chunk in trace.chunks():
        for samples in (chunk.accelerometer, chunk.gyroscope):
            runs[samples.sensor].append(samples.between(*span))
        progress()
    runs_at_rest = (even(Samples.joined(run)) for run in runs.values() if run)
    return [stretch for stretch in runs_at_rest if stretch is not None]


def _scanned(trace: Trace, progress: Callable[[], None]) -> list[RestState]:
    """Return all rests of a recording, watched without a break."""
    detector, rests = StationaryDetector(), list[RestState]()
    for chunk in trace.chunks():
        rests += detector.feed(chunk.gyroscope, chunk.accelerometer)
        progress()
    return rests + detector.finish()


def longest(rests: Sequence[RestState]) -> tuple[float, float] | None:
    """Return the longest span, s, of rests that follow on one another and lie alike; None without a rest."""
    spans: list[tuple[float, float]] = []
    last: RestState | None = None
    for rest in rests:
        if last is not None and _follows(last, rest):
            spans[-1] = (spans[-1][0], rest.t_end)
        else:
            spans.append((rest.t_start, rest.t_end))
        last = rest
    return max(spans, key=lambda span: span[1] - span[0], default=None)


def _follows(last: RestState, rest: RestState) -> bool:
    a, b = directions(np.array([last.specific_force, rest.specific_force]))
    near = float(np.linalg.norm(a - b)) <= JOINED_ANGLE
    return near and rest.t_start - last.t_end <= JOINED_GAP_S


def even(samples: Samples) -> Stretch | None:
    """Return the longest run without a gap between its samples; None where that is too short."""
    steps = np.diff(samples.t)
    if not steps.size:
        return None
    edges = np.r_[
        0, np.flatnonzero(steps > max(GAP_S, GAP_STEPS * float(np.median(steps)))) + 1, len(samples)
    ]
    longest_run = int(np.argmax(np.diff(edges)))
    part = samples[int(edges[longest_run]) : int(edges[longest_run + 1])]
    length = float(part.t[-1] - part.t[0])
    if len(part) < LEAST_SAMPLES or length < LEAST_S:
        return None
    return Stretch(part.sensor, frozen(part.xyz), (len(part) - 1) / length, float(part.t[0]))
