"""The report's pictures, as SVG text: curves, spectra, values, intervals, numbers.

Small and alike, so that they read on a phone: one width, one set of colours, labels with units. Needs
matplotlib (the extra `report`).
"""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned
from stillcal.calib_core.diagnosis.motion.time_offset import power_over_delays
from stillcal.calib_core.diagnosis.motion.turning_windows import Span
from stillcal.calib_core.diagnosis.noise.low_pass import LEAST_PIECES, quiet, spectra
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.stamps.clock import arrivals
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.report.curves import Curve, running_median
from stillcal.replay.diagnosis.words.names import parameter_noun
from stillcal.replay.diagnosis.words.units import pretty, shown_in
from stillcal.replay.palette import BLUE, RED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 5.0, 3.1
"""Size of a picture, inches: two stand side by side on a page at a desk, one on a phone."""

GAP, GAP_OF_USUAL = 0.03, 4.0
"""A line is broken where no point is for this part of the recording, and for so many usual spacings."""

DELAYS, SHOWN_DELAYS, LEAST_SHOWN = 15, 2.5, 0.02
"""How many delays are drawn, up to how many times the one found, and up to at least how much, s."""

COURSE = 200
"""Points of a course of stamps over time."""

ROW_INCHES = 0.45
"""Height of one number's row."""

INK, RECORDED, BEFORE, AFTER = "#222222", "#444444", RED, BLUE
SHADED_BELOW = 0.9
"""A finding in less than this share of the recording is shaded in time."""

STYLE: Any = {
    "font.size": 9.5,
    "font.family": "sans-serif",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.labelcolor": INK,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.columnspacing": 1.2,
    "legend.handlelength": 1.4,
    "svg.fonttype": "path",
    "svg.hashsalt": "stillcal",
    "axes.formatter.useoffset": False,
}


class NoMatplotlibError(UserError):
    """matplotlib is not installed, so the pictures cannot be drawn."""

    def __init__(self) -> None:
        remedy = "pip install '.[report]' in the source folder, or pip install matplotlib"
        super().__init__(f"the report's pictures need matplotlib: {remedy}")


def require_matplotlib() -> None:
    """Raise NoMatplotlibError where matplotlib is not installed, before any work is done."""
    if importlib.util.find_spec("matplotlib") is None:
        raise NoMatplotlibError


@contextmanager
def drawing(height: float = HEIGHT) -> Iterator[tuple[Figure, Axes, list[str]]]:
    """Give a figure with one pair of axes; the list has its SVG text after the block.

    What was labelled stands in a legend above the axes, where it can lie on no curve.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415 - an extra
        from matplotlib.figure import Figure  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise NoMatplotlibError from error
    out: list[str] = []
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        axes = figure.add_subplot()
        yield figure, axes, out
        labels = axes.get_legend_handles_labels()[1]
        if labels:
            axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(labels), borderaxespad=0.0)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    out.append(text.getvalue())


Drawn = Sequence[tuple[str, str, Curve]]
"""Label, colour and curve of each side; the first is the one whose effect it is."""


def curve_figures(sides: Drawn) -> list[str]:
    """Draw a finding on one axis: against its driver, and in time with the cross-validated prediction."""
    curve = sides[0][2]
    scale, unit = shown_in(np.concatenate([one.point for _, _, one in sides]), curve.unit)
    alike = [side for side in sides if side[2].x_name == curve.x_name]
    if curve.period is not None:
        return [_against(alike, scale, unit)]
    if curve.x_name.startswith("time"):
        return [_in_time(alike, scale, unit)]
    return [_against(alike, scale, unit), _in_time(sides[:1], scale, unit)]


def _against(sides: Drawn, scale: float, unit: str) -> str:
    curve = sides[0][2]
    with drawing() as (_, axes, out):
        for label, colour, one in sides:
            y = one.partial_point * scale
            axes.plot(one.x, y, ".", color=colour, ms=4, alpha=0.6, label=label)
        for place, (_, colour, one) in enumerate(sides):
            known = one.partial_component
            if known is not None:
                order = np.argsort(one.x)
                x, y, label = one.x[order], known[order], "fitted"
            elif place == 0:
                x, y = running_median(one.x, one.partial_point)
                label = "running median (cause unknown)"
            else:
                continue
            said = label if place == 0 else None
            dash = "-" if place == 0 else "--"
            axes.plot(x, y * scale, dash, color=_line_colour(colour), lw=1.8, label=said)
        axes.set_xlabel(pretty(curve.x_name))
        axes.set_ylabel(f"{curve.y_name} {curve.axis}, {pretty(unit)}")
    return out[0]


def _line_colour(colour: str) -> str:
    """Return the colour of the line through points of a colour."""
    return AFTER if colour == RECORDED else colour


def _in_time(sides: Drawn, scale: float, unit: str) -> str:
    label, colour, curve = sides[0]
    length = float(curve.edges[-1] - curve.edges[0])
    with drawing() as (_, axes, out):
        if curve.span[1] - curve.span[0] < SHADED_BELOW * length:
            axes.axvspan(curve.span[0] / 60.0, curve.span[1] / 60.0, color="#f1e3d6", label="effect present")
        axes.plot(curve.t / 60.0, curve.point * scale, ".", color=colour, ms=4, alpha=0.6, label=label)
        if curve.held_out is None:
            t, y = broken(*running_median(curve.t, curve.point, 30), length)
            axes.plot(t / 60.0, y * scale, color=BEFORE, lw=1.8, label="running median (cause unknown)")
        else:
            remaining = (curve.point - curve.held_out) * scale
            axes.plot(curve.t / 60.0, remaining, ".", color=AFTER, ms=3, alpha=0.5, label="residual")
            t, y = broken(curve.t, curve.held_out, length)
            axes.plot(
                t / 60.0, y * scale, ".-", color=AFTER, ms=2.5, lw=1.6, label="cross-validated prediction"
            )
            for edge in curve.edges[1:-1] / 60.0:
                axes.axvline(edge, color="#bbbbbb", lw=0.8, ls=":")
        for other, other_colour, one in sides[1:]:
            axes.plot(one.t / 60.0, one.point * scale, ".", color=other_colour, ms=4, alpha=0.6, label=other)
            if one.partial_component is not None:
                t, y = broken(one.t, one.partial_component, length)
                axes.plot(t / 60.0, y * scale, "--", color=_line_colour(other_colour), lw=1.6)
        axes.set_xlabel(
            "time, min (dotted: parts left out in turn)" if curve.held_out is not None else "time, min"
        )
        axes.set_ylabel(f"bias {curve.axis}, {pretty(unit)}")
    return out[0]


def broken(t: Array, y: Array, length: float) -> tuple[Array, Array]:
    """Return a line through points (n,) with a NaN in each gap, where it would show what nothing measured.

    length: of the recording, s. Rests that are few and alike far apart are one line.
    """
    gaps = np.diff(t)
    wide = np.flatnonzero(gaps > max(GAP * length, GAP_OF_USUAL * float(np.median(gaps)))) + 1
    return np.insert(t, wide, np.nan), np.insert(y, wide, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """Both sensors of one recording with their constants (None without rests), as a label and a colour.

    spoiled: when they are no measurement.
    """

    label: str
    colour: str
    accelerometer: Samples
    gyroscope: Samples
    aligned: Aligned | None
    spoiled: Sequence[Span]


def delay_figure(turned: Sequence[Turned], delay: float) -> str | None:
    """Draw what motion leaves over the gyroscope's delay, s, that is tried; None with too little motion."""
    tried = np.linspace(-1.0, 1.0, DELAYS) * max(SHOWN_DELAYS * abs(delay), LEAST_SHOWN)
    lines = [(one, power) for one in turned if (power := _power(one, tried)) is not None]
    if not lines:
        return None
    with drawing() as (_, axes, out):
        for one, power in lines:
            dash = "--" if one.colour == AFTER else "-"
            axes.plot(tried * 1e3, power, dash, marker=".", lw=1.5, color=one.colour, label=one.label)
        axes.axvline(delay * 1e3, color="#999999", lw=1.0, ls=":")
        axes.set_xlabel(f"gyroscope behind the accelerometer by, ms (dotted: {delay * 1e3:.3g} ms)")
        axes.set_ylabel("power left, relative to the least")
    return out[0]


def _power(one: Turned, tried: Array) -> Array | None:
    return power_over_delays(one.accelerometer, one.gyroscope, one.aligned, tried, spoiled=one.spoiled)


RecordedAndSimulated = Sequence[tuple[str, str, Samples, Bins]]
"""Label, colour, samples and static bins of the recording, the simulation, and the corrected simulation."""


def spectrum_figure(sources: RecordedAndSimulated, unit: str, axis: int, marks: Sequence[float]) -> str:
    """Draw the noise densities of one axis at rest. marks: Hz, of a frequency or the ends of a band."""
    lines = []
    for label, colour, samples, bins in sources:
        still = quiet(samples, bins)
        if len(still.pieces) >= LEAST_PIECES:
            f, power = spectra(still)
            lines.append((label, colour, f[1:], np.sqrt(np.median(power[:, 1:, axis], axis=0))))
    typical = float(np.median(lines[0][3])) if lines else 0.0
    scale, name = shown_in(typical, f"{unit}/sqrt(Hz)")
    with drawing() as (_, axes, out):
        for label, colour, f, density in lines:
            # A simulation that matches lies on the recording: both must be visible.
            dash = "--" if colour == AFTER else "-"
            axes.loglog(f, density * scale, dash, color=colour, lw=1.5, label=label)
        for mark in marks:
            axes.axvline(mark, color="#999999", lw=1.0, ls=":")
        dotted = " and ".join(f"{mark:.4g}" for mark in marks)
        axes.set_xlabel(f"frequency, Hz (dotted: {dotted} Hz)" if dotted else "frequency, Hz")
        axes.set_ylabel(f"noise density {'xyz'[axis]}, {name}")
    return out[0]


def values_figure(sources: RecordedAndSimulated, unit: str, axis: int) -> str:
    """Draw a histogram of single samples at rest about their bin's mean."""
    with drawing() as (_, axes, out):
        parts = [(label, colour, _pooled(samples, bins, axis)) for label, colour, samples, bins in sources]
        spread = max(float(np.abs(p).max(initial=1e-9)) for _, _, p in parts)
        wide = min(spread, 8.0 * max(float(p.std()) if p.size else 1e-9 for _, _, p in parts))
        edges = np.linspace(-wide, wide, 122)
        scale, name = shown_in(wide, unit)
        for label, colour, p in parts:
            share = np.histogram(p, edges)[0] / max(p.size, 1)
            axes.stairs(share, edges * scale, color=colour, lw=1.3, label=label)
        axes.set_yscale("log")
        axes.set_xlabel(f"sample minus the interval's mean, {'xyz'[axis]}, {pretty(name)}")
        axes.set_ylabel("share of samples")
    return out[0]


def _pooled(samples: Samples, bins: Bins, axis: int) -> Array:
    pieces = quiet(samples, bins).pieces
    return np.concatenate([p[:, axis] for p in pieces]) if pieces else np.empty(0)


def intervals_figure(sources: RecordedAndSimulated, *, arrival: bool) -> str:
    """Draw the intervals between stamps, or between arrivals."""
    with drawing() as (_, axes, out):
        period = float(np.median(np.diff(sources[0][2].t)))
        edges = np.linspace(0.0, 4.0 * period, 162) * 1e3
        for label, colour, samples, _bins in sources:
            t = samples.t_arrival if arrival else samples.t
            if t is None:
                continue
            steps = np.diff(t) * 1e3
            axes.stairs(np.histogram(steps, edges)[0] / steps.size, edges, color=colour, lw=1.3, label=label)
        axes.set_yscale("log")
        axes.set_xlabel(f"interval between {'arrivals' if arrival else 'stamps'}, ms")
        axes.set_ylabel("share of intervals")
    return out[0]


def course_figure(sources: RecordedAndSimulated, *, arrival: bool) -> str:
    """Draw over time the least of arrival less stamp without its line, or the median interval of stamps."""
    with drawing() as (_, axes, out):
        for label, colour, samples, _bins in sources:
            t, late = samples.t, arrivals(samples) if arrival else None
            if arrival and late is None:
                continue
            parts = np.array_split(np.arange(t.size - 1), COURSE)
            at = np.array([t[p].mean() for p in parts])
            if late is None:
                y = np.array([np.median(np.diff(t)[p]) for p in parts])
            else:
                y = np.array([(late - t)[p].min() for p in parts])
                y -= np.polyval(np.polyfit(at, y, 1), at)
            axes.plot((at - t[0]) / 60.0, y * 1e3, color=colour, lw=1.5, label=label)
        axes.set_xlabel("time, min")
        axes.set_ylabel("arrival less stamp, line off, ms" if arrival else "interval between stamps, ms")
    return out[0]


def extremes_figure(sources: RecordedAndSimulated, unit: str, axis: int, limit: float) -> str:
    """Draw a histogram of the values of one axis, without their signs. limit: is marked."""
    scale, name = shown_in(limit, unit)
    with drawing() as (_, axes, out):
        edges = np.linspace(0.0, 1.3 * limit, 131)
        for label, colour, samples, _bins in sources:
            share = np.histogram(np.abs(samples.xyz[:, axis]), edges)[0] / max(len(samples), 1)
            axes.stairs(share, edges * scale, color=colour, lw=1.3, label=label)
        axes.axvline(limit * scale, color="#999999", lw=1.0, ls=":")
        axes.set_yscale("log")
        axes.set_xlabel(f"size of {'xyz'[axis]}, {name} (dotted: {limit * scale:.4g})")
        axes.set_ylabel("share of samples")
    return out[0]


Numbers = tuple[str, str, Array, Array]
"""Label, colour, values (k,) and their intervals (k, 2) of one side."""


def numbers_figure(sides: Sequence[Numbers], labels: Sequence[str], unit: str, name: str) -> str:
    """Draw the numbers of one parameter with their intervals, one row each. name: of the parameter."""
    largest = max((float(np.abs(value).max(initial=0.0)) for _, _, value, _ in sides), default=0.0)
    scale, shown = shown_in(largest, unit, name)
    count = len(labels)
    with drawing(ROW_INCHES * count + 0.8) as (_, axes, out):
        for place, (label, colour, value, ends) in enumerate(sides):
            rows = np.arange(count)[::-1] + 0.12 * (1.0 - 2.0 * place)
            errors = np.maximum(np.abs(ends.T - value), 0.0) * scale
            axes.errorbar(value * scale, rows, xerr=errors, fmt="o", color=colour, label=label, capsize=3)
        axes.axvline(0.0, color="#bbbbbb", lw=0.8)
        axes.set_yticks(np.arange(count)[::-1], labels)
        axes.set_ylim(-0.6, count - 0.4)
        axes.set_xlabel(f"{parameter_noun(name)}{', ' if shown else ''}{shown}")
        axes.grid(axis="x", color="#dddddd", linewidth=0.6)
    return out[0]
