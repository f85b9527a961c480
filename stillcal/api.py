"""The public interface: load, calibrate, apply, diagnose, simulate.

Use it as `from stillcal import load, calibrate, ...`. Each function is a thin layer over what the command of
the same name calls, so that both give the same numbers. SI units throughout: s, m/s^2, rad/s, degC. Body axes
are Android's: x to the right of the screen, y up along it, z out of it. An accelerometer measures specific
force: at rest it reads +g on the axis that points up.

Errors: `UserError` (a ValueError) for input that cannot be used, in one line that names the place and the
remedy; its subclass `NotSupported` where there is too little data, with `reason` and `missing`, which says
what to record.

Set `OPENBLAS_NUM_THREADS=1` before numpy is imported, as the command line does: the matrices here are small,
and on a busy machine numpy's threads wait for each other.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core.calibration.adoption import adopt, beginning_of
from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.codec import jsonable
from stillcal.calib_core.engine.actions import Publish, Reject
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.errors import NotSupported, UserError
from stillcal.calib_core.streams.samples import warmed
from stillcal.calib_core.streams.smoothing import smoothed
from stillcal.daemon.store.document import calibration_json
from stillcal.replay.corrector import Corrector
from stillcal.replay.diagnosis.diagnose import Request, conflict
from stillcal.replay.diagnosis.diagnose import diagnose as find_differences
from stillcal.replay.diagnosis.words.summary import summary
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.covariates import of_values
from stillcal.replay.formats.in_memory import is_table, of_arrays, of_table, part_of
from stillcal.replay.formats.trace import Recording, read_all
from stillcal.replay.notebook import html_table
from stillcal.replay.outcome import (
    current_in_store,
    from_recording,
    full,
    keep_in_store,
    outcome_rows,
    record_rows,
    why_not,
)
from stillcal.replay.phone import load_phone, load_scenario
from stillcal.replay.phone import simulate as play
from stillcal.replay.runner import Outcome, replay, with_choices

__all__ = [
    "Calibration",
    "Diagnosis",
    "NotSupported",
    "Recording",
    "UserError",
    "apply",
    "calibrate",
    "diagnose",
    "load",
    "simulate",
]

PathLike: TypeAlias = str | os.PathLike[str]
Source: TypeAlias = Any
"""What `load` takes: a path, "sample:NAME", a data frame, a mapping of columns, or a Recording as it is."""


def load(
    source: Source = None,
    /,
    *,
    t: ArrayLike | None = None,
    accelerometer: ArrayLike | None = None,
    gyroscope: ArrayLike | None = None,
    gyroscope_t: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    t_arrival: ArrayLike | None = None,
    format: PathLike | None = None,
    gyroscope_file: PathLike | None = None,
    sensor: str | None = None,
    start: float | None = None,
    stop: float | None = None,
    events: Iterable[Mapping[str, Any]] = (),
    claims: Mapping[str, Any] | None = None,
    name: str = "",
) -> Recording:
    """Return a recording from a file, a table or arrays.

    A file or folder: `load("walk.csv")`, `load("flight.ulg")`; the format is recognised by its content.
    `format` overrides that with a format's name or the path of a column map (docs/formats.md),
    `gyroscope_file` names the gyroscope's own file where there are two, `sensor` one of a log's sensors.
    `load("sample:lab")` comes with stillcal.

    A table: `load(frame)`, a pandas data frame or anything else with named columns (an Arrow table, a
    mapping, a structured array): t, ax, ay, az; optionally gx, gy, gz, temperature, t_arrival. NaN stands for
    an empty cell; a row whose three cells of a sensor are NaN has no sample of that sensor. The index is a
    column too where it has a name or holds times, which may be dates. Columns of other usual names, and
    arrays (n, 3) such as `acc`, are found as in a file; `notes` says what was read as what.

    Arrays: `load(t=t, accelerometer=force, gyroscope=rate)`. t: (n,) s, never decreasing. accelerometer:
    (n, 3) m/s^2, body axes. gyroscope: (n, 3) rad/s, or (m, 3) with times of its own in gyroscope_t (m,) s.
    temperature: (n,) degC. t_arrival: (n,) s on the host's clock.

    `start` and `stop` cut any of them, in s after the first sample.

    With tables and arrays, events are mappings as lines of NAME.events.jsonl hold them, such as
    {"t": 60.0, "event": "charging", "on": True}; claims is a mapping as NAME.json holds it, such as
    {"nominal_rate_hz": 100.0}; name is what the recording is called in results. Beside a file they are read
    from its folder.

    Raises UserError where something is missing, not finite, runs backwards in time or is in other units, and
    TypeError where it is not said what to load.
    """
    arrays = (t, accelerometer, gyroscope, gyroscope_t, temperature, t_arrival)
    if source is not None and any(array is not None for array in arrays):
        raise TypeError("load() takes a file, a table or arrays, not two of them")
    if isinstance(source, str | os.PathLike):
        if claims is not None or tuple(events):
            raise TypeError("events and claims of a file lie beside it (docs/formats.md)")
        gyroscope_path = None if gyroscope_file is None else Path(gyroscope_file)
        form = None if format is None else _text(format)
        return read_all(os.fspath(source), form, gyroscope_path, sensor=sensor, start=start, stop=stop)
    if format is not None or gyroscope_file is not None:
        raise TypeError("format and gyroscope_file are of files")
    if isinstance(source, Recording):
        recording = source
    elif source is not None and is_table(source):
        recording = of_table(source, name or "table", events, claims, sensor)
    elif source is not None:
        raise TypeError(
            "load() takes a path, a table with named columns, or load(t=..., accelerometer=...) for arrays;"
            f" {type(source).__name__} is none of them"
        )
    elif t is None or accelerometer is None:
        raise TypeError("load() needs a path, a table, or both t and accelerometer")
    else:
        recording = of_arrays(
            t=t,
            accelerometer=accelerometer,
            gyroscope=gyroscope,
            gyroscope_t=gyroscope_t,
            temperature=temperature,
            t_arrival=t_arrival,
            name=name or "arrays",
            events=events,
            claims=claims,
        )
    return recording if start is None and stop is None else part_of(recording, start, stop)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What `calibrate` found, or what a store holds: calibrated = scale @ (raw - bias) for either sensor.

    It shows itself as a table in a notebook. `record` holds all of it; the properties are what most need.
    left_out: why `adopt` did not take up some findings, by effect.
    """

    record: CalibrationRecord
    _outcome: Outcome | None = None
    _actions: tuple[Publish | Reject, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, path: PathLike) -> Calibration:
        """Read a store that `save`, `stillcal replay` or the daemon wrote. Raises UserError."""
        record = current_in_store(Path(path))
        t = 0.0 if record.fitted_at is None else record.fitted_at
        action = Publish(t, record, record.acceptance.reason)
        return cls(record, None, (action,))

    @property
    def accelerometer(self) -> AccelerometerRecord | None:
        """The accelerometer's part: scale (3, 3), bias (3,) m/s^2, and how sure they are.

        bias_interval (2, 3) and scale_interval (2, 3, 3) are 95 % intervals; bias_uncertainty and
        scale_uncertainty are standard uncertainties. rms_residual: m/s^2, of the norm at rest. n_rests and
        n_states: rests and distinct attitudes. most_helpful_attitude: which to record next, in words.
        """
        return self.record.accelerometer

    @property
    def gyroscope(self) -> GyroscopeRecord | None:
        """The gyroscope's part, as the accelerometer's with bias in rad/s; None where nothing was measured.

        rms_residual: rad, between gravity as turned by the gyroscope and as measured.
        """
        return self.record.gyroscope

    @property
    def gravity(self) -> float | None:
        """Local gravity that the accelerometer was fitted to, m/s^2."""
        return None if self.accelerometer is None else self.accelerometer.gravity

    @property
    def missing(self) -> tuple[str, ...]:
        """What to record for more than was found, a phrase each; empty where nothing is missing."""
        refused = (
            () if self._outcome is None or self._outcome.refusal is None else self._outcome.refusal.missing
        )
        turns = () if self.gyroscope is None else self.gyroscope.missing
        return (*refused, *turns)

    def adopt(self, diagnosis: Diagnosis) -> Calibration:
        """Return the calibration with corrections that a diagnosis found, as `stillcal store adopt-terms`.

        The diagnosis must be of the same phone; a warm-up is taken up only from a diagnosis of the recording
        that was calibrated. `record.terms` says which effects are corrected now, `left_out` why others are
        not. `apply` uses them, and `save` keeps the calibration without them in the history. Raises
        NotSupported where none of the findings can be taken up, and says why.
        """
        record, left_out = adopt(self.record, diagnosis.findings, beginning_of(diagnosis.answer))
        t = 0.0 if record.fitted_at is None else record.fitted_at
        actions = (*self._actions, Publish(t, record, "terms from a diagnosis"))
        return Calibration(record, None, actions, left_out)

    @property
    def warnings(self) -> list[str]:
        """What the engine warned of as it calibrated, the first of each kind; none of a store."""
        return [] if self._outcome is None else self._outcome.warnings

    def save(self, path: PathLike) -> None:
        """Put the calibration into a store, a JSON file, as `stillcal replay --store` does.

        A store that exists keeps its history. Raises UserError where it is damaged or in use.
        """
        keep_in_store(Path(path), self._actions)

    def as_dict(self) -> dict[str, Any]:
        """Return the calibration as plain values, in the layout of `stillcal replay --json`."""
        return calibration_json(self.record)

    def __repr__(self) -> str:
        return _text_table("Calibration", self._rows())

    def _repr_html_(self) -> str:
        return html_table(self._rows(), f"Calibration {self.record.id}")

    def _rows(self) -> list[tuple[str, str]]:
        rows = record_rows(self.record) if self._outcome is None else outcome_rows(self._outcome)
        said = [("missing", phrase) for phrase in self.missing]
        return [*rows, *said, *(("warning", line) for line in self.warnings)]


def calibrate(
    recording: Source,
    *,
    gravity: float | None = None,
    watch: Literal["auto", "continuous", "probing"] | None = None,
) -> Calibration:
    """Calibrate from a recording with the daemon's engine, as `stillcal replay` does.

    recording: a Recording, or what `load` takes. gravity: local gravity, m/s^2; else it comes from the
    recording's location or claims, else it is the standard value. watch: "continuous" looks at every sample;
    "auto", the default, spares the sensors on long recordings as the daemon would.

    Rests are found by themselves, and the largest model that they support is fitted: 6, 9 or 12 parameters of
    calibrated = scale @ (raw - bias) (Grammenos et al. 2018, Eq. 2). Raises NotSupported where the recording
    cannot support a calibration of the accelerometer, with what is missing.
    """
    opened = load(recording)
    settings = with_choices(EngineSettings(), gravity, watch, opened.claimed_gravity)
    actions: list[Publish | Reject] = []
    outcome = replay(opened.chunks(), Engine(settings), actions.append)
    record = outcome.record
    if record is None or record.accelerometer is None:
        needed = () if outcome.refusal is None else outcome.refusal.missing
        reason = why_not(outcome) if outcome.refusal is None else outcome.refusal.reason
        raise NotSupported(f"{opened.name}: no calibration: {reason}", needed)
    name, beginning = opened.name, opened.beginning
    kept = [replace(a, record=from_recording(a.record, name, beginning)) for a in full(actions)]
    return Calibration(from_recording(record, name, beginning), outcome, tuple(kept))


def apply(
    recording: Source,
    calibration: Calibration | PathLike,
    *,
    smooth: bool = False,
    on_for: float | None = None,
) -> Recording:
    """Return the recording as true sensors would have given it, as `stillcal apply` writes it.

    recording: a Recording, or what `load` takes. calibration: a Calibration, or the path of a store. A sensor
    of which the calibration holds nothing stays as it is. smooth: also remove noise by a rolling mean of 3 to
    20 samples, by rate (Grammenos et al. 2018, Table 2); stamps stay, so values come late by half of that.
    on_for: s, how long the phone had been switched on when the recording began, which a warm-up follows; None
    counts as 0. The result's `notes` say what speaks against the calibration on this recording, or was
    assumed. `.save("true.csv")` writes the result. Raises UserError where the store cannot be read or holds
    nothing, ValueError where on_for is negative or not finite.
    """
    if on_for is not None and not 0.0 <= on_for < np.inf:
        raise ValueError(f"on_for is {on_for}: give how long the phone had been on, s, 0 or more")
    opened = load(recording)
    known = calibration if isinstance(calibration, Calibration) else Calibration.read(calibration)
    corrector = Corrector(known.record, opened.beginning, on_for)
    accelerometer, gyroscope = corrector.corrected(opened.accelerometer, opened.gyroscope, opened.events)
    claims = opened.claims.without_counts()
    if smooth:
        accelerometer, claims = smoothed(accelerometer), claims.without_noise()
        gyroscope = None if gyroscope is None else smoothed(gyroscope)
    return replace(
        opened,
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        claims=claims,
        notes=[*opened.notes, *corrector.warnings()],
    )


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """What `diagnose` found. answer: all of it as plain values, as `stillcal diagnose --json` writes it.

    It shows itself as a table in a notebook.
    """

    answer: dict[str, Any]

    @property
    def verdict(self) -> str:
        """The verdict in a word; docs/comparison.md says what each means."""
        return str(self.answer["verdict"])

    @property
    def findings(self) -> list[dict[str, Any]]:
        """The findings, each with at least effect, sensor, axes, where, parameters, evidence, statement."""
        return list(self.answer["findings"])

    def as_dict(self) -> dict[str, Any]:
        """Return the whole answer as plain values that JSON can hold."""
        return dict(jsonable(self.answer))

    def __repr__(self) -> str:
        return "\n".join(summary(self.answer))

    def _repr_html_(self) -> str:
        rows = [
            (f["effect"], " ".join([f["sensor"], *f["axes"]]), f["statement"])
            for f in self.answer["findings"]
        ]
        first, *_ = summary(self.answer)
        return html_table(rows, first, ("effect", "sensor", "what it is") if rows else ())


def diagnose(
    recording: Source,
    *,
    phone: PathLike | None = None,
    simulated: Source | None = None,
    paired: bool = False,
    witnesses: Iterable[Source] = (),
    covariates: Mapping[str, ArrayLike | tuple[ArrayLike, ArrayLike]] | None = None,
) -> Diagnosis:
    """Say where a recording differs from its simulation and which physics explains it.

    The same as `stillcal diagnose`. recording: a Recording, or what `load` takes. phone: the simulation to be
    judged, a ready phone's name or the path of a phone.toml; None for the phone that calibration assumes,
    with constant scale and bias and plain noise. simulated: what any simulator recorded; it is then judged
    instead. paired: it has the recording's own motion and stamps. witnesses: recordings by other sensors on
    the same body at the same time. covariates: further quantities that a bias may follow, by name, or a
    pandas data frame of them: (n,) one value for each of the accelerometer's samples, or a pair of times
    (m,) s and values (m,).

    The answer has schema 2 (what differs, what agrees, what could not be compared).

    Raises NotSupported where there is too little data, ValueError where the phone cannot be had, arguments
    exclude each other or a covariate has another length.
    """
    if isinstance(witnesses, str | os.PathLike | Recording) or is_table(witnesses):
        raise TypeError("witnesses are recordings in a list, also where it is one")
    others = tuple(witnesses)
    given = {"simulated": simulated is not None, "phone": phone is not None, "paired": paired}
    if covariates is not None and not is_table(covariates):
        raise TypeError("covariates are values by name: a mapping, or a data frame")
    columns = {} if covariates is None else dict(covariates)
    given |= {"witness": bool(others), "covariate": bool(columns)}
    if why := conflict([name for name, there in given.items() if there]):
        raise ValueError(why)
    request = Request(
        simulated=None if simulated is None else load(simulated),
        phone=None if phone is None else load_phone(_text(phone)),
        phone_name="" if phone is None else Path(_text(phone)).name,
        paired=paired,
        witnesses=tuple(load(other) for other in others),
    )
    opened = load(recording)
    if columns:
        stamps = opened.accelerometer.t
        series = {name: of_values(name, values, stamps) for name, values in columns.items()}
        opened = replace(opened, covariates=series)
    return Diagnosis(find_differences(opened, request).judged.answer)


def simulate(scenario: PathLike, *, phone: PathLike = "typical", seed: int = 0) -> Recording:
    """Return a recording of the simulated phone living through a scenario, as `stillcal simulate` writes it.

    scenario: a ready one (lab, tables, desk, day, night, drive, laundry, starved, week) or the path of a TOML
    file; phone: a ready one or a phone.toml (docs/phone.md). The same seed gives the same recording. All of
    it is held in memory, 96 bytes for a sample of both sensors: write long ones with `stillcal simulate`.
    Raises ValueError where the scenario or the phone cannot be had.
    """
    simulation = play(load_scenario(_text(scenario)), load_phone(_text(phone)), seed)
    whole = simulation.whole()
    claims = msgspec.convert(simulation.phone.claimed(), Claims)
    gyroscope = None if whole.gyroscope is None else warmed(whole.gyroscope, whole.accelerometer)
    name = f"{Path(scenario).stem}, seed {seed}"
    return Recording(whole.accelerometer, gyroscope, list(whole.events), claims, [], name)


def _text(path: PathLike) -> str:
    return os.fspath(path)


def _text_table(title: str, rows: Iterable[tuple[str, str]]) -> str:
    pairs = list(rows)
    width = max((len(name) for name, _ in pairs), default=0)
    return "\n".join([title, *(f"  {name:{width}}  {value}" for name, value in pairs)])
