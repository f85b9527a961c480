"""A delay's error grows where its parts disagree, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.misfit.agreement import disagreement

WINDOWS, FREQUENCIES = 40, 60
FREQUENCY = np.arange(FREQUENCIES) / 8.0


def spectra(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """What a delay of 1 s does, and noise of which one Hann window's neighbours share a value."""
    rng = np.random.default_rng(seed)
    shape = (WINDOWS, FREQUENCIES, 3)
    late = 300.0 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    noise = (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2.0)
    return late, noise


@pytest.mark.parametrize("seed", range(4))
def test_parts_that_agree_add_little(seed: int) -> None:
    late, noise = spectra(seed)
    sampling = 1.0 / np.sqrt(2.0 * (np.abs(late) ** 2).sum())
    assert disagreement(late, noise, FREQUENCY) < 3.0 * sampling


def test_delays_that_differ_between_directions_are_as_uncertain_as_they_differ() -> None:
    late, noise = spectra(9)
    apart = late * np.array([0.01, -0.01, 0.0])
    error = disagreement(late, noise + apart, FREQUENCY)
    assert 0.0005 < error < 0.01
