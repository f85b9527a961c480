"""The report's pictures, as SVG text: the map, curves, spectra, values, intervals.

Small and alike, so that they read on a phone: one width, one set of colours, labels with units. Needs
matplotlib (the extra `report`).
"""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct.low_pass import quiet, spectra
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.report.curves import Curve, running_median
from stillcal.replay.diagnosis.report.departure_map import DepartureMap
from stillcal.replay.diagnosis.wording import readable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 5.0, 3.1
"""Size of a picture, inches: two stand side by side on a page at a desk, one on a phone."""

INK, RECORDED, BEFORE, AFTER = "#222222", "#444444", "#c65a11", "#0b6e99"
CLIP = 8.0
"""Differences beyond this many units of noise have the same colour."""

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


def map_figure(departure_map: DepartureMap) -> str:
    """Draw when and in which channel the recording differs from the simulation."""
    rows = departure_map.channels
    with drawing(0.9 + 0.27 * len(rows)) as (figure, axes, out):
        minutes = (departure_map.edges - departure_map.edges[0]) / 60.0
        values = np.ma.masked_invalid(np.array([r.departure for r in rows]))
        colours = axes.pcolormesh(
            minutes, np.arange(len(rows) + 1), values, cmap="PuOr_r", vmin=-CLIP, vmax=CLIP, rasterized=True
        )
        axes.set_facecolor("#e9e9e9")
        axes.set_yticks(np.arange(len(rows)) + 0.5, [r.name for r in rows])
        axes.tick_params(axis="y", length=0)
        axes.invert_yaxis()
        axes.set_xlabel("time, min")
        bar = figure.colorbar(colours, ax=axes, location="top", shrink=0.8, aspect=40, extend="both")
        bar.set_ticks([-CLIP, -CLIP / 2, 0.0, CLIP / 2, CLIP])
        bar.set_label("difference, in units of each channel's noise")
    return out[0]


def curve_figures(curve: Curve) -> list[str]:
    """Draw a finding on one axis: against its driver, and in time with the cross-validated prediction."""
    scale, unit = prefixed(curve.point, curve.unit)
    pictures = [_in_time(curve, scale, unit)]
    if not curve.x_name.startswith("time"):
        pictures.insert(0, _against(curve, scale, unit))
    return pictures


def _against(curve: Curve, scale: float, unit: str) -> str:
    with drawing() as (_, axes, out):
        y = curve.partial_point * scale
        axes.plot(curve.x, y, ".", color=RECORDED, ms=4, alpha=0.6, label="recorded")
        if curve.partial_component is None:
            x, middle = running_median(curve.x, y)
            axes.plot(x, middle, color=BEFORE, lw=1.8, label="running median (cause unknown)")
        else:
            order = np.argsort(curve.x)
            axes.plot(
                curve.x[order], curve.partial_component[order] * scale, color=AFTER, lw=1.8, label="fitted"
            )
        axes.set_xlabel(readable(curve.x_name))
        axes.set_ylabel(f"{curve.y_name} {curve.axis}, {readable(unit)}")
    return out[0]


def _in_time(curve: Curve, scale: float, unit: str) -> str:
    with drawing() as (_, axes, out):
        minutes = curve.t / 60.0
        if curve.span[1] - curve.span[0] < SHADED_BELOW * (curve.edges[-1] - curve.edges[0]):
            axes.axvspan(curve.span[0] / 60.0, curve.span[1] / 60.0, color="#f1e3d6", label="effect present")
        axes.plot(minutes, curve.point * scale, ".", color=RECORDED, ms=4, alpha=0.6, label="recorded")
        if curve.held_out is None:
            x, y = running_median(minutes, curve.point, 30)
            axes.plot(x, y * scale, color=BEFORE, lw=1.8, label="running median (cause unknown)")
        else:
            remaining = (curve.point - curve.held_out) * scale
            axes.plot(minutes, remaining, ".", color=AFTER, ms=3, alpha=0.5, label="residual")
            axes.plot(
                minutes, curve.held_out * scale, color=AFTER, lw=1.6, label="cross-validated prediction"
            )
            for edge in curve.edges[1:-1] / 60.0:
                axes.axvline(edge, color="#bbbbbb", lw=0.8, ls=":")
        axes.set_xlabel(
            "time, min (dotted: parts left out in turn)" if curve.held_out is not None else "time, min"
        )
        axes.set_ylabel(f"bias {curve.axis}, {readable(unit)}")
    return out[0]


def prefixed(values: Array, unit: str) -> tuple[float, str]:
    """Return the factor and unit in which values are easily read: milli or micro where they are small."""
    size = float(np.quantile(np.abs(values), 0.95)) if values.size else 0.0
    if size >= 0.2 or size == 0.0:
        return 1.0, unit
    return (1e3, f"10⁻³ {unit}") if size >= 2e-4 else (1e6, f"10⁻⁶ {unit}")


RecordedAndSimulated = Sequence[tuple[str, str, Samples, Bins]]
"""Label, colour, samples and static bins of the recording, the simulation, and the corrected simulation."""


def spectrum_figure(
    recorded_and_simulated: RecordedAndSimulated, unit: str, axis: int, mark: float | None
) -> str:
    """Draw the noise densities of one axis at rest. mark: Hz."""
    with drawing() as (_, axes, out):
        for label, colour, samples, bins in recorded_and_simulated:
            still = quiet(samples, bins)
            if len(still.pieces) < 3:
                continue
            f, power = spectra(still)
            density = np.sqrt(np.median(power[:, :, axis], axis=0))
            dash = (
                "--" if colour == AFTER else "-"
            )  # a simulation that matches lies on the recording: both must be visible
            axes.loglog(f[1:], density[1:], dash, color=colour, lw=1.5, label=label)
        if mark is not None:
            axes.axvline(mark, color="#999999", lw=1.0, ls=":")
        axes.set_xlabel("frequency, Hz" if mark is None else f"frequency, Hz (dotted: {mark:.4g} Hz)")
        axes.set_ylabel(f"density {'xyz'[axis]}, {readable(unit)}/√Hz")
    return out[0]


def values_figure(recorded_and_simulated: RecordedAndSimulated, unit: str, axis: int) -> str:
    """Draw a histogram of single samples at rest about their bin's mean."""
    with drawing() as (_, axes, out):
        parts = [
            (label, colour, _pooled(samples, bins, axis))
            for label, colour, samples, bins in recorded_and_simulated
        ]
        spread = max(float(np.abs(p).max(initial=1e-9)) for _, _, p in parts)
        wide = min(spread, 8.0 * max(float(p.std()) if p.size else 1e-9 for _, _, p in parts))
        edges = np.linspace(-wide, wide, 122)
        scale, name = prefixed(np.array([wide]), unit)
        for label, colour, p in parts:
            share = np.histogram(p, edges)[0] / max(p.size, 1)
            axes.stairs(share, edges * scale, color=colour, lw=1.3, label=label)
        axes.set_yscale("log")
        axes.set_xlabel(f"sample minus the interval's mean, {'xyz'[axis]}, {readable(name)}")
        axes.set_ylabel("share of samples")
    return out[0]


def _pooled(samples: Samples, bins: Bins, axis: int) -> Array:
    pieces = quiet(samples, bins).pieces
    return np.concatenate([p[:, axis] for p in pieces]) if pieces else np.empty(0)


def intervals_figure(recorded_and_simulated: RecordedAndSimulated, *, arrival: bool) -> str:
    """Draw the intervals between stamps, or between arrivals."""
    with drawing() as (_, axes, out):
        period = float(np.median(np.diff(recorded_and_simulated[0][2].t)))
        edges = np.linspace(0.0, 4.0 * period, 162) * 1e3
        for label, colour, samples, _bins in recorded_and_simulated:
            t = samples.t_arrival if arrival else samples.t
            if t is None:
                continue
            steps = np.diff(t) * 1e3
            axes.stairs(np.histogram(steps, edges)[0] / steps.size, edges, color=colour, lw=1.3, label=label)
        axes.set_yscale("log")
        axes.set_xlabel(f"interval between {'arrivals' if arrival else 'stamps'}, ms")
        axes.set_ylabel("share of intervals")
    return out[0]


def extremes_figure(recorded_and_simulated: RecordedAndSimulated, unit: str, limit: float) -> str:
    """Draw a histogram of the largest axis value of each sample. limit: is marked."""
    with drawing() as (_, axes, out):
        edges = np.linspace(0.0, 1.3 * limit, 131)
        for label, colour, samples, _bins in recorded_and_simulated:
            share = np.histogram(np.abs(samples.xyz).max(axis=1), edges)[0] / max(len(samples), 1)
            axes.stairs(share, edges, color=colour, lw=1.3, label=label)
        axes.axvline(limit, color="#999999", lw=1.0, ls=":")
        axes.set_yscale("log")
        axes.set_xlabel(f"largest value of a sample, {readable(unit)} (dotted: {limit:.4g})")
        axes.set_ylabel("share of samples")
    return out[0]
