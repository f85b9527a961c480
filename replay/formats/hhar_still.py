"""The still experiment of Stisen et al. 2015 (HHAR): phones and watches lying on each of their faces.

A folder holds index.csv, one row a recording, and still_accel.npz, the samples of all recordings one after
another. The folder's own labels of faces are not used: they call two recordings of one face left and right on
several phones.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples, Sensor

_BATCHES = 10
"""A mean's uncertainty is the scatter of so many parts of the recording, so that slow drift is in it."""


@dataclass(frozen=True, slots=True, eq=False)
class DeviceRecordings:
    """The still recordings of one device.

    means, spreads, uncertainties: (n, 3) m/s^2, the mean of each recording, the standard deviation of its
    samples and the standard deviation of its mean.
    """

    device: str
    model: str
    means: Array
    spreads: Array
    uncertainties: Array


def read(folder: Path) -> list[DeviceRecordings]:
    """Read the still experiment in `folder`: one entry a device, ordered by model and device.

    Raises OSError or KeyError where a file or column is missing.
    """
    samples = np.load(folder / "still_accel.npz")["acc"]
    blocks_of: dict[tuple[str, str], list[Array]] = {}
    with (folder / "index.csv").open(newline="") as lines:
        for row in csv.DictReader(lines):
            start = int(row["start"])
            block = np.asarray(samples[start : start + int(row["count"])], dtype=np.float64)
            model = row["model"].removesuffix("_locked").removesuffix("_unlocked")
            blocks_of.setdefault((model, row["device"]), []).append(block)
    return [
        _device_recordings(device, model, blocks) for (model, device), blocks in sorted(blocks_of.items())
    ]


def _device_recordings(device: str, model: str, blocks: list[Array]) -> DeviceRecordings:
    parts = [np.array([p.mean(axis=0) for p in np.array_split(b, _BATCHES)]) for b in blocks]
    return DeviceRecordings(
        device,
        model,
        np.array([b.mean(axis=0) for b in blocks]),
        np.array([b.std(axis=0) for b in blocks]),
        np.array([p.std(axis=0, ddof=1) / np.sqrt(_BATCHES) for p in parts]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class StillRecording:
    """One recording of the still experiment. position: the folder's label, as published."""

    device: str
    model: str
    position: str
    samples: Samples


def recordings(folder: Path) -> list[StillRecording]:
    """Read every recording in `folder` with its own stamps, s from the first, and times of arrival.

    The stamps' unit differs by device; it is the power of ten s that fits the arrivals best.
    Raises OSError or KeyError where a file or column is missing.
    """
    with np.load(folder / "still_accel.npz") as data:
        columns = [np.asarray(data[name], dtype=np.float64) for name in ("acc", "arrival_ms", "creation")]
    out = []
    with (folder / "index.csv").open(newline="") as lines:
        for row in csv.DictReader(lines):
            start = int(row["start"])
            force, arrival_ms, creation = (c[start : start + int(row["count"])] for c in columns)
            model = row["model"].removesuffix("_locked").removesuffix("_unlocked")
            arrival = np.maximum.accumulate(arrival_ms - arrival_ms[0]) / 1e3
            t = (creation - creation[0]) * _unit(np.diff(creation), np.diff(arrival))
            samples = Samples.checked(Sensor.ACCELEROMETER, t, force, None, arrival)
            out.append(StillRecording(row["device"], model, row["position"], samples))
    return out


def _unit(stamps: Array, arrivals: Array) -> float:
    """Return the s that one unit of the stamps stands for, by mean intervals, pauses left out."""
    typical, waits = float(np.median(stamps)), stamps < 10.0 * float(np.median(stamps))
    return float(10.0 ** np.rint(np.log10(arrivals[waits].mean() / typical)))
