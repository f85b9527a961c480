"""Densities of pieces of unlike lengths."""

import numpy as np
from scipy.signal import welch

from stillcal.calib_core.maths.welch import densities


def test_each_piece_has_the_density_it_has_alone() -> None:
    rng = np.random.default_rng(0)
    pieces = [rng.normal(size=(n, 3)) for n in (100, 64, 100, 131)]
    for one, own in zip(densities(pieces, 50.0, 64), pieces, strict=True):
        alone = welch(own, fs=50.0, nperseg=64, axis=0)[1]
        np.testing.assert_allclose(one, alone, rtol=1e-12)
