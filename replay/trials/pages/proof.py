"""The table of docs/proof.md, section 10, from what `stillcal prove --json` wrote.

python -m stillcal.replay.trials.pages.proof proof.json
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from stillcal.replay.studies.claim import table as markdown

SOLVERS = {
    "diagnosis": "diagnosis",
    "affine_coloured_bic": "coloured, BIC",
    "sparse_regression": "sparse regression",
}
Line = Mapping[str, Any]


@click.command()
@click.argument("proof", type=click.Path(exists=True, dir_okay=False, path_type=Path))
def main(proof: Path) -> None:
    """Print the scores of PROOF as a table."""
    for line in table(json.loads(proof.read_text())["scores"]):
        click.echo(line)


def table(scores: list[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the table's lines, and how often the whole answer is right."""
    lines = {s["solver"]: _under_heads(s["lines"]) for s in scores}
    there = [solver for solver in SOLVERS if solver in lines]
    head = ("score", *(SOLVERS[s] for s in there), "n", "bar", "holds")
    rows = []
    for key, own in lines["diagnosis"].items():
        if own["n"]:
            what, cells = own["what"], [_cell(lines[s].get(key)) for s in there]
            holds = {True: "yes", False: "**no**", None: ""}[own["holds"]]
            name = f"- {what.strip()}" if what.startswith(" ") else what
            rows.append((name, *cells, str(own["n"]), own["bar"], holds))
    yield from markdown(head, rows).splitlines()
    right = {s["solver"]: s["right"] for s in scores}
    shares = [f"{SOLVERS[s]} {100 * right[s]['value']:.1f} %" for s in there if right[s]["n"]]
    if shares:
        yield f"\nWhole answer right, of {right['diagnosis']['n']} cases: {', '.join(shares)}."


def _under_heads(lines: Iterable[Line]) -> dict[tuple[str, str], Line]:
    """Return lines by the score that they are a part of, and their own name: parts are named alike."""
    found, head = {}, ""
    for line in lines:
        head = head if line["what"].startswith(" ") else line["what"]
        found[head, line["what"]] = line
    return found


def _cell(line: Line | None) -> str:
    """Return a score with its bounds; shares in per cent, times and d' as they are."""
    if line is None or line["value"] is None:
        return "-"
    plain = line["what"].startswith(("d' of", "steps'"))
    factor, unit = (1.0, "") if plain else (100.0, " %")
    low, high = (None if x is None else f"{factor * x:.{int(plain)}f}" for x in (line["low"], line["high"]))
    bounds = "" if low is None else f" ({low} to {high})" if high is not None else f" ({low} and more)"
    return f"{factor * line['value']:.1f}{unit}{bounds}"


if __name__ == "__main__":
    main()
