"""What every target has in common: what it holds, what it cannot hold, and the file it writes and reads."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import UserError
from stillcal.replay.export.imu import ImuParameters, facts, spread

MAX_BYTES = 16 << 20
"""A configuration larger than this is none."""


@dataclass(frozen=True, slots=True)
class Exported:
    """A file's contents. left_out: names of what it does not hold. notes: what a user must know."""

    data: bytes
    left_out: list[str]
    notes: list[str]


class Target(ABC):
    """One tool's file. source: where its convention is written down."""

    name: ClassVar[str]
    title: ClassVar[str]
    source: ClassVar[str]
    invertible: ClassVar[bool] = True
    needs_noise: ClassVar[bool] = False

    @abstractmethod
    def holds(self, imu: ImuParameters) -> set[str]:
        """Return the names (of `imu.facts`) that the file holds; names that are not known do not matter."""

    def notes(self, imu: ImuParameters) -> list[str]:
        """Return what a user of the file must know, a sentence each."""
        return []

    @abstractmethod
    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return the file, with the remarks as comments."""

    def read(self, data: bytes) -> ImuParameters:
        """Return what a file holds. Raises UserError where it is no such file."""
        raise UserError(f"{self.title} holds no calibration that could be read back")


def exported(target: Target, imu: ImuParameters, what: str) -> Exported:
    """Return the file of a target. what: the store's name, for its first line and for errors.

    Raises UserError where nothing of what the target is for is known.
    """
    known = facts(imu)
    held = target.holds(imu) & known.keys()
    if target.needs_noise and not any(name.endswith("noise") for name in known):
        raise UserError(
            f"{what}: holds no noise, which {target.title} is made of: add --phone PHONE.toml, which"
            " stillcal diagnose --phone-out writes"
        )
    if not held:
        raise UserError(f"{what}: holds nothing that {target.title} can hold")
    left_out = [name for name in known if name not in held]
    notes = target.notes(imu)
    device = f" of {imu.device}" if imu.device else ""
    head = [f"Calibration {imu.identity}{device} from {what}, written by stillcal store export."]
    remarks = [*head, *(f"Note: {n}" for n in notes), *(f"Not held here: {n}: {known[n]}" for n in left_out)]
    plain = [" ".join(line.split()) for line in remarks]
    return Exported(target.write(imu, plain), left_out, notes)


def commented(lines: Iterable[str], mark: str = "# ") -> str:
    """Return lines as comments, each ended."""
    return "".join(f"{mark}{line}\n" for line in lines)


def text_of(data: bytes) -> str:
    """Return a file's text. Raises UserError where it is none."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError("not a text file") from error


def finite(values: object, shape: tuple[int, ...], what: str) -> Array:
    """Return numbers of a shape. Raises UserError where they are not."""
    try:
        out = np.asarray(values, dtype=np.float64).reshape(shape)
    except (ValueError, TypeError) as error:
        raise UserError(f"{what}: expected {' by '.join(map(str, shape)) or 'one'} numbers") from error
    if not np.isfinite(out).all():
        raise UserError(f"{what}: expected finite numbers")
    return out


def one_number(imu: ImuParameters) -> list[str]:
    """Return a note for each sensor whose axes differ, for a target that has one density for all three."""
    return [
        f"the {name}'s axes differ in noise; the one number is their root mean square"
        for name, part in imu.parts()
        if part.noise is not None and spread(part.noise.white)
    ]
