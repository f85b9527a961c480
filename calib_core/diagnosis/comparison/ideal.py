"""A recording against the built-in simulation: an ideal affine sensor with plain noise, moved as it moved.

That sensor's constants are the recording's own, so bias, scale and noise density cannot differ. Whatever else
the recording shows is lacking in it: the simulation's part of every difference is zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import checks_of, slow_checks
from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import Sought, each_once, sought
from stillcal.calib_core.diagnosis.comparison.direct import measured_directly, smallest_direct
from stillcal.calib_core.diagnosis.comparison.linear.constants import ALIKE_SCALE
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import density
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, Relation, posterior
from stillcal.calib_core.diagnosis.comparison.records import (
    LEVEL,
    Common,
    Comparison,
    Discrepancy,
    NotCompared,
)
from stillcal.calib_core.diagnosis.comparison.stated import is_sure, undecided_finding
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Evidence, Finding, Where, only_unknown
from stillcal.calib_core.diagnosis.model.rotation_alignment import GYRO_SCALE_SIZE
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones, usual
from stillcal.calib_core.diagnosis.noise.noise_level import TWO_SIDED, claimed, convention

DOES_NOT = "the recording does not"

FAR_OFF = 0.2
"""Part by which a gyroscope's scale is off where it is another range's. Data sheets allow far less: the
MPU-6050's 3 % at 25 degC and 2 % over temperature (PS-MPU-6000A-00, revision 3.4, 6.1)."""


def compare_with_ideal(exam: Examination, *, samples: bool = True) -> Comparison:
    """Return what the recording shows beyond an ideal sensor, and what it could not show.

    samples: whether single samples, stamps and noise at rest are judged, or by something else.
    """
    found = sought(exam)
    stated = [(s.finding, s.finding.evidence.log_bayes_factor) for s in exam.statements]
    every = checks_of(exam, found)
    checks = every if samples else slow_checks(exam, found)
    judged = [(f, e, posterior(e, max(len(every), 1))) for f, e in stated]
    sure = [j for j in judged if is_sure(j[0], j[2])]
    missing = [NotCompared(c.effect, c.sensor, c.reason) for c in checks if c.reason is not None]
    slow = [row for one in found for row in one.smallest]
    apart = Comparison(
        discrepancies=[_discrepancy(*one) for one in sorted(sure, key=lambda j: -j[1])],
        not_compared=missing,
        undecided=[undecided_finding(f, odds, DOES_NOT) for f, _, odds in judged if not is_sure(f, odds)],
        comparisons=len(checks) - len(missing),
        evidence=[*((f.effect, e) for f, e in stated), *_not_stated(found, stated)],
        common=_common(exam, {f.effect for f, *_ in sure}) if samples else [],
        smallest=list(each_once([*slow, *(smallest_direct(exam) if samples else [])])),
    )
    rejected = not apart.discrepancies and apart.p() < LEVEL
    return _with_what_differs(apart, exam, found) if rejected else apart


def _with_what_differs(apart: Comparison, exam: Examination, found: Sequence[Sought]) -> Comparison:
    """Return a comparison that rejects the simulation without any effect that is stated by itself.

    What the fit speaks for most did not predict the parts left out of the fit, as nothing does that comes
    once: it is said that something differs and what it follows, and not that it is this effect.
    """
    checks = max(apart.comparisons + len(apart.not_compared), 1)
    slow = [_sought(s, exam) for s in found if s.smallest]
    every = [*slow, *(s.finding for s in exam.statements)]
    nearest = max(every, key=lambda f: f.evidence.log_bayes_factor)
    nats = nearest.evidence.log_bayes_factor
    odds = posterior(nats, checks)
    say = only_unknown(f"({nearest.sensor})", nearest.where.driver)
    unnamed = replace(nearest, effect="unknown", alternatives=[], statement=say)
    told = {(n.effect, n.sensor) for n in apart.undecided}
    unsure = [] if (nearest.effect, nearest.sensor) in told else [undecided_finding(nearest, odds, DOES_NOT)]
    return replace(
        apart, discrepancies=[_discrepancy(unnamed, nats, odds)], undecided=[*apart.undecided, *unsure]
    )


def _sought(one: Sought, exam: Examination) -> Finding:
    """Return what was looked for and not stated, as a finding without a size."""
    where = Where(*exam.bins.span, SLOW_BAND, one.follows)
    return Finding(one.effect, one.sensor, [], where, {}, Evidence(one.log_bayes_factor), [], "")


def _common(exam: Examination, found: set[str]) -> list[Common]:
    """Return what stamps and values show more of than half of the real devices, where it is no finding."""
    if exam.is_table:
        return []
    sound, nominal, out = sound_phones(), exam.claims.nominal_rate_hz, []
    for (effect, _), (measured, quantity) in measured_directly(exam).items():
        population = usual(sound, effect, nominal)
        more, of = population.at_least(measured.value), population.devices.size
        if effect not in found and of and measured.value > population.middle and not quantity.none:
            what = "one of them shows" if more == 1 else f"{more} of them show"
            within = f"within what {of} real devices show; {what} as much"
            beyond = f"more than any of {of} real devices shows, and not by so much that it is a fault"
            out.append(Common(quantity, within if more else beyond))
    return out + _two_sided(exam, found) + _other_range(exam)


def _two_sided(exam: Examination, found: set[str]) -> list[Common]:
    """Return the densities that are as claimed only if the claims are those of two-sided spectra."""
    levels = {s.sensor: s.levels for s in exam.streams if s.levels is not None}
    if "noise_level" in found or convention(levels, exam.claims) != TWO_SIDED:
        return []
    note = "the maker's densities are read as those of a two-sided spectrum: times √2 they are one-sided"
    claimed_ones = [s for s in exam.streams if claimed(s.sensor, exam.claims) is not None]
    return [Common(level, note) for s in claimed_ones if (level := density(s)) is not None]


def _other_range(exam: Examination) -> list[Common]:
    """Return the gyroscope's scale where no sensor's own is so far off: an ideal sensor may have any."""
    affine = exam.aligned
    if exam.exchanged or affine is None or affine.errors is None:
        return []
    factor, own = affine.mapping.diagonal(), [9, 13, 17]
    errors = factor[:, None] * affine.errors[own]
    scale = Quantity(
        "gyro_scale",
        "gyro",
        (Part("scale", "1", 3),),
        value=factor - 1.0,
        covariance=errors @ errors.T,
        size=np.full(3, GYRO_SCALE_SIZE),
        tolerance=np.full(3, ALIKE_SCALE),
        axis_of=np.arange(3),
    )
    if (np.abs(scale.value) - NORMAL_95 * scale.sigma).max() < FAR_OFF:
        return []
    return [Common(scale, "no data sheet allows so much: are its rates of another range or unit?")]


def _not_stated(found: Sequence[Sought], stated: Sequence[tuple[Finding, float]]) -> list[tuple[str, float]]:
    """Return the evidence for what was looked for and not found, by effect."""
    names = {(f.effect, f.sensor) for f, _ in stated}
    return [(s.effect, s.log_bayes_factor) for s in found if s.smallest and (s.effect, s.sensor) not in names]


def _discrepancy(finding: Finding, evidence: float, probability: float) -> Discrepancy:
    return Discrepancy(
        finding.effect,
        finding.sensor,
        list(finding.axes),
        finding.where,
        _relation(finding),
        probability,
        evidence,
        recorded=finding,
    )


def _relation(finding: Finding) -> Relation:
    """Return "lacking"; of a noise level, which the simulation has as it is claimed, how it is off."""
    ratio = finding.parameters.get("ratio")
    if finding.effect == "noise_level" and ratio is not None and isinstance(ratio.value, float):
        return "too_small" if ratio.value > 1.0 else "too_large"
    return "lacking"
