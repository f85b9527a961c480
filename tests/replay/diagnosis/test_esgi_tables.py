"""Tables of rests that state no uncertainty are diagnosed, such as the three that ship with the project."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.inference.noise_models import families
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.replay.diagnosis.rest_table import diagnose_rests, rest_bins
from stillcal.replay.formats.rest_table import read_rest_table


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_published_table_is_diagnosed(number: int) -> None:
    with as_file(files("stillcal.config") / "esgi" / f"dataset{number}.csv") as path:
        rests = read_rest_table(path)
    answer = diagnose_rests(rests, "table")
    names = {f["effect"] for f in answer["findings"]}
    assert names <= {"accel_nonlinearity", "unknown"}
    (norm, *_) = by_sensor(rest_bins(rests), 9.80665)[0].views
    for family in families(norm):
        assert np.isfinite(family.rotation).all() and (family.diagonals > 0.0).all()


def test_rates_printed_with_all_their_digits_are_not_taken_as_known_to_the_last(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    up = rng.normal(size=(24, 3))
    force = 9.80665 * up / np.linalg.norm(up, axis=1, keepdims=True) + rng.normal(size=(24, 3)) * 3e-4
    rate = np.array([0.01, -0.02, 0.005]) + rng.normal(size=(24, 3)) * 5e-5
    table = tmp_path / "rests.csv"
    rows = np.column_stack([30.0 * np.arange(24), force, rate])
    np.savetxt(table, rows, delimiter=",", header="t,ax,ay,az,gx,gy,gz", comments="")
    assert diagnose_rests(read_rest_table(table), "rests.csv")["findings"] == []
