"""Against known truth: what a calibration leaves on attitudes it never saw, and whether its intervals hold.

The phone: 40, 30 and 20 mg of bias, 1 % of scale, 0.4 % of cross-axis sensitivity, the noise of a phone's
accelerometer (150 ug/sqrt(Hz), as datasheets give it to a factor of two) with a mild 1/f part (20 ug).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.streams.events import End
from stillcal.replay.phone import Phone, Simulation, draw_rests, load_scenario, simulate
from stillcal.replay.phone.settings import Noise, SensorSettings

G = 9.80665
MG = G / 1000
FORWARD = np.array([[1.01, 0.004, -0.004], [-0.004, 0.99, 0.004], [-0.004, -0.004, 1.01]])
PHONE = Phone(
    accel=SensorSettings(
        rate_hz=50.0,
        bias=(40 * MG, -30 * MG, 20 * MG),
        scale=tuple(map(tuple, FORWARD.tolist())),
        noise=Noise(white=150e-6 * G, flicker=20e-6 * G),
        lsb=4 * G / 32768,
        range=4 * G,
    ),
    gyro=SensorSettings(
        rate_hz=50.0, bias=(0.01, -0.02, 0.005), noise=Noise(white=1e-4, flicker=1e-5), lsb=1e-3
    ),
)


@dataclass(frozen=True)
class Left:
    """What a calibration leaves, in mg over all directions of gravity: mean and largest vector error.

    with_rotation: the mean where the rotation (deg) common to all of them is not taken out; raw: before.
    """

    mean: float
    largest: float
    with_rotation: float
    rotation: float
    raw: float


def left_by(model: SensorModel, forward: np.ndarray, bias: np.ndarray) -> Left:
    """Hold a calibration against true forces in 2000 attitudes.

    Gravity's norm says nothing of a rotation common to all axes: the polar factor of the product of both
    matrices is that rotation.
    """
    up = np.random.default_rng(0).normal(size=(2000, 3))
    true = G * up / np.linalg.norm(up, axis=1, keepdims=True)
    raw = true @ forward.T + bias
    u, _, v = np.linalg.svd(model.scale @ forward)
    rotation, corrected = u @ v, model.apply(raw)

    def off(found: np.ndarray) -> np.ndarray:
        return np.linalg.norm(found - true, axis=1) / MG

    turned = off(corrected @ rotation)
    angle = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    return Left(turned.mean(), turned.max(), off(corrected).mean(), float(angle), off(raw).mean())


BARS = {"continuous": 0.1, "auto": 0.25}
"""Mean vector error in mg that a way of watching may leave."""


@cache
def lived() -> tuple[Simulation, dict[str, Engine]]:
    """Let an engine of each way of watching live the same day, which is simulated once."""
    day = simulate(load_scenario("day"), PHONE, 0)
    engines = {w: Engine(EngineSettings(schedule=ScheduleSettings(watch=w))) for w in BARS}
    for chunk in day.chunks():
        assert chunk.gyroscope is not None
        for engine in engines.values():
            engine.feed(chunk.gyroscope, chunk.accelerometer, *chunk.events)
    for engine in engines.values():
        engine.feed(End(day.duration))
    return day, engines


@pytest.mark.slow
@pytest.mark.parametrize(("watch", "bar"), BARS.items())
def test_a_day_leaves_less_than_a_tenth_of_a_milli_g(
    watch: str, bar: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """The published unaided tools leave 4.4 mg on the same work: as much as the common rotation alone makes.

    Watched without a break, the days of seeds 0 to 5 leave 0.03 to 0.07 mg. By default the sensors are on for
    a twentieth of the time and rests last some seconds: 0.03 to 0.16 mg, more than 0.1 in three days of six,
    because a second calibration, though better, cannot show it on rests held out by more than chance.
    """
    day, engines = lived()
    engine = engines[watch]
    record = engine.state.record
    assert record is not None and record.accelerometer is not None
    assert record.gravity is not None and record.gravity.source == "location"
    truth = day.truth.accelerometer
    left = left_by(record.accelerometer.model, truth.forward, truth.bias)
    on = 100 * engine.ledger.asked_s / day.duration
    with capsys.disabled():
        print(
            f"\n{watch}: sensors on {on:.1f} % of the time; vector error {left.raw:.1f} mg before, mean "
            f"{left.mean:.4f}, largest {left.largest:.4f} mg after, {record.accelerometer.parameters} "
            f"parameters; with the common rotation of {left.rotation:.3f} deg in it: mean "
            f"{left.with_rotation:.2f} mg"
        )
    assert record.accelerometer.parameters == 9
    assert left.mean < bar


def symmetric(forward: np.ndarray) -> np.ndarray:
    """Return the symmetric correction that gives the norms of the true one: (F^-T F^-1)^(1/2)."""
    inverse = np.linalg.inv(forward)
    values, vectors = np.linalg.eigh(inverse.T @ inverse)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)


def some_phone(number: int) -> Phone:
    """Draw a phone: biases of 30 mg, scale errors of 1 %, cross-axis sensitivity of 0.4 %, each normal."""
    rng = np.random.default_rng(number)
    forward = np.eye(3) + rng.normal(0, 0.004, (3, 3)) + np.diag(rng.normal(0, 0.01, 3))
    accel = msgspec.structs.replace(
        PHONE.accel,
        bias=tuple(rng.normal(0, 30 * MG, 3).tolist()),
        scale=tuple(map(tuple, forward.tolist())),
    )
    return msgspec.structs.replace(PHONE, accel=accel)


@pytest.mark.slow
@pytest.mark.parametrize("rests", [16, 40])
def test_intervals_of_500_phones_hold_the_truth(rests: int, capsys: pytest.CaptureFixture[str]) -> None:
    """95 % intervals, 93 to 97 % wanted; the uncertainties declared are of the white noise only.

    A bias that wanders is, while the rests are taken, what it has wandered to: that is what an interval
    speaks of. How often it also holds the bias that the phone had when it was made is printed beside it.
    """
    inside = np.zeros((500, 9), dtype=bool)
    as_made = np.zeros((500, 3), dtype=bool)
    for number in range(500):
        phone = some_phone(number)
        drawn = draw_rests(phone, rests, number, duration_s=(10.0, 60.0))
        fit = accelerometer.fit(drawn.forces, drawn.white_uncertainties, drawn.gravity, parameters=9)
        scale = symmetric(np.asarray(phone.accel.scale))
        bias = np.asarray(phone.accel.bias)
        truth = np.r_[bias + drawn.wander.mean(axis=0), np.diag(scale), scale[np.triu_indices(3, 1)]]
        low, high = fit.interval(0.95).T
        inside[number] = (low <= truth) & (truth <= high)
        as_made[number] = (low[:3] <= bias) & (bias <= high[:3])
    with capsys.disabled():
        print(
            f"\n{rests} rests, 500 phones: {100 * inside.mean():.1f} % of the 95 % intervals hold the truth, "
            f"biases alone {100 * inside[:, :3].mean():.1f} %, of biases as made {100 * as_made.mean():.1f} %"
        )
    assert 0.93 <= inside.mean() <= 0.97
    assert np.all((inside.mean(axis=0) > 0.91) & (inside.mean(axis=0) < 0.99))
