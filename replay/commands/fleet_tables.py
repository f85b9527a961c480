"""A fleet's report as tables for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from rich.table import Table

from stillcal.replay.fleet.report import Report
from stillcal.replay.fleet.spread import ALL


def tables(report: Report) -> Iterator[Table]:
    """Yield the tables that have rows."""
    for title, columns, rows in (
        ("All devices", ("quantity", "unit", "devices", "median", "middle half"), _spreads(report)),
        ("Bias by model, m/s²", ("model", "devices", "x", "y", "z"), _biases(report)),
        ("Left-out effects", ("model", "effect", "sensor", "recordings", "size"), _effects(report)),
        ("Outlier devices", ("device", "model", "distance", "limit", "most"), _outliers(report)),
        ("Clusters", ("exemplar", "devices", "bias, m/s²", "rate, Hz", "models"), _clusters(report)),
        ("Priors: bias, m/s²", ("model", "x", "y", "z", "± each"), _priors(report)),
    ):
        if rows:
            table = Table(*columns, title=title, title_justify="left", box=None, pad_edge=False)
            for row in rows:
                table.add_row(*row)
            yield table


def _spreads(report: Report) -> list[tuple[str, ...]]:
    return [
        (s.quantity, s.unit, str(s.devices), f"{s.median:.3g}", f"{s.low:.3g} to {s.high:.3g}")
        for s in report.spreads
        if s.model == ALL
    ]


def _biases(report: Report) -> list[tuple[str, ...]]:
    models = dict.fromkeys(s.model for s in report.spreads if s.model != ALL)
    rows = []
    for model in models:
        own = [s for s in report.spreads if s.model == model and s.quantity.startswith("accelerometer bias")]
        cells = (f"{s.median:+.3f} ({s.low:+.3f} to {s.high:+.3f})" for s in own)
        rows.append((model, str(own[0].devices), *cells))
    return rows


def _effects(report: Report) -> list[tuple[str, ...]]:
    return [
        (
            e.model,
            e.effect,
            e.sensor,
            f"{e.found} of {e.diagnosed}",
            f"{e.parameter} {e.median:.3g} ({e.low:.3g} to {e.high:.3g}) {e.unit}",
        )
        for e in report.effects
    ]


def _outliers(report: Report) -> list[tuple[str, ...]]:
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


def _clusters(report: Report) -> list[tuple[str, ...]]:
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


def _priors(report: Report) -> list[tuple[str, ...]]:
    return [
        (
            p.model or "any",
            *(f"{m:+.3f}" for m in p.mean[:3]),
            ", ".join(f"{v**0.5:.3f}" for v in p.covariance.diagonal()[:3]),
        )
        for p in report.priors
    ]
