"""What single samples, values, stamps and noise at rest show of two recordings, compared without any fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.comparison import sample_rate
from stillcal.calib_core.diagnosis.comparison.coverage import not_logged
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import obstacle
from stillcal.calib_core.diagnosis.comparison.coverage.not_logged import NotLogged
from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import shows_as_large
from stillcal.calib_core.diagnosis.comparison.direct import (
    ALIKE,
    MEASURED_ELSEWHERE,
    band_of_other,
    direct_statements,
    of_any_direction,
    partner,
    quantities_of,
    step_of_other,
    why_not_shown,
)
from stillcal.calib_core.diagnosis.comparison.lines_of_both import (
    LinesOf,
    beside_steady,
    not_as_large,
    unlike,
    with_lines_heard,
)
from stillcal.calib_core.diagnosis.comparison.quantity import (
    Difference,
    Key,
    subtract,
)
from stillcal.calib_core.diagnosis.comparison.records import NotCompared
from stillcal.calib_core.diagnosis.comparison.stated import Sole
from stillcal.calib_core.diagnosis.comparison.without_name import by_its_driver, is_course, may_be_had
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.residuals import attitudes
from stillcal.calib_core.diagnosis.noise.lines.line import is_line

Reasons = Mapping[Key, str | None]
"""Why an effect was not looked for; None where it was."""


def differences_of_samples(
    exams: tuple[Examination, Examination],
    reasons: Sequence[Reasons],
    names: tuple[str, str],
    unlogged: Sequence[Sequence[NotLogged]],
) -> tuple[list[Difference], list[Sole], list[NotCompared]]:
    """Compare the effects that samples show directly. reasons: of both, why an effect was not looked for.

    Returned are differences of what both have; what one alone has, and whether it is the recording; what the
    other could not show, or was found by its driver.
    """
    sides = with_lines_heard((direct_statements(exams[0]), direct_statements(exams[1])), exams)
    lines = (LinesOf(exams[0]), LinesOf(exams[1]))
    turned = any(map(_turned, exams))
    both: list[Difference] = []
    sole: list[Sole] = []
    unseen: list[NotCompared] = []
    for own, others, other, name, of_recording in (
        (sides[0], sides[1], 1, names[1], True),
        (sides[1], sides[0], 0, names[0], False),
    ):
        for finding in own:
            stated = partner(finding, own, others)
            pair = stated or lines[other].unstated(finding, own, others)
            if pair is not None and unlike(finding, pair):
                if finding.effect == "unknown" or stated is None:
                    told, untold = _of_one_alone(
                        beside_steady(finding, pair, names, of_recording), lines, names
                    )
                    sole += told
                    unseen += untold
                continue
            if pair is not None and not is_course(finding):
                why = by_its_driver(finding, exams[1 - other])
                if of_recording and why is not None:
                    unseen.append(NotCompared(finding.effect, finding.sensor, f"both: {why}"))
                elif of_recording or stated is None:
                    both += _paired(*((finding, pair) if of_recording else (pair, finding)), turned)
                continue
            measured = step_of_other(finding, exams[other]) or band_of_other(finding, exams[other])
            measured = measured or _same_rate(finding, exams[1 - other], exams[other])
            if measured is not None:
                both += _paired(*((finding, measured) if of_recording else (measured, finding)), turned)
                continue
            unlooked = reasons[other].get((finding.effect, finding.sensor))
            # Its rests tell all their vibrations, also those of what it lay on.
            unlooked = None if lines[other].has_passing(finding) else unlooked
            reason = why_not_shown(finding, exams[other]) or unlooked
            reason = reason or lines[other].why_none(finding, own, others, exams[1 - other])
            hidden = not_logged.of_finding(unlogged[1 - other], exams[1 - other], finding)
            reason = reason or may_be_had(finding, exams[1 - other], exams[other])
            reason = reason or _too_small(finding, exams[1 - other], exams[other])
            if reason is not None or hidden is not None:
                why = hidden or f"{name}: {reason}"
                unseen.append(NotCompared(finding.effect, finding.sensor, why))
            else:
                sole.append((finding, of_recording))
    return both, sole, unseen


def _of_one_alone(
    unsteady: Sole, lines: tuple[LinesOf, LinesOf], names: tuple[str, str]
) -> tuple[list[Sole], list[NotCompared]]:
    """Return a vibration that is steady in the other recording; or why that may only seem so."""
    line, of_recording = unsteady
    why = lines[int(of_recording)].why_not_steady(line)
    if why is None:
        return [unsteady], []
    return [], [NotCompared("vibration_tone", line.sensor, f"{names[int(of_recording)]}: {why}")]


def _same_rate(finding: Finding, own: Examination, other: Examination) -> Finding | None:
    """Return an error of the clock's rate that is the nominal rate's, where the other has the same rate.

    Where deliveries stall, the error may be no finding, and the rates are alike all the same. None where the
    other's rate is another one, or where the host's time shows the error.
    """
    nominal = own.claims.nominal_rate_hz
    if finding.effect != "clock_skew" or not nominal or other.claims.nominal_rate_hz != nominal:
        return None
    relative = float(np.asarray(finding.parameters["relative"].value))
    errors = [float(np.exp(sample_rate.rate(e.accelerometer).value[0])) / nominal - 1.0 for e in (own, other)]
    return finding if max(abs(e - relative) for e in errors) <= ALIKE * abs(relative) else None


def _too_small(finding: Finding, own: Examination, other: Examination) -> str | None:
    """Say why another recording does not show a slow effect by its size; None where it would have."""
    stated = next((s for s in own.statements if s.finding is finding), None)
    if stated is None or stated.residuals is None:
        return None
    if (why := obstacle(other, finding.effect, finding.sensor)) is not None:
        return why
    where = "turns" if stated.residuals.turns else "rests"
    return None if shows_as_large(other, stated) else not_as_large(where)


def _turned(exam: Examination) -> bool:
    """Whether a device lay in more than one attitude."""
    force = exam.bins.force
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    return bool(np.unique(attitudes(up)).size > 1)


def _paired(one: Finding, other: Finding, turned: bool) -> list[Difference]:
    """Return the difference of what both have. turned: whether a device lay in more than one attitude."""
    if one.effect != other.effect:  # a vibration whose name one of the two does not show
        one, other = (replace(f, effect="vibration_tone") for f in (one, other))
    pair = quantities_of(one, other)
    if pair is None:
        return []
    if turned and is_line(one):
        pair = of_any_direction(pair[0]), of_any_direction(pair[1])
    return [subtract(*pair)]


def in_neither(
    reasons: Sequence[Reasons], said: set[Key], names: tuple[str, str]
) -> tuple[list[Key], list[NotCompared]]:
    """Return what was looked for in both and found in neither, and what one of the two cannot show.

    said: effects and sensors of which something is said already.
    """
    neither, missing = [], []
    for key in dict.fromkeys([*reasons[0], *reasons[1]]):
        if key in said or key[0].endswith(MEASURED_ELSEWHERE):
            continue
        whys = [one.get(key, _why_not_sought(key[0])) for one in reasons]
        cannot = [f"{name}: {why}" for name, why in zip(names, whys, strict=True) if why is not None]
        if cannot:
            same = whys[0] is not None and whys[0] == whys[1]
            missing.append(NotCompared(*key, f"both: {whys[0]}" if same else "; ".join(cannot)))
        else:
            neither.append(key)
    return neither, missing


def _why_not_sought(effect: str) -> str:
    """Say why an effect is not in a recording's list at all."""
    if effect == "thermal_latent":
        return "its temperature was recorded"
    return "it has no such column" if "_bias_" in effect else "no such sensor"
