"""The page of a recording against a given simulation: what differs, drawn as numbers with their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from importlib.metadata import version
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.given_simulation import Judged
from stillcal.replay.diagnosis.relation_text import (
    VERDICTS,
    labels_of,
    noun,
    probability_text,
    readable,
    shown_of,
    with_interval,
)
from stillcal.replay.diagnosis.report import figures, tables
from stillcal.replay.diagnosis.report.page import document, figure_html
from stillcal.replay.diagnosis.report.pictures import Picture

ROW_INCHES = 0.55
"""Height of one axis' row in a figure of two values."""

RELATIONS = {
    "lacking": "the simulation lacks it",
    "too_small": "smaller in the simulation, all numbers together",
    "too_large": "larger in the simulation, all numbers together",
    "superfluous": "only the simulation has it",
}


def comparison_page(judged: Judged) -> str:
    """Return the page's HTML."""
    answer = judged.answer
    names = escape(answer["recording"]), escape(answer["simulation"])
    parts = [
        f"<h1>{names[0]} against {names[1]}</h1>",
        f'<p class="verdict {escape(answer["verdict"])}">{escape(_headline(answer))}</p>',
        _header(judged),
        *_findings(answer),
        *_agreed(answer),
        *_not_compared(answer),
        *_sensitivity(answer),
        "<footer>Made by <code>stillcal diagnose --simulated</code>. Intervals are 95 %. Both recordings were"
        " fitted with the same model; docs/comparison.md says how.</footer>",
    ]
    return document(f"{names[0]} against {names[1]}", parts)


def _headline(answer: Mapping[str, Any]) -> str:
    text = VERDICTS[answer["verdict"]]
    text = text[0].upper() + text[1:] + "."
    if not answer["findings"]:
        return text
    after = answer["fit"]["p_after"]
    passes = "passes" if after >= 0.01 else "still fails"
    put_in = "With the differences put into its samples the simulation"
    left = answer["fit"]["not_put_in"]
    # One effect on both sensors is named once.
    what = ", ".join(dict.fromkeys(noun(effect, "") for effect in left))
    but = f"; these could not be put in and are left out of it: {what}" if left else ""
    return f"{text} {put_in} {passes} the same comparison, p = {after:.2g}{but}."


def _header(judged: Judged) -> str:
    rows = []
    for name, exam in (
        (judged.answer["recording"], judged.recorded),
        (judged.answer["simulation"], judged.simulated),
    ):
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


def _findings(answer: Mapping[str, Any]) -> Iterator[str]:
    if answer["findings"]:
        yield "<h2>What differs</h2>"
    for finding in answer["findings"]:
        axes = ", ".join(finding["axes"])
        what = noun(finding["effect"], finding["sensor"])
        yield f"<h3>{escape(what[0].upper() + what[1:])}{' on ' + axes if axes else ''}</h3>"
        yield f"<p>{escape(finding['statement'])}</p>"
        share = probability_text(finding["probability"])
        yield f"<p>{RELATIONS[finding['relation']].capitalize()}. Probability of a difference: {share}.</p>"
        yield _table(finding)
        drawn = [_picture(finding, name) for name in finding["difference"] if name != "ratio"]
        if drawn:
            yield f'<div class="pictures">{"".join(drawn)}</div>'


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
    return figure_html(Picture(_two_values(name, sides), caption, caption))


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
        rows = [(escape(noun(n["effect"], n["sensor"])), escape(n["reason"])) for n in answer["not_compared"]]
        yield tables.table(("quantity", "why"), rows)


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
