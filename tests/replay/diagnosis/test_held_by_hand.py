"""Calibrations by hand: rests of some seconds in many attitudes, compared as they are calibrated."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import stillcal
from stillcal.calib_core.streams.samples import Samples
from stillcal.daemon.cli.main import cli
from stillcal.replay.phone import load_phone, simulate
from stillcal.replay.phone.activities.resting import Poses
from stillcal.replay.phone.scenario import Scenario


def run(folder: Path, *arguments: object, out: str = "out.json") -> dict[str, Any]:
    """Run a command on MikOff's format and return the JSON that it writes."""
    wanted = [*map(str, arguments), "--format", "mikoff", "--json", str(folder / out), "--quiet"]
    done = CliRunner().invoke(cli, wanted)
    assert done.exit_code == 0, done.output
    answer: dict[str, Any] = json.loads((folder / out).read_text())
    return answer


@pytest.mark.parametrize("pair", [("imu0", "imu2"), ("imu1", "imu2")])
@pytest.mark.slow
def test_biases_differ_by_what_their_calibrations_do(
    data_dir: Path, tmp_path: Path, pair: tuple[str, str]
) -> None:
    """Three sensors, each held still for four to seven seconds in some twenty attitudes."""
    own, other = (data_dir / f"mikoff/{name}.log" for name in pair)
    calibrated = [run(tmp_path, "replay", file) for file in (own, other)]
    answer = run(tmp_path, "diagnose", own, "--simulated", other, "--simulated-format", "mikoff")
    for effect, sensor in (("accel_bias", "accelerometer"), ("gyro_bias", "gyroscope")):
        (found,) = (f for f in answer["findings"] if f["effect"] == effect)
        apart, (low, high) = (
            found["difference"]["bias"]["value"],
            np.transpose(found["difference"]["bias"]["ci95"]),
        )
        of_each = [np.array(c[sensor]["bias"]) for c in calibrated]
        np.testing.assert_array_less(np.abs(of_each[0] - of_each[1] - apart), (high - low) / 2.0)


@pytest.mark.parametrize(
    "name", ["imu2", *(pytest.param(n, marks=pytest.mark.slow) for n in ("imu0", "imu1"))]
)
def test_a_hand_that_moves_is_no_fault_of_the_sensor(data_dir: Path, tmp_path: Path, name: str) -> None:
    answer = run(tmp_path, "diagnose", data_dir / f"mikoff/{name}.log")
    assert answer["verdict"] == "match" and answer["findings"] == []


def both(
    accelerometer: Samples, gyroscope: Samples, force: object = 0.0, rate: object = 0.0
) -> stillcal.Recording:
    """Return a recording of both sensors with biases added, m/s^2 and rad/s."""
    return stillcal.load(
        t=accelerometer.t,
        accelerometer=accelerometer.xyz + force,
        gyroscope=gyroscope.xyz + rate,
        gyroscope_t=gyroscope.t,
    )


def on_six_faces(rest_s: float, seed: int) -> stillcal.Recording:
    """A phone that is laid on each of its faces once."""
    ups = tuple(tuple((sign * np.eye(3)[axis]).tolist()) for axis in range(3) for sign in (1.0, -1.0))
    scenario = Scenario(segments=(Poses(ups=ups, rest_s=(rest_s, 1.2 * rest_s)),))
    whole = simulate(scenario, load_phone("consumer"), seed).whole()
    accelerometer, gyroscope = whole.accelerometer, whole.gyroscope
    assert gyroscope is not None
    return both(accelerometer, gyroscope)


@pytest.mark.parametrize("rest_s", [5.0, pytest.param(16.0, marks=pytest.mark.slow)])
def test_six_faces_show_another_bias_of_either_sensor(rest_s: float) -> None:
    one, other = on_six_faces(rest_s, 1), on_six_faces(rest_s, 2)
    assert other.gyroscope is not None
    force, rate = np.array([0.12, 0.0, 0.0]), np.array([0.0, 0.005, 0.0])
    moved = both(other.accelerometer, other.gyroscope, force, rate)
    nothing, answer = (stillcal.diagnose(one, simulated=s) for s in (other, moved))
    assert nothing.verdict == "match" and {"accel_bias", "gyro_bias"} <= {
        a["effect"] for a in nothing.answer["agreed"]
    }
    assert sorted(f["effect"] for f in answer.findings) == ["accel_bias", "gyro_bias"]
    for found, truth in zip(sorted(answer.findings, key=lambda f: f["effect"]), (-force, -rate), strict=True):
        ci = np.array(found["difference"]["bias"]["ci95"])
        assert (ci[:, 0] <= truth).all() and (truth <= ci[:, 1]).all()
