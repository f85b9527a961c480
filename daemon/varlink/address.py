"""The path of the daemon's socket, for the daemon and for its clients."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

NAME = "io.stillcal.Calibration"
SYSTEM = Path("/run/stillcal") / NAME


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
    """Return the path to connect to: as given, else the user's own daemon if it exists, else the system's."""
    own = socket_path(path, environ)
    return own if path or own.exists() else SYSTEM
