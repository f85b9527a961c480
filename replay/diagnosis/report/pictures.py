"""Which pictures illustrate a finding, with what they show in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.replay.diagnosis.judged import Judged, bins_of
from stillcal.replay.diagnosis.phone.case import Case, case_of
from stillcal.replay.diagnosis.report import figures
from stillcal.replay.diagnosis.report.curves import Curve, curves_of
from stillcal.replay.diagnosis.words.names import capital, noun, parameter_noun, simulation_text
from stillcal.replay.diagnosis.words.relation_text import labels_of

SPECTRAL = ("vibration_tone", "bandwidth", "noise_level", "noise_unequal_axes")
VALUED = ("accel_quantisation", "gyro_quantisation", "noise_heavy_tailed", "unknown")
LIMITED = ("accel_saturation", "gyro_saturation")


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as SVG, what it shows for those who do not see it, and its caption."""

    svg: str
    alt: str
    caption: str


Sources = figures.RecordedAndSimulated


@dataclass(frozen=True, slots=True, eq=False)
class Album:
    """What pictures are made of: the recording's case and, by sensor, the samples that are drawn together.

    case: the recording's own effects, which the curves are of; None where nothing is at rest.
    """

    case: Case | None
    samples: Mapping[str, Sources]

    @classmethod
    def of(cls, judged: Judged) -> Album:
        """Gather the recording, the simulation as it is, and the corrected one."""
        recorded, simulated = judged.recorded, judged.simulated
        name = simulation_text(judged.answer["simulation"])
        sides = [(recorded.accelerometer, recorded.gyroscope, recorded.bins, "recorded", figures.RECORDED)]
        if simulated is not None:
            one = (simulated.accelerometer, simulated.gyroscope, simulated.bins)
            sides.append((*one, name, figures.BEFORE))
        if judged.corrected is not None:
            made = judged.corrected
            sides.append((made.accelerometer, made.gyroscope, bins_of(made), "corrected", figures.AFTER))
        force = [(label, colour, accel, bins) for accel, _, bins, label, colour in sides]
        rate = [(label, colour, gyro, bins) for _, gyro, bins, label, colour in sides if gyro is not None]
        case = judged.case or case_of(judged.recording, recorded, compare_with_ideal(recorded))
        return cls(case if len(case.bins) else None, {"accel": force, "timing": force, "gyro": rate})

    def pictures(self, answered: Mapping[str, Any]) -> list[Picture]:
        """Return the pictures of one finding of the answer."""
        key = (answered["effect"], answered["sensor"])
        for finding, curves in self._curves(key):
            if curves:
                return [p for curve in curves for p in _of_curve(finding, curve)]
        return _of_samples(answered, self.samples[answered["sensor"]]) or _of_numbers(answered)

    def _curves(self, key: tuple[str, str]) -> list[tuple[Finding, list[Curve]]]:
        if (case := self.case) is None:
            return []
        return [
            (m.finding, curves_of(m, case.bins, case.conditions, case.affine, case.gravity))
            for m in case.mapped
            if (m.finding.effect, m.finding.sensor) == key
        ]


def _of_curve(finding: Finding, curve: Curve) -> list[Picture]:
    svgs = figures.curve_figures(curve)
    effect = noun(finding.effect, finding.sensor)
    against = Picture(
        svgs[0],
        f"Bias of axis {curve.axis} against {curve.x_name}, with the curve of the {effect}.",
        f"Axis {curve.axis}: bias in each static interval, against {curve.x_name}.",
    )
    in_time = Picture(
        svgs[-1],
        f"Bias of axis {curve.axis} in time, with the cross-validated prediction of the {effect}.",
        f"Axis {curve.axis}: the line in each fifth was fitted to the other four fifths; the dots about zero"
        " are the residual."
        if curve.held_out is not None
        else f"Axis {curve.axis} in time: the part that no known effect explains.",
    )
    return [in_time] if len(svgs) == 1 else [against, in_time]


def _of_numbers(finding: Mapping[str, Any]) -> list[Picture]:
    """Return a picture for each parameter that both the recording and the simulation have."""
    found = []
    for name, recorded in finding["parameters"].items():
        simulated = finding["simulated"].get(name)
        if simulated is None or "ci95" not in recorded:
            continue
        sides = [
            _numbers("recorded", figures.RECORDED, recorded),
            _numbers("simulated", figures.BEFORE, simulated),
        ]
        labels = labels_of(name, sides[0][2].size)
        what = capital(noun(finding["effect"], finding["sensor"]))
        caption = f"{what}: {parameter_noun(name)}, recorded and simulated, with 95 % intervals."
        svg = figures.numbers_figure(sides, labels, recorded["unit"], name)
        found.append(Picture(svg, caption, caption))
    return found


def _numbers(label: str, colour: str, parameter: Mapping[str, Any]) -> figures.Numbers:
    value = np.asarray(parameter["value"], dtype=np.float64).ravel()
    ends = np.asarray(parameter.get("ci95", np.stack([value, value], axis=-1)), dtype=np.float64)
    return label, colour, value, ends.reshape(-1, 2)


Draw = Callable[[Sources, str], str]


def _of_samples(finding: Mapping[str, Any], sources: Sources) -> list[Picture]:
    """Return the picture of what single samples or stamps do; none where no kind of picture shows it."""
    kind = _kind(finding)
    if kind is None or not sources:
        return []
    draw, what, caption = kind
    alt = f"{what}: {', '.join(label for label, *_ in sources)}."
    return [Picture(draw(sources, UNIT.get(finding["sensor"], "")), alt, caption)]


def _kind(finding: Mapping[str, Any]) -> tuple[Draw, str, str] | None:
    """Return how a finding is drawn, what the picture is of, and its caption."""
    effect = finding["effect"]
    axis = "xyz".index(finding["axes"][0]) if finding["axes"] else 0
    if effect in SPECTRAL:
        mark = _number(finding, "frequency", "cutoff")
        draw: Draw = lambda three, unit: figures.spectrum_figure(three, unit, axis, mark)  # noqa: E731 - one of five
        return draw, "Noise density at rest", f"Noise density of axis {'xyz'[axis]} at rest."
    if effect in LIMITED:
        limit = _number(finding, "limit") or 1.0
        return (
            lambda three, unit: figures.extremes_figure(three, unit, axis, limit),
            "Histogram of values",
            f"How often axis {'xyz'[axis]} reads how much, whatever the sign (log scale).",
        )
    if finding["sensor"] == "timing":
        late = effect == "arrival_bursts"
        caption = "Histogram of sample intervals (log scale)."
        return (
            lambda three, _: figures.intervals_figure(three, arrival=late),
            "Histogram of intervals",
            caption,
        )
    if effect in VALUED and finding["where"]["driver"] != "rate of turn":
        caption = "Histogram of samples about the mean of their static interval (log scale)."
        draw = lambda three, unit: figures.values_figure(three, unit, axis)  # noqa: E731 - one of five
        return draw, "Histogram of samples at rest", caption
    return None


def _number(finding: Mapping[str, Any], *names: str) -> float | None:
    for name in names:
        for side in ("parameters", "simulated"):
            value = finding[side][name]["value"] if name in finding[side] else None
            if isinstance(value, float):
                return value
    return None
