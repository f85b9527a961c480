"""A finding's NumPy function is pasted, run on simulated samples, and takes the effect out of them.

The samples are made by the simulated phone's own effects, which share no formula with the diagnosis.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.diagnosis.effects.catalogue import named_effects
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.diagnosis.words.correction_code import CODE, code_of, equation_of, to_paste
from stillcal.replay.phone.effects.base import Circumstances, Moment
from stillcal.replay.phone.effects.registry import EFFECTS

RATE_HZ, N = 100.0, 6000
T = np.arange(N) / RATE_HZ
PHASE = 2.0 * np.pi * np.outer(T, [0.13, 0.21, 0.34])
FORCE = 9.8 * np.sin(PHASE)
RATE = 2.0 * np.cos(PHASE)
RATE_DOT = -2.0 * 2.0 * np.pi * np.array([0.13, 0.21, 0.34]) * np.sin(PHASE)
WARMTH = 10.0 * np.sin(2.0 * np.pi * T / 60.0)
REFERENCE_C = 25.0


def finding(effect: str, sensor: str, values: dict[str, Any], **more: Any) -> dict[str, Any]:
    parameters = {k: {"value": v, "unit": "1"} for k, v in values.items()}
    return {
        "effect": effect,
        "sensor": sensor,
        "parameters": parameters,
        "where": {"t_start": 20.0},
        "reference": {"temperature_c": REFERENCE_C},
        **more,
    }


def pasted(found: dict[str, Any]) -> Any:
    names: dict[str, Any] = {}
    exec(code_of(found), names)
    return names["correct"]


ADDED = [
    ("accel_bias_temperature", "accel", {"slope": [5e-3, -3e-3, 4e-3]}, {}),
    ("gyro_bias_temperature", "gyro", {"slope": [2e-4, -1e-4, 1e-4]}, {}),
    ("accel_scale_temperature", "accel", {"slope": [1e-4, 1e-4, -1e-4]}, {}),
    ("gyro_scale_temperature", "gyro", {"slope": [1e-4, 1e-4, -1e-4]}, {}),
    ("accel_warmup", "accel", {"amplitude": [0.05, 0.02, -0.03], "tau_s": 15.0}, {}),
    ("gyro_warmup", "gyro", {"amplitude": [1e-3, 2e-3, -1e-3], "tau_s": 15.0}, {}),
    ("accel_bias_drift", "accel", {"rate": [1e-3, 0.0, -1e-3]}, {}),
    ("gyro_bias_drift", "gyro", {"rate": [1e-4, 0.0, -1e-4]}, {}),
    ("accel_bias_step", "accel", {"step": [0.03, 0.0, -0.02]}, {"at_s": 20.0}),
    ("gyro_bias_step", "gyro", {"step": [3e-3, 0.0, -2e-3]}, {"at_s": 20.0}),
    ("gyro_g_sensitivity", "gyro", {"matrix": [[1e-4, 0, 2e-4], [0, -1e-4, 0], [3e-4, 0, 1e-4]]}, {}),
    ("accel_nonlinearity", "accel", {"quadratic": [2e-4, -1e-4, 2e-4], "cubic": [1e-5, 0.0, 1e-5]}, {}),
    ("gyro_nonlinearity", "gyro", {"quadratic": [2e-3, -1e-3, 2e-3], "cubic": [1e-3, 0.0, 1e-3]}, {}),
    ("gyro_nonlinearity", "gyro", {"quadratic": [0.0, 0.02, 0.0], "cubic": [0.12, 0.08, -0.02]}, {}),
    ("lever_arm", "accel", {"position": [0.03, 0.05, 0.002]}, {}),
]
"""Effect, sensor, the finding's parameters, and what else the phone's effect takes."""


@pytest.mark.parametrize(
    ("effect", "sensor", "values", "more"), ADDED, ids=[f"{i}-{a[0]}" for i, a in enumerate(ADDED)]
)
def test_the_pasted_function_takes_out_what_the_phone_put_in(
    effect: str, sensor: str, values: dict[str, Any], more: dict[str, Any]
) -> None:
    which = Sensor.ACCELEROMETER if sensor == "accel" else Sensor.GYROSCOPE
    moment = Moment(T, FORCE, RATE, RATE_DOT, WARMTH, np.zeros(N))
    made = msgspec.convert({"name": effect, **values, **more}, type=EFFECTS[effect])
    circumstances = Circumstances(RATE_HZ, None, np.random.default_rng(0))  # type: ignore[arg-type]
    term = made.output_term(which, circumstances) or made.input_term(circumstances)
    assert term is not None
    added = np.broadcast_to(term(moment), (N, 3))
    raw = {"accel": FORCE.copy(), "gyro": RATE.copy()}
    raw[sensor] = raw[sensor] + added
    _, force, rate = pasted(finding(effect, sensor, values))(
        T, REFERENCE_C + WARMTH, raw["accel"], raw["gyro"]
    )
    left = {"accel": force - FORCE, "gyro": rate - RATE}[sensor][2:-2]  # ends: the rate is differenced
    assert np.sqrt(np.mean(left**2)) < 0.01 * np.sqrt(np.mean(added**2))


def test_a_settling_that_counts_from_the_settled_bias_is_taken_out_from_there() -> None:
    values = {"amplitude": [0.05, 0.02, -0.03], "tau_s": 15.0}
    found = finding("accel_warmup", "accel", values, reference={"settled": 1.0})
    added = -np.outer(np.exp(-(T - T[0]) / 15.0), values["amplitude"])
    _, force, _ = pasted(found)(T, None, FORCE + added, RATE)
    np.testing.assert_allclose(force, FORCE, atol=1e-9)


def test_constants_in_the_order_that_the_equation_has() -> None:
    bias, scale = np.array([0.1, -0.2, 0.3]), np.diag([1.01, 0.99, 1.02])
    scale[0, 1] = scale[1, 0] = 0.004
    raw = FORCE @ np.linalg.inv(scale).T + bias
    apart = {"scale": np.diag(scale) - 1.0, "misalignment": [scale[0, 1], 0.0, 0.0]}
    found = [finding("accel_bias", "accel", {"bias": bias.tolist()}), finding("accel_scale", "accel", apart)]
    for one in found:
        _, raw, _ = pasted(one)(T, None, raw, RATE)
    np.testing.assert_allclose(raw, FORCE, atol=1e-8)


def test_a_nine_number_scale_of_the_gyroscope() -> None:
    matrix = np.eye(3) + np.arange(9.0).reshape(3, 3) * 1e-3
    found = finding("gyro_scale", "gyro", {"scale": (matrix - np.eye(3)).tolist()})
    _, _, rate = pasted(found)(T, None, FORCE, RATE @ np.linalg.inv(matrix).T)
    np.testing.assert_allclose(rate, RATE, atol=1e-8)


def test_what_only_the_simulation_has_is_taken_out_of_the_simulation() -> None:
    there, none = np.diag([4e-4, -2e-4, 1e-4]), np.full((3, 3), 1e-7)
    found = finding("gyro_g_sensitivity", "gyro", {"matrix": none.tolist()}, relation="superfluous")
    found["simulated"] = {"matrix": {"value": there.tolist(), "unit": "(rad/s)/(m/s^2)"}}
    _, _, rate = pasted(found)(T, None, FORCE, RATE + FORCE @ there.T)
    np.testing.assert_allclose(rate, RATE, atol=1e-9)
    assert "out of the simulation" in code_of(found)


def test_time_is_put_right() -> None:
    _, _, rate = pasted(finding("accel_gyro_time_offset", "timing", {"delay": 0.02}))(
        T, None, FORCE, 2.0 * np.cos(PHASE - 0.02 * PHASE[1] / T[1])
    )
    assert np.abs(rate - RATE)[:-3].max() < 1e-3
    t, *_ = pasted(finding("clock_skew", "timing", {"relative": 1e-3}))(T * 1.001, None, FORCE, RATE)
    np.testing.assert_allclose(t, T, atol=1e-9)


def test_curved_temperature_and_an_unknown_temperature() -> None:
    values = {"slope": [1e-3, 0.0, 0.0], "quadratic": [1e-5, 0.0, 0.0], "cubic": [1e-6, 0.0, 0.0]}
    warm = REFERENCE_C + WARMTH
    added = np.outer(1e-3 * WARMTH + 1e-5 * WARMTH**2 + 1e-6 * WARMTH**3, [1.0, 0.0, 0.0])
    warm[0] = np.nan
    _, force, _ = pasted(finding("accel_bias_temperature", "accel", values))(T, warm, FORCE + added, RATE)
    np.testing.assert_allclose(force[1:], FORCE[1:], atol=1e-9)
    assert np.isfinite(force).all()


def test_a_bias_while_charging_takes_when_it_charged() -> None:
    on, step = (T > 20.0).astype(float), np.array([0.02, 0.0, -0.01])
    found = finding("accel_charging_bias", "accel", {"step": step.tolist()})
    _, force, _ = pasted(found)(T, None, FORCE + np.outer(on, step), RATE, on)
    assert np.abs(force - FORCE).max() < 1e-12


def test_what_is_clipped_becomes_nan_and_nothing_else_changes() -> None:
    found = finding("gyro_saturation", "gyro", {"limit": 1.5})
    _, _, rate = pasted(found)(T, None, FORCE, np.clip(RATE, -1.5, 1.5))
    beyond = np.abs(RATE) >= 1.5
    assert beyond.any() and np.isnan(rate[beyond]).all() and (rate[~beyond] == RATE[~beyond]).all()


def test_a_tone_is_taken_out_while_it_lasts() -> None:
    still = np.tile([0.0, 0.0, 9.8], (N, 1))
    tone = np.outer(np.sin(2.0 * np.pi * 17.0 * T + 0.4) * (T >= 20.0) * (T <= 40.0), [0.0, 0.01, 0.02])
    values = {"frequency": 17.0, "amplitude": [0.0, 0.01, 0.02]}
    found = finding("vibration_tone", "accel", values, where={"t_start": 20.0, "t_end": 40.0})
    _, force, _ = pasted(found)(T, None, still + tone, RATE)
    assert np.abs(force - still).max() < 1e-4


def test_what_no_function_can_take_out_has_an_equation_only() -> None:
    found = to_paste(finding("noise_level", "accel", {"density": [1e-3] * 3}))
    assert found.keys() == {"equation"}
    assert to_paste(finding("unknown", "gyro", {})) == {}
    assert code_of(finding("gyro_g_sensitivity", "gyro", {})) == ""


def test_every_named_effect_and_every_effect_of_the_phone_that_a_diagnosis_finds_has_an_equation() -> None:
    for effect in named_effects():
        assert equation_of(finding(effect.name, effect.sensor, {}))
    for name in CODE:
        effect = name if name in EFFECTS else f"accel_{name}"
        assert equation_of(finding(effect, "accel", {})) or equation_of(finding(f"gyro_{name}", "gyro", {}))
