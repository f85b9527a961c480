"""A large nonlinearity of the gyroscope in both: its sizes, and what is put in, are of the true rate."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.replay.diagnosis.built_in import judge_built_in
from stillcal.replay.diagnosis.given_simulation import judge_simulation
from tests.support.diagnosis.turned_pairs import turned

SQUARES = np.array([0.06, -0.05, 0.04])
"""1/(rad/s); at 3 rad/s a sixth of the rate."""


@pytest.mark.slow
def test_a_simulation_with_twice_the_nonlinearity_has_twice_and_passes_once_corrected() -> None:
    """Fitted about the rate as it is read, the simulation seemed to have half of it and a cubic term."""

    def bent(part: float):
        return lambda force, rate: (force, rate + part * SQUARES * rate**2)

    recording = turned(1, bent(0.5), turns=40, rest=20.0, motion=1)
    simulation = turned(2, bent(1.0), turns=40, rest=20.0, motion=2)
    answer = judge_simulation(recording, simulation).answer
    (found,) = [f for f in answer["findings"] if f["effect"] != "sample_rate"]
    assert (found["effect"], found["relation"]) == ("gyro_nonlinearity", "too_large")
    for side, part in (("parameters", 0.5), ("simulated", 1.0)):
        of_square = found[side]["quadratic"]
        low, high = np.transpose(of_square["ci95"])
        np.testing.assert_allclose(of_square["value"], part * SQUARES, rtol=0.03, atol=2e-4)
        assert ((low <= part * SQUARES) & (part * SQUARES <= high)).all()
    assert answer["fit"]["p_after"] > 0.01


@pytest.mark.slow
def test_the_built_in_simulation_passes_with_a_gross_cube_put_in() -> None:
    """Measured about the rate as it is read, the corrected simulation seemed to have a fifth less of it."""
    cubes = np.array([0.02, -0.01, 0.02])

    def bent(force, rate):
        return force, rate + cubes * rate**3

    answer = judge_built_in(turned(1, bent, turns=40, rest=20.0, motion=1)).answer
    (found,) = answer["findings"]
    assert found["effect"] == "gyro_nonlinearity"
    np.testing.assert_allclose(found["parameters"]["cubic"]["value"], cubes, rtol=0.05, atol=1e-3)
    assert answer["fit"]["p_after"] > 0.01
