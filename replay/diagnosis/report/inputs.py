"""The inputs of all outputs about one diagnosed recording, computed once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from stillcal.calib_core.diagnosis.model.records import Diagnosis
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.replay.diagnosis.diagnose import bins_of, claims_of
from stillcal.replay.diagnosis.report.comparison import Comparison, Side, compare, side_of
from stillcal.replay.diagnosis.report.curves import Curve, curves_of
from stillcal.replay.diagnosis.report.departure_map import DepartureMap, map_of
from stillcal.replay.diagnosis.report.phone_effects import MappedFinding, map_findings
from stillcal.replay.diagnosis.report.phone_file import phone_of, plain_phone
from stillcal.replay.diagnosis.resimulate import resimulate
from stillcal.replay.diagnosis.twin import AffinePhone, Conditions, conditions_of, fit_affine
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.effects.base import Effect
from stillcal.replay.phone.phone import Phone

SEEDS = (1, 2)
"""Seeds of the simulations without and with the effects."""

ShowStage = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A recording with its findings.

    mapped: findings with their effects. known: effects that the given phone has already. plain, better: the
    affine phone fitted without and with the effects found.
    """

    recording: Recording
    diagnosis: Diagnosis
    bins: Bins
    gravity: float
    conditions: Conditions
    mapped: tuple[MappedFinding, ...]
    known: tuple[Effect, ...]
    plain: AffinePhone
    better: AffinePhone
    departure_map: DepartureMap

    def phone(self) -> Phone:
        """Return the phone that the recording shows, with the effects found."""
        effects = (*self.known, *(m.effect for m in self.mapped if m.effect is not None))
        return phone_of(self.recording, self.bins, effects, self.conditions, self.gravity)

    def curves(self, one: MappedFinding) -> list[Curve]:
        """Return the curves of one finding."""
        return curves_of(one, self.bins, self.conditions, self.better, self.gravity)

    def side(self) -> Side:
        """Return the recording as one side of a comparison."""
        return side_of(self.recording, self.bins, self.gravity)


@dataclass(frozen=True, slots=True, eq=False)
class Resimulation:
    """A simulation of the recording's motion, and its comparison with the recording."""

    recording: Recording
    bins: Bins
    comparison: Comparison


def case_of(recording: Recording, diagnosis: Diagnosis, known: Sequence[Effect] = ()) -> Case:
    """Compute the inputs of all outputs. known: effects that the given phone has already."""
    bins, claims = bins_of(recording), claims_of(recording)
    conditions = conditions_of(bins)
    mapped = tuple(map_findings(diagnosis.findings, bins, conditions))
    effects = [*known, *(m.effect for m in mapped if m.effect is not None)]
    plain, better = (fit_affine(bins, chosen, conditions, claims.gravity) for chosen in (known, effects))
    departure_map = map_of(recording, bins, (plain, better), claims)
    return Case(
        recording,
        diagnosis,
        bins,
        claims.gravity,
        conditions,
        mapped,
        tuple(known),
        plain,
        better,
        departure_map,
    )


def resimulate_before_and_after(
    case: Case, show_stage: ShowStage = lambda stage: None
) -> tuple[Resimulation, Resimulation]:
    """Simulate the recording's motion without and with the effects found, and compare both with it."""
    show_stage("simulating the recording without and with the effects")
    phone = case.phone()
    before = plain_phone(phone, case.mapped, case.known, case.recording, case.plain)
    side = case.side()
    pairs: Sequence[tuple[Phone, AffinePhone]] = ((before, case.plain), (phone, case.better))
    resimulations = [
        _resimulation(case, side, p, affine, seed) for (p, affine), seed in zip(pairs, SEEDS, strict=True)
    ]
    return resimulations[0], resimulations[1]


def _resimulation(case: Case, side: Side, phone: Phone, affine: AffinePhone, seed: int) -> Resimulation:
    recording = resimulate(
        case.recording, case.bins, affine, case.conditions, phone, gravity=case.gravity, seed=seed
    )
    bins = bins_of(recording)
    return Resimulation(recording, bins, compare(side, side_of(recording, bins, case.gravity)))
