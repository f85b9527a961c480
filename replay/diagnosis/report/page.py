"""The report: one HTML page that loads no other file, for every kind of simulation.

All text that comes from files or names is escaped; pictures are data in the page itself.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from importlib.metadata import version
from typing import Any

import numpy as np

from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.streams.resample import median_rate_hz
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.judged import Judged
from stillcal.replay.diagnosis.report import tables
from stillcal.replay.diagnosis.report.pictures import Album, Picture
from stillcal.replay.diagnosis.report.sides import in_pair
from stillcal.replay.diagnosis.words.moments import moment
from stillcal.replay.diagnosis.words.names import (
    BUILT_IN,
    THE_BUILT_IN,
    capital,
    noun,
    parameter_noun,
    simulation_text,
)
from stillcal.replay.diagnosis.words.next_recording import to_record
from stillcal.replay.diagnosis.words.relation_text import AXES, interval_of, labels_of, side_of, with_interval
from stillcal.replay.diagnosis.words.summary import headline, outcome, reasons
from stillcal.replay.diagnosis.words.units import plain, pretty, shown_in, within
from stillcal.replay.palette import BLUE, GREEN, RED

STYLE = (
    """
:root{color-scheme:light}
body{font:16px/1.5 system-ui,sans-serif;color:#222;background:#fff;margin:0 auto;max-width:64rem;
 padding:1rem;overflow-wrap:anywhere}
h1{font-size:1.5rem;line-height:1.25}h2{font-size:1.2rem;margin-top:2.2rem;border-top:1px solid #ccc;
 padding-top:1rem}h3{font-size:1.05rem;margin-top:1.8rem}
.verdict{font-size:1.15rem;padding:.8rem 1rem;border-left:.4rem solid @RED;background:#fbf3ec}
.verdict.match{border-color:@GREEN;background:#f0f7f0}
.verdict.identified{border-color:@BLUE;background:#f1f6f8}
.verdict.not_judged{border-color:#777;background:#f4f4f4}
a{color:@BLUE}.made{font-size:.85rem;color:#555}
nav ul{columns:2 20rem;padding-left:1.2rem}
.pictures{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,27rem),1fr));gap:1rem}
figure{margin:.6rem 0;max-width:31rem}
img{width:100%;height:auto;display:block}figcaption{font-size:.9rem;color:#444}
code,.equation{font-family:ui-monospace,monospace;font-size:.92rem}
.equation{background:#f6f6f6;padding:.5rem .7rem;white-space:pre-wrap}
footer{margin-top:2.5rem;font-size:.85rem;color:#555}
@media print{h2,h3{break-after:avoid}figure,tr,.verdict{break-inside:avoid}nav{display:none}}
""".replace("@RED", RED)
    .replace("@GREEN", GREEN)
    .replace("@BLUE", BLUE)
)

RELATIONS = {
    "lacking": "{} lacks it",
    "too_small": "it differs from that of {}",
    "too_large": "it differs from that of {}",
    "superfluous": "only {} has it",
}
OF_EITHER = "the recording or {} has it, which is not known"

SIDES = ("parameters", "simulated", "difference")

VECTOR = 3
"""Numbers of a parameter that stand in one row of a table."""

CONTENTS_FROM = 3
"""Findings from which the page has a list of its contents."""


def page(judged: Judged, made: str = "") -> str:
    """Return the page's HTML. made: when, and by which command, for its head; "" leaves that line out."""
    answer = judged.answer
    recording, simulation = escape(answer["recording"]), escape(simulation_text(answer["simulation"]))
    strong, _, rest = headline(answer).rpartition(" (")
    parts = [
        f"<h1>{recording} against {simulation}</h1>",
        f'<p class="made">{escape(made)}</p>' if made else "",
        f'<p class="verdict {escape(answer["verdict"])}"><strong>{escape(strong)}</strong>'
        f" ({escape(rest)}. {escape(outcome(answer))}</p>",
        _files(judged),
        _contents(answer["findings"]),
        *_findings(judged),
        *_agreed(answer),
        *_not_compared(answer),
        *_sensitivity(answer),
        f"<footer>Made by <code>stillcal diagnose</code>, version {escape(version('stillcal'))}. Intervals"
        " are 95 %. docs/comparison.md describes the method, docs/report.md this page.</footer>",
    ]
    return document(f"{recording} against {simulation}: {escape(strong)}", parts)


def document(title: str, parts: Iterable[str]) -> str:
    """Return a whole HTML document. title, parts: trusted HTML."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{title}</title>"
        f"<style>{STYLE}{tables.STYLE}</style></head><body><main>\n{chr(10).join(parts)}\n</main></body></html>\n"
    )


def _figure(picture: Picture) -> str:
    """Return a picture with its caption, held in the page itself."""
    data = base64.b64encode(picture.svg.encode()).decode()
    return (
        f'<figure><img alt="{escape(picture.alt)}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
    )


def _files(judged: Judged) -> str:
    """Return what was compared: length, rates, sensors and rest of both."""
    rows = [_file(judged.answer["recording"], judged.recorded)]
    if judged.simulated is not None:
        rows.append(_file(judged.answer["simulation"], judged.simulated))
    heads = ("file", "length", "accelerometer", "gyroscope", "thermometer", "at rest")
    # All of a pair is judged, at rest or not.
    shown = len(heads) - in_pair(judged.recorded)
    text = tables.table(heads[:shown], [row[:shown] for row in rows])
    if judged.answer["simulation"] == BUILT_IN:
        text += (
            f"<p>{capital(THE_BUILT_IN)} is an ideal sensor moved as the recording moved: constant bias,"
            " scale and misalignment as measured here, and plain noise.</p>"
        )
    return text


def _file(name: str, exam: Examination) -> tuple[str, ...]:
    accel, gyro = exam.accelerometer, exam.gyroscope
    still = float(exam.bins.duration.sum()) / 60.0
    return (
        escape(name),
        f"{float(accel.t[-1] - accel.t[0]) / 60.0:.1f} min",
        _rate(accel),
        "none" if gyro is None else _rate(gyro),
        "none" if accel.temperature is None else "yes",
        f"{still:.1f} min",
    )


def _rate(samples: Samples) -> str:
    if len(samples) < 2:
        return "no samples"
    return f"{median_rate_hz(samples):.4g} Hz"


def _contents(findings: Sequence[Mapping[str, Any]]) -> str:
    if len(findings) < CONTENTS_FROM:
        return ""
    items = "".join(f'<li><a href="#f{i}">{escape(_title(f))}</a></li>' for i, f in enumerate(findings))
    return f"<nav><ul>{items}</ul></nav>"


def _title(finding: Mapping[str, Any]) -> str:
    """Return what a finding is called: a line also by its frequency, and a step by its time."""
    axes = ", ".join(finding["axes"])
    own = finding[side_of(finding)]
    line = f", {own['frequency']['value']:.4g} Hz" if "frequency" in own else ""
    step = f", at {moment(finding['where']['t_start'])}" if finding["effect"].endswith("_bias_step") else ""
    return capital(noun(finding["effect"], finding["sensor"])) + (f" on {axes}" if axes else "") + line + step


def _findings(judged: Judged) -> Iterator[str]:
    answer = judged.answer
    if not answer["findings"]:
        return
    yield "<h2>What differs</h2>"
    album = Album.of(judged)
    for i, finding in enumerate(answer["findings"]):
        owner = judged.simulated if finding["relation"] == "superfluous" else None
        start = float((owner or judged.recorded).accelerometer.t[0])
        yield f'<h3 id="f{i}">{escape(_title(finding))}</h3><p>{escape(finding["statement"])}</p>'
        yield _table(finding)
        yield _equation(finding)
        drawn = "".join(_figure(p) for p in album.pictures(finding))
        yield f'<div class="pictures">{drawn}</div>' if drawn else ""
        yield f"<p>{escape(_sure(finding, start, simulation_text(answer['simulation'])))}</p>"
        yield _alternatives(finding)
        if following := to_record(finding["effect"], finding["sensor"]):
            yield f"<p>What to record next: {escape(following)}.</p>"


def _equation(finding: Mapping[str, Any]) -> str:
    """Return the physics as a formula, and the NumPy function that takes it out folded up."""
    equation = finding.get("equation", "")
    at = finding.get("reference", {}).get("temperature_c")
    if at is not None:
        equation += f", T0 = {at:.4g} °C"
    text = f'<p class="equation">{escape(pretty(equation))}</p>' if equation else ""
    if "numpy" in finding:
        code = f'<pre class="equation">{escape(finding["numpy"])}</pre>'
        whose = "simulation" if finding["relation"] == "superfluous" else "recording"
        title = f"NumPy function that takes it out of the {whose}'s samples"
        title += ", if it is there" if "of_either" in finding else ""
        text += f"<details><summary>{title}</summary>{code}</details>"
    return text


def _sure(finding: Mapping[str, Any], start: float, simulation: str) -> str:
    """Return how sure a finding is. start: s, the first stamp of what has it."""
    where, evidence = finding["where"], finding["evidence"]
    either = "of_either" in finding
    relation = (OF_EITHER if either else RELATIONS[finding["relation"]]).format(simulation)
    text = (
        f"Probability {finding['probability']:.2f} that {relation}. Seen from"
        f" {where['t_start'] - start:z.0f} to {where['t_end'] - start:z.0f} s"
    )
    text += "." if where["driver"] == "nothing" else f", following {where['driver']}."
    if "heldout_log_score_gain" in evidence:
        gain = evidence["heldout_log_score_gain"]
        text += f" What was left out of the fit is predicted better with it, by {plain(gain)} nats"
        text += f" in {evidence['folds']} parts." if "folds" in evidence else "."
    return text


def _table(finding: Mapping[str, Any]) -> str:
    names = list(dict.fromkeys(name for side in SIDES for name in finding[side]))
    rows = [row for name in names for row in _rows(finding, name)]
    return tables.table(("parameter", "recorded", "simulated", "add to the simulation"), rows)


def _rows(finding: Mapping[str, Any], name: str) -> Iterator[tuple[str, ...]]:
    """Yield the rows of one parameter: one, or of many numbers one for each, all in one unit."""
    noun_of = escape(parameter_noun(name))
    sides = [finding[side].get(name) for side in SIDES]
    size = max(np.size(p["value"]) for p in sides if p is not None)
    if size <= VECTOR:
        yield noun_of, *(_cell(finding, side, name, range(size)) for side in SIDES)
        return
    labels = element_labels(finding, name, size)
    largest = [np.max(np.abs(p["value"])) for p in sides if p is not None]
    unit = next(p["unit"] for p in sides if p is not None)
    scale = shown_in(largest, unit, name)
    for i, label in enumerate(labels):
        cells = ("" if p is None else escape(_number(p, i, scale)) for p in sides)
        yield f"{noun_of}, {escape(label)}", *cells


def element_labels(finding: Mapping[str, Any], name: str, size: int) -> list[str]:
    """Return what each of the numbers of a parameter is."""
    if finding["where"]["driver"] == "a period in time" and size == 2 * len(AXES):
        return [f"{wave} of {axis}" for wave in ("sine", "cosine") for axis in AXES]
    return labels_of(name, size)


def _number(parameter: Mapping[str, Any], i: int, scale: tuple[float, str]) -> str:
    """Return one number of a parameter with its interval, in a given unit."""
    factor, unit = scale
    value = float(np.ravel(parameter["value"])[i])
    return f"{within(value * factor, *(interval_of(parameter)[i] * factor))} {unit}".strip()


def _cell(finding: Mapping[str, Any], side: str, name: str, shown: Sequence[int]) -> str:
    if name not in finding[side]:
        return ""
    parameter = finding[side][name]
    beside = [finding[s][name] for s in SIDES if name in finding.get(s, {})]
    return escape(with_interval(name, parameter, shown, beside))


def _alternatives(finding: Mapping[str, Any]) -> str:
    if not finding["alternatives"]:
        return ""
    rows = [
        (
            escape(noun(a["effect"], finding["sensor"])),
            f"{plain(a['heldout_log_score_gain'])} nats",
            "cannot be told from it here" if a["indistinguishable"] else "explains it less well",
        )
        for a in finding["alternatives"]
    ]
    return "<p>Other explanations that were tried:</p>" + tables.table(
        ("effect", "held-out gain", "how it compares"), rows
    )


def _agreed(answer: Mapping[str, Any]) -> Iterator[str]:
    if not answer["agreed"]:
        return
    yield "<h2>What agrees</h2>"
    rows = [(escape(capital(noun(a["effect"], a["sensor"]))), _agreeing(a)) for a in answer["agreed"]]
    yield tables.table(("quantity", "recorded"), rows)


def _agreeing(one: Mapping[str, Any]) -> str:
    texts = []
    for name, parameter in one["parameters"].items():
        shown = range(np.size(parameter["value"]))
        texts.append(f"{escape(parameter_noun(name))}: {_cell(one, 'parameters', name, shown)}")
    return "; ".join(texts) + (f" ({escape(one['note'])})" if "note" in one else "")


def _not_compared(answer: Mapping[str, Any]) -> Iterator[str]:
    if answer["not_compared"]:
        yield "<h2>What could not be compared</h2>"
        rows = [(escape(why), escape("; ".join(what))) for why, what in reasons(answer).items()]
        yield tables.table(("why", "effects"), rows)


def _sensitivity(answer: Mapping[str, Any]) -> Iterator[str]:
    if not answer["sensitivity"]:
        return
    yield "<h2>How small a difference would have been seen</h2>"
    yield "<p>A difference of this size on one axis is found nine times in ten.</p>"
    rows = []
    for s in answer["sensitivity"]:
        factor, unit = shown_in(s["smallest_seen_90"], s["unit"], s["parameter"])
        at = "".join(f" ({k.removesuffix('_s')} {moment(v)})" for k, v in s.get("reference", {}).items())
        what = capital(noun(s["effect"], s["sensor"]))
        size = f"{plain(s['smallest_seen_90'] * factor)} {unit}"
        size += f", not on {' or '.join(s['not_on'])}" if "not_on" in s else ""
        size = f"not shown: {s['reason']}" if "reason" in s else size
        rows.append((escape(what), escape(parameter_noun(s["parameter"]) + at), escape(size)))
    yield tables.table(("effect", "parameter", "smallest size"), rows)
