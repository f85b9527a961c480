"""docs/api.md is what the core says of itself, and its example calibrates."""

from __future__ import annotations

import json
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

import stillcal
from stillcal import api
from stillcal.replay.trials.pages.core_api import HEAD, MODULES, PUBLIC, page

PAGE = Path(__file__).parents[3] / "docs" / "api.md"


def test_the_page_is_what_the_core_says() -> None:
    remedy = "run: python -m stillcal.replay.trials.pages.core_api > docs/api.md"
    assert PAGE.read_text() == page() + "\n", remedy


def test_every_entry_says_what_it_is() -> None:
    sections = re.split(r"^## ", page(), flags=re.MULTILINE)[1:]
    assert [section.split("\n")[0] for section in sections] == ["stillcal", *MODULES]
    for section in sections:
        entries = re.split(r"^### ", section, flags=re.MULTILINE)[1:]
        assert entries
        for entry in entries:
            prose = re.sub(r"```.*?```", "", entry, flags=re.DOTALL)
            assert len(prose) > 20, entry


def test_everything_public_is_on_the_page() -> None:
    assert set(PUBLIC) | {"__version__"} == set(stillcal.__all__)
    assert set(PUBLIC) == set(api.__all__)


@pytest.mark.slow
def test_the_example_finds_the_bias(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sample's true errors lie beside it; what stays of the bias is a few thousandths of it."""
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"^```python\n(.*?)^```$", HEAD, re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    exec(code, names)
    truth = json.loads((files("stillcal.config") / "samples" / "lab.truth.json").read_text())["accelerometer"]
    assert names["calibration"].accelerometer.bias == pytest.approx(truth["bias"], abs=0.003)
    assert [f["effect"] for f in names["diagnosis"].findings] == ["gyro_bias_temperature"]
    assert (tmp_path / "lab-calibrated.csv").is_file()
