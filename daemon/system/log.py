"""The log: one line per event, figures as key=value, with a syslog priority for journald.

The callers decide what is logged.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, TextIO

from stillcal.daemon.system.clock import Clock, host_time
from stillcal.daemon.system.printable import printable

_PRIORITIES = {"DEBUG": 7, "INFO": 6, "WARNING": 4, "ERROR": 3, "CRITICAL": 2}
"""The number in angle brackets at the start of a line (sd-daemon(3))."""

BURST, REFILL_S = 50.0, 10.0
"""Lines of one kind that may come at once, and after how long another one may, s."""

MOST_WAITING = 1000
"""Lines that wait for whoever reads them."""

FLUSH_S = 0.2
"""How long the end of the daemon waits for them, s."""

MAX_KINDS, KIND_CHARACTERS = 200, 60
"""Kinds of lines that are told apart, and by how much of their text where they have no name."""

_logger = logging.getLogger("stillcal")


def say(level: str, what: str, why: str = "", **fields: Any) -> None:
    """Log an event. what: its stable name; why: a sentence; fields: figures, None for none."""
    number = logging.getLevelNamesMapping()[level.upper()]
    if _logger.isEnabledFor(number):
        _logger.log(number, "%s", entry(what, why, fields), extra={"what": what})


def entry(what: str, why: str, fields: Mapping[str, Any]) -> str:
    """Return an event as one line, `what: why key=value ...`; values with a space are quoted."""
    head = f"{what}: {printable(why)}" if why else what
    return " ".join([head, *(f"{key}={_value(value)}" for key, value in fields.items() if value is not None)])


def set_up(level: str, stream: TextIO | None = None, environ: Mapping[str, str] = os.environ) -> Lines:
    """Send the log to `stream` (standard error), in journald's form where journald reads it."""
    stream = stream or sys.stderr
    handler = Lines(_descriptor(stream))
    handler.setFormatter(_Journal() if reads_journal(stream, environ) else logging.Formatter(_PLAIN))
    handler.addFilter(Quota())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    set_level(level)
    return handler


class Lines(logging.Handler):
    """Writes lines in a thread of its own: whoever reads them may be stuck, as a terminal at Ctrl-S is.

    At most MOST_WAITING lines wait, and later ones are counted. descriptor: None where nobody reads. Written
    past Python's own files, whose locks a thread that is stuck would hold when the interpreter ends.
    """

    def __init__(self, descriptor: int | None) -> None:
        super().__init__()
        self._descriptor, self._lost = descriptor, 0
        self._patience_s = FLUSH_S
        self._lines: SimpleQueue[bytes | threading.Event | None] = SimpleQueue()
        threading.Thread(target=self._write, name="log", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Hand a line to the thread."""
        if self._lines.qsize() >= MOST_WAITING:
            self._lost += 1
            return
        lost, self._lost = self._lost, 0
        tail = f" lost_before={lost}" if lost else ""
        self._lines.put(f"{self.format(record)}{tail}\n".encode(errors="backslashreplace"))

    def flush(self) -> None:
        """Wait until what was said is written, but no longer than FLUSH_S in all."""
        done = threading.Event()
        self._lines.put(done)
        if not done.wait(self._patience_s):
            self._patience_s = 0.0

    def close(self) -> None:
        """End the thread after what waits."""
        self._lines.put(None)
        super().close()

    def _write(self) -> None:
        while (item := self._lines.get()) is not None:
            if isinstance(item, threading.Event):
                item.set()
            elif self._descriptor is not None:
                with contextlib.suppress(OSError):  # nobody reads any more
                    while item:
                        item = item[os.write(self._descriptor, item) :]


def _descriptor(stream: TextIO | None) -> int | None:
    """Return the file that a stream writes to, None where there is none."""
    try:
        return None if stream is None else stream.fileno()
    except (OSError, ValueError):
        return None


class Quota(logging.Filter):
    """Lets BURST lines of a kind through at once, then one every REFILL_S that tells how many were held back.

    Whoever makes the daemon say the same without end, such as a phone that says hello in turn under two
    names, fills no disk.
    """

    def __init__(self, clock: Clock = host_time) -> None:
        super().__init__()
        self._clock = clock
        self._kinds: dict[str, _Kind] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Say whether a line may be written; add to it how many of its kind were not."""
        now, name = self._clock(), str(getattr(record, "what", record.msg))[:KIND_CHARACTERS]
        if len(self._kinds) >= MAX_KINDS and name not in self._kinds:
            name = ""
        kind = self._kinds.setdefault(name, _Kind(now))
        kind.credit = min(kind.credit + (now - kind.at) / REFILL_S, BURST)
        kind.at = now
        if kind.credit < 1.0:
            kind.held_back += 1
            return False
        kind.credit -= 1.0
        if kind.held_back:
            record.msg, record.args = f"{record.getMessage()} held_back={kind.held_back}", ()
            kind.held_back = 0
        return True


@dataclass(slots=True)
class _Kind:
    """Lines of one kind. at: when the last one came; credit: how many more may; held_back: since then."""

    at: float
    credit: float = BURST
    held_back: int = 0


def set_level(level: str) -> None:
    """Log events of `level` and above."""
    _logger.setLevel(level.upper())


def reads_journal(stream: TextIO | None, environ: Mapping[str, str]) -> bool:
    """Return whether `stream` is the one that journald named in JOURNAL_STREAM (systemd.exec(5))."""
    descriptor = _descriptor(stream)
    if descriptor is None:
        return False
    found = os.fstat(descriptor)
    return environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


_PLAIN = "%(asctime)s %(levelname)-7s %(message)s"


class _Journal(logging.Formatter):
    """Puts the priority before every line, also those of a traceback."""

    def format(self, record: logging.LogRecord) -> str:
        prefix = f"<{_PRIORITIES.get(record.levelname, 6)}>"
        return "\n".join(prefix + line for line in super().format(record).splitlines())


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    text = printable(str(value))
    return json.dumps(text, ensure_ascii=False) if not text or set(text) & set(' "=') else text
