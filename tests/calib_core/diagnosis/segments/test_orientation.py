"""Nudges and jumps told apart: rests that are one, and poses within a rest."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.segments.static_bins import Bins, cut
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE, SECONDS, G = 50.0, 400.0, 9.80665


def lying(jump: float, nudge: float, shake: float = 0.0) -> Bins:
    """Lie for 400 s; half-way the x bias jumps by `jump` m/s^2 and the phone tips by `nudge` rad about y.

    shake: amplitude in rad/s of a wobble about z of three seconds about that time, which comes back.
    """
    rng = np.random.default_rng(4)
    t = np.arange(int(SECONDS * RATE)) / RATE
    after = t >= SECONDS / 2
    angle = nudge * np.clip((t - SECONDS / 2) / 0.4, 0.0, 1.0)
    force = G * np.stack([np.sin(angle), np.zeros(t.size), np.cos(angle)], axis=1)
    force[:, 0] += jump * after
    away = t - SECONDS / 2
    wobble = shake * np.sin(4.0 * np.pi * away) * (np.abs(away) < 1.5)
    spin = np.stack([np.zeros(t.size), np.gradient(angle, t), wobble], axis=1)
    accelerometer = Samples.checked(Sensor.ACCELEROMETER, t, force + rng.normal(0, 0.01, force.shape))
    gyroscope = Samples.checked(Sensor.GYROSCOPE, t, spin + 0.01 + rng.normal(0, 1e-3, spin.shape))
    return cut(accelerometer, gyroscope)


def test_specific_force_that_jumps_while_nothing_turns_ends_no_rest() -> None:
    for jump in (0.02, 0.3):
        bins = lying(jump, 0.0)
        assert bins.pose is not None
        assert np.unique(bins.rest).size == 1 and np.unique(bins.pose).size == 1


def test_a_nudge_parts_poses() -> None:
    bins = lying(0.0, 2e-3)
    assert bins.pose is not None
    assert np.unique(bins.pose).size >= 2
    assert bins.pose[0] != bins.pose[-1]


def test_a_phone_that_is_tipped_over_rests_anew() -> None:
    assert np.unique(lying(0.0, 0.1).rest).size == 2


def test_a_phone_put_back_a_little_askew_keeps_its_rest_but_not_its_pose() -> None:
    bins = lying(0.0, 3e-4, shake=0.2)
    assert bins.pose is not None
    assert np.unique(bins.rest).size == 1
    assert bins.pose[0] != bins.pose[-1]
