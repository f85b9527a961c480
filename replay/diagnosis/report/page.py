"""The report: one page that needs nothing else, read from the top down.

All text that comes from files or names is escaped; pictures are data in the page itself.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator
from html import escape
from typing import Any

import numpy as np

from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.replay.diagnosis.report import figures, tables
from stillcal.replay.diagnosis.report.curves import UNIT, is_slow
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
.verdict.unexplained,.verdict.partly_explained{border-color:#c65a11;background:#fbf3ec}
.pictures{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,27rem),1fr));gap:1rem}
figure{margin:.6rem 0;max-width:31rem}figure.wide{max-width:46rem}
img{width:100%;height:auto;display:block}figcaption{font-size:.9rem;color:#444}
code,.equation{font-family:ui-monospace,monospace;font-size:.92rem}
.equation{background:#f6f6f6;padding:.5rem .7rem}
.no{color:#8a3c00;font-weight:600}footer{margin-top:2.5rem;font-size:.85rem;color:#555}
"""

SIMULATED_LAST = {
    "adequate": "Its simulated twin",
    "unexplained": "A phone simulated as it was measured, without what has no name",
}
"""What was simulated last, by verdict, where it is not a phone with what was found."""


def page(case: Case, answer: dict[str, Any], resimulated: tuple[Resimulation, Resimulation] | None) -> str:
    """Return the page's HTML. answer: the plain diagnosis; both: the twins before and after, if made."""
    name = escape(case.diagnosis.recording)
    parts = [
        f"<h1>Why {name} differs from its simulation</h1>" if answer["findings"] else f"<h1>{name}</h1>",
        *_verdict(case, answer),
        "<h2>Where it departs</h2>",
        _figure(_map(case), wide=True),
        *_findings(case, answer, resimulated),
        *_comparison(answer),
        *_checked(answer),
        "<footer>Made by <code>stillcal diagnose</code>. Intervals are 95 %; p-values carry the size of the"
        " search. The method stands in docs/diagnosis.md, this page in docs/report.md.</footer>",
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{name}: {escape(answer['verdict'].replace('_', ' '))}</title>"
        f"<style>{STYLE}{tables.STYLE}</style></head><body><main>\n{chr(10).join(parts)}\n</main></body></html>\n"
    )


def _verdict(case: Case, answer: dict[str, Any]) -> Iterator[str]:
    checks = answer["checked"]
    done = sum(c["done"] for c in checks)
    kind, words = answer["verdict"], headline(answer["verdict"], done, len(checks))
    verdict = kind.replace("_", " ").capitalize()
    yield f'<p class="verdict {escape(kind)}"><strong>{escape(verdict)}</strong>: {escape(words)}.</p>'
    if "judged_phone" in answer:
        sentence = judged_against(answer["judged_phone"])
        yield f"<p>{escape(sentence[0].upper() + sentence[1:])}.</p>"
    yield _list(readable(f["statement"]) for f in answer["findings"])
    yield _outcome(answer)
    known = [f"{k['effect']} ({k['sensor']}): {k['why']}" for k in answer.get("already_simulated", ())]
    if known:
        yield "<p>Already in the simulation, and so no news:</p>" + _list(known)
    absent = [f"{k['effect']}: {k['why']}" for k in answer.get("only_simulated", ())]
    if absent:
        yield "<p>In the simulation, and not in the recording:</p>" + _list(absent)
    if answer["limits"]:
        yield "<p>What this recording cannot show:</p>" + _list(answer["limits"])


def _outcome(answer: dict[str, Any]) -> str:
    """Say beside the verdict whether the simulation is now the recording's: a verdict may not hide that."""
    after = answer.get("comparison_after")
    if after is None:
        return ""
    which = SIMULATED_LAST.get(answer["verdict"], "A phone simulated with what was found")
    return f"<p>{which}, on this recording's own day: {escape(comparison_text(after))}.</p>"


def _list(items: Iterable[str]) -> str:
    rows = "".join(f"<li>{escape(item)}</li>" for item in items)
    return f"<ul>{rows}</ul>" if rows else ""


def _map(case: Case) -> Picture:
    loudest = max(case.departure_map.channels, key=lambda c: float(_largest(c.departure)))
    minutes = (case.departure_map.edges[-1] - case.departure_map.edges[0]) / 60.0
    size = _largest(loudest.departure)
    alt = (
        f"Map of departures over {minutes:.0f} minutes for {len(case.departure_map.channels)} channels; the"
        f" largest is {size:.0f} units of noise in {loudest.name}."
    )
    caption = (
        "Each row is a channel: the norm of gravity and the rates at rest, the spread of single samples at"
        " rest, how far intervals are off the period. Each column is a stretch of time; grey is where the"
        " phone moved or nothing was recorded. Colour is the departure from the twin before anything found is"
        f" taken off; beyond {figures.CLIP:.0f} units it is full. One unit of noise in the row that departs"
        f" most, {loudest.name}, is {number(loudest.noise)} {readable(loudest.unit)}."
    )
    return Picture(figures.map_figure(case.departure_map), alt, caption)


def _largest(values: Any) -> float:
    finite = [abs(float(v)) for v in values if np.isfinite(v)]
    return max(finite, default=0.0)


def _figure(picture: Picture, *, wide: bool = False) -> str:
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
    yield "<h2>What was found</h2>"
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
        yield f'<div class="pictures">{"".join(_figure(p) for p in shown_pictures)}</div>'
    yield tables.parameters(finding)
    yield f"<p>{_sure(finding, case.conditions.t_start)}</p>"
    yield _alternatives(finding)
    following = to_record(finding)
    if following:
        yield f"<p>What to record next: {escape(following)}.</p>"
    if mapped.effect is None:
        yield f"<p>In the phone file: {escape(mapped.why)}.</p>"


def _sure(finding: Finding, start: float) -> str:
    e, where = finding.evidence, finding.where
    unit = readable(UNIT[finding.sensor]) + " " if is_slow(finding) else ""
    span = f"from {where.t_start - start:.0f} to {where.t_end - start:.0f} s after the start"
    text = f"How sure: {certainty(e.p_value)} (p = {tables.p_words(e.p_value)}), {span},"
    text += f" following {escape(where.driver)}."
    better = "falls" if e.heldout_rmse_after < e.heldout_rmse_before else "does not fall"
    rms = f"{number(e.heldout_rmse_before)} to {number(e.heldout_rmse_after)} {unit}rms"
    if e.folds:
        gain = e.heldout_log_score_gain
        text += f" Held out in {e.folds} parts, the residual {better}: {rms}; the log score"
        text += f" {'gains' if gain > 0.0 else 'loses'} {number(abs(gain))} nats."
    elif e.heldout_rmse_before > 0.0:
        text += f" The residual {better}: {rms}."
    return text


def _alternatives(finding: Finding) -> str:
    if not finding.alternatives:
        return ""
    rows = [
        (
            escape(a.effect.replace("_", " ")),
            number(a.heldout_log_score_gain),
            "cannot be told apart here" if a.indistinguishable else "explains it less well",
        )
        for a in finding.alternatives
    ]
    return "<p>What else was tried for it:</p>" + tables.table(
        ("effect", "held-out log score gain", "verdict"), rows
    )


def _comparison(answer: dict[str, Any]) -> Iterator[str]:
    with_simulated = answer.get("comparison")
    if with_simulated is not None:
        yield "<h2>Beside the simulated recording</h2>"
        yield (
            f"<p>The simulated recording: {escape(comparison_text(with_simulated))}.</p>"
            + tables.comparison(with_simulated)
        )
    before, after = answer.get("comparison_before"), answer.get("comparison_after")
    if before is None or after is None:
        return
    if not answer["findings"]:
        yield "<h2>Beside its simulated twin</h2>"
        yield (
            "<p>A simulated phone, with the affine errors and the noise measured here, lives through this"
            f" recording's own day. Its recording: {escape(comparison_text(after))}.</p>"
        )
        yield tables.comparison(after)
        return
    yield "<h2>The simulation before and after</h2>"
    yield (
        "<p>A simulated phone lives through this recording's own day, rest by rest, once as it was and once"
        " with what was found; both recordings are then compared with this one.</p>"
    )
    yield f"<p>Before: {escape(comparison_text(before))}. After: {escape(comparison_text(after))}.</p>"
    yield tables.comparison(before, after)


def _checked(answer: dict[str, Any]) -> Iterator[str]:
    yield "<h2>What was checked</h2>"
    rows = [
        (escape(c["what"]), "yes" if c["done"] else '<span class="no">no</span>', escape(c["how"]))
        for c in answer["checked"]
    ]
    yield tables.table(("departures", "checked", "on what, or why not"), rows)
    if answer["findings"]:
        yield "<p>After what was found, nothing else passed the threshold of the search.</p>"
