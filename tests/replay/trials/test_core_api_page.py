"""docs/api.md is what the core says of itself, and its example calibrates."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.daemon.cli.main import cli
from stillcal.replay.trials.pages.core_api import HEAD, MODULES, page

PAGE = Path(__file__).parents[3] / "docs" / "api.md"


def test_the_page_is_what_the_core_says() -> None:
    remedy = "run: python -m stillcal.replay.trials.pages.core_api > docs/api.md"
    assert PAGE.read_text() == page() + "\n", remedy


def test_every_entry_says_what_it_is() -> None:
    sections = re.split(r"^## ", page(), flags=re.MULTILINE)[1:]
    assert [section.split("\n")[0] for section in sections] == list(MODULES)
    for section in sections:
        entries = re.split(r"^### ", section, flags=re.MULTILINE)[1:]
        assert entries
        for entry in entries:
            prose = re.sub(r"```.*?```", "", entry, flags=re.DOTALL)
            assert len(prose) > 20, entry


def test_the_example_finds_the_bias(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A phone calibrated by hand; g is 9.81 in the example and 9.8126 where the simulated one lies."""
    monkeypatch.chdir(tmp_path)
    made = CliRunner().invoke(cli, ["simulate", "lab", "--out", "walk.csv", "--truth", "truth.json"])
    assert made.exit_code == 0
    (code,) = re.findall(r"^```python\n(.*?)^```$", HEAD, re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    exec(code, names)
    truth = json.loads((tmp_path / "truth.json").read_text())["accelerometer"]["bias"]
    assert names["calibration"].model.bias == pytest.approx(truth, abs=0.003)
    assert names["true"].shape == (len(names["recording"].accelerometer.t), 3)
    assert np.median(np.linalg.norm(names["true"], axis=1)) == pytest.approx(9.81, abs=0.01)
