"""Recordings made once for all tests of the report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.diagnosis.phone.case import Case, case_of
from stillcal.replay.formats.trace import Recording
from stillcal.replay.formats.writer import TraceWriter
from tests.support.report_days import phone_with, recorded


@pytest.fixture(scope="session")
def recording() -> Callable[..., Recording]:
    """Give recordings of a phone with the effects named, by seed."""
    made: dict[str, Recording] = {}

    def of(*effects: Mapping[str, Any], seed: int = 3) -> Recording:
        key = repr((effects, seed))
        if key not in made:
            made[key] = recorded(phone_with(*effects), seed)
        return made[key]

    return of


def diagnosed(recording: Recording) -> Case:
    """Return a recording's case."""
    exam = examined(recording)
    return case_of(recording, exam, compare_with_ideal(exam))


@pytest.fixture(scope="session")
def case_with(recording: Callable[..., Recording]) -> Callable[..., Case]:
    """Give diagnosed recordings of a phone with the effects named."""
    made: dict[str, Case] = {}

    def of(*effects: Mapping[str, Any]) -> Case:
        if repr(effects) not in made:
            real = recording(*effects)
            made[repr(effects)] = diagnosed(real)
        return made[repr(effects)]

    return of


def _write(recording: Recording, path: Path) -> Path:
    with TraceWriter(path, temperature=True, arrival=True, claims=recording.claims) as writer:
        writer.write(recording.accelerometer, recording.gyroscope, tuple(recording.events))
    return path


@pytest.fixture
def written(tmp_path: Path) -> Callable[[Recording, str], Path]:
    """Give a function that writes a recording as a file."""
    return lambda recording, name: _write(recording, tmp_path / name)
