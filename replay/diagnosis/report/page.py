"""The report: one HTML page that loads no other file.

All text that comes from files or names is escaped; pictures are data in the page itself.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator
from html import escape
from typing import Any

import numpy as np

from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.replay.diagnosis.report import figures, tables
from stillcal.replay.diagnosis.report.curves import is_slow
from stillcal.replay.diagnosis.report.inputs import Case, Resimulation
from stillcal.replay.diagnosis.report.phone_effects import MappedFinding
from stillcal.replay.diagnosis.report.pictures import Picture, pictures
from stillcal.replay.diagnosis.report.summary import comparison_text
from stillcal.replay.diagnosis.wording import (
    EQUATIONS,
    certainty,
    ending,
    headline,
    judged_against,
    number,
    readable,
    title,
    to_record,
)

STYLE = """
:root{color-scheme:light}
body{font:16px/1.5 system-ui,sans-serif;color:#222;background:#fff;margin:0 auto;max-width:64rem;
 padding:1rem;overflow-wrap:anywhere}
h1{font-size:1.5rem;line-height:1.25}h2{font-size:1.2rem;margin-top:2.2rem;border-top:1px solid #ccc;
 padding-top:1rem}h3{font-size:1.05rem;margin-top:1.8rem}
.verdict{font-size:1.15rem;padding:.8rem 1rem;border-left:.4rem solid #0b6e99;background:#f1f6f8}
.verdict.unexplained,.verdict.partly_explained,.verdict.unidentified,.verdict.partly_identified,
.verdict.not_judged{border-color:#c65a11;background:#fbf3ec}
.pictures{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,27rem),1fr));gap:1rem}
figure{margin:.6rem 0;max-width:31rem}figure.wide{max-width:46rem}
img{width:100%;height:auto;display:block}figcaption{font-size:.9rem;color:#444}
code,.equation{font-family:ui-monospace,monospace;font-size:.92rem}
.equation{background:#f6f6f6;padding:.5rem .7rem}
.no{color:#8a3c00;font-weight:600}footer{margin-top:2.5rem;font-size:.85rem;color:#555}
"""

SIMULATED_LAST = {
    "adequate": "A phone with constant errors and plain noise, as measured here",
    "unexplained": "A phone with the errors measured here, without the effects of unknown cause",
}
"""What was simulated last, by verdict, where it is not a phone with the effects found."""


def page(case: Case, answer: dict[str, Any], resimulated: tuple[Resimulation, Resimulation] | None) -> str:
    """Return the page's HTML.

    answer: the diagnosis as plain values. resimulated: the recordings simulated without and with the effects
    found, None where they were not made.
    """
    name = escape(case.diagnosis.recording)
    parts = [
        f"<h1>Why {name} differs from its simulation</h1>" if answer["findings"] else f"<h1>{name}</h1>",
        *_verdict(case, answer),
        "<h2>Where it differs</h2>",
        figure_html(_map(case), wide=True),
        *_findings(case, answer, resimulated),
        *_comparison(answer),
        *_checked(answer),
        "<footer>Made by <code>stillcal diagnose</code>. Intervals are 95 %; p-values carry the size of the"
        " search. docs/diagnosis.md describes the method, docs/report.md this page.</footer>",
    ]
    return document(f"{name}: {escape(answer['verdict'].replace('_', ' '))}", parts)


def document(title: str, parts: Iterable[str]) -> str:
    """Return a whole HTML document. title, parts: trusted HTML."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{title}</title>"
        f"<style>{STYLE}{tables.STYLE}</style></head><body><main>\n{chr(10).join(parts)}\n</main></body></html>\n"
    )


def _verdict(case: Case, answer: dict[str, Any]) -> Iterator[str]:
    checks = answer["checked"]
    done = sum(c["done"] for c in checks)
    kind, judged_phone = answer["verdict"], answer.get("judged_phone")
    words = headline(kind, done, len(checks), against_phone=judged_phone is not None)
    strong = words.partition(":" if ":" in words else ".")[0]
    rest = words.removeprefix(strong)
    yield f'<p class="verdict {escape(kind)}"><strong>{escape(strong)}</strong>{escape(rest)}</p>'
    if judged_phone is not None:
        yield f"<p>{escape(judged_against(judged_phone))}</p>"
    yield _list(readable(f["statement"]) for f in answer["findings"])
    yield _outcome(answer)
    known = [f"{k['effect']} ({k['sensor']}): {k['why']}" for k in answer.get("already_simulated", ())]
    if known:
        yield "<p>In the recording and in the simulated phone:</p>" + _list(known)
    absent = [f"{k['effect']}: {k['why']}" for k in answer.get("only_simulated", ())]
    if absent:
        yield "<p>Only in the simulated phone:</p>" + _list(absent)
    if answer["limits"]:
        yield "<p>Not possible with this recording:</p>" + _list(answer["limits"])


def _outcome(answer: dict[str, Any]) -> str:
    """Return whether the last simulation matches the recording: a verdict may not hide that."""
    after = answer.get("comparison_after")
    if after is None:
        return ""
    which = SIMULATED_LAST.get(answer["verdict"], "A phone with the effects found")
    return f"<p>{which}, simulated with this recording's motion, {escape(comparison_text(after))}.</p>"


def _list(items: Iterable[str]) -> str:
    rows = "".join(f"<li>{escape(item)}</li>" for item in items)
    return f"<ul>{rows}</ul>" if rows else ""


def _map(case: Case) -> Picture:
    loudest = max(case.departure_map.channels, key=lambda c: float(_largest(c.departure)))
    minutes = (case.departure_map.edges[-1] - case.departure_map.edges[0]) / 60.0
    size = _largest(loudest.departure)
    alt = (
        f"Map of differences over {minutes:.0f} minutes for {len(case.departure_map.channels)} channels; the"
        f" largest is {size:.0f} units of noise in {loudest.name}."
    )
    caption = (
        "Each row is a channel: the norm of gravity and the rates at rest, the spread of single samples at"
        " rest, the deviation of sample intervals from the period. Each column is a span of time; grey is"
        " where the phone moved or nothing was recorded. Colour is the difference from the simulation without"
        f" the effects found, in units of noise; the scale ends at {figures.CLIP:.0f}. One unit of noise in"
        f" the row that differs most, {loudest.name}, is {number(loudest.noise)} {readable(loudest.unit)}."
    )
    return Picture(figures.map_figure(case.departure_map), alt, caption)


def _largest(values: Any) -> float:
    finite = [abs(float(v)) for v in values if np.isfinite(v)]
    return max(finite, default=0.0)


def figure_html(picture: Picture, *, wide: bool = False) -> str:
    """Return a picture with its caption, held in the page itself."""
    data = base64.b64encode(picture.svg.encode()).decode()
    kind = ' class="wide"' if wide else ""
    return (
        f'<figure{kind}><img alt="{escape(picture.alt)}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
    )


def _findings(
    case: Case, answer: dict[str, Any], resimulated: tuple[Resimulation, Resimulation] | None
) -> Iterator[str]:
    if not case.mapped:
        return
    yield "<h2>Effects found</h2>"
    for mapped in case.mapped:
        yield from _finding(case, mapped, resimulated)


def _finding(
    case: Case, mapped: MappedFinding, resimulated: tuple[Resimulation, Resimulation] | None
) -> Iterator[str]:
    finding = mapped.finding
    yield f"<h3>{escape(title(finding))}</h3><p>{escape(readable(finding.statement))}</p>"
    equation = ending(finding.effect, EQUATIONS)
    if equation:
        yield f'<p class="equation">{equation}</p>'
    shown_pictures = pictures(case, mapped, resimulated)
    if shown_pictures:
        yield f'<div class="pictures">{"".join(figure_html(p) for p in shown_pictures)}</div>'
    yield tables.parameters(finding)
    yield f"<p>{_sure(finding, case.conditions.t_start)}</p>"
    yield _alternatives(finding)
    following = to_record(finding)
    if following:
        yield f"<p>What to record next: {escape(following)}.</p>"
    if mapped.effect is None:
        yield f"<p>Phone file: {escape(mapped.why)}.</p>"


NOT_PREDICTED = ("saturation", "quantisation")
"""Effects that change which values occur and not what is expected next: cross-validation does not apply."""


def _sure(finding: Finding, start: float) -> str:
    """Return how sure a finding is, as trusted HTML. start: s, the recording's first stamp."""
    e, where = finding.evidence, finding.where
    unit = readable(UNIT[finding.sensor]) + " " if is_slow(finding) else ""
    span = f"{where.t_start - start:.0f} to {where.t_end - start:.0f} s"
    text = f"Confidence: {certainty(e.p_value)} (p = {tables.p_words(e.p_value)}). Seen from {span}."
    if finding.effect.endswith(NOT_PREDICTED):
        return f"{text} (Cross-validation does not apply to {finding.effect.rpartition('_')[2]}.)"
    rms = f"from {number(e.heldout_rmse_before)} to {number(e.heldout_rmse_after)} {unit}rms"
    falls = e.heldout_rmse_after < e.heldout_rmse_before
    if e.folds:
        gain = e.heldout_log_score_gain
        score = f"the log score {'gains' if gain > 0.0 else 'loses'} {number(abs(gain))} nats"
        change = f"falls {rms}" if falls else f"goes {rms}"
        text += f" In {e.folds}-fold cross-validation the residual {change}; {score}."
    elif e.heldout_rmse_before > 0.0:
        text += f" The residual {'falls' if falls else 'goes'} {rms}."
    return text


def _alternatives(finding: Finding) -> str:
    if not finding.alternatives:
        return ""
    rows = [
        (
            escape(a.effect.replace("_", " ")),
            number(a.heldout_log_score_gain),
            "cannot be distinguished here" if a.indistinguishable else "explains it less well",
        )
        for a in finding.alternatives
    ]
    return "<p>Other explanations that were tried:</p>" + tables.table(
        ("effect", "held-out log score gain", "verdict"), rows
    )


def _comparison(answer: dict[str, Any]) -> Iterator[str]:
    before, after = answer.get("comparison_before"), answer.get("comparison_after")
    if before is None or after is None:
        return
    if not answer["findings"]:
        yield "<h2>Comparison with a simulation</h2>"
        yield (
            "<p>The recording's motion was simulated with a phone that has the constant errors and the noise"
            f" measured here. The simulation {escape(comparison_text(after))}.</p>"
        )
        yield tables.comparison(after)
        return
    yield "<h2>The simulation without and with the effects</h2>"
    yield "<p>The recording's motion was simulated twice: without and with the effects found.</p>"
    yield (
        f"<p>Without them the simulation {escape(comparison_text(before))}. With them it"
        f" {escape(comparison_text(after))}.</p>"
    )
    yield tables.comparison(before, after)


def _checked(answer: dict[str, Any]) -> Iterator[str]:
    yield "<h2>What was checked</h2>"
    rows = [
        (escape(c["what"]), "yes" if c["done"] else '<span class="no">no</span>', escape(c["how"]))
        for c in answer["checked"]
    ]
    yield tables.table(("effects", "checked", "on what, or why not"), rows)
    if answer["findings"]:
        yield "<p>No other effect passed the threshold of the search.</p>"
