"""The report: one page that needs nothing else, read from the top down.

All text that comes from files or names is escaped; pictures are data in the page itself.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator
from html import escape
from typing import Any

import numpy as np

from stillcal.calib_core.misfit.records import Finding
from stillcal.replay.report import figures
from stillcal.replay.report.case import Case, Trial
from stillcal.replay.report.curves import UNIT, slow
from stillcal.replay.report.mapping import Mapped
from stillcal.replay.report.pictures import Picture, pictures
from stillcal.replay.report.summary import told
from stillcal.replay.report.wording import (
    EQUATIONS,
    certainty,
    ending,
    headline,
    interval,
    number,
    shown,
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
.scroll{overflow-x:auto}table{border-collapse:collapse;font-size:.9rem;min-width:20rem}
th,td{overflow-wrap:normal;text-align:left;vertical-align:top;
 padding:.25rem .7rem .25rem 0;border-bottom:1px solid #ddd}
code,.equation{font-family:ui-monospace,monospace;font-size:.92rem}
.equation{background:#f6f6f6;padding:.5rem .7rem;overflow-x:auto}
.no{color:#8a3c00;font-weight:600}footer{margin-top:2.5rem;font-size:.85rem;color:#555}
"""


def page(case: Case, answer: dict[str, Any], both: tuple[Trial, Trial] | None) -> str:
    """Return the page's HTML. answer: the plain diagnosis; both: the twins before and after, if made."""
    name = escape(case.diagnosis.recording)
    parts = [
        f"<h1>Why {name} differs from its simulation</h1>" if answer["findings"] else f"<h1>{name}</h1>",
        *_verdict(case, answer),
        "<h2>Where it departs</h2>",
        _figure(_map(case), wide=True),
        *_findings(case, answer, both),
        *_comparison(answer),
        *_checked(answer),
        "<footer>Made by <code>stillcal diagnose</code>. Intervals are 95 %; p-values carry the size of the"
        " search. The method stands in docs/misfit.md, this page in docs/report.md.</footer>",
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{name}: {escape(answer['verdict'].replace('_', ' '))}</title><style>{STYLE}</style></head>"
        f"<body><main>\n{chr(10).join(parts)}\n</main></body></html>\n"
    )


def _verdict(case: Case, answer: dict[str, Any]) -> Iterator[str]:
    checks = answer["checked"]
    done = sum(c["done"] for c in checks)
    kind, words = answer["verdict"], headline(answer["verdict"], done, len(checks))
    said = kind.replace("_", " ").capitalize()
    yield f'<p class="verdict {escape(kind)}"><strong>{escape(said)}</strong>: {escape(words)}.</p>'
    yield _list(f["statement"] for f in answer["findings"])
    known = [f"{k['effect']} ({k['sensor']}): {k['why']}" for k in answer.get("already_simulated", ())]
    if known:
        yield "<p>Already in the simulation, and so no news:</p>" + _list(known)
    absent = [f"{k['effect']}: {k['why']}" for k in answer.get("only_simulated", ())]
    if absent:
        yield "<p>In the simulation, and not in the recording:</p>" + _list(absent)
    if answer["limits"]:
        yield "<p>What this recording cannot show:</p>" + _list(answer["limits"])


def _list(items: Iterable[str]) -> str:
    rows = "".join(f"<li>{escape(item)}</li>" for item in items)
    return f"<ul>{rows}</ul>" if rows else ""


def _map(case: Case) -> Picture:
    loudest = max(case.map.channels, key=lambda c: float(_largest(c.departure)))
    minutes = (case.map.edges[-1] - case.map.edges[0]) / 60.0
    size = _largest(loudest.departure)
    alt = (
        f"Map of departures over {minutes:.0f} minutes for {len(case.map.channels)} channels; the largest"
        f" is {size:.0f} units of noise in {loudest.name}."
    )
    caption = (
        "Each row is a channel: the norm of gravity and the rates at rest, the spread of single samples at"
        " rest, how far intervals are off the period. Each column is a stretch of time; grey is where the"
        " phone moved. Colour is the departure from the twin before anything found is taken off; beyond"
        f" {figures.CLIP:.0f} units it is full. One unit of noise in the row that departs most,"
        f" {loudest.name}, is {number(loudest.noise)} {loudest.unit}."
    )
    return Picture(figures.map_figure(case.map), alt, caption)


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


def _findings(case: Case, answer: dict[str, Any], both: tuple[Trial, Trial] | None) -> Iterator[str]:
    if not case.found:
        return
    yield "<h2>What was found</h2>"
    for one in case.found:
        yield from _finding(case, one, both)


def _finding(case: Case, one: Mapped, both: tuple[Trial, Trial] | None) -> Iterator[str]:
    finding = one.finding
    yield f"<h3>{escape(title(finding))}</h3><p>{escape(finding.statement)}</p>"
    equation = ending(finding.effect, EQUATIONS)
    if equation:
        yield f'<p class="equation">{equation}</p>'
    drawn = pictures(case, one, both)
    if drawn:
        yield f'<div class="pictures">{"".join(_figure(p) for p in drawn)}</div>'
    yield _parameters(finding)
    yield f"<p>{_sure(finding)}</p>"
    yield _alternatives(finding)
    following = to_record(finding)
    if following:
        yield f"<p>To learn more: {escape(following)}.</p>"
    if one.effect is None:
        yield f"<p>In the phone file: {escape(one.why)}.</p>"


def _parameters(finding: Finding) -> str:
    rows = [
        (escape(name), escape(shown(p.value)), escape(interval(p.ci95)), escape(p.unit))
        for name, p in finding.parameters.items()
    ]
    return _table(("parameter", "value", "95 % interval", "unit"), rows)


def _sure(finding: Finding) -> str:
    e, where = finding.evidence, finding.where
    unit = UNIT[finding.sensor] + " " if slow(finding) else ""
    span = f"from {where.t_start:.0f} to {where.t_end:.0f} s"
    text = (
        f"How sure: {certainty(e.p_value)} (p = {e.p_value:.1e}), {span}, following {escape(where.driver)}."
    )
    if e.folds:
        text += (
            f" Held out in {e.folds} parts, the residual falls from {number(e.heldout_rmse_before)} to"
            f" {number(e.heldout_rmse_after)} {unit}rms, and the log score gains"
            f" {number(e.heldout_log_score_gain)}."
        )
    elif e.heldout_rmse_before > 0.0:
        rms = f"{number(e.heldout_rmse_before)} to {number(e.heldout_rmse_after)}"
        text += f" It takes the residual from {rms} rms."
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
    return "<p>What else was tried for it:</p>" + _table(("effect", "held-out log score gain", ""), rows)


def _comparison(answer: dict[str, Any]) -> Iterator[str]:
    given = answer.get("comparison")
    if given is not None:
        yield "<h2>Beside the simulated recording</h2>"
        yield f"<p>The simulated recording {escape(told(given))}.</p>" + _tests(given)
    before, after = answer.get("comparison_before"), answer.get("comparison_after")
    if before is None or after is None:
        return
    if not answer["findings"]:
        yield "<h2>Beside its simulated twin</h2>"
        yield (
            "<p>A simulated phone, with the affine errors and the noise measured here, lives through this"
            f" recording's own day. Its recording: {escape(told(after))}.</p>"
        )
        yield _tests(after)
        return
    yield "<h2>The simulation before and after</h2>"
    yield (
        "<p>A simulated phone lives through this recording's own day, rest by rest, once as it was and once"
        " with what was found; both recordings are then compared with this one.</p>"
    )
    yield f"<p>Before: {escape(told(before))}. After: {escape(told(after))}.</p>"
    yield _tests(before, after)


def _tests(before: dict[str, Any], after: dict[str, Any] | None = None, most: int = 12) -> str:
    """Return the table of the statistics that differ most, with what they are afterwards."""
    later = {} if after is None else {(t["statistic"], t["channel"]): t for t in after["tests"]}
    rows = []
    for t in before["tests"][:most]:
        cells = [escape(t["statistic"]), escape(t["channel"]), number(t["recorded"])]
        cells += [number(t["simulated"]), f"{t['p_corrected']:.1e}"]
        other = later.get((t["statistic"], t["channel"]))
        if after is not None:
            cells += (
                ["", ""] if other is None else [number(other["simulated"]), f"{other['p_corrected']:.1e}"]
            )
        rows.append((*cells, escape(t["unit"])))
    heads: tuple[str, ...] = ("statistic", "channel", "recorded", "simulated", "p")
    if after is not None:
        heads = (*heads[:3], "simulated before", "p before", "simulated after", "p after")
    note = f"<p>The {len(rows)} of {len(before['tests'])} statistics that differ most; p is corrected.</p>"
    return note + _table((*heads, "unit"), rows)


def _checked(answer: dict[str, Any]) -> Iterator[str]:
    yield "<h2>What was checked</h2>"
    rows = [
        (escape(c["what"]), "yes" if c["done"] else '<span class="no">no</span>', escape(c["how"]))
        for c in answer["checked"]
    ]
    yield _table(("departures", "checked", "on what, or why not"), rows)
    if answer["findings"]:
        yield "<p>After what was found, nothing else passed the threshold of the search.</p>"


def _table(heads: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Return a table of trusted cells."""
    head = "".join(f'<th scope="col">{h}</th>' for h in heads)
    body = "".join(f"<tr>{''.join(f'<td>{c}</td>' for c in row)}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
