"""What users should be told: heat, a second correction, how slow a rotation goes unseen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.record import Validity
from stillcal.calib_core.calibration.terms import correct_both
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.store.store import Store
from stillcal.replay.commands.replay import apply_command
from stillcal.replay.outcome import record_rows
from stillcal.replay.suitability import SLACK_C, Suitability


def resting(record: Any, corrected: bool, celsius: float | None = None) -> Samples:
    """A phone at rest in twelve directions, raw or corrected already by its calibration."""
    rng = np.random.default_rng(3)
    up = rng.normal(size=(12, 3))
    force = np.repeat(STANDARD * up / np.linalg.norm(up, axis=1)[:, None], 50, axis=0)
    raw = (
        force
        if corrected
        else force @ np.linalg.inv(record.accelerometer.scale).T + record.accelerometer.bias
    )
    raw = raw + rng.normal(0.0, 0.01, raw.shape)
    warm = None if celsius is None else np.full(len(raw), celsius)
    return Samples.checked(Sensor.ACCELEROMETER, np.arange(len(raw)) / 100, raw, warm)


def warned(record: Any, samples: Samples) -> list[str]:
    suits = Suitability(record)
    suits.see(samples, correct_both(record, samples, None)[0])
    return suits.warnings()


@pytest.fixture
def record(make_record: Any) -> Any:
    made = make_record(40)
    part = replace(made.accelerometer, gravity=STANDARD)
    return replace(made, accelerometer=part, validity=Validity(temperature_min=20.0, temperature_max=25.0))


def test_a_second_correction_is_noticed_and_the_first_is_not(record: Any) -> None:
    assert warned(record, resting(record, corrected=False)) == []
    (said,) = warned(record, resting(record, corrected=True))
    assert "corrected already, or another phone's" in said


@pytest.mark.parametrize(
    ("celsius", "outside"),
    [(22.0, False), (25.0 + SLACK_C, False), (40.0, True), (-5.0, True), (np.nan, False)],
)
def test_a_bias_taken_cold_and_used_hot_says_so(record: Any, celsius: float, outside: bool) -> None:
    said = warned(record, resting(record, False, celsius))
    assert ["extrapolated" in text for text in said] == [True] * outside


def test_apply_says_it_on_standard_error(tmp_path: Path, record: Any) -> None:
    Store(tmp_path / "store.json").publish(record)
    samples = resting(record, corrected=True)
    rows = "".join(f"{t},{x},{y},{z}\n" for t, (x, y, z) in zip(samples.t, samples.xyz, strict=True))
    (tmp_path / "log.csv").write_text("t,ax,ay,az\n" + rows)
    arguments = [tmp_path / "log.csv", "--store", tmp_path / "store.json", "--out", tmp_path / "out.csv"]
    ran = CliRunner().invoke(apply_command, list(map(str, arguments)))
    assert ran.exit_code == 0, ran.output
    assert "corrected already" in ran.output


def test_unseen_rotation_is_said_in_degrees_per_hour_and_the_temperature_in_words(record: Any) -> None:
    gyroscope = replace(record.gyroscope, rotation_admitted=np.full(3, np.radians(12.0) / 3600.0))
    rows = dict(record_rows(replace(record, gyroscope=gyroscope)))
    assert rows["  slow rotation unseen"] == "up to 12 °/h may be in the bias"
    assert rows["Measured at"].startswith("20.0 to 25.0 °C")


def test_a_calibration_of_the_gyroscope_alone_says_what_it_leaves(record: Any) -> None:
    samples = resting(record, corrected=False)
    (said,) = warned(replace(record, accelerometer=None), samples)
    assert "stay as they are" in said
    assert warned(record, samples) == []


def test_what_a_term_takes_off_does_not_count_as_corrected_before(record: Any) -> None:
    """The bias is that in the cold, and the recording is warm: without the term it would be made worse."""
    slope = {"slope": TermParameter(value=-record.accelerometer.bias / 10.0, unit="")}
    term = Term(
        effect="accel_bias_temperature",
        sensor=Sensor.ACCELEROMETER,
        parameters=slope,
        reference={"temperature": 15.0},
    )
    part = replace(record.accelerometer, scale=np.eye(3))
    warm = replace(record, accelerometer=part, terms=(term,))
    unbiased = replace(warm, accelerometer=replace(part, bias=np.zeros(3)), terms=())
    samples = resting(unbiased, corrected=False, celsius=25.0)
    assert warned(warm, samples) == []
    (said,) = warned(replace(warm, terms=()), samples)
    assert "corrected already" in said


@pytest.mark.parametrize("effect", ["accel_bias_temperature", "accel_scale_temperature"])
def test_what_follows_temperature_is_said_to_be_left_in_without_one(record: Any, effect: str) -> None:
    slope = {"slope": TermParameter(value=np.full(3, 1e-3), unit="")}
    reference = {"temperature": 22.0}
    term = Term(effect=effect, sensor=Sensor.ACCELEROMETER, parameters=slope, reference=reference)
    follows = replace(record, terms=(term,))
    (said,) = warned(follows, resting(record, corrected=False))
    assert said == f"{effect}: not corrected, the recording has no temperature"
    assert warned(follows, resting(record, corrected=False, celsius=22.0)) == []


def test_a_bias_that_follows_the_charger_needs_to_know_when_it_was_plugged_in(record: Any) -> None:
    amplitude = TermParameter(value=np.full(3, 0.03), unit="m/s^2")
    term = Term(effect=BY_CHARGING, sensor=Sensor.ACCELEROMETER, parameters={"amplitude": amplitude})
    follows, samples = replace(record, terms=(term,)), resting(record, corrected=False)
    (said,) = warned(follows, samples)
    assert "off the charger" in said
    told = Suitability(follows)
    told.see(samples, samples, [Charging(0.0, True)])
    assert told.warnings() == []
