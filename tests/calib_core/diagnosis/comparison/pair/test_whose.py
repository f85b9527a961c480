"""Whose a difference of two sensors on one motion is, where the simulation by itself does not show it."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.direct import of_delay
from stillcal.calib_core.diagnosis.comparison.pair.measured import none_of
from stillcal.calib_core.diagnosis.comparison.pair.stands import _of_whom
from stillcal.calib_core.diagnosis.comparison.quantity import Quantity, subtract
from stillcal.calib_core.diagnosis.comparison.stated import discrepancy
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.streams.samples import Samples

LATE = 12e-3
"""s by which the recording's gyroscope is later than the simulation's."""


def delay(value: float, error: float) -> Quantity:
    return of_delay(Measured(value, error), Samples("accel", np.arange(4.0), np.zeros((4, 3))))


@pytest.mark.parametrize(
    ("recorded", "simulated", "relation", "either"),
    [
        (None, None, "lacking", True),
        ((LATE, 8e-3), (0.0, 8e-3), "lacking", True),
        ((0.0, 5e-3), (-LATE, 5e-3), "lacking", True),
        ((LATE, 2e-3), None, "lacking", False),
        ((LATE, 2e-3), (0.0, 2e-3), "lacking", False),
        ((0.0, 2e-3), None, "superfluous", False),
    ],
)
def test_what_neither_shows_alone_may_be_of_either(
    recorded: tuple[float, float] | None, simulated: tuple[float, float] | None, relation: str, either: bool
) -> None:
    """By 8 ms a delay of 12 ms of one recording is not told from none, by 2 ms it is."""
    apart = delay(LATE, 1e-4)
    own, other = (None if one is None else delay(*one) for one in (recorded, simulated))
    said = _of_whom(discrepancy(subtract(apart, none_of(apart))), own, other)
    assert (said.relation, said.of_either) == (relation, either)
    assert said.difference is not None
    np.testing.assert_allclose(said.difference.value, [LATE])
    if relation == "lacking":
        # Its own part is nothing, as sure as a recording shows it.
        shown = simulated or recorded
        sigma = 0.0 if shown is None else shown[1]
        np.testing.assert_allclose(said.difference.simulated.sigma, [sigma])
    else:
        np.testing.assert_allclose(said.difference.simulated.value, [-LATE])
