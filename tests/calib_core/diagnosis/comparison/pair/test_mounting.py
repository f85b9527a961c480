"""How another sensor on the body is turned and what its clock says, from the motion that both share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.pair.mounting import Mounting, mounting
from stillcal.calib_core.streams.resample import read_at
from stillcal.replay.diagnosis.pair.readings import readings_of
from stillcal.replay.formats.trace import Recording
from tests.support.diagnosis.one_body import UPRIGHT, Body, sensor, spun

OBLIQUE = Rotation.from_rotvec(np.radians(37.0) * np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0))
QUARTER = Rotation.from_euler("z", 90.0, degrees=True)


def stands(own: Recording, other: Recording) -> Mounting:
    """Return how another recording stands to one."""
    found = mounting(readings_of(own), readings_of(other))
    assert found is not None
    return found


def without_gyroscope(one: Recording) -> Recording:
    """Return a recording of the accelerometer only."""
    return replace(one, gyroscope=None)


@pytest.mark.parametrize("change", [lambda one: one, without_gyroscope])
@pytest.mark.parametrize(
    ("turned", "late", "ppm"),
    [(UPRIGHT, 0.0, 0.0), (QUARTER, 0.13, 0.0), (OBLIQUE, 0.13, 200.0), (OBLIQUE, -5.3, -3000.0)],
)
def test_turn_delay_and_rate_are_found_within_their_errors(
    change: Callable[[Recording], Recording], turned: Rotation, late: float, ppm: float
) -> None:
    own, other = change(sensor(1)), change(sensor(2, turned=turned, late=late, ppm=ppm))
    found = stands(own, other)
    apart = (Rotation.from_matrix(found.rotation) * turned.inv()).magnitude()
    assert found.is_known and found.one_body and apart < 4.0 * found.error < 2e-3
    # At true time t the recording's stamp is t, the other's late + (1 + rate) t.
    delay = late + 1e-6 * ppm * found.clock.middle
    assert abs(found.delay.value - delay) < 4.0 * found.delay.error < 2e-3
    assert abs(found.rate.value - 1e-6 * ppm) < 4.0 * found.rate.error < 2e-5


def test_what_was_undone_reads_what_the_recording_reads() -> None:
    """The other sits 5 cm away, which its force shows in turns."""
    own = sensor(1)
    other = sensor(2, turned=OBLIQUE, late=0.13, ppm=200.0, arm=np.array([0.0, 0.05, 0.0]))
    back = stands(own, other).undone(readings_of(other))
    assert own.gyroscope is not None and back.rate is not None
    for one, two, noise in ((own.gyroscope, back.rate, 1e-3), (own.accelerometer, back.force, 0.01)):
        there = (one.t > 1.0) & (one.t < one.t[-1] - 1.0)
        left = one.xyz[there] - read_at(two, one.t[there]).xyz
        assert (np.std(left, axis=0) < 2.0 * noise).all()


@pytest.mark.parametrize("change", [lambda one: one, without_gyroscope])
def test_another_body_shares_no_motion(change: Callable[[Recording], Recording]) -> None:
    for seed in (5, 6, 7):
        assert not stands(change(sensor(1)), change(sensor(2, body=Body(seed)))).one_body


def test_turns_about_the_vertical_do_not_tell_how_a_sensor_is_turned_and_others_do() -> None:
    for axis, told in (([0.0, 0.0, 1.0], False), ([1.0, 0.0, 0.0], True)):
        found = stands(spun(np.array(axis), 1), spun(np.array(axis), 2, OBLIQUE))
        assert found.one_body and found.is_known is told
    apart = (Rotation.from_matrix(found.rotation) * OBLIQUE.inv()).magnitude()
    assert apart < 2.0 * found.error


def test_where_nothing_moves_nothing_is_told() -> None:
    def still(seed: int) -> Recording:
        one, rng = sensor(seed), np.random.default_rng(seed)
        assert one.gyroscope is not None
        noise = rng.normal(0.0, 1.0, one.accelerometer.xyz.shape)
        return replace(
            one,
            accelerometer=replace(one.accelerometer, xyz=frozen([0.0, 0.0, 9.8] + 0.01 * noise)),
            gyroscope=replace(one.gyroscope, xyz=frozen(1e-3 * noise[::-1])),
        )

    assert mounting(readings_of(still(1)), readings_of(still(2))) is None
