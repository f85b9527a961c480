"""What a running daemon says of itself at one moment: questions over its socket, answers as a plain record.

Nothing is drawn here. A daemon that does not answer is an answer too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from stillcal.daemon.cli.query import NoDaemonError, replies
from stillcal.daemon.varlink.address import NAME

Answer = dict[str, Any]

DAYS = 7
RESTS = 96


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Answers of one moment, as the interface describes them; `absent` says why there are none.

    calibration: None where there is none yet. days: the newest, oldest first.
    """

    where: Path
    absent: str = ""
    status: Answer = field(default_factory=dict)
    stillness: Answer = field(default_factory=dict)
    calibration: Answer | None = None
    days: list[Answer] = field(default_factory=list)


def snapshot(where: Path) -> Snapshot:
    """Ask the daemon at the socket `where` for all that is shown; never raises for want of a daemon."""
    try:
        return Snapshot(
            where,
            status=_asked(where, "GetStatus", "status") or {},
            stillness=_asked(where, "GetStillness", "stillness", limit=RESTS) or {},
            calibration=_asked(where, "GetCalibration", "calibration"),
            days=_asked(where, "GetEnergy", "days", limit=DAYS) or [],
        )
    except (NoDaemonError, msgspec.MsgspecError) as error:
        return Snapshot(where, absent=str(error))


def _asked(where: Path, method: str, key: str, **parameters: int) -> Any:
    """Ask one question; None where the daemon answers with an error, such as that nothing is calibrated."""
    (reply,) = replies(where, {"method": f"{NAME}.{method}", "parameters": parameters})
    return (reply.get("parameters") or {}).get(key)
