"""Recordings of the simulated phone: repeatable, cut anywhere, timed as real ones, true to their files."""

from __future__ import annotations

import math
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillcal.calib_core.samples import Samples
from stillcal.replay.phone import (
    Charging,
    Chunk,
    Location,
    Scenario,
    dump_phone,
    load_phone,
    load_scenario,
    population,
    simulate,
)
from stillcal.replay.phone.effects import EFFECTS
from stillcal.replay.phone.gravity import gravity_at
from stillcal.replay.phone.heat import Heat, Surroundings
from stillcal.replay.phone.population import FACE_RANGE, MODELS, face_deviations
from stillcal.replay.phone.scenario import Segment
from stillcal.replay.phone.settings import HeatSettings
from stillcal.replay.phone.timeline import Steps

PHONES = sorted(
    p.name[:-5] for p in (files("stillcal.config") / "phones").iterdir() if p.name.endswith(".toml")
)
SCENARIOS = sorted(
    p.name[:-5] for p in (files("stillcal.config") / "scenarios").iterdir() if p.name.endswith(".toml")
)
LENGTHS = {"day": (86_400.0, 1), "week": (604_800.0, 7)}
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


@given(st.floats(0.5, 250.0))
@settings(max_examples=8, deadline=None)
def test_how_the_stream_is_cut_changes_nothing(seconds: float) -> None:
    simulation = simulate(short(), load_phone("nexus4"), seed=4)
    whole, chunks = simulation.whole(), list(simulation.chunks(seconds))
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


@pytest.mark.parametrize("name", PHONES)
def test_ready_phones_load_survive_a_dump_and_record_valid_samples(name: str, tmp_path: Path) -> None:
    phone = load_phone(name)
    file = tmp_path / "phone.toml"
    file.write_text(dump_phone(phone), encoding="utf-8")
    assert load_phone(file) == phone
    recording = simulate(load_scenario("starved"), phone, seed=2).whole()
    for run in (recording.accelerometer, recording.gyroscope):
        checked = Samples.checked(run.sensor, run.t, run.xyz, run.temperature, run.t_arrival)
        assert len(checked) > 20_000
        assert np.all(np.diff(run.t_arrival) >= 0.0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_ready_scenarios_play(name: str) -> None:
    scenario = load_scenario(name)
    once = msgspec.structs.replace(scenario, repeat=1, duration_s=None)
    simulation = simulate(once, load_phone("ideal"), seed=1)
    pieces = simulation.plan.pieces
    assert pieces[0].t_start == 0.0
    assert pieces[-1].t_end >= simulation.plan.duration
    assert all(a.t_end == b.t_start for a, b in pairwise(pieces))
    assert len(simulation.truth.rests) >= 1
    assert (scenario.duration_s, scenario.repeat) == LENGTHS.get(name, (None, 1))


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


def test_claims_fill_up_from_the_settings_and_can_be_wrong() -> None:
    phone = load_phone("nexus4")
    claimed = phone.claimed()
    assert claimed["nominal_rate_hz"] == 200.0 != phone.accel.rate_hz
    assert claimed["device"] == "LG Nexus 4"
    assert claimed["accel_noise_density"] == 0.0025
    assert "gravity" not in claimed


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


def test_population_spreads_as_the_measured_devices_did() -> None:
    """Stisen et al. 2015, 3.1: deviations of -8.5 % to +7.5 % of g, mean 9.76 m/s^2; Table 1: rates."""
    phones = population(400, seed=1)
    affine = [(np.array(p.accel.bias), np.array(p.accel.scale)) for p in phones]
    deviations = np.concatenate([face_deviations(*a) for a in affine])
    assert FACE_RANGE[0] <= deviations.min() < -0.08
    assert 0.07 < deviations.max() <= FACE_RANGE[1]
    assert 9.81 * (1.0 + deviations.mean()) == pytest.approx(9.76, abs=0.02)
    nominal = {p.claims.nominal_rate_hz for p in phones}
    assert nominal == {m.rate_hz for m in MODELS} == {25.0, 50.0, 100.0, 125.0, 150.0, 200.0}
    share = np.mean([p.claims.device == "LG Nexus 4" for p in phones])
    assert share == pytest.approx(11 / 38, abs=0.08)


def test_population_is_the_same_whatever_its_size() -> None:
    assert population(3, seed=9) == population(5, seed=9)[:3]
    assert population(2, seed=9) != population(2, seed=10)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[accel]\nrate_hz = 0.0", "rate_hz"),
        ("[accel]\nscale = [[0, 0, 0], [0, 0, 0], [0, 0, 0]]", "invertible"),
        ("[accel]\ncutoff_hz = 60.0", "cutoff_hz"),
        ("[accel.noise]\nwhite = -1.0", "white"),
        ("[clock]\ndrop_fraction = 1.5", "drop_fraction"),
        ("[accel]\nbiass = [0, 0, 0]", "biass"),
        ('[[effect]]\nname = "magic"', "magic"),
        ("[accel", "table declaration"),
    ],
)
def test_a_bad_phone_file_is_refused_with_file_and_field(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=said) as refusal:
        load_phone(file)
    assert "bad.toml" in str(refusal.value)


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match="typical"):
        load_phone("no_such_phone")
    with pytest.raises(ValueError, match="tables"):
        load_scenario("no_such_scenario")


def test_bad_scenarios_are_refused(tmp_path: Path) -> None:
    for text, said in (
        ('[[segment]]\nactivity = "flying"', "flying"),
        ('[[segment]]\nactivity = "rest"\nduration_s = -1.0', "duration_s"),
        ('[[segment]]\nactivity = "rest"\nplace = { latitude = 91.0, longitude = 0.0 }', "latitude"),
        ("segment = []", "segment"),
        ('[[segment]]\nactivity = "rest"\nsupport = "ceiling"', "ceiling"),
        ('[[segment]]\nactivity = "table"\nsupports = { moon = 1.0 }', "moon"),
        ('[[segment]]\nactivity = "table"\nrest_s = [90.0, 5.0]', "rest_s"),
    ):
        file = tmp_path / "scenario.toml"
        file.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=said):
            load_scenario(file)


def test_poses_can_be_told_one_by_one() -> None:
    ups = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    segment = {"activity": "poses", "ups": ups.tolist(), "rest_s": 5.0}
    simulation = simulate(msgspec.convert({"segment": [segment]}, type=Scenario), load_phone("ideal"), seed=1)
    assert np.array([r.up for r in simulation.truth.rests]) == pytest.approx(ups, abs=1e-12)
    assert [r.t_end - r.t_start for r in simulation.truth.rests] == pytest.approx([5.0] * 3)


def test_the_guide_names_every_effect_phone_scenario_and_activity() -> None:
    guide = (Path(__file__).resolve().parents[2] / "docs" / "phone.md").read_text(encoding="utf-8")
    activities = [k.__struct_config__.tag for k in get_args(Segment)]
    missing = [n for n in [*EFFECTS, *PHONES, *SCENARIOS, *activities] if f"`{n}`" not in guide]
    assert not missing
