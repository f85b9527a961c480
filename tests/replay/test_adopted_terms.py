"""From a simulated recording through its diagnosis to a store, and to another recording of the same phone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.api import apply, calibrate, diagnose
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.streams.samples import Samples
from stillcal.daemon.cli.store import store_group
from stillcal.daemon.store.store import Store
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone import load_phone, simulate
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.scenario import Scenario

POSES = {"activity": "poses", "count": 24, "rest_s": [18.0, 24.0]}
HAND = [{"activity": "rest", "duration_s": 30.0}, POSES]
PLUGGED = [POSES | {"count": 12, "charging": k % 2 == 0} for k in range(6)]
WARMED = [
    POSES | {"count": 14},
    {"activity": "rest", "duration_s": 300.0, "charging": True},
    POSES | {"count": 14, "charging": True},
    {"activity": "rest", "duration_s": 300.0},
    POSES | {"count": 14},
]
NO_HEAT = {"charge_k": 0.0, "use_k": 0.0}
HEAT = {"charge_k": 15.0, "use_k": 0.0, "fast_share": 1.0, "fast_tau_s": 100.0}

CASES: dict[str, tuple[dict[str, Any], list[dict[str, Any]], dict[str, float]]] = {
    "accel_nonlinearity": ({"quadratic": [1e-3, -8e-4, 1.2e-3]}, HAND, NO_HEAT),
    "accel_scale_temperature": ({"slope": [1e-3, -8e-4, 1e-3]}, WARMED, HEAT),
    "accel_charging_bias": ({"step": [0.04, -0.03, 0.05]}, PLUGGED, NO_HEAT),
    "accel_warmup": ({"amplitude": [0.08, -0.06, 0.07], "tau_s": 120.0}, [POSES, POSES], NO_HEAT),
}


def recorded(effect: str, seed: int) -> Recording:
    parameters, segments, heat = CASES[effect]
    table = msgspec.to_builtins(load_phone("ideal"))
    for sensor, noise in (("accel", 2e-3), ("gyro", 2e-4)):
        table[sensor] |= {"rate_hz": 25.0, "noise": {"white": noise}}
    table["accel"]["bias"] = [0.1, -0.2, 0.15]
    more = {"heat": heat, "effect": [{"name": effect, **parameters}]}
    phone = msgspec.convert(table | more, type=Phone)
    made = simulate(msgspec.convert({"segment": segments}, type=Scenario), phone, seed).whole()
    claims = msgspec.convert(phone.claimed(), Claims)
    return Recording(made.accelerometer, made.gyroscope, list(made.events), claims, [], "day.csv")


def off(samples: Samples) -> float:
    """Return by how much gravity at rest is off (rms), m/s^2."""
    windows = samples.xyz[: len(samples) // 50 * 50].reshape(-1, 50, 3)
    still = (windows.std(axis=1) < 0.02).all(axis=1)
    norms = np.linalg.norm(windows[still].mean(axis=1), axis=1)
    return rms(norms - np.median(norms))


def effects(findings: list[Mapping[str, Any]]) -> set[str]:
    return {str(finding["effect"]) for finding in findings}


@pytest.mark.slow
@pytest.mark.parametrize("effect", CASES)
def test_what_a_recording_shows_is_adopted_and_corrects_another_one(effect: str, tmp_path: Path) -> None:
    first, later = recorded(effect, 1), recorded(effect, 2)
    store, answer = tmp_path / "store.json", tmp_path / "day.json"
    calibrate(first).save(store)
    found = diagnose(first)
    assert effects(found.findings) == {effect}
    answer.write_text(json.dumps(found.as_dict()))
    before = off(apply(later, store).accelerometer)
    said = CliRunner().invoke(store_group, ["adopt-terms", str(store), str(answer)])
    assert f"now corrects {effect}" in said.output
    after = off(apply(later, store).accelerometer)
    assert after < before / 4
    assert not Store(store).rollback().document.current.terms
    assert off(apply(later, store).accelerometer) == pytest.approx(before)
