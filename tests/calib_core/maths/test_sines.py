"""Sines of known frequencies are taken off values, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.maths.sines import SINE_NUMBERS, without_sines

T = 100.0 + np.arange(0.0, 10.0, 0.01)
NOISE = np.random.default_rng(0).normal(size=(T.size, 3))


def test_sines_that_fade_go_and_noise_stays() -> None:
    fading = 5.0 * np.sin(2.0 * np.pi * 23.0 * T) * np.linspace(1.0, 0.5, T.size)
    waves = fading + np.cos(2.0 * np.pi * 7.3 * T)
    left = without_sines(NOISE + np.outer(waves, [1.0, 2.0, 0.0]), T, [23.0, 7.3])
    assert np.allclose(left, without_sines(NOISE, T, [23.0, 7.3]), atol=1e-9)
    assert (left**2).sum() == pytest.approx((NOISE**2).sum() * (1.0 - 2 * SINE_NUMBERS / T.size), rel=0.01)
