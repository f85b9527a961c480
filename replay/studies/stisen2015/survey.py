"""How far phones are off: every device of the still experiment calibrated from its faces.

`python -m stillcal.replay.studies.stisen2015.survey FOLDER [--docs DIR]` reads the still recordings of Stisen
et al. 2015 (HHAR) and writes hhar_still.md with its figure.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from stillcal.calib_core.accelerometer.known_attitudes import FaceCalibration
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.maths.rms import rms
from stillcal.replay.formats.hhar_still import read
from stillcal.replay.plots.style import AXES
from stillcal.replay.studies.methods.device_faces import DeviceOutcome, calibrate_devices

_PAGE = """# How far phones are off

*For people who ask what errors real phones have.*

{total} devices lay still on their faces (Stisen et al. 2015). {done} were calibrated, {refused} were refused
because a face is missing, and {broken} have a broken sensor. Local gravity is not known; {gravity} m/s² is
used, so all scales have its error in common, up to 0.3 %. Made by
`python -m stillcal.replay.studies.stisen2015.survey FOLDER`.

![Bias and scale of each device](images/hhar_still.png)

{calibrated_table}

{distribution_table}

Tilt is how far the faces are from exactly opposite (rms, the residual of approach 2). Up to 0.01 rad the
faces count as known (approach 2 of ESGI'95). Beyond that only their norm is used: 6 parameters, which fit six
faces exactly, so that no residual is left to judge the fit by.

## Refused

{refused_list}

## Broken

{broken_list}
"""


def page(outcomes: list[DeviceOutcome], gravity: float) -> str:
    """Write the survey as a page of Markdown."""
    calibrated = [o for o in outcomes if o.calibration is not None]
    refused = [o for o in outcomes if o.calibration is None and not o.broken]
    broken = [o for o in outcomes if o.broken]
    return _PAGE.format(
        total=len(outcomes),
        done=len(calibrated),
        refused=len(refused),
        broken=len(broken),
        gravity=gravity,
        calibrated_table="\n".join(_calibrated_table(calibrated, gravity)),
        distribution_table="\n".join(_distribution_table(calibrated)),
        refused_list="\n".join(f"- {_name(o)}: {o.reason}." for o in refused),
        broken_list="\n".join(f"- {_name(o)}: {o.reason}." for o in broken),
    )


def _name(outcome: DeviceOutcome) -> str:
    return f"{outcome.recordings.model} {outcome.recordings.device}"


def _calibrated_table(calibrated: list[DeviceOutcome], gravity: float) -> list[str]:
    lines = [
        "| device | method | tilt, rad | bias x, y, z, m/s² | scale error x, y, z, % | norm rms, m/s² |",
        "|---|---|---|---|---|---|",
    ]
    for outcome in calibrated:
        calibration = outcome.calibration
        assert calibration is not None  # `calibrated` holds only these
        bias = ", ".join(f"{b:+.3f}" for b in calibration.model.bias)
        scale = ", ".join(f"{s:+.2f}" for s in _scale_errors(calibration))
        before = rms(np.linalg.norm(outcome.recordings.means, axis=1) - gravity)
        after = f"{before:.3f} → {calibration.rms_residual:.3f}"
        method = f"{calibration.method} | {calibration.tilt:.4f}"
        lines.append(f"| {_name(outcome)} | {method} | {bias} | {scale} | {after} |")
    return lines


def _distribution_table(calibrated: list[DeviceOutcome]) -> list[str]:
    biases = np.array([o.calibration.model.bias for o in calibrated if o.calibration])
    scales = np.array([_scale_errors(o.calibration) for o in calibrated if o.calibration])
    lines = ["| over devices | least | quartile | median | quartile | most |", "|---|---|---|---|---|---|"]
    for name, values in (("bias {}, m/s²", biases), ("scale error {}, %", scales)):
        for axis, column in zip("xyz", values.T, strict=True):
            marks = " | ".join(f"{v:+.3f}" for v in np.percentile(column, [0, 25, 50, 75, 100]))
            lines.append(f"| {name.format(axis)} | {marks} |")
    return lines


def _scale_errors(calibration: FaceCalibration) -> Array:
    """Return what the sensor reads too much along each axis, percent; (3,)."""
    return np.asarray(100.0 * (np.diag(np.linalg.inv(calibration.model.scale)) - 1.0))


def draw(outcomes: list[DeviceOutcome], path: Path) -> None:
    """Draw bias and scale error of each calibrated device. Needs the `report` extra."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

    calibrated = [o for o in outcomes if o.calibration is not None]
    figure = Figure(figsize=(9.0, 0.32 * len(calibrated) + 1.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    rows = np.arange(len(calibrated))
    for axis, (name, colour, marker) in enumerate(AXES):
        biases = [o.calibration.model.bias[axis] for o in calibrated if o.calibration]
        scales = [_scale_errors(o.calibration)[axis] for o in calibrated if o.calibration]
        left.plot(biases, rows, marker, color=colour, label=name)
        right.plot(scales, rows, marker, color=colour)
    left.set_yticks(rows, [_name(o) for o in calibrated])
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
    outcomes = calibrate_devices(read(folder))
    draw(outcomes, docs / "figures" / "hhar_still.png")
    (docs / "hhar_still.md").write_text(page(outcomes, STANDARD), encoding="utf-8")
    click.echo(
        f"{docs / 'hhar_still.md'}: {sum(o.calibration is not None for o in outcomes)} devices calibrated"
    )


if __name__ == "__main__":
    main()
