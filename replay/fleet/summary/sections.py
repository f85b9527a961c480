"""The summary of a fleet as tables of text, for the terminal and the page alike."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from stillcal.replay.diagnosis.words.units import pretty
from stillcal.replay.fleet.summary.report import Report

Row = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Section:
    """A table with its title; `about` says how to read it."""

    title: str
    about: str
    heads: Row
    rows: list[Row]


def sections(report: Report) -> Iterator[Section]:
    """Yield the tables that have rows, what needs somebody's attention first."""
    for section in (
        Section(
            "Devices that got worse",
            "Farther from an ideal sensor in the last recording than in the first (in the order of names), by"
            " more than the uncertainty of both and by more than the fleet's devices ordinarily change. A"
            " bias also changes with temperature: compare those of the two recordings.",
            ("device", "model", "what", "first", "last", "sd", "temperatures, °C"),
            _changes(report, worse=True),
        ),
        Section(
            "Devices that changed otherwise",
            "The same, but not farther from an ideal sensor than before.",
            ("device", "model", "what", "first", "last", "sd", "temperatures, °C"),
            _changes(report, worse=False),
        ),
        Section(
            "Outlier devices",
            "Devices whose six biases and scales do not belong to the fleet: Mahalanobis distance beyond its"
            " limit.",
            ("device", "model", "distance", "limit", "most"),
            _outliers(report),
        ),
        Section(
            "All devices",
            "One calibration a device: the recording with the most attitudes.",
            ("quantity", "unit", "devices", "median", "middle half"),
            _spreads(report),
        ),
        Section(
            "Bias by model, m/s²",
            "Median and middle half of each axis.",
            ("model", "devices", "x", "y", "z"),
            _biases(report),
        ),
        Section(
            "Effects found",
            "In how many of the diagnosed recordings, and the size of the effect's first parameter: median,"
            " middle half, and the median size of each axis.",
            ("model", "effect", "sensor", "recordings", "size", "by axis x, y, z"),
            _effects(report),
        ),
        Section(
            "Clusters",
            "Devices alike in bias, rate and steadiness of the rate.",
            ("exemplar", "devices", "bias, m/s²", "rate, Hz", "models"),
            _clusters(report),
        ),
        Section(
            "Priors: bias, m/s²",
            "What to expect of a new device; stillcal fleet-first begins with it.",
            ("model", "devices", "x", "y", "z", "± each"),
            _priors(report),
        ),
    ):
        if section.rows:
            yield section


def _changes(report: Report, *, worse: bool) -> list[Row]:
    return [
        (
            c.device,
            c.model,
            c.quantity,
            f"{c.first:+.4g} {pretty(c.unit)}",
            f"{c.last:+.4g} {pretty(c.unit)}",
            f"{c.sds:.1f}",
            "-" if c.first_c is None or c.last_c is None else f"{c.first_c:.0f} to {c.last_c:.0f}",
        )
        for c in report.changes
        if c.worse == worse
    ]


def _spreads(report: Report) -> list[Row]:
    return [
        (s.quantity, pretty(s.unit), str(s.devices), f"{s.median:.3g}", f"{s.low:.3g} to {s.high:.3g}")
        for s in report.spreads
        if s.of_all_models
    ]


def _biases(report: Report) -> list[Row]:
    models = dict.fromkeys(s.model for s in report.spreads if not s.of_all_models)
    rows = []
    for model in models:
        own = [s for s in report.spreads if s.model == model and s.quantity.startswith("accelerometer bias")]
        alone = own[0].devices == 1
        cells = (f"{s.median:+.3f}" + ("" if alone else f" ({s.low:+.3f} to {s.high:+.3f})") for s in own)
        rows.append((model, str(own[0].devices), *cells))
    return rows


def _effects(report: Report) -> list[Row]:
    return [
        (
            e.model,
            e.effect,
            e.sensor,
            f"{e.found} of {e.diagnosed}",
            f"{e.parameter} {e.median:.3g} ({e.low:.3g} to {e.high:.3g}) {pretty(e.unit)}",
            "  ".join(f"{size:.3g}" for size in e.by_axis),
        )
        for e in report.effects
    ]


def _outliers(report: Report) -> list[Row]:
    return [
        (
            o.device,
            o.model,
            f"{o.distance:.1f}",
            f"{o.limit:.1f}",
            f"{o.parameter} {o.value:+.4g}, the others {o.median:+.4g}",
        )
        for o in report.outliers
    ]


def _clusters(report: Report) -> list[Row]:
    return [
        (
            c.exemplar,
            str(c.devices),
            f"{c.bias:.3f}",
            f"{c.rate_hz:.1f}",
            ", ".join(f"{n} {model}" for model, n in c.models.items()),
        )
        for c in report.clusters
    ]


def _priors(report: Report) -> list[Row]:
    return [
        (
            p.model or "any",
            str(p.of_model if p.model else p.devices),
            *(f"{m:+.3f}" for m in p.mean[:3]),
            ", ".join(f"{v**0.5:.3f}" for v in p.covariance.diagonal()[:3]),
        )
        for p in report.priors
    ]
