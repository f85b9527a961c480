"""The engine gives the same, bit for bit, however its input is cut and however often it is saved."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import Phase, given, seed, settings
from hypothesis import strategies as st

from stillcal.calib_core.codec import packed, plain, unpacked
from stillcal.calib_core.engine.actions import Action, Log, Publish, Reject
from stillcal.calib_core.engine.duty_cycle import EnergySettings
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.intake import ACCEL_PATIENCE_S
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.static.settings import DetectorSettings, Sleep
from stillcal.calib_core.streams.events import End, Event, Tick
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.phone import Phone, load_phone, simulate
from stillcal.replay.phone.activities.carried import Walk
from stillcal.replay.phone.activities.resting import Place, Poses, Rest, Table
from stillcal.replay.phone.scenario import Scenario

LIVELY = EngineSettings(
    schedule=ScheduleSettings(
        check_interval_s=150.0, review_interval_s=7.0, recalibrate_interval_s=100.0, attitudes_wanted=20
    ),
    energy=EnergySettings(burst_s=90.0, on_time_fraction=0.25),
    detector=DetectorSettings(probe_min_s=3.0, probe_max_s=15.0),
)
"""All that a day brings, within a quarter of an hour."""

SUPPORTS = {"screen_up": 1.0, "screen_down": 1.0, "on_long_edge": 1.0, "upright": 1.0, "leaning": 1.0}
AWAY = Place(latitude=-33.9, longitude=18.4, altitude=900.0)
LIVED = Scenario(
    segments=(
        Poses(count=12, rest_s=(5.0, 8.0), charging=True),
        Walk(duration_s=15.0),
        Rest(duration_s=120.0, suspended=True),
        Table(duration_s=250.0, rest_s=(6.0, 20.0), look=0.2, supports=SUPPORTS, place=AWAY),
        Rest(duration_s=40.0, suspended=True, support="leaning"),
        Table(duration_s=250.0, rest_s=(6.0, 20.0), look=0.2, supports=SUPPORTS, charging=True),
        Rest(duration_s=120.0),
    )
)
"""Turned about on the charger, walked away with, lying about elsewhere; asleep in between."""


@dataclass(frozen=True)
class Recording:
    """Both streams and the events, whole."""

    streams: tuple[Samples, ...]
    events: tuple[Event, ...]

    @property
    def end(self) -> float:
        return float(self.streams[0].t[-1])


@cache
def _lived() -> Recording:
    whole = simulate(LIVED, load_phone("consumer"), 3).whole()
    assert whole.gyroscope is not None
    return Recording((whole.accelerometer, whole.gyroscope), whole.events)


def _later(recording: Recording, after: float, by: float) -> Recording:
    """Put a gap of `by` s in."""
    return Recording(
        tuple(replace(s, t=np.where(s.t < after, s.t, s.t + by)) for s in recording.streams),
        tuple(msgspec.structs.replace(e, t=e.t + by * (e.t >= after)) for e in recording.events),
    )


def _gyro_out(recording: Recording, begin: float, end: float) -> Recording:
    accel, gyro = recording.streams
    kept = (gyro.between(-np.inf, begin), gyro.between(end, np.inf))
    return replace(recording, streams=(accel, Samples.joined(kept)))


@cache
def recording(name: str) -> Recording:
    plain = _lived()
    if name == "accelerometer only":
        return replace(plain, streams=plain.streams[:1])
    if name == "five hours away":
        return _later(plain, 300.0, 5 * 3600.0)
    return _gyro_out(plain, 400.0, 520.0) if name == "gyroscope out" else plain


@dataclass
class Life:
    """An engine and all that it ever did."""

    engine: Engine
    actions: list[Action]

    @classmethod
    def begun(cls, chosen: EngineSettings = LIVELY) -> Life:
        return cls(Engine(chosen), [])

    def feed(self, *items: Samples | Event) -> None:
        self.actions += self.engine.feed(*items)

    def saved_and_restored(self) -> None:
        state = unpacked(packed(self.engine.state), EngineState)
        self.engine = Engine(self.engine.settings, state)

    @property
    def done(self) -> str:
        """All that it did, as text."""
        return json.dumps(plain(self.actions), sort_keys=True)

    @property
    def whole(self) -> str:
        """All of it as text, every float to the last bit; the order of keys means nothing."""
        return json.dumps([plain(self.actions), plain(self.engine.state)], sort_keys=True)


@cache
def unbroken(name: str) -> str:
    life, whole = Life.begun(), recording(name)
    life.feed(*whole.streams, *whole.events, End(whole.end))
    return life.whole


def test_the_recording_has_all_in_it_that_a_cut_could_spoil() -> None:
    life, whole = Life.begun(), recording("whole")
    life.feed(*whole.streams, *whole.events, End(whole.end))
    watched = {a.why.split()[-1] for a in life.actions if isinstance(a, Log) and a.what == "watch"}
    assert watched == {"continuous", "probing", "idle"}
    assert {type(a) for a in life.actions} == {Log, Publish, Reject}
    counted = life.engine.state.counters
    assert min(counted.turns, counted.checks, counted.zeroings, counted.refused) > 0
    assert len({h.gravity.value for h in life.engine.state.pool.held}) > 1
    assert life.engine.ledger.accel_unasked > 0
    assert life.engine.ledger.probes > 10


PIECE = st.tuples(
    st.floats(0.0, 1.0),  # where the piece ends
    st.floats(0.0, 4.9),  # how far the gyroscope's stream is behind there, within the engine's patience
    st.booleans(),  # whether the engine is saved and restored there
    st.booleans(),  # which stream comes first, and in one call or two, within the engine's patience
)


def fed_in_pieces(name: str, pieces: list) -> Life:
    """Feed a recording in pieces, in any order of the streams, saving and restoring in between."""
    whole, life = recording(name), Life.begun()
    stamps, last = whole.streams[0].t, [-np.inf, -np.inf, -np.inf]
    for place, lag, save, apart in [*sorted(pieces), (2.0, 0.0, False, False)]:
        end = stamps[int(place * (stamps.size - 1))] if place <= 1.0 else np.inf
        ends = (end, max(end - lag, last[1]))
        parts = [s.between(a, b) for s, a, b in zip(whole.streams, last, ends, strict=False)]
        events = [e for e in whole.events if last[2] <= e.t < end]
        # The gyroscope alone for longer than the engine's patience is an accelerometer that has stopped.
        if apart and min(end, whole.end) - max(last[0], 0.0) < ACCEL_PATIENCE_S:
            life.feed(*events, *parts[1:])
            life.feed(parts[0])
        else:
            life.feed(*parts, *events)
        if save:
            life.saved_and_restored()
        last = [*ends, end]
    life.feed(End(whole.end))
    return life


@pytest.mark.slow
@pytest.mark.parametrize("name", ["whole", "accelerometer only", "five hours away", "gyroscope out"])
@seed(0)
@settings(max_examples=5, deadline=None, database=None, phases=[Phase.generate])
@given(pieces=st.lists(PIECE, min_size=1, max_size=40))
def test_streamed_equals_unbroken_to_the_last_bit(name: str, pieces: list) -> None:
    assert fed_in_pieces(name, pieces).whole == unbroken(name)


@pytest.mark.slow
def test_how_a_file_is_cut_changes_nothing_of_what_is_learnt_of_temperature_and_charging() -> None:
    """Rests of an hour and a half of a phone that warms: an hour of readings tells how warm sensors are.

    In pieces, with the engine saved and restored in between, and whole.
    """
    warm = msgspec.convert(
        msgspec.to_builtins(load_phone("typical")) | {"heat": {"charge_k": 8.0, "slow_tau_s": 300.0}}, Phone
    )
    slow = msgspec.structs.replace(warm, accel=msgspec.structs.replace(warm.accel, rate_hz=10.0), gyro=None)
    day = Scenario(segments=(Table(duration_s=5400.0, rest_s=(40.0, 60.0), charging=True),))
    whole = simulate(day, slow, 3).whole()
    samples = whole.accelerometer
    states = []
    for pieces in (1, 7):
        engine = Engine(EngineSettings())
        engine.feed(*whole.events)
        for cut in np.array_split(np.arange(len(samples)), pieces):
            engine = Engine(EngineSettings(), unpacked(packed(engine.state), EngineState))
            engine.feed(samples[int(cut[0]) : int(cut[-1]) + 1])
        engine.feed(End(float(samples.t[-1])))
        states.append(plain(engine.state))
    for known, columns in (("lagged", 4), ("charged", 3)):  # slower than 1200 s takes longer to be known
        values = [np.asarray(held["rest"][known], dtype=float) for held in states[0]["pool"]["held"]]
        assert sum(np.isfinite(value[:columns]).all() for value in values) > 10
    assert json.dumps(states[0]) == json.dumps(states[1])


def lived_through(name: str, obedient: bool) -> tuple[Life, int]:
    """Feed a recording as it comes, with a clock's ticks, asking each time what is wanted.

    An obedient phone delivers nothing while the engine lets it sleep. Returns the life and how many
    accelerometer samples it was given.
    """
    whole, life, t, given_samples = recording(name), Life.begun(), 0.0, 0
    while t <= whole.end:
        want = life.engine.wants()
        until = min(t + 60.0 if isinstance(want, Sleep) else t + 1.0, want.until)
        until = until if until > t else t + 1.0
        events = [e for e in whole.events if t <= e.t < until]
        asleep = obedient and isinstance(want, Sleep)
        parts = [] if asleep else [s.between(t, until) for s in whole.streams]
        given_samples += sum(len(part) for part in parts[:1])
        life.feed(*events, *parts, Tick(until))
        t = until
    life.feed(End(whole.end + 1.0))
    return life, given_samples


@pytest.mark.slow
@pytest.mark.parametrize("name", ["whole", "accelerometer only", "five hours away"])
def test_a_phone_that_sends_only_what_is_asked_for_gives_the_same(name: str) -> None:
    """A recording replayed whole, lived through, and lived through by a phone that sleeps when it may."""
    lived, all_of_it = lived_through(name, obedient=False)
    slept, few = lived_through(name, obedient=True)
    replayed, whole = Life.begun(), recording(name)
    replayed.feed(*whole.streams, *whole.events, End(whole.end + 1.0))
    assert few < all_of_it / 2
    assert slept.done == lived.done == replayed.done
    assert slept.engine.ledger.asked_s == lived.engine.ledger.asked_s == replayed.engine.ledger.asked_s
