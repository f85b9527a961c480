"""The log: one line per event, figures as key=value, with a syslog priority for journald.

The callers decide what is logged.
"""

from __future__ import annotations

import json
import logging
import os
import sys
from collections.abc import Mapping
from typing import Any, TextIO

_PRIORITIES = {"DEBUG": 7, "INFO": 6, "WARNING": 4, "ERROR": 3, "CRITICAL": 2}
"""The number in angle brackets at the start of a line (sd-daemon(3))."""

_logger = logging.getLogger("stillcal")


def say(level: str, what: str, why: str = "", **fields: Any) -> None:
    """Log an event. what: its stable name; why: a sentence; fields: figures, None for none."""
    number = logging.getLevelNamesMapping()[level.upper()]
    if _logger.isEnabledFor(number):
        _logger.log(number, "%s", entry(what, why, fields))


def entry(what: str, why: str, fields: Mapping[str, Any]) -> str:
    """Return an event as one line, `what: why key=value ...`; values with a space are quoted."""
    head = f"{what}: {_plain(why)}" if why else what
    return " ".join([head, *(f"{key}={_value(value)}" for key, value in fields.items() if value is not None)])


def set_up(level: str, stream: TextIO | None = None, environ: Mapping[str, str] = os.environ) -> None:
    """Send the log to `stream` (standard error), in journald's form where journald reads it."""
    stream = stream or sys.stderr
    handler = logging.StreamHandler(stream)
    handler.setFormatter(_Journal() if reads_journal(stream, environ) else logging.Formatter(_PLAIN))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    set_level(level)


def set_level(level: str) -> None:
    """Log events of `level` and above."""
    _logger.setLevel(level.upper())


def reads_journal(stream: TextIO, environ: Mapping[str, str]) -> bool:
    """Return whether `stream` is the one that journald named in JOURNAL_STREAM (systemd.exec(5))."""
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
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
    text = _plain(str(value))
    return json.dumps(text, ensure_ascii=False) if not text or set(text) & set(' "=') else text


def _plain(text: str) -> str:
    """Escape what is not printable, so that a text stays on one line."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
