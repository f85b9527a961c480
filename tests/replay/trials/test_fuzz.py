"""Each fuzz target takes its good inputs and a round of changed ones; inputs that once failed stay tried."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from stillcal.replay.trials import fuzz
from stillcal.replay.trials.fuzz import TARGETS, Target, fuzzed

CORPUS = Path(__file__).parents[2] / "corpus"


@pytest.mark.parametrize("name", TARGETS)
def test_good_inputs_and_a_round_of_changed_ones(name: str) -> None:
    for data in TARGETS[name].seeds():
        TARGETS[name].feed(data)
    tried, failed = fuzzed(TARGETS[name], 0.0, 7, examples=20)
    assert failed is None and tried >= 10


KEPT = sorted(path for path in CORPUS.glob("*/*") if path.is_file())


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_what_once_failed_no_longer_does(path: Path) -> None:
    TARGETS[path.parent.name].feed(path.read_bytes())


def test_a_target_that_fails_is_found_out_and_its_least_input_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def feed(data: bytes) -> None:
        assert b"\0" not in data

    monkeypatch.setitem(TARGETS, "store", Target(lambda: [b"seed"], feed))
    ran = CliRunner().invoke(fuzz.main, ["--seconds", "0", "--target", "store", "--corpus", str(tmp_path)])
    assert ran.exit_code == 1 and "FAILED" in ran.output
    (kept,) = (tmp_path / "store").iterdir()
    assert kept.read_bytes() == b"\0"
