"""The fault figures' command, in small, and that it can fail."""

from __future__ import annotations

import re

import pytest
from click.testing import CliRunner

from stillcal.daemon.wire import cobs as wire_cobs
from stillcal.replay.trials.faults import wire as wire_faults


def test_the_command_counts_and_holds() -> None:
    run = CliRunner().invoke(wire_faults.main, ["--bytes", "100000", "--flips", "300", "--times", "5"])
    assert run.exit_code == 0, run.output
    assert run.output.count("holds") == 3
    assert re.search(r"damaged and delivered +0$", run.output, re.MULTILINE)


def test_a_wire_without_a_crc_does_not_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire_cobs.zlib, "crc32", lambda data: 0)
    assert not wire_faults.flipped_bits(300, 1).holds
