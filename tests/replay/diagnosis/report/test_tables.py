"""The page's tables and curves: every number with its own interval, every curve over its own driver."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Parameter, Where
from stillcal.replay.diagnosis.report.curves import affine_columns
from stillcal.replay.diagnosis.report.inputs import Case
from stillcal.replay.diagnosis.report.tables import comparison, p_words, parameters

SENSITIVE: dict[str, object] = {
    "name": "gyro_g_sensitivity",
    "matrix": [[0.0, 0.0, 4e-4], [3e-4, 0.0, 0.0], [0.0, -4e-4, 2e-4]],
}


def cells(html: str) -> list[list[str]]:
    """Return the rows of a table's body as text."""
    rows = re.findall(r"<tr>(.*?)</tr>", html.split("<tbody>")[1])
    return [[re.sub("<[^>]*>", "", c) for c in re.findall(r"<td[^>]*>(.*?)</td>", row)] for row in rows]


def finding(parameter: Parameter) -> Finding:
    where, seen = Where(0.0, 1.0, (0.0, 0.01), "attitude"), Evidence(1e-9, 1.0, 0.5, 3.0, 5)
    return Finding("gyro_g_sensitivity", "gyro", ["x"], where, {"matrix": parameter}, seen, [], "said")


def test_every_number_stands_beside_its_own_interval() -> None:
    value = [[float(3 * i + j) for j in range(3)] for i in range(3)]
    pairs = [[[v - 0.25, v + 0.5] for v in row] for row in value]
    wanted = [
        [f"matrix {a}{b}", f"{value[i][j]:.4g}", f"{value[i][j] - 0.25:.4g} to {value[i][j] + 0.5:.4g}", "m²"]
        for i, a in enumerate("xyz")
        for j, b in enumerate("xyz")
    ]
    assert cells(parameters(finding(Parameter(value, pairs, "m^2")))) == wanted
    alone = finding(Parameter(4.0, [4.0, 4.0], "samples"))
    assert cells(parameters(alone)) == [["matrix", "4", "exact", "samples"]]


def test_what_differs_only_afterwards_is_shown_too() -> None:
    def test(name: str, p: float) -> dict[str, object]:
        told = {"statistic": name, "channel": "accel x", "unit": "1", "recorded": 1.0, "simulated": 2.0}
        return told | {"p_value": p, "p_corrected": min(1.0, 40 * p)}

    quiet = [test(f"quiet {i}", 0.1 + 0.01 * i) for i in range(30)]
    before = {"level": 0.01, "tests": [test("early", 1e-8), test("late", 0.9), *quiet]}
    after = {"level": 0.01, "tests": [test("late", 1e-6), test("early", 0.9), test("new", 1e-7), *quiet]}
    html = comparison(before, after)
    rows = cells(html)
    assert [row[0] for row in rows[:3]] == ["early", "new", "late"] and len(rows) == 6
    assert rows[1][4:] == ["", "", "2", "4e-06"]
    assert html.count('class="no"') == 3


def test_p_values_are_read_at_a_glance() -> None:
    assert [p_words(p) for p in (1.0, 0.25, 1.3e-7, 0.0)] == ["1", "0.25", "1e-07", "&lt; 1e-300"]


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
    curves = case.curves(one)
    assert curves
    for curve in curves:
        assert curve.partial_component is not None
        slope, offset = np.polyfit(curve.x, curve.partial_component, 1)
        np.testing.assert_allclose(curve.partial_component, slope * curve.x + offset, atol=1e-9)
        row = np.asarray(SENSITIVE["matrix"])["xyz".index(curve.axis)]
        assert abs(slope - row[np.argmax(np.abs(row))]) < 5e-5
