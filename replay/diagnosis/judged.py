"""What a recording's comparison with a simulation leaves: both examined, before and after the correction."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from stillcal.calib_core.diagnosis.clear_bins import still_bins
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.diagnose import examine, refuse_too_little
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis
from stillcal.calib_core.diagnosis.model.records import Claims
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.streams.events import Charging
from stillcal.replay.diagnosis.condense import overview_of
from stillcal.replay.diagnosis.phone.case import Case
from stillcal.replay.formats.trace import Recording

ShowStage = Callable[[str, float], None]
"""Is called with the name of the present stage and how much of it is done, 0 to 1."""


def silent(_stage: str, _done: float) -> None:
    """Show no stage."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A recording against a simulation.

    simulated: None for the built-in simulation, whose part of every difference is zero. before, after: the
    comparison with the simulation as it is, and with what was found put into it (None where nothing was found
    or it could not be played). corrected: that simulation's recording. case: what a phone file is made of,
    None where a simulator's recording was judged.
    """

    recording: Recording
    recorded: Examination
    simulated: Examination | None
    before: Comparison
    after: Comparison | None
    corrected: Recording | None
    answer: dict[str, Any]
    case: Case | None = None


def examined(
    recording: Recording,
    show_stage: ShowStage = silent,
    *,
    name: str = "",
    without: Collection[str] = (),
    sought: Sequence[Hypothesis] | None = None,
    of_turns: Sequence[Stated] = (),
    within: Bins | None = None,
) -> Examination:
    """Measure a recording. name: of what is shown; the others: as for `diagnose.examine`.

    Raises NotSupported, with the recording's name, on too little data.
    """
    stage = f"examining {name or recording.name or 'the recording'}"
    show_stage(stage, 0.0)
    with _by_name(recording):
        return examine(
            recording.accelerometer,
            recording.gyroscope,
            charging_events(recording),
            claims_of(recording),
            without=without,
            covariates=recording.covariates,
            sought=sought,
            of_turns=of_turns,
            within=within,
            overview=overview_of(recording),
            delivered_twice=recording.delivered_twice,
            progress=lambda done: show_stage(stage, done),
        )


def refuse_short(*recordings: Recording) -> None:
    """Raise NotSupported, with the recording's name, for the first that is too short to be examined."""
    for recording in recordings:
        with _by_name(recording):
            refuse_too_little(recording.accelerometer)


@contextmanager
def _by_name(recording: Recording) -> Iterator[None]:
    """Put the recording's name before the reason of a refusal."""
    try:
        yield
    except NotSupported as refusal:
        where = f"{recording.name}: " if recording.name else ""
        raise NotSupported(f"{where}{refusal.reason}", refusal.missing) from refusal


def claims_of(recording: Recording) -> Claims:
    """Return what the maker says, as the diagnosis takes it."""
    claims = msgspec.to_builtins(recording.claims)
    return Claims(**{k: claims[k] for k in Claims.__slots__ if claims.get(k) is not None})


def charging_events(recording: Recording) -> list[Charging]:
    """Return the recording's charging events."""
    return [e for e in recording.events if isinstance(e, Charging)]


def bins_of(recording: Recording) -> Bins:
    """Return the recording's static bins."""
    events = charging_events(recording)
    return still_bins(recording.accelerometer, recording.gyroscope, events, overview_of(recording))


def named(recording: Recording, name: str) -> Recording:
    """Return a recording under a name."""
    return replace(recording, name=name)
