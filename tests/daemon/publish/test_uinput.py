"""The "Motion Sensors" input device: against the kernel's own headers, and as bytes that a reader decodes.

Where the machine has /dev/uinput, a real device is made and read; elsewhere that test is skipped.
"""

from __future__ import annotations

import fcntl
import os
import re
import select
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.cli.entry import main
from stillcal.daemon.publish import uinput
from stillcal.daemon.publish.uinput import MotionSensors
from stillcal.daemon.service.live_stream import Interruption, LiveBlock
from tests.support.forked import Forked

HEADER = Path("/usr/include/linux/uinput.h")
EVENT = struct.Struct("@llHHi")
"""struct input_event of <linux/input.h>, on a system whose time_t is a long."""

QUESTION = """
#include <stddef.h>
#include <stdio.h>
#include <linux/uinput.h>
#define N(x) printf(#x " %lu\\n", (unsigned long)(x));
int main(void) {
    N(sizeof(struct uinput_setup)) N(sizeof(struct uinput_abs_setup)) N(sizeof(struct input_event))
    N(offsetof(struct uinput_setup, name)) N(offsetof(struct uinput_abs_setup, absinfo.minimum))
    N(offsetof(struct uinput_abs_setup, absinfo.resolution)) N(offsetof(struct input_event, type))
    N(UI_DEV_CREATE) N(UI_DEV_SETUP) N(UI_ABS_SETUP)
    N(UI_SET_EVBIT) N(UI_SET_ABSBIT) N(UI_SET_MSCBIT) N(UI_SET_PROPBIT)
    N(EV_SYN) N(EV_ABS) N(EV_MSC) N(SYN_REPORT) N(MSC_TIMESTAMP) N(INPUT_PROP_ACCELEROMETER) N(BUS_VIRTUAL)
    N(ABS_X) N(ABS_Y) N(ABS_Z) N(ABS_RX) N(ABS_RY) N(ABS_RZ)
    return 0;
}
"""


def test_structures_and_numbers_are_those_of_the_kernels_headers(tmp_path: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None or not HEADER.exists():
        pytest.skip("needs a C compiler and the kernel's headers (linux/uinput.h)")
    (tmp_path / "q.c").write_text(QUESTION)
    subprocess.run([compiler, "-o", str(tmp_path / "q"), str(tmp_path / "q.c")], check=True)
    said = subprocess.run([str(tmp_path / "q")], check=True, capture_output=True, text=True).stdout
    kernel = {name: int(value) for name, value in re.findall(r"^(.*) (\d+)$", said, re.MULTILINE)}
    assert kernel.pop("sizeof(struct uinput_setup)") == uinput.SETUP.size
    assert kernel.pop("sizeof(struct uinput_abs_setup)") == uinput.ABS_SETUP.size
    assert kernel.pop("sizeof(struct input_event)") == uinput.EVENT.itemsize == EVENT.size
    assert kernel.pop("offsetof(struct input_event, type)") == uinput.EVENT.fields["type"][1]
    assert kernel.pop("offsetof(struct uinput_setup, name)") == struct.calcsize("=HHHH")
    assert kernel.pop("offsetof(struct uinput_abs_setup, absinfo.minimum)") == struct.calcsize("=Hxxi")
    assert kernel.pop("offsetof(struct uinput_abs_setup, absinfo.resolution)") == struct.calcsize("=Hxx5i")
    axes = [kernel.pop(f"ABS_{name}") for name in ("X", "Y", "Z", "RX", "RY", "RZ")]
    assert tuple(axes) == uinput.AXES
    assert kernel == {name: getattr(uinput, name) for name in kernel} and len(kernel) == 14


class Kernel:
    """A pipe in place of /dev/uinput, and a list of what was asked of it."""

    def __init__(self, folder: Path) -> None:
        self.path = str(folder / "uinput")
        os.mkfifo(self.path)
        self._end = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        self.asked: list[tuple[int, Any]] = []

    def ioctl(self, fd: int, request: int, argument: Any) -> None:
        self.asked.append((request, argument))

    def reports(self) -> list[dict[tuple[int, int], int]]:
        """Return what was written, as evdev clients see it: one dictionary up to each SYN_REPORT."""
        found, report = [], {}
        data = os.read(self._end, 1 << 16) if select.select([self._end], [], [], 0)[0] else b""
        for _, _, kind, code, value in EVENT.iter_unpack(data):
            if (kind, code) == (0, 0):
                found.append(report)
                report = {}
            else:
                report[kind, code] = value
        assert not report
        return found


def block(sensor: Sensor, t: list[float], xyz: list[list[float]]) -> LiveBlock:
    return LiveBlock(Samples(sensor, frozen(t), frozen(xyz)), None, 0.0)


def test_the_device_is_described_as_motion_sensors(tmp_path: Path) -> None:
    kernel = Kernel(tmp_path)
    sensors = MotionSensors(kernel.path, kernel.ioctl)
    sensors.open()
    requests = [request for request, _ in kernel.asked]
    assert requests[-2:] == [uinput.UI_DEV_SETUP, uinput.UI_DEV_CREATE]
    assert (uinput.UI_SET_PROPBIT, 0x06) in kernel.asked and (uinput.UI_SET_MSCBIT, 0x05) in kernel.asked
    axes = [uinput.ABS_SETUP.unpack(a) for request, a in kernel.asked if request == uinput.UI_ABS_SETUP]
    assert [(code, resolution) for code, *_, resolution in axes] == [
        *((code, 8192) for code in (0, 1, 2)),
        *((code, 1024) for code in (3, 4, 5)),
    ]
    assert all(-low == high > 0 == fuzz for _, _, low, high, fuzz, _, _ in axes)
    name = uinput.SETUP.unpack(kernel.asked[-2][1])[4].rstrip(b"\0")
    assert name == b"stillcal Motion Sensors"
    sensors.close()


def test_a_phone_that_lies_flat_and_turns_reads_one_g_and_its_rate(tmp_path: Path) -> None:
    """A controller's y is the phone's z; the force is taken at the time of each gyroscope sample."""
    kernel = Kernel(tmp_path)
    sensors = MotionSensors(kernel.path, kernel.ioctl)
    sensors.open()
    force = [[0.0, 0.0, 9.80665], [9.80665, 0.0, 9.80665]]
    rate = [[0.0, 0.0, np.radians(90.0)], [np.radians(-1.5), np.radians(2.0), 0.0], [100.0, 0.0, 0.0]]
    sensors.take([block(Sensor.ACCELEROMETER, [1.0, 2.0], force)])
    assert kernel.reports() == []
    sensors.take([block(Sensor.GYROSCOPE, [1.0, 1.5, 4400.0], rate)])
    one, two, late = kernel.reports()
    assert [one[3, axis] for axis in range(6)] == [0, 8192, 0, 0, 90 * 1024, 0]
    assert [two[3, axis] for axis in range(6)] == [4096, 8192, 0, -1536, 0, -2048]
    assert (late[3, 0], late[3, 3]) == (8192, 2048 * 1024), "held, and cut at the range"
    stamps = [report[4, 5] & 0xFFFFFFFF for report in (one, two, late)]
    assert stamps == [1_000_000, 1_500_000, 4_400_000_000 - (1 << 32)]
    sensors.close()


def test_without_a_gyroscope_the_force_is_reported_alone(tmp_path: Path) -> None:
    kernel = Kernel(tmp_path)
    sensors = MotionSensors(kernel.path, kernel.ioctl)
    sensors.open()
    for i in range(6):
        sensors.take([block(Sensor.ACCELEROMETER, [float(i)], [[0.0, -9.80665, 0.0]])])
    reports = kernel.reports()
    assert len(reports) == 3 and all(report[3, 2] == 8192 and (3, 3) not in report for report in reports)
    sensors.take([Interruption("lost"), block(Sensor.GYROSCOPE, [9.0], [[0.0, 0.0, 0.0]])])
    assert kernel.reports() == [], "no force is known after an interruption"
    sensors.close()


def test_without_uinput_one_line_says_so(tmp_path: Path) -> None:
    if os.access(uinput.DEVICE, os.W_OK):
        pytest.skip("this machine has uinput")
    words = [
        "run",
        "--port",
        tmp_path / "tty",
        "--store",
        tmp_path / "s.json",
        "--socket",
        tmp_path / "socket",
    ]
    with Forked([*words, "--publish", "uinput"], main) as daemon:
        _, said = daemon.said()
    assert daemon.returncode == 2 and "/dev/uinput" in said and "module uinput" in said
    assert said.count("\n") == 1


def test_the_kernel_makes_the_device_and_hands_on_its_events() -> None:
    if not os.access(uinput.DEVICE, os.W_OK):
        pytest.skip("this machine has no /dev/uinput that may be written")
    sensors = MotionSensors()
    sensors.open()
    assert sensors._fd is not None
    name = bytearray(64)
    fcntl.ioctl(sensors._fd, 2 << 30 | len(name) << 16 | ord("U") << 8 | 44, name)  # UI_GET_SYSNAME
    folder = Path("/sys/devices/virtual/input") / name.rstrip(b"\0").decode()
    assert (folder / "name").read_text().strip() == "stillcal Motion Sensors"
    assert int((folder / "properties").read_text(), 16) == 1 << uinput.INPUT_PROP_ACCELEROMETER
    sensors.close()
