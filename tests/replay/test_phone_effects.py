"""Every effect does what its formula says, where it says, and nothing else."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.samples import Sensor
from stillcal.replay.phone import Phone, Scenario, Simulation, draw_rests, dump_phone, simulate
from stillcal.replay.phone.effect import Effect
from stillcal.replay.phone.effects import EFFECTS
from stillcal.replay.phone.settings import ClockSettings, HeatSettings, Noise, SensorSettings

SILENT = Noise()
V = (0.3, -0.2, 0.1)
SCENARIO = """
{"ambient_c": 20.0, "duration_s": 150.0, "segment": [
  {"activity": "table", "duration_s": 60.0, "rest_s": [4.0, 9.0], "use": 0.5},
  {"activity": "walk", "duration_s": 30.0, "ambient_c": 12.0},
  {"activity": "table", "duration_s": 60.0, "rest_s": [4.0, 9.0], "charging": true}
]}
"""
M = np.array([[1.01, 0.004, -0.003], [0.002, 0.99, 0.005], [-0.004, 0.001, 1.02]])


def scenario() -> Scenario:
    return msgspec.json.decode(SCENARIO, type=Scenario)


def phone(*effects: Effect, noise: Noise = SILENT, **clock: Any) -> Phone:
    sensor = SensorSettings(
        rate_hz=100.0, bias=(0.1, -0.2, 0.3), scale=tuple(map(tuple, M.tolist())), noise=noise
    )
    return Phone(
        accel=sensor,
        gyro=sensor,
        clock=ClockSettings(shared=True, **clock),
        heat=HeatSettings(),
        effects=effects,
    )


def effect(name: str, **parameters: Any) -> Effect:
    return msgspec.convert({"name": name, **parameters}, type=EFFECTS[name])


class Truth:
    """The true input at the samples' times, from the plan and the heat and nothing of the sensor."""

    def __init__(self, simulation: Simulation, t: np.ndarray) -> None:
        motion = simulation.plan.motion(t)
        self.t, self.force, self.rate, self.rate_dot = t, motion.force, motion.rate, motion.rate_dot
        self.warmth = simulation.temperature_at(t) - 25.0
        self.charging = simulation.plan.surroundings.charging.at(t)
        self.use = simulation.plan.surroundings.use.at(t)

    def of(self, sensor: str) -> np.ndarray:
        return self.force if sensor == "accel" else self.rate


def lagged(t: np.ndarray, drive: np.ndarray, tau: float) -> np.ndarray:
    """First-order lag by stepping, settled on the first value."""
    level = np.empty_like(drive)
    level[0] = drive[0]
    for i, dt in enumerate(np.diff(t)):
        level[i + 1] = drive[i] + (level[i] - drive[i]) * math.exp(-dt / tau)
    return level


G3 = ((0.01, 0.002, 0.0), (0.0, -0.01, 0.003), (0.001, 0.0, 0.02))
R = (0.03, 0.05, -0.01)


def slow(name: str, parameters: dict[str, Any], formula: Callable[[Truth, str], np.ndarray]) -> list[Any]:
    """The same effect on either sensor."""
    return [pytest.param(f"{s}_{name}", parameters, s, formula, id=f"{s}_{name}") for s in ("accel", "gyro")]


FORMULAS = [
    *slow("bias_temperature", {"slope": V}, lambda m, s: np.outer(m.warmth, V)),
    *slow("scale_temperature", {"slope": V}, lambda m, s: m.warmth[:, None] * np.array(V) * m.of(s)),
    *slow("warmup", {"amplitude": V, "tau_s": 40.0}, lambda m, s: np.outer(1 - np.exp(-m.t / 40.0), V)),
    *slow("bias_step", {"step": V, "at_s": 50.0}, lambda m, s: np.outer(m.t >= 50.0, V)),
    *slow("bias_drift", {"rate": V}, lambda m, s: np.outer(m.t, V)),
    *slow("charging_bias", {"step": V}, lambda m, s: np.outer(m.charging, V)),
    *slow(
        "nonlinearity",
        {"quadratic": V, "cubic": (0.01, 0.02, -0.01)},
        lambda m, s: np.array(V) * m.of(s) ** 2 + np.array([0.01, 0.02, -0.01]) * m.of(s) ** 3,
    ),
    *slow(
        "thermal_hysteresis",
        {"coefficient": V, "tau_s": 30.0},
        lambda m, s: np.outer(m.warmth - lagged(m.t, m.warmth, 30.0), V),
    ),
    pytest.param(
        "thermal_latent",
        {"amplitude": V, "tau_s": 30.0, "sensor": "gyro"},
        "gyro",
        lambda m, s: np.outer(lagged(m.t, m.use + m.charging, 30.0), V),
        id="thermal_latent",
    ),
    pytest.param(
        "gyro_g_sensitivity",
        {"matrix": G3},
        "gyro",
        lambda m, s: m.force @ np.array(G3).T,
        id="gyro_g_sensitivity",
    ),
    pytest.param(
        "lever_arm",
        {"position": R},
        "accel",
        lambda m, s: (np.cross(m.rate_dot, R) + np.cross(m.rate, np.cross(m.rate, R))) @ M.T,
        id="lever_arm",
    ),
    pytest.param(
        "vibration_tone",
        {"frequency": 17.0, "amplitude": V, "start_s": 20.0, "duration_s": 60.0},
        "accel",
        lambda m, s: np.outer(np.sin(34 * np.pi * m.t) * (m.t >= 20) * (m.t < 80), V) @ M.T,
        id="vibration_tone",
    ),
]


@pytest.mark.parametrize(("name", "parameters", "sensor", "formula"), FORMULAS)
def test_on_less_off_is_the_formula(name: str, parameters: Any, sensor: str, formula: Any) -> None:
    off = simulate(scenario(), phone(), seed=1)
    on = simulate(scenario(), phone(effect(name, **parameters)), seed=1)
    without, with_it = off.whole(), on.whole()
    a, g = without.accelerometer, without.gyroscope
    changes = {
        "accel": with_it.accelerometer.xyz - a.xyz,
        "gyro": with_it.gyroscope.xyz - g.xyz,
    }
    expected = formula(Truth(off, a.t), sensor)
    # a lag stepped from sample to sample meets the exact one only where steps fall between samples
    tolerance = 1e-3 if "thermal_" in name else 1e-9
    assert np.abs(changes.pop(sensor) - expected).max() < tolerance * (1.0 + np.abs(expected).max())
    assert np.abs(expected).max() > 1e-3
    assert np.all(next(iter(changes.values())) == 0.0)
    assert np.array_equal(a.t, with_it.accelerometer.t)
    assert np.array_equal(a.t_arrival, with_it.accelerometer.t_arrival)


def both(*effects: Effect, noise: Noise = SILENT, **clock: Any) -> tuple[Any, Any]:
    return (
        simulate(scenario(), phone(noise=noise, **clock), seed=1).whole(),
        simulate(scenario(), phone(*effects, noise=noise, **clock), seed=1).whole(),
    )


def test_saturation_clips_what_was_read() -> None:
    off, on = both(effect("accel_saturation", limit=7.0), effect("gyro_saturation", limit=1.5))
    assert np.array_equal(on.accelerometer.xyz, np.clip(off.accelerometer.xyz, -7.0, 7.0))
    assert np.array_equal(on.gyroscope.xyz, np.clip(off.gyroscope.xyz, -1.5, 1.5))


def test_saturation_of_the_element_comes_before_bias_and_scale() -> None:
    off, on = both(effect("accel_saturation", limit=7.0, before_filter=True))
    true = (off.accelerometer.xyz - [0.1, -0.2, 0.3]) @ np.linalg.inv(M).T
    expected = np.clip(true, -7.0, 7.0) @ M.T + [0.1, -0.2, 0.3]
    assert on.accelerometer.xyz == pytest.approx(expected, abs=1e-9)


def test_quantisation_rounds_noise_and_all() -> None:
    steps = effect("accel_quantisation", step=0.02), effect("gyro_quantisation", step=0.005)
    off, on = both(*steps, noise=Noise(white=0.002))
    assert on.accelerometer.xyz == pytest.approx(np.rint(off.accelerometer.xyz / 0.02) * 0.02, abs=1e-12)
    assert on.gyroscope.xyz == pytest.approx(np.rint(off.gyroscope.xyz / 0.005) * 0.005, abs=1e-12)


def test_bandwidth_halves_the_power_at_its_cutoff() -> None:
    """A tone at the cutoff comes out 3 dB down; white noise is cut as a Butterworth filter cuts it."""
    tone = effect("vibration_tone", frequency=10.0, amplitude=(0.0, 0.0, 1.0), sensor="both")
    slow_off = simulate(scenario(), phone(effect("bandwidth", cutoff=10.0)), seed=1).whole()
    slow_on = simulate(scenario(), phone(tone, effect("bandwidth", cutoff=10.0)), seed=1).whole()
    for stream in ("accelerometer", "gyroscope"):
        response = (getattr(slow_on, stream).xyz - getattr(slow_off, stream).xyz)[500:]
        rms = np.sqrt(np.mean(response**2, axis=0)) * math.sqrt(2.0)
        assert rms == pytest.approx(np.abs(M[:, 2]) / math.sqrt(2.0), rel=0.01)


def test_bandwidth_leaves_rests_alone() -> None:
    off, on = both(effect("bandwidth", cutoff=20.0))
    simulation = simulate(scenario(), phone(), seed=1)
    assert simulation.truth.rests and np.abs(off.accelerometer.xyz - on.accelerometer.xyz).max() > 1e-3
    for rest in simulation.truth.rests:
        late = [r.accelerometer.between(rest.t_start + 1.0, rest.t_end).xyz for r in (off, on)]
        assert np.abs(late[0] - late[1]).max() < 1e-6


def test_held_samples_repeat_the_one_before() -> None:
    off, on = both(effect("held_samples", fraction=0.2, sensor="accel"), noise=Noise(white=0.002))
    repeats = (np.diff(on.accelerometer.xyz, axis=0) == 0.0).all(axis=1)
    # 15000 draws: one standard deviation is 0.0033
    assert repeats.mean() == pytest.approx(0.2, abs=0.015)
    fresh = np.flatnonzero(~repeats) + 1
    assert np.array_equal(on.accelerometer.xyz[fresh], off.accelerometer.xyz[fresh])
    assert np.array_equal(on.gyroscope.xyz, off.gyroscope.xyz)


def noise_of(*effects: Effect) -> dict[str, np.ndarray]:
    """What noise adds, by sensor."""
    silent = simulate(scenario(), phone(), seed=1).whole()
    loud = simulate(scenario(), phone(*effects, noise=Noise(white=0.002)), seed=1).whole()
    return {s: getattr(loud, s).xyz - getattr(silent, s).xyz for s in ("accelerometer", "gyroscope")}


def test_noise_effects_scale_the_very_same_noise() -> None:
    plain = noise_of()
    louder = noise_of(effect("noise_level", ratio=3.0, sensor="accel"))
    assert louder["accelerometer"] == pytest.approx(3.0 * plain["accelerometer"], abs=1e-12)
    assert np.array_equal(louder["gyroscope"], plain["gyroscope"])
    uneven = noise_of(effect("noise_unequal_axes", ratio=(1.0, 2.0, 0.5)))
    for stream in plain:
        assert uneven[stream] == pytest.approx(plain[stream] * [1.0, 2.0, 0.5], abs=1e-12)


def test_heavy_tails_come_as_often_as_told() -> None:
    tails = noise_of(effect("noise_heavy_tailed", ratio=50.0, fraction=0.05))["accelerometer"]
    sd = 0.002 * math.sqrt(50.0)
    # beyond 5 sigma only the tails reach, and 92 % of them do (|x| > 0.1)
    assert np.mean(np.abs(tails) > 5.0 * sd) == pytest.approx(0.05 * 0.92, rel=0.1)


@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_bias_random_walk_walks(sensor: str) -> None:
    name = {"accel": "accelerometer", "gyro": "gyroscope"}
    off, on = both(effect(f"{sensor}_bias_random_walk", density=(0.01, 0.02, 0.0)))
    walked = {s: getattr(on, n).xyz - getattr(off, n).xyz for s, n in name.items()}
    steps = walked[sensor][::100][1:] - walked[sensor][::100][:-1]
    # 149 steps of 1 s: good to 6 %
    assert steps.std(axis=0)[:2] == pytest.approx([0.01, 0.02], rel=0.25)
    assert np.abs(walked[sensor][:, 2]).max() < 1e-12
    assert np.all(walked["gyro" if sensor == "accel" else "accel"] == 0.0)


def test_spikes_are_rare_single_samples() -> None:
    off, on = both(effect("spikes", amplitude=(0.0, 0.0, 5.0), per_hour=1200.0, sensor="accel"))
    change = on.accelerometer.xyz - off.accelerometer.xyz
    hit = np.abs(change[:, 2]) > 1e-9
    assert 25 <= hit.sum() <= 80  # 50 expected
    assert np.abs(change[hit, 2]) == pytest.approx(5.0)
    assert np.abs(change[:, :2]).max() == 0.0


@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_vibration_rectifies_into_bias(sensor: str) -> None:
    """A tone of amplitude A leaves k A^2 / 2 behind on average, less what the lag of 0.5 s takes."""
    tone = effect("vibration_tone", frequency=20.0, amplitude=(0.0, 0.0, 2.0))
    kind = effect(f"{sensor}_vibration_rectification", coefficient=(0.0, 0.0, 0.1))
    name = {"accel": "accelerometer", "gyro": "gyroscope"}[sensor]
    text = '{"segment": [{"activity": "rest", "duration_s": 60.0}]}'
    rest = msgspec.json.decode(text, type=Scenario)
    quiet, loud = (simulate(rest, phone(*e), seed=1).whole() for e in ((tone,), (tone, kind)))
    change = (getattr(loud, name).xyz - getattr(quiet, name).xyz)[1000:]
    keep = math.exp(-1.0 / 50.0)
    passed = 1.0 - (1.0 - keep) / (1.0 - keep * np.exp(-2j * np.pi * 20.0 / 100.0))
    expected = 0.1 * (2.0 * abs(passed)) ** 2 / 2.0
    assert change.mean(axis=0) == pytest.approx([0.0, 0.0, expected], abs=0.002 * expected)


def test_clock_skew_shortens_true_intervals_and_keeps_stamps() -> None:
    off, on = both(effect("clock_skew", relative=0.01))
    assert np.diff(on.accelerometer.t) == pytest.approx(0.01, abs=1e-9)
    assert np.diff(on.accelerometer.t_arrival) == pytest.approx(0.01 / 1.01, abs=1e-9)
    assert len(on.accelerometer) == pytest.approx(1.01 * len(off.accelerometer), abs=2)


def test_timestamp_jitter_scatters_stamps_only() -> None:
    off, on = both(effect("timestamp_jitter", sigma=5e-4))
    assert np.std(on.accelerometer.t - off.accelerometer.t) == pytest.approx(5e-4, rel=0.03)
    assert np.array_equal(on.accelerometer.xyz, off.accelerometer.xyz)
    assert np.diff(on.accelerometer.t).min() > 0.0


def test_wild_jitter_never_turns_time_back() -> None:
    _, on = both(effect("timestamp_jitter", sigma=0.05))
    assert np.diff(on.accelerometer.t).min() >= 0.0


def test_dropped_samples_leave_the_others_as_they_were() -> None:
    off, on = both(effect("dropped_samples", fraction=0.1), noise=Noise(white=0.002, flicker=0.001))
    assert 1.0 - len(on.accelerometer) / len(off.accelerometer) == pytest.approx(0.1, abs=0.01)
    kept = np.isin(off.accelerometer.t, on.accelerometer.t)
    assert np.array_equal(off.accelerometer.xyz[kept], on.accelerometer.xyz)


def test_doubled_samples_come_twice_whole() -> None:
    off, on = both(effect("doubled_samples", fraction=0.1), noise=Noise(white=0.002))
    twice = np.diff(on.accelerometer.t) == 0.0
    assert twice.mean() == pytest.approx(0.1 / 1.1, abs=0.01)
    assert np.all(np.diff(on.accelerometer.xyz, axis=0)[twice] == 0.0)
    assert np.array_equal(np.unique(on.accelerometer.t), off.accelerometer.t)


def test_arrival_bursts_hold_samples_back() -> None:
    off, on = both(effect("arrival_bursts", fraction=0.3, burst_s=0.2))
    late = on.accelerometer.t_arrival > off.accelerometer.t_arrival + 1e-9
    assert late.mean() == pytest.approx(0.3, abs=0.06)  # 750 windows: sd 0.017
    assert (on.accelerometer.t_arrival - on.accelerometer.t).max() <= 0.2 + 1e-9
    assert np.diff(on.accelerometer.t_arrival).min() >= 0.0
    assert np.array_equal(on.accelerometer.xyz, off.accelerometer.xyz)


def test_time_offset_delays_the_gyroscope_motion() -> None:
    delay = 0.03
    off, on = both(effect("accel_gyro_time_offset", delay=delay))
    simulation = simulate(scenario(), phone(), seed=1)
    earlier = simulation.plan.motion(off.gyroscope.t - delay).rate @ M.T + [0.1, -0.2, 0.3]
    assert on.gyroscope.xyz == pytest.approx(earlier, abs=1e-12)
    assert np.array_equal(on.accelerometer.xyz, off.accelerometer.xyz)


def test_tilt_creep_moves_across_gravity_and_keeps_the_norm() -> None:
    creeping = phone(effect("tilt_creep", amplitude=0.01, tau_s=5.0))
    simulation = simulate(scenario(), creeping, seed=1)
    moved = []
    for rest in simulation.truth.rests:
        t = np.linspace(rest.t_start, rest.t_end, 50)
        force = simulation.plan.motion(t).force
        assert np.linalg.norm(force, axis=1) == pytest.approx(rest.gravity, rel=1e-12)
        span = rest.t_end - rest.t_start
        angle = math.asin(np.linalg.norm(np.cross(force[0], force[-1])) / rest.gravity**2)
        moved.append(angle / (0.01 * (1.0 - math.exp(-span / 5.0))))
    assert moved == pytest.approx(np.ones(len(moved)), rel=1e-3)


CONTRACT = {
    "accel_bias_temperature",
    "gyro_bias_temperature",
    "accel_scale_temperature",
    "gyro_scale_temperature",
    "accel_warmup",
    "gyro_warmup",
    "thermal_latent",
    "gyro_g_sensitivity",
    "accel_nonlinearity",
    "gyro_nonlinearity",
    "accel_bias_step",
    "gyro_bias_step",
    "accel_bias_drift",
    "gyro_bias_drift",
    "accel_bias_random_walk",
    "gyro_bias_random_walk",
    "accel_charging_bias",
    "gyro_charging_bias",
    "accel_saturation",
    "gyro_saturation",
    "accel_quantisation",
    "gyro_quantisation",
    "noise_unequal_axes",
    "noise_heavy_tailed",
    "noise_level",
    "vibration_tone",
    "clock_skew",
    "timestamp_jitter",
    "dropped_samples",
    "arrival_bursts",
    "accel_gyro_time_offset",
    "bandwidth",
    "lever_arm",
}


def test_every_effect_that_a_diagnosis_can_name_can_be_switched_on() -> None:
    assert set(EFFECTS) >= CONTRACT


def example(kind: type[Effect]) -> Effect:
    """One of each, with numbers fit for its fields."""
    values: dict[str, Any] = {}
    for field in msgspec.structs.fields(kind):
        if field.required:
            text = str(field.type)
            values[field.name] = G3 if text.count("tuple") > 1 else V if "tuple" in text else 0.125
    return kind(**values)


@pytest.mark.parametrize("kind", EFFECTS.values(), ids=EFFECTS)
def test_effects_survive_a_phone_file(kind: type[Effect]) -> None:
    before = Phone(effects=(example(kind),))
    after = msgspec.convert(tomllib.loads(dump_phone(before)), type=Phone)
    assert after == before
    assert after.effects[0].name == next(n for n, k in EFFECTS.items() if k is kind)


def test_an_unknown_effect_or_field_is_refused_by_name() -> None:
    with pytest.raises(msgspec.ValidationError, match="telepathy"):
        msgspec.convert({"effect": [{"name": "telepathy"}]}, type=Phone)
    with pytest.raises(msgspec.ValidationError, match="slop"):
        msgspec.convert({"effect": [{"name": "accel_bias_drift", "slop": [0, 0, 0]}]}, type=Phone)


def test_drawn_rests_carry_effects_that_means_can_show() -> None:
    clean, curved = (phone(*e) for e in ((), (effect("accel_nonlinearity", quadratic=V),)))
    a, b = (draw_rests(p, 30, seed=1) for p in (clean, curved))
    assert b.forces - a.forces == pytest.approx(np.array(V) * a.true_forces**2, abs=1e-12)


def test_drawn_rests_refuse_what_only_samples_can_show() -> None:
    with pytest.raises(ValueError, match="accel_vibration_rectification"):
        draw_rests(phone(effect("accel_vibration_rectification", coefficient=V)), 5)


def test_effects_on_one_sensor_do_not_concern_the_other() -> None:
    kind = effect("noise_level", ratio=2.0, sensor="gyro")
    assert kind.concerns(Sensor.GYROSCOPE)
    assert not kind.concerns(Sensor.ACCELEROMETER)
