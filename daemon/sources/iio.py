"""The sensors of the machine itself: a Linux phone's accelerometer and gyroscope, polled through sysfs.

To the daemon it is a phone like any other: it identifies itself, sends samples with time stamps, and
sleeps and wakes on command. Everything runs in callbacks of one asyncio loop. sysfs.py says what the files
mean. A stamp is CLOCK_BOOTTIME halfway through a reading, which goes on while the machine is suspended. A
reboot is a new session.
"""

from __future__ import annotations

import asyncio
import math
import zlib
from dataclasses import replace
from pathlib import Path

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams.events import Temperature, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.sources import sysfs
from stillcal.daemon.sources.base import SerialSettings, Source
from stillcal.daemon.sources.sysfs import SensorGoneError, Sensors
from stillcal.daemon.system.clock import BOOT_ID, Clock, host_time
from stillcal.daemon.wire.messages import Claim, Command, Hello, Identify, Rate, Status
from stillcal.daemon.wire.reassembly import WireCounters

MAX_RATE_HZ = 50.0
"""Sampling rate unless [source] rate_hz sets one: each axis costs a system call and a bus transfer."""

BATCH_S = 0.1
"""How long samples gather before they are handed on, s, unless somebody listens who wants them sooner."""

SLEPT_S = 2.0
"""After a pause longer than this, s, the chip may have slept and lost its registers."""

STATUS_S = 10.0
"""Time between two readings of the thermometer and two status records, s."""

THERMOMETER_S = 60.0
"""The same for the thermometer while the sensors sleep, s."""


class IioSource(Source):
    """The machine's own sensors, looked for again when they are lost. settings.port: folder of devices."""

    def __init__(self, settings: SerialSettings, clock: Clock = host_time) -> None:
        super().__init__(settings)
        self._clock = clock
        self._rate_hz, self._batch_s = 0.0, BATCH_S
        self._counters = WireCounters()
        self._sensors: Sensors | None = None
        self._gathered: dict[Sensor, tuple[list[float], list[Array]]] = {}
        self._sensing, self._on_time, self._wakeups, self._woken = False, 0.0, 0, False
        self._last = self._next_status = 0.0
        self.celsius: float | None = None

    # For the one who takes

    @property
    def connected(self) -> bool:
        """Whether the sensors are available now."""
        return self._sensors is not None

    @property
    def device(self) -> str:
        """Path of the accelerometer's device, "" where none is."""
        return "" if self._sensors is None else str(self._sensors.accelerometer.folder)

    @property
    def wire(self) -> WireCounters:
        """A copy of the counters; there is no wire, so only samples are counted."""
        return replace(self._counters)

    def send(self, command: Command) -> bool:
        """Carry out a command as a phone would; return False while there are no sensors."""
        if self._sensors is None:
            return False
        self.link.commands_sent += 1
        if isinstance(command, Sense):
            self._wake()
        elif isinstance(command, Sleep):
            self._sleep(command.until)
        elif isinstance(command, Rate):
            self._rate_hz = command.hz
            sysfs.set_rate(self._sensors, command.hz)
        elif isinstance(command, Identify):
            self._greet(self._sensors)
        return True

    async def let_gather(self, seconds: float) -> None:
        """Let records gather for this long, s; samples are handed on as often."""
        self._batch_s = min(seconds, BATCH_S)
        await super().let_gather(seconds)

    def correct_chip(self, sensor: Sensor, bias: Array, scale: Array, memory: Path) -> bool:
        """Have the chip correct a sensor itself; return whether that was written.

        bias: (3,), scale: (3, 3), SI, the phone's axes. memory: where the values of before are kept. What is
        sent stays uncorrected, because it is taken off again (sysfs.Channel). Raises ChipError and OSError.
        """
        for channel in () if self._sensors is None else self._sensors.channels():
            if channel.sensor is sensor and channel.correct_chip(bias, scale, memory):
                assert self._sensors is not None
                self._read_chip(self._sensors)
                return True
        return False

    def _read_chip(self, sensors: Sensors) -> Sensors:
        """Look what the chips correct by themselves, after a write or where they may have been reset."""
        self._sensors = sensors.read_again()
        return self._sensors

    # Finding and losing the sensors

    def _connect(self) -> None:
        self._timer = None
        try:
            self._sensors = sysfs.find(Path(self.settings.port))
        except SensorGoneError as error:
            self._fail(str(error))
            return
        self._opened(self.device)
        self._greet(self._sensors)
        self._wake()

    def _greet(self, sensors: Sensors) -> None:
        claims: dict[str, Claim] = {
            "device": sensors.accelerometer.name,
            "nominal_rate_hz": self._hz(sensors),
        }
        claims["accel_lsb"] = float(sensors.accelerometer.scale[0])
        if sensors.gyroscope is not None:
            claims["gyro_lsb"] = float(sensors.gyroscope.scale[0])
        self._emit(Hello(session=_session(), claims=claims))
        self._emit(self._status(self._clock()))

    def _lose(self, reason: str, for_good: bool = False) -> None:
        self._flush()
        device, self._sensors, self._sensing = self.device, None, False
        self._line_down(device, reason, for_good)

    # Reading

    def _hz(self, sensors: Sensors) -> float:
        return self._rate_hz or min(sensors.rate_hz or MAX_RATE_HZ, MAX_RATE_HZ)

    def _wake(self) -> None:
        if self._sensing:
            return
        self._cancel()
        now = self._clock()
        self._sensing, self._last, self._next_status, self._woken = True, now, now, True
        self._wakeups += 1
        self._poll()

    def _sleep(self, until: float) -> None:
        """Read no sensor before `until`, s of the stamps: the driver then puts the chip to sleep by itself.

        The thermometer is still read now and then: a sensor that warms up late needs its past.
        """
        self._cancel()
        self._flush()
        self._sensing = False
        self._emit_status(self._clock())
        self._doze(until)

    def _doze(self, until: float) -> None:
        """Plan a reading of the thermometer, or waking at `until`, s of the stamps."""
        remaining = until - self._clock()
        if remaining <= THERMOMETER_S:
            self._schedule(max(remaining, 0.0), self._wake)
        elif self._sensors is not None and self.celsius is not None:
            self._schedule(THERMOMETER_S, lambda: self._read_thermometer(until))
        elif math.isfinite(until):
            self._schedule(remaining, self._wake)

    def _read_thermometer(self, until: float) -> None:
        """Read the thermometer alone, and go on sleeping until a time, s of the stamps."""
        self._timer = None
        try:
            self.celsius = None if self._sensors is None else self._sensors.celsius()
        except SensorGoneError as error:
            self._lose(f"sensor lost: {error}")
            return
        if self.celsius is not None:
            self._emit(Temperature(self._clock(), self.celsius))
        self._doze(until)

    def _poll(self) -> None:
        """Read each sensor once, and plan the next reading on the same grid."""
        self._timer = None
        sensors = self._sensors
        if sensors is None:
            return
        if len(self._records) >= self.settings.queue:
            self.link.pauses += 1
            self._schedule(BATCH_S, self._poll)
            return
        begin, loop = self._clock(), asyncio.get_running_loop()
        try:
            if self._woken or begin - self._last > SLEPT_S:
                sensors = self._read_chip(sensors)
                self._woken = False
            for channel in sensors.channels():
                self._sample(channel)
            if begin >= self._next_status:
                self._read_status(sensors, begin)
        except SensorGoneError as error:
            self._lose(f"sensor lost: {error}")
            return
        self._failures = 0
        self._on_time, self._last = self._on_time + begin - self._last, begin
        if begin - self._oldest(begin) >= self._batch_s:
            self._flush()
        step = 1.0 / self._hz(sensors)
        now = loop.time()
        self._timer = loop.call_at((math.floor(now / step) + 1) * step, self._poll)

    def _sample(self, channel: sysfs.Channel) -> None:
        before = self._clock()
        xyz = channel.read()
        stamps, rows = self._gathered.setdefault(channel.sensor, ([], []))
        stamps.append((before + self._clock()) / 2.0)
        rows.append(xyz)

    def _oldest(self, now: float) -> float:
        return min((stamps[0] for stamps, _ in self._gathered.values() if stamps), default=now)

    def _read_status(self, sensors: Sensors, now: float) -> None:
        self._next_status = now + STATUS_S
        celsius = sensors.celsius()
        self.celsius = celsius
        if celsius is not None:
            self._emit(Temperature(now, celsius))
        self._emit(self._status(now))

    def _flush(self) -> None:
        """Emit the gathered samples, the gyroscope's first."""
        read, self._gathered = self._gathered, {}
        for sensor in (Sensor.GYROSCOPE, Sensor.ACCELEROMETER):
            stamps, rows = read.get(sensor, ([], []))
            if stamps:
                self._counters.samples += len(stamps)
                self._emit(Samples.checked(sensor, stamps, rows))

    def _status(self, now: float) -> Status:
        return Status(now, self._on_time, self._sensing, self._wakeups)

    def _emit_status(self, now: float) -> None:
        self._emit(self._status(now))
        self._emit(Tick(now))


def _session() -> int:
    """Return a number that changes at each boot, when CLOCK_BOOTTIME starts at zero again."""
    try:
        return zlib.crc32(BOOT_ID.read_bytes())
    except OSError:
        return 0
