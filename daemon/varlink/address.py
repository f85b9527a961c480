"""The path of the daemon's socket, for the daemon and for its clients."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Mapping
from pathlib import Path

from stillcal.calib_core.errors import UserError

NAME = "io.stillcal.Calibration"
SYSTEM = Path("/run/stillcal") / NAME

LONGEST = 107
"""Of a socket's path, bytes (unix(7))."""


def socket_path(path: str, environ: Mapping[str, str] = os.environ) -> Path:
    """Return the path at which a daemon of this environment listens: as set, else in its runtime folder."""
    if path:
        return Path(path)
    if service := environ.get("RUNTIME_DIRECTORY"):
        return Path(service.split(":")[0]) / NAME
    if user := environ.get("XDG_RUNTIME_DIR"):
        return Path(user) / "stillcal" / NAME
    return SYSTEM


def answering_path(path: str, environ: Mapping[str, str] = os.environ) -> Path:
    """Return the path to connect to: as given, else the user's own daemon if it exists, else the system's.

    Raises UserError where no socket can be there.
    """
    own = socket_path(path, environ)
    found = own if path or own.exists() else SYSTEM
    if len(os.fsencode(found)) > LONGEST:
        raise UserError(f"{found}: a socket's path has {LONGEST} bytes at most: give a shorter one")
    with contextlib.suppress(OSError):  # connecting says what is wrong
        if not stat.S_ISSOCK(found.stat().st_mode):
            raise UserError(f"{found}: is no socket: give the path of the daemon's, as `stillcal run` has it")
    return found
