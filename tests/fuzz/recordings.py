"""Recordings in every format, and the files beside them. A read one must hold usable samples in order."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin

from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams import limits
from stillcal.replay.formats.rest_table import read_rest_table
from stillcal.replay.formats.trace import read_all
from tests.fuzz.target import Target, any_of
from tests.support import log_files
from tests.support.log_files import CWA_BLOCK, CWA_HEADER, IMU, cwa_summed, rows, text

DATA = rows(80)
"""What the seeds hold: two blocks of Axivity's, little enough that an input takes milliseconds."""

T, FORCE, RATE = DATA[:, :1], DATA[:, 1:4], DATA[:, 4:]


def _read(path: Path, format: str | None = None) -> None:
    """Read a recording as replay does: refused in one line, or usable samples in time order."""
    try:
        recording = read_all(path, format)
    except UserError as error:
        assert "\n" not in str(error)
        return
    for samples in (recording.accelerometer, recording.gyroscope):
        if samples is not None:
            assert limits.usable(samples.t, samples.xyz).all()
            assert (np.diff(samples.t) >= 0).all()


def _feed(name: str, format: str | None, data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        _read(path, format)


# Text

_AXES = ("x", "y", "z")


def _csv() -> str:
    return text("t,ax,ay,az,gx,gy,gz", DATA)


def _hhar() -> str:
    cells = (f"{i},{1000 + 10 * i},{10_000_000 * i},0.1,0.2,9.8,a,nexus4,nexus4_1,stand" for i in range(40))
    return "\n".join(cells) + "\n"


def _blank_separated(values: np.ndarray) -> str:
    return "\n".join("   ".join(f"{v:.7e}" for v in row) for row in values) + "\n"


def _imucal() -> str:
    names = ",".join(["n_samples", *(f"acc_{a}" for a in _AXES), *(f"gyr_{a}" for a in _AXES)])
    return text(names, np.column_stack([np.arange(len(DATA)), FORCE, np.rad2deg(RATE)]))


def _rows_of_sensors() -> str:
    """Return a table with a row for each sensor, those of a light sensor shorter."""
    cells = zip(("acc", "gyr"), (FORCE, RATE), strict=True)
    by_sensor = [
        [f"{name},{t},{x},{y},{z}" for t, (x, y, z) in zip(T[:, 0], xyz, strict=True)] for name, xyz in cells
    ]
    rows_of = (row for pair in zip(*by_sensor, strict=True) for row in (*pair, "light,0,40"))
    return "\n".join(["sensor,t,x,y,z", *rows_of])


_NAMES = ("t", "acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z")


def _json() -> list[bytes]:
    """Return records a line each, as an array, and the same by column."""
    records = [dict(zip(_NAMES, row, strict=True)) for row in DATA.tolist()]
    nested = [
        {"t": row[0], "acc": row[1:4], "gyr": dict(zip("xyz", row[4:], strict=True))} for row in DATA.tolist()
    ]
    columns = dict(zip(_NAMES, DATA.T.tolist(), strict=True))
    lines = "\n".join(map(json.dumps, nested))
    return [text.encode() for text in (lines, json.dumps(records, indent=1), json.dumps(columns))]


TEXTS: dict[str, Callable[[], str]] = {
    "csv": _csv,
    "hhar": _hhar,
    "imu_tk": lambda: _blank_separated(np.column_stack([T, FORCE * 411 + 32768])),
    "mikoff": lambda: _blank_separated(DATA[:, 1:]),
    "imucal": _imucal,
    "phyphox": lambda: log_files.phyphox_files(DATA)["Accelerometer.csv"].replace(",", ";"),
    "sensorlogger": lambda: log_files.sensor_logger_files(data=DATA)["TotalAcceleration.csv"],
}


def _rest_table(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rests.csv"
        path.write_bytes(data)
        with contextlib.suppress(UserError):
            read_rest_table(path)


def _beside_trace(name: str, data: bytes) -> None:
    """Feed a file that stands beside a recording: its events or its claims."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trace.csv"
        path.write_text(_csv())
        (Path(folder) / name).write_bytes(data)
        _read(path)


# Logs


def _made(make: Callable[[Path], Path]) -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        return [make(Path(folder)).read_bytes()]


def _ros2(folder: Path) -> Path:
    (stored,) = log_files.ros2_bag(folder, StoragePlugin.SQLITE3, data=DATA).glob("*.db3")
    return stored


@functools.cache
def _ros2_bag() -> tuple[str, bytes, bytes]:
    """Return a bag's name of the file of messages, that file, and its description."""
    with tempfile.TemporaryDirectory() as folder:
        stored = _ros2(Path(folder))
        return stored.name, stored.read_bytes(), (stored.parent / "metadata.yaml").read_bytes()


def _feed_ros2_folder(data: bytes) -> None:
    """Feed the description of a bag whose messages are whole."""
    name, messages, _ = _ros2_bag()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / name).write_bytes(messages)
        (Path(folder) / "metadata.yaml").write_bytes(data)
        _read(Path(folder))


def _mcap() -> list[bytes]:
    """Return two files of Imu messages, without compression and with."""
    return [_mcap_file(chunked) for chunked in (False, True)]


def _mcap_file(chunked: bool) -> bytes:
    store = log_files.get_typestore(log_files.Stores.ROS2_HUMBLE)
    out = io.BytesIO()
    writer = McapWriter(out, use_chunking=chunked)
    writer.start()
    channel = writer.register_channel("/imu", "cdr", writer.register_schema(IMU, "ros2msg", b""))
    for row in DATA:
        ns = round((1000 + row[0]) * 1e9)
        message = store.serialize_cdr(log_files.imu_message(store, row), IMU)
        writer.add_message(channel, ns, message, ns)
    writer.finish()
    return out.getvalue()


def _feed_axivity(data: bytes) -> None:
    """Feed a recording as it is, and with the check sums that are right for whatever its blocks hold."""
    _feed("log.cwa", None, data)
    blocks = [data[at : at + CWA_BLOCK] for at in range(CWA_HEADER, len(data) - CWA_BLOCK + 1, CWA_BLOCK)]
    _feed("log.cwa", None, data[:CWA_HEADER] + b"".join(map(cwa_summed, blocks)))


def _npz() -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        whole = log_files.npz(Path(folder), DATA).read_bytes()
        np.save(Path(folder) / "acc.npy", FORCE)
        return [whole, (Path(folder) / "acc.npy").read_bytes()]


def _feed_npz(data: bytes) -> None:
    """Feed an archive, or an array of one whose check sum is right."""
    _feed("walk.npz", None, data)
    _feed_zip({"time.npy": _npy(DATA[:, 0]), "acc.npy": data})


def _npy(values: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, values)
    return out.getvalue()


def _feed_zip(members: dict[str, bytes]) -> None:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    _feed("export.zip", None, out.getvalue())


def _feed_member(files: dict[str, str], member: str, data: bytes) -> None:
    """Feed one file of a phone's export, in a zip whose check sums are right."""
    _feed_zip({name: content.encode() for name, content in files.items()} | {member: data})


def _betaflight(unit_force: str = "", unit_rate: str = "", head: str = "") -> bytes:
    """Return a blackbox log as CSV, in counts where no units are given."""
    names = [f"gyroADC[{i}]{unit_rate}" for i in range(3)] + [f"accSmooth[{i}]{unit_force}" for i in range(3)]
    count = 9.80665 if unit_force else 9.80665 / 2048
    values = np.column_stack([np.round(1e6 * T), np.round(np.degrees(RATE)), np.round(FORCE / count)])
    lines = [",".join(map(str, [i, *row])) for i, row in enumerate(values.astype(int).tolist())]
    return "\n".join([head + ",".join(["loopIteration", "time (us)", *names]), *lines, ""]).encode()


_EXPLORER = '"Product","Blackbox flight data recorder"\n"acc_1G",2048\n"gyroScale",1.7453292519943296e-8\n'
_HEADERS = b"fieldname,fieldvalue\nacc_1G,2048\ngyro_scale,0x3f800000\nblackbox_high_resolution,1\n"


def _feed_headers(data: bytes) -> None:
    """Feed the headers that stand beside a log in counts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_bytes(_betaflight())
        path.with_name("log.headers.csv").write_bytes(data)
        _read(path)


def _zips() -> list[bytes]:
    exports = (log_files.phyphox_files(DATA), log_files.sensor_logger_files(data=DATA))
    return [
        _made(functools.partial(lambda files, folder: log_files.as_zip(folder, files), e))[0] for e in exports
    ]


_PHYPHOX = log_files.phyphox_files(DATA)
_SENSOR_LOGGER = log_files.sensor_logger_files(data=DATA)

TARGETS = {
    "rests": Target(lambda: [b"ax,ay,az,t\n0,0,9.8,1\n9.8,0,0,2\n"], _rest_table),
    "events": Target(
        lambda: [b'{"t": 0.1, "event": "charging", "on": true}\n'],
        functools.partial(_beside_trace, "trace.events.jsonl"),
    ),
    "claims": Target(
        lambda: [b'{"device": "x", "nominal_rate_hz": 100, "gravity": 9.81}'],
        functools.partial(_beside_trace, "trace.json"),
    ),
    "text-formats": any_of(
        [
            Target(
                functools.partial(lambda make: [make().encode()], make),
                functools.partial(_feed, "trace.csv", name),
            )
            for name, make in TEXTS.items()
        ]
    ),
    "recognised": Target(
        lambda: [make().encode() for make in (*TEXTS.values(), _rows_of_sensors)],
        functools.partial(_feed, "log", None),
    ),
    "json": Target(_json, functools.partial(_feed, "log.json", None)),
    "gnss-logger": Target(
        lambda: _made(lambda folder: log_files.gnss_logger(folder, DATA)),
        functools.partial(_feed, "log.txt", None),
    ),
    "betaflight": any_of(
        [
            Target(
                lambda: [_betaflight(" (g)", " (deg/s)"), _betaflight(head=_EXPLORER)],
                functools.partial(_feed, "log.csv", None),
            ),
            Target(lambda: [_HEADERS], _feed_headers),
        ]
    ),
    "ulog": Target(lambda: [log_files.ulog(DATA)], functools.partial(_feed, "log.ulg", None)),
    "dataflash": Target(lambda: [log_files.dataflash(data=DATA)], functools.partial(_feed, "log.bin", None)),
    "axivity": Target(lambda: [log_files.axivity(DATA)], _feed_axivity),
    "ros1": Target(
        lambda: _made(lambda folder: log_files.ros1_bag(folder, DATA)),
        functools.partial(_feed, "walk.bag", None),
    ),
    "ros2": Target(lambda: [_ros2_bag()[1]], functools.partial(_feed, "walk.db3", None)),
    "ros2-folder": Target(lambda: [_ros2_bag()[2]], _feed_ros2_folder),
    "mcap": Target(_mcap, functools.partial(_feed, "walk.mcap", None)),
    "parquet": Target(
        lambda: _made(lambda folder: log_files.parquet_file(folder, DATA)),
        functools.partial(_feed, "w.parquet", None),
    ),
    "hdf5": Target(
        lambda: _made(lambda folder: log_files.hdf5(folder, DATA)), functools.partial(_feed, "w.h5", None)
    ),
    "matlab": Target(
        lambda: _made(lambda folder: log_files.mat(folder, DATA)), functools.partial(_feed, "w.mat", None)
    ),
    "npz": Target(_npz, _feed_npz),
    "zip": Target(_zips, functools.partial(_feed, "export.zip", None)),
    "export-member": any_of(
        [
            Target(
                functools.partial(lambda files, member: [files[member].encode()], files, member),
                functools.partial(_feed_member, files, member),
            )
            for files, member in (
                (_PHYPHOX, "meta/device.csv"),
                (_SENSOR_LOGGER, "GyroscopeUncalibrated.csv"),
            )
        ]
    ),
}
