"""Jumps of gravity's direction that the gyroscope does not see have no name; true turns are silent."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.diagnose import diagnose
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.motion.unseen_tilt import DRIVER, MISSED, unseen_tilt
from stillcal.calib_core.diagnosis.segments.static_bins import cut, overview_of
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.calib_core.diagnosis.test_true_motion import on_foam

RATE, SECONDS, G = 50.0, 200.0, 9.80665


def lying(seed: int, own: float, nudge: float, lasts: float = 0.3, walk: float = 0.0) -> tuple[Samples, ...]:
    """Lie for 200 s. At 60 and 140 s gravity turns by `own` rad about y for the accelerometer, and back.

    nudge: rad, by which the phone tips about x in `lasts` s at 100 s; walk: of the accelerometer's bias,
    m/s^2 per root second.
    """
    rng, t = np.random.default_rng(seed), np.arange(0.0, SECONDS, 1.0 / RATE)
    tipped = nudge * np.clip((t - 100.0) / lasts, 0.0, 1.0)
    about_y = own * ((t >= 60.0) & (t < 140.0))
    up = np.stack(
        [np.sin(about_y), np.sin(tipped), np.sqrt(1.0 - np.sin(about_y) ** 2 - np.sin(tipped) ** 2)]
    )
    noise = 0.01 * rng.normal(size=(t.size, 3))
    force = (
        G * up.T + [0.1, -0.2, 0.05] + noise + walk / RATE**0.5 * np.cumsum(rng.normal(size=noise.shape), 0)
    )
    # The nudge's rate, scale 3 % off: du/dt = u x w.
    rate = (
        np.outer(1.03 * np.gradient(tipped, t), [1.0, 0.0, 0.0]) + 0.01 + 1e-3 * rng.normal(size=(t.size, 3))
    )
    return Samples.checked(Sensor.ACCELEROMETER, t, force), Samples.checked(Sensor.GYROSCOPE, t, rate)


def tilts(force: Samples, rate: Samples, *spoiled: tuple[float, float]) -> Finding | None:
    bins = cut(force, rate)
    return unseen_tilt(overview_of(force, rate), (bins.force_rounding, bins.rate_rounding), G, spoiled)


def test_what_the_accelerometer_alone_shows_is_found() -> None:
    angle = float(np.radians(1.0))
    found = tilts(*lying(1, angle, 0.0))
    assert found is not None and (found.effect, found.where.driver, found.axes) == ("unknown", DRIVER, ["x"])
    assert (found.where.t_start, found.where.t_end) == pytest.approx((60.0, 140.0), abs=1.0)
    assert found.parameters["angle"].value == pytest.approx(angle, rel=0.03)
    assert found.parameters["jumps"].value == 2.0
    low, high = found.parameters["angle"].ci95
    assert low < angle < high


@pytest.mark.parametrize(
    ("along", "pushes", "told"), [(0.0, 2, False), (0.0, 1, True), (0.3, 2, True), (-0.3, 2, True)]
)
def test_what_a_train_pushes_as_it_starts_and_stops_is_no_fault_of_a_sensor(
    along: float, pushes: int, told: bool
) -> None:
    """0.6 m/s^2 for a minute. One push alone, or what is longer or shorter than gravity too, a bias does."""
    force, rate = lying(1, 0.0, 0.0)
    t = force.t
    pushed = ((t >= 60.0) & (t < (140.0 if pushes == 2 else 300.0)))[:, None] * [0.6, 0.0, along]
    found = tilts(Samples.checked(Sensor.ACCELEROMETER, t, force.xyz + pushed), rate)
    assert (found is not None) == told


def test_a_jump_that_no_push_makes_is_told_beside_pushes() -> None:
    """Two of 0.6 m/s^2 across gravity, and a bias that jumps by as much along it besides."""
    force, rate = lying(1, 0.0, 0.0)
    pushed = ((force.t >= 60.0) & (force.t < 100.0))[:, None] * [0.6, 0.0, 0.0]
    pushed = pushed + (force.t >= 150.0)[:, None] * [0.0, 0.5, 0.5]
    found = tilts(Samples.checked(Sensor.ACCELEROMETER, force.t, force.xyz + pushed), rate)
    assert found is not None and (found.axes, "jumps" in found.parameters) == (["y"], False)
    assert found.where.t_start == pytest.approx(150.0, abs=1.0)


@pytest.mark.parametrize(
    ("first", "last", "told"), [(300.0, 700.0, True), (300.0, 400.0, False), (30.0, 970.0, False)]
)
def test_what_pushes_for_longer_than_anything_gets_faster_is_a_bias(
    first: float, last: float, told: bool
) -> None:
    """0.5 m/s^2 for 300 s is 540 km/h. What is off for 30 s at either end may be a push."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 1000.0, 1.0 / 25.0)
    force = [0.0, 0.0, G] + ((t >= first) & (t < last))[:, None] * [0.5, 0.0, 0.0]
    force = Samples.checked(Sensor.ACCELEROMETER, t, force + 0.01 * rng.normal(size=(t.size, 3)))
    rate = Samples.checked(Sensor.GYROSCOPE, t, 1e-3 * rng.normal(size=(t.size, 3)))
    assert (tilts(force, rate) is not None) == told


def test_a_nudge_that_both_see_is_silent() -> None:
    """Quick and slow, on a gyroscope whose scale is 3 % off, beside a bias that walks."""
    for seed, (nudge, lasts, walk) in enumerate([(0.02, 0.1, 0.0), (0.05, 0.5, 3e-3), (0.02, 8.0, 1e-2)]):
        assert tilts(*lying(seed, 0.0, nudge, lasts, walk)) is None
    for seed in (1, 2):
        assert tilts(*on_foam(seed, rests=5)) is None


def test_where_the_gyroscope_turned_in_another_direction_the_accelerometer_is_not_blamed() -> None:
    """Two of the gyroscope's axes are exchanged: it sees as large a turn, about another axis."""
    force, rate = lying(1, 0.0, 0.025, lasts=1.0)
    assert tilts(force, rate) is None
    for order in ([1, 0, 2], [2, 1, 0]):
        assert tilts(force, Samples.checked(Sensor.GYROSCOPE, rate.t, rate.xyz[:, order])) is None


def test_what_the_gyroscope_alone_turns_is_not_the_accelerometers() -> None:
    """Its bias is off for 3 s, by too little to be a motion: gravity stays where it was."""
    force, rate = lying(1, 0.0, 0.0)
    own = rate.xyz.copy()
    own[(rate.t >= 60.0) & (rate.t < 63.0), 0] += 0.002
    assert tilts(force, Samples.checked(Sensor.GYROSCOPE, rate.t, own)) is None


def test_where_the_gyroscope_does_not_measure_nothing_is_said() -> None:
    force, rate = lying(1, 0.02, 0.0)
    assert tilts(force, rate, (55.0, 65.0), (135.0, 145.0)) is None
    held = rate.xyz.copy()
    for jump in (60.0, 140.0):
        rows = np.abs(rate.t - jump) < 5.0
        held[rows] = held[rows][0]
    assert tilts(force, Samples.checked(Sensor.GYROSCOPE, rate.t, held)) is None
    slow = rate[::5]
    assert unseen_tilt(overview_of(force, slow), (None, None), G) is None


def test_the_diagnosis_states_it_once() -> None:
    found = diagnose(*lying(3, 0.02, 0.0)).findings
    assert [(f.effect, f.sensor, f.where.driver) for f in found] == [("unknown", "accel", DRIVER)]
    assert "2 times" in found[0].statement


@pytest.mark.parametrize("told", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_bias_while_charging_is_not_told_as_jumps_besides(told: bool) -> None:
    """It turned gravity by 0.2 degrees at each plug, and was unknown as well. Events come a second late."""
    rng, t = np.random.default_rng(4), np.arange(0.0, 1200.0, 1.0 / RATE)
    plugs = np.array([150.0, 310.0, 500.0, 720.0, 810.0, 1010.0])
    charging = np.searchsorted(plugs, t, side="right") % 2
    force = [0.0, 0.0, G] + np.outer(charging, [0.03, -0.02, 0.02]) + 0.01 * rng.normal(size=(t.size, 3))
    rate = 1e-3 * rng.normal(size=(t.size, 3))
    found = diagnose(
        Samples.checked(Sensor.ACCELEROMETER, t, force),
        Samples.checked(Sensor.GYROSCOPE, t, rate),
        [Charging(s + 1.0, k % 2 == 0) for k, s in enumerate(plugs)] if told else [],
    ).findings
    assert [f.effect for f in found] == ["accel_charging_bias" if told else "unknown"]


def test_a_turn_that_no_bias_makes_is_one_that_the_gyroscope_missed() -> None:
    found = diagnose(*lying(3, 0.3, 0.0)).findings
    assert [(f.effect, f.sensor, f.where.driver) for f in found] == [("unknown", "gyro", MISSED)]
    assert found[0].parameters["angle"].value == pytest.approx(0.3, rel=0.03)
