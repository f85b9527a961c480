"""The page that `make bench` writes, docs/performance.md, from what it measured.

`python benchmarks/page.py out/benchmarks/results.json docs/performance.md` writes it again.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HEAD = "| item | what | ours | beside | times as fast | accuracy and more | goal | met |\n|" + "---|" * 8
QUIET = 0.5
"""Load above which the page says that the machine had other work."""

SECTIONS = {
    "1": (
        "Replay throughput",
        "Calibrating from a day of a simulated phone's accelerometer (50 Hz; 40, 30, 20 mg of bias, 1 % "
        "of scale, 0.4 % of cross-axis sensitivity). The error is the mean vector error over 2000 "
        "attitudes, the common rotation taken out. scikit-digital-health estimates offsets and diagonal "
        "scales from windows of ten seconds, once; its iteration as shipped stops early on so many "
        "samples. The engine looks for rests at every sample, reviews and checks all day, and estimates "
        "cross-axis terms too. The exponent is of processor time against length, where 1 is in "
        "proportion; every length runs in a process of its own and is read block by block, the same day "
        "again and again. To pandas and pyarrow, which only parse, the least is added that gives the same "
        "checks: stamps that do not run back, readings that are finite, no sensor with some of its axes "
        "missing, and the line where one is broken. Reading here also recognises the format and looks for "
        "units, gaps, repeats and readings that no sensor gives. The engine cuts the stream at each of its "
        "reviews, and most of what a review takes is the fixed cost of numpy's calls on few windows.",
    ),
    "2": (
        "The daemon, live",
        "`stillcal run` on a pseudo-terminal on which a simulated phone on a desk sends both sensors in real "
        "time, one write every 20 ms. The spread of a share is over five parts of the time watched.",
    ),
    "3": ("Correcting samples", "Blocks of 100 000 samples, and one sample a call."),
    "4": (
        "Fits",
        "Ours weighs each rest, drops outliers, and judges coverage and fit besides; scipy searches the "
        "least cost and nothing else. imucal calibrates sessions whose regions a person has marked: no peer "
        "here.",
    ),
    "5": ("Allan deviation", "Overlapping; white noise."),
    "6": ("Diagnosis", "The whole catalogue of left-out effects, on the first hours of the same day."),
    "7": (
        "Truth at a random moment",
        "Eight simulated weeks of people whose phones' bias follows temperature (0.2 to 0.9 mg/K, 0.005 to "
        "0.03 deg/s/K; curved in a third, late in a third), heat of charging, random walk, flicker, knocks. "
        "Every ten minutes after the first calibration: the mean vector error of calibrated specific force "
        "at rest, the common rotation taken out, and the error of rate. Intervals are those of the bias, by "
        "axis. The offset table keeps a gyroscope offset for every 2 K, our own reading of the idea that "
        "Android's stack publishes; vqf is fed with all samples, and so is the daily fit, "
        "scikit-digital-health's (van Hees et al. 2014, with a slope by temperature). The thermometer is "
        "read once a minute. "
        "*Without learning*: this program without learning temperature.",
    ),
}


def spread(values: Any, unit: str = "") -> str:
    """Return a median with its middle half, or a value alone, to three digits."""
    if not isinstance(values, list | tuple):
        return f"{_digits(values)} {unit}".strip()
    median, low, high = (_digits(v) for v in values)
    return f"{median} {unit} ({low} to {high})".replace("  ", " ")


def _digits(value: float | None) -> str:
    """Return a number to three digits; None, what JSON has for one that is not finite, is a dash."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:.3g}"


def line(row: dict[str, Any]) -> str:
    """Return one row of the table in Markdown."""
    versus = "" if row["ratio"] is None else spread(row["ratio"])
    cells = (row["item"], row["what"], spread(row["value"], row["unit"]), row["peer"], versus)
    return "| " + " | ".join(map(str, (*cells, row["accuracy"], row["goal"], _met(row)))) + " |"


def _met(row: dict[str, Any]) -> str:
    """Return the verdict in words: whether the goal is met, and by how much it is missed."""
    if row["met"] is None:
        return ""
    if row["met"]:
        return "yes"
    margin = row["margin"]
    if margin is None:
        return "**no**"
    return f"**no**, by a factor of {1 / margin:.3g}" if margin < 1.0 else "**no**, but fast enough: accuracy"


def page(document: dict[str, Any]) -> str:
    """Return the whole page."""
    return "\n".join([*_top(document), *_goals(document["rows"]), *_sections(document)]) + "\n"


def _top(document: dict[str, Any]) -> Iterator[str]:
    machine, load = document["machine"], document["load"]
    yield "# Performance\n\n*For people who ask what stillcal costs, beside other tools.*\n"
    minutes = sum(document["taken_s"].values()) / 60
    yield (
        f"`make bench` measured all of this in {minutes:.1f} minutes and wrote this page, which is not to be "
        "edited by hand. It leaves the figures in `out/benchmarks/results.json` too.\n"
    )
    if document["quick"]:
        yield "**A trial with `--quick`: fewer rounds, shorter inputs. No figure here is a result.**\n"
    if load[0] > QUIET:
        yield (
            f"**The machine had other work: a load of {load[0]:.1f} when this began.** Ratios suffer least, "
            "being of processor time and within rounds; latencies and times by the clock do suffer.\n"
        )
    peers = ", ".join(f"{k} {v or 'not installed'}" for k, v in document["peers"].items())
    yield "| | |\n|---|---|"
    yield f"| machine | {machine['processor']}, {machine['cores']} cores, {machine['system']} |"
    yield f"| load, before and after each item | {', '.join(f'{v:.1f}' for v in load)} |"
    yield f"| software | Python {machine['python']}, numpy {machine['numpy']}; one thread for all |"
    yield f"| peers | {peers} |\n"
    yield (
        "Every round runs ours and the peer in turn, after a round that does not count. Times are of the "
        "processor unless said otherwise. What stands here is the median over rounds, in brackets the middle "
        "half; *times as fast* is the peer's time over ours within the same round: above 1 we are faster.\n"
    )
    for item, error in document["failed"].items():
        yield f"**Item {item} failed and is missing or cut short: {error}**\n"


def _goals(rows: list[dict[str, Any]]) -> Iterator[str]:
    judged = [row for row in rows if row["met"] is not None]
    met = sum(row["met"] for row in judged)
    yield f"## Goals: {met} of {len(judged)} met\n"
    yield "| item | what | goal | ours | times as fast as the peer | met |\n|---|---|---|---|---|---|"
    for row in sorted(judged, key=lambda r: (r["item"], bool(r["met"]))):
        versus = "" if row["ratio"] is None else f"{row['ratio'][0]:.3g}"
        ours = spread(row["value"], row["unit"]).split(" (")[0]
        ours += f"; {row['accuracy']}" if "mg" in row["accuracy"] and "left" in row["accuracy"] else ""
        yield f"| {row['item']} | {row['what']} | {row['goal']} | {ours} | {versus} | {_met(row)} |"
    yield ""


def _sections(document: dict[str, Any]) -> Iterator[str]:
    for item, (title, words) in SECTIONS.items():
        rows = [row for row in document["rows"] if row["item"] == item]
        if not rows:
            continue
        yield f"## {item}. {title}\n\n{words}\n"
        head = HEAD.replace("| item ", "", 1).replace("---|", "", 1)
        yield head
        for row in rows:
            yield "| " + line(row).split(" | ", 1)[1]
        yield ""
        for row in rows:
            if row["more"]:
                yield from _more(row)


def _more(row: dict[str, Any]) -> Iterator[str]:
    """Yield the table behind a row: one line a length."""
    names = list(next(iter(row["more"].values())))
    yield f"{row['what']}:\n"
    yield (
        f"| {'where' if 'moments' in names else 'length'} | "
        + " | ".join(n.replace("_mb", ", MB") for n in names)
        + " |\n|"
        + "---|" * (1 + len(names))
    )
    for length, found in row["more"].items():
        yield f"| {length} | " + " | ".join(_digits(found[n]) for n in names) + " |"
    yield ""


if __name__ == "__main__":
    Path(sys.argv[2]).write_text(page(json.loads(Path(sys.argv[1]).read_text())))
