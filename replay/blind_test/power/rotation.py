"""d' of effects that only rotations show: gravity propagated from rest to rest by the gyroscope.

In each rotation, an error of the rate leaves an error of the attitude at its end; the part about the vertical
cannot be observed. The nine scale and misalignment terms and the bias are absorbed with broad priors.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.power.detectability import GYRO_BIAS
from stillcal.replay.blind_test.world.day import World
from stillcal.replay.blind_test.world.noise import Colour
from stillcal.replay.blind_test.world.turning import rotated

SCALE = 0.1
"""Prior standard deviation of the gyroscope's scale and misalignment."""

LEVEL_RAD = 2e-4
"""Uncertainty of the tilt at either end of a turn after calibration: 2 mm/s^2 of noise and misfit."""


def turn_d_prime(world: World, delta: Array, colour: Colour) -> float:
    """Return d' of an error of the rate, (n, 3) rad/s, over all rotations."""
    errors, variances = [], []
    basis = _nuisances(world)
    for turn in world.turns:
        first, last = np.searchsorted(world.t, turn[:2])
        rows = slice(int(first), int(last) + 1)
        tilt_map = _tilt_map(world, rows, turn)
        errors.append(tilt_map @ np.column_stack([_flat(delta[rows]), *(_flat(b[rows]) for b in basis)]))
        variances += [colour.white**2 / 2.0 * (turn[1] - turn[0]) + 2.0 * LEVEL_RAD**2] * 2
    stacked = np.concatenate(errors)
    free = stacked[:, 1:] * np.array([GYRO_BIAS] * 3 + [SCALE] * 9)
    covariance = np.diag(variances) + free @ free.T
    return float(np.sqrt(stacked[:, 0] @ np.linalg.solve(covariance, stacked[:, 0])))


def _flat(values: Array) -> Array:
    return np.asarray(values.ravel())


def _nuisances(world: World) -> list[Array]:
    eye = np.eye(3)
    constant = [np.broadcast_to(eye[a], world.rate.shape) for a in range(3)]
    return constant + [world.rate[:, b : b + 1] * eye[a] for a in range(3) for b in range(3)]


def _tilt_map(world: World, rows: slice, turn: Array) -> Array:
    """Return the map (2, 3n) from an error of the rate to the tilt error at the turn's end."""
    axis, speed = turn[2:5], world.rate[rows] @ turn[2:5]
    step = float(world.t[1] - world.t[0])
    ahead = np.cumsum(speed[::-1])[::-1] * step  # angle still to turn
    propagated = np.stack([rotated(e, axis, -ahead) for e in np.eye(3)], axis=2)
    up = world.force[min(rows.stop + 1, len(world.force) - 1)]
    _, _, directions = np.linalg.svd(up[None, :])
    return np.asarray(step * np.einsum("kj,nji->kni", directions[1:], propagated).reshape(2, -1))
