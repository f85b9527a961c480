"""The notebooks in examples/ run as they stand, and show what they say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = Path(__file__).parents[1] / "examples"


def run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Run a notebook's code cells one after another, and return what they define."""
    pytest.importorskip("matplotlib", reason="the extra report").use("Agg")
    monkeypatch.chdir(folder)
    notebook = json.loads((NOTEBOOKS / name).read_text())
    assert (notebook["nbformat"], {cell["cell_type"] for cell in notebook["cells"]}) == (
        4,
        {"code", "markdown"},
    )
    defined: dict[str, Any] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert not cell["outputs"], "notebooks are kept without outputs, which grow old"
            exec("".join(cell["source"]), defined)
    return defined


def test_a_recording_is_calibrated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    defined = run("calibrate_recording.ipynb", tmp_path, monkeypatch)
    assert defined["error_after"] < 0.05 * defined["error_before"]
    assert {"store.json", "lab-calibrated.csv"} <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.slow
def test_a_simulator_is_compared_with_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    defined = run("compare_simulator.ipynb", tmp_path, monkeypatch)
    before, after = (
        {(finding["effect"], finding["sensor"]) for finding in defined[name].findings}
        for name in ("answer", "worse")
    )
    assert after - before >= {("noise_level", "accel")}


def test_no_notebook_is_left_out() -> None:
    assert {p.name for p in NOTEBOOKS.glob("*.ipynb")} == {
        "calibrate_recording.ipynb",
        "compare_simulator.ipynb",
    }
