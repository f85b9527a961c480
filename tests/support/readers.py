"""The page of what every reader makes of real recordings, docs/readers.md.

`python -m tests.support.readers FOLDER` prints it; FOLDER holds the recordings of docs/data.md. For formats
of which none is at hand, one of them is written by the format's own library, or in an app's layout, and read
again.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin

from stillcal.replay.formats.trace import Recording, open_trace, read_all
from stillcal.replay.studies.claim import table
from tests.support import log_files as made
from tests.support.command_line import ran

GGIR = "wadpac/GGIRread (Apache-2.0)"
REAL = {
    "px4/sample.ulg": "PX4/pyulog (BSD-3)",
    "px4/sample_log_small.ulg": "PX4/pyulog (BSD-3)",
    "axivity/ax3_testfile.cwa": GGIR,
    "axivity/ax3_testfile_corrupt_blocks_0_13_14_142_143_144.cwa": GGIR,
    "axivity/ax6_testfile.cwa": GGIR,
    "broad/01_undisturbed_slow_rotation_A.mat": "dlaidig/broad (CC BY 4.0)",
    "broad/14_undisturbed_slow_translation_with_breaks_B.mat": "dlaidig/broad (CC BY 4.0)",
    "carbonix/flight_three_imus.npz": "CarbonixUAV/ardupilot-log-handler (MIT), repacked",
    "imu_tk/xsens_acc.mat.gz": "Kyle-ak/imu_tk (BSD)",
    "mikoff/imu0.log": "mikoff/imu-calib (MIT)",
    "mikoff/imu1.log": "mikoff/imu-calib (MIT)",
    "mikoff/imu2.log": "mikoff/imu-calib (MIT)",
    "imucal/example_ferraris_session.csv": "mad-lab-fau/imucal (MIT)",
    "hhar/Phones_accelerometer.csv.gz": "rdavilao/COMP_Taller5, after Stisen et al. 2015 (CC BY 4.0)",
    "hhar/Watch_accelerometer.csv.gz": "rdavilao/COMP_Taller5, after Stisen et al. 2015 (CC BY 4.0)",
    "sunsided/full_sphere.csv.gz": "sunsided/sensor-fusion (EUPL-1.2)",
    "sunsided/still_10min.csv.gz": "sunsided/sensor-fusion (EUPL-1.2)",
    "rocket/jackpot_launch_1.csv.gz": "NCSU-High-Powered-Rocketry-Club/AirbrakesV2 (MIT)",
}
"""Files of docs/data.md with their source and its licence."""

COPIED = "mikoff/imu0.log"
"""The recording that is written in other formats: the one with most attitudes."""


COPIES: dict[str, Callable[[Path, np.ndarray], Path]] = {
    "ROS 1 bag, by rosbags": made.ros1_bag,
    "ROS 2 bag (SQLite), by rosbags": lambda folder, data: made.ros2_bag(folder, data=data),
    "ROS 2 bag (MCAP), by rosbags": lambda f, data: made.ros2_bag(f, StoragePlugin.MCAP, data=data),
    "MCAP file, by rosbags": made.mcap_file,
    "Parquet, by pyarrow": made.parquet_file,
    "HDF5, by h5py": made.hdf5,
    "MATLAB, by scipy": made.mat,
    "NPZ, by numpy": made.npz,
    "phyphox, zip in the app's layout": lambda f, data: made.as_zip(f, made.phyphox_files(data)),
    "phyphox on iOS, zip in the app's layout": lambda f, data: made.as_zip(f, made.phyphox_ios_files(data)),
    "Sensor Logger, zip in the app's layout": lambda f, data: made.as_zip(
        f, made.sensor_logger_files(bias=(0, 0, 0), data=data, force_bias=0.0)
    ),
    "GnssLogger, text in the app's layout": made.gnss_logger,
    "DataFlash, by ArduPilot's `LogStructure.h`": made.dataflash_file,
}
"""What writes the copied recording, (n, 7) SI, into a folder."""

PAGE = """# What every reader makes of real recordings

*For people who ask whether their kind of log is read, and how that was tried.*

Made by `python -m tests.support.readers $STILLCAL_DATA > docs/readers.md`. [data.md](data.md) says where the
recordings come from; they are not part of the package. Every file is opened without `--format`. The
calibration is what `{command} FILE` answers; few of these recordings were made to
calibrate from.

## Real recordings

{real}

## One real recording in other formats

No real recording of these formats was at hand but of MATLAB and NPZ. `{copied}` was written in each, by the
format's own library where there is one, and read again. The difference is the largest of any axis of both
sensors from the original.

{copies}
"""
COMMAND = ("replay", "--watch", "continuous")


def main(folder: Path) -> None:
    """Print the page."""
    real = table(REAL_HEAD, [real_row(folder, name) for name in REAL])
    copies = table(COPY_HEAD, list(copy_rows(folder / COPIED)))
    command = " ".join(("stillcal", *COMMAND))
    sys.stdout.write(PAGE.format(command=command, real=real, copied=COPIED, copies=copies))


REAL_HEAD = (
    "FILE",
    "source (licence)",
    "read as",
    "samples of the accelerometer",
    "gyroscope",
    "calibration",
)
COPY_HEAD = ("format", "read as", "samples of the accelerometer", "difference, m/s^2 or rad/s", "calibration")


def real_row(folder: Path, name: str) -> tuple[str, ...]:
    """Return what is made of one real recording."""
    path = folder / name
    recording = read_all(path)
    gyroscope = "no" if recording.gyroscope is None else "yes"
    return (f"`{name}`", REAL[name], open_trace(path).kind, _length(recording), gyroscope, calibration(path))


def calibration(path: Path) -> str:
    """Return what the command answers: attitudes and what is left at rest, or why there is no calibration."""
    done = ran(*COMMAND, path, "--quiet", "--json", "-")
    if done.returncode == 0:
        fit = json.loads(done.stdout)["accelerometer"]
        return f"{fit['n_states']} attitudes, {fit['rms_residual']:.4f} m/s² rms"
    said = done.stderr.decode().strip().splitlines()[-1]
    return said.partition(": no calibration: ")[2].partition(";")[0] or said


def copy_rows(original: Path, answer: Callable[[Path], str] = calibration) -> Iterator[tuple[str, ...]]:
    """Yield what is made of each copy of a recording. answer: says what a command makes of it."""
    whole = read_all(original)
    assert whole.gyroscope is not None
    values = np.column_stack([whole.accelerometer.xyz, whole.gyroscope.xyz])
    data = np.column_stack([whole.accelerometer.t, values])
    for name, written in COPIES.items():
        with tempfile.TemporaryDirectory() as folder:
            path = written(Path(folder), data)
            copy = read_all(path)
            assert copy.gyroscope is not None
            difference = np.abs(np.column_stack([copy.accelerometer.xyz, copy.gyroscope.xyz]) - values).max()
            yield name, open_trace(path).kind, _length(copy), f"{difference:.2g}", answer(path)


def _length(recording: Recording) -> str:
    t = recording.accelerometer.t
    return f"{len(t):,} in {t[-1] - t[0]:.0f} s, {(len(t) - 1) / (t[-1] - t[0]):.1f} Hz"


if __name__ == "__main__":
    main(Path(sys.argv[1]))
