"""A turn's error that a nameless error of either sensor's bias may make says nothing of the rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis import diagnose
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.effects.unknown import CrossedForce, GainInStretch
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Evidence, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.turns.unsure_tilt import beyond, unsure_tilt
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.formats.trace import Recording
from tests.support.report_days import phone_with, recorded

TURNS = 20
LASTS = 3.0
SCALE = next(e for e in effects_of("gyro", in_turns=True) if e.name == "gyro_scale_temperature")


def finding(effect: str, sensor: str, sizes: dict[str, Parameter], band: tuple[float, float]) -> Finding:
    return Finding(effect, sensor, [], Where(0.0, 900.0, band, "time"), sizes, Evidence(50.0), [], "Said.")


def of_turns(moved: float) -> Stated:
    """Return a statement whose effect moves gravity by `moved` (rad) across itself in every turn."""
    columns = np.full((1, 2 * TURNS, 3), moved / np.sqrt(2.0)) * [1.0, 0.0, 0.0]
    sizes = {SCALE.parameters[0].name: Parameter([1.0, 0.0, 0.0], None, "1/K")}
    return Stated(finding(SCALE.name, "gyro", sizes, SLOW_BAND), Hypothesis(SCALE, {}, (columns,)), None)


def nameless(sensor: str, size: float, band: tuple[float, float] = SLOW_BAND) -> Stated:
    return Stated(finding("unknown", sensor, {"amplitude": Parameter([0.0, size, 0.0], None, "m/s^2")}, band))


@pytest.mark.parametrize("moved, kept", [(9e-3, False), (11e-3, True)])
def test_what_turns_show_is_kept_where_it_is_larger_than_the_tilt(moved: float, kept: bool) -> None:
    leaning = [nameless("accel", 3e-3 * STANDARD), nameless("accel", 4e-3 * STANDARD)]
    tilt = unsure_tilt(leaning, STANDARD, LASTS)
    assert tilt == pytest.approx(2.0 * 5e-3)
    assert bool(beyond(tilt, [of_turns(moved)])) is kept


@pytest.mark.parametrize("moved, kept", [(9e-3, False), (11e-3, True)])
def test_a_nameless_bias_of_the_gyroscope_adds_up_over_a_turn(moved: float, kept: bool) -> None:
    tilt = unsure_tilt([nameless("gyro", 0.01 / LASTS / np.sqrt(2.0))], STANDARD, LASTS)
    assert tilt == pytest.approx(0.01)
    assert bool(beyond(tilt, [of_turns(moved)])) is kept


def test_only_slow_nameless_errors_tilt() -> None:
    others = [
        nameless("gyro", 1.0, (5.0, 6.0)),
        nameless("accel", 1.0, (5.0, 6.0)),
        Stated(finding("accel_bias_step", "accel", {"step": Parameter([1.0] * 3, None, "m/s^2")}, SLOW_BAND)),
    ]
    assert unsure_tilt(others, STANDARD, LASTS) == 0.0
    assert beyond(0.0, [of_turns(1e-6)])


def test_what_is_unsure_of_a_named_error_tilts_and_its_size_does_not() -> None:
    """A square of the force, of 1 +- 0.2 %/g on z (a 95 % interval), by the rests of a day."""
    exam = examined(recorded(phone_with(), 3), sought=())
    residuals = next(s for s in exam.sensors if s.sensor == "accel")
    square = next(e for e in effects_of("accel") if e.name == "accel_nonlinearity" and len(e.parameters) == 1)
    interval = [[0.0, 0.0], [0.0, 0.0], [8e-4, 1.2e-3]]
    sizes = {square.parameters[0].name: Parameter([0.0, 0.0, 1e-3], interval, "1/(m/s^2)")}
    own = residuals.hypothesis(square, {})
    told = Stated(finding(square.name, "accel", sizes, SLOW_BAND), own, residuals)
    z = residuals.moments.force[:, 2]
    expected = np.sqrt(2.0) * 0.2e-3 / 1.96 * np.sqrt((z**4).mean()) / STANDARD
    assert unsure_tilt([told], STANDARD, LASTS) == pytest.approx(expected, rel=0.05)


def test_of_a_named_error_with_an_amplitude_only_what_is_unsure_tilts() -> None:
    exam = examined(recorded(phone_with(), 3), sought=())
    residuals = next(s for s in exam.sensors if s.sensor == "accel")
    settling = next(e for e in effects_of("accel") if e.name == "accel_warmup")
    own = residuals.hypotheses(settling)[0]
    amplitude = Parameter([0.5, 0.0, 0.0], [[0.5 - 1.96e-3, 0.5 + 1.96e-3], [0.0, 0.0], [0.0, 0.0]], "m/s^2")
    told = Stated(finding(settling.name, "accel", {"amplitude": amplitude}, SLOW_BAND), own, residuals)
    assert 0.0 < unsure_tilt([told], STANDARD, LASTS) < np.sqrt(2.0) * 1e-3 / STANDARD


def test_a_nameless_gain_tilts_by_what_it_adds_at_rest() -> None:
    """1000 ppm/K of the next axis' force, in a day that warms: a gyroscope's scale seemed to follow it."""
    exam = examined(recorded(phone_with(), 3), sought=())
    residuals = next(s for s in exam.sensors if s.sensor == "accel")
    crossed = CrossedForce()
    slope = Parameter([0.0, 0.0, 1e-3], [[0.0, 0.0]] * 3, "1/K")
    own = residuals.hypothesis(crossed, {})
    told = Stated(finding("unknown", "accel", {"slope": slope}, SLOW_BAND), own, residuals)
    moments = residuals.moments
    added = 0.5e-3 * moments.temperature[:, None] * moments.force[:, [0, 2]]
    expected = 2.0 * np.sqrt((added**2).sum(axis=1).mean()) / STANDARD
    assert expected > 1e-4 and unsure_tilt([told], STANDARD, LASTS) == pytest.approx(expected)


def test_a_nameless_gain_in_a_stretch_tilts_by_what_it_adds_there() -> None:
    exam = examined(recorded(phone_with(), 3), sought=())
    residuals = next(s for s in exam.sensors if s.sensor == "accel")
    stretched, moments = GainInStretch(), residuals.moments
    many = stretched.dictionary(moments)
    assert many is not None
    k = len(many.grids) // 2
    own = residuals.hypothesis(stretched, many.grids[k])
    gain = Parameter([0.0, 0.0, 0.01], [[0.0, 0.0]] * 3, "1")
    told = Stated(finding("unknown", "accel", {"gain": gain}, SLOW_BAND), own, residuals)
    added = 0.01 * many.curve(k)[0] * moments.force[:, 2]
    expected = 2.0 * np.sqrt((added**2).mean()) / STANDARD
    assert expected > 1e-4 and unsure_tilt([told], STANDARD, LASTS) == pytest.approx(expected)


def assert_only_larger_turns_are_stated(
    recording: Recording, sensor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Turns show a small and a large effect, and the sensor one without a name: the large one counts."""
    smaller, larger = of_turns(1e-3), of_turns(0.5)
    monkeypatch.setattr(diagnose, "about_effects", lambda *_: ([smaller, larger], None))
    exam = examined(recording)
    assert ("unknown", sensor) in {(s.finding.effect, s.finding.sensor) for s in exam.statements}
    (stated,) = [s for s in exam.statements if s.finding.effect == SCALE.name]
    assert stated.hypothesis is larger.hypothesis


@pytest.mark.slow
def test_a_recording_whose_accelerometer_bends_with_temperature_states_no_smaller_turns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = recorded(phone_with(), 3)
    accel = recording.accelerometer
    assert accel.temperature is not None
    warm = accel.temperature - accel.temperature.min()
    bent = np.outer(1.0 - np.exp(-6.0 * warm / warm.max()), [0.024, -0.048, 0.08])
    bending = replace(recording, accelerometer=replace(accel, xyz=frozen(accel.xyz + bent)))
    assert_only_larger_turns_are_stated(bending, "accel", monkeypatch)


@pytest.mark.slow
def test_a_gyroscope_whose_bias_comes_and_goes_states_no_smaller_turns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """2 mrad/s for 12 s of every 70: what it adds up to over a turn seemed a gain that follows the rate."""
    recording = recorded(phone_with(), 3)
    gyro = recording.gyroscope
    assert gyro is not None
    lit = np.outer(gyro.t % 70.0 < 12.0, [1e-3, 0.0, 2e-3])
    flickering = replace(recording, gyroscope=replace(gyro, xyz=frozen(gyro.xyz + lit)))
    assert_only_larger_turns_are_stated(flickering, "gyro", monkeypatch)
