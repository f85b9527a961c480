"""Real recordings through the command line, end to end, and what is left on rests held out."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from msgspec import structs

from stillcal.calib_core.calibration.rest_pool import HeldRest
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import forces
from stillcal.daemon.cli.main import cli
from stillcal.replay.formats.trace import open_trace
from stillcal.replay.runner import replay
from stillcal.replay.studies.real_recordings import split_rests

MG = 9.80665e-3


def replayed(path: Path, format: str, out: Path) -> dict[str, Any]:
    """Return what `stillcal replay --json` says of a recording, the units' standard gravity its own."""
    words = ["replay", path, "--format", format, "--json", out, "--quiet"]
    done = CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(out.read_text())
    return found


def residuals(found: dict[str, Any]) -> np.ndarray:
    """Return | |scale @ (raw - bias)| - g | over all rests that the JSON names, m/s^2."""
    part = found["accelerometer"]
    raw = np.array([s["specific_force"] for s in found["states"]])
    norms = np.linalg.norm((raw - part["bias"]) @ np.array(part["scale"]).T, axis=1)
    return norms - part["gravity"]


def test_imu_tk(data_dir: Path, tmp_path: Path) -> None:
    """Tedaldi et al. 2014: hand-placed poses after fifty seconds of rest."""
    found = replayed(data_dir / "imu_tk/xsens_acc.mat.gz", "imu_tk", tmp_path / "c.json")
    accel, gyro = found["accelerometer"], found["gyroscope"]
    assert accel["parameters"] == 9
    assert accel["n_rests"] == len(found["states"]) >= 35
    assert accel["n_states"] == len({s["attitude"] for s in found["states"]}) >= 12
    assert rms(residuals(found)) == pytest.approx(accel["rms_residual"], rel=1e-9)
    assert accel["rms_residual"] <= 0.12 * MG
    assert gyro["parameters"] == 12
    assert gyro["rms_nominal"] >= 10 * gyro["rms_residual"]


@pytest.mark.parametrize("name", ["imu0", "imu1", "imu2"])
def test_mikoff(data_dir: Path, tmp_path: Path, name: str) -> None:
    found = replayed(data_dir / f"mikoff/{name}.log", "mikoff", tmp_path / "c.json")
    assert found["accelerometer"]["parameters"] == 9
    assert rms(residuals(found)) == pytest.approx(found["accelerometer"]["rms_residual"], rel=1e-9)
    assert found["accelerometer"]["rms_residual"] <= 0.45 * MG


def faultless(held: list[HeldRest], model: SensorModel, rng: np.random.Generator) -> list[HeldRest]:
    """Return the same rests as a sensor would give them that the model fits but for white noise of 0.1 mg."""
    calibrated = model.apply(forces([h.rest for h in held]))
    norms = np.array([h.gravity.value for h in held]) / np.linalg.norm(calibrated, axis=1)
    raw = (calibrated * norms[:, None]) @ np.linalg.inv(model.scale).T + model.bias
    raw += rng.normal(0, 0.1 * MG, raw.shape)
    return [
        replace(h, rest=structs.replace(h.rest, specific_force=f)) for h, f in zip(held, raw, strict=True)
    ]


@pytest.mark.slow
def test_imu_tk_held_out(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rests held out are foretold as well as 40 rests in 16 attitudes allow.

    Wanted were odd and even rests within 1.3 times of the fitted ones. Nine parameters on twenty rests in
    eleven or twelve attitudes leave the fitted residuals too small and the others too large: a sensor
    without any fault but white noise, at rest in the same attitudes, comes out at 2.0 in the median and
    seldom below 1.35. So the measure here is what such a sensor does.
    """
    engine = Engine()
    trace = open_trace(data_dir / "imu_tk/xsens_acc.mat.gz", "imu_tk")
    record = replay(trace.chunks(), engine, lambda action: None).record
    assert record is not None and record.accelerometer is not None
    held, rng = list(engine.state.pool.held), np.random.default_rng(1)
    for name, folds, trials in (("odd and even", 2, 100), ("one by one", len(held), 20)):
        found = split_rests(held, 9, folds)
        others = [faultless(held, record.accelerometer.model, rng) for _ in range(trials)]
        expected = [s.ratio for rests in others if (s := split_rests(rests, 9, folds))]
        low, median, high = np.quantile(expected, [0.025, 0.5, 0.975])
        assert found is not None
        with capsys.disabled():
            print(
                f"\nimu_tk, rests held out {name}: {found.ratio:.2f} times the fitted ones; a faultless "
                f"sensor {median:.2f} ({low:.2f} to {high:.2f}); wanted 1.3"
            )
        assert found.ratio <= high


def test_a_rest_table_of_a_published_phone(tmp_path: Path) -> None:
    """ESGI'95, table 1: twenty positions of a phone, no uncertainties, no gyroscope."""
    with as_file(files("stillcal.config") / "esgi" / "dataset1.csv") as path:
        found = replayed(path, "rest", tmp_path / "c.json")
    assert found["gyroscope"] is None
    assert found["accelerometer"]["n_rests"] == len(found["states"])
    assert found["accelerometer"]["rms_residual"] < 0.1
