"""The phone's serial line: open it, read and write it on the event loop, and reopen it when it is lost.

Everything runs in callbacks of one asyncio loop; no thread, no task. What arrives is decoded at once and
waits in a bounded queue; when that is full, reading stops and the kernel holds the sender back. The wire
package says what the bytes mean, the service package what to do about them.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import glob
import math
import os
import termios

import serial

from stillcal.daemon.sources.base import SerialSettings, Source
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Command, Identify
from stillcal.daemon.wire.reassembly import WireCounters

READ_BYTES = 4096
"""Bytes read at once: a terminal's buffer, so that a full queue is exceeded by no more than that."""

ROOM_BYTES = 3072
"""Bytes that may gather unread: three quarters of a terminal's buffer, beyond which it stops the sender."""

LEAST_NAP_S = 0.02
"""A line that would fill that sooner than this is watched without pause, s."""

UNSENT_LIMIT = 65_536
"""Bytes of commands that may wait for a device that does not read; further commands are dropped."""


class SerialSource(Source):
    """A serial line that is reopened whenever it is lost. Records come out in order of time.

    Call `take` from one task. Between LinkUp and LinkDown lies what one connection
    brought; nothing that was read from the device is lost between the two.
    """

    def __init__(self, settings: SerialSettings) -> None:
        super().__init__(settings)
        self._decoder = WireDecoder()
        self._encoders = {form: WireEncoder(WireSettings(form=form)) for form in Form}
        self._port: serial.Serial | None = None
        self._unsent = bytearray()
        self._reading = self._writing = False
        self._rate_sample = (-math.inf, 0)

    # For the one who takes

    @property
    def connected(self) -> bool:
        """Whether a device is open now."""
        return self._port is not None

    @property
    def device(self) -> str:
        """Path of the open device; "" where none is open."""
        return "" if self._port is None else str(self._port.port)

    @property
    def wire(self) -> WireCounters:
        """A copy of the decoder's counters."""
        return self._decoder.snapshot()

    async def let_gather(self, seconds: float) -> None:
        """Let bytes gather on the line for this long, s, so that small messages do not wake the process.

        A faster line is read more often; a very fast one is watched all the time.
        """
        loop = asyncio.get_running_loop()
        end = loop.time() + seconds
        while (left := end - loop.time()) > 0.0 and (nap := self._nap(loop.time())) >= LEAST_NAP_S:
            self._unwatch()
            await asyncio.sleep(min(nap, left))
            self._read_gathered()
        self._resume()
        if left > 0.0:
            await asyncio.sleep(left)

    def close(self) -> None:
        """Release the phone for good; records that have arrived can still be taken."""
        self._read_gathered()
        super().close()

    def send(self, command: Command) -> bool:
        """Send a command in the form that the device uses; return whether it was queued.

        It is dropped while no device is open, or while the device does not read.
        """
        form = self._decoder.form or Form.BINARY
        sent = self._put(self._encoders[form].encode(command))
        self.link.commands_sent += sent
        self.link.commands_dropped += not sent
        return sent

    # Opening

    def _connect(self) -> None:
        """Try every device that the settings name; try again later where none opens."""
        self._timer = None
        reason = "no such device"
        for device in self._candidates():
            try:
                self._port = _open_port(device, self.settings.baud)
            except (serial.SerialException, OSError, termios.error, ValueError) as error:
                reason = f"{device}: {_why(error)}"
                continue
            self._greet(device)
            return
        self._fail(reason)

    def _candidates(self) -> list[str]:
        port = self.settings.port
        return sorted(glob.glob(port)) if glob.has_magic(port) else [port]  # noqa: PTH207 - may be absolute

    def _greet(self, device: str) -> None:
        """Ask the device to identify itself, in both forms: each kind of device ignores the other's."""
        self._opened(device)
        self._unsent.clear()
        self._resume()
        binary, text = (self._encoders[form].encode(Identify()) for form in (Form.BINARY, Form.TEXT))
        self._put(binary + b"\n" + text)

    def _lose(self, reason: str, for_good: bool = False) -> None:
        port, self._port = self._port, None
        assert port is not None
        self._stop(port.fileno())
        with contextlib.suppress(OSError, termios.error):
            termios.tcflush(port.fileno(), termios.TCOFLUSH)  # or close() waits for a stuck device
        port.close()
        for message in self._decoder.end():
            self._emit(message)
        self._line_down(str(port.port), reason, for_good)

    # Reading

    def _read(self) -> None:
        assert self._port is not None
        try:
            data = os.read(self._port.fileno(), READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(error.strerror or errno.errorcode.get(error.errno or 0, "I/O error"))
            return
        if not data:
            self._lose("the device closed the line")
            return
        for message in self._decoder.feed(data):
            self._failures = 0  # only a device that makes sense ends the back-off
            self._emit(message)
        if len(self._records) >= self.settings.queue:
            self._pause()

    def _read_gathered(self) -> None:
        """Read what gathered while the line was not watched, if the queue has room."""
        if self._port is not None and not self._reading and len(self._records) < self.settings.queue:
            self._read()

    def _nap(self, now: float) -> float:
        """Return how long (s) the line may gather, at the rate of bytes since the last call."""
        (before, had), self._rate_sample = self._rate_sample, (now, self._decoder.counters.bytes)
        return ROOM_BYTES * (now - before) / max(self._rate_sample[1] - had, 1)

    def _pause(self) -> None:
        self.link.pauses += self._unwatch()

    def _unwatch(self) -> bool:
        """Stop reading; return whether the line was being read."""
        was, self._reading = self._reading, False
        if was and self._port is not None:
            asyncio.get_running_loop().remove_reader(self._port.fileno())
        return was

    def _resume(self) -> None:
        if not self._reading and self._port is not None and len(self._records) <= self.settings.queue // 2:
            asyncio.get_running_loop().add_reader(self._port.fileno(), self._read)
            self._reading = True

    def _stop(self, fd: int) -> None:
        loop = asyncio.get_running_loop()
        loop.remove_reader(fd)
        loop.remove_writer(fd)
        self._reading = self._writing = False

    # Writing

    def _put(self, data: bytes) -> bool:
        if self._port is None or len(self._unsent) + len(data) > UNSENT_LIMIT:
            return False
        self._unsent += data
        if not self._writing:
            self._write()
        return True

    def _write(self) -> None:
        assert self._port is not None
        fd, loop = self._port.fileno(), asyncio.get_running_loop()
        try:
            del self._unsent[: os.write(fd, self._unsent)]
        except BlockingIOError:
            pass
        except OSError:
            self._unsent.clear()  # the reader learns of the loss, after what still arrived
        if self._unsent and not self._writing:
            loop.add_writer(fd, self._write)
        elif not self._unsent and self._writing:
            loop.remove_writer(fd)
        self._writing = bool(self._unsent)


def _why(error: Exception) -> str:
    """Return why a line cannot be opened: pyserial puts the system's own error into the text of another."""
    cause = error.__context__ or error
    number = next(iter(cause.args), None)  # also of a termios.error, which is no OSError
    if number in {errno.EAGAIN, errno.EBUSY}:
        return "another program has locked it"
    if number == errno.ENOTTY:
        return "it is no serial line"
    return os.strerror(number) if isinstance(number, int) else str(cause)


def _open_port(device: str, baud: int) -> serial.Serial:
    """Open `device` raw and locked, so that a read distinguishes silence from a hang-up.

    pyserial sets VMIN to 0, with which a read of nothing returns 0 bytes as a hang-up does (termios(3));
    with 1 it says EAGAIN. Raises serial.SerialException, OSError or termios.error.
    """
    port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
    try:
        attributes = termios.tcgetattr(port.fileno())
        attributes[6][termios.VMIN] = 1
        termios.tcsetattr(port.fileno(), termios.TCSANOW, attributes)
    except BaseException:
        port.close()
        raise
    return port
