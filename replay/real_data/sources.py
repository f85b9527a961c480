"""The real recordings, one by one, as the diagnosis takes them; their places are those of docs/data.md."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.trace import Recording, read_all

FILES = (
    "imu_tk/xsens_acc.mat.gz",
    "mikoff/imu0.log",
    "mikoff/imu1.log",
    "mikoff/imu2.log",
    "imucal/example_ferraris_session.csv",
    "hhar/Phones_accelerometer.csv.gz",
    "hhar/Watch_accelerometer.csv.gz",
    "sunsided/still_10min.csv.gz",
    "sunsided/full_sphere.csv.gz",
    "rocket/jackpot_launch_1.csv.gz",
    "px4/sample.ulg",
    "carbonix/flight_three_imus.npz",
    "axivity/ax3_testfile.cwa",
    "axivity/ax6_testfile.cwa",
)
"""Recordings that are read as they are; their formats are recognised."""


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A real recording. device: who made it (sisters share it); optical: (n, 4) true attitude, or None."""

    name: str
    device: str
    recording: Recording
    optical: Array | None = None


def sources(folder: Path, maker: str | None = None) -> Iterator[Source]:
    """Yield every recording of samples that is there, or one maker's, named like its folder."""
    for name in FILES:
        if (folder / name).exists() and maker in (None, name.split("/")[0]):
            yield Source(name, name.split("/")[0], read_all(folder / name))
    if maker in (None, "broad"):
        yield from _broad(folder / "broad")


def _broad(folder: Path) -> Iterator[Source]:
    """Yield trials of BROAD (Laidig et al. 2021, CC BY 4.0): MATLAB files with optical truth beside."""
    from scipy.io import loadmat  # noqa: PLC0415 - only these files need it

    for path in sorted(folder.glob("*.mat")):
        attitude = np.asarray(loadmat(path, variable_names=["opt_quat"])["opt_quat"])
        yield Source(f"broad/{path.name[:2]}", "broad", read_all(path), attitude)


def part(recording: Recording, first: float, last: float) -> Recording:
    """Return the samples from the fraction `first` to `last` of the recording's span."""
    t = recording.accelerometer.t
    begin, end = (t[0] + f * (t[-1] - t[0]) for f in (first, last))
    gyroscope = None if recording.gyroscope is None else recording.gyroscope.between(begin, end)
    events = [e for e in recording.events if begin <= e.t <= end]
    accelerometer = recording.accelerometer.between(begin, end)
    return replace(recording, accelerometer=accelerometer, gyroscope=gyroscope, events=events)


def without_thermometer(recording: Recording) -> Recording:
    """Return the recording with its temperatures withheld."""
    gyroscope = recording.gyroscope
    return replace(
        recording,
        accelerometer=replace(recording.accelerometer, temperature=None),
        gyroscope=None if gyroscope is None else replace(gyroscope, temperature=None),
    )
