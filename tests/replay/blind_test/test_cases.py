"""Cases: every effect can be drawn and put in, two makers agree, and what the recordings do not tell."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from stillcal.replay.blind_test import cases
from stillcal.replay.blind_test import simulator_cases as simulated
from stillcal.replay.blind_test.cases import make_case
from stillcal.replay.blind_test.designs import DECOYS, HIDDEN, SHARES, VARIANTS, Design, planned
from stillcal.replay.blind_test.hidden.near_shapes import NEAR_SHAPES
from stillcal.replay.blind_test.hidden.off_catalogue import OFF_CATALOGUE
from stillcal.replay.blind_test.hidden.off_catalogue_reserve import RESERVE
from stillcal.replay.blind_test.keys import SealError, TrueEffect, key_of, opened, seal_of, sealed
from stillcal.replay.blind_test.make import ChallengeError, make, read_manifest
from stillcal.replay.blind_test.power import detectability as power
from stillcal.replay.blind_test.power import direct as sizes
from stillcal.replay.blind_test.power.misfit import left_by_names
from stillcal.replay.blind_test.power.sizing import NAMES, Stage, drawn_effect, put_in
from stillcal.replay.blind_test.world import phones
from stillcal.replay.blind_test.world.day import binned, over_bins
from stillcal.replay.blind_test.world.days import Day, play
from stillcal.replay.blind_test.world.forward_model import FORWARD, played
from stillcal.replay.blind_test.world.grounds import GROUNDS
from stillcal.replay.blind_test.world.phones import Additions

DOCUMENTED = """
accel_bias_temperature gyro_bias_temperature accel_scale_temperature gyro_scale_temperature
accel_warmup gyro_warmup thermal_latent gyro_g_sensitivity accel_nonlinearity gyro_nonlinearity
accel_bias_step gyro_bias_step accel_bias_drift gyro_bias_drift accel_bias_random_walk
gyro_bias_random_walk accel_charging_bias gyro_charging_bias accel_saturation gyro_saturation
accel_quantisation gyro_quantisation noise_unequal_axes noise_heavy_tailed noise_level
vibration_tone clock_skew timestamp_jitter dropped_samples arrival_bursts accel_gyro_time_offset
bandwidth lever_arm
"""


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let recordings be short: what is tested here does not depend on it."""
    monkeypatch.setattr(cases, "LENGTHS_S", (240.0, 400.0))


def test_every_documented_effect_is_in_the_examination() -> None:
    assert sorted(NAMES) == sorted(DOCUMENTED.split())
    assert not set(HIDDEN) & set(NAMES)
    assert len(OFF_CATALOGUE) >= 10 and len(RESERVE) >= 10 and len(OFF_CATALOGUE) + len(RESERVE) >= 20


def stage_of(seed: int, **day: object) -> Stage:
    rng = np.random.default_rng(seed)
    world = play(Day(600.0, 25.0, **day), rng)  # type: ignore[arg-type]
    return Stage(world, binned(world), phones.drawn_phone("flicker", 25.0, 9.80665, rng), rng)


@pytest.mark.parametrize("name", NAMES)
def test_every_effect_changes_the_recording_it_is_put_into(name: str) -> None:
    stage = stage_of(1, vivid=name.endswith("_saturation"), pivot=name == "lever_arm")
    before, added = stage.phone, Additions.none(stage.world)
    effect = drawn_effect(stage, name, 12.0)
    put_in(stage, effect, added)
    plain = phones.recorded(stage.world, before, Additions.none(stage.world), np.random.default_rng(2))
    with_it = phones.recorded(stage.world, stage.phone, added, np.random.default_rng(2))
    told = {"accel": "accelerometer", "gyro": "gyroscope", "timing": "accelerometer"}[effect.sensor]
    one, other = getattr(plain, told), getattr(with_it, told)
    if effect.effect == "accel_gyro_time_offset":
        one, other = plain.gyroscope, with_it.gyroscope
    same = len(one) == len(other) and all(
        np.array_equal(getattr(one, f), getattr(other, f)) for f in ("t", "xyz", "t_arrival")
    )
    assert not same
    assert effect.axes and effect.sensor in ("accel", "gyro", "timing")


@pytest.mark.parametrize(
    "name", [n for n in FORWARD if n not in ("gyro_scale_temperature", "gyro_nonlinearity")]
)
def test_a_slow_effect_has_the_d_prime_it_was_drawn_for(name: str) -> None:
    stage = stage_of(3)
    effect = drawn_effect(stage, name, 7.0)
    added = Additions.none(stage.world)
    put_in(stage, effect, added)
    delta = over_bins(stage.world, stage.bins, getattr(added, effect.sensor))
    assert power.d_prime(stage.weight(effect.sensor), delta) == pytest.approx(7.0, rel=1e-6)


@pytest.mark.parametrize("name", [n for n in simulated.CAN if n in FORWARD])
def test_the_simulated_phone_and_the_examiner_agree_on_slow_effects(name: str) -> None:
    """Two makers, no shared formula: what an effect adds to the bins of one day is the same to a percent."""
    rng = np.random.default_rng(4)
    phone = phones.drawn_phone("white", 25.0, 9.812, rng)
    phone = replace(phone, accel=replace(phone.accel, lsb=1e-7), gyro=replace(phone.gyro, lsb=1e-8))
    day = simulated.drawn_day(400.0, rng)
    world = simulated.world_of(simulated.simulated(phone, day, [], 9), 25.0)
    stage = Stage(world, binned(world), phone, rng)
    effect = drawn_effect(stage, name, 30.0)
    entries = [simulated.entry_of(phone, effect)]
    plain, with_it = (simulated.recorded(simulated.simulated(phone, day, e, 9), phone) for e in ([], entries))
    told = "gyroscope" if effect.sensor == "gyro" else "accelerometer"
    difference = getattr(with_it, told).xyz - getattr(plain, told).xyz
    added = Additions.none(world)
    put_in(stage, effect, added)
    expected = getattr(added, effect.sensor)[
        np.clip(np.searchsorted(world.t, getattr(plain, told).t), 0, world.t.size - 1)
    ]
    switched = [effect.parameters.get("at_s", -9.0), *world.drive[:, 0]]
    near = (np.abs(getattr(plain, told).t[:, None] - switched) < 1.0).any(axis=1)
    inside = (world.rest_of(getattr(plain, told).t) >= 0) & ~near
    assert np.abs(difference - expected)[inside].max() < 0.02 * np.abs(expected[inside]).max()


def test_the_earth_is_one_vector_of_the_ground_for_a_simulated_phone_too() -> None:
    rng = np.random.default_rng(1)
    phone, day = phones.drawn_phone("white", 25.0, 9.81, rng), simulated.drawn_day(300.0, rng)
    world = simulated.world_of(simulated.simulated(phone, day, [], 3), 25.0)
    bins = binned(world)
    up = bins.force / np.linalg.norm(bins.force, axis=1, keepdims=True)
    rate = over_bins(world, bins, world.rate)
    parts = np.array([(rate * v).sum(axis=1) for v in (up, bins.north, np.cross(bins.north, up))])
    assert np.ptp(parts, axis=1).max() < 1e-9
    assert np.linalg.norm(parts.mean(axis=1)) == pytest.approx(7.292115e-5, rel=1e-4)


def test_sizes_are_the_inverse_of_what_they_are_drawn_from() -> None:
    ratio = sizes.tail_ratio(6.0, 20_000)
    assert sizes.excess_kurtosis(ratio, 0.02) == pytest.approx(
        6.0 * np.hypot(sizes.KURTOSIS_SPREAD, np.sqrt(8.0 / 20_000))
    )
    rng, step = np.random.default_rng(5), sizes.comb_step(10.0, 20_000, 1.0)
    # Rayleigh's statistic of the phases on a comb of that step has the size that was asked for.
    phases = np.exp(2j * np.pi * rng.standard_normal(60_000) / step)
    assert np.sqrt(2.0) * np.abs(phases.sum()) / np.sqrt(60_000 / 3.0) / np.sqrt(3.0) == pytest.approx(
        10.0, abs=3.0
    )
    lost = sizes.dropped(5.0, 30_000)
    assert lost / np.hypot(np.sqrt(lost / 30_000), sizes.DROP_SPREAD) == pytest.approx(5.0)


def test_the_plan_has_every_kind_and_in_each_about_half_from_either_maker() -> None:
    designs = planned(1000, 1)
    assert len(designs) == 1000 and {d.kind for d in designs} == set(SHARES)
    for kind in SHARES:
        of_it = [d for d in designs if d.kind == kind]
        share = sum(d.maker == "simulator" for d in of_it) / len(of_it)
        assert 0.35 < share < 0.65, kind
        if kind != "null":
            assert {d.names for d in of_it} == set(VARIANTS[kind]), kind
    assert {d.ground for d in designs if d.kind == "null"} == set(GROUNDS)
    assert {d.ground for d in designs if d.kind != "null"} == {"firm"}
    assert 10 <= sum(d.full_length for d in designs) <= 30
    assert Counter(d.kind for d in planned(1000, 1, ["reserve"]))["reserve"] == 120


@pytest.mark.parametrize("name", [*HIDDEN])
def test_hidden_kinds_are_in_their_recordings(name: str) -> None:
    """What is sized by rests is in the bins that the key stores, and the key says what it is near to."""
    kind = HIDDEN[name]
    maker = "examiner" if kind.vivid else ("examiner", "simulator")[[*HIDDEN].index(name) % 2]
    case = make_case(Design("near_shape", "white", maker, (name,), 9.0, False), 6, 1)
    key, samples = case.key, case.recording.accelerometer
    assert key.exam is not None and np.isfinite(samples.xyz).all()
    assert (np.diff(samples.t) > 0.0).all(), "time runs on"
    sensor = kind.sensor if kind.sensor != "timing" else "accel"
    assert (np.abs(getattr(key.exam, sensor)).max() > 0.0) or not kind.sized
    assert (key.misfit is not None) == kind.sized
    assert key.nearest == list(kind.nearest) and key.entailed == list(kind.entailed)
    assert key.effects[0].t_end > key.effects[0].t_start
    assert set(key.nearest) <= set(NAMES)


@pytest.mark.parametrize("name", [n for n, k in HIDDEN.items() if k.altered is not None])
def test_kinds_that_alter_a_finished_recording_do(name: str) -> None:
    kind, stage = HIDDEN[name], stage_of(3, vivid=HIDDEN[name].vivid)
    recording = phones.recorded(stage.world, stage.phone, Additions.none(stage.world), stage.rng)
    assert kind.altered is not None
    altered, begin, end = kind.altered(recording, stage)
    changed = [
        not np.array_equal(getattr(getattr(recording, s), f), getattr(getattr(altered, s), f))
        for s in ("accelerometer", "gyroscope")
        for f in ("t", "xyz")
    ]
    of = {"accel": [False, True, False, False], "gyro": [False, False, False, True]}
    assert changed == of.get(kind.sensor, [True, False, True, False])
    assert 0.0 <= begin < end


def test_a_named_effect_leaves_nothing_of_itself_and_something_of_a_near_shape() -> None:
    stage = stage_of(5)
    for name in ("accel_bias_temperature", "accel_charging_bias"):
        delta = played(stage.bins, name, {"slope": [0.1, 0.0, 0.0], "step": [0.0, 0.1, 0.1]})
        weight = stage.weight("accel")
        assert left_by_names(stage.bins, "accel", weight, delta) < 1e-3 * power.d_prime(weight, delta)
    curve = over_bins(stage.world, stage.bins, NEAR_SHAPES["saturating_temperature"].added(stage))  # type: ignore[misc]
    line = left_by_names(stage.bins, "accel", weight, curve, ("accel_bias_temperature",))
    every = left_by_names(stage.bins, "accel", weight, curve)
    assert every < line < power.d_prime(weight, curve), "a cubic follows a saturation better than a line"


@pytest.mark.parametrize("decoy", DECOYS)
def test_decoys_conceal_nothing(decoy: str) -> None:
    for maker in ("examiner", *(["simulator"] if decoy in simulated.DECOYS else [])):
        case = make_case(Design("decoy", "flicker", maker, (decoy,), 10.0, False), 7, 1)
        assert case.key.effects == [] and case.key.variant == decoy
        assert (case.recording.claims.gravity is None) == (decoy == "location")


@pytest.mark.parametrize("ground", simulated.GROUNDS)
def test_a_simulated_phone_lies_on_every_ground_and_hides_nothing(ground: str) -> None:
    case = make_case(Design("null", "white", "simulator", (), 2.0, False, ground), 7, 2)
    assert case.key.effects == [] and case.key.ground == ground
    rows = case.recording.accelerometer.xyz
    assert np.linalg.norm(rows, axis=1).mean() == pytest.approx(9.8, abs=0.6)


def test_a_case_is_its_design_seed_and_index() -> None:
    design = Design("single", "mixture", "examiner", ("accel_warmup",), 8.0, False)
    a, b, c = (make_case(design, 8, i) for i in (1, 1, 2))
    assert np.array_equal(a.recording.accelerometer.xyz, b.recording.accelerometer.xyz) and a.key == b.key
    assert not np.array_equal(a.recording.accelerometer.xyz[:100], c.recording.accelerometer.xyz[:100])


def test_a_seal_is_the_sum_of_the_file_and_breaks_with_one_bit() -> None:
    key = make_case(Design("null", "white", "examiner", (), 2.0, False), 9, 1).key
    file = sealed(key)
    assert seal_of(file) == hashlib.sha256(file).hexdigest()
    assert opened(file, seal_of(file), "r0001.key") == key
    assert sealed(key) != file
    changed = bytearray(file)
    changed[len(file) // 2] ^= 1
    with pytest.raises(SealError, match=r"r0001\.key.*not the one"):
        opened(bytes(changed), seal_of(file), "r0001.key")


def test_a_key_of_another_kind_is_refused() -> None:
    file = b'00\n{"kind":"guess"}\n'
    with pytest.raises(SealError, match="kind = guess"):
        opened(file, seal_of(file), "r0001.key")


@pytest.mark.parametrize(
    ("key", "field"),
    [
        ({"kind": "single"}, "effects"),
        ({"kind": "near_shape", "effects": [{}]}, "nearest"),
        ({"kind": "simulated", "effects": [{}]}, "relation = None"),
    ],
)
def test_a_key_that_lacks_what_its_kind_needs_is_refused(key: dict[str, object], field: str) -> None:
    step = {"effect": "accel_bias_step", "sensor": "accel", "axes": ["x"], "parameters": {}, "d_prime": None,
            "t_start": 0.0, "t_end": 9.0}  # fmt: skip
    if "effects" in key:
        key = {**key, "effects": [step]}
    with pytest.raises(SealError, match=f"mine: {field}"):
        key_of(msgspec.json.encode(key), "mine")


def test_recordings_tell_nothing_of_what_is_in_them(tmp_path: Path) -> None:
    manifest = make(tmp_path / "recordings", tmp_path / "keys", 4, 3)
    assert read_manifest(tmp_path / "recordings") == manifest
    words = [w.encode() for w in (*NAMES, *HIDDEN, *DECOYS, "examiner", "simulator", "flicker", "seed")]
    for path in (tmp_path / "recordings").iterdir():
        assert path.name == "manifest.json" or (path.name[0] == "r" and path.name[1:5].isdigit())
        head = path.read_bytes()[:4096]
        assert not any(word in head for word in words)
    assert sorted(p.stem for p in (tmp_path / "keys").iterdir()) == sorted(manifest.seals)
    with pytest.raises(ChallengeError, match="is not empty"):
        make(tmp_path / "recordings", tmp_path / "other", 1, 1)


def test_true_effects_of_a_pair_are_both_told() -> None:
    design = Design("pair", "white", "simulator", ("accel_bias_step", "dropped_samples"), 16.0, False)
    key = make_case(design, 10, 1).key
    assert [e.effect for e in key.effects] == ["accel_bias_step", "dropped_samples"]
    assert isinstance(key.effects[0], TrueEffect) and key.effects[0].t_start > 0.0
