"""Effects of one recording whose driver the other did not log, and may show without their name.

Without a thermometer, a bias that follows temperature shows as one that follows time, or as slow noise. That
is no difference of physics: the two cannot be compared there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import OF_TIME, why_not_logged
from stillcal.calib_core.diagnosis.comparison.linear.shifts import SHIFTED, moved_rows
from stillcal.calib_core.diagnosis.comparison.linear.wanted import Wanted, kind_of
from stillcal.calib_core.diagnosis.comparison.quantity import Difference, Quantity
from stillcal.calib_core.diagnosis.comparison.records import NotCompared
from stillcal.calib_core.diagnosis.comparison.stated import differs, key_of
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.effect import Effect
from stillcal.calib_core.diagnosis.model.records import Finding

SPREAD_K = 10.0
"""K: how far from the other's mean temperature a recording without a thermometer may have been."""

SHOWS_MORE = (("lacking", "too_small"), ("superfluous", "too_large"))
"""Relations of a difference by which the recording shows more, and by which the simulation does."""

Side = dict[tuple[str, str], Quantity]


@dataclass(frozen=True, slots=True)
class NotLogged:
    """An effect that the other recording was found to have, whose driver this one did not log.

    kind: "accel" or "gyro" for rests, "turn" for turns. reason: why what this one shows is not compared.
    """

    kind: str
    effect: Effect
    reason: str

    def may_be(self, kind: str, effect: str) -> bool:
        """Whether an effect found here may be the other's one."""
        alike = ("unknown", "slow_noise", *OF_TIME, *self.effect.look_alikes)
        return kind == self.kind and effect.endswith(alike)


def not_logged(
    exams: Sequence[Examination], found: Sequence[Sequence[Wanted]], names: Sequence[str]
) -> tuple[list[NotLogged], ...]:
    """Return for each of two recordings what the other was found to have and it has no driver of."""
    return tuple(
        [
            NotLogged(
                w.kind,
                effect,
                f"{names[i]}: {why}, so it may be the {effect.called()} that {names[1 - i]} shows",
            )
            for w in found[1 - i]
            if (why := why_not_logged(exams[i], effect := w.hypothesis.effect)) is not None
        ]
        for i in (0, 1)
    )


def of_finding(missing: Sequence[NotLogged], exam: Examination, finding: Finding) -> str | None:
    """Return why a finding that only this recording makes is not compared; None where it is."""
    residuals = next((s.residuals for s in exam.statements if s.finding is finding), None)
    if residuals is None:
        return None
    return next((m.reason for m in missing if m.may_be(kind_of(residuals), finding.effect)), None)


def without_hidden(
    pairs: Sequence[Difference], missing: Sequence[Sequence[NotLogged]]
) -> tuple[list[Difference], list[NotCompared]]:
    """Return the differences that can be compared, and of those that cannot, which differ, the reasons."""
    kept: list[Difference] = []
    hidden: list[NotCompared] = []
    for pair in pairs:
        why = _of_difference(missing, pair) if differs(pair) else None
        if why is None:
            kept.append(pair)
        else:
            hidden.append(NotCompared(*key_of(pair), why))
    return kept, hidden


def _of_difference(missing: Sequence[Sequence[NotLogged]], difference: Difference) -> str | None:
    """Return why a quantity that differs is not compared; None where it is."""
    effect, sensor = difference.recorded.effect, difference.recorded.sensor
    relation = difference.relation()
    return next(
        (
            m.reason
            for one, more in zip(missing, SHOWS_MORE, strict=True)
            for m in one
            if relation in more and m.may_be(sensor, effect)
        ),
        None,
    )


def with_unknown_temperature(sides: Sequence[Side], missing: Sequence[Sequence[NotLogged]]) -> list[Side]:
    """Return what two recordings show, a bias or scale at an unknown temperature with a larger error.

    It may be off by the other's slope times `SPREAD_K`.
    """
    out = []
    for side, other, lacking in zip(sides, reversed(sides), missing, strict=True):
        changed = dict(side)
        for one in lacking:
            slope = other.get(one.effect.key)
            if slope is None or one.effect.name not in SHIFTED:
                continue
            key = (one.effect.name.removesuffix("_temperature"), one.effect.sensor)
            if key in changed:
                changed[key] = _less_sure(changed[key], slope)
        out.append(changed)
    return out


def _less_sure(constant: Quantity, slope: Quantity) -> Quantity:
    away = np.zeros(constant.value.size)
    away[moved_rows(slope.effect)] = SPREAD_K * slope.value[:3]
    return replace(constant, covariance=constant.covariance + np.outer(away, away))
