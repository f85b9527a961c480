"""Everything that is shown of one diagnosed recording, worked out once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from stillcal.calib_core.diagnosis.model.records import Diagnosis
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.replay.diagnosis.diagnose import bins_of, claims_of
from stillcal.replay.diagnosis.report.comparison import Comparison, Side, compare, side_of
from stillcal.replay.diagnosis.report.curves import Curve, curves_of
from stillcal.replay.diagnosis.report.departure_map import Map, map_of
from stillcal.replay.diagnosis.report.phone_effects import Mapped, mapped
from stillcal.replay.diagnosis.report.phone_file import phone_of, plain_phone
from stillcal.replay.diagnosis.resimulate import relived
from stillcal.replay.diagnosis.twin import Affine, Lived, affine, lived
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.effect_base import Effect
from stillcal.replay.phone.phone import Phone

SEEDS = (1, 2)
"""Of the simulated recordings before and after."""

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A recording, what was found in it, and the affine phones with nothing and with all of it known.

    known: effects that the judged simulation had already.
    """

    recording: Recording
    diagnosis: Diagnosis
    bins: Bins
    gravity: float
    about: Lived
    found: tuple[Mapped, ...]
    known: tuple[Effect, ...]
    plain: Affine
    better: Affine
    map: Map

    def phone(self) -> Phone:
        """Return the phone that the recording shows, with what was found."""
        effects = (*self.known, *(m.effect for m in self.found if m.effect is not None))
        return phone_of(self.recording, self.bins, effects, self.about, self.gravity)

    def curves(self, one: Mapped) -> list[Curve]:
        """Return the curves of one finding."""
        return curves_of(one, self.bins, self.about, self.better, self.gravity)

    def side(self) -> Side:
        """Return the recording as one side of a comparison."""
        return side_of(self.recording, self.bins, self.gravity)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A simulated recording of the same day and how it compares."""

    made: Recording
    bins: Bins
    comparison: Comparison


def case_of(recording: Recording, diagnosis: Diagnosis, known: Sequence[Effect] = ()) -> Case:
    """Work out what is to be shown. known: effects that the judged simulation had already."""
    bins, claims = bins_of(recording), claims_of(recording)
    about = lived(bins)
    found = tuple(mapped(diagnosis.findings, bins, about))
    effects = [*known, *(m.effect for m in found if m.effect is not None)]
    plain, better = (affine(bins, chosen, about, claims.gravity) for chosen in (known, effects))
    drawn = map_of(recording, bins, (plain, better), claims)
    return Case(recording, diagnosis, bins, claims.gravity, about, found, tuple(known), plain, better, drawn)


def trials(case: Case, tell: Tell = lambda stage: None) -> tuple[Trial, Trial]:
    """Simulate the recording's day with the phone before and after the findings, and compare both with it."""
    tell("simulating the phone before and after")
    phone = case.phone()
    before = plain_phone(phone, case.found, case.known, case.recording, case.plain)
    side = case.side()
    pairs: Sequence[tuple[Phone, Affine]] = ((before, case.plain), (phone, case.better))
    done = [_trial(case, side, p, below, seed) for (p, below), seed in zip(pairs, SEEDS, strict=True)]
    return done[0], done[1]


def _trial(case: Case, side: Side, phone: Phone, below: Affine, seed: int) -> Trial:
    made = relived(case.recording, case.bins, below, case.about, phone, gravity=case.gravity, seed=seed)
    bins = bins_of(made)
    return Trial(made, bins, compare(side, side_of(made, bins, case.gravity)))
