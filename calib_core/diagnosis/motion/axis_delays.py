"""Axes of one sensor that are late by different times: one is read after the others, or filtered otherwise.

A delay between the sensors is one number where all axes have it. Here each axis has its own beside it, and
what sets them apart is held against how windows of motion, frequencies and directions disagree about it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, of_chance, vector
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.motion.block_regression import PARTS, Regression
from stillcal.calib_core.maths.integral import running

DRIVER = "rate of turn, axis by axis"
SENSORS = ("accel", "gyro")
ALIKE = 1e-3
"""s, standard deviation by which a sound phone's delays differ: from axis to axis, or while it records."""

SPLIT = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]])
"""What delays of x and y against z (2,) make of all three, which is nothing on the mean."""

UNLIKELY = 0.01
"""Chance of axes being as far apart, below which they have no common delay."""


def axis_columns(t: Array, back: Array, rate: Array, up: Array, gravity: float) -> Array:
    """Return what delays of single axes, less those of the sensor's other ones, do to the force: (n, 3, 4).

    Of the accelerometer's x and y against its z, then of the gyroscope's. back: (n, 3, 3), turns the body to
    where it was when the window began; rate: (n, 3); up: (3,), in the body then.

    A late axis b of the gyroscope turns gravity by the integral of R e_b dw_b/dt: by parts R e_b w_b less
    that of R (w x e_b) w_b. Of all axes together the second is nothing.
    """
    changing = -gravity * np.cross(rate, np.einsum("nji,j->ni", back, up))
    accel = -back * changing[:, None, :]
    along = back * rate[:, None, :]
    swept = np.einsum("nij,nbj->nib", back, np.cross(rate[:, None, :], np.eye(3)[None])) * rate[:, None, :]
    turned = along - running(t, swept)
    gyro = gravity * np.cross(up[None, :, None], turned, axis=1)
    return np.concatenate([accel[:, :, :2] - accel[:, :, 2:], gyro[:, :, :2] - gyro[:, :, 2:]], axis=2)


class AxisDelays:
    """Delays of each sensor's axes about their mean, with how surely they differ.

    delays, errors: (s, 3) s, a sensor a row; log_chance: of axes of one delay being as far apart.
    """

    def __init__(self, sums: Regression, apart: Array, sensors: Sequence[str] = SENSORS) -> None:
        """Estimate them by the last columns of a regression, two a sensor: x and y against z.

        apart: s, how parts disagree about each of these, one standard deviation.
        """
        fitted, covariance, _ = sums.jackknifed(PARTS)
        k = 2 * len(sensors)
        x, within = fitted[-k:], covariance[-k:, -k:] + np.diag(np.square(apart))
        self.sensors = sensors
        self.log_chance = sums.log_chance(x, within)
        self.delays = x.reshape(-1, 2) @ SPLIT.T
        blocks = [within[i : i + 2, i : i + 2] for i in range(0, k, 2)]
        self.errors = np.sqrt(np.array([np.einsum("ij,jk,ik->i", SPLIT, b, SPLIT) for b in blocks]))

    @property
    def differ(self) -> bool:
        """Whether one delay of all axes does not fit."""
        return self.log_chance < float(np.log(UNLIKELY))

    @property
    def longest(self) -> float:
        """The largest delay of an axis against the sensor's mean, s."""
        return float(np.abs(self.delays).max())

    def finding(self, where: Where, least: float = 0.0) -> Finding | None:
        """State delays that differ; least: nats for what shows in any case, whatever it is called."""
        which = int(np.argmax((np.abs(self.delays) / self.errors).max(axis=1)))
        sensor, delays = self.sensors[which], self.delays[which]
        axis = int(np.argmax(np.abs(delays) / self.errors[which]))
        say = (
            f"The {NAME[sensor]}'s axes are late by different times: {AXES[axis]} by"
            f" {delays[axis] * 1e3:.1f} ms more than their mean."
        )
        there = Where(where.t_start, where.t_end, where.band_hz, DRIVER)
        parameters = {"delay": vector(delays, self.errors[which], "s")}
        seen = DirectEvidence(max(of_chance(self.log_chance), least))
        return direct_finding("unknown", sensor, [axis], there, parameters, statement=say, seen=seen)
