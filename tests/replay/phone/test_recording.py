"""Recordings of the simulated phone: repeatable, cut anywhere, timed as real ones, true to what is told."""

from __future__ import annotations

import math
from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillcal.calib_core.streams.events import Charging, Location
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.phone import Chunk, Scenario, Simulation, load_phone, load_scenario, simulate
from stillcal.replay.phone.heat import Heat, Surroundings
from stillcal.replay.phone.motion.gravity import gravity_at
from stillcal.replay.phone.settings import HeatSettings
from stillcal.replay.phone.timeline import Steps

SHORT = """
{"duration_s": 200.0, "segment": [
  {"activity": "table", "duration_s": 100.0, "rest_s": [4.0, 20.0]},
  {"activity": "walk", "duration_s": 40.0, "place": {"latitude": 46.0, "longitude": 7.0, "altitude": 1600.0}},
  {"activity": "rest", "duration_s": 60.0, "charging": true}
]}
"""


def short() -> Scenario:
    return msgspec.json.decode(SHORT, type=Scenario)


def columns(run: Samples) -> list[np.ndarray]:
    return [c for c in (run.t, run.xyz, run.temperature, run.t_arrival) if c is not None]


def same(a: Samples, b: Samples) -> bool:
    return len(columns(a)) == len(columns(b)) and all(
        np.array_equal(x, y) for x, y in zip(columns(a), columns(b), strict=True)
    )


def joined(chunks: list[Chunk]) -> tuple[Samples, Samples]:
    return (
        Samples.joined([c.accelerometer for c in chunks if len(c.accelerometer)]),
        Samples.joined([c.gyroscope for c in chunks if c.gyroscope is not None and len(c.gyroscope)]),
    )


@pytest.mark.parametrize("phone", ["nexus4", "flawed"])
def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not(phone: str) -> None:
    first, again, other = (simulate(short(), load_phone(phone), seed).whole() for seed in (4, 4, 5))
    assert same(first.accelerometer, again.accelerometer)
    assert same(first.gyroscope, again.gyroscope)
    assert first.events == again.events
    assert not same(first.accelerometer, other.accelerometer)


@cache
def uncut() -> tuple[Simulation, Chunk]:
    """Return a phone's life and, at once, all that it records."""
    simulation = simulate(short(), load_phone("nexus4"), seed=4)
    return simulation, simulation.whole()


@given(st.floats(0.5, 250.0))
@settings(max_examples=8, deadline=None)
def test_how_the_stream_is_cut_changes_nothing(seconds: float) -> None:
    simulation, whole = uncut()
    chunks = list(simulation.chunks(seconds))
    accel, gyro = joined(chunks)
    assert same(accel, whole.accelerometer)
    assert same(gyro, whole.gyroscope)
    assert tuple(e for c in chunks for e in c.events) == whole.events


def test_chunks_hold_what_their_time_says() -> None:
    before = -math.inf
    chunks = list(simulate(short(), load_phone("nexus4"), seed=4).chunks(7.0))
    assert len(chunks) > 3 and sum(len(c.accelerometer.t) + len(c.gyroscope.t) for c in chunks) > 1000
    for chunk in chunks:
        for t in (chunk.accelerometer.t, chunk.gyroscope.t, [e.t for e in chunk.events]):
            assert all(before <= x < chunk.t_end for x in t)
        before = chunk.t_end


def test_a_course_is_repeated_drawn_anew_and_cut_or_rested_to_length() -> None:
    twice = msgspec.structs.replace(short(), repeat=2, duration_s=None)
    pieces = simulate(twice, load_phone("ideal"), seed=1).plan.pieces
    cut = simulate(msgspec.structs.replace(twice, duration_s=150.0), load_phone("ideal"), seed=1)
    rested = simulate(msgspec.structs.replace(twice, duration_s=900.0), load_phone("ideal"), seed=1)
    assert sum(p.activity == "walk" for p in pieces) > 1
    assert cut.whole().accelerometer.t[-1] < 150.0 <= cut.plan.pieces[-1].t_end
    assert rested.plan.pieces[-1].t_end == 900.0
    assert rested.plan.pieces[-1].still


def test_shared_clock_gives_common_stamps_and_separate_clocks_do_not() -> None:
    together = simulate(short(), load_phone("typical"), seed=1).whole()
    assert np.array_equal(together.accelerometer.t, together.gyroscope.t)
    assert np.array_equal(together.accelerometer.t_arrival, together.gyroscope.t_arrival)
    apart = simulate(short(), load_phone("nexus4"), seed=1).whole()
    assert np.intersect1d(apart.accelerometer.t, apart.gyroscope.t).size == 0


def test_a_busy_processor_nearly_doubles_the_interval_and_opens_gaps() -> None:
    """Stisen et al. 2015, 3.3: median 5.2 to 9.7 ms, a factor of 1.87, and gaps of over 1 s."""
    simulation = simulate(load_scenario("starved"), load_phone("icm42688p"), seed=3)
    t = simulation.whole().accelerometer.t
    (busy,) = simulation.plan.stressed
    calm = np.diff(t[t < busy.start])
    load = np.diff(t[(t >= busy.start) & (t < busy.end)])
    assert np.median(load) / np.median(calm) == pytest.approx(9.7 / 5.2, abs=0.06)
    assert load.max() > 1.0
    assert calm.max() < 0.01


def test_a_suspended_phone_delivers_nothing_and_goes_on_afterwards() -> None:
    simulation = simulate(load_scenario("starved"), load_phone("typical"), seed=3)
    t = simulation.whole().accelerometer.t
    (asleep,) = simulation.plan.suspended
    assert not np.any((t > asleep.start + 0.1) & (t < asleep.end - 0.1))
    assert t[-1] == pytest.approx(simulation.duration, abs=0.05)


def test_gaps_come_as_often_and_last_as_long_as_told() -> None:
    phone = load_phone("ideal")
    clock = msgspec.structs.replace(phone.clock, gaps_per_hour=240.0, gap_s=(0.2, 0.8))
    scenario = msgspec.json.decode('{"segment": [{"activity": "rest", "duration_s": 3600.0}]}', type=Scenario)
    steps = np.diff(
        simulate(scenario, msgspec.structs.replace(phone, clock=clock), 1).whole().accelerometer.t
    )
    gaps = steps[steps > 0.05]
    assert gaps.size == pytest.approx(240, abs=60)  # Poisson: sd 15
    assert gaps.max() <= 0.8 + 0.02 + 0.8  # two may touch
    assert np.median(gaps) == pytest.approx(0.5, abs=0.1)


def test_events_tell_of_plug_and_place_and_encode_as_the_format_has_them() -> None:
    simulation = simulate(short(), load_phone("typical"), seed=1)
    home, away, plug = simulation.events()
    assert isinstance(home, Location) and isinstance(away, Location) and isinstance(plug, Charging)
    assert msgspec.to_builtins(plug) == {"event": "charging", "t": plug.t, "on": True}
    assert set(msgspec.to_builtins(away)) == {"event", "t", "latitude", "longitude", "altitude"}
    rests = simulation.truth.rests
    assert rests[0].gravity == gravity_at(home.latitude, home.altitude)
    assert rests[-1].gravity == gravity_at(away.latitude, away.altitude)
    assert rests[-1].gravity != rests[0].gravity


def test_events_and_truth_keep_the_phones_own_time() -> None:
    phone = load_phone("ideal")
    clock = msgspec.structs.replace(phone.clock, skew=0.01)
    plain, fast = (simulate(short(), p, 1) for p in (phone, msgspec.structs.replace(phone, clock=clock)))
    assert [e.t for e in fast.events()] == pytest.approx([1.01 * e.t for e in plain.events()])
    rest = fast.truth.rests[3]
    inside = fast.whole().accelerometer.between(rest.t_start, rest.t_end).xyz
    assert np.abs(inside - rest.up * rest.gravity).max() < 1e-12


def test_truth_undoes_the_sensor() -> None:
    phone = load_phone("typical")
    silent = msgspec.structs.replace(
        phone, accel=msgspec.structs.replace(phone.accel, noise=type(phone.accel.noise)(), lsb=0.0)
    )
    simulation = simulate(short(), silent, seed=1)
    truth, run = simulation.truth, simulation.whole().accelerometer
    calibrated = (run.xyz - truth.accelerometer.bias) @ truth.accelerometer.scale.T
    assert len(truth.rests) > 1
    for rest in truth.rests:
        rows = (run.t > rest.t_start + 0.01) & (run.t < rest.t_end - 0.01)
        assert rows.any()
        assert np.abs(calibrated[rows] - rest.up * rest.gravity).max() < 1e-10


def test_a_phone_without_a_gyroscope_streams_without_one() -> None:
    phone = msgspec.structs.replace(load_phone("typical"), gyro=None)
    simulation = simulate(short(), phone, seed=1)
    assert simulation.whole().gyroscope is None
    assert simulation.truth.gyroscope is None
    assert all(c.gyroscope is None for c in simulation.chunks(50.0))


def test_heat_follows_use_and_charging_with_two_time_constants() -> None:
    steps = Steps.of([0.0, 100.0], [0.0, 1.0])
    surroundings = Surroundings(Steps.of([0.0, 100.0], [20.0, 20.0]), steps, steps)
    heat = Heat(
        HeatSettings(use_k=6.0, charge_k=4.0, fast_share=0.3, fast_tau_s=50.0, slow_tau_s=800.0), surroundings
    )
    t = np.array([0.0, 100.0, 160.0, 1000.0, 1e6])
    since = np.maximum(t - 100.0, 0.0)
    expected = 20.0 + 10.0 * (0.3 * (1 - np.exp(-since / 50.0)) + 0.7 * (1 - np.exp(-since / 800.0)))
    assert heat.at(t) == pytest.approx(expected)
    assert heat.at(t[::-1].copy()) == pytest.approx(expected[::-1])


def test_steps_and_lags_go_on_from_step_to_step() -> None:
    steps = Steps.of([0.0, 10.0, 30.0], [1.0, 3.0, 0.0])
    t = np.linspace(0.0, 60.0, 6001)
    stepped = np.empty_like(t)
    stepped[0] = 1.0
    for i in range(6000):
        stepped[i + 1] = stepped[i] + 0.01 / 7.0 * (steps.at(t[i : i + 1])[0] - stepped[i])
    assert np.abs(steps.lagged(7.0).at(t) - stepped).max() < 2e-3


def test_thermometer_reads_the_true_temperature_in_its_steps() -> None:
    simulation = simulate(short(), load_phone("typical"), seed=1)
    run = simulation.whole().accelerometer
    assert np.abs(run.temperature - simulation.temperature_at(run.t)).max() <= 0.05 + 1e-3
    assert np.ptp(run.temperature) > 0.5
    assert simulate(short(), load_phone("nexus4"), seed=1).whole().accelerometer.temperature is None


def test_poses_can_be_told_one_by_one() -> None:
    ups = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    segment = {"activity": "poses", "ups": ups.tolist(), "rest_s": 5.0}
    simulation = simulate(msgspec.convert({"segment": [segment]}, type=Scenario), load_phone("ideal"), seed=1)
    assert np.array([r.up for r in simulation.truth.rests]) == pytest.approx(ups, abs=1e-12)
    assert [r.t_end - r.t_start for r in simulation.truth.rests] == pytest.approx([5.0] * 3)
