"""How far phones are off: every device of a still experiment calibrated from its faces.

`python -m stillcal.replay.formats.hhar_still FOLDER [--docs DIR]` reads the still recordings of Stisen et al.
2015 (HHAR; index.csv and still_accel.npz) and writes hhar_still.md with its figure. The faces are read from
the data, not from the folder's labels, which call two recordings of one face left and right on several
phones.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from stillcal.calib_core.accelerometer.known_attitudes import Broken, FaceCalibration, calibrate_faces
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import STANDARD

_BATCHES = 10  # a mean's uncertainty from so many parts, so that slow wander is in it


@dataclass(frozen=True, slots=True, eq=False)
class Recordings:
    """One device's still recordings: means, sds of samples and uncertainties of means, (n, 3) m/s^2."""

    device: str
    model: str
    means: Array
    spreads: Array
    uncertainties: Array


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What came of one device: a calibration, or why there is none (`broken` or faces missing)."""

    recordings: Recordings
    calibration: FaceCalibration | None
    broken: bool = False
    reason: str = ""


def read(folder: Path) -> list[Recordings]:
    """Read the still experiment, one entry a device; devices without a name go by their model."""
    samples = np.load(folder / "still_accel.npz")["acc"]
    found: dict[tuple[str, str], list[Array]] = {}
    with (folder / "index.csv").open(newline="") as lines:
        for row in csv.DictReader(lines):
            start = int(row["start"])
            block = np.asarray(samples[start : start + int(row["count"])], dtype=np.float64)
            model = row["model"].removesuffix("_locked").removesuffix("_unlocked")
            found.setdefault((model, row["device"]), []).append(block)
    return [_recordings(device, model, blocks) for (model, device), blocks in sorted(found.items())]


def _recordings(device: str, model: str, blocks: list[Array]) -> Recordings:
    parts = [np.array([p.mean(axis=0) for p in np.array_split(b, _BATCHES)]) for b in blocks]
    return Recordings(
        device,
        model,
        np.array([b.mean(axis=0) for b in blocks]),
        np.array([b.std(axis=0) for b in blocks]),
        np.array([p.std(axis=0, ddof=1) / np.sqrt(_BATCHES) for p in parts]),
    )


def survey(devices: list[Recordings], gravity: float = STANDARD) -> list[Outcome]:
    """Calibrate every device that can be; gravity in m/s^2, standard where the place is unknown."""
    return [_outcome(device, gravity) for device in devices]


def _outcome(device: Recordings, gravity: float) -> Outcome:
    try:
        return Outcome(device, calibrate_faces(device.means, device.spreads, device.uncertainties, gravity))
    except NotSupported as error:
        return Outcome(device, None, isinstance(error, Broken), str(error))


_PAGE = """# How far phones are off

{total} devices lay still on their faces (Stisen et al. 2015): {done} calibrated, {refused} refused for want
of a face, {broken} broken. Local gravity is not known and taken as {gravity} m/s², so all scales share its
error, up to 0.3 %. Made by `python -m stillcal.replay.formats.hhar_still FOLDER`.

![Bias and scale of each device](figures/hhar_still.png)

{calibrated_table}

{distribution_table}

Tilt is how far the faces are from truly opposite (rms, approach 2's own residual). Up to 0.01 rad the faces
are taken as known (approach 2 of ESGI'95), beyond it only their norm is (6 parameters, which fit six faces
exactly: no residual is left to judge them by).

## Refused

{refused_list}

## Broken

{broken_list}
"""


def page(outcomes: list[Outcome], gravity: float) -> str:
    """Write the survey as a page of Markdown."""
    done = [o for o in outcomes if o.calibration is not None]
    refused = [o for o in outcomes if o.calibration is None and not o.broken]
    broken = [o for o in outcomes if o.broken]
    return _PAGE.format(
        total=len(outcomes),
        done=len(done),
        refused=len(refused),
        broken=len(broken),
        gravity=gravity,
        calibrated_table="\n".join(_calibrated_table(done, gravity)),
        distribution_table="\n".join(_distribution_table(done)),
        refused_list="\n".join(f"- {_name(o)}: {o.reason}." for o in refused),
        broken_list="\n".join(f"- {_name(o)}: {o.reason}." for o in broken),
    )


def _name(outcome: Outcome) -> str:
    return f"{outcome.recordings.model} {outcome.recordings.device}"


def _calibrated_table(done: list[Outcome], gravity: float) -> list[str]:
    lines = [
        "| device | method | tilt, rad | bias x, y, z, m/s² | scale error x, y, z, % | norm rms, m/s² |",
        "|---|---|---|---|---|---|",
    ]
    for outcome in done:
        found = outcome.calibration
        assert found is not None  # `done` holds only these
        bias = ", ".join(f"{b:+.3f}" for b in found.model.bias)
        scale = ", ".join(f"{s:+.2f}" for s in _scale_errors(found))
        before = float(np.sqrt(np.mean((np.linalg.norm(outcome.recordings.means, axis=1) - gravity) ** 2)))
        after = f"{before:.3f} → {found.rms_residual:.3f}"
        lines.append(f"| {_name(outcome)} | {found.method} | {found.tilt:.4f} | {bias} | {scale} | {after} |")
    return lines


def _distribution_table(done: list[Outcome]) -> list[str]:
    biases = np.array([o.calibration.model.bias for o in done if o.calibration])
    scales = np.array([_scale_errors(o.calibration) for o in done if o.calibration])
    lines = ["| over devices | least | quartile | median | quartile | most |", "|---|---|---|---|---|---|"]
    for name, values in (("bias {}, m/s²", biases), ("scale error {}, %", scales)):
        for axis, column in zip("xyz", values.T, strict=True):
            marks = " | ".join(f"{v:+.3f}" for v in np.percentile(column, [0, 25, 50, 75, 100]))
            lines.append(f"| {name.format(axis)} | {marks} |")
    return lines


def _scale_errors(found: FaceCalibration) -> Array:
    """Return what the sensor reads too much along each axis, percent; (3,)."""
    return np.asarray(100.0 * (np.diag(np.linalg.inv(found.model.scale)) - 1.0))


def draw(outcomes: list[Outcome], path: Path) -> None:
    """Draw bias and scale error of each calibrated device. Needs the `report` extra."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

    done = [o for o in outcomes if o.calibration is not None]
    figure = Figure(figsize=(9.0, 0.32 * len(done) + 1.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    rows = np.arange(len(done))
    for axis, (colour, marker) in enumerate((("#0072b2", "o"), ("#d55e00", "s"), ("#009e73", "^"))):
        biases = [o.calibration.model.bias[axis] for o in done if o.calibration]
        scales = [_scale_errors(o.calibration)[axis] for o in done if o.calibration]
        left.plot(biases, rows, marker, color=colour, label="xyz"[axis])
        right.plot(scales, rows, marker, color=colour)
    left.set_yticks(rows, [_name(o) for o in done])
    left.invert_yaxis()
    left.set_xlabel("bias, m/s²")
    right.set_xlabel("scale error, %")
    for panel in (left, right):
        panel.axvline(0.0, color="0.6", linewidth=0.8, zorder=0)
        panel.grid(axis="y", color="0.9", zorder=0)
        panel.spines[["top", "right"]].set_visible(False)
    left.legend(title="axis", frameon=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


@click.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--docs", default="docs", type=click.Path(path_type=Path), help="Where the page is written.")
def main(folder: Path, docs: Path) -> None:
    """Calibrate every device of a still experiment in FOLDER; write hhar_still.md and its figure."""
    outcomes = survey(read(folder))
    draw(outcomes, docs / "figures" / "hhar_still.png")
    (docs / "hhar_still.md").write_text(page(outcomes, STANDARD), encoding="utf-8")
    click.echo(
        f"{docs / 'hhar_still.md'}: {sum(o.calibration is not None for o in outcomes)} devices calibrated"
    )


if __name__ == "__main__":
    main()
