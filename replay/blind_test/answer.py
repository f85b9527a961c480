"""Answering a blind test, in a process of its own that can read the recordings' folder only.

`python -m stillcal.replay.blind_test.answer SOLVER OUT NAME...`, run inside the recordings' folder, writes
OUT/NAME.json for each; with NAME=EFFECT that entry is removed from the catalogue first. Solvers are the
diagnosis and the two baselines. Only this module of the blind test calls the diagnosis, and it loads nothing
that could make or open a key.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import IO, Any

import msgspec

from stillcal import calib_core, config, daemon, replay
from stillcal.calib_core.codec import jsonable
from stillcal.calib_core.errors import NotSupported
from stillcal.replay.formats.trace import read_all
from stillcal.replay.phone.phone import dump_phone, load_phone

SOLVERS = ("diagnosis", "affine_coloured_bic", "sparse_regression")
"""The solvers by name."""

SIMULATION, PHONE, FRESH = ".sim.csv", ".phone.toml", ".fresh.csv"
"""Ends of the names of what may lie beside NAME.csv: a simulation to be judged; or a phone file to be judged
and written back, and the fresh day that the phone written back is compared with."""

_MODULE = "stillcal.replay.blind_test.answer"


class AnswerError(RuntimeError):
    """An answering process failed; the message has its last line of output."""


def answer_one(
    folder: Path, name: str, solver: str = "diagnosis", without: str | None = None
) -> dict[str, Any]:
    """Return the answer to the recording folder/NAME.csv, in the documented layout.

    without: an effect to be removed from the diagnosis' catalogue. The verdict is `too_little_data` where
    there is too little data, and `failed` where the solver raises another error.
    """
    try:
        if (folder / f"{name}{SIMULATION}").is_file():
            return _simulation_judged(folder, name)
        if (folder / f"{name}{PHONE}").is_file():
            return _phone_written_back(folder, name)
        recording = read_all(folder / f"{name}.csv")
        if solver == "diagnosis":
            from stillcal.replay.diagnosis.diagnose import diagnose_recording  # noqa: PLC0415 - baselines do without it

            return diagnose_recording(recording, f"{name}.csv", without)
        from stillcal.replay.blind_test import baselines  # noqa: PLC0415 - the diagnosis does without them

        return baselines.SOLVERS[solver](recording, f"{name}.csv")
    except NotSupported as error:
        return _without_findings(name, "too_little_data", error)
    except Exception as error:  # a solver that breaks has answered wrongly; its other answers still count
        return _without_findings(name, "failed", error)


def answerable(folder: Path, names: Iterable[str], solver: str) -> list[str]:
    """Return the recordings that a solver can answer: the baselines none that a simulation lies beside."""
    return [
        name
        for name in names
        if solver == SOLVERS[0] or not any((folder / f"{name}{end}").is_file() for end in (SIMULATION, PHONE))
    ]


def _simulation_judged(folder: Path, name: str) -> dict[str, Any]:
    """Return the answer to a recording and a simulation of it."""
    from stillcal.replay.diagnosis.diagnose import Request, diagnose  # noqa: PLC0415 - baselines do without it

    real, simulation = read_all(folder / f"{name}.csv"), read_all(folder / f"{name}{SIMULATION}")
    return diagnose(real, Request(simulated=simulation)).judged.answer


def _phone_written_back(folder: Path, name: str) -> dict[str, Any]:
    """Return the answer to a fresh day and the phone file as the first day's diagnosis corrects it.

    Its field `first` is the answer to the first day and the phone file as it was given.
    """
    from stillcal.replay.diagnosis.diagnose import Request, diagnose  # noqa: PLC0415 - baselines do without it
    from stillcal.replay.export.fix.fixers import fixed_for  # noqa: PLC0415 - the same
    from stillcal.replay.export.fix.phone import phone_from  # noqa: PLC0415 - the same

    given = load_phone(folder / f"{name}{PHONE}")
    first = diagnose(read_all(folder / f"{name}.csv"), Request(phone=given, phone_name="given")).judged.answer
    better = phone_from(fixed_for("phone", dump_phone(given), first).text)
    fresh = diagnose(read_all(folder / f"{name}{FRESH}"), Request(phone=better, phone_name="written back"))
    return fresh.judged.answer | {"first": first}


def _without_findings(name: str, verdict: str, error: Exception) -> dict[str, Any]:
    why = f"{type(error).__name__}: {error}"
    return {"schema": 2, "recording": f"{name}.csv", "verdict": verdict, "findings": [], "why": why}


def _confine(folders: Sequence[Path]) -> None:
    """Refuse, for the rest of this process, to open files outside `folders` and Python's own.

    This prevents reading a key by mistake or on purpose from Python code; it is no sandbox for other code.
    """
    code = [*map(Path, sys.path), Path(sys.prefix), Path(sys.base_prefix)]
    layers = (calib_core.__file__, config.__file__, daemon.__file__, replay.__file__)
    code += [Path(file).parent for file in layers]
    allowed = tuple(
        f"{folder.resolve()}{os.sep}" for folder in (*folders, *code) if str(folder) not in ("", ".")
    )

    def fence(event: str, arguments: tuple[Any, ...]) -> None:
        if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], str | bytes):
            path = os.path.realpath(os.fsdecode(arguments[0]))
            if not f"{path}{os.sep}".startswith((*allowed, "/dev/", "/proc/", "/sys/")):
                raise PermissionError(f"{path}: an answering process may read its recordings only")

    sys.addaudithook(fence)


def run(solver: str, out: Path, names: Sequence[str]) -> None:
    """Answer recordings of the working folder one after another; every answer file is written atomically."""
    _confine((Path.cwd(), out))
    for item in names:
        name, _, without = item.partition("=")
        temporary = out / f".{name}.part"
        answer = answer_one(Path(), name, solver, without or None)
        temporary.write_bytes(msgspec.json.encode(jsonable(answer)))
        temporary.replace(out / f"{name}.json")


def answer_all(
    recordings: Path,
    out: Path,
    names: Sequence[str],
    solver: str = "diagnosis",
    *,
    jobs: int = 1,
    tick: Callable[[int], None] = lambda done: None,
) -> None:
    """Answer in `jobs` separate processes that start in the recordings' folder with a minimal environment.

    tick: is called with the number of answers so far. Raises AnswerError where a process fails.
    """
    out = out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    shares = [list(names[i::jobs]) for i in range(jobs) if names[i::jobs]]
    with tempfile.TemporaryFile() as errors:
        running = [_started(recordings, out, share, solver, errors) for share in shares]
        _awaited(running, lambda: tick(len(list(out.glob("r*.json")))))
        errors.seek(0)
        last = (errors.read().decode(errors="replace").strip().splitlines() or ["no word"])[-1]
    if any(process.returncode != 0 for process in running):
        raise AnswerError(f"an answering process failed: {last}")
    tick(len(names))


def _awaited(running: list[subprocess.Popen[bytes]], tick: Callable[[], None]) -> None:
    """Wait until all processes have ended; none is left running after an error here."""
    try:
        while any(process.poll() is None for process in running):
            tick()
            time.sleep(0.2)
    finally:
        for process in running:
            process.kill()
            process.wait()


def _started(
    recordings: Path, out: Path, names: list[str], solver: str, errors: IO[bytes]
) -> subprocess.Popen[bytes]:
    environment = {
        k: v for k, v in os.environ.items() if k in ("PATH", "LANG", "VIRTUAL_ENV", "OPENBLAS_NUM_THREADS")
    }
    command = [sys.executable, "-P", "-m", _MODULE, solver, str(out), *names]
    return subprocess.Popen(command, cwd=recordings, env=environment, stderr=errors)


def read_answers(folder: Path, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the answers NAME.json in `folder` by name; recordings without an answer are left out."""
    answers = {}
    for name in names:
        path = folder / f"{name}.json"
        if path.is_file():
            answers[name] = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    return answers


if __name__ == "__main__":
    run(sys.argv[1], Path(sys.argv[2]), sys.argv[3:])
