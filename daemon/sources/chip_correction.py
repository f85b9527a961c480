"""The correction that a chip applies itself: calibbias and calibscale of the kernel's sysfs-bus-iio.

reading = calibscale * (uncorrected + calibbias), by the chip's axes; every program that reads the sensor then
gets corrected values. The unit of calibbias is the driver's own; for inv_icm42600 it is SI
(Documentation/ABI/testing/sysfs-bus-iio-icm42600). Only drivers whose unit is known are written to.
calibscale is a plain factor.

What the files held before the first write is kept in a file of ours until it is put back, so that neither a
crash nor a kill loses it. A reboot resets the chip, and with it this memory.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.daemon.store.atomic import write_atomically
from stillcal.daemon.system.clock import BOOT_ID
from stillcal.daemon.system.files import read_regular

SI_DRIVERS = re.compile(r"(icm426\d\d|icm427\d\d|iim42\d\d\d|icm40609)")
"""Names of the devices of inv_icm42600."""

MAX_BYTES = 2**20
"""More than what is kept of a few registers can have."""

AXES = "xyz"
STEP_SHARE = 0.75
"""A value is written anew where it differs by more than this share of the register's step."""


class ChipError(ValueError):
    """The chip cannot hold a correction; the message says why."""


class Before(msgspec.Struct, frozen=True):
    """What files held before they were first written to. boot: id of that boot of the kernel."""

    boot: str
    files: dict[str, str]


def files_of(folder: Path, prefix: str) -> dict[str, Path]:
    """Return the files of a sensor's correction that there are: "x_calibbias" and the like."""
    names = [f"{axis}_{kind}" for kind in ("calibbias", "calibscale") for axis in AXES]
    return {name: path for name in names if (path := folder / f"{prefix}_{name}").exists()}


def applied(folder: Path, prefix: str, device: str) -> tuple[Array, Array]:
    """Return calibbias (SI) and calibscale now, (3,) each; 0 and 1 where the unit is unknown.

    Raises OSError and ValueError on a file that cannot be read.
    """
    bias, scale = np.zeros(3), np.ones(3)
    if SI_DRIVERS.match(device):
        for name, path in files_of(folder, prefix).items():
            values = bias if name.endswith("calibbias") else scale
            values[AXES.index(name[0])] = float(path.read_text(encoding="ascii"))
    return bias, scale


def wanted(folder: Path, prefix: str, device: str, bias: Array, scale: Array) -> dict[Path, float]:
    """Return what to write for calibrated = scale * (uncorrected - bias); nothing where it is there already.

    bias, scale: (3,), SI, the chip's axes. Raises ChipError where the driver has no such files, their unit is
    unknown, or a value does not fit.
    """
    there = files_of(folder, prefix)
    if not all(f"{axis}_calibbias" in there for axis in AXES):
        raise ChipError(f"{device} has no {prefix}_x_calibbias: its driver cannot correct the readings")
    if not SI_DRIVERS.match(device):
        what = f"the unit of its {prefix}_x_calibbias is not known, only that of inv_icm42600's"
        raise ChipError(f"{device}: {what}")
    range_ = _available(folder / f"{prefix}_calibbias_available")
    values = {}
    for i, axis in enumerate(AXES):
        value = float(-bias[i])
        if range_ is not None and not range_[0] <= value <= range_[2]:
            what = f"{value:.4g} is beyond its range, {range_[0]:g} to {range_[2]:g}"
            raise ChipError(f"{device}: {prefix}_{axis}_calibbias: {what}")
        values[there[f"{axis}_calibbias"]] = value
        if f"{axis}_calibscale" in there:
            values[there[f"{axis}_calibscale"]] = float(scale[i])
    step = range_[1] if range_ is not None else 0.0
    return values if _differ(values, step) else {}


def write(values: Mapping[Path, float], memory: Path) -> None:
    """Write all values, or none: where one is refused, those written before it are put back. Raises OSError.

    memory: where the files' contents of before are kept.
    """
    held = {path: path.read_text(encoding="ascii") for path in values}
    _remember({str(path): text for path, text in held.items()}, memory)
    done: list[Path] = []
    try:
        for path, value in values.items():
            done.append(path)
            path.write_text(f"{value:.9f}\n", encoding="ascii")
    except OSError:
        for path in done:
            with contextlib.suppress(OSError):
                path.write_text(held[path], encoding="ascii")
        raise


def put_back(memory: Path) -> list[Path]:
    """Put back what the files held before, forget it, and return the files. Raises OSError."""
    before = _remembered(memory)
    for name, text in before.items():
        Path(name).write_text(text, encoding="ascii")
    memory.unlink(missing_ok=True)
    return [Path(name) for name in before]


def _remember(held: Mapping[str, str], memory: Path) -> None:
    """Keep what files hold, unless it is kept already."""
    known = _remembered(memory)
    if held.keys() - known.keys():
        write_atomically(memory, msgspec.json.encode(Before(_boot(), {**held, **known})), 0o600)


def _remembered(memory: Path) -> dict[str, str]:
    """Return what is kept of this boot of the kernel."""
    try:
        before = msgspec.json.decode(read_regular(memory, MAX_BYTES), type=Before)
    except (OSError, msgspec.MsgspecError):
        return {}
    return before.files if before.boot == _boot() else {}


def _boot() -> str:
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _available(path: Path) -> tuple[float, float, float] | None:
    """Return least value, step and largest from "[min step max]"; None where the driver does not say."""
    try:
        low, step, high = (float(word) for word in path.read_text(encoding="ascii").strip("[] \n").split())
    except (OSError, ValueError):
        return None
    return low, step, high


def _differ(values: Mapping[Path, float], step: float) -> bool:
    """Return whether a file holds something else than its value, as far as the register's step shows."""
    for path, value in values.items():
        try:
            held = float(path.read_text(encoding="ascii"))
        except ValueError:
            return True
        if abs(held - value) > max(STEP_SHARE * step if path.name.endswith("calibbias") else 0.0, 1e-6):
            return True
    return False
