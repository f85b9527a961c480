"""Steps by correlation, on a walk whose steps are known."""

import numpy as np
import pytest

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.studies.collin2019.step_template import correlation, count, form


def a_walk(cadence: float, size: float = 3.0, seconds: float = 60.0) -> Samples:
    """Return a phone upright whose norm swings `cadence` times a second about g."""
    t = np.arange(0.0, seconds, 0.01)
    phase = 2.0 * np.pi * cadence * t
    up = 9.80665 + size * (np.sin(phase) + 0.3 * np.sin(2.0 * phase))
    return Samples(Sensor.ACCELEROMETER, t, np.column_stack((0.0 * t, 0.0 * t, up)))


def test_a_template_finds_the_steps_of_another_walk_of_another_size() -> None:
    template = form(a_walk(1.8))
    assert template.shape.size == 14  # 25 Hz over 1.8 Hz
    assert count(a_walk(1.8, size=1.0), template) == pytest.approx(1.8 * 60.0, abs=2)
    assert count(a_walk(2.0), template) == pytest.approx(2.0 * 60.0, abs=2)
    # it does not see how large the signal is
    assert count(a_walk(1.8, size=1e-4), template) == count(a_walk(1.8), template)


def test_correlation_is_one_on_the_template_itself_and_none_on_a_constant() -> None:
    template = form(a_walk(1.8))
    assert correlation(9.8 + 5.0 * template.shape, template) == pytest.approx([1.0])
    assert correlation(9.8 - 2.0 * template.shape, template) == pytest.approx([-1.0])
    assert correlation(np.full(40, 9.8), template) == pytest.approx(0.0)
