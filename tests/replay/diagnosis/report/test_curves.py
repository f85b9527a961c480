"""The page's curves: every one over its own driver."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from stillcal.replay.diagnosis.phone.case import Case
from stillcal.replay.diagnosis.report.curves import affine_columns, curves_of

SENSITIVE: dict[str, object] = {
    "name": "gyro_g_sensitivity",
    "matrix": [[0.0, 0.0, 4e-4], [3e-4, 0.0, 0.0], [0.0, -4e-4, 2e-4]],
}


def test_affine_columns_leave_a_change_of_the_norm_that_is_no_matter_of_attitude() -> None:
    rng = np.random.default_rng(3)
    up = rng.normal(size=(200, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    columns = affine_columns(up)
    error = rng.normal(size=200)
    left = error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0]
    assert np.linalg.matrix_rank(columns) == 9
    np.testing.assert_allclose(left.std() / error.std(), np.sqrt(191 / 200), rtol=0.05)


@pytest.mark.slow
def test_a_matrix_is_drawn_as_a_line_over_the_one_force_that_it_is_drawn_against(
    case_with: Callable[..., Case],
) -> None:
    case = case_with(SENSITIVE)
    (one,) = [m for m in case.mapped if m.finding.effect == SENSITIVE["name"]]
    curves = curves_of(one, case.bins, case.conditions, case.affine, case.gravity)
    assert curves
    for curve in curves:
        assert curve.partial_component is not None
        slope, offset = np.polyfit(curve.x, curve.partial_component, 1)
        np.testing.assert_allclose(curve.partial_component, slope * curve.x + offset, atol=1e-9)
        row = np.asarray(SENSITIVE["matrix"])["xyz".index(curve.axis)]
        assert abs(slope - row[np.argmax(np.abs(row))]) < 5e-5
