"""The page of a recording against a simulation: what differs, drawn as numbers with their intervals."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from importlib.metadata import version
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.judged import Judged
from stillcal.replay.diagnosis.relation_text import (
    headline,
    labels_of,
    noun,
    outcome,
    probability_text,
    readable,
    reasons,
    shown_of,
    simulation_text,
    with_interval,
)
from stillcal.replay.diagnosis.report import figures, tables
from stillcal.replay.diagnosis.report.pictures import Album
from stillcal.replay.diagnosis.wording import EQUATIONS, ending, to_record

STYLE = """
:root{color-scheme:light}
body{font:16px/1.5 system-ui,sans-serif;color:#222;background:#fff;margin:0 auto;max-width:64rem;
 padding:1rem;overflow-wrap:anywhere}
h1{font-size:1.5rem;line-height:1.25}h2{font-size:1.2rem;margin-top:2.2rem;border-top:1px solid #ccc;
 padding-top:1rem}h3{font-size:1.05rem;margin-top:1.8rem}
.verdict{font-size:1.15rem;padding:.8rem 1rem;border-left:.4rem solid #0b6e99;background:#f1f6f8}
.verdict.match{border-color:#2e7d32;background:#f0f7f0}
.verdict.unidentified,.verdict.partly_identified,
.verdict.not_judged{border-color:#c65a11;background:#fbf3ec}
.pictures{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,27rem),1fr));gap:1rem}
figure{margin:.6rem 0;max-width:31rem}figure.wide{max-width:46rem}
img{width:100%;height:auto;display:block}figcaption{font-size:.9rem;color:#444}
code,.equation{font-family:ui-monospace,monospace;font-size:.92rem}
.equation{background:#f6f6f6;padding:.5rem .7rem}
.no{color:#8a3c00;font-weight:600}footer{margin-top:2.5rem;font-size:.85rem;color:#555}
"""

ROW_INCHES = 0.55
"""Height of one axis' row in a figure of two values."""

RELATIONS = {
    "lacking": "the simulation lacks it",
    "too_small": "smaller in the simulation, all numbers together",
    "too_large": "larger in the simulation, all numbers together",
    "superfluous": "only the simulation has it",
}


def page(judged: Judged) -> str:
    """Return the page's HTML."""
    answer = judged.answer
    names = escape(answer["recording"]), escape(simulation_text(answer["simulation"]))
    parts = [
        f"<h1>{names[0]} against {names[1]}</h1>",
        f'<p class="verdict {escape(answer["verdict"])}">{escape(_verdict(answer))}</p>',
        _header(judged),
        *_findings(judged),
        *_agreed(answer),
        *_not_compared(answer),
        *_sensitivity(answer),
        "<footer>Made by <code>stillcal diagnose</code>. Intervals are 95 %. docs/comparison.md describes the"
        " method and this page.</footer>",
    ]
    return document(f"{names[0]} against {names[1]}", parts)


def document(title: str, parts: Iterable[str]) -> str:
    """Return a whole HTML document. title, parts: trusted HTML."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{title}</title>"
        f"<style>{STYLE}{tables.STYLE}</style></head><body><main>\n{chr(10).join(parts)}\n</main></body></html>\n"
    )


def figure_html(svg: str, alt: str, caption: str, *, wide: bool = False) -> str:
    """Return a picture with its caption, held in the page itself."""
    data = base64.b64encode(svg.encode()).decode()
    kind = ' class="wide"' if wide else ""
    return (
        f'<figure{kind}><img alt="{escape(alt)}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _verdict(answer: Mapping[str, Any]) -> str:
    return " ".join(f"{headline(answer)}. {outcome(answer)}".split())


def _header(judged: Judged) -> str:
    rows = []
    for name, exam in (
        (judged.answer["recording"], judged.recorded),
        (judged.answer["simulation"], judged.simulated),
    ):
        if exam is None:
            continue
        accel, gyro = exam.accelerometer, exam.gyroscope
        rows.append(
            (
                escape(name),
                _length(accel),
                _rate(accel),
                "none" if gyro is None else _rate(gyro),
                "no" if exam.bins.temperature is None else "yes",
                f"{float(exam.bins.duration.sum()) / 60.0:.1f} min",
            )
        )
    heads = ("file", "length", "accelerometer", "gyroscope", "thermometer", "at rest")
    return f"<p>stillcal {escape(version('stillcal'))}</p>" + tables.table(heads, rows)


def _length(samples: Samples) -> str:
    return f"{float(samples.t[-1] - samples.t[0]) / 60.0:.1f} min"


def _rate(samples: Samples) -> str:
    return f"{(len(samples) - 1) / float(samples.t[-1] - samples.t[0]):.4g} Hz"


def _findings(judged: Judged) -> Iterator[str]:
    answer = judged.answer
    if not answer["findings"]:
        return
    yield "<h2>What differs</h2>"
    album = Album.of(judged)
    for finding in answer["findings"]:
        axes = ", ".join(finding["axes"])
        what = noun(finding["effect"], finding["sensor"])
        yield f"<h3>{escape(what[0].upper() + what[1:])}{' on ' + axes if axes else ''}</h3>"
        yield f"<p>{escape(finding['statement'])}</p>"
        share = probability_text(finding["probability"])
        yield f"<p>{RELATIONS[finding['relation']].capitalize()}. Probability of a difference: {share}.</p>"
        if equation := ending(finding["effect"], EQUATIONS):
            yield f'<p class="equation">{equation}</p>'
        yield _to_paste(finding)
        yield _table(finding)
        drawn = [figure_html(p.svg, p.alt, p.caption) for p in album.pictures(finding)]
        if judged.simulated is not None:
            drawn += [_picture(finding, name) for name in finding["difference"] if name != "ratio"]
        if drawn:
            yield f'<div class="pictures">{"".join(drawn)}</div>'
        if following := to_record(finding["effect"], finding["sensor"]):
            yield f"<p>What to record next: {escape(following)}.</p>"


def _to_paste(finding: Mapping[str, Any]) -> str:
    """Return the temperature that a finding counts from, and its NumPy function folded up."""
    at = finding.get("reference", {}).get("temperature_c")
    counted = "" if at is None else f"<p>T₀ = {at:.4g} °C.</p>"
    if "numpy" not in finding:
        return counted
    code = f'<pre class="equation">{escape(finding["numpy"])}</pre>'
    return f"{counted}<details><summary>NumPy function that takes it out</summary>{code}</details>"


def _table(finding: Mapping[str, Any]) -> str:
    names = list(dict.fromkeys([*finding["parameters"], *finding["simulated"], *finding["difference"]]))
    rows = [
        (
            escape(name.replace("_", " ")),
            *(_cell(finding, side, name) for side in ("parameters", "simulated", "difference")),
        )
        for name in names
    ]
    heads = ("parameter", "recorded", "simulated", "add to the simulation")
    return tables.table(heads, rows)


def _cell(finding: Mapping[str, Any], side: str, name: str) -> str:
    if name not in finding[side]:
        return ""
    parameter = finding[side][name]
    labels = labels_of(name, np.size(parameter["value"]))
    return escape(with_interval(parameter, labels, shown_of(finding, name, "xyz")))


def _picture(finding: Mapping[str, Any], name: str) -> str:
    sides = [finding["parameters"].get(name), finding["simulated"].get(name)]
    what = noun(finding["effect"], finding["sensor"])
    what = f"{what[0].upper() + what[1:]}: {name.replace('_', ' ')}"
    caption = f"{what}, recorded and simulated, with 95 % intervals."
    return figure_html(_two_values(name, sides), caption, caption)


def _two_values(name: str, sides: Sequence[Mapping[str, Any] | None]) -> str:
    """Draw one parameter's numbers row by row, the recorded above the simulated."""
    known = [s for s in sides if s is not None]
    count = np.asarray(known[0]["value"], dtype=np.float64).size
    labels = labels_of(name, count)
    with figures.drawing(0.8 + ROW_INCHES * count) as (_, axes, out):
        unit = ""
        for side, label, colour, shift in (
            (sides[0], "recorded", figures.INK, 0.12),
            (sides[1], "simulated", figures.BEFORE, -0.12),
        ):
            if side is None:
                continue
            value, low, high, unit = _shown(side)
            rows = np.arange(count)[::-1] + shift
            axes.errorbar(
                value, rows, xerr=[value - low, high - value], fmt="o", color=colour, label=label, capsize=3
            )
        axes.set_yticks(np.arange(count)[::-1], labels)
        axes.set_ylim(-0.6, count - 0.4)
        axes.set_xlabel(unit.replace("^2", "²"))
        axes.grid(axis="x", color="#dddddd", linewidth=0.6)
    return out[0]


def _shown(side: Mapping[str, Any]) -> tuple[Array, Array, Array, str]:
    """Return values and the ends of their intervals in the unit that people read."""
    value = np.asarray(side["value"], dtype=np.float64).ravel()
    ends = np.asarray(side.get("ci95", np.stack([value, value], axis=-1)), dtype=np.float64).reshape(-1, 2)
    factor, unit = readable(1.0, side["unit"])
    return value * factor, ends[:, 0] * factor, ends[:, 1] * factor, unit


def _agreed(answer: Mapping[str, Any]) -> Iterator[str]:
    if not answer["agreed"]:
        return
    yield "<h2>What agrees</h2>"
    rows = [
        (
            escape(noun(a["effect"], a["sensor"])),
            "; ".join(f"{escape(k.replace('_', ' '))}: {_cell(a, 'parameters', k)}" for k in a["parameters"]),
        )
        for a in answer["agreed"]
    ]
    yield tables.table(("quantity", "recorded"), rows)


def _not_compared(answer: Mapping[str, Any]) -> Iterator[str]:
    if answer["not_compared"]:
        yield "<h2>What could not be compared</h2>"
        rows = [(escape(why), escape(", ".join(what))) for why, what in reasons(answer).items()]
        yield tables.table(("why", "effects"), rows)


def _sensitivity(answer: Mapping[str, Any]) -> Iterator[str]:
    if answer["sensitivity"]:
        yield "<h2>How small a difference would have been seen</h2>"
        yield "<p>A difference of this size on one axis would have been stated nine times in ten.</p>"
        rows = []
        for s in answer["sensitivity"]:
            value, unit = readable(s["smallest_seen_90"], s["unit"])
            what = f"{noun(s['effect'], s['sensor'])}: {s['parameter'].replace('_', ' ')}"
            rows.append((escape(what), f"{value:.2g} {escape(unit)}"))
        yield tables.table(("quantity", "smallest difference"), rows)
