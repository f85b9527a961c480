"""The page docs/readers.md, against what the readers make of the recordings now."""

from __future__ import annotations

from pathlib import Path

import pytest

from stillcal.replay.studies.claim import table
from tests.support.readers import COPIES, REAL, REAL_HEAD, copy_rows, real_row

PAGE = (Path(__file__).parents[3] / "docs" / "readers.md").read_text()


@pytest.mark.parametrize("name", ["px4/sample_log_small.ulg", "axivity/ax6_testfile.cwa", "mikoff/imu0.log"])
def test_rows_of_real_recordings_are_what_is_read_now(data_dir: Path, name: str) -> None:
    assert table(REAL_HEAD, [real_row(data_dir, name)]).splitlines()[-1] in PAGE.splitlines()


def test_every_real_recording_and_every_copy_has_a_row() -> None:
    assert all(f"| `{name}` |" in PAGE for name in REAL)
    assert all(f"| {name} |" in PAGE for name in COPIES)


def test_every_copy_is_read_as_the_original(data_dir: Path) -> None:
    for _, _, samples, difference, _ in copy_rows(data_dir / "mikoff/imu0.log", lambda _: ""):
        assert samples.startswith("15,969 in 160 s")
        assert float(difference) < 2e-6  # DataFlash keeps 24 bits
