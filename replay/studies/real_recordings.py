"""What the engine makes of other people's recordings: one row each, as printed in the README.

`python -m stillcal.replay.studies.real_recordings FOLDER` replays the recordings of FOLDER that it knows by
name through the engine with default settings, and checks each calibration on rests and turns that were held
out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import click
import numpy as np

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer.fit import AccelerometerSettings
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.drift_check import norm_residuals
from stillcal.calib_core.calibration.rest_pool import HeldRest
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import force_uncertainties, forces
from stillcal.replay.formats.trace import open_trace
from stillcal.replay.runner import replay

T = TypeVar("T")

KNOWN = {
    "imu_tk/xsens_acc.mat.gz": "imu_tk",
    "mikoff/imu0.log": "mikoff",
    "mikoff/imu1.log": "mikoff",
    "mikoff/imu2.log": "mikoff",
    "imucal/example_ferraris_session.csv": "imucal",
}
"""Recordings and their formats."""

_UNCHECKED = AccelerometerSettings(max_amplification=np.inf, max_norm_sd=np.inf, spare_attitudes=0)
"""Half of the rests seldom supports what all of them do; a held-out check fits it all the same."""

_MILLI_G = 1000 / STANDARD


@dataclass(frozen=True, slots=True)
class Split:
    """Rms over what a fit was made on, and over what was held out of it; m/s^2 or rad."""

    fitted: float
    held_out: float

    @property
    def ratio(self) -> float:
        """Held out over fitted."""
        return self.held_out / self.fitted


@dataclass(frozen=True, slots=True)
class Row:
    """One recording. *_before, *_after: rms, accelerometer m/s^2 of the norm, gyroscope rad over a turn.

    accel_split: each rest held out in turn. *_halves: odd against even, both ways. None where what is left
    cannot be fitted.
    """

    name: str
    rests: int
    attitudes: int
    parameters: int
    accel_before: float
    accel_after: float
    accel_split: Split | None
    accel_halves: Split | None
    turns: int
    gyro_before: float | None
    gyro_after: float | None
    gyro_halves: Split | None


def survey(folder: Path) -> Iterator[Row]:
    """Yield a row for every known recording in `folder`."""
    for name, form in KNOWN.items():
        if (folder / name).exists():
            yield examine(folder / name, form, name)


def examine(path: Path, form: str, name: str) -> Row:
    """Replay one recording and hold its calibration against what was left out."""
    engine = Engine()
    trace = open_trace(path, form)
    record = replay(trace.chunks(), engine, lambda action: None).record
    pool = engine.state.pool
    if record is None or record.accelerometer is None:
        raise click.ClickException(f"{path}: no calibration: {engine.state.refusal}")
    accel, gyro = record.accelerometer, record.gyroscope
    used = [h for h in pool.held if any(s.t_start == h.rest.t_start for s in record.states)]
    full = gyro is not None and gyro.parameters == 12
    before, _ = norm_residuals(SensorModel.identity(), used)
    return Row(
        name=name,
        rests=accel.n_rests,
        attitudes=accel.n_states,
        parameters=accel.parameters,
        accel_before=_rms(before),
        accel_after=accel.rms_residual or float("nan"),
        accel_split=split_rests(used, accel.parameters, len(used)),
        accel_halves=split_rests(used, accel.parameters, 2),
        turns=0 if gyro is None else gyro.n_turns,
        gyro_before=None if gyro is None else gyro.rms_nominal,
        gyro_after=None if gyro is None else gyro.rms_residual,
        gyro_halves=split_turns(pool.turns, accel.model) if full else None,
    )


def split_rests(held: Sequence[HeldRest], parameters: int, folds: int) -> Split | None:
    """Hold out every `folds`-th rest in turn; None where what is left cannot be fitted."""
    fitted, out = [], []
    try:
        for fold in range(folds):
            kept, left = _divided(held, fold, folds)
            rests, local = [h.rest for h in kept], np.array([h.gravity.value for h in kept])
            fit = accelerometer.fit(
                forces(rests),
                force_uncertainties(rests),
                local,
                parameters=parameters,  # type: ignore[arg-type]  # 6 or 9, as a fit reports it
                settings=_UNCHECKED,
            )
            fitted.append(fit.residuals)
            out.append(norm_residuals(fit.model, left)[0])
    except NotSupported:
        return None
    return Split(_rms(np.concatenate(fitted)), _rms(np.concatenate(out)))


def split_turns(turns: Sequence[RotationSegment], accel: SensorModel) -> Split:
    """Fit the odd turns and look at the even ones, and the other way round."""
    fitted, out = [], []
    for half in (0, 1):
        kept, left = _divided(turns, half, 2)
        fit = gyroscope.fit(kept, accel, STANDARD, parameters=gyroscope.Parameters.FULL9)
        fitted.append(gyroscope.residuals(kept, accel, fit.model.scale, fit.shift))
        out.append(gyroscope.residuals(left, accel, fit.model.scale, fit.shift))
    return Split(_rms(np.concatenate(fitted)), _rms(np.concatenate(out)))


def _divided(items: Sequence[T], fold: int, folds: int) -> tuple[list[T], list[T]]:
    kept = [item for i, item in enumerate(items) if i % folds != fold]
    return kept, list(items[fold::folds])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _line(row: Row) -> str:
    accel = f"{_MILLI_G * row.accel_before:.3g} -> {_MILLI_G * row.accel_after:.3g}"
    held = [_held(split, _MILLI_G) for split in (row.accel_split, row.accel_halves)]
    gyro = "-"
    if row.gyro_before is not None and row.gyro_after is not None:
        gyro = f"{np.degrees(row.gyro_before):.3g} -> {np.degrees(row.gyro_after):.3g}"
    cells = [row.name, f"{row.rests} / {row.attitudes}", str(row.parameters), accel, *held]
    turned = _held(row.gyro_halves, 180 / np.pi)
    return "| " + " | ".join([*cells, str(row.turns), gyro, turned]) + " |"


def _held(split: Split | None, gain: float) -> str:
    return "-" if split is None else f"{gain * split.held_out:.3g} ({split.ratio:.2f})"


_HEADER = (
    "recording",
    "rests / attitudes",
    "parameters",
    "accelerometer, mg rms",
    "one held out (ratio)",
    "half held out (ratio)",
    "turns",
    "gyroscope, deg rms a turn",
    "half held out (ratio)",
)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
def main(folder: Path) -> None:
    """Print what the engine makes of the known recordings in FOLDER."""
    click.echo("| " + " | ".join(_HEADER) + " |")
    click.echo("|" + "---|" * len(_HEADER))
    for row in survey(folder):
        click.echo(_line(row))


if __name__ == "__main__":
    main()
