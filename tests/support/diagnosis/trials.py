"""End-to-end trials on simulated phones: each effect in turn, and nulls of several noise families.

    python -m tests.support.diagnosis.trials --scenario tables --minutes 60
        --effects all|none|name,... [--seeds 3]

Prints what was found beside what was put in.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import msgspec

from stillcal.calib_core.diagnosis.diagnose import diagnose
from stillcal.calib_core.diagnosis.model.records import Claims, Diagnosis
from stillcal.calib_core.streams.events import Charging
from stillcal.replay.phone.phone import Phone, load_phone
from stillcal.replay.phone.scenario import load_scenario
from stillcal.replay.phone.simulation import simulate

EFFECTS: list[dict[str, Any]] = [
    {"name": "accel_bias_temperature", "slope": [0.004, 0.0, -0.003]},
    {"name": "gyro_bias_temperature", "slope": [1e-4, 0.0, -2e-4]},
    {"name": "accel_scale_temperature", "slope": [3e-4, 3e-4, -3e-4]},
    {"name": "accel_warmup", "amplitude": [0.05, 0.0, 0.04], "tau_s": 300.0},
    {"name": "gyro_warmup", "amplitude": [0.001, 0.0, 0.002], "tau_s": 300.0},
    {"name": "gyro_g_sensitivity", "matrix": [[2e-4, 0.0, 0.0], [0.0, 0.0, 1e-4], [0.0, 0.0, 0.0]]},
    {"name": "accel_nonlinearity", "quadratic": [3e-4, 0.0, -3e-4]},
    {"name": "accel_bias_step", "step": [0.04, 0.0, 0.03], "at_s": 1000.0},
    {"name": "gyro_bias_step", "step": [0.001, 0.0, 0.0], "at_s": 1000.0},
    {"name": "accel_bias_drift", "rate": [2e-5, 0.0, 1e-5]},
    {"name": "gyro_bias_drift", "rate": [4e-7, 0.0, 0.0]},
    {"name": "accel_charging_bias", "step": [0.0, 0.03, 0.02]},
    {"name": "gyro_charging_bias", "step": [4e-4, 0.0, 0.0]},
    {"name": "accel_bias_random_walk", "density": [2e-3, 2e-3, 2e-3]},
    {"name": "gyro_bias_random_walk", "density": [6e-5, 6e-5, 6e-5]},
    {"name": "accel_saturation", "limit": 14.0},
    {"name": "gyro_saturation", "limit": 2.0},
    {"name": "accel_quantisation", "step": 0.04},
    {"name": "gyro_quantisation", "step": 0.004},
    {"name": "noise_unequal_axes", "sensor": "accel", "ratio": [1.0, 1.0, 1.6]},
    {"name": "noise_heavy_tailed", "sensor": "accel", "ratio": 5.0},
    {"name": "noise_level", "sensor": "gyro", "ratio": 1.6},
    {"name": "vibration_tone", "frequency": 17.0, "amplitude": [0.0, 0.0, 0.01]},
    {"name": "clock_skew", "relative": 0.004},
    {"name": "timestamp_jitter", "sigma": 0.002},
    {"name": "dropped_samples", "fraction": 0.01},
    {"name": "arrival_bursts", "fraction": 0.1},
    {"name": "accel_gyro_time_offset", "delay": 0.012},
    {"name": "bandwidth", "sensor": "accel", "cutoff": 9.0},
    {"name": "lever_arm", "position": [0.03, 0.05, 0.0]},
    {"name": "gyro_nonlinearity", "quadratic": [0.01, 0.0, 0.01]},
    {"name": "gyro_scale_temperature", "slope": [1e-3, 1e-3, 1e-3]},
    {"name": "accel_vibration_rectification", "coefficient": [0.5, 0.5, 0.5]},
]


def claims_of(phone: Phone) -> Claims:
    """Return what the unaltered phone's maker would claim."""
    fields = {k: v for k, v in phone.claimed().items() if k in Claims.__slots__}
    return Claims(**fields)


def run(
    scenario: str, phone: Phone, minutes: float, rate: float, seed: int, thermometer: bool
) -> tuple[Diagnosis, float]:
    """Simulate one recording and diagnose it; return the answer and its time in s."""
    day = msgspec.structs.replace(load_scenario(scenario), duration_s=60.0 * minutes)
    phone = msgspec.structs.replace(
        phone,
        accel=msgspec.structs.replace(phone.accel, rate_hz=rate),
        gyro=msgspec.structs.replace(phone.gyro, rate_hz=rate),
        heat=msgspec.structs.replace(phone.heat, thermometer=thermometer),
    )
    made = simulate(day, phone, seed).whole()
    events = [Charging(e.t, e.on) for e in made.events if type(e).__name__ == "Charging"]
    began = time.perf_counter()
    answer = diagnose(
        made.accelerometer, made.gyroscope, events, claims_of(msgspec.structs.replace(phone, effects=()))
    )
    return answer, time.perf_counter() - began


def show(label: str, answer: Diagnosis, seconds: float) -> None:
    """Print one line a finding."""
    print(f"{label}: {len(answer.findings)} found, {seconds:.1f} s", flush=True)
    for f in answer.findings:
        values = {
            k: p.value if not isinstance(p.value, float) else round(p.value, 6)
            for k, p in f.parameters.items()
        }
        alike = [a.effect for a in f.alternatives if a.indistinguishable]
        print(
            f"      {f.effect} {f.sensor} {f.axes} {f.evidence.log_bayes_factor:.1f} nats {values} ~{alike}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="tables")
    parser.add_argument("--phone", default="typical")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--effects", default="all")
    parser.add_argument("--no-thermometer", action="store_true")
    options = parser.parse_args()
    base = load_phone(options.phone)
    chosen = [e for e in EFFECTS if options.effects == "all" or e["name"] in options.effects.split(",")]
    for effect in [None] if options.effects == "none" else chosen:
        table = msgspec.to_builtins(base) | ({} if effect is None else {"effect": [effect]})
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            phone = msgspec.convert(table, type=Phone)
            args = (options.scenario, phone, options.minutes, options.rate, seed, not options.no_thermometer)
            show(f"{effect or 'nothing'} seed {seed}", *run(*args))


if __name__ == "__main__":
    main()
