"""The list of effects: all that a diagnosis names, in phone files, in drawn rests, by sensor."""

from __future__ import annotations

import tomllib
from typing import Any

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone import Phone, draw_rests, dump_phone
from stillcal.replay.phone.effects.base import Effect
from stillcal.replay.phone.effects.other_physics import OtherPhysics
from stillcal.replay.phone.effects.registry import EFFECTS
from tests.support.affected import G3, V, effect, phone

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


@pytest.mark.parametrize("kind", [k for k in EFFECTS.values() if k is not OtherPhysics])
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
