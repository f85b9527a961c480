"""ESGI'95: every published parameter and error, computed anew from the printed tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
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
    own = {r.figure: r.ours for r in rows}
    huawei, gt = (np.array([own[f"{device}: y{k}"] for k in "123"]) for device in ("Huawei", "GT"))
    claims = (*(_claim(group, members) for group, members in groups.items()), offsets(huawei, gt))
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
    if "maximum" in row.figure:  # a bound is one sentence on both choices of positions
        return f"{row.figure.split(',')[0]}: maximum, %, of both fits" if "<" in row.paper else row.figure
    return row.figure.split(":")[0] + (": errors" if "error" in row.figure else ": parameters")


def _claim(group: str, rows: list[Row]) -> Claim:
    agreeing = sum(row.agrees for row in rows)
    causes = [(f"{_positions(row)}: {row.cause.tried}", row.cause.shown) for row in rows if row.cause]
    many = "maximum" not in group
    return Claim(
        WORK,
        "2.4" if group.startswith("dataset") else "3.5",
        group,
        f"{len(rows)} figures" if many else rows[0].paper,
        f"{agreeing} of {len(rows)} agree" if many else ", ".join(f"{row.ours:.3f}" for row in rows),
        DATA,
        holds(agreeing == len(rows)),
        "within the rounding of table and figure" + _exceptions(rows)
        if many
        else "; ".join(f"{_positions(row)}: {row.why}" for row in rows),
        evidence=Evidence.PRINTED,
        cause=Cause(". ".join(tried for tried, _ in causes), all(s for _, s in causes)) if causes else None,
    )


def _positions(row: Row) -> str:
    return row.figure.split(", ")[1].split(":")[0]


def offsets(huawei: Array, gt: Array) -> Claim:
    """Judge whether the second device's offsets, m/s^2 (3,) each, are noticeably smaller (3.5.2)."""
    pairs = zip("xyz", np.abs(gt), np.abs(huawei), strict=True)
    norms = [float(np.linalg.norm(y)) for y in (gt, huawei)]
    return Claim(
        WORK,
        "3.5.2",
        "GT: its offsets are noticeably smaller than those of Huawei, m/s²",
        "noticeably smaller",
        ", ".join(f"{axis} {own:.2f} against {other:.2f}" for axis, own, other in pairs),
        DATA,
        holds(bool((np.abs(gt) < np.abs(huawei)).all())),
        "holds where it is so on every axis",
        evidence=Evidence.PRINTED,
        cause=Cause(
            f"of all axes together {norms[0]:.2f} against {norms[1]:.2f}: it is so on the whole",
            shown=norms[0] < 0.5 * norms[1],
        ),
    )


def _exceptions(rows: list[Row]) -> str:
    missed = [f"{row.figure.split(': ')[1]} {row.why}" for row in rows if not row.agrees]
    return f"; not: {', '.join(missed)}" if missed else ""
