"""Effects whose driver only one of two recordings has: what the other shows of them is not compared."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.coverage import not_logged
from stillcal.calib_core.diagnosis.comparison.linear.wanted import Wanted
from stillcal.calib_core.diagnosis.comparison.quantity import Difference, Part, Quantity, subtract, weighed
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.streams.samples import Samples, Sensor

NAMES = ("rec.csv", "sim.csv")


def lying(*, thermometer: bool) -> Examination:
    """Return ten minutes on a table, examined without a search."""
    t = np.arange(0.0, 600.0, 0.04)
    xyz = np.array([0.0, 0.0, 9.81]) + np.random.default_rng(0).normal(0.0, 0.01, (t.size, 3))
    warm = frozen(20.0 + t / 60.0) if thermometer else None
    samples = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz), warm)
    return examine(samples, None, sought=())


def quantity(effect: str, value: list[float], *, logarithmic: bool = False) -> Quantity:
    k = len(value)
    part = (Part("value", "m/s^2", k),)
    about = np.full(k, 1e-3), np.full(k, -1) if k == 1 else np.arange(k)
    return Quantity(
        effect,
        "accel",
        part,
        np.array(value),
        1e-6 * np.eye(k),
        np.full(k, 1.0),
        *about,
        logarithmic=logarithmic,
    )


def noisier(recorded: float, simulated: float) -> Difference:
    effect = "accel_slow_noise"
    return subtract(*(quantity(effect, [x], logarithmic=True) for x in (recorded, simulated)))


def test_what_a_side_without_a_thermometer_shows_may_be_the_other_sides_slope() -> None:
    warm, blind = lying(thermometer=True), lying(thermometer=False)
    effect = BiasTemperature("accel", 1)
    had = [Wanted("accel", warm.sensors[0].hypothesis(effect, {}), {})]
    missing = not_logged.not_logged((warm, blind), (had, []), NAMES)
    assert missing[0] == [] and [m.reason for m in missing[1]] == [
        "sim.csv: no temperature, so it may be the change of the accelerometer's bias with temperature that"
        " rec.csv shows"
    ]
    assert not_logged.not_logged((warm, warm), (had, []), NAMES) == ([], [])
    shown = [missing[1][0].may_be("accel", e) for e in ("unknown", "accel_warmup", "accel_nonlinearity")]
    assert shown == [True, True, False] and not missing[1][0].may_be("gyro", "unknown")
    simulated, recorded, alike = weighed([noisier(0.0, 1.0), noisier(1.0, 0.0), noisier(0.0, 0.0)], 10)
    kept, hidden = not_logged.without_hidden([simulated, recorded, alike], missing)
    assert kept == [recorded, alike], "more noise in the recording is its own"
    assert [(n.effect, n.reason) for n in hidden] == [("accel_slow_noise", missing[1][0].reason)]
    bias, slope = quantity("accel_bias", [0.1] * 3), quantity("accel_bias_temperature", [0.01, 0.0, 0.0])
    keyed = {(q.effect, "accel"): q for q in (bias, slope)}
    known, unsure = not_logged.with_unknown_temperature([keyed, {("accel_bias", "accel"): bias}], missing)
    assert known["accel_bias", "accel"] is bias
    assert unsure["accel_bias", "accel"].sigma == pytest.approx([np.hypot(1e-3, 0.1), 1e-3, 1e-3])
