"""Heavy tails that two recordings have: their ratio is a parameter, and no ratio of the recordings."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, subtract
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy
from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.replay.diagnosis.answer import Fit, answer_of

WHERE = Where(0.0, 900.0, (0.0, 50.0), "nothing")
PARTS = tuple(Part(name, "1", 1) for name in ("excess_kurtosis", "ratio", "fraction"))
"""As `noise_heavy_tailed` has them."""


def tails(ratio: float, fraction: float) -> Quantity:
    value = np.log([9.0, ratio, fraction])
    alike = (1e-4 * np.eye(3), np.full(3, 1.0), np.full(3, 0.01), np.full(3, -1))
    return Quantity("noise_heavy_tailed", "accel", PARTS, value, *alike, logarithmic=True, where=WHERE)


def test_the_difference_of_a_ratio_is_told_and_not_the_ratio_of_the_two_recordings() -> None:
    apart = subtract(tails(5.0, 0.06), tails(4.0, 0.04))
    one = Discrepancy("noise_heavy_tailed", "accel", ["x"], WHERE, apart.relation(), 1.0, 300.0, apart)
    (said,) = answer_of(Comparison([one]), ("real.csv", "sim.csv"), Fit(1e-9, 1.0), {}, None)["findings"]
    assert np.allclose(said["difference"]["ratio"]["value"], 1.0)
    assert np.allclose(said["difference"]["fraction"]["value"], 0.02)
    assert "sim.csv" in said["statement"]
