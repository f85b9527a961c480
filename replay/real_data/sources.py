"""The real recordings, one by one, as the diagnosis takes them; their places are those of docs/data.md."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording, read_all

FILES = {
    "imu_tk/xsens_acc.mat.gz": "imu_tk",
    "mikoff/imu0.log": "mikoff",
    "mikoff/imu1.log": "mikoff",
    "mikoff/imu2.log": "mikoff",
    "imucal/example_ferraris_session.csv": "imucal",
    "hhar/Phones_accelerometer.csv.gz": "hhar",
    "hhar/Watch_accelerometer.csv.gz": "hhar",
    "sunsided/still_10min.csv.gz": "mpu6050",
    "sunsided/full_sphere.csv.gz": "mpu6050",
    "rocket/jackpot_launch_1.csv.gz": "airbrakes",
}
"""Recordings that the formats read, and their formats."""


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A real recording. device: who made it (sisters share it); optical: (n, 4) true attitude, or None."""

    name: str
    device: str
    recording: Recording
    optical: Array | None = None


def sources(folder: Path, maker: str | None = None) -> Iterator[Source]:
    """Yield every recording of samples that is there, or one maker's, named like its folder."""
    for name, form in FILES.items():
        if (folder / name).exists() and maker in (None, name.split("/")[0]):
            yield Source(name, name.split("/")[0], read_all(folder / name, form))
    if maker in (None, "broad"):
        yield from _broad(folder / "broad")
    if maker in (None, "hhar_still"):
        yield from _still(folder / "hhar_still")


def _broad(folder: Path) -> Iterator[Source]:
    """Yield trials of BROAD (Laidig et al. 2021, CC BY 4.0): MATLAB files with optical truth beside."""
    from scipy.io import loadmat  # noqa: PLC0415 - only these files need it

    for path in sorted(folder.glob("*.mat")):
        file = loadmat(path)
        t = np.arange(len(file["imu_acc"])) / float(file["sampling_rate"].squeeze())
        accelerometer = _samples(Sensor.ACCELEROMETER, t, file["imu_acc"])
        gyroscope = _samples(Sensor.GYROSCOPE, t, file["imu_gyr"])
        recording = Recording(accelerometer, gyroscope, [], Claims(), [])
        yield Source(f"broad/{path.name[:2]}", "broad", recording, np.asarray(file["opt_quat"]))


def _still(folder: Path) -> Iterator[Source]:
    if not (folder / "index.csv").exists():
        return
    samples = np.load(folder / "still_accel.npz")
    with (folder / "index.csv").open(newline="") as lines:
        for row in csv.DictReader(lines):
            rows = slice(int(row["start"]), int(row["start"]) + int(row["count"]))
            name = f"hhar_still/{row['model']}/{row['device']}/{row['position']}"
            yield Source(name, f"{row['model']}/{row['device']}", _resting(samples, rows))


def _resting(samples: dict[str, Array], rows: slice) -> Recording:
    """Return one still recording, its stamps those of arrival: creation's unit differs between devices.

    Samples that arrive within one millisecond share a stamp there; they are spread over their interval.
    """
    arrival = np.maximum.accumulate(np.asarray(samples["arrival_ms"][rows], dtype=np.float64)) / 1000.0
    index = np.arange(arrival.size)
    first = np.flatnonzero(np.r_[True, np.diff(arrival) > 0])
    t = np.interp(index, np.r_[first, arrival.size], np.r_[arrival[first], arrival[-1] + 1e-3])
    return Recording(_samples(Sensor.ACCELEROMETER, t, samples["acc"][rows]), None, [], Claims(), [])


def _samples(sensor: Sensor, t: Array, values: Array) -> Samples:
    return Samples(sensor, frozen(t), frozen(values))


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
