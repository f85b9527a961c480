"""A heading gyroscope that is tilted: a scale error, and what else it does to a walk's heading.

Collin et al. 2019, 3.4, last remark. A tilted axis senses cos(tilt) of turns about the vertical, and
sin(tilt) of every turn about a level axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import (
    Claim,
    Evidence,
    Progress,
    Study,
    Verdict,
    picture,
    table,
)
from stillcal.replay.studies.collin2019.pedestrian_tables import DEG, walk
from stillcal.replay.studies.har.data import MOVING, RATE_HZ, read_rates, without_recordings

NAME, TITLE, WORK, WHERE = "heading-tilt", "Tilt of the heading gyroscope", "Collin 2019", "3.4"
TILTS_DEG = (1.0, 2.0, 3.0, 5.0)
COUPLE_DEG = 2.0
"""The paper's "couple of degrees"."""
AZIMUTHS = 12
PAPER = (
    (WORK, WHERE, "a tilt of a couple of degrees introduces a scaling error to the heading", "scaling error"),
)


@dataclass(frozen=True, slots=True, eq=False)
class TiltError:
    """What a tilt does to the heading's change over windows, degrees RMS.

    scaling: the part cos(tilt) - 1 of the change itself; crossed: the part by turns about level axes.
    slopes: (12,) of the tilted change on the true one, by least squares, by direction of the tilt.
    """

    scaling: float
    crossed: float
    slopes: Array


def tilted(forces: Array, rates: Array, rate_hz: float, tilt: float) -> TiltError:
    """Tilt the axis of heading by `tilt` rad from up, all around, in windows (n, m, 3) of m/s^2 and rad/s.

    Up is the mean force of a window: carrying a phone cancels in it.
    """
    up = forces.mean(axis=1)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up), axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    third = np.cross(up, side)
    turned = rates.sum(axis=1) / rate_hz
    change = np.einsum("ni,ni->n", turned, up)
    around = np.linspace(0.0, 2.0 * math.pi, AZIMUTHS, endpoint=False)
    level = np.array(
        [np.einsum("ni,ni->n", turned, math.cos(a) * side + math.sin(a) * third) for a in around]
    )
    sensed = math.cos(tilt) * change + math.sin(tilt) * level
    slopes = np.asarray(sensed @ change / (change @ change))
    scaling, crossed = (math.cos(tilt) - 1.0) * change, math.sin(tilt) * level
    return TiltError(_rms(scaling), _rms(crossed), slopes)


def _rms(values: Array) -> float:
    return math.degrees(math.sqrt(float(np.mean(values**2))))


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Tilt the axis of heading of real walkers."""
    if data is None:
        return without_recordings(NAME, TITLE, PAPER, seed)
    windows, rates = read_rates(data)
    moves = np.isin(windows.label, np.unique(windows.of(*MOVING).label))
    found = {tilt: tilted(windows.accel[moves], rates[moves], RATE_HZ, tilt * DEG) for tilt in TILTS_DEG}
    progress(0.8)
    words = f"ucihar: {int(moves.sum())} windows of walking and stairs, 2.56 s, 30 people"
    file = _draw(found, figures)
    progress(1.0)
    claims = (_scale(found[COUPLE_DEG], words), _only(found[COUPLE_DEG], words))
    return Study(NAME, TITLE, claims, _text(found, file), (file,), seed)


def _turned(tilt_deg: float) -> tuple[float, float]:
    """Return heading error, degrees, and position error, percent, of Fig. 8's walk with a tilted axis."""
    walked = walk(60.0, scale_error=math.cos(tilt_deg * DEG) - 1.0)
    return float(abs(walked.heading_error[-1]) / DEG), 100.0 * float(walked.relative_error[-1])


def _scale(found: TiltError, data: str) -> Claim:
    expected = 100.0 * (math.cos(COUPLE_DEG * DEG) - 1.0)
    low, high = 100.0 * (found.slopes.min() - 1.0), 100.0 * (found.slopes.max() - 1.0)
    heading, position = _turned(COUPLE_DEG)
    return Claim(
        *PAPER[0],
        f"{COUPLE_DEG:g} deg: {low:+.2f} to {high:+.2f} %, by direction; cosine {expected:+.3f} %",
        data,
        Verdict.OPEN,
        "the paper gives no size. Slope of the tilted heading's change on the true one, twelve directions;"
        f" their mean is the cosine. By it a turn of 180 degrees leaves {heading:.2f} degrees, {position:.2f}"
        " % of the distance, against 1.8 degrees and 3.14 % by Table 4's 1 %",
        evidence=Evidence.REAL,
    )


def _only(found: TiltError, data: str) -> Claim:
    return Claim(
        WORK,
        WHERE,
        "what else a tilt does to a walker's heading: turns about level axes",
        "-",
        f"in 2.56 s {found.scaling:.3f} deg by scaling, {found.crossed:.2f} by turns about level axes",
        data,
        Verdict.OPEN,
        "the paper names the scaling and does not say that it is all. RMS: of turns about level axes a tilted"
        f" axis senses the sine of the tilt, {math.sin(COUPLE_DEG * DEG):.3f} of them; of turns about the"
        f" vertical it loses 1 less the cosine, {1.0 - math.cos(COUPLE_DEG * DEG):.4f}. Over longer walks"
        " such turns may return: windows end after 2.56 s",
        evidence=Evidence.REAL,
    )


def _text(found: dict[float, TiltError], file: str) -> str:
    rows = []
    for tilt, one in found.items():
        heading, position = _turned(tilt)
        rows.append(
            (
                f"{tilt:g}",
                f"{100 * (one.slopes.min() - 1.0):+.2f} to {100 * (one.slopes.max() - 1.0):+.2f}",
                f"{one.scaling:.4f}",
                f"{one.crossed:.2f}",
                f"{heading:.2f}",
                f"{position:.2f}",
            )
        )
    head = (
        "tilt, deg",
        "scale, %",
        "by scaling, deg",
        "by level turns, deg",
        "heading after 180 deg, deg",
        "position after it, %",
    )
    return "\n\n".join(
        [
            "The heading's change over windows of 2.56 s of real people, by an axis along the mean force and"
            " by one tilted from it in twelve directions; each person's mean rate at rest is taken off. RMS"
            " errors. The last two columns are Fig. 8's walk with the scale error of the tilt alone.",
            table(head, rows),
            picture(file, "Heading error over a window by tilt: both parts"),
        ]
    )


def _draw(found: dict[float, TiltError], figures: Path) -> str:
    figure, (axis,) = drawing.panels(1)
    for colour, label, values in (
        (drawing.BLUE, "scaling", [one.scaling for one in found.values()]),
        (drawing.RED, "turns about level axes", [one.crossed for one in found.values()]),
    ):
        axis.semilogy(list(found), values, "o-", color=colour, label=label)
    axis.set(xlabel="tilt, degrees", ylabel="heading error over 2.56 s, degrees RMS")
    axis.legend()
    return drawing.save(figure, figures, NAME)
