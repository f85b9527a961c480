"""Which pictures illustrate a finding, with what they show in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillcal.calib_core.diagnosis.motion.axis_delays import DRIVER as AXES_LATE
from stillcal.calib_core.diagnosis.motion.unseen_tilt import DRIVER as UNSEEN_TILT
from stillcal.calib_core.diagnosis.noise.coloured_noise import DRIVER as COLOURED
from stillcal.calib_core.diagnosis.noise.lines.line import COMES_AND_GOES, WANDERS
from stillcal.calib_core.diagnosis.noise.lines.steady_period import DRIVER as STEADY_PERIOD
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.diagnosis.sequence import codes as own_code
from stillcal.calib_core.diagnosis.sequence import lone_values, order, places, recurrence
from stillcal.calib_core.diagnosis.sequence.stamps import FEW, LEAP, PATTERN
from stillcal.calib_core.diagnosis.slow.turns.turn_errors import DRIVER as TURNS
from stillcal.calib_core.diagnosis.stamps.clock_wander import DRIVER as WANDERING
from stillcal.replay.diagnosis.judged import Judged, bins_of
from stillcal.replay.diagnosis.report import figures, sample_figures
from stillcal.replay.diagnosis.report.curves import Curve
from stillcal.replay.diagnosis.report.sides import Side
from stillcal.replay.diagnosis.words.names import capital, noun, parameter_noun, simulation_text
from stillcal.replay.diagnosis.words.relation_text import labels_of
from stillcal.replay.diagnosis.words.units import pretty

SPECTRAL = ("vibration_tone", "bandwidth", "noise_level", "noise_unequal_axes")
VALUED = ("accel_quantisation", "gyro_quantisation", "noise_heavy_tailed", "unknown")
UNEVEN = (LEAP, PATTERN, FEW)
OF_TURNS = ("rate of turn", TURNS)
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
    """What pictures are made of: both sides and, by sensor, the samples that are drawn together.

    sides: the recording, and the simulation where that is a recording too. turned: what moved together.
    """

    sides: tuple[Side, ...]
    samples: Mapping[str, Sources]
    turned: tuple[figures.Turned, ...]

    @classmethod
    def of(cls, judged: Judged) -> Album:
        """Gather the recording, the simulation as it is, and the corrected one."""
        recorded, simulated = judged.recorded, judged.simulated
        name = simulation_text(judged.answer["simulation"])
        compared = [Side("recorded", figures.RECORDED, "parameters", recorded)]
        sides = [(recorded.accelerometer, recorded.gyroscope, recorded.bins, "recorded", figures.RECORDED)]
        if simulated is not None:
            # Of one motion the difference of both is drawn, and the simulation has no curve of its own.
            if not compared[0].paired:
                compared.append(Side(name, figures.BEFORE, "simulated", simulated))
            one = (simulated.accelerometer, simulated.gyroscope, simulated.bins)
            sides.append((*one, name, figures.BEFORE))
        if judged.corrected is not None:
            made = judged.corrected
            sides.append((made.accelerometer, made.gyroscope, bins_of(made), "corrected", figures.AFTER))
        force = [(label, colour, accel, bins) for accel, _, bins, label, colour in sides]
        rate = [(label, colour, gyro, bins) for _, gyro, bins, label, colour in sides if gyro is not None]
        # A corrected simulation has the constants that it was made with: the simulation's or the recording's.
        exams = [side.exam for side in compared] + [compared[-1].exam]
        turned = [
            figures.Turned(label, colour, accel, gyro, own.aligned, own.on_limits)
            for (accel, gyro, _, label, colour), own in zip(sides, exams, strict=False)
            if gyro is not None
        ]
        return cls(tuple(compared), {"accel": force, "timing": force, "gyro": rate}, tuple(turned))

    def pictures(self, answered: Mapping[str, Any]) -> list[Picture]:
        """Return the pictures of one finding of the answer."""
        # What gravity says of each side's delay is not how one reads later than the other of one motion.
        between = self.sides[0].paired and len(self.turned) > 1
        delay = answered["effect"] == "accel_gyro_time_offset" or answered["where"]["driver"] == AXES_LATE
        if delay:
            return _of_numbers(answered) if between else _of_delay(answered, self.turned)
        # What only the simulation has is its curve, with the recording beside it.
        first, *others = self.sides[::-1] if answered["relation"] == "superfluous" else self.sides
        curves = first.curves(answered)
        beside = [(side, c) for side in others for c in side.curves(answered)] if curves else []
        pictures: list[Picture] = []
        for curve in curves:
            pictures += _of_curve(answered, [(first, curve), *(p for p in beside if p[1].axis == curve.axis)])
        if pictures:
            return pictures
        return _of_samples(answered, self.samples[answered["sensor"]]) or _of_numbers(answered)


def _of_curve(answered: Mapping[str, Any], drawn: Sequence[tuple[Side, Curve]]) -> list[Picture]:
    """Return the pictures of one axis: of the side that is first, with the others beside it."""
    curve = drawn[0][1]
    svgs = figures.curve_figures([(side.label, side.colour, one) for side, one in drawn])
    effect = noun(answered["effect"], answered["sensor"])
    against = Picture(
        svgs[0],
        f"Bias of axis {curve.axis} against {curve.x_name}, with the curve of the {effect}.",
        f"Axis {curve.axis}: bias in each static interval, against {pretty(curve.x_name)}.",
    )
    in_time = Picture(
        svgs[-1],
        f"Bias of axis {curve.axis} in time, with the cross-validated prediction of the {effect}.",
        f"Axis {curve.axis}, {drawn[0][0].label}: the line in each fifth was fitted to the other four fifths;"
        " the dots about zero are the residual."
        if curve.held_out is not None
        else f"Axis {curve.axis} in time: the part that no known effect explains.",
    )
    if curve.period is not None:
        return [against]
    return [in_time] if len(svgs) == 1 else [against, in_time]


def _of_delay(answered: Mapping[str, Any], turned: Sequence[figures.Turned]) -> list[Picture]:
    """Return what is left of motion over the delay that is tried."""
    delay = _number(answered, "delay") or 0.0
    what = (
        "What the gyroscope's rotation leaves of the turn that gravity shows, over the delay that is tried"
        " (1: its least). The least is at the delay between the sensors."
    )
    svg = figures.delay_figure(turned, delay)
    return [] if svg is None else [Picture(svg, f"{what} {', '.join(t.label for t in turned)}.", what)]


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
    kind = _nameless(finding) or _kind(finding)
    if kind is None or not sources:
        return []
    draw, what, caption = kind
    alt = f"{what}: {', '.join(label for label, *_ in sources)}."
    return [Picture(draw(sources, UNIT.get(finding["sensor"], "")), alt, caption)]


def _kind(finding: Mapping[str, Any]) -> tuple[Draw, str, str] | None:
    """Return how a finding is drawn, what the picture is of, and its caption."""
    effect = finding["effect"]
    axis = "xyz".index(finding["axes"][0]) if finding["axes"] else 0
    driver = finding["where"]["driver"]
    if effect in SPECTRAL or driver in (COMES_AND_GOES, WANDERS, COLOURED):
        mark = _number(finding, "frequency", "cutoff")
        marks = finding["where"]["band_hz"] if driver == COLOURED else [] if mark is None else [mark]
        draw: Draw = lambda three, unit: figures.spectrum_figure(three, unit, axis, marks)  # noqa: E731 - one of five
        return draw, "Noise density at rest", f"Noise density of axis {'xyz'[axis]} at rest."
    if effect in LIMITED:
        limit = _number(finding, "limit") or 1.0
        return (
            lambda three, unit: figures.extremes_figure(three, unit, axis, limit),
            "Histogram of values",
            f"How often axis {'xyz'[axis]} reads how much, whatever the sign (log scale).",
        )
    if effect == "unknown" and finding["sensor"] == "timing":
        by_host = finding["where"]["driver"] == WANDERING
        caption = (
            "Quickest deliveries: arrival less stamp, without a line." if by_host else "Median intervals."
        )
        return (
            lambda three, _: figures.course_figure(three, arrival=by_host),
            "Course of the stamps in time",
            caption,
        )
    if finding["sensor"] == "timing":
        late = effect == "arrival_bursts"
        caption = "Histogram of sample intervals (log scale)."
        return (
            lambda three, _: figures.intervals_figure(three, arrival=late),
            "Histogram of intervals",
            caption,
        )
    if effect in VALUED and finding["where"]["driver"] not in OF_TURNS:
        caption = "Histogram of samples about the mean of their static interval (log scale)."
        draw = lambda three, unit: figures.values_figure(three, unit, axis)  # noqa: E731 - one of five
        return draw, "Histogram of samples at rest", caption
    return None


def _nameless(finding: Mapping[str, Any]) -> tuple[Draw, str, str] | None:
    """Return how an effect of single samples without a name is drawn; None for any other."""
    if finding["effect"] != "unknown":
        return None
    name = finding["axes"][0] if finding["axes"] else "x"
    axis, driver = "xyz".index(name), finding["where"]["driver"]
    if finding["sensor"] == "timing":
        if driver not in UNEVEN:
            return None
        caption = "Histogram of sample intervals (log scale)."
        return (
            lambda three, _: figures.intervals_figure(three, arrival=False),
            "Histogram of intervals",
            caption,
        )
    if (event := _event(finding, driver, axis)) is not None:
        return event
    what = {own_code.DRIVER: sample_figures.CODES, places.DRIVER: sample_figures.COUNT}.get(driver)
    period = _number(finding, "period_codes", "period_samples")
    if what is None or period is None:
        return None
    return (
        lambda three, unit: sample_figures.cycle_figure(three, unit, axis, period, what),
        f"Size of residuals over the {what}",
        f"Median size of what neighbours leave of samples of axis {name}, over the {what}.",
    )


def _event(finding: Mapping[str, Any], driver: str, axis: int) -> tuple[Draw, str, str] | None:
    """Return how an effect without a name is drawn that has a moment or a steady period; None for others."""
    name, at = "xyz"[axis], float(finding["where"]["t_start"])
    if driver in (order.DRIVER, recurrence.AGAIN, recurrence.STALE, lone_values.DRIVER):
        return (
            lambda three, unit: sample_figures.samples_figure(three, unit, axis, at),
            "Single samples where it first happens",
            f"Samples of axis {name} where it first happens.",
        )
    if driver == UNSEEN_TILT:
        return (
            lambda three, unit: sample_figures.jump_figure(three, unit, axis, at),
            "Means of seconds about the jump",
            f"Axis {name} about the first jump: the mean of each second.",
        )
    frequency = _number(finding, "frequency")
    if driver == STEADY_PERIOD and frequency:
        cycle = 1.0 / frequency
        return (
            lambda three, unit: sample_figures.period_figure(three, unit, axis, cycle),
            "Mean over the period",
            f"Axis {name} at rest over the period of {cycle:.4g} s: the mean of the samples in each part.",
        )
    return None


def _number(finding: Mapping[str, Any], *names: str) -> float | None:
    for name in names:
        for side in ("parameters", "simulated"):
            value = finding[side][name]["value"] if name in finding[side] else None
            if isinstance(value, float):
                return value
    return None
