"""Sines of known frequencies are taken off values, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.maths.sines import SINE_NUMBERS, without_sines, without_vibrations

T = 100.0 + np.arange(0.0, 10.0, 0.01)
NOISE = np.random.default_rng(0).normal(size=(T.size, 3))


def test_sines_that_fade_go_and_noise_stays() -> None:
    fading = 5.0 * np.sin(2.0 * np.pi * 23.0 * T) * np.linspace(1.0, 0.5, T.size)
    waves = fading + np.cos(2.0 * np.pi * 7.3 * T)
    left = without_sines(NOISE + np.outer(waves, [1.0, 2.0, 0.0]), T, [23.0, 7.3])
    assert np.allclose(left, without_sines(NOISE, T, [23.0, 7.3]), atol=1e-9)
    assert (left**2).sum() == pytest.approx((NOISE**2).sum() * (1.0 - 2 * SINE_NUMBERS / T.size), rel=0.01)


def test_rests_in_two_attitudes_are_no_sine() -> None:
    """The rows between are a turn: the step from one level to the other was taken for a sine."""
    still = (T < 104.0) | (T > 106.0)
    turned = np.outer(np.clip(T - 104.0, 0.0, 2.0), [5.0, -3.0, 0.0])
    tone = np.outer(np.sin(2.0 * np.pi * 7.3 * T), [1.0, 0.0, 0.0])
    left = without_sines(turned + tone, T, [7.3], still)
    assert left == pytest.approx(turned, abs=1e-9)


@pytest.mark.parametrize("rest_s", [50.0, 58.0])
def test_a_vibration_is_told_by_the_rests_about_a_motion(rest_s: float) -> None:
    """Half a minute of motion leaves a part of 20 s without rests, and another with few."""
    t = np.arange(0.0, 140.0, 0.02)
    still = (t < rest_s) | (t > 90.0)
    motion = np.where(still, 0.0, 30.0 * np.random.default_rng(1).standard_normal(t.size))[:, None]
    tone = 0.1 * np.sin(2.0 * np.pi * 7.3 * t)[:, None]
    assert without_vibrations(motion + tone, t, [7.3], still) == pytest.approx(motion, abs=1e-6)
    few = without_vibrations(motion + tone, t, [7.3], still & (t < 1.0))
    assert np.array_equal(few, without_vibrations(motion + tone, t, [7.3])), "all rows tell then"
