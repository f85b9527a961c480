"""Reckoning a simulated walk: what a bias does to it, and that true sensors reckon the truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.phone import Scenario, load_phone, simulate
from stillcal.replay.phone.activities.carried import Walk
from stillcal.replay.phone.effects.on_bias import GyroBiasTemperature
from stillcal.replay.phone.effects.on_input import GyroGSensitivity
from stillcal.replay.studies.collin2019 import pedestrian_calibration as study
from stillcal.replay.studies.collin2019.pedestrian_calibration import Life, reckon
from stillcal.replay.studies.collin2019.step_detection import real_cadences, walked

G = 9.8125


@pytest.fixture(scope="module")
def walk() -> tuple[Samples, Samples]:
    whole = simulate(Scenario(segments=(Walk(duration_s=120.0),)), load_phone("ideal"), 4).whole()
    assert whole.gyroscope is not None
    return whole.accelerometer.between(5.0, np.inf), whole.gyroscope.between(5.0, np.inf)


def test_steps_are_the_walker_s(walk: tuple[Samples, Samples]) -> None:
    steps = reckon(*walk, G, 0.5)
    span = walk[0].t[-1] - walk[0].t[0]
    assert 1.6 * 0.85 < steps.t.size / span < 2.0 * 1.05  # cadence 1.6 to 2 Hz, short stops between stretches


def test_a_bias_turns_the_heading_by_its_part_about_up(walk: tuple[Samples, Samples]) -> None:
    accel, gyro = walk
    up = accel.xyz.mean(axis=0) / np.linalg.norm(accel.xyz.mean(axis=0))
    bias = 2e-3
    true, off = reckon(accel, gyro, G, 0.5), reckon(accel, replace(gyro, xyz=gyro.xyz + bias * up), G, 0.5)
    drift = np.polyfit(true.t, off.heading - true.heading, 1)[0]
    # the pocket's up wanders by a few tenths of a radian, whose cosine is near one
    assert drift == pytest.approx(bias, rel=0.1)


def test_error_is_the_distance_between_ends_over_the_way(walk: tuple[Samples, Samples]) -> None:
    true = reckon(*walk, G, 0.5)
    longer = reckon(*walk, G, 0.5 * 1.01)
    life = Life("ideal", true, longer, true, true)
    assert life.error(true) == 0.0
    assert longer.distance == pytest.approx(1.01 * true.distance)
    assert life.error(longer) == pytest.approx(0.01 * np.linalg.norm(true.position[-1]) / true.distance)


@pytest.mark.parametrize(
    "cause, shown", [(GyroBiasTemperature, True), (GyroGSensitivity, True), (None, False)]
)
def test_a_cause_is_shown_where_the_error_goes_with_it(
    walk: tuple[Samples, Samples], monkeypatch: pytest.MonkeyPatch, cause: type | None, shown: bool
) -> None:
    """Lives that are off by a tenth unless one effect is taken off: a day each would take too long here."""
    true, off = reckon(*walk, G, 0.5), reckon(*walk, G, 0.55)
    scale = np.linalg.norm(true.position[-1]) / true.distance
    monkeypatch.setattr(study, "GOOD", 0.03 * scale)

    def lived(name: str, seed: int, *, without: tuple[type, ...]) -> Life:
        return Life(name, true, off, true if cause in without else off, off)

    monkeypatch.setattr(study, "live", lived)
    found = study._tried("mpu6050", 0)
    assert found.shown is shown
    assert found.tried.count(" 0 %") == (2 if shown else 0)  # without it, and without both


@pytest.mark.parametrize("carry", ["pocket", "bag"])
def test_steps_found_are_those_taken(carry: str) -> None:
    true, found, _ = walked(carry, "consumer", 1)
    assert found == pytest.approx(true, rel=0.05)


def test_real_walkers_step_at_the_frequency_of_their_spectrum(data_dir: Path) -> None:
    steps, spectrum = real_cadences(data_dir)
    # half a bin of a window of 2.56 s, and 5 % for the few steps of one
    assert np.mean(np.abs(steps - spectrum) <= 0.5 / 2.56 + 0.05 * spectrum) > 0.9
