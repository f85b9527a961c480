"""Scenarios: what happens to a phone, in order, read from a TOML file."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import TypeVar

import msgspec

from stillcal.daemon.system.files import (
    NotRegularError,
    TooLargeError,
    input_name,
    is_read_once,
    read_input,
)
from stillcal.replay.phone.activities.carried import Drive, Hand, Pocket, Stairs, Walk
from stillcal.replay.phone.activities.resting import Desk, Mattress, Place, Poses, Rest, Table, Washer
from stillcal.replay.phone.settings import Settings, require

T = TypeVar("T")

MOST_BYTES = 1 << 24
"""Longest settings file that is read."""

Segment = Rest | Table | Poses | Desk | Washer | Mattress | Hand | Pocket | Walk | Stairs | Drive


class Scenario(Settings, frozen=True, kw_only=True, rename={"segments": "segment"}):
    """A course of events.

    place: where it starts; ambient_c: degC at the start; repeat: how often it all happens. duration_s:
    length of the whole recording, None for as long as it takes; a course that ends early rests until then,
    one that runs over is cut. earth_rotation: whether the gyroscope feels the Earth turn.
    """

    segments: tuple[Segment, ...]
    description: str = ""
    place: Place = Place(latitude=52.2, longitude=0.12, altitude=20.0)
    ambient_c: float = 22.0
    repeat: int = 1
    duration_s: float | None = None
    earth_rotation: bool = False

    def __post_init__(self) -> None:
        require(len(self.segments) > 0, "segment", "none", "given at least once")
        require(1 <= self.repeat <= 1000, "repeat", self.repeat, "from 1 to 1000")
        require(self.duration_s is None or self.duration_s > 0.0, "duration_s", self.duration_s, "above 0 s")


def read_settings(name: str | Path, folder: str, kind: type[T]) -> T:
    """Read a settings file by path ("-": standard input), or by name from the package's own `folder`.

    Raises ValueError naming the file and the field where it is not found or does not fit.
    """
    path = Path(name)
    given = path.suffix == ".toml" or is_read_once(name)
    shipped = files("stillcal.config") / folder
    source = input_name(name) if given else shipped / f"{name}.toml"
    try:
        text = read_input(path, MOST_BYTES) if given else (shipped / f"{name}.toml").read_bytes()
        table = tomllib.loads(text.decode())
        return msgspec.convert(table, type=kind)
    except FileNotFoundError as error:
        if path.exists():
            raise ValueError(f"{name}: settings are TOML; give a file whose name ends in .toml") from error
        known = sorted(p.name[:-5] for p in shipped.iterdir() if p.name.endswith(".toml"))
        raise ValueError(f"{name}: no such file, and not one of {', '.join(known)}") from error
    except (NotRegularError, TooLargeError) as error:
        raise ValueError(f"{source}: {error.strerror}; give TOML as docs/phone.md has it") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{source}: is not a text file; give TOML as docs/phone.md has it") from error
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise ValueError(f"{source}: {error}; docs/phone.md says what it may hold") from error


def load_scenario(name: str | Path) -> Scenario:
    """Load a scenario by path or by the name of a ready one. Raises ValueError saying what is wrong where."""
    return read_settings(name, "scenarios", Scenario)
