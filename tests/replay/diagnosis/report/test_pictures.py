"""What is drawn of effects without a name: what shows them."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.motion.unseen_tilt import DRIVER as UNSEEN_TILT
from stillcal.calib_core.diagnosis.noise.coloured_noise import DRIVER as COLOURED
from stillcal.calib_core.diagnosis.noise.lines.steady_period import DRIVER as STEADY_PERIOD
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.report import figures
from stillcal.replay.diagnosis.report.pictures import _of_samples
from stillcal.replay.diagnosis.report.sample_figures import _folded


def answered(driver: str, **parameters: float) -> dict[str, object]:
    return {
        "effect": "unknown", "sensor": "accel", "axes": ["z"], "simulated": {},
        "where": {"t_start": 100.0, "t_end": 100.0, "band_hz": [0.0, 1.0], "driver": driver},
        "parameters": {name: {"value": value, "unit": "1"} for name, value in parameters.items()},
    }  # fmt: skip


def lying() -> Samples:
    """200 s at rest; z rises and falls every 3.7 s by 2e-3 m/s^2, a fifth of its noise."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 200.0, 0.02)
    force = np.array([0.0, 0.0, 9.8]) + 0.01 * rng.standard_normal((t.size, 3))
    force[:, 2] += 2e-3 * np.sin(2.0 * np.pi * t / 3.7)
    return Samples.checked(Sensor.ACCELEROMETER, t, force)


def test_a_steady_period_is_drawn_over_the_period() -> None:
    samples = lying()
    bins = cut(samples, None)
    course = _folded(samples, bins, 2, 3.7)
    assert course is not None
    wave = np.sin(2.0 * np.pi * (np.arange(course.size) + 0.5) / course.size)
    assert np.polyfit(wave, course, 1)[0] > 1.5e-3
    (picture,) = _of_samples(
        answered(STEADY_PERIOD, frequency=1 / 3.7), [("recorded", "#444444", samples, bins)]
    )
    assert "over the period of 3.7 s" in picture.caption and "istogram" not in picture.caption


def test_a_jump_of_gravity_s_direction_is_drawn_in_time() -> None:
    samples = lying()
    source = ("recorded", "#444444", samples, cut(samples, None))
    (picture,) = _of_samples(answered(UNSEEN_TILT, angle=0.02), [source])
    assert "about the first jump" in picture.caption and picture.svg.startswith("<?xml")


def test_a_band_of_noise_is_drawn_in_the_spectrum_between_its_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """A histogram of samples at rest, as of other effects without a name, shows nothing of it."""
    drawn = []
    monkeypatch.setattr(figures, "spectrum_figure", lambda *told: drawn.append(told) or "")
    samples = lying()
    source = ("recorded", "#444444", samples, cut(samples, None))
    finding = answered(COLOURED, ratio=4.0)
    finding["where"] = {"t_start": 0.0, "t_end": 200.0, "band_hz": [12.0, 19.0], "driver": COLOURED}
    (picture,) = _of_samples(finding, [source])
    assert picture.caption == "Noise density of axis z at rest." and drawn[0][2:] == (2, [12.0, 19.0])
