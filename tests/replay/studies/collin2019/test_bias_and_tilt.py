"""Prediction of 1/f noise beside its theory, and the tilt of a heading gyroscope on known turns."""

import math
from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.maths.rotation import exponential, matrix
from stillcal.replay.studies.claim import Verdict
from stillcal.replay.studies.collin2019.bias_prediction import (
    ORDERS,
    Real,
    _real,
    on_real,
    one_over_f,
    predicted,
    theory,
)
from stillcal.replay.studies.collin2019.heading_tilt import tilted


def test_one_over_f_has_the_spectrum_and_increments_of_its_definition() -> None:
    n = 2**14
    values = np.array([one_over_f(n, np.random.default_rng(k)) for k in range(16)])
    assert np.mean(np.diff(values) ** 2) == pytest.approx(4.0 / math.pi, rel=0.01)
    power = np.mean(np.abs(np.fft.rfft(values * np.hanning(n), axis=1)) ** 2, axis=0)
    bands = [power[1 << k : 2 << k].mean() for k in range(4, 11)]
    slope = np.polyfit(np.log([1.5 * (1 << k) for k in range(4, 11)]), np.log(bands), 1)[0]
    assert slope == pytest.approx(-1.0, abs=0.1)


def test_longer_memory_predicts_better_and_never_perfectly() -> None:
    assert theory(1) == pytest.approx(4.0 / math.pi)
    assert theory(32) - 1.0 == pytest.approx(1.0 / (4 * 32), rel=0.03)
    found = predicted(3, 2**14, 0, lambda share: None)
    means = found.models.mean(axis=0)
    assert (np.diff(means[:5]) < 0.0).all()
    assert means[ORDERS.index(8)] == pytest.approx(theory(8), abs=0.03)
    assert means[-1] > 0.98


def test_a_tilted_axis_senses_the_cosine_of_turns_about_up_and_the_sine_of_others() -> None:
    frame = matrix(exponential(np.array([0.3, -0.7, 0.2])))
    forces = np.tile(9.8 * frame[:, 2], (5, 50, 1))
    speeds = np.array([0.1, -0.3, 0.5, 0.2, -0.4])[:, None, None]
    tilt = math.radians(2.0)
    upright = tilted(forces, speeds * np.ones((1, 50, 1)) * frame[:, 2], 50.0, tilt)
    assert upright.slopes == pytest.approx(math.cos(tilt), abs=1e-9)
    assert upright.crossed == pytest.approx(0.0, abs=1e-9)
    level = tilted(forces, 0.1 * np.ones((5, 50, 1)) * frame[:, 0], 50.0, tilt)
    # the RMS over all directions of the tilt is that of a sinusoid
    assert level.crossed == pytest.approx(math.degrees(0.1 * math.sin(tilt) / math.sqrt(2.0)), rel=1e-6)


def test_the_real_gyroscope_is_predicted_from_its_first_half_alone(data_dir: Path) -> None:
    """A second's mean hardly follows the last one: holding on to it nearly doubles the squared error."""
    found = on_real(data_dir)
    assert 600 <= found.means <= 660
    assert (np.abs(found.together) < 0.6).all()
    white = 2.0 * (1.0 - found.together)  # of a random walk's error over the variance
    assert found.last == pytest.approx(white, rel=0.5)
    assert (found.sure[:, 0] < found.sure[:, 1]).all()
    better = np.minimum(found.last, found.one)
    assert ((found.sure[:, 0] < better) & (better < found.sure[:, 1])).all()


@pytest.mark.parametrize("least, verdict", [(1.01, Verdict.REPRODUCED), (1.0, Verdict.DIFFERS)])
def test_every_axis_must_be_predicted_better_for_certain(least: float, verdict: Verdict) -> None:
    sure = np.array([[1.1, 1.3], [1.2, 1.4], [least, 1.3]])
    assert _real(Real(np.full(3, 1.5), np.full(3, 1.2), sure, np.zeros(3), 600)).verdict is verdict
