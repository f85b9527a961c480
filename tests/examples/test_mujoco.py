"""The example with MuJoCo: the difference is found, the configuration corrected, the difference gone."""

from __future__ import annotations

import json
import runpy
import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from stillcal.daemon.cli.main import cli

EXAMPLE = Path(__file__).parents[2] / "examples" / "mujoco"


def stillcal(*words: str) -> Result:
    return CliRunner().invoke(cli, words, catch_exceptions=False)


def half_intervals(finding: dict[str, Any]) -> dict[str, np.ndarray]:
    """Half of the 95 % interval of each parameter's difference."""
    return {k: np.ptp(np.array(p["ci95"]), axis=-1) / 2.0 for k, p in finding["difference"].items()}


@pytest.mark.slow
def test_the_concealed_physics_is_found_put_in_and_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco", reason="the example needs MuJoCo: pip install 'stillcal[examples]'")
    shutil.copytree(EXAMPLE, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    play = runpy.run_path("play.py")["main"]
    stillcal("simulate", "motion.toml", "--phone", "real.toml", "--seed", "7", "--out", "real.csv", "--quiet")
    play("sensor.toml", "mujoco.csv")
    compare = ("diagnose", "real.csv", "--simulated", "mujoco.csv", "--quiet", "--json", "answer.json")
    first = stillcal(*compare, "--fix-for", "phone", "sensor.toml")
    assert first.exit_code == 0, first.output
    answer = json.loads(Path("answer.json").read_text())
    concealed = {"gyro_bias", "gyro_bias_temperature", "gyro_g_sensitivity"}
    assert {f["effect"] for f in answer["findings"]} == concealed
    assert answer["verdict"] == "identified"
    found, real = (tomllib.loads(Path(name).read_text()) for name in ("sensor.toml", "real.toml"))
    effects = [{e["name"]: e for e in phone["effect"]} for phone in (found, real)]
    halves = {f["effect"]: half_intervals(f) for f in answer["findings"]}
    for name, parameter in (("gyro_bias_temperature", "slope"), ("gyro_g_sensitivity", "matrix")):
        one, other = (np.array(e[name][parameter]) for e in effects)
        assert (np.abs(one - other) <= halves[name][parameter]).all()
    [slope] = [f for f in answer["findings"] if f["effect"] == "gyro_bias_temperature"]
    away = abs(slope["reference"]["temperature_c"] - 25.0)
    room = halves["gyro_bias"]["bias"] + away * halves["gyro_bias_temperature"]["slope"]
    assert (np.abs(np.subtract(found["gyro"]["bias"], real["gyro"]["bias"])) <= room).all()
    play("sensor.toml", "mujoco.csv", 2)
    second = stillcal(*compare)
    assert second.exit_code == 0, second.output
    answer = json.loads(Path("answer.json").read_text())
    assert (answer["verdict"], answer["findings"]) == ("match", [])
