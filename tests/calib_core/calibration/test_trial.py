"""Terms of a diagnosis: taken up and dropped on later rests only."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from msgspec import structs

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.trial import TESTED, Trial, judge
from stillcal.calib_core.codec import packed, unpacked
from stillcal.calib_core.engine.actions import Publish
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Charging, Tick
from stillcal.calib_core.temperature.charger import Charger
from tests.calib_core.calibration.test_following import (
    HOUR,
    SETTINGS,
    TRUE,
    G,
    accelerometer_record,
    gyroscope_record,
    lived,
    remembered,
)

EFFECT = "gyro_g_sensitivity"
MATRIX = 1e-4 * np.array([[2.0, 0.0, -1.0], [0.0, 1.5, 0.0], [0.5, 0.0, 2.0]])
NOTHING, NO_STEP = np.zeros((3, 3)), np.zeros(3)


def sensitive(rests: list[RestState], matrix: Array = MATRIX) -> list[RestState]:
    """Return the rests of a gyroscope that is sensitive to force."""
    forces = [matrix @ TRUE.apply(rest.specific_force) for rest in rests]
    return [structs.replace(r, rate=frozen(r.rate + f)) for r, f in zip(rests, forces, strict=True)]


def term(matrix: Array = MATRIX) -> Term:
    parameter = TermParameter(value=frozen(matrix), unit="(rad/s)/(m/s^2)", ci95=None)
    return Term(effect=EFFECT, sensor="gyroscope", parameters={"matrix": parameter}, reference={})


def record(*terms: Term) -> CalibrationRecord:
    accelerometer, gyroscope = accelerometer_record().accelerometer, gyroscope_record().gyroscope
    return CalibrationRecord(accelerometer=accelerometer, gyroscope=gyroscope, terms=terms, fitted_at=0.0)


def test_a_term_is_taken_up_where_later_rests_bear_it_out() -> None:
    memory = remembered(sensitive(lived(30.0)))
    outcome = judge(Trial(term(), 20 * HOUR), record(), memory, 30 * HOUR, SETTINGS)
    assert outcome.record is not None and [t.effect for t in outcome.record.terms if t.effect == EFFECT]
    assert "taken up" in outcome.record.acceptance.reason and outcome.record.acceptance.how == "terms"


@pytest.mark.parametrize(("matrix", "since"), [(NOTHING, 20.0), (-MATRIX, 20.0)])
def test_a_term_that_later_rests_do_not_show_is_not_taken_up(matrix: Array, since: float) -> None:
    memory = remembered(sensitive(lived(30.0), matrix))
    outcome = judge(Trial(term(), since * HOUR), record(), memory, 30 * HOUR, SETTINGS)
    assert outcome.record is None and outcome.decided


def test_rests_from_before_do_not_count() -> None:
    """The rests that a term was fitted to say nothing for it: five later hours are too few."""
    memory = remembered(sensitive(lived(30.0)))
    outcome = judge(Trial(term(), 25 * HOUR), record(), memory, 30 * HOUR, SETTINGS)
    assert outcome.record is None and not outcome.decided


def test_a_term_in_use_is_dropped_where_it_predicts_worse() -> None:
    memory = remembered(lived(30.0))
    outcome = judge(Trial(term(), 20 * HOUR), record(term()), memory, 30 * HOUR, SETTINGS)
    assert outcome.record is not None and "dropped" in outcome.record.acceptance.reason
    assert EFFECT not in {t.effect for t in outcome.record.terms}


def finding(matrix: Array) -> dict[str, Any]:
    parameters = {"matrix": {"value": matrix.tolist(), "unit": "(rad/s)/(m/s^2)"}}
    return {"effect": EFFECT, "parameters": parameters, "alternatives": []}


def test_the_engine_puts_a_finding_on_trial_for_a_night_and_keeps_the_trial() -> None:
    rests = sensitive(lived(44.0))
    first, later = ([r for r in rests if before is (r.t_end < 30 * HOUR)] for before in (True, False))
    engine = Engine(EngineSettings(schedule=ScheduleSettings(gravity=G)))
    engine.add_rests(first)
    engine.feed(Tick(30 * HOUR))
    engine.calibrate()
    assert engine.consider([finding(MATRIX), {"effect": "accel_nonlinearity"}]) == []
    engine = Engine(engine.settings, unpacked(packed(engine.state), EngineState))
    assert [trial.term.effect for trial in engine.present.trials] == [EFFECT]
    engine.add_rests(later)
    engine.feed(Tick(44 * HOUR))
    published = [a for a in engine.consider([]) if isinstance(a, Publish)]
    assert len(published) == 1
    (found,) = [t for t in published[0].record.terms if t.effect == EFFECT]
    assert np.array_equal(found.parameters["matrix"].value, MATRIX)


STEP = 0.05 * np.array([1.0, -0.6, 0.8]) * np.pi / 180.0


def plugged(rests: list[RestState], step: Array = STEP) -> list[RestState]:
    """Return the rests of a gyroscope whose bias steps on the charger, plugged in every other 100 minutes."""
    charger = Charger().with_events(Charging(t=6000.0 * k, on=k % 2 == 0) for k in range(40))
    on = charger.course(np.array([0.5 * (rest.t_start + rest.t_end) for rest in rests]))
    return [
        structs.replace(r, charged=c, rate=frozen(r.rate + c[0] / 10.0 * step))
        for r, c in zip(rests, on, strict=True)
    ]


def by_charger() -> Term:
    parameter = TermParameter(value=frozen(STEP), unit="rad/s", ci95=None)
    return Term(effect="gyro_charging_bias", sensor="gyroscope", parameters={"step": parameter})


def test_a_bias_on_the_charger_is_taken_up_and_dropped_by_the_same_rule() -> None:
    assert set(TESTED) == {EFFECT, "gyro_charging_bias"}
    memory = remembered(plugged(lived(30.0)))
    outcome = judge(Trial(by_charger(), 20 * HOUR), record(), memory, 30 * HOUR, SETTINGS)
    assert outcome.record is not None and "gyro_charging_bias taken up" in outcome.record.acceptance.reason
    memory = remembered(plugged(lived(30.0), NO_STEP))
    outcome = judge(Trial(by_charger(), 20 * HOUR), record(by_charger()), memory, 30 * HOUR, SETTINGS)
    assert outcome.record is not None and "gyro_charging_bias dropped" in outcome.record.acceptance.reason
    outcome = judge(Trial(by_charger(), 20 * HOUR), record(), memory, 30 * HOUR, SETTINGS)
    assert outcome.record is None and outcome.decided
