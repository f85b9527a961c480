"""Temperature learnt in use: taken up on evidence, dropped on evidence, never worse than without it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from stillcal.calib_core.accelerometer.parameters import names
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.acceptance import CLEARLY, clearly_smaller, stated_uncertainty
from stillcal.calib_core.calibration.bias_curve.learn import learn_accelerometer, learn_gyroscope
from stillcal.calib_core.calibration.bias_curve.learnt import DROPPED, TAKEN_UP, held_term
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.following import follow_accelerometer, with_learnt_gyroscope
from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.calibration.terms import bias_terms
from stillcal.calib_core.codec import packed, unpacked
from stillcal.calib_core.engine.actions import Publish
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Tick
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.forecast import Forecast
from stillcal.calib_core.temperature.memory import MAX_AGE_S, Memory
from stillcal.calib_core.temperature.thermometer import Thermometer
from tests.calib_core.temperature.test_regression import moved_along_a_line

HOUR, G = 3600.0, 9.80665
DEG, MG = np.pi / 180, G * 1e-3
SETTINGS = QualitySettings()
GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
RATE_SLOPE = 0.02 * DEG * np.array([1.0, -0.6, 0.3])
FORCE_SLOPE = 0.5 * MG * np.array([0.8, -0.3, 0.5])
TRUE = SensorModel.of(
    np.eye(3) + 0.01 * np.array([[1, 0.4, 0], [0.4, -1, 0.2], [0, 0.2, 0.5]]), 30 * MG * np.ones(3)
)


def celsius_at(t: float) -> float:
    return 25.0 + 8.0 * np.sin(2 * np.pi * t / (7 * HOUR)) + np.sin(t / 1e3)


def lived(
    hours: float,
    seed: int = 0,
    slopes: float = 1.0,
    read: Callable[[float, float], float | None] = lambda t, celsius: celsius,
    knock: tuple[float, Array] = (np.inf, np.zeros(3)),
    every_s: float = 1200.0,
) -> list[RestState]:
    """Return a rest every 20 minutes, or `every_s`, in attitudes of any direction.

    slopes: how strongly both biases follow the temperature. read: the thermometer, of time (s) and truth.
    knock: time, s, and step of the accelerometer's bias, m/s^2.
    """
    rng, rests = np.random.default_rng(seed), []
    for t in np.arange(0.0, hours * HOUR, every_s).tolist():
        celsius = celsius_at(t)
        up = rng.standard_normal(3)
        bias = TRUE.bias + slopes * FORCE_SLOPE * (celsius - 25.0) + (t >= knock[0]) * knock[1]
        force = (
            np.linalg.solve(TRUE.scale, G * up / np.linalg.norm(up))
            + bias
            + 0.03 * MG * rng.standard_normal(3)
        )
        rate = 0.5 * DEG + slopes * RATE_SLOPE * (celsius - 25.0) + 5e-4 * DEG * rng.standard_normal(3)
        sd, rate_sd = frozen(np.full(3, 0.03 * MG)), frozen(np.full(3, 5e-4 * DEG))
        rests.append(
            RestState(
                t,
                t + 30.0,
                3000,
                frozen(force),
                sd,
                sd,
                0.01,
                temperature=read(t, celsius),
                rate=frozen(rate),
                rate_sd=rate_sd,
                rate_uncertainty=rate_sd,
            )
        )
    return rests


def remembered(rests: list[RestState]) -> Memory:
    memory = Memory()
    for rest in rests:
        memory = memory.with_rest(rest, G)
    return memory


def gyroscope_record() -> CalibrationRecord:
    return CalibrationRecord(gyroscope=GyroscopeRecord(scale=np.eye(3), bias=np.zeros(3), parameters=3))


def accelerometer_record(model: SensorModel = TRUE, sd: float = 3 * MG) -> CalibrationRecord:
    part = AccelerometerRecord(
        scale=model.scale, bias=model.bias, parameters=9, names=names(9),
        covariance=np.diag([sd**2] * 3 + [(sd / G) ** 2] * 6),
        gravity=G, rms_residual=sd, n_rests=12, n_states=12,
    )  # fmt: skip
    return CalibrationRecord(accelerometer=part, fitted_at=0.0)


@pytest.mark.parametrize("with_prior", [True, False])
def test_a_first_calibration_that_a_prior_entered_is_replaced_after_two_hours(with_prior: bool) -> None:
    """It is off by 20 mg where it says 25 mg; one that stands on its rests waits for six hours."""
    off = SensorModel.of(TRUE.scale, TRUE.bias + 20 * MG * np.array([0.0, 1.0, 0.0]))
    record = accelerometer_record(off, 25 * MG)
    assert record.accelerometer is not None
    first = replace(record, accelerometer=replace(record.accelerometer, with_prior=with_prior))
    memory = remembered(lived(1.9, slopes=0.0, every_s=500.0))
    followed = follow_accelerometer(first, memory, 1.9 * HOUR, SETTINGS)
    assert followed is not None and followed.accepted is with_prior
    if with_prior:
        part = followed.record.accelerometer
        assert part is not None and part.bias == pytest.approx(TRUE.bias, abs=1 * MG)
        assert "less uncertain" in followed.record.acceptance.reason


def followed_gyroscope(rests: list[RestState]) -> tuple[CalibrationRecord, list[str]]:
    """Learn at every third rest, as at hourly checks; return the record and the decisions on the curve."""
    record, memory, changes = gyroscope_record(), Memory(), []
    for number, rest in enumerate(rests):
        memory = memory.with_rest(rest, G)
        if number % 3 == 2 and (learnt := learn_gyroscope(memory, record, rest.t_end, SETTINGS)) is not None:
            record = with_learnt_gyroscope(record, learnt, rest.t_end)
            changes += [learnt.change] if learnt.change else []
    return record, changes


def test_a_gyroscopes_curve_is_taken_up_and_told_with_its_reason() -> None:
    record, changes = followed_gyroscope(lived(20.0))
    term = held_term(record.terms, GYRO)
    assert changes == [TAKEN_UP] and term is not None
    assert term.parameters["slope"].value == pytest.approx(RATE_SLOPE, rel=0.1, abs=1e-3 * DEG)
    told = record.gyroscope.bias + bias_terms(record, GYRO, np.array([31.0]))[0]
    assert told == pytest.approx(0.5 * DEG + 6.0 * RATE_SLOPE, abs=5e-3 * DEG)


def test_without_tempco_or_without_evidence_nothing_is_taken_up() -> None:
    two_hours = lived(1.9, every_s=600.0)
    for rests in (lived(20.0, slopes=0.0), two_hours, lived(20.0, read=lambda t, celsius: 25.0)):
        record, changes = followed_gyroscope(rests)
        assert changes == [] and record.terms == ()
        assert GYRO in record.forecast


def test_temperatures_that_are_all_alike_tell_nothing_of_others() -> None:
    """Rests at 25 degC show what holds there; 20 K away the bias is as uncertain as data sheets leave it."""
    rests = [structs.replace(rest, temperature=25.0) for rest in lived(6.0, slopes=0.0)]
    record, _ = followed_gyroscope(rests)
    t = rests[-1].t_end
    here, away = (record.bias_uncertainty_at(GYRO, t, celsius) for celsius in (25.0, 5.0))
    assert here.max() < 5e-3 * DEG
    assert away.min() > 20.0 * np.abs(RATE_SLOPE).max()


def test_a_curve_that_is_held_stays_as_certain_where_later_temperatures_are_all_alike() -> None:
    record, _ = followed_gyroscope(lived(30.0))
    constant = [structs.replace(rest, temperature=25.123) for rest in lived(6.0, slopes=0.0)]
    learnt = learn_gyroscope(remembered(constant), record, 6 * HOUR, SETTINGS)
    assert learnt is not None and learnt.change == ""
    later = with_learnt_gyroscope(record, learnt, 6 * HOUR)
    assert later.terms == record.terms
    stated, before = (r.bias_uncertainty_at(GYRO, r.forecast[GYRO].at, 33.0) for r in (later, record))
    assert (stated > before).all() and (stated < 5e-3 * DEG).all()


def test_where_few_hours_leave_no_doubt_a_curve_is_taken_up_after_them() -> None:
    """The test of signs alone takes nine hours at least."""
    assert followed_gyroscope(lived(5.0))[1] == [TAKEN_UP]


def test_a_thermometer_that_turns_wild_has_its_curve_dropped() -> None:
    wild = np.random.default_rng(5)

    def read(t: float, celsius: float) -> float:
        return celsius if t < 20 * HOUR else celsius + float(wild.choice([-6.0, 6.0]))

    record, changes = followed_gyroscope(lived(40.0, read=read))
    assert changes == [TAKEN_UP, DROPPED] and record.terms == ()


@pytest.mark.parametrize(
    ("read", "doubt"),
    [
        (lambda t, celsius: 27.0, "predicted worse"),
        (lambda t, celsius: celsius + 40.0, "far from all others"),
        (lambda t, celsius: 20.0 + 7 * np.cos(t / 5e3), "predicted worse"),
    ],
    ids=["freezes", "lies by 40 K", "tells another chip's"],
)
def test_a_thermometer_that_fails_is_believed_no_longer_after_two_checks(
    read: Callable[[float, float], float], doubt: str
) -> None:
    """The bias stated is then the same at any temperature. Later the thermometer is believed again."""

    def failing(t: float, celsius: float) -> float:
        return read(t, celsius) if 20 * HOUR < t < 26 * HOUR else celsius

    record, learnt_at, held = gyroscope_record(), {}, []
    memory = Memory()
    for number, rest in enumerate(lived(34.0, read=failing)):
        t, at = rest.t_start, np.array([rest.temperature])
        if 22 * HOUR < t < 26 * HOUR:
            error = rest.rate - record.gyroscope.bias - np.ravel(bias_terms(record, GYRO, at))
            held += (np.abs(error) < 1.96 * record.bias_uncertainty_at(GYRO, t, at[0])).tolist()
        memory = memory.with_rest(rest, G)
        if number % 3 == 2:
            learnt = learn_gyroscope(memory, record, rest.t_end, SETTINGS)
            assert learnt is not None
            record = with_learnt_gyroscope(record, learnt, rest.t_end)
            learnt_at[rest.t_end / HOUR] = learnt
    hour, first = next((h, learnt) for h, learnt in learnt_at.items() if learnt.change == DROPPED)
    assert 20.0 < hour < 22.0 and doubt in first.reason
    cold, hot = (first.forecast.bias_uncertainty(21 * HOUR, c) for c in (20.0, 70.0))
    assert cold == pytest.approx(hot)
    print(f"{np.mean(held):.0%} of the 95 % intervals hold")
    assert np.mean(held) > 0.95
    assert [hour for hour, learnt in learnt_at.items() if learnt.change == TAKEN_UP][-1] < 30.0


@pytest.mark.parametrize(
    "read",
    [
        lambda t, celsius: round(celsius),
        lambda t, celsius: celsius_at(t - 900.0),
        lambda t, celsius: celsius + (40.0 if t > 20 * HOUR else 0.0),
        lambda t, celsius: celsius if t < 20 * HOUR else 27.0,
        lambda t, celsius: celsius if t < 20 * HOUR else None,
        lambda t, celsius: 20.0 + 7 * np.cos(t / 5e3),
        lambda t, celsius: celsius + 12.0 * (int(t / 9000.0) % 2),
        lambda t, celsius: celsius if int(t / (4 * HOUR)) % 3 else None,
    ],
    ids=[
        "1 K steps",
        "15 minutes late",
        "lies by 40 K",
        "freezes",
        "goes",
        "of another chip",
        "jumps",
        "comes and goes",
    ],
)
def test_no_thermometer_makes_it_worse_than_none(read: Callable[[float, float], float | None]) -> None:
    """Each hour the bias told is compared with the next rest, hours 20 to 30; the bar is without one."""

    def error(read: Callable[[float, float], float | None]) -> float:
        record, memory, errors, heard = gyroscope_record(), Memory(), [], Thermometer()
        for number, rest in enumerate(lived(30.0, read=read)):
            t, celsius = rest.t_start, np.nan if rest.temperature is None else rest.temperature
            minutes = np.arange(t - 1200.0, t, 60.0)
            readings = [read(at, celsius_at(at)) for at in minutes.tolist()]
            heard = heard.with_readings(minutes, np.array(readings, dtype=np.float64))
            late = heard.lagged(t, celsius)
            if number % 3 == 0 and t > 20 * HOUR:
                at = None if rest.temperature is None else np.array([celsius])
                told = record.gyroscope.bias + np.ravel(bias_terms(record, GYRO, at, None, late))
                errors.append(np.linalg.norm(rest.rate - told))
            memory = memory.with_rest(structs.replace(rest, lagged=late), G)
            learnt = learn_gyroscope(memory, record, rest.t_end, SETTINGS) if number % 3 == 2 else None
            if learnt is not None:
                record = with_learnt_gyroscope(record, learnt, rest.t_end)
        return float(np.sqrt(np.mean(np.square(errors))))

    assert error(read) < 1.1 * error(lambda t, celsius: None)


@pytest.mark.parametrize("read", [lambda celsius: None, lambda celsius: celsius + 40.0], ids=["goes", "lies"])
def test_what_a_curve_showed_is_stated_while_no_temperature_is_believed(
    read: Callable[[float], float | None],
) -> None:
    """The bias of now is that of the newest rests, and the temperature may be any other one by now.

    It is stated for as long as rests are kept.
    """
    record = replace(gyroscope_record(), accelerometer=accelerometer_record().accelerometer, fitted_at=0.0)
    memory, centre, missed = Memory(), None, []
    for number, rest in enumerate(lived(28.0, read=lambda t, c: read(c) if t > 20 * HOUR else c)):
        t, truth = rest.t_start, celsius_at(rest.t_start) - 25.0
        if t > 21.1 * HOUR:
            at = None if rest.temperature is None else np.array([rest.temperature])
            for sensor, bias in (
                (GYRO, 0.5 * DEG + RATE_SLOPE * truth),
                (ACCEL, TRUE.bias + FORCE_SLOPE * truth),
            ):
                told = record.model(sensor).bias + np.ravel(bias_terms(record, sensor, at))
                missed.append((told - bias) / record.bias_uncertainty_at(sensor, t, rest.temperature))
        memory, now = memory.with_rest(rest, G), rest.t_end
        if number % 3 == 2 and (learnt := learn_gyroscope(memory, record, now, SETTINGS)) is not None:
            record = with_learnt_gyroscope(record, learnt, now)
            if (followed := follow_accelerometer(record, memory, now, SETTINGS, centre=centre)) is not None:
                record, centre = followed.record, followed.centre
    assert np.mean(np.abs(missed) < 1.96) > 0.95 and np.abs(missed).max() < 3.0
    stated = record.forecast[str(GYRO)]
    assert stated.unfollowed == pytest.approx(np.abs(RATE_SLOPE) * 8.0, rel=0.4)
    later = learn_gyroscope(memory, record, stated.unfollowed_since + MAX_AGE_S + HOUR, SETTINGS)
    assert later is not None and later.forecast.unfollowed_since is None


def used_now_and_then(seed: int, warmer: float) -> list[RestState]:
    """Return two days of rests of a phone without a thermometer.

    It lies for two hours, with a rest every nine minutes, and is used for one, by which it gets warmer (K).
    """
    rng, rests = np.random.default_rng(seed), []
    for rest in lived(48.0, seed, slopes=0.0, read=lambda t, celsius: None, every_s=540.0):
        into = rest.t_start % (3 * HOUR)
        assert rest.rate is not None
        used = warmer * rng.normal(1.0, 0.3) * (into < 540.0)
        if into < 2 * HOUR:
            rests.append(structs.replace(rest, rate=frozen(rest.rate + used * RATE_SLOPE)))
    return rests


@pytest.mark.parametrize("seed", [0, 1])
def test_how_far_off_rests_are_after_use_is_stated_while_a_phone_shows_no_rest(seed: int) -> None:
    """What rests say of each other is too certain for a phone in use; the first rest after it shows that."""

    def learnt(warmer: float) -> tuple[Forecast, float]:
        rests = used_now_and_then(seed, warmer)
        found = learn_gyroscope(remembered(rests), gyroscope_record(), rests[-1].t_end, SETTINGS)
        assert found is not None
        return found.forecast, rests[-1].t_end - 15.0

    forecast, rested_at = learnt(warmer=6.0)
    assert forecast.rested_at == pytest.approx(rested_at)
    of_fit, soon, late = (
        f.bias_uncertainty(rested_at + age, None).max()
        for f, age in ((forecast.of_fit(), 601.0), (forecast, 599.0), (forecast, 601.0))
    )
    assert soon == pytest.approx(of_fit, rel=0.01) and late > 1.5 * of_fit
    assert learnt(warmer=0.0)[0].unseen < 1.3


def off_by(record: CalibrationRecord, celsius: float, step: Array | float = 0.0) -> float:
    """Return the error of the accelerometer's bias at a temperature, mg, largest axis.

    step: m/s^2, by which the bias has stepped.
    """
    told = record.accelerometer.bias + np.ravel(bias_terms(record, ACCEL, np.array([celsius])))
    return float(np.abs(told - TRUE.bias - step - FORCE_SLOPE * (celsius - 25.0)).max() / MG)


def test_an_accelerometers_calibration_follows_temperature_on_evidence() -> None:
    biased = SensorModel.of(TRUE.scale, TRUE.bias + 2 * MG)
    record = accelerometer_record(biased)
    followed = follow_accelerometer(record, remembered(lived(30.0)), 30 * HOUR, SETTINGS)
    assert followed is not None and followed.accepted
    new = followed.record
    assert "better by more than chance" in new.acceptance.reason and TAKEN_UP in new.acceptance.reason
    assert max(off_by(new, 19.0), off_by(new, 31.0)) < 0.2
    assert off_by(record, 31.0) > 2.0
    stated = new.bias_uncertainty_at(ACCEL, 30 * HOUR, 31.0)
    assert (stated < 0.3 * MG).all()


def test_what_is_not_replaced_yet_is_told_as_uncertain() -> None:
    """Five hours do not decide; the error that is known by then is in the uncertainty told."""
    record = accelerometer_record(SensorModel.of(TRUE.scale, TRUE.bias + 2 * MG))
    followed = follow_accelerometer(record, remembered(lived(5.0)), 5 * HOUR, SETTINGS)
    assert followed is not None and not followed.accepted
    assert followed.record.accelerometer is record.accelerometer
    for celsius in (19.0, 25.0, 31.0):
        stated = followed.record.bias_uncertainty_at(ACCEL, 5 * HOUR, celsius)
        assert off_by(record, celsius) * MG < 3 * stated.max()


def test_a_knock_widens_what_is_told_at_the_next_rest() -> None:
    rests = lived(31.0, knock=(30.5 * HOUR, np.array([15.0, -12.0, 10.0]) * MG))
    before, after = remembered(rests[:90]), remembered(rests[:93])
    stated = []
    for memory, t in ((before, rests[89].t_end), (after, rests[92].t_end)):
        followed = follow_accelerometer(
            replace(accelerometer_record(), fitted_at=t - 60.0), memory, t, SETTINGS
        )
        assert followed is not None
        stated.append(followed.record.bias_uncertainty_at(ACCEL, t, 25.0).max())
    assert stated[1] > 5 * stated[0]


KNOCK = np.array([4.0, -3.0, 3.5]) * MG


def followed_hourly(rests: list[RestState], hours: range) -> list[tuple[int, CalibrationRecord]]:
    """Learn a calibration at the first of `hours`, follow it at the others; return what replaced it."""
    start, replaced = hours[0] * HOUR, []
    first = follow_accelerometer(
        accelerometer_record(), remembered([r for r in rests if r.t_end <= start]), start, SETTINGS
    )
    assert first is not None and first.accepted
    record, centre = first.record, first.centre
    for hour in hours[1:]:
        memory = remembered([r for r in rests if r.t_end <= hour * HOUR])
        followed = follow_accelerometer(record, memory, hour * HOUR, SETTINGS, centre=centre)
        assert followed is not None
        record, centre = followed.record, followed.centre
        replaced += [(hour, record)] if followed.accepted else []
    return replaced


def test_a_knock_is_followed_within_hours() -> None:
    """The rule of held-out hours needs six of them; the rests since the step decide sooner."""
    replaced = followed_hourly(lived(40.0, knock=(30.5 * HOUR, KNOCK)), range(30, 40))
    hour, record = replaced[0]
    assert hour < 30.5 + SETTINGS.held_out_rests and "the bias stepped" in record.acceptance.reason
    assert max(off_by(record, 19.0, KNOCK), off_by(record, 31.0, KNOCK)) < 0.5


@pytest.mark.parametrize("size_mg", [1, 10, 100, 500])
@pytest.mark.parametrize("about", ["the old bias", "the new bias"])
def test_a_knock_of_any_size_is_learnt_with_an_interval_that_holds(size_mg: float, about: str) -> None:
    """Rests are linear about the bias of their own time: a step of 100 mg bends norms by 5 mg."""
    knock = size_mg * MG * np.array([0.6, -0.5, 0.62])
    rests = lived(16.0, slopes=0.0, knock=(12.4 * HOUR, knock), seed=3)
    model = SensorModel.of(TRUE.scale, TRUE.bias + (knock if about == "the new bias" else 0.0))
    t = rests[-1].t_end
    learnt = learn_accelerometer(remembered(rests), model, accelerometer_record(model), t, SETTINGS)
    assert learnt is not None
    error = np.abs(learnt.bias - TRUE.bias - knock)
    stated = learnt.forecast.bias_uncertainty(t, celsius_at(t))
    assert error.max() < 0.3 * MG and (error < 3 * stated).all() and stated.max() < 0.3 * MG


@pytest.mark.parametrize("size_mg", [20, 400])
def test_one_rest_that_shows_a_step_leaves_as_much_unknown_across(size_mg: float) -> None:
    knock = size_mg * MG * np.array([0.6, -0.5, 0.62])
    rests = lived(16.0, slopes=0.0, knock=(np.nextafter(15.6 * HOUR, 0.0), knock), seed=3)
    t = rests[-1].t_end
    learnt = learn_accelerometer(remembered(rests), TRUE, accelerometer_record(), t, SETTINGS)
    assert learnt is not None and len(learnt.steps) == 1
    assert (np.abs(learnt.bias - TRUE.bias - knock) < 2 * learnt.forecast.bias_uncertainty(t, 25.0)).all()


def test_a_phone_that_lies_flat_is_followed_as_its_bias_moves_along_one_line() -> None:
    """With a wander that is taken to be alike on all axes, the bias across gravity is off by 4.7 mg."""
    flat, errors = SensorModel.of(np.eye(3), np.zeros(3)), []
    for seed in range(24):
        seen, bias = moved_along_a_line(seed)
        noise = 0.05 * MG * np.random.default_rng(100 + seed).standard_normal(bias.shape)
        none, t = np.full(bias.shape, np.nan), float(seen.t[-1])
        force, force_sd = bias + noise - G * seen.towards, np.full(bias.shape, 0.05 * MG)
        rests = Memory(seen.t, none[:, 0], force, force_sd, none, none, np.full(len(bias), G))
        learnt = learn_accelerometer(rests, flat, None, t, SETTINGS)
        assert learnt is not None
        errors.append(learnt.bias - bias[-1])
    assert np.sqrt(np.square(errors)[:, :2].mean()) < 4.0 * MG


def test_a_large_knock_is_followed_within_hours() -> None:
    """What the step itself was missed by is not taken for scatter of rests, which checks allow for."""
    knock = 100 * MG * np.array([0.6, -0.5, 0.62])
    hour, record = followed_hourly(lived(35.0, knock=(30.5 * HOUR, knock)), range(30, 35))[0]
    assert hour <= 33
    assert record.accelerometer.rms_residual < 0.1 * MG
    assert max(off_by(record, 19.0, knock), off_by(record, 31.0, knock)) < 1.0


BREAKS: dict[str, Callable[[RestState], Array]] = {
    "z reads 0": lambda rest: rest.specific_force * [1.0, 1.0, 0.0],
    "x is inverted": lambda rest: rest.specific_force * [-1.0, 1.0, 1.0],
    "scale grows": lambda rest: rest.specific_force * 1.03,
    "scale is noise": lambda rest: rest.specific_force * (1.0 + 0.1 * np.sin(rest.t_start * np.arange(1, 4))),
}


@pytest.mark.parametrize("broken", BREAKS)
@pytest.mark.parametrize("seed", [1, 4])
def test_what_three_rests_after_a_break_fit_exactly_is_no_calibration(broken: str, seed: int) -> None:
    """Three rests show three axes of a step, right or wrong: nothing is left to test it."""
    rests = lived(7.0, seed=seed, slopes=0.0)
    late = [
        structs.replace(r, specific_force=frozen(BREAKS[broken](r))) for r in rests if r.t_start >= 6 * HOUR
    ]
    memory = remembered([*(r for r in rests if r.t_start < 6 * HOUR), *late])
    record = accelerometer_record(sd=0.1 * MG)
    followed = follow_accelerometer(record, memory, 7 * HOUR, SETTINGS, degraded=True)
    assert followed is not None and followed.record.accelerometer is record.accelerometer
    stated = followed.record.bias_uncertainty_at(ACCEL, 7 * HOUR, 25.0)
    assert stated is not None and stated.max() > 0.1


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_rests_that_contradict_each_other_replace_no_calibration(seed: int) -> None:
    """The z of an accelerometer reads 0 after six hours: no bias and no scale makes its rests agree."""
    record = accelerometer_record(sd=0.1 * MG)
    for hour in (9, 11):
        rests = lived(hour, seed=seed, slopes=0.0)
        late = [
            structs.replace(r, specific_force=BREAKS["z reads 0"](r)) for r in rests if r.t_start >= 6 * HOUR
        ]
        memory = remembered([*(r for r in rests if r.t_start < 6 * HOUR), *late])
        followed = follow_accelerometer(record, memory, hour * HOUR, SETTINGS, degraded=True)
        assert followed is not None and followed.record.accelerometer is record.accelerometer


def test_one_bad_rest_is_no_knock() -> None:
    rests = lived(36.0)
    bad = next(k for k, r in enumerate(rests) if r.t_start > 30.5 * HOUR)
    rests[bad] = structs.replace(rests[bad], specific_force=frozen(rests[bad].specific_force * 1.01))
    assert followed_hourly(rests, range(30, 36)) == []


@pytest.mark.slow
def test_a_year_of_calibrations_that_replace_each_other_does_not_creep() -> None:
    """A year of rests, followed daily: few calibrations replace each other, none strays from the truth."""
    record, memory, errors, scales, centre, told = accelerometer_record(), Memory(), [], [], None, []
    for rest in lived(365 * 24.0, every_s=11.3 * HOUR):
        memory = memory.with_rest(rest, G)
        if rest.t_end % (24 * HOUR) < 12 * HOUR:
            followed = follow_accelerometer(record, memory, rest.t_end, SETTINGS, centre=centre)
            if followed is not None:
                centre = followed.centre
                told.append(max(off_by(followed.record, 19.0), off_by(followed.record, 31.0)))
            if followed is not None and followed.accepted:
                record = followed.record
                errors.append(max(off_by(record, 19.0), off_by(record, 31.0)))
                scales.append(np.abs(record.accelerometer.scale - TRUE.scale).max())
            elif followed is not None:
                record = followed.record
    assert 1 <= len(errors) <= 8
    assert max(errors[1:], default=0.0) < 0.3 and errors[-1] < 0.2
    assert scales[-1] < 3e-4
    assert max(told[-270:]) < 0.3 and np.median(told[-90:]) <= 1.2 * np.median(told[-270:-180])


def wandering(until: float) -> list[RestState]:
    """Return the rests of 34 hours; the accelerometer's bias rises by 0.1 mg an hour until `until`."""
    rests = lived(34.0, slopes=0.0)
    for k, rest in enumerate(rests):
        moved = 0.1 * MG * min(rest.t_start / HOUR, until) * np.ones(3)
        rests[k] = structs.replace(rest, specific_force=frozen(rest.specific_force + moved))
    return rests


def test_the_calibration_in_use_follows_its_rests_about_the_accepted_one() -> None:
    """What is learnt is told before it may replace the accepted one; it depends on that one and the rests."""
    first = accelerometer_record(SensorModel.of(TRUE.scale, TRUE.bias + 3.0 * MG))
    first, centre = replace(first, fitted_at=30 * HOUR), None
    rests, record = wandering(until=34.0), first
    for hour in range(31, 35):
        memory = remembered([r for r in rests if r.t_end <= hour * HOUR])
        followed = follow_accelerometer(record, memory, hour * HOUR, SETTINGS, centre=centre)
        assert followed is not None and not followed.accepted
        record, centre = followed.record, followed.centre
    assert centre is not None and centre.accelerometer is first.accelerometer
    assert record.acceptance.how == "following" and record.fitted_at == first.fitted_at
    assert off_by(record, 25.0, 3.4 * MG) < 0.5 * off_by(first, 25.0, 3.4 * MG)
    stated = record.bias_uncertainty_at(ACCEL, 34 * HOUR, 25.0)
    assert off_by(record, 25.0, 3.4 * MG) * MG < 2 * stated.max()
    at_once = follow_accelerometer(first, memory, 34 * HOUR, SETTINGS)
    assert at_once is not None
    told = at_once.record.accelerometer.bias
    assert record.accelerometer.bias == pytest.approx(told, abs=1e-3 * MG)
    steady = remembered(wandering(until=30.0))
    back = follow_accelerometer(record, steady, 34 * HOUR, SETTINGS, centre=centre)
    assert back is not None and back.centre is None and not back.accepted
    assert back.record.accelerometer is first.accelerometer
    assert "no longer follows" in back.record.acceptance.reason


def test_clearly_smaller_is_half_the_variance_over_all_directions() -> None:
    old = accelerometer_record(sd=1 * MG).accelerometer
    for share, expected in ((CLEARLY - 0.01, True), (CLEARLY + 0.01, False)):
        new = accelerometer_record(sd=share * MG).accelerometer
        assert clearly_smaller(new, old) is expected
    assert stated_uncertainty(replace(old, covariance=None, names=())) is None
    assert clearly_smaller(old, replace(old, covariance=None, names=())) is False


def calibrated_engine(**schedule: object) -> Engine:
    """Return an engine that was given thirty hours of rests and then asked for a calibration."""
    engine = Engine(EngineSettings(schedule=ScheduleSettings(gravity=G, **schedule)))
    engine.add_rests(lived(30.0))
    engine.feed(Tick(30 * HOUR))
    engine.calibrate()
    return engine


def test_the_engine_learns_from_its_rests_and_forgets_them_at_a_rollback() -> None:
    engine = calibrated_engine()
    record = engine.present.record
    assert {term.effect for term in record.terms} == {"accel_bias_temperature", "gyro_bias_temperature"}
    assert record.acceptance.reason.count(TAKEN_UP) == 2
    assert max(off_by(record, 19.0), off_by(record, 31.0)) < 0.3
    plain = calibrated_engine(learn_temperature=False).present.record
    assert plain.terms == () and max(off_by(plain, 19.0), off_by(plain, 31.0)) > 1.0
    again = unpacked(packed(engine.state), EngineState)
    assert np.array_equal(again.memory.force, engine.state.memory.force)
    assert again.record.forecast.keys() == record.forecast.keys()
    engine.use_calibration(plain)
    assert len(engine.state.memory) == 0


def test_the_engine_publishes_what_follows_and_a_rollback_ends_it() -> None:
    engine = Engine(EngineSettings(schedule=ScheduleSettings(gravity=G)))
    first = accelerometer_record(SensorModel.of(TRUE.scale, TRUE.bias + 3.0 * MG))
    engine.use_calibration(replace(first, fitted_at=30 * HOUR))
    engine.add_rests([structs.replace(rest, rate=None) for rest in wandering(until=34.0)])
    engine._policy.check(34 * HOUR)
    published = [a for a in engine.feed(Tick(34 * HOUR)) if isinstance(a, Publish)]
    assert [a.record.acceptance.how for a in published] == ["following"]
    assert engine.present.centre.accelerometer is first.accelerometer
    assert engine.present.record is published[0].record and not engine.present.degraded
    again = unpacked(packed(engine.state), EngineState)
    assert np.array_equal(again.centre.accelerometer.bias, first.accelerometer.bias)
    engine.use_calibration(first)
    assert engine.present.centre is None
