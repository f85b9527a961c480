"""Small recordings in every format that is read, written as its own library or specification does."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import scipy.io
from pyarrow import parquet
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

RNG = np.random.default_rng(3)
IMU = "sensor_msgs/msg/Imu"
IMU_FIELDS = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"
LETTERS = str.maketrans({"n": "4s", "N": "16s", "Z": "64s", "b": "b", "B": "B"})  # others are struct's own


def rows(n: int = 400, rate: float = 100.0) -> np.ndarray:
    """Return t, force and rate of a phone that is turned about its x axis, (n, 7) SI."""
    t = np.arange(n) / rate
    angle = 1.2 * np.sin(2 * np.pi * 0.3 * t)
    omega = 1.2 * 2 * np.pi * 0.3 * np.cos(2 * np.pi * 0.3 * t)
    force = 9.81 * np.column_stack([np.zeros(n), np.sin(angle), np.cos(angle)])
    rate_xyz = np.column_stack([omega, np.zeros(n), np.zeros(n)])
    return np.column_stack([t, force + RNG.normal(0, 0.02, (n, 3)), rate_xyz + RNG.normal(0, 1e-3, (n, 3))])


def text(header: str, table: np.ndarray, mark: str = ",") -> str:
    return "\n".join([header, *(mark.join(map(repr, row)) for row in table.tolist())]) + "\n"


DATA = rows(600)


def sensor_logger_files(
    bias: tuple[float, float, float] = (0.01, -0.02, 0.03),
    data: np.ndarray = DATA[:400],
    force_bias: float = 0.1,
) -> dict[str, str]:
    ns = np.round(1.7e18 + data[:, :1] * 1e9)
    files = {}
    for name, xyz in (
        ("TotalAcceleration", data[:, 1:4]),
        ("AccelerometerUncalibrated", data[:, 1:4] + force_bias),
        ("Gyroscope", data[:, 4:]),
        ("GyroscopeUncalibrated", data[:, 4:] + bias),
        ("Accelerometer", data[:, 1:4] * 0.01),
    ):
        table = np.column_stack([ns, data[:, 0], xyz[:, ::-1]])
        files[f"{name}.csv"] = text("time,seconds_elapsed,z,y,x", table)
    files["Metadata.csv"] = "version,device name\n3,phone\n"
    return files


def phyphox_files(data: np.ndarray = DATA[:400]) -> dict[str, str]:
    acceleration = ",".join(["Time (s)", *(f"Acceleration {a} (m/s^2)" for a in "xyz")])
    gyroscope = ",".join(["Time (s)", *(f"Gyroscope {a} (rad/s)" for a in "xyz")])
    device = '"property","value"\n"deviceModel","Pixel 9a"\n"accelerometer Range","78.4532"\n'
    return {
        "Accelerometer.csv": text(acceleration, data[:, :4]),
        "Gyroscope.csv": text(gyroscope, data[:, [0, 4, 5, 6]]),
        "meta/device.csv": device + '"accelerometer Resolution","0.0011901855"\n"gyroscope Range","null"\n',
        "meta/time.csv": '"event","experiment time"\n"START",0.0\n',
    }


def phyphox_ios_files(data: np.ndarray = DATA[:400]) -> dict[str, str]:
    """Return what phyphox on iOS exports of an experiment of the user's own, with semicolons."""

    def table(unit: str, xyz: np.ndarray) -> str:
        header = ";".join(['"Time (s)"', *(f'"{a} ({unit})"' for a in "XYZ")])
        return text(header, np.column_stack([data[:, 0], xyz]), ";")

    return {
        "Accelerometer.csv": table("m/s^2", data[:, 1:4]),
        "Gyroscope.csv": table("rad/s", data[:, 4:]),
        "Linear Accelerometer.csv": table("m/s^2", data[:, 1:4] - [0.0, 0.0, 9.81]),
        "meta/device.csv": '"property";"value"\n"deviceModel";"iPhone13,4"\n"depthFrontSensor";"1"\n',
        "meta/time.csv": '"event";"experiment time"\n"START";0.0\n',
    }


def as_folder(folder: Path, files: dict[str, str]) -> Path:
    for name, content in files.items():
        path = folder / "export" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return folder / "export"


def as_zip(folder: Path, files: dict[str, str]) -> Path:
    with zipfile.ZipFile(folder / "export.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(f"2026-03-01 walk/{name}", content)
        archive.writestr("__MACOSX/._Accelerometer.csv", b"\0\0")
    return folder / "export.zip"


def gnss_logger(folder: Path, data: np.ndarray = DATA[:400]) -> Path:
    header = "utcTimeMillis,elapsedRealtimeNanos,UncalAccelXMps2,UncalAccelYMps2,UncalAccelZMps2,BiasXMps2"
    lines = ["# ", "# Header Description:", f"# UncalAccel,{header}", "Raw,1,2,3", "Fix,GPS,52.2"]
    for row in data.tolist():
        stamp = f"1700000000000,{round(row[0] * 1e9)}"
        lines.append(f"UncalAccel,{stamp},{row[1]},{row[2]},{row[3]},0.1,0.2,0.3")
        lines.append(f"UncalGyro,{stamp},{row[4]},{row[5]},{row[6]},0.01,-0.02,0.03")
        lines.append(f"Accel,{stamp},{row[1]},{row[2]},{row[3]}")
    (folder / "gnss_log.txt").write_text("\n".join(lines) + "\nUncalAccel,17000")
    return folder / "gnss_log.txt"


def imu_message(store, row: np.ndarray, *, force: bool = True, rate: bool = True, stamped: bool = True):
    """Return a sensor_msgs/Imu as the library defines it; without a quantity as Imu.msg says."""
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]
    ns = round((1000 + row[0]) * 1e9) if stamped else 0
    stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    more = {"seq": 0} if "seq" in types["std_msgs/msg/Header"].__dataclass_fields__ else {}
    absent = np.array([-1.0] + [0.0] * 8)
    return types[IMU](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="imu_link", **more),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=absent,
        angular_velocity=vector(*(row[4:] if rate else np.zeros(3)).tolist()),
        angular_velocity_covariance=np.zeros(9) if rate else absent,
        linear_acceleration=vector(*(row[1:4] if force else np.zeros(3)).tolist()),
        linear_acceleration_covariance=np.zeros(9) if force else absent,
    )


def ros1_bag(
    folder: Path, data: np.ndarray = DATA, topics: dict[str, int] | None = None, **what: bool
) -> Path:
    """topics: of how many rows each topic has one, by name."""
    store = get_typestore(Stores.ROS1_NOETIC)
    path = folder / "walk.bag"
    with Writer1(path) as writer:
        for name, every in (topics or {"/imu/data": 1}).items():
            topic = writer.add_connection(name, IMU, typestore=store)
            for row in data[::every]:
                message = store.serialize_ros1(imu_message(store, row, **what), IMU)
                writer.write(topic, round((2000 + row[0]) * 1e9), message)
    return path


def ros2_bag(
    folder: Path,
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    split: bool = False,
    data: np.ndarray = DATA,
    rate_later_s: float = 0.0,
    compressed: bool = False,
) -> Path:
    """rate_later_s: by how much the stamps of the rates' own topic are later; compressed: each message."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    path = folder / "walk"
    writer = Writer2(path, version=9, storage_plugin=storage)
    if compressed:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        names = ["/camera/accel/sample", "/camera/gyro/sample"] if split else ["/imu"]
        topics = [writer.add_connection(name, IMU, typestore=store) for name in names]
        for row in data:
            for i, topic in enumerate(topics):
                which = {"force": i == 0, "rate": i == 1} if split else {}
                stamped = row + np.eye(len(row))[0] * rate_later_s * i
                message = store.serialize_cdr(imu_message(store, stamped, **which), IMU)
                writer.write(topic, round((1000 + row[0]) * 1e9) + 500, message)
    return path


def ros2_file(folder: Path) -> Path:
    """Return a ROS 2 bag's own file, SQLite."""
    return next(ros2_bag(folder).glob("*.db3"))


def mcap_file(folder: Path, data: np.ndarray = DATA) -> Path:
    return next(ros2_bag(folder, StoragePlugin.MCAP, data=data).glob("*.mcap"))


def bag_of_texts(folder: Path, storage: StoragePlugin | None) -> Path:
    """Return a bag that holds no readings; ROS 1 without a kind of storage."""
    kind = "std_msgs/msg/String"
    if storage is None:
        store, path = get_typestore(Stores.ROS1_NOETIC), folder / "chat.bag"
        with Writer1(path) as one:
            topic1 = one.add_connection("/chatter", kind, typestore=store)
            one.write(topic1, 10**9, store.serialize_ros1(store.types[kind](data="hello"), kind))
        return path
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(folder / "chat", version=9, storage_plugin=storage) as two:
        topic2 = two.add_connection("/chatter", kind, typestore=store)
        two.write(topic2, 10**9, store.serialize_cdr(store.types[kind](data="hello"), kind))
    return folder / "chat"


def dataflash(imu: str = "IMU", instances: int = 2, data: np.ndarray = DATA) -> bytes:
    """Return a log as ArduPilot's libraries/AP_Logger/LogStructure.h lays it out."""

    def fmt(kind: int, name: str, letters: str, columns: str) -> bytes:
        length = 3 + struct.calcsize("<" + letters.translate(LETTERS))
        texts = (name.encode(), letters.encode(), columns.encode())
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, length, *texts)

    out = [fmt(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    out.append(fmt(64, "PARM", "QNff", "TimeUS,Name,Value,Default"))
    out.append(fmt(130, imu, "QBffffffIIfBBHH", IMU_FIELDS))
    for name, value in (("INS_ACCOFFS_X", 0.25), ("INS_TCAL1_ENABLE", 1.0)):
        out.append(b"\xa3\x95\x40" + struct.pack("<Q16sff", 10, name.encode(), value, 0.0))
    for row in data:
        for instance in range(instances):
            values = [*(row[4:] + instance), *row[1:4], 0, 0, 31.5, 1, 1, 1000, 1000]
            out.append(
                b"\xa3\x95\x82" + struct.pack("<QBffffffIIfBBHH", round(row[0] * 1e6), instance, *values)
            )
    return b"".join(out)


def npz(folder: Path, data: np.ndarray = DATA) -> Path:
    np.savez_compressed(folder / "walk.npz", **arrays(data))
    return folder / "walk.npz"


def mat(folder: Path, data: np.ndarray = DATA) -> Path:
    scipy.io.savemat(folder / "walk.mat", {"imu": arrays(data), "fs": 100.0})
    return folder / "walk.mat"


def hdf5(folder: Path, data: np.ndarray = DATA) -> Path:
    with h5py.File(folder / "walk.h5", "w") as file:
        for name, values in arrays(data).items():
            file[f"left/{name}"] = values.T  # as MATLAB 7.3 stores them
            file[f"right/{name}"] = values
    return folder / "walk.h5"


def parquet_file(folder: Path, data: np.ndarray = DATA) -> Path:
    names = ["time", "ax", "ay", "az", "gx", "gy", "gz"]
    columns = {name: data[:, i] for i, name in enumerate(names)}
    parquet.write_table(
        pa.table({"label": ["w"] * len(data)} | columns), folder / "w.parquet", row_group_size=70
    )
    return folder / "w.parquet"


def dataflash_file(folder: Path, data: np.ndarray = DATA) -> Path:
    (folder / "log.bin").write_bytes(dataflash(instances=1, data=data))
    return folder / "log.bin"


def arrays(data: np.ndarray = DATA) -> dict[str, np.ndarray]:
    return {"time": data[:, 0], "acc": data[:, 1:4], "gyr": data[:, 4:]}


def ulog(data: np.ndarray = DATA) -> bytes:
    """Return a PX4 log (docs.px4.io, "ULog File Format") of two topics of raw values, and a parameter."""
    fields = "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;"

    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<H", len(content)) + kind + content

    out = [b"ULog\x01\x12\x35\x01" + bytes(8), message(b"B", bytes(40))]
    for i, (topic, more) in enumerate((("sensor_accel", "float temperature;"), ("sensor_gyro", ""))):
        out.insert(2, message(b"F", f"{topic}:{fields}{more}".encode()))
        out.append(message(b"A", struct.pack("<BH", 0, i) + topic.encode()))
    key = b"float CAL_ACC0_XOFF"
    out.insert(4, message(b"P", bytes([len(key)]) + key + struct.pack("<f", 0.25)))
    for row in data.tolist():
        us = round(row[0] * 1e6)
        out.append(message(b"D", struct.pack("<HQQI4f", 0, us + 30, us, 1, *row[1:4], 31.5)))
        out.append(message(b"D", struct.pack("<HQQI3f", 1, us + 40, us, 2, *row[4:])))
    return b"".join(out)


def ulog_fifo(data: np.ndarray = DATA) -> bytes:
    """Return a PX4 log of a chip's buffers: 8 samples a message at most, in counts of 1/2048 and 1/1024."""
    ints = "".join(f"int16_t[32] {axis};" for axis in "xyz")
    fields = "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float dt;float scale;"
    fields += f"{ints}uint8_t samples;"

    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<H", len(content)) + kind + content

    topics = (("sensor_accel_fifo", 2048, 1), ("sensor_gyro_fifo", 1024, 4))
    out = [b"ULog\x01\x12\x35\x01" + bytes(8), message(b"B", bytes(40))]
    out += [message(b"F", f"{topic}:{fields}".encode()) for topic, *_ in topics]
    out += [message(b"A", struct.pack("<BH", 0, i) + topic.encode()) for i, (topic, *_) in enumerate(topics)]
    for first in range(0, len(data), 8):
        rows = data[first : first + 8]
        us = round(rows[-1, 0] * 1e6)
        for i, (_, per_unit, column) in enumerate(topics):
            counts = np.zeros((3, 32), dtype="<i2")
            counts[:, : len(rows)] = np.round(rows[:, column : column + 3].T * per_unit)
            head = struct.pack("<HQQIff", i, us + 30, us, 1, 1e4, 1 / per_unit)
            out.append(message(b"D", head + counts.tobytes() + struct.pack("<B", len(rows))))
    return b"".join(out)


CWA_BLOCK, CWA_HEADER = 512, 1024


def axivity(data: np.ndarray = DATA) -> bytes:
    """Return a recording of an AX6 (openmovement, Docs/ax3/cwa.h): 100 Hz, 2048 counts a g, 500 deg/s."""
    blocks = [b"MD" + struct.pack("<H", CWA_HEADER - 4) + b"\xff" * (CWA_HEADER - 4)]
    counts = np.column_stack([np.rad2deg(data[:, 4:]) * 32768 / 500, data[:, 1:4] / 9.80665 * 2048])
    for number in range(len(data) // 40):
        t = data[number * 40, 0]
        part = round((t % 1) * 32768)
        date = (26 << 26) | (3 << 22) | (1 << 17) | int(t)
        head = struct.pack("<HIII", 0x8000 | part, 7, number, date)
        head += struct.pack(
            "<HHBBBBhH", (3 << 13) | (4 << 10), 256, 0, 0, 0x4A, 0x62, -int(part * 100 / 32768), 40
        )
        block = b"AX" + struct.pack("<H", CWA_BLOCK - 4) + head
        block += np.round(counts[number * 40 : number * 40 + 40]).astype("<i2").tobytes()
        blocks.append(cwa_summed(block + b"\0\0"))
    return b"".join(blocks)


def cwa_summed(block: bytes) -> bytes:
    """Return a block with the check sum that makes its 16-bit words add up to nothing."""
    words = np.frombuffer(block[:-2], "<u2")
    return block[:-2] + struct.pack("<H", int(-words.sum(dtype=np.int64)) & 0xFFFF)
