"""The diagnosis of what the daemon has kept, at night on the charger, in a process of its own.

The process is `stillcal diagnose store.state`: it reads the rests kept (calib_core/temperature/memory.py)
from the saved state, so that the daemon loads nothing of the diagnosis. Its processor time and memory are
measured while it runs; it is ended where it takes more than its budget.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from stillcal.daemon.settings import DiagnosisSettings
from stillcal.daemon.system.memory import process_usage

LEAST_RESTS = 30
"""Fewer rests than this are not worth a diagnosis: some are needed for each of its effects."""

MEASURED_EVERY_S = 0.25
NICENESS = 15
_MIB = 2**20
_PROGRAM = "from stillcal.daemon.cli.entry import main; main()"


class _Finding(msgspec.Struct):
    """What is read of a finding; the rest is kept as it came."""

    effect: str
    sensor: str
    axes: list[str]
    statement: str
    probability: float | None


class _Answer(msgspec.Struct):
    """What is read of `diagnose --json`."""

    verdict: str
    findings: list[_Finding]


@dataclass(frozen=True, slots=True)
class NightReport:
    """The newest self-diagnosis. at: s of engine time, when it was tried; None before the first.

    rests: that it saw. verdict: as `diagnose --json` has it. findings: of the same, each as JSON. trouble:
    why there is no result, empty where there is one; findings and verdict are then those of the one before.
    processor_s, memory_bytes: what it took.
    """

    at: float | None = None
    rests: int = 0
    verdict: str = ""
    findings: tuple[str, ...] = ()
    trouble: str = ""
    processor_s: float = 0.0
    memory_bytes: int = 0

    @property
    def headline(self) -> str:
        """What it found, in a few words."""
        if self.findings:
            return f"{len(self.findings)} found, told in the next lines"
        if self.verdict == "not_judged":
            return "no result: too few of the checks could be made with these rests"
        return "nothing found beyond constant bias and scale, nothing to do"

    def read(self) -> list[dict[str, Any]]:
        """Return the findings as plain values."""
        return [msgspec.json.decode(finding) for finding in self.findings]


@dataclass(slots=True)
class Night:
    """Tells when a self-diagnosis is due. plugged_at: s, since when the phone is on the charger."""

    plugged_at: float | None = None

    def is_due(
        self, now: float, charging: bool | None, rests: int, last: NightReport, settings: DiagnosisSettings
    ) -> bool:
        """Tell at `now` (s) whether it is due. rests: kept by now; last: the newest report."""
        if not charging:
            self.plugged_at = None
            return False
        self.plugged_at = now if self.plugged_at is None else min(self.plugged_at, now)
        rested = last.at is None or not 0.0 <= now - last.at < settings.every_s
        long_enough = now - self.plugged_at >= settings.charging_s
        return settings.at_night and long_enough and rested and rests >= LEAST_RESTS


class DiagnosisError(RuntimeError):
    """There is no result; the message says why."""


@dataclass(slots=True)
class _Usage:
    """What a process has taken so far, and where that is too much."""

    processor_s: float = 0.0
    memory_bytes: int = 0

    def measure(self, pid: int) -> None:
        """Take the present figures of a process, or none where it has just ended."""
        with contextlib.suppress(OSError, IndexError):
            self.processor_s, resident = process_usage(pid)
            self.memory_bytes = max(self.memory_bytes, resident)

    def beyond(self, settings: DiagnosisSettings) -> str:
        """Return which part of the budget is used up, empty where none is."""
        if self.processor_s > settings.processor_s:
            return f"it took more than {settings.processor_s:g} s of processor"
        if self.memory_bytes > settings.memory_mib * _MIB:
            return f"it took more than {settings.memory_mib:g} MiB of memory"
        return ""


async def diagnose(state: Path, settings: DiagnosisSettings, at: float, rests: int) -> NightReport:
    """Diagnose the rests in a saved state. at: s, for the report; rests: kept. Never raises on a failure."""
    usage = _Usage()
    try:
        answer = await _answer(state, settings, usage)
        trouble, verdict = "", str(answer["verdict"])
        findings = tuple(msgspec.json.encode(finding).decode() for finding in answer["findings"])
    except DiagnosisError as error:
        trouble, verdict, findings = str(error), "", ()
    return NightReport(at, rests, verdict, findings, trouble, usage.processor_s, usage.memory_bytes)


async def _answer(state: Path, settings: DiagnosisSettings, usage: _Usage) -> dict[str, Any]:
    """Run the process and return its answer. usage: takes what it took. Raises DiagnosisError."""
    command = [sys.executable, "-P", "-c", _PROGRAM, "diagnose", str(state), "--json", "-", "--quiet"]
    environ = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    pipe = asyncio.subprocess.PIPE
    try:
        child = await asyncio.create_subprocess_exec(*command, stdout=pipe, stderr=pipe, env=environ)
    except OSError as error:
        raise DiagnosisError(f"its process cannot be started: {error.strerror}") from error
    with contextlib.suppress(OSError):  # the hardened unit forbids it, and is nice itself
        os.setpriority(os.PRIO_PROCESS, child.pid, NICENESS)
    ended = asyncio.ensure_future(child.communicate())
    try:
        while not ended.done():
            await asyncio.wait([ended], timeout=MEASURED_EVERY_S)
            usage.measure(child.pid)
            if over := usage.beyond(settings):
                raise DiagnosisError(f"it was ended: {over}")
        output, complaint = ended.result()
    finally:
        if not ended.done():
            with contextlib.suppress(ProcessLookupError):
                child.kill()
            await ended
    if child.returncode:
        raise DiagnosisError(_last_line(complaint) or f"its process ended with {child.returncode}")
    try:
        answer: dict[str, Any] = msgspec.json.decode(output)
        msgspec.convert(answer, _Answer)
    except msgspec.MsgspecError as error:  # another version was installed while this one runs
        raise DiagnosisError(f"its answer makes no sense here: {error}") from error
    return answer


def _last_line(text: bytes) -> str:
    lines = text.decode(errors="replace").strip().splitlines()
    return lines[-1].removeprefix("stillcal: ") if lines else ""
