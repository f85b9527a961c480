"""What the engine does when: on the charger, at checks, away from home, after the sensor has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.calibration.acceptance import decide, stated_uncertainty
from stillcal.calib_core.calibration.candidate import CalibrateSettings, fit_candidate
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.engine.actions import Action, Log, Publish, Reject
from stillcal.calib_core.engine.duty_cycle import EnergySettings
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import DetectorSettings, Sense
from stillcal.calib_core.streams.events import Charging, End, Event, Location, Tick
from stillcal.calib_core.streams.samples import SampleError, Samples, Sensor
from stillcal.replay.phone import Phone, draw_rests, load_phone, load_scenario, simulate
from stillcal.replay.phone.activities.resting import Activity, Place, Poses, Rest, Table
from stillcal.replay.phone.scenario import Scenario

QUICK = EngineSettings(
    schedule=ScheduleSettings(check_interval_s=120.0, review_interval_s=10.0, recalibrate_interval_s=240.0)
)
"""An hour's doings in two minutes."""

HOME = Place(latitude=52.2, longitude=0.12, altitude=20.0)
HANDLED = {"screen_up": 1.0, "screen_down": 1.0, "on_long_edge": 1.0, "upright": 1.0, "leaning": 1.0}


class Day:
    """A phone, what it lives through, and an engine that watches it."""

    def __init__(self, *segments: Activity, settings: EngineSettings = QUICK, seed: int = 1) -> None:
        scenario = Scenario(segments=segments, place=HOME)
        self.simulation = simulate(scenario, load_phone("consumer"), seed)
        self.whole = self.simulation.whole()
        self.accel, self.events = self.whole.accelerometer, self.whole.events
        self.engine = Engine(settings)
        self.actions: list[Action] = []

    def biased_after(self, t: float, jump: Sequence[float]) -> Day:
        """Shift the accelerometer's bias (m/s^2) from time t (s) on."""
        moved = self.accel.xyz + np.where(self.accel.t[:, None] >= t, np.asarray(jump), 0.0)
        self.accel = replace(self.accel, xyz=frozen(moved))
        return self

    def warmer_after(self, t: float, jump: float) -> Day:
        """Shift the thermometer's readings (K) from time t (s) on."""
        assert self.accel.temperature is not None
        moved = self.accel.temperature + np.where(self.accel.t >= t, jump, 0.0)
        self.accel = replace(self.accel, temperature=frozen(moved))
        return self

    def lived(self) -> Day:
        assert self.whole.gyroscope is not None
        end = End(self.simulation.duration)
        self.actions = self.engine.feed(self.whole.gyroscope, self.accel, *self.events, end)
        return self

    def logged(self, what: str) -> list[Log]:
        return [a for a in self.actions if isinstance(a, Log) and a.what == what]

    @property
    def stored(self) -> list[Publish]:
        """Full calibrations that were accepted."""
        kept = [a for a in self.actions if isinstance(a, Publish)]
        return [a for a in kept if a.record.acceptance.how == "calibration"]

    def bias_error(self, store: Publish, jump: Sequence[float] = (0.0, 0.0, 0.0)) -> float:
        assert store.record.accelerometer is not None
        truth = self.simulation.truth.accelerometer.bias + np.asarray(jump)
        return float(np.abs(store.record.accelerometer.bias - truth).max())


def test_the_charger_brings_the_calibration() -> None:
    day = Day(Poses(count=20, rest_s=(6.0, 8.0)), Rest(duration_s=60.0), Rest(duration_s=60.0, charging=True))
    day.lived()
    (plugged,) = (e.t for e in day.events if isinstance(e, Charging) and e.on)
    assert [s.t for s in day.stored] == [plugged]
    assert day.stored[0].record.acceptance.evidence["occasion"] == "charging"
    assert day.bias_error(day.stored[0]) < 0.005


def test_without_word_of_a_charger_enough_attitudes_do() -> None:
    day = Day(Poses(count=36, rest_s=(5.0, 6.0)), Rest(duration_s=200.0))
    day.events = tuple(e for e in day.events if not isinstance(e, Charging))
    day.lived()
    assert day.stored[0].t < day.simulation.duration - 60.0
    assert day.stored[0].record.acceptance.evidence["occasion"] == "no charger was ever reported"


def test_without_word_of_a_charger_a_first_calibration_comes_after_six_hours() -> None:
    """Attitudes as a day has them are far fewer than those at which gathering ends."""
    day = Day(Poses(count=12, rest_s=(5.0, 6.0)), Rest(duration_s=250.0))
    day.events = tuple(e for e in day.events if not isinstance(e, Charging))
    day.lived()
    assert day.stored[0].t == pytest.approx(240.0, abs=0.1)  # QUICK's six hours
    assert day.bias_error(day.stored[0]) < 0.02


def test_off_the_charger_for_a_day_a_first_calibration_comes_all_the_same() -> None:
    """The paper prefers the charger, and phones are charged daily; one that is not has to wait no longer."""
    charged = Rest(duration_s=30.0, charging=True)
    day = Day(charged, Poses(count=12, rest_s=(5.0, 6.0)), Rest(duration_s=1100.0)).lived()
    (unplugged,) = (e.t for e in day.events if isinstance(e, Charging) and not e.on and e.t > 20.0)
    first = day.stored[0]
    assert unplugged + 4 * 240.0 <= first.t <= unplugged + 4 * 240.0 + 120.0  # QUICK's day and its hour
    assert first.record.acceptance.evidence["occasion"] == "off the charger for long"
    assert day.bias_error(first) < 0.02


def test_checks_stay_on_their_grid_across_twelve_hours_without_samples() -> None:
    day = Day(
        Poses(count=20, rest_s=(6.0, 8.0), charging=True), Table(duration_s=1500.0, rest_s=(10.0, 60.0))
    )
    gap = 12 * 3600.0
    assert day.whole.gyroscope is not None
    later = [
        replace(s, t=frozen(np.where(s.t < 800.0, s.t, s.t + gap))) for s in (day.accel, day.whole.gyroscope)
    ]
    asked: list[float] = []
    engine = Engine(QUICK)
    check = engine._policy.check
    engine._policy.check = lambda t: (asked.append(t), check(t))[1]  # type: ignore[method-assign, func-returns-value]
    events = [msgspec.structs.replace(e, t=e.t + gap * (e.t >= 800.0)) for e in day.events]
    engine.feed(*later, *events, End(float(later[0].t[-1])))
    began, interval = engine.state.began, QUICK.schedule.check_interval_s
    assert began is not None
    due = began + interval * np.arange(1, int((later[0].t[-1] - began) / interval) + 1)
    assert set(due) <= set(asked)
    assert engine.state.counters.checks >= 10


def test_gravity_is_that_of_the_place_and_rests_keep_theirs() -> None:
    """Cambridge, then the Cape and higher: 19 mm/s^2 less, 2 mg, and yet one calibration fits both."""
    away = Place(latitude=-33.9, longitude=18.4, altitude=900.0)
    day = Day(
        Poses(count=14, rest_s=(6.0, 8.0)),
        Rest(duration_s=30.0, place=away),
        Poses(count=14, rest_s=(6.0, 8.0)),
        Rest(duration_s=30.0, charging=True),
    ).lived()
    values = [h.gravity.value for h in day.engine.state.pool.held]
    assert len(set(values)) == 2
    assert max(values) - min(values) == pytest.approx(0.019, abs=0.002)
    for held in day.engine.state.pool.held:
        (true,) = (r.gravity for r in day.simulation.truth.rests if r.t_start <= held.rest.t_start < r.t_end)
        assert held.gravity.value == pytest.approx(true, abs=1e-4)
    accel = day.stored[-1].record.accelerometer
    assert accel is not None and accel.rms_residual is not None
    assert accel.rms_residual < 0.001


def test_rests_before_the_first_fix_take_its_gravity() -> None:
    """Until the phone learns where it is, gravity is the standard value, a rough one: then it is no more."""
    day = Day(
        Poses(count=14, rest_s=(6.0, 8.0)),
        Poses(count=14, rest_s=(6.0, 8.0)),
        Rest(duration_s=30.0, charging=True),
    )
    first = day.accel.t[len(day.accel) // 2]
    day.events = tuple(
        msgspec.structs.replace(e, t=first) if isinstance(e, Location) else e for e in day.events
    )
    day.lived()
    assert {h.gravity.source for h in day.engine.state.pool.held} == {"location"}
    assert day.bias_error(day.stored[-1]) < 0.005


@pytest.mark.parametrize("place", [Location(5.0, 200.0, 0.0, 0.0), Location(5.0, 52.0, 0.0, 1e9)])
def test_a_senseless_place_is_not_used_and_said(place: Location) -> None:
    day = Day(Rest(duration_s=60.0))
    day.events = (place,)
    day.lived()
    assert [e.what for e in day.logged("location")] == ["location"]
    assert day.engine.state.gravity == Gravity()


JUMP = (0.25, 0.0, -0.2)


def test_a_changed_sensor_is_noticed_and_calibrated_anew_the_old_kept_meanwhile() -> None:
    day = Day(
        Poses(count=20, rest_s=(6.0, 8.0), charging=True),
        Table(duration_s=260.0, rest_s=(10.0, 30.0), supports=HANDLED),
        Table(duration_s=300.0, rest_s=(10.0, 30.0), supports=HANDLED),
        Poses(count=24, rest_s=(6.0, 8.0)),
        Rest(duration_s=200.0, charging=True),
    )
    jumped = 450.0
    day.biased_after(jumped, JUMP).lived()
    first, last = [s for s in day.stored if s.t < jumped][-1], day.stored[-1]
    assert first.t < jumped < last.t
    verdicts = [entry.why for entry in day.logged("check") if entry.t < jumped]
    assert verdicts and set(verdicts) == {"keep"}
    (noticed,) = day.logged("degraded")
    assert all(entry.why == "recalibrate" for entry in day.logged("check") if noticed.t <= entry.t < last.t)
    assert jumped < noticed.t < jumped + 3 * QUICK.schedule.check_interval_s
    between = [s for s in day.actions if isinstance(s, Publish) and jumped < s.t < last.t]
    assert all(s.record.accelerometer is first.record.accelerometer for s in between)
    failing = {entry.t for entry in day.logged("check") if noticed.t <= entry.t < last.t}
    assert failing <= {s.t for s in between}  # each of them measured the gyroscope's bias all the same
    assert day.bias_error(first) < 0.01
    assert day.bias_error(last, JUMP) < 0.01
    assert not day.engine.state.degraded


def test_a_first_calibration_with_a_prior_gives_way_when_the_attitudes_allow() -> None:
    faces = {name: 1.0 for name in ("screen_up", "screen_down", "on_long_edge", "upright", "upside_down")}
    day = Day(
        Table(duration_s=300.0, rest_s=(8.0, 12.0), look=0.0, supports=faces),
        Rest(duration_s=20.0, support="stand_landscape", charging=True),
        Poses(count=24, rest_s=(6.0, 8.0)),
        Rest(duration_s=20.0),
        Rest(duration_s=100.0, charging=True),
    ).lived()
    parts = [s.record.accelerometer for s in day.stored if s.record.accelerometer]
    assert [part.with_prior for part in parts] == [True, False]
    before, after = (stated_uncertainty(part) for part in parts)
    assert before is not None and after is not None and after < 0.2 * before


def test_rests_after_a_jump_of_the_thermometer_have_no_temperature_and_it_is_said() -> None:
    day = Day(Poses(count=14, rest_s=(6.0, 8.0))).warmer_after(60.0, 12.0).lived()
    (said,) = day.logged("thermometer")
    assert 60.0 <= said.t <= 90.0 and "faster than a phone warms or cools" in said.why
    rests = day.engine.state.memory
    known = np.isfinite(rests.celsius)
    assert known[rests.t < 55.0].all() and not known[rests.t > 95.0].any()
    sound = Day(Poses(count=14, rest_s=(6.0, 8.0))).lived()
    assert not sound.logged("thermometer") and np.isfinite(sound.engine.state.memory.celsius).all()
    back = Day(Poses(count=14, rest_s=(6.0, 8.0))).warmer_after(60.0, 12.0).warmer_after(100.0, -12.0).lived()
    assert [log.why.split(" is ")[-1] for log in back.logged("thermometer")][1:] == ["followed again"]


def test_how_the_gyroscope_wanders_is_learnt_once_an_hour_and_its_bias_at_every_check() -> None:
    hourly = replace(QUICK.schedule, check_interval_s=1200.0, wanted_rate=1e-7)
    charged = Rest(duration_s=60.0, charging=True)
    day = Day(
        Poses(count=20, rest_s=(6.0, 8.0)),
        charged,
        Table(duration_s=5000.0, rest_s=(60.0, 300.0)),
        settings=replace(QUICK, schedule=hourly),
    ).lived()
    zeroed = [
        (a.t, a.record.gyroscope.bias, a.record.forecast["gyroscope"].wander)
        for a in day.actions
        if isinstance(a, Publish) and a.record.acceptance.how == "zeroing"
    ]
    hours = [np.floor(t / 1200.0) for t, _, _ in zeroed]
    in_between = [(b, c) for b, c, x, y in zip(zeroed, zeroed[1:], hours, hours[1:], strict=False) if x == y]
    assert len(in_between) >= 5
    for (_, bias, wander), (_, later, same) in in_between:
        assert not np.array_equal(bias, later) and wander == same
    assert len({wander for _, _, wander in zeroed}) >= 2


def test_on_time_stays_within_burst_and_fraction() -> None:
    """With probes so close that they alone would take a fifth of the time."""
    energy = EnergySettings(burst_s=100.0, on_time_fraction=0.05)
    day = Day(
        Table(duration_s=2000.0, rest_s=(10.0, 60.0)),
        settings=replace(QUICK, energy=energy, detector=DetectorSettings(probe_min_s=5.0, probe_max_s=20.0)),
    ).lived()
    asked, length = day.engine.ledger.asked_s, day.simulation.duration
    longest_probe = QUICK.detector.w_min_s + QUICK.detector.w_spread_s + QUICK.detector.startup_s
    checks = day.engine.state.counters.checks * longest_probe
    assert (
        energy.burst_s < asked <= energy.burst_s + energy.on_time_fraction * length + longest_probe + checks
    )
    assert asked < 0.15 * length


def rests_of(phone: Phone, number: int, after: float, count: int) -> Pool:
    """Return `count` drawn rests of a phone, taken from `after` s on."""
    drawn = draw_rests(phone, count, number, duration_s=(10.0, 60.0))
    return Pool(
        tuple(
            HeldRest(
                RestState(after + t, after + t + d, int(100 * d), frozen(f), frozen(u * 30), frozen(u), 0.01),
                Gravity(drawn.gravity, 0.0, "given"),
            )
            for t, d, f, u in zip(
                drawn.t, drawn.duration, drawn.forces, drawn.white_uncertainties, strict=True
            )
        )
    )


@pytest.mark.slow
def test_an_unchanged_phone_replaces_its_calibration_no_more_often_than_chance() -> None:
    """Old and new each fitted to 18 rests of one unchanged sensor, compared on the new one's, held out."""
    quiet = load_phone("consumer")
    noise = msgspec.structs.replace(quiet.accel.noise, flicker=0.0)
    phone = msgspec.structs.replace(quiet, accel=msgspec.structs.replace(quiet.accel, noise=noise))
    settings, chance, trials, taken = CalibrateSettings(), QualitySettings().chance, 100, 0
    gravity = Gravity(9.80665, 0.0, "given")
    for number in range(trials):
        old, new = (
            fit_candidate(rests_of(phone, 2 * number + i, 1e5 * i, 18), gravity, 5e4, settings)
            for i in (0, 1)
        )
        taken += decide(new, old.record, False, QualitySettings()).accepted
    print(f"{taken} of {trials} taken")
    assert taken <= chance * trials + 3 * np.sqrt(chance * trials)


def block(sensor: Sensor, begin: float, end: float) -> Samples:
    t = np.arange(begin, end, 0.01)
    return Samples(sensor, frozen(t), frozen(np.tile([0.0, 0.0, 9.8], (t.size, 1))))


def test_a_stream_that_runs_back_is_refused() -> None:
    engine = Engine()
    engine.feed(block(Sensor.ACCELEROMETER, 0.0, 10.0))
    with pytest.raises(SampleError, match="comes after"):
        engine.feed(block(Sensor.ACCELEROMETER, 5.0, 6.0))


@pytest.mark.parametrize(
    "events",
    [
        [End(1.0)],
        [Charging(0.0, True), Tick(5.0), Location(6.0, 52.0, 0.0), End(7.0)],
        [Tick(100.0), Tick(50.0), Charging(60.0, True), End(7.0)],
    ],
)
def test_events_without_samples_bring_nothing_and_break_nothing(events: list[Event]) -> None:
    engine = Engine()
    actions = [a for event in events for a in engine.feed(event)]
    assert not any(isinstance(a, Publish | Reject) for a in actions)
    assert engine.wants() == Sense(np.inf)


def noisy(begin: float, end: float) -> Samples:
    still = block(Sensor.ACCELEROMETER, begin, end)
    return replace(still, xyz=frozen(still.xyz + np.random.default_rng(1).normal(0, 0.01, still.xyz.shape)))


def test_a_year_between_two_stamps_takes_no_time() -> None:
    """A clock that is set while the phone records: a rest on either side, none across, no year of checks."""
    engine = Engine(replace(QUICK, energy=EnergySettings(burst_s=600.0)))
    actions = engine.feed(noisy(0.0, 60.0), noisy(3e7, 3e7 + 60.0), End(4e7))
    assert [a.what for a in actions if isinstance(a, Log)] == ["watch", "rest", "rest", "refused"]
    assert engine.state.counters.rests == 2
    (kept,) = engine.state.pool.rests  # the first is a year old
    assert kept.t_start >= 3e7 and kept.t_end <= 3e7 + 60.0


def test_a_phone_that_lies_flat_is_not_calibrated_and_why_is_said() -> None:
    """Two hours at a desk, mostly flat: a gyroscope's bias, and what is missing for more is said."""
    whole = simulate(load_scenario("desk"), load_phone("consumer"), 2).whole()
    assert whole.gyroscope is not None
    engine = Engine()
    engine.feed(whole.gyroscope, whole.accelerometer, *whole.events, End(whole.t_end))
    assert engine.state.record is not None and engine.state.record.accelerometer is None
    assert engine.state.refusal is not None and engine.state.refusal.missing
