"""A bias that follows the charger, where there is no thermometer: learnt, dropped, told and applied."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import structs

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.bias_curve import driver, learn
from stillcal.calib_core.calibration.bias_curve.learn import learn_gyroscope
from stillcal.calib_core.calibration.bias_curve.learnt import DROPPED, TAKEN_UP, held_term
from stillcal.calib_core.calibration.bias_curve.observations import shown_by_gyroscope
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING
from stillcal.calib_core.calibration.corrections.term import lag_of
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.following import with_learnt_gyroscope
from stillcal.calib_core.calibration.record import CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.calibration.terms import bias_terms, correct_both
from stillcal.calib_core.codec import packed, unpacked
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Charging, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.temperature.charger import Charger
from stillcal.calib_core.temperature.memory import Memory
from stillcal.calib_core.temperature.thermometer import Thermometer
from stillcal.daemon.service.live_stream import LiveStream
from tests.calib_core.calibration.test_lag import late

GRID_S, HOUR, DEG, G = 10.0, 3600.0, np.pi / 180, 9.80665
MG = G * 1e-3
T = np.arange(0.0, 48 * HOUR, GRID_S)
FULL_RATE = 0.15 * DEG * np.array([1.0, -0.6, 0.3])
FULL_FORCE = 5 * MG * np.array([0.8, -0.3, 0.5])
RATE_SD, FORCE_SD = 5e-4 * DEG, 0.03 * MG
GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
SETTINGS = QualitySettings()


def plugged(seed: int) -> list[Charging]:
    """Return the charger's changes: in for half an hour to some hours, three or four times a day."""
    rng, events, t = np.random.default_rng(seed), [], 600.0
    while t < T[-1]:
        events.append(Charging(t, not len(events) % 2))
        t += rng.uniform(0.5, 4.0) * HOUR
    return events


def heat(events: list[Charging], lag_s: float = 1000.0) -> Array:
    """Return how far the phone has warmed up at T, 0 to 1."""
    on = np.zeros(len(T))
    for event in events:
        on[event.t <= T] = float(event.on)
    return late(on, lag_s)


def wander(seed: int) -> Array:
    """Return a bias that follows nothing: a random walk of 0.05 deg/s a day, (n, 3)."""
    steps = np.random.default_rng(1000 + seed).standard_normal((len(T), 3))
    return 0.05 * DEG * np.sqrt(GRID_S / (24 * HOUR)) * np.cumsum(steps, axis=0)


def rests_of(bias: Array, events: list[Charging], seed: int, celsius: Array | None = None) -> list[RestState]:
    """Return a rest every half hour, in any attitude, of a phone with a bias (n, 3) rad/s at T."""
    rng, warm = np.random.default_rng(seed), heat(events)
    sd, rate_sd = frozen(np.full(3, FORCE_SD)), frozen(np.full(3, RATE_SD))
    rests = []
    for row in range(60, len(T), 180):
        up, t = rng.standard_normal(3), float(T[row])
        force = G * up / np.linalg.norm(up) + warm[row] * FULL_FORCE + FORCE_SD * rng.standard_normal(3)
        rate = bias[row] + RATE_SD * rng.standard_normal(3)
        rests.append(
            RestState(
                t - 15.0, t + 15.0, 3000, frozen(force), sd, sd, 0.01, frozen(rate), rate_sd, rate_sd,
                temperature=None if celsius is None or not np.isfinite(celsius[row]) else float(celsius[row]),
            )
        )  # fmt: skip
    return rests


def followed(
    bias: Array,
    events: list[Charging],
    seed: int,
    celsius: Array | None = None,
    look: Callable[[CalibrationRecord, int], None] = lambda record, row: None,
) -> tuple[CalibrationRecord, list[str]]:
    """Learn a gyroscope's bias every two hours; return the record and all decisions."""
    record = CalibrationRecord(gyroscope=GyroscopeRecord(scale=np.eye(3), bias=np.zeros(3), parameters=3))
    memory, charger, changes = Memory(), Charger().with_events(events), []
    for number, rest in enumerate(rests_of(bias, events, seed, celsius)):
        warm = structs.replace(rest, charged=charger.at(0.5 * (rest.t_start + rest.t_end)))
        memory = memory.with_rest(warm, G)
        learnt = learn_gyroscope(memory, record, rest.t_end, SETTINGS) if number % 4 == 3 else None
        if learnt is not None:
            record = with_learnt_gyroscope(record, learnt, rest.t_end)
            changes += [learnt.reason] if learnt.change else []
            look(record, int(rest.t_end / GRID_S))
    return record, changes


@pytest.mark.parametrize("seed", [0, 1])
def test_a_bias_that_follows_the_charger_is_learnt_and_its_interval_holds(seed: int) -> None:
    events = plugged(seed)
    bias = np.outer(heat(events), FULL_RATE) + 0.2 * wander(seed)
    apart, sds, charger, rng = [], [], Charger().with_events(events), np.random.default_rng(seed)

    def foretold(known: CalibrationRecord, row: int) -> None:
        """Compare the bias up to two hours later with what is told, once the term is in use."""
        later = min(row + int(rng.uniform(0, 720)), len(T) - 1)
        if known.terms:
            charged, part = charger.at(float(T[later])), known.gyroscope
            told = part.bias + np.ravel(bias_terms(known, GYRO, None, charged=charged))
            apart.append(bias[later] - told)
            sds.append(known.bias_uncertainty_at(GYRO, float(T[later]), None, charged=charged))

    record, changes = followed(bias, events, seed, look=foretold)
    assert len(changes) == 1 and f"bias by charging {TAKEN_UP}" in changes[0]
    term = held_term(record.terms, GYRO)
    assert term is not None and term.effect == BY_CHARGING and lag_of(term) in (600.0, 1200.0)
    assert term.parameters["amplitude"].value == pytest.approx(FULL_RATE, rel=0.15, abs=5e-3 * DEG)
    off, stated = np.array(apart), np.array(sds)
    assert len(off) > 20 and (np.abs(off) < 1.96 * stated).mean() > 0.88
    assert np.sqrt((off**2).mean()) < 0.2 * np.abs(FULL_RATE).max()
    unknown = record.bias_uncertainty_at(GYRO, float(T[-1]), None)
    assert unknown is not None and unknown.max() > 3 * np.median(stated)


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_taken_up_where_the_bias_merely_wanders_or_stays(seed: int) -> None:
    bias = 0.5 * DEG + wander(seed) * (seed % 4)
    record, changes = followed(bias, plugged(seed), seed)
    assert changes == [] and record.terms == ()


def test_a_term_is_dropped_when_the_charger_has_no_effect_any_more() -> None:
    events = plugged(3)
    bias = np.outer(heat(events) * (T < 24 * HOUR), FULL_RATE)
    record, changes = followed(bias, events, 3)
    assert [change.split(": ")[1] for change in changes] == [
        f"bias by charging {TAKEN_UP}",
        f"bias by charging {DROPPED}",
    ]
    assert record.terms == ()


def test_a_thermometer_takes_over_once_it_knows_better() -> None:
    events = plugged(4)
    celsius = 22.0 + 8.0 * heat(events) + 3.0 * np.sin(T / 9000.0)
    bias = np.outer(celsius - 22.0, FULL_RATE / 8.0)
    heard = np.where(T < 18 * HOUR, np.nan, celsius)
    record, changes = followed(bias, events, 4, heard)
    assert ["charging" in change for change in changes] == [True, False]
    assert [term.effect for term in record.terms] == ["gyro_bias_temperature"]
    assert not record.forecast[GYRO].by_charger


def test_the_charger_takes_over_where_a_thermometer_falls_silent_and_gives_way_when_it_tells_again() -> None:
    events = plugged(4)
    celsius = 22.0 + 8.0 * heat(events) + 3.0 * np.sin(T / 9000.0)
    bias = np.outer(celsius - 22.0, FULL_RATE / 8.0)
    heard = np.where((T > 20 * HOUR) & (T < 34 * HOUR), np.nan, celsius)
    _, changes = followed(bias, events, 4, heard)
    assert ["charging" in change for change in changes] == [False, True, False]
    assert all(TAKEN_UP in change for change in changes)


CHOICES = [
    # silent, doubt, followed no longer since, what the charger's fit decides, which fit is used
    (True, "", None, TAKEN_UP, "charger"),
    (True, "", None, "", "thermometer"),
    (False, "its readings mislead", None, TAKEN_UP, "charger"),
    (False, "", 3600.0, TAKEN_UP, "charger"),
    (False, "", 3600.0, "", "thermometer"),
    (False, "", None, TAKEN_UP, "thermometer"),
]


@pytest.mark.parametrize(("silent", "doubt", "since", "change", "used"), CHOICES)
def test_the_charger_is_asked_where_the_thermometer_failed_and_used_where_it_is_taken_up(
    silent: bool, doubt: str, since: float | None, change: str, used: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Silent or doubted now, or doubted before and no curve followed since."""

    def learn_by(shown: object, driver: SimpleNamespace, **_: object) -> SimpleNamespace:
        by_charger = driver.name == "charger"
        decided = {"doubt": "", "change": change} if by_charger else {"doubt": doubt, "change": ""}
        return SimpleNamespace(term=None, name=driver.name, **decided)

    for name in ("thermometer", "charger"):
        driver = SimpleNamespace(name=name, mostly_known=True, silent=silent)
        monkeypatch.setattr(learn, f"by_{name}", lambda memory, driver=driver: driver)
    monkeypatch.setattr(learn, "_learn_by", learn_by)
    monkeypatch.setattr(learn, "_with_unfollowed", lambda learnt, *_, **__: learnt)
    monkeypatch.setattr(learn, "_with_unseen", lambda learnt, _: learnt)
    known = SimpleNamespace(terms=(), forecast={str(GYRO): SimpleNamespace(unfollowed_since=since)})
    shown = SimpleNamespace(sensor=GYRO, memory=None)
    learnt = learn._learn(shown, known, 0.0, SETTINGS)
    assert learnt.name == used


@pytest.mark.parametrize("by_charger", [False, True])
def test_a_lag_is_kept_only_while_the_same_driver_is_followed(
    by_charger: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lag of the charger's heat says nothing of that of the thermometer."""
    events, kept = plugged(4), []
    celsius = 22.0 + 8.0 * heat(events) + 3.0 * np.sin(T / 9000.0)
    heard = np.full(len(T), np.nan) if by_charger else celsius
    record, changes = followed(np.outer(celsius - 22.0, FULL_RATE / 8.0), events, 4, heard)
    assert len(changes) == 1 and record.forecast[GYRO].by_charger == by_charger
    memory, charger = Memory(), Charger().with_events(events)
    for rest in rests_of(np.outer(celsius, FULL_RATE), events, 4, celsius):
        memory = memory.with_rest(structs.replace(rest, charged=charger.at(rest.t_end)), G)
    likeliest = driver.Driver.at_likeliest_lag
    monkeypatch.setattr(
        driver.Driver,
        "at_likeliest_lag",
        lambda own, seen, model, t, before, **how: (
            kept.append(before) or likeliest(own, seen, model, t, before, **how)
        ),
    )
    shown = shown_by_gyroscope(memory, record)
    for own in (driver.by_thermometer(memory), driver.by_charger(memory)):
        learn._learn_by(
            shown,
            own,
            term=None,
            before=record.forecast[GYRO],
            t=float(T[-1]),
            settings=SETTINGS,
            search=True,
        )
    assert [before is not None for before in kept] == [not by_charger, by_charger]


def lived(engine: Engine, rests: list[RestState], events: list[Charging], *, saved: bool = False) -> Engine:
    """Give an engine the rests of 30 hours, hour by hour, and ask it for a calibration after 20."""
    for hour in range(1, 31):
        since, now = (hour - 1) * HOUR, hour * HOUR
        engine.feed(*[event for event in events if since <= event.t < now], Tick(now))
        engine.add_rests([rest for rest in rests if since <= rest.t_end < now])
        if hour == 20:
            engine.calibrate()
        if saved:
            engine = Engine(engine.settings, unpacked(packed(engine.state), EngineState))
    return engine


def settled() -> EngineSettings:
    return EngineSettings(schedule=ScheduleSettings(gravity=G))


def test_the_engine_learns_it_for_both_sensors_and_a_restart_changes_no_bit() -> None:
    events = plugged(5)
    rests = rests_of(np.outer(heat(events), FULL_RATE), events, 5)
    engine = lived(Engine(settled()), rests, events)
    record = engine.present.record
    assert record is not None and record.accelerometer is not None
    terms = {term.sensor: term.parameters["amplitude"].value for term in record.terms}
    assert terms[GYRO] == pytest.approx(FULL_RATE, rel=0.15, abs=5e-3 * DEG)
    assert terms[ACCEL] == pytest.approx(FULL_FORCE, rel=0.15, abs=0.3 * MG)
    assert record.accelerometer.bias == pytest.approx(np.zeros(3), abs=0.5 * MG)
    again = lived(Engine(settled()), rests, events, saved=True)
    assert packed(again.state) == packed(engine.state)


def test_samples_are_corrected_alike_whole_in_pieces_and_live_and_not_where_the_charger_is_unknown() -> None:
    events = plugged(6)
    record, _ = followed(np.outer(heat(events), FULL_RATE), events, 6)
    assert record.gyroscope is not None and record.terms
    rows = slice(len(T) - 3000, len(T))
    rate = Samples.checked(GYRO, T[rows], np.outer(heat(events)[rows], FULL_RATE))
    force = Samples.checked(ACCEL, T[rows], np.tile([0.0, 0.0, G], (3000, 1)))
    charger = Charger().with_events(events)
    _, whole = correct_both(record, force, rate, charger=charger)
    assert whole is not None and np.abs(whole.xyz).max() < 0.2 * np.abs(rate.xyz).max()
    live, heard = LiveStream(), Charger().with_events(event for event in events if event.t < rate.t[0])
    listener, _ = live.subscribe(0.0)
    for begin in range(0, 3000, 150):
        piece = rate[begin : begin + 150]
        now = [event for event in events if piece.t[0] <= event.t <= piece.t[-1]]
        heard = heard.with_events(now).of_late()
        live.take([piece], record, 0.0, Thermometer(), heard)
    told = np.vstack([listener.queue.get_nowait().samples.xyz for _ in range(listener.queue.qsize())])
    assert told == pytest.approx(whole.xyz, abs=1e-4 * DEG)
    _, blind = correct_both(record, force, rate)
    assert blind is not None
    np.testing.assert_array_equal(blind.xyz, rate.xyz - record.gyroscope.bias)
