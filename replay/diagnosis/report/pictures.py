"""Which pictures illustrate a finding, with what they show in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.report import figures
from stillcal.replay.diagnosis.report.curves import Curve
from stillcal.replay.diagnosis.report.inputs import Case, Resimulation
from stillcal.replay.diagnosis.report.phone_effects import MappedFinding
from stillcal.replay.diagnosis.wording import readable
from stillcal.replay.formats.trace import Recording

SPECTRAL = ("vibration_tone", "bandwidth", "noise_level", "noise_unequal_axes")
VALUED = ("accel_quantisation", "gyro_quantisation", "noise_heavy_tailed", "unknown")
LIMITED = ("accel_saturation", "gyro_saturation")


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as SVG, what it shows for those who do not see it, and its caption."""

    svg: str
    alt: str
    caption: str


def pictures(
    case: Case, mapped: MappedFinding, resimulated: tuple[Resimulation, Resimulation] | None
) -> list[Picture]:
    """Return the pictures of one finding."""
    curves = case.curves(mapped)
    if curves:
        return [p for curve in curves for p in _of_curve(mapped.finding, curve)]
    sample_pictures = [] if resimulated is None else _of_samples(case, mapped.finding, resimulated)
    return sample_pictures or _of_held_out(mapped.finding)


def _of_held_out(finding: Finding) -> list[Picture]:
    before, after = finding.evidence.heldout_rmse_before, finding.evidence.heldout_rmse_after
    if not before > 0.0:
        return []
    alt = f"Cross-validation residual without it {before:.3g} rms, with it {after:.3g}."
    caption = "Prediction error on parts of the recording that were left out of the fit, without and with it."
    return [Picture(figures.held_out_figure(before, after), alt, caption)]


def _of_curve(finding: Finding, curve: Curve) -> list[Picture]:
    svgs = figures.curve_figures(curve)
    effect = finding.effect.replace("_", " ")
    low, high = float(curve.point.min()), float(curve.point.max())
    size = f"from {low:.3g} to {high:.3g} {readable(curve.unit)}"
    against = Picture(
        svgs[0],
        f"Bias of axis {curve.axis} against {curve.x_name}, {size}, with the curve of {effect}.",
        f"Axis {curve.axis}: bias in each static interval, against {readable(curve.x_name)}.",
    )
    in_time = Picture(
        svgs[-1],
        f"Bias of axis {curve.axis} in time, {size}, with the cross-validated prediction of {effect}.",
        f"Axis {curve.axis}: the line in each fifth was fitted to the other four fifths; the dots about zero"
        " are the residual."
        if curve.held_out is not None
        else f"Axis {curve.axis} in time: the part that no known effect explains.",
    )
    return [in_time] if len(svgs) == 1 else [against, in_time]


def _of_samples(
    case: Case, finding: Finding, resimulated: tuple[Resimulation, Resimulation]
) -> list[Picture]:
    """Return the picture of what single samples or stamps do; none where no kind of picture shows it."""
    recorded_and_simulated = _recorded_and_simulated(case, finding, resimulated)
    kind = _kind(finding)
    if recorded_and_simulated is None or kind is None:
        return []
    draw, what, caption = kind
    alt = f"{what}: recorded, simulated without and with the effects found."
    return [Picture(draw(recorded_and_simulated, UNIT.get(finding.sensor, "")), alt, caption)]


Draw = Callable[[figures.RecordedAndSimulated, str], str]


def _kind(finding: Finding) -> tuple[Draw, str, str] | None:
    """Return how a finding is drawn, what the picture is of, and its caption."""
    axis = "xyz".index(finding.axes[0]) if finding.axes else 0
    if finding.effect in SPECTRAL:
        mark = _number(finding, "frequency", "cutoff")
        draw: Draw = lambda three, unit: figures.spectrum_figure(three, unit, mark)  # noqa: E731 - one of five
        return (
            draw,
            "Noise density at rest",
            "Noise density at rest: with the effects found, the dashed line should lie on the recorded one.",
        )
    if finding.effect in LIMITED:
        limit = _number(finding, "limit") or 1.0
        return (
            lambda t, unit: figures.extremes_figure(t, unit, limit),
            "Histogram of largest values",
            "Histogram of the largest axis value of each sample. Between rests the simulated phone moves only"
            " roughly as recorded, and may not reach the limit.",
        )
    if finding.sensor == "timing":
        late = finding.effect == "arrival_bursts"
        caption = "Histogram of sample intervals (log scale)."
        return lambda t, _: figures.intervals_figure(t, arrival=late), "Histogram of intervals", caption
    if finding.effect in VALUED and finding.where.driver != "rate of turn":
        caption = "Histogram of samples about the mean of their static interval (log scale)."
        return lambda t, unit: figures.values_figure(t, unit, axis), "Histogram of samples at rest", caption
    return None


def _number(finding: Finding, *names: str) -> float | None:
    for name in names:
        value = finding.parameters[name].value if name in finding.parameters else None
        if isinstance(value, float):
            return value
    return None


def _recorded_and_simulated(
    case: Case, finding: Finding, resimulated: tuple[Resimulation, Resimulation]
) -> figures.RecordedAndSimulated | None:
    """Return the sensor's samples recorded, before and after; None where there are none."""
    recordings = [
        (case.recording, case.bins, "recorded", figures.RECORDED),
        (resimulated[0].recording, resimulated[0].bins, "simulated without", figures.BEFORE),
        (resimulated[1].recording, resimulated[1].bins, "simulated with effects", figures.AFTER),
    ]
    rows = []
    for recording, bins, label, colour in recordings:
        samples = _samples(recording, finding.sensor)
        if samples is None:
            return None
        rows.append((label, colour, samples, bins))
    return rows


def _samples(recording: Recording, sensor: str) -> Samples | None:
    return recording.gyroscope if sensor == "gyro" else recording.accelerometer
