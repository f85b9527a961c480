"""What `diagnose --residuals` writes of turns."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.maths.rms import rms
from stillcal.replay.diagnosis.residuals import residuals_csv
from tests.calib_core.diagnosis.model.test_rotation_alignment import day


def test_what_is_known_of_a_nuisance_leaves_turns_what_they_miss() -> None:
    """Fitted freely, 37 columns of what may wander went through the 34 residuals: all were 0."""
    force, spin, _ = day(3, 20)
    gain = 1.0 + 0.01 * (spin.t > 0.45 * spin.t[-1])
    exam = examine(force, replace(spin, xyz=spin.xyz * gain[:, None]))
    rows = [r for r in csv.DictReader(residuals_csv(exam).splitlines()) if r["residual"] == "turn"]
    ideal, left, sd = (np.array([float(r[name]) for r in rows]) for name in ("ideal", "with_effects", "sd"))
    assert rms(ideal) > 3.0 * rms(left)
    assert 0.3 < rms(left / sd) < 3.0
