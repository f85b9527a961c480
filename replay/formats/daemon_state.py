"""The rests that a daemon has kept for learning, read from its state file (daemon/service/saved_state.py)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.temperature.memory import Memory
from stillcal.daemon.service.saved_state import HEAD, MAX_BYTES, StateError, decode
from stillcal.daemon.system.files import read_regular
from stillcal.replay.formats.errors import TraceError

_HALF = 0.5


def is_daemon_state(path: Path) -> bool:
    """Whether a file is a daemon's state, by its first bytes."""
    if not path.is_file() or path.stat().st_size < len(HEAD):  # a file of /proc has no size, and may wait
        return False
    with path.open("rb") as file:
        return file.read(len(HEAD)) == HEAD


def kept_rests(path: Path) -> list[RestState]:
    """Return the rests kept, oldest first. Raises TraceError where the state cannot be read, or has none.

    Their forces are those at the newest one's gravity: a rest at another place is scaled, which leaves an
    error of the bias times the change of gravity, 0.1 mg at most. Where half of the rests or more have rates,
    only those are returned, and likewise for temperatures and for whether the phone was on the charger.
    """
    try:
        memory = decode(read_regular(path, MAX_BYTES)).engine.memory
    except StateError as error:
        raise TraceError(path, str(error), "give the state of a daemon of this version") from error
    if not len(memory):
        raise TraceError(path, "no rests are kept yet", "let the daemon gather rests")
    for columns in (_rates, _temperatures, _on_charger):
        known = np.isfinite(columns(memory)).all(axis=1)
        if known.mean() >= _HALF:
            memory = memory.where(np.asarray(known))
    return [_rest(memory, row) for row in range(len(memory))]


def _rates(memory: Memory) -> Array:
    return memory.rate


def _temperatures(memory: Memory) -> Array:
    return memory.celsius[:, None]


def _on_charger(memory: Memory) -> Array:
    return memory.charged[:, :1]


def _rest(memory: Memory, row: int) -> RestState:
    force = memory.force[row] * (memory.gravity[-1] / memory.gravity[row])
    sd, rate, rate_sd = memory.force_sd[row], memory.rate[row], memory.rate_sd[row]
    t, celsius, has_rate = float(memory.t[row]), float(memory.celsius[row]), np.isfinite(rate).all()
    return RestState(
        t,
        t,
        1,
        frozen(force),
        sd,
        sd,
        float(np.linalg.norm(sd)),
        rate=_known(rate, has_rate),
        rate_sd=_known(rate_sd, has_rate),
        rate_uncertainty=_known(rate_sd, has_rate),
        temperature=celsius if np.isfinite(celsius) else None,
        charged=memory.charged[row],
    )


def _known(values: Array, known: bool) -> Array | None:
    return frozen(values) if known else None
