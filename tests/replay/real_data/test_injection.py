"""What is injected into a recording is what its forward equation says, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording
from stillcal.replay.real_data import injection
from stillcal.replay.real_data.injection import DIRECT, SLOW, Injection

RATE = 50.0


@pytest.fixture
def recording() -> Recording:
    rng = np.random.default_rng(0)
    t = np.arange(int(120 * RATE)) / RATE
    turn = 12.0 * np.stack([np.sin(t / 9), np.cos(t / 7), np.sin(t / 5)], axis=1)
    force = turn + 0.01 * rng.standard_normal((t.size, 3))
    rate = 0.5 * turn / 12 + 1e-3 * rng.standard_normal((t.size, 3))
    warm = 25.0 + 3.0 * np.sin(t / 40)
    accelerometer = Samples.checked(Sensor.ACCELEROMETER, t, force, warm)
    return Recording(accelerometer, Samples.checked(Sensor.GYROSCOPE, t, rate), [], Claims(), [])


def of(name: str) -> Injection:
    return next(i for i in (*SLOW, *DIRECT) if i.effect == name)


def test_a_step_is_added_from_its_time_on(recording: Recording) -> None:
    changed, value = injection.injected(recording, of("accel_bias_step"), 1.0, seed=0)
    added = changed.accelerometer.xyz - recording.accelerometer.xyz
    t = recording.accelerometer.t
    after = t - t[0] >= 0.55 * (t[-1] - t[0])
    assert np.allclose(added[after], value) and np.allclose(added[~after], 0.0)
    assert changed.gyroscope is recording.gyroscope


def test_temperature_moves_the_bias_by_the_slope(recording: Recording) -> None:
    changed, slope = injection.injected(recording, of("accel_bias_temperature"), 2.0, seed=0)
    added = changed.accelerometer.xyz - recording.accelerometer.xyz
    warm = recording.accelerometer.temperature
    assert warm is not None
    fitted = np.polyfit(warm, added, 1)[0]
    assert np.allclose(fitted, slope)


def test_the_control_of_a_charging_effect_has_the_same_plug_and_the_same_samples(
    recording: Recording,
) -> None:
    changed, step = injection.injected(recording, of("accel_charging_bias"), 1.0, seed=0)
    control = injection.control(recording, of("accel_charging_bias"))
    assert changed.events == control.events and len(control.events) == 6
    added = changed.accelerometer.xyz - control.accelerometer.xyz
    for event, following in zip(control.events, [*control.events[1:], None], strict=True):
        end = np.inf if following is None else following.t
        inside = (recording.accelerometer.t >= event.t) & (recording.accelerometer.t < end)
        assert np.allclose(added[inside], step * event.on)


@pytest.mark.parametrize("name", [i.effect for i in DIRECT])
def test_direct_effects_grow_with_their_strength(recording: Recording, name: str) -> None:
    def changed(strength: float) -> float:
        after, _ = injection.injected(recording, of(name), strength, seed=3)
        total = 0.0
        for before, now in (
            (recording.accelerometer, after.accelerometer),
            (recording.gyroscope, after.gyroscope),
        ):
            assert before is not None and now is not None
            if len(now) != len(before):
                return float(len(before) - len(now))
            total += float(np.abs(now.xyz - before.xyz).sum() + np.abs(now.t - before.t).sum())
            assert (np.diff(now.t) >= 0).all()
        return total

    strong, weak = (changed(s) for s in (1.0, 1.0 / 3.0))
    assert (strong > weak > 0.0) if name != "bandwidth" else (strong > 0.0 and weak > 0.0)


def test_what_a_recording_lacks_is_not_injected(recording: Recording) -> None:
    alone = Recording(recording.accelerometer, None, [], Claims(), [])
    assert injection.supports(recording, of("gyro_g_sensitivity"))
    assert not injection.supports(alone, of("gyro_g_sensitivity"))
    assert injection.supports(alone, of("accel_bias_step"))


def test_what_is_added_to_values_in_steps_stays_in_steps() -> None:
    """A sensor rounds what it adds; without that, two grids would look like codes that are missing."""
    t = np.arange(2000) / 50.0
    noise = np.random.default_rng(3).normal(0.0, 0.03, (t.size, 3))
    xyz = np.rint((noise + np.array([0.0, 0.0, 9.81])) / 0.0125) * 0.0125
    recording = Recording(Samples.checked(Sensor.ACCELEROMETER, t, xyz), None, [], Claims(), [])
    changed = injection.injected(recording, of("accel_bias_step"), 1.0, seed=1)[0].accelerometer.xyz
    assert not np.array_equal(changed, xyz)
    np.testing.assert_allclose(np.rint(changed / 0.0125) * 0.0125, changed, atol=1e-9)
