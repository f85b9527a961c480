"""Making a blind test: recordings with neutral names in one folder, sealed keys in another."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.blind_test.answer import FRESH, PHONE, SIMULATION
from stillcal.replay.blind_test.case import Case
from stillcal.replay.blind_test.cases import make_case
from stillcal.replay.blind_test.designs import Design, planned
from stillcal.replay.blind_test.keys import key_of, seal_of, sealed
from stillcal.replay.blind_test.world.phones import MadeRecording
from stillcal.replay.formats.writer import TraceWriter


class ChallengeError(ValueError):
    """A folder or file of a blind test cannot be used; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class Manifest:
    """Published before any answer. seals: SHA-256 of the key file, by the recording's name."""

    seals: dict[str, str]
    schema: int = 1


def make(
    recordings: Path,
    keys: Path,
    trials: int,
    seed: int,
    *,
    jobs: int = 1,
    beside: Collection[str] = (),
    trials_too: bool = True,
    tick: Callable[[int, int], None] = lambda done, of: None,
) -> Manifest:
    """Write `trials` cases, and those of kinds `beside` them, with their manifest, and their keys.

    trials_too: whether the trials themselves are made. tick: is called after each with the number done and
    the number in all.

    Raises ChallengeError where a folder holds something already.
    """
    for folder in (recordings, keys):
        if folder.exists() and any(folder.iterdir()):
            raise ChallengeError(f"{folder}: is not empty; name a new or an empty folder")
        folder.mkdir(parents=True, exist_ok=True)
    designs, seals = planned(trials, seed, beside, recordings=trials_too), {}
    work = [(design, seed, i, recordings, keys) for i, design in enumerate(designs)]
    with _case_mapper(jobs) as run:
        for name, seal in run(_write_case, work):
            seals[name] = seal
            tick(len(seals), len(designs))
    return _published(recordings, seals)


def _published(recordings: Path, seals: dict[str, str]) -> Manifest:
    manifest = Manifest(dict(sorted(seals.items())))
    (recordings / "manifest.json").write_bytes(msgspec.json.format(msgspec.json.encode(manifest)) + b"\n")
    return manifest


def commit(recordings: Path, keys: Path) -> Manifest:
    """Seal keys written by others, KEYS/NAME.json for RECORDINGS/NAME.csv, and publish the manifest.

    Each key becomes KEYS/NAME.key. Raises ChallengeError where a recording is missing, a key is sealed
    already or there is none, and SealError where a key has not the documented layout.
    """
    seals = {}
    for path in sorted(keys.glob("*.json")):
        sealed_path = path.with_suffix(".key")
        if not (recordings / f"{path.stem}.csv").is_file():
            raise ChallengeError(f"{recordings / path.stem}.csv: not found; every key needs its recording")
        if sealed_path.exists():
            raise ChallengeError(f"{sealed_path}: is sealed already; commit only once, before any answer")
        file = sealed(key_of(path.read_bytes(), path.name))
        sealed_path.write_bytes(file)
        seals[path.stem] = seal_of(file)
    if not seals:
        raise ChallengeError(f"{keys}: holds no key NAME.json; see docs/proof.md for the layout")
    return _published(recordings, seals)


Runner = Callable[..., Iterator[tuple[str, str]]]


@contextmanager
def _case_mapper(jobs: int) -> Iterator[Runner]:
    if jobs <= 1:
        yield map
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield pool.map


def _write_case(work: tuple[Design, int, int, Path, Path]) -> tuple[str, str]:
    design, seed, index, recordings, keys = work
    name = f"r{index + 1:04d}"
    case = make_case(design, seed, index)
    _write_files(recordings, name, case)
    file = sealed(case.key)
    (keys / f"{name}.key").write_bytes(file)
    return name, seal_of(file)


def _write_files(folder: Path, name: str, case: Case) -> None:
    write_recording(folder / f"{name}.csv", case.recording)
    if case.simulation is not None:
        write_recording(folder / f"{name}{SIMULATION}", case.simulation)
    if case.phone is not None and case.fresh is not None:
        (folder / f"{name}{PHONE}").write_text(case.phone, encoding="utf-8")
        write_recording(folder / f"{name}{FRESH}", case.fresh)


def write_recording(path: Path, recording: MadeRecording) -> None:
    """Write a recording in the documented layout, with the digits that loggers write."""
    accel = _shortened(recording.accelerometer)
    gyro = None if recording.gyroscope is None else _shortened(recording.gyroscope)
    with TraceWriter(
        path,
        gyroscope=gyro is not None,
        temperature=accel.temperature is not None,
        arrival=accel.t_arrival is not None,
        claims=recording.claims,
    ) as writer:
        writer.write(accel, gyro, recording.events)


def _shortened(samples: Samples) -> Samples:
    """Round stamps to microseconds, values to 1e-7, temperatures to a thousandth."""
    temperature, arrival = samples.temperature, samples.t_arrival
    return Samples(
        samples.sensor,
        frozen(samples.t.round(6)),
        frozen(samples.xyz.round(7)),
        None if temperature is None else frozen(temperature.round(3)),
        None if arrival is None else frozen(arrival.round(6)),
    )


def read_manifest(recordings: Path) -> Manifest:
    """Read a challenge's manifest. Raises ChallengeError where there is none, or it does not fit."""
    path = recordings / "manifest.json"
    try:
        return msgspec.json.decode(path.read_bytes(), type=Manifest)
    except FileNotFoundError:
        raise ChallengeError(f"{path}: not found; name the folder of the blind test's recordings") from None
    except msgspec.DecodeError as error:
        raise ChallengeError(f"{path}: {error}; see docs/proof.md for its layout") from None
