"""Each fuzz target takes its good inputs and a round of changed ones; inputs that once failed stay tried."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from stillcal.replay.export.targets import INVERTIBLE, target_named
from tests.fuzz.__main__ import MOST_MEMORY, TARGETS, feed_within, fuzzed, main, peak_bytes
from tests.fuzz.target import Target, any_of

CORPUS = Path(__file__).parents[1] / "corpus"


@pytest.mark.parametrize("name", TARGETS)
def test_good_inputs_and_a_round_of_changed_ones(name: str) -> None:
    tried, failed = fuzzed(TARGETS[name], 0.0, 7, examples=20)
    assert failed is None and tried >= 10


KEPT = sorted(path for path in CORPUS.glob("*/*") if path.is_file())


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_what_once_failed_no_longer_does(path: Path) -> None:
    """Neither by what it raises, nor by its time, nor by its memory."""
    room = peak_bytes() + MOST_MEMORY
    feed_within(TARGETS[path.parent.name], path.read_bytes(), room)
    assert peak_bytes() <= room


def test_a_target_that_fails_is_found_out_and_its_least_input_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def feed(data: bytes) -> None:
        assert b"\0" not in data

    monkeypatch.setitem(TARGETS, "store", Target(lambda: [b"seed"], feed))
    ran = CliRunner().invoke(main, ["--seconds", "0", "--target", "store", "--corpus", str(tmp_path)])
    assert ran.exit_code == 1 and "FAILED" in ran.output
    (kept,) = (tmp_path / "store").iterdir()
    assert kept.read_bytes() == b"\0"


@pytest.mark.parametrize("tool", INVERTIBLE)
def test_the_seeds_of_other_tools_are_read_back_whatever_they_hold(tool: str) -> None:
    for data in TARGETS[f"import-{tool}"].seeds():
        read = target_named(tool).read(data)
        assert read.accelerometer is not None


def test_the_first_byte_chooses_among_parsers_that_share_a_reader() -> None:
    fed: list[tuple[int, bytes]] = []

    def part(i: int) -> Target:
        return Target(lambda: [b"seed"], lambda data: fed.append((i, data)))

    both = any_of([part(0), part(1)])
    for data in [*both.seeds(), b"", b"\xff\0"]:
        both.feed(data)
    assert fed == [(0, b"seed"), (1, b"seed"), (1, b"\0")]


# Beyond what the process has ever taken, since it is its peak that is watched.
@pytest.mark.parametrize(
    "feed", [lambda data: time.sleep(10), lambda data: bytearray(peak_bytes() + (60 << 20))]
)
def test_an_input_that_takes_long_or_much_memory_fails(
    feed: Callable[[bytes], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.fuzz.__main__.SLOWEST_S", 1)
    monkeypatch.setattr("tests.fuzz.__main__.MOST_MEMORY", 1 << 20)
    fed: list[bytes] = []

    def after_the_seed(data: bytes) -> None:
        fed.append(data)
        if len(fed) > 1:
            kept.append(feed(data))

    kept: list[object] = []
    tried, failed = fuzzed(Target(lambda: [b"seed"], after_the_seed), 0.0, 1, examples=5)
    assert tried >= 1 and failed is not None
