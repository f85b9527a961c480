"""Physics of the user's own: a class in another package is found, reported, written back and listed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

PACKAGE = '''
"""The gyroscope's bias swings with an air conditioner that blows every ten minutes."""

import numpy as np

from stillcal.calib_core.diagnosis.model.effect import Effect, Linear, on_axes


class Breeze(Effect):
    name = "gyro_bias_breeze"
    sensor = "gyro"
    follows = "the air conditioner"
    parameters = (Linear("swing", "rad/s", 3, 0.002),)
    sentence = "The gyroscope's bias swings with the air conditioner on {axes}."
    equation = "bias(t) = bias + swing sin(2 pi t / 600 s)"
    remedy = "switch the air conditioner off"

    def response(self, moments, grid):
        return on_axes(np.sin(2.0 * np.pi * moments.age / 600.0))
'''
SWING = 6e-4


def installed(folder: Path, value: str = "breeze:Breeze") -> dict[str, str]:
    """Install a package of one module beside stillcal, and return an environment that has it."""
    (folder / "breeze.py").write_text(PACKAGE)
    info = folder / "breeze-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: breeze\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[stillcal.effects]\ngyro_bias_breeze = {value}\n")
    return os.environ | {"PYTHONPATH": str(folder)}


def stillcal(environment: dict[str, str], *words: object) -> subprocess.CompletedProcess[str]:
    program = "from stillcal.daemon.cli.entry import main; main()"
    command = [sys.executable, "-c", program, *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten rests of two minutes at 20 Hz, the phone turned in hand between them."""
    rng, rate_hz = np.random.default_rng(8), 20.0
    turned = []
    for _ in range(10):
        turned.append(np.zeros((int(120 * rate_hz), 3)))
        s = np.arange(int(3 * rate_hz)) / (3 * rate_hz)
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        turned.append(axis * (rng.uniform(0.8, 2.5) / 3.0 * (1.0 - np.cos(2.0 * np.pi * s)))[:, None])
    rate = np.concatenate(turned)
    up, ups = np.array([0.0, 0.0, 1.0]), np.empty_like(rate)
    for i, step in enumerate(Rotation.from_rotvec(rate / rate_hz).as_matrix()):
        ups[i] = up
        up = step.T @ up
    t = np.arange(len(rate)) / rate_hz
    moving = np.linalg.norm(rate, axis=1) > 0.05
    force = 9.80665 * ups + rng.normal(size=rate.shape) * np.where(moving, 0.3, 0.01)[:, None]
    swing = np.outer(np.sin(2.0 * np.pi * t / 600.0), [SWING, 0.0, -SWING])
    middle = (rate + np.vstack([rate[:1], rate[:-1]])) / 2.0
    read = middle + swing + rng.normal(size=rate.shape) * 0.001
    path = tmp_path_factory.mktemp("room") / "room.csv"
    rows = np.column_stack([t, force, read])
    np.savetxt(path, rows, delimiter=",", fmt="%.7g", header="t,ax,ay,az,gx,gy,gz", comments="")
    return path


@pytest.mark.slow
def test_a_class_of_another_package_is_found_reported_and_written_back(
    tmp_path: Path, recording: Path
) -> None:
    (tmp_path / "site").mkdir()
    environment = installed(tmp_path / "site")
    answer, page, phone = (tmp_path / name for name in ("answer.json", "page.html", "phone.toml"))
    done = stillcal(
        environment, "diagnose", recording, "--json", answer, "--report", page, "--phone-out", phone
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(answer.read_text())
    assert [f["effect"] for f in said["findings"]] == ["gyro_bias_breeze"]
    assert said["verdict"] == "identified"
    swing = said["findings"][0]["parameters"]["swing"]["value"]
    assert swing == pytest.approx([SWING, 0.0, -SWING], abs=6e-5)
    assert "air conditioner" in done.stdout
    assert "air conditioner" in page.read_text()
    written = phone.read_text()
    assert "gyro_bias_breeze" in written

    played = tmp_path / "played.csv"
    again = stillcal(environment, "simulate", "tables", "--out", played, "--phone", phone)
    assert again.returncode == 0, again.stderr
    without = stillcal(os.environ | {}, "simulate", "tables", "--out", tmp_path / "no.csv", "--phone", phone)
    assert without.returncode == 2
    assert "no installed package has the effect 'gyro_bias_breeze'" in without.stderr


def test_an_entry_point_that_cannot_be_loaded_is_told_in_one_line(tmp_path: Path, recording: Path) -> None:
    (tmp_path / "site").mkdir()
    environment = installed(tmp_path / "site", "breeze:Missing")
    done = stillcal(environment, "diagnose", recording)
    assert done.returncode == 2
    assert "the effect gyro_bias_breeze (breeze:Missing) cannot be loaded" in done.stderr
    assert done.stderr.count("\n") == 1
