"""The real still experiment: every device calibrated from its faces, refused, or broken."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.accelerometer.known_attitudes import Method
from stillcal.replay.formats.hhar_still import read
from stillcal.replay.studies.methods.device_faces import calibrate_devices
from stillcal.replay.studies.stisen2015.survey import draw, page

G = 9.80665


@pytest.fixture(scope="module")
def outcomes(data_dir):
    return calibrate_devices(read(data_dir / "hhar_still"))


def test_real_devices_are_calibrated_refused_or_broken(outcomes):
    by_name = {f"{o.recordings.model} {o.recordings.device}": o for o in outcomes}
    assert len(by_name) == len(outcomes)
    for outcome in outcomes:
        assert (outcome.calibration is None) == bool(outcome.reason)
    assert by_name["Samsung-Galaxy-Tab10.1 SamsungGalaxyTab10.1"].broken
    one_face_twice = by_name["Samsung-Galaxy-S3 it-101"]  # labelled left and right, both with x up
    assert "right edge (x axis down)" in one_face_twice.reason
    assert not one_face_twice.broken


def test_real_calibrations_are_plausible_and_help(outcomes):
    """Every calibrated device's norms come nearer to g; the reference is better than most."""
    done = [o for o in outcomes if o.calibration is not None]
    assert len(done) >= 10
    for outcome in done:
        before = np.sqrt(np.mean((np.linalg.norm(outcome.recordings.means, axis=1) - G) ** 2))
        assert outcome.calibration.rms_residual < before / 2
        assert np.abs(outcome.calibration.model.bias).max() < 2.0
        assert np.abs(np.diag(outcome.calibration.model.scale) - 1.0).max() < 0.03
    size = {o.recordings.device: np.abs(o.calibration.model.bias).max() for o in done}
    assert size["xsens"] < np.median(list(size.values()))


def test_page_and_figure_are_written(outcomes, tmp_path):
    text = page(outcomes, G)
    assert text.count("approach 2 |") == sum(
        o.calibration is not None and o.calibration.method == Method.KNOWN_FACES for o in outcomes
    )
    pytest.importorskip("matplotlib")
    draw(outcomes, tmp_path / "figures" / "still.png")
    assert (tmp_path / "figures" / "still.png").stat().st_size > 10_000
