"""Held-out evidence for what is measured directly."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.inference.left_out import of_spread


def test_values_without_any_spread_speak_for_none() -> None:
    """Such as stamps that are even to the last digit, all along or but for one."""
    assert of_spread(np.zeros(40), 1e-3).gain == 0.0
    assert of_spread(np.append(np.zeros(39), 1e-6), 1e-3).gain == 0.0
