"""What becomes of a finding is said with the reason and what to do, and since when."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.service.engine_thread import EngineThread, View
from stillcal.daemon.service.finding_outcomes import outcome
from stillcal.daemon.store.document import StoreDocument

TERM = Term(
    effect="accel_bias_temperature",
    sensor=Sensor.ACCELEROMETER,
    parameters={"slope": TermParameter(value=np.ones(3), unit="m/s^2/K")},
    reference={"temperature": 25.0},
)


@pytest.fixture
def view() -> View:
    thread = EngineThread(EngineSettings(), None, None)
    thread.close()
    return thread.view


def said(effect: str, view: View, document: StoreDocument | None = None, **finding: Any) -> tuple[str, str]:
    sensor = effect.partition("_")[0] if effect.startswith(("accel", "gyro")) else "accel"
    found = {"effect": effect, "sensor": sensor, **finding}
    made = outcome(found, view, document or StoreDocument(), 10_000.0)
    return made.handled, made.words


def test_a_correction_counts_from_the_first_calibration_that_has_it_without_a_break(
    view: View, make_record: Any
) -> None:
    def at(t: float, *terms: Term) -> CalibrationRecord:
        record: CalibrationRecord = replace(make_record(int(t)), fitted_at=t, terms=terms)
        return record

    document = StoreDocument()
    for record in (at(1000.0, TERM), at(2000.0), at(2800.0, TERM), at(6400.0, TERM)):
        document = document.after_publishing(record, 10)
    now = replace(view, record=document.current)
    handled, words = said("accel_bias_temperature", now, document)
    assert (handled, words) == ("corrected", "corrected for 2 h by the calibration, nothing to do")
    assert said("accel_scale_temperature", now, document)[0] == "reported"
    assert said("gyro_bias_temperature", now, document)[0] == "reported"  # the term is the other sensor's


def test_a_term_on_trial_is_not_a_correction(view: View) -> None:
    handled, words = said("gyro_g_sensitivity", replace(view, on_trial={"gyro_g_sensitivity": 6400.0}))
    assert handled == "on_trial" and words.startswith("not corrected yet: tested on later rests for 1 h, ")


@pytest.mark.parametrize(
    ("effect", "why"),
    [
        ("gyro_g_sensitivity", "let the phone lie in more attitudes"),
        ("gyro_bias_temperature", "once it predicts later rests better"),
        ("thermal_latent", "no thermometer"),
        ("accel_bias_step", "measured anew at every check"),
        ("accel_nonlinearity", "stillcal record"),
        ("unknown", "stillcal record"),
    ],
)
def test_what_is_only_reported_has_its_reason(view: View, effect: str, why: str) -> None:
    handled, words = said(effect, view)
    assert handled == "reported" and words.startswith("not corrected: ") and why in words


def test_a_reason_holds_for_the_settings_and_for_what_looks_alike(view: View) -> None:
    off = replace(view, learns_temperature=False)
    assert "learn_temperature is false" in said("gyro_bias_temperature", off)[1]
    assert "learn_temperature" not in said("gyro_bias_step", off)[1]
    alike = [{"effect": "gyro_bias_step", "indistinguishable": True}]
    assert "do not tell it from gyro_bias_step" in said("gyro_g_sensitivity", view, alternatives=alike)[1]
