"""From two recordings to corrected configurations: with them the simulation has what the recording has."""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ET
from typing import Any

import msgspec
import numpy as np
import pytest

import stillcal
from stillcal.replay.export.fix.fixers import fixed_for
from stillcal.replay.phone.phone import Phone
from tests.replay.export.test_fix import SDF

REAL = """
[accel]
rate_hz = 50.0
bias = [0.1, -0.05, 0.2]
[accel.noise]
white = 0.003
[gyro]
rate_hz = 50.0
bias = [0.01, 0.02, -0.01]
scale = [[1.01, 0.0, 0.0], [0.0, 0.98, 0.004], [0.0, 0.0, 1.005]]
[gyro.noise]
white = 0.0004
[clock]
shared = true
"""
SIMULATION = """# mine
[accel]
rate_hz = 50.0
[accel.noise]
white = 0.0015
[gyro]
rate_hz = 50.0
bias = [0.002, 0.0, 0.0]
[gyro.noise]
white = 0.0004
[clock]
shared = true
"""


@pytest.mark.slow
def test_a_corrected_simulation_matches(tmp_path: Any) -> None:
    paths = {name: tmp_path / f"{name}.toml" for name in ("real", "simulation")}
    paths["real"].write_text(REAL)
    paths["simulation"].write_text(SIMULATION)
    real = stillcal.simulate("lab", phone=paths["real"], seed=3)
    first = stillcal.diagnose(real, simulated=stillcal.simulate("lab", phone=paths["simulation"], seed=4))
    answer = first.as_dict()
    corrected = fixed_for("phone", SIMULATION, answer)
    assert not corrected.not_held
    paths["simulation"].write_text(corrected.text)
    second = stillcal.diagnose(real, simulated=stillcal.simulate("lab", phone=paths["simulation"], seed=5))
    assert (first.verdict, second.verdict) == ("identified", "match")
    one, other = (msgspec.convert(tomllib.loads(t), type=Phone) for t in (REAL, corrected.text))
    assert one.gyro is not None and other.gyro is not None
    np.testing.assert_allclose(other.gyro.scale, one.gyro.scale, atol=half(answer, "gyro_scale", "scale"))
    np.testing.assert_allclose(other.gyro.bias, one.gyro.bias, atol=half(answer, "gyro_bias", "bias"))
    # The same answer in Gazebo's own terms; its file says what the simulation was made with.
    element = ET.fromstring(fixed_for("gazebo", SDF.replace("0.1</mean>", "0</mean>"), answer).text)
    means = [float(element.findtext(f".//linear_acceleration/{a}/noise/mean") or 0.0) for a in "xyz"]
    np.testing.assert_allclose(means, one.accel.bias, atol=half(answer, "accel_bias", "bias"))
    deviation = float(element.findtext(".//linear_acceleration/x/noise/stddev") or 0.0)
    assert deviation == pytest.approx(0.02 * 2.0, rel=0.05)


def half(answer: dict[str, Any], effect: str, parameter: str) -> float:
    """The largest half of the 95 % intervals of a difference."""
    [found] = [f for f in answer["findings"] if f["effect"] == effect]
    return float(np.ptp(np.array(found["difference"][parameter]["ci95"]), axis=-1).max() / 2.0)
