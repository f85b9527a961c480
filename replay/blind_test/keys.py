"""Keys: the effects hidden in a recording, and the seal that proves they were fixed before the answer.

A key file is a line with a nonce of 128 random bits in hexadecimal, then the key as JSON. Its SHA-256 is
what the manifest publishes, so that `sha256sum` alone checks it.
"""

from __future__ import annotations

import hashlib
import secrets
from dataclasses import dataclass, field
from typing import Any

import msgspec

KINDS = ("null", "decoy", "single", "pair", "near_shape", "off_catalogue", "reserve",
         "simulated", "phone_file")  # fmt: skip


SIGNS = {"lacking": 1, "too_small": 1, "agreed": 0, "too_large": -1, "superfluous": -1}
"""Relations of a recording's effect to a simulation's: 1 where it has more of it, -1 where less."""


@dataclass(frozen=True, slots=True)
class TrueEffect:
    """A hidden effect. d_prime: None where it has no d'. t_start, t_end: s."""

    effect: str
    sensor: str
    axes: list[str]
    parameters: dict[str, Any]
    d_prime: float | None
    t_start: float
    t_end: float


@dataclass(frozen=True, slots=True)
class Exam:
    """What is needed to score the model of an answer: the bins, the noise, and what the effects truly add.

    Lists over bins; force, north, accel and gyro (m, 3). accel_noise, gyro_noise: fields of `noise.Colour`.
    """

    width: float
    t: list[float]
    rest: list[float]
    since: list[float]
    force: list[list[float]]
    north: list[list[float]]
    temperature: list[float]
    charging: list[float]
    drive: list[list[float]]
    accel: list[list[float]]
    gyro: list[list[float]]
    accel_noise: dict[str, float]
    gyro_noise: dict[str, float]


@dataclass(frozen=True, slots=True)
class Key:
    """The key of a recording.

    kind: one of `KINDS`. family: of the noise. maker: who made motion and noise, examiner or simulator.
    variant: the decoy, or the hidden kind. ground: what the phone lies on. entailed: names that are true
    beside the effect. nearest: the names of which a near-shape is almost one; misfit: d' of what these, or of
    what all names, leave of a hidden kind, None where that is not its measure. relation: of the recording's
    effect to a given simulation, which has a `share` of it; can_tell: whether the two recordings can tell it.
    """

    kind: str
    family: str = "unknown"
    maker: str = "another"
    full_length: bool = False
    variant: str | None = None
    effects: list[TrueEffect] = field(default_factory=list)
    entailed: list[str] = field(default_factory=list)
    nearest: list[str] = field(default_factory=list)
    misfit: float | None = None
    ground: str = "firm"
    relation: str | None = None
    share: float | None = None
    can_tell: bool = True
    exam: Exam | None = None
    schema: int = 1


class SealError(ValueError):
    """A key file cannot be used; the message says why."""


def sealed(key: Key) -> bytes:
    """Return a key file with a fresh nonce."""
    return secrets.token_hex(16).encode() + b"\n" + msgspec.json.encode(key) + b"\n"


def seal_of(file: bytes) -> str:
    """Return the SHA-256 that the manifest publishes of a key file."""
    return hashlib.sha256(file).hexdigest()


def opened(file: bytes, seal: str, name: str) -> Key:
    """Open a key file. Raises SealError where it is not the one that was committed to, or is no key."""
    if seal_of(file) != seal:
        raise SealError(f"{name}: the key is not the one the manifest commits to; give the original key file")
    return key_of(file.partition(b"\n")[2], name)


def key_of(text: bytes, name: str) -> Key:
    """Read a key's JSON. Raises SealError where it has not the documented layout."""
    try:
        key = msgspec.json.decode(text, type=Key)
    except msgspec.DecodeError as error:
        raise SealError(f"{name}: not a key ({error}); see docs/proof.md for its layout") from None
    if key.kind not in KINDS:
        raise SealError(f"{name}: kind = {key.kind}: must be one of {', '.join(KINDS)}")
    if key.kind not in ("null", "decoy") and not key.effects:
        raise SealError(f"{name}: effects: a key of kind {key.kind} names at least one effect")
    if key.kind == "near_shape" and not key.nearest:
        raise SealError(f"{name}: nearest: a near-shape names the effects that it is almost one of")
    if key.kind == "simulated" and key.relation not in SIGNS:
        raise SealError(f"{name}: relation = {key.relation}: must be one of {', '.join(SIGNS)}")
    return key
