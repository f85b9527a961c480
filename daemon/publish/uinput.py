"""Corrected samples as an input device, such as game controllers have: a "Motion Sensors" node of evdev.

The kernel's rules (include/uapi/linux/input.h, uinput.h, Documentation/input/event-codes.rst):
INPUT_PROP_ACCELEROMETER says that ABS_X, ABS_Y, ABS_Z are acceleration, their resolution in units per g, and
ABS_RX, ABS_RY, ABS_RZ rates of rotation, in units per deg/s. MSC_TIMESTAMP counts microseconds in 32 bits and
wraps. Resolutions are those of drivers/hid/hid-playstation.c; fuzz is 0, so that the kernel smooths nothing.

The axes are a controller's as SDL has them (SDL_sensor.h), x to the right, y up out of the face, z towards
the player, when the device lies flat with its screen up: x, z, -y of the phone's axes. At rest there, y is
+1 g.

The numbers of the ioctls are those of x86, ARM and RISC-V (include/uapi/asm-generic/ioctl.h).
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.service.live_stream import Interruption, Live, LiveBlock
from stillcal.daemon.settings import SettingsError
from stillcal.daemon.system.files import passing

DEVICE = "/dev/uinput"
NAME = b"stillcal Motion Sensors"

EV_SYN, EV_ABS, EV_MSC = 0x00, 0x03, 0x04
SYN_REPORT, MSC_TIMESTAMP, INPUT_PROP_ACCELEROMETER = 0x00, 0x05, 0x06
AXES = (0, 1, 2, 3, 4, 5)
"""ABS_X, ABS_Y, ABS_Z, ABS_RX, ABS_RY, ABS_RZ."""

BUS_VIRTUAL = 0x06

PER_G, PER_DEG_S = 8192, 1024
RANGE = (16 * PER_G,) * 3 + (2048 * PER_DEG_S,) * 3
"""Largest value of each axis: 16 g and 2048 deg/s; beyond it a value is cut."""

SETUP = struct.Struct("=HHHH80sI")
"""struct uinput_setup: bus, vendor, product, version, name, number of force feedback effects."""

ABS_SETUP = struct.Struct("=Hxx6i")
"""struct uinput_abs_setup: code, then value, minimum, maximum, fuzz, flat, resolution."""

EVENT = np.dtype(
    [("sec", np.dtype("l")), ("usec", np.dtype("l")), ("type", "u2"), ("code", "u2"), ("value", "i4")]
)
"""struct input_event; the kernel sets the time itself."""


def _iow(number: int, size: int) -> int:
    return 1 << 30 | size << 16 | ord("U") << 8 | number


UI_DEV_CREATE = ord("U") << 8 | 1
UI_DEV_SETUP, UI_ABS_SETUP = _iow(3, SETUP.size), _iow(4, ABS_SETUP.size)
UI_SET_EVBIT, UI_SET_ABSBIT, UI_SET_MSCBIT, UI_SET_PROPBIT = (_iow(n, 4) for n in (100, 103, 104, 110))

Ioctl = Callable[[int, int, Any], Any]


class MotionSensors:
    """The input device. path, ioctl: of the kernel's, unless a test takes their place."""

    name = "uinput"
    patience_s = 0.005

    def __init__(self, path: str = DEVICE, ioctl: Ioctl | None = None) -> None:
        self._path, self._given = path, ioctl
        self._fd: int | None = None
        self._force = Samples.empty(Sensor.ACCELEROMETER)
        self._alone = 0

    def open(self) -> None:
        """Make the device. Raises OSError; SettingsError where the kernel has no uinput, or forbids it."""
        try:
            self._fd = os.open(self._path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            describe(self._fd, self._given or _ioctl())
        except OSError as error:
            self.close()
            if passing(error):
                raise
            remedy = "load the module uinput, and let the daemon's user write to it (docs/live.md)"
            raise SettingsError(f"--publish uinput: {self._path}: {error.strerror}: {remedy}") from error

    def take(self, items: Sequence[Live]) -> None:
        """Send samples as events. Raises OSError, and SettingsError as `open` does."""
        if self._fd is None:
            self.open()
        for item in items:
            if isinstance(item, Interruption):
                self._force, self._alone = Samples.empty(Sensor.ACCELEROMETER), 0
            elif (events := self._events(item)) is not None:
                assert self._fd is not None
                os.write(self._fd, events.tobytes())

    def close(self) -> None:
        """Remove the device, which the kernel does when its file is closed."""
        fd, self._fd = self._fd, None
        if fd is not None:
            os.close(fd)

    def _events(self, block: LiveBlock) -> Array | None:
        """Return a report for each gyroscope sample, with the force at its time; without gyroscope, of force.

        A gyroscope is missing where three blocks of the accelerometer came with none of it between.
        """
        samples = block.samples
        if samples.sensor is Sensor.ACCELEROMETER:
            bare = Samples(samples.sensor, samples.t, samples.xyz)
            self._force = Samples.joined([self._force[-1:], bare])
            self._alone += 1
            return reports(samples.t, samples.xyz, None) if self._alone > 3 else None
        self._alone = 0
        if not len(self._force):
            return None
        force = np.column_stack([np.interp(samples.t, self._force.t, axis) for axis in self._force.xyz.T])
        return reports(samples.t, force, samples.xyz)


def describe(fd: int, ioctl: Ioctl) -> None:
    """Tell the kernel what the device has, and make it. Raises OSError."""
    for event in (EV_ABS, EV_MSC):
        ioctl(fd, UI_SET_EVBIT, event)
    ioctl(fd, UI_SET_MSCBIT, MSC_TIMESTAMP)
    ioctl(fd, UI_SET_PROPBIT, INPUT_PROP_ACCELEROMETER)
    for axis in AXES:
        ioctl(fd, UI_SET_ABSBIT, axis)
        resolution = PER_G if axis < 3 else PER_DEG_S
        ioctl(fd, UI_ABS_SETUP, ABS_SETUP.pack(axis, 0, -RANGE[axis], RANGE[axis], 0, 0, resolution))
    ioctl(fd, UI_DEV_SETUP, SETUP.pack(BUS_VIRTUAL, 0, 0, 1, NAME, 0))
    ioctl(fd, UI_DEV_CREATE, 0)


def reports(t: Array, force: Array, rate: Array | None) -> Array:
    """Return the events of reports at times t (n,), s, one report a row. force, rate: (n, 3) m/s^2, rad/s."""
    values = [_turned(force) * (PER_G / STANDARD)]
    if rate is not None:
        values.append(_turned(np.degrees(rate)) * PER_DEG_S)
    axes = np.column_stack(values)
    n_axes = axes.shape[1]
    limit = np.array(RANGE[:n_axes])
    events = np.zeros((len(t), n_axes + 2), dtype=EVENT)
    events["type"], events["code"] = EV_ABS, [*AXES[:n_axes], MSC_TIMESTAMP, SYN_REPORT]
    events["value"][:, :n_axes] = np.rint(np.clip(axes, -limit, limit))
    events["type"][:, -2], events["type"][:, -1] = EV_MSC, EV_SYN
    microseconds = np.rint(t * 1e6).astype(np.int64) & 0xFFFFFFFF
    events["value"][:, -2] = microseconds.astype(np.uint32).view(np.int32)
    return events


def _turned(xyz: Array) -> Array:
    """Return vectors of the phone's axes in a controller's."""
    return np.column_stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]])


def _ioctl() -> Ioctl:
    from fcntl import ioctl  # noqa: PLC0415 - only Linux has it

    return ioctl
