"""Whose an effect is that a recording and its witnesses differ by: what is said of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.pair.vote import nats_of, shares, shown_alone
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.settings import CERTAIN
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.errors import NotSupported
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.diagnosis.words.names import noun
from stillcal.replay.formats.trace import Recording


@dataclass(frozen=True, slots=True, eq=False)
class Owned:
    """What the recording and its witnesses differ by, with how likely it is each one's.

    names: of the recording and its witnesses; shares: of each of them, in that order.
    """

    discrepancy: Discrepancy
    names: Sequence[str]
    shares: Array

    @property
    def owner(self) -> int | None:
        """Whose it surely is, 0 for the recording; None where that is not sure."""
        k = int(self.shares.argmax())
        return k if self.shares[k] >= CERTAIN else None

    @property
    def own(self) -> float:
        """How likely it is the recording's; 0 where it is surely a witness's."""
        return 0.0 if self.owner else float(self.shares[0])

    def of_witness(self) -> dict[str, Any]:
        """Return what is surely a witness's in plain values, with a sentence."""
        one, name = self.discrepancy, self.names[int(self.shares.argmax())]
        axes = f" on {', '.join(one.axes)}" if one.axes else ""
        return {
            "effect": one.effect,
            "sensor": one.sensor,
            "axes": one.axes,
            "probability": float(one.true * self.shares.max()),
            "note": f"{noun(one.effect, one.sensor)}{axes} (axes of the recording): it is {name}'s, not the"
            f" recording's, because {self.names[0]} and the others do not show it against each other.",
        }


def owners_of(
    exam: Examination,
    found: Comparison,
    direct: Sequence[Stated],
    recordings: Sequence[Recording],
    differing: Callable[[int], list[SensorResiduals]],
) -> list[Owned]:
    """Return what was found in the difference of readings, with how likely it is each recording's.

    exam: of the recording less its witnesses; direct: what single samples of the recording show, which is its
    own. recordings: that recording, then its witnesses. differing: gives the residuals of one of them, by its
    place, less the mean of the rest. What each shows by itself is looked at where the vote is not sure.
    """
    own = {id(s.finding) for s in direct}
    stated = [s for s in exam.statements if id(s.finding) not in own]
    of_pair = [d for d in found.discrepancies if d.recorded is None or id(d.recorded) not in own]
    if not of_pair:
        return []
    sensors = [differing(k) for k in range(len(recordings))] if len(recordings) > 2 else []
    names = [r.name for r in recordings]

    def vote(alone: Sequence[Sequence[Finding]]) -> list[Owned]:
        out = []
        for one in of_pair:
            of_kind = _having(recordings, one.sensor)
            # Two sensors' differences are the same.
            compared = [sensors[k] for k in of_kind] if len(of_kind) > 2 else []
            its = [next(s for s in each if s.sensor == one.sensor) for each in compared]
            said = next((s for s in stated if s.finding is one.recorded), None)
            nats = np.array([nats_of(shown_alone(each, one)) for each in alone])[of_kind]
            beside = [s for s in stated if s.finding.sensor == one.sensor]
            told = Stated(one.recorded) if said is None and one.recorded is not None else said
            assert told is not None, "what is found in a pair is a finding"
            likely = np.zeros(len(recordings))
            likely[of_kind] = shares(told, beside, its, nats)
            out.append(Owned(one, names, likely))
        return out

    owned = vote([()] * len(recordings))
    if all(one.owner is not None for one in owned):
        return owned
    return vote([_findings_alone(one) for one in recordings])


def _having(recordings: Sequence[Recording], sensor: str) -> list[int]:
    """Return which recordings have a sensor, by their place."""
    return [k for k, r in enumerate(recordings) if sensor != "gyro" or r.gyroscope is not None]


def _findings_alone(recording: Recording) -> list[Finding]:
    """Return what a recording shows by itself, at rest; nothing where it has too little of that."""
    try:
        return [s.finding for s in examined(recording).statements]
    except NotSupported:
        return []


def tell_owners(answer: dict[str, Any], before: Comparison, owned: Sequence[Owned]) -> None:
    """Add to every finding of an answer whose it may be; one that may be a witness's says so.

    before: the comparison that the answer states, its findings in the same order.
    """
    by_finding = {id(one.discrepancy.recorded): one for one in owned}
    for one, told in zip(before.discrepancies, answer["findings"], strict=True):
        whose = by_finding.get(id(one.recorded))
        if whose is None:
            continue
        told["owners"] = dict(zip(whose.names, whose.shares.tolist(), strict=True))
        if whose.owner is None:
            likely = [n for n, p in zip(whose.names, whose.shares, strict=True) if p > 1.0 - CERTAIN]
            told["statement"] = (
                f"Of {' or '.join(likely)}, which these sensors do not decide: {told['statement']}"
            )
