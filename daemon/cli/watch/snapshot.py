"""Ask a running daemon over its socket and keep the answers of one moment as a plain record.

Nothing is drawn here. That no daemon answers is recorded too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stillcal.daemon.cli.query import NoDaemonError, replies
from stillcal.daemon.system.printable import printable
from stillcal.daemon.varlink.address import NAME

Answer = dict[str, Any]

DAYS = 7
"""Days of energy use that are asked for; the frame shows the last three."""

RESTS = 96
"""Rests that are asked for: the default of the daemon's own pool, one for each orientation that it keeps."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Answers of one moment, as the interface describes them; `absent` says why there are none.

    calibration: None where there is none yet. days: the newest, oldest first. diagnosis: the newest
    self-diagnosis. faces: how far six known faces have come.
    """

    where: Path
    absent: str = ""
    status: Answer = field(default_factory=dict)
    stillness: Answer = field(default_factory=dict)
    calibration: Answer | None = None
    days: list[Answer] = field(default_factory=list)
    diagnosis: Answer = field(default_factory=dict)
    faces: Answer = field(default_factory=dict)


def snapshot(where: Path) -> Snapshot:
    """Ask the daemon at the socket `where` for all that is shown; `absent` says why where none answers."""
    try:
        return Snapshot(
            where,
            status=_asked(where, "GetStatus", "status") or {},
            stillness=_asked(where, "GetStillness", "stillness", limit=RESTS) or {},
            calibration=_asked(where, "GetCalibration", "calibration"),
            days=_asked(where, "GetEnergy", "days", limit=DAYS) or [],
            diagnosis=_asked(where, "GetFindings", "diagnosis") or {},
            faces=_asked(where, "GetFaces", "faces") or {},
        )
    except NoDaemonError as error:
        return Snapshot(where, absent=str(error))


def _asked(where: Path, method: str, key: str, **parameters: int) -> Any:
    """Call one method; None where the daemon answers with an error, such as that there is no calibration."""
    (reply,) = replies(where, {"method": f"{NAME}.{method}", "parameters": parameters})
    return _cleaned((reply.get("parameters") or {}).get(key))


def _cleaned(value: Any) -> Any:
    """Return an answer in which no text moves the terminal's cursor: names come from the phone."""
    if isinstance(value, dict):
        return {key: _cleaned(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_cleaned(item) for item in value]
    return printable(value) if isinstance(value, str) else value
