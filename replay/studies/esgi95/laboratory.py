"""ESGI'95: every published parameter and error, computed anew from the printed tables."""

from __future__ import annotations

from pathlib import Path

from stillcal.replay.studies.claim import Cause, Claim, Evidence, Progress, Study, holds, table
from stillcal.replay.studies.esgi95.published import Row, esgi_table

WORK = "ESGI'95"
DATA = "its printed tables (config/esgi)"


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Compare all figures of 2.4, 3.5.1 and 3.5.2; one claim a group of figures."""
    rows = esgi_table()
    progress(1.0)
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(_group(row), []).append(row)
    claims = tuple(_claim(group, members) for group, members in groups.items())
    text = "The tolerance of each figure is what rounding of the printed table and of the figure can do.\n\n"
    text += table(
        ("figure", "paper", "ours", "rounding", "agrees", "why"),
        [
            (
                r.figure,
                r.paper,
                f"{r.ours:.7g}",
                f"{r.slack:.0e}" if r.slack else "-",
                "yes" if r.agrees else "no",
                r.why,
            )
            for r in rows
        ],
    )
    return Study("laboratory", "Laboratory calibration (ESGI'95)", claims, text, seed=seed)


def _group(row: Row) -> str:
    if "maximum" in row.figure:
        return row.figure
    return row.figure.split(":")[0] + (": errors" if "error" in row.figure else ": parameters")


def _claim(group: str, rows: list[Row]) -> Claim:
    agreeing = sum(row.agrees for row in rows)
    causes = [row.cause for row in rows if row.cause]
    single = len(rows) == 1
    return Claim(
        WORK,
        "2.4" if group.startswith("dataset") else "3.5",
        group,
        rows[0].paper if single else f"{len(rows)} figures",
        f"{rows[0].ours:.3f}" if single else f"{agreeing} of {len(rows)} agree",
        DATA,
        holds(agreeing == len(rows)),
        rows[0].why if single else "within the rounding of table and figure" + _exceptions(rows),
        evidence=Evidence.PRINTED,
        cause=Cause("; ".join(c.tried for c in causes), all(c.shown for c in causes)) if causes else None,
    )


def _exceptions(rows: list[Row]) -> str:
    missed = [f"{row.figure.split(': ')[1]} {row.why}" for row in rows if not row.agrees]
    return f"; not: {', '.join(missed)}" if missed else ""
