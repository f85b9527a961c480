"""What `make run` runs, and `stillcal simulate`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.daemon.cli import cli
from stillcal.daemon.demo import demo


def test_the_demo_finds_the_simulated_phone_and_prints_the_real_ones(tmp_path: Path) -> None:
    result = CliRunner().invoke(demo, ["--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    store = json.loads((tmp_path / "out" / "store.json").read_text())
    truth = json.loads((tmp_path / "out" / "phone.truth.json").read_text())
    bias_error = np.array(store["accelerometer"]["bias"]) - truth["accelerometer"]["bias"]
    # Single rests of 20 s stand within 0.1 mg (150 ug/sqrt(Hz), 0.06 mg of wander); five times that.
    assert np.abs(bias_error).max() < 5 * 0.1e-3 * 9.81
    assert "beside the truth" in result.output and result.output.count("rows of a rest table") == 3


def test_the_same_seed_writes_the_same_recording(tmp_path: Path) -> None:
    for name in ("a", "b"):
        out = str(tmp_path / f"{name}.csv")
        assert CliRunner().invoke(cli, ["simulate", "lab", "--out", out, "--seed", "4"]).exit_code == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert json.loads((tmp_path / "a.json").read_text())["nominal_rate_hz"] == 100


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["nowhere"], "nowhere"), (["lab", "--phone", "no-such-phone"], "no-such-phone")],
)
def test_what_cannot_be_simulated_is_refused_by_name(tmp_path: Path, arguments: list[str], said: str) -> None:
    out = tmp_path / "x.csv"
    result = CliRunner().invoke(cli, ["simulate", *arguments, "--out", str(out)])
    assert result.exit_code == 2 and said in result.output
    assert not list(tmp_path.iterdir())
