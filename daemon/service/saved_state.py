"""The engine's state on disk, so that rests gathered before a crash still count.

One file beside the store: a line that says what it is, a SHA-256 of the rest, and the rest in MessagePack.
Losing it costs rests, never a calibration; so what cannot be read is set aside and the daemon goes on.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from stillcal.calib_core.codec import unpacked
from stillcal.calib_core.engine.state import EngineState
from stillcal.daemon.service.energy_ledger import EnergyLedger
from stillcal.daemon.service.phone_clock import PhoneClock
from stillcal.daemon.service.self_diagnosis import NightReport
from stillcal.daemon.store.atomic import write_atomically
from stillcal.daemon.store.msgpack_arrays import encoded
from stillcal.daemon.system.files import NotRegularError, TooLargeError, read_regular

HEAD = b"stillcal state 1\n"
MAX_BYTES = 64 * 2**20
"""Longest state file that is read, so that a wrong file at its path cannot fill the memory."""

ASIDE = 10
"""How many unreadable state files are kept; a further one replaces the last."""


class StateError(ValueError):
    """The state file cannot be used; the message says why."""


@dataclass(slots=True)
class SavedState:
    """What the daemon remembers besides the store.

    device: the name that the phone gives itself. seed: of the random pauses between probes, drawn at the
    first start; 0 in a state from before there was one. night: the newest self-diagnosis.
    """

    engine: EngineState
    clock: PhoneClock = field(default_factory=PhoneClock)
    energy: EnergyLedger = field(default_factory=EnergyLedger)
    device: str = ""
    seed: int = 0
    night: NightReport = field(default_factory=NightReport)


@dataclass(frozen=True, slots=True)
class Loaded:
    """The result of loading. state: None where there is none. note: what was wrong, for the log."""

    state: SavedState | None = None
    note: str = ""


def state_path(store: Path) -> Path:
    """Return the path of the state file that belongs to a store: no other store's, and not the store's own.

    >>> str(state_path(Path("store.json"))), str(state_path(Path("phone.1")))
    ('store.state', 'phone.1.state')
    """
    return store.with_name(f"{store.name.removesuffix('.json')}.state")


def encode(state: SavedState) -> bytes:
    """Return the file's contents."""
    body = encoded(state)
    return HEAD + hashlib.sha256(body).digest() + body


def decode(data: bytes) -> SavedState:
    """Read a file's contents. Raises StateError where they are foreign, damaged or of another version."""
    body = data[len(HEAD) + 32 :]
    if not data.startswith(HEAD):
        raise StateError("not a state file of this version")
    if hashlib.sha256(body).digest() != data[len(HEAD) : len(HEAD) + 32]:
        raise StateError("the checksum does not match")
    try:
        return unpacked(body, SavedState)
    except (msgspec.MsgspecError, ValueError, TypeError, KeyError) as error:
        raise StateError(f"does not fit this version: {error}") from error


def load(path: Path) -> Loaded:
    """Read the state; one that cannot be used is set aside. Never raises on what the file holds.

    Raises OSError where the file is there and neither can be read nor moved away.
    """
    try:
        return Loaded(decode(read_regular(path, MAX_BYTES)))
    except FileNotFoundError:
        return Loaded()
    except (StateError, NotRegularError, TooLargeError) as error:
        aside = _free(path)
        path.replace(aside)
        why = error.strerror if isinstance(error, OSError) else error
        return Loaded(note=f"{path}: {why}; moved to {aside.name}; rests are collected again from scratch")


def save(path: Path, data: bytes) -> None:
    """Replace the state by encoded contents, whole or not at all. Raises OSError."""
    write_atomically(path, data, 0o600)


def _free(path: Path) -> Path:
    names = [path.with_name(f"{path.name}.bad-{n}") for n in range(1, ASIDE + 1)]
    return next((name for name in names if not os.path.lexists(name)), names[-1])
