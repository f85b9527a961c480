"""Whether the gyroscope's bias may be disregarded, on real turns (Grammenos et al. 2018, 4.3, Eq. 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.maths.rotation import rotation
from stillcal.calib_core.model import SensorModel
from stillcal.replay.formats.trace import open_trace
from stillcal.replay.runner import replay
from stillcal.replay.studies.claim import Cause, Claim, Evidence, Progress, Study, holds, table
from stillcal.replay.studies.collin2019.grades import ORDER, TABLE1, of_order
from stillcal.replay.studies.har.data import without_recordings

NAME, TITLE, WORK = "gyroscope-bias", "A gyroscope's bias disregarded (Eq. 10)", "Grammenos 2018"
RECORDINGS = {
    "imu_tk/xsens_acc.mat.gz": "imu_tk",
    "mikoff/imu0.log": "mikoff",
    "mikoff/imu1.log": "mikoff",
    "mikoff/imu2.log": "mikoff",
}
"""Real recordings with turns enough for nine parameters twice over, and their formats."""

WAYS = (
    "nominal scale, bias taken off",
    "Eq. 10, bias disregarded",
    "Eq. 9, mean bias of the rests",
    "stillcal",
)
PAPER = {
    "bias": ("4.3, Eq. 10", "the gyroscope's bias can be disregarded", "safely"),
    "methods": (
        "4.3",
        "methods that take the bias into account are not significantly better than Eq. 10",
        "not significantly",
    ),
}


CONSUMER_DEG_H = TABLE1["gyroscope bias, deg/h"][-1]
GRADE = ("Collin 2019", "Table 1", "consumer grade: gyroscope bias, deg/h", "1000")


@dataclass(frozen=True, slots=True)
class Result:
    """Rms angle between gravity carried through a turn and measured, degrees, on turns held out, by WAYS.

    turns: how many. bias: the size of the gyroscope's bias, rad/s; by_axis: the mean size of its
    axes. drift: what the bias turns by in the time of a turn, and what the difference of the rests around a
    turn from their mean does, rms degrees.
    """

    name: str
    turns: int
    bias: float
    by_axis: float
    held_out: tuple[float, ...]
    drift: tuple[float, float]


def misalignments(turns: Sequence[RotationSegment], accel: SensorModel, scale: Array, bias: Array) -> Array:
    """Return unit gravity carried by `scale @ (raw - bias)` less that measured after each turn, (K, 3)."""
    rows = []
    for turn in turns:
        before, after = (accel.apply(r.specific_force[None])[0] for r in (turn.before, turn.after))
        carried = rotation(turn.t, (turn.rates - bias) @ scale.T) @ before
        rows.append(carried / np.linalg.norm(carried) - after / np.linalg.norm(after))
    return np.array(rows)


def fit_scale(turns: Sequence[RotationSegment], accel: SensorModel, bias: Array) -> Array:
    """Minimise Eq. 15 over the nine elements of the scale, the bias held; (3, 3)."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - slow to import

    def residuals(theta: Array) -> Array:
        return misalignments(turns, accel, theta.reshape(3, 3), bias).ravel()

    return np.asarray(least_squares(residuals, np.eye(3).ravel(), method="lm").x.reshape(3, 3))


def rms_angle(residuals: Array) -> float:
    """Return the rms angle of differences of unit vectors (K, 3), degrees."""
    chord = np.linalg.norm(residuals, axis=1)
    return float(np.degrees(np.sqrt(np.mean(np.square(2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0)))))))


def examine(path: Path, form: str) -> Result:
    """Replay one recording, fit half of its turns in each way, and look at the other half; both ways."""
    engine = Engine()
    record = replay(open_trace(path, form).chunks(), engine, lambda action: None).record
    assert record is not None and record.accelerometer is not None, f"{path} calibrates"
    accel, turns = record.accelerometer.model, list(engine.state.pool.turns)
    squares: list[list[float]] = []
    for half in (0, 1):
        kept, left = turns[half::2], turns[1 - half :: 2]
        rests = [r.rate for turn in kept for r in (turn.before, turn.after) if r.rate is not None]
        mean = np.mean(rests, axis=0)
        ours = gyroscope.fit(kept, accel, STANDARD, parameters=gyroscope.Parameters.FULL9)
        own = np.degrees(gyroscope.residuals(left, accel, ours.model.scale, ours.shift))
        squares.append(
            [
                rms_angle(misalignments(left, accel, np.eye(3), mean)) ** 2,
                rms_angle(misalignments(left, accel, fit_scale(kept, accel, np.zeros(3)), np.zeros(3))) ** 2,
                rms_angle(misalignments(left, accel, fit_scale(kept, accel, mean), mean)) ** 2,
                float(np.mean(np.square(own))),
            ]
        )
    held_out = np.sqrt(np.mean(squares, axis=0))
    return Result(
        path.name,
        len(turns),
        float(np.linalg.norm(mean)),
        float(np.abs(mean).mean()),
        tuple(float(v) for v in held_out),
        drifts(turns),
    )


def drifts(turns: Sequence[RotationSegment]) -> tuple[float, float]:
    """Return what the rests' mean rate turns by in a turn's time, and each turn's own less that; degrees.

    Rms over the turns; of each turn's own the mean of the rests before and after it is taken.
    """
    spans = np.array([turn.t[-1] - turn.t[0] for turn in turns])
    own = np.array(
        [np.mean([r.rate for r in (turn.before, turn.after) if r.rate is not None], axis=0) for turn in turns]
    )
    mean = own.mean(axis=0)
    sizes = (np.linalg.norm(mean) * spans, np.linalg.norm(own - mean, axis=1) * spans)
    whole, changed = (float(np.degrees(np.sqrt(np.mean(np.square(size))))) for size in sizes)
    return whole, changed


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Fit real turns with the bias disregarded, with one bias, and as the product does."""
    if data is None:
        return without_recordings(NAME, TITLE, [*((WORK, *row) for row in PAPER.values()), GRADE], seed)
    found = []
    for k, (name, form) in enumerate(RECORDINGS.items()):
        found.append(examine(data / name, form))
        progress((k + 1) / len(RECORDINGS))
    values = np.array([r.held_out for r in found])
    claims = (_bias(values, found), _methods(values, found), _grade(found))
    rows = [
        (r.name, str(r.turns), f"{np.degrees(r.bias):.2f}", *(f"{v:.2f}" for v in r.held_out)) for r in found
    ]
    head = ("recording", "turns", "bias, deg/s", *(f"{w}, deg" for w in WAYS))
    text = (
        "Gravity, as the calibrated accelerometer sees it at one rest, is carried by the gyroscope to the"
        " next and compared there (Eq. 15). The scale is fitted to every other turn, and the angles are"
        " those of the turns left out, rms, both halves taken in turn. Eq. 9 takes the mean rate of all"
        f" rests off; stillcal takes the bias of the rests around each turn.\n\n{table(head, rows)}"
    )
    return Study(NAME, TITLE, claims, text, (), seed)


def _names(found: list[Result]) -> str:
    turns = sum(r.turns for r in found)
    return f"{len(found)} real recordings (imu_tk, mikoff), {turns} turns from rest to rest"


def accounts(supposed: Array, measured: Array) -> bool:
    """Return whether what a cause would do is half to twice what was measured, on the median; (n,) each."""
    return 0.5 <= float(np.median(supposed / measured)) <= 2.0


def _bias(values: Array, found: list[Result]) -> Claim:
    without, taken = values[:, 1], values[:, 2]
    ratio = without / taken
    ours = f"held-out angle {np.median(without):.2f} deg without it, {np.median(taken):.2f} deg with it"
    why = (
        "medians over recordings; holds where no recording is worse by more than a tenth. Same fit, bias"
        f" zero or the mean of the rests: {', '.join(f'{r:.1f}' for r in ratio)} times"
    ).replace("  ", " ")
    cause = Cause(
        "a constant bias does not average out over a turn. In a turn's time it turns by"
        f" {', '.join(f'{r.drift[0]:.1f}' for r in found)} deg rms, recording by recording; the angle"
        f" without it is {', '.join(f'{v:.1f}' for v in without)} deg",
        shown=accounts(np.array([r.drift[0] for r in found]), without),
    )
    good = bool((ratio <= 1.1).all())
    return Claim(
        WORK, *PAPER["bias"], ours, _names(found), holds(good), why, evidence=Evidence.REAL, cause=cause
    )


def _methods(values: Array, found: list[Result]) -> Claim:
    without, mean, ours = values[:, 1], values[:, 2], values[:, 3]
    figure = (
        f"held-out angle {np.median(without):.2f} deg by Eq. 10, {np.median(mean):.2f} deg by one bias,"
        f" {np.median(ours):.2f} deg by each turn's own"
    )
    better = np.minimum(mean, ours) / without
    why = (
        "holds where the better of both ways with a bias is better than Eq. 10 by less than a tenth, on the"
        f" median: {', '.join(f'{b:.2g}' for b in better)} times. Zeroing at rest (4.7) takes the bias off,"
        " so that the paper's method whole is the column of Eq. 9"
    )
    cause = Cause(
        "what Eq. 10 leaves is the bias: in a turn's time it turns by"
        f" {', '.join(f'{r.drift[0]:.1f}' for r in found)} deg rms, recording by recording, and the angle is"
        f" {', '.join(f'{v:.1f}' for v in without)} deg. Between the ways with a bias it is what moves from"
        f" rest to rest: {', '.join(f'{r.drift[1]:.2f}' for r in found)} deg, and one bias leaves"
        f" {', '.join(f'{v:.2f}' for v in mean)} deg",
        shown=accounts(np.array([r.drift[0] for r in found]), without),
    )
    good = float(np.median(better)) > 0.9
    return Claim(
        WORK, *PAPER["methods"], figure, _names(found), holds(good), why, evidence=Evidence.REAL, cause=cause
    )


def _grade(found: list[Result]) -> Claim:
    """Hold the raw biases of these gyroscopes against Collin's Table 1, as `grades` holds accelerometers'."""
    hourly = np.array([np.degrees(r.by_axis) * 3600.0 for r in found])
    middle = float(np.median(hourly))
    first = float(np.median(hourly[1:]))
    sizes = ", ".join(f"{np.degrees(r.bias) * 3600.0:,.0f}" for r in found)
    return Claim(
        *GRADE,
        f"{middle:,.0f} ({hourly.min():,.0f} to {hourly.max():,.0f})",
        _names(found),
        holds(of_order(middle, CONSUMER_DEG_H)),
        f"median of {len(found)} gyroscopes, mean of the axes' sizes ({sizes} with all axes together);"
        f" within a factor of {ORDER:.1f} as in `grades`",
        evidence=Evidence.REAL,
        cause=Cause(
            f"the largest, of {found[0].name}, is left out: the median is {first:,.0f}",
            shown=of_order(first, CONSUMER_DEG_H),
        ),
    )
