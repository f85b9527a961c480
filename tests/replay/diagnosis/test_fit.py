"""How well a simulation fits, before and after: what counts in the two numbers."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.compare import Comparison
from stillcal.replay.diagnosis.answer import Fit


def test_what_is_unknown_counts_in_both_and_a_rate_that_cannot_be_put_in_in_neither() -> None:
    both = Comparison(evidence=[("unknown", 20.0), ("sample_rate", 90.0)])
    fit = Fit.of(both, both, ["unknown", "sample_rate"])
    assert fit.p_before == fit.p_after == pytest.approx(np.exp(-20.0))
    rate = Comparison(evidence=[("accel_bias", -3.0), ("sample_rate", 90.0)])
    assert Fit.of(rate, rate, ["sample_rate"]).p_before == 1.0
