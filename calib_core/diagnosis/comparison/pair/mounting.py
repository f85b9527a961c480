"""How another sensor on the same body is turned, and what its clock reads, from the motion that both share.

What turns a body changes the size of both sensors' readings alike, however they are mounted. So the moment
is found first, by the size of what changes; then the rotation (Wahba's problem); then both to a small part of
a sample, by least squares beside scale, misalignment and the arm between the two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.pair.alignment import Readings
from stillcal.calib_core.diagnosis.comparison.pair.clocks import Clock, roughly
from stillcal.calib_core.diagnosis.comparison.pair.delay import (
    LEAST_PIECES,
    MOST_PIECES,
    NOISY,
    PIECES,
    SIZE,
)
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.model.residuals import BIAS_SIZE, MISALIGNMENT_SIZE
from stillcal.calib_core.diagnosis.motion.block_regression import Regression, of_arm
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.maths.rotation import exponential, matrix
from stillcal.calib_core.streams.resample import means_over, read_at
from stillcal.calib_core.streams.samples import Samples, Sensor

STEP = 0.05
"""s over which readings are averaged before they are aligned, or a sample where that is longer. What a hand
or a vehicle does is slower; what shakes faster is not alike at two places of a body."""

SHARED = 0.5
"""Part of the power of the motion that another sensor must read too, in most pieces of it. On one body it is
nearly all, on another one chance."""

ARM = 0.1
"""Prior standard deviation of the distance of two sensors on one body along each axis, m."""

TURNED = 1.0
"""That of the rotation that the first estimate leaves, rad: any."""

DELAYED = 0.1
"""That of the delay that the first estimate leaves, s: its step."""

ALIKE = 1e-3
"""Part of what sets kinds of sensors apart that there is where only one kind is compared: none."""

COMMON = 9
"""Numbers that all kinds of sensors share: rotation, delay, its growth, the force's own delay, the arm."""

BETWEEN = 0.005
"""Part of a sample by which a delay is unsure besides: readings between samples are interpolated."""

LEAST_MEANS = 40
"""Means of readings that are needed: a piece, and some about it."""

KNOWN = 3.0 * MISALIGNMENT_SIZE
"""Error of a rotation from where on it is not known, rad: more than a misalignment takes up."""

ROUNDS = 6
"""Times that the least squares are solved about what was found before."""

OWN = 9
"""Numbers of each kind of sensor: scale, misalignment, and how the accelerometer is turned besides."""

GAINS = np.array([[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]])
"""Rows and columns of what one sensor reads of the other's input besides: it is symmetric."""


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """How another device stands to a recording's.

    rotation: (3, 3), takes its readings to the recording's axes; error: rad, of the axis about which it is
    known worst. clock: of its stamps against the recording's, with delay (in the middle, s) and rate as they
    were measured. force_later: s, by which its accelerometer is late besides. arm: (3,) m, from it to the
    recording's accelerometer. shared: part of the recording's motion that it reads too, of the middle piece.
    """

    rotation: Array
    error: float
    clock: Clock
    delay: Measured
    rate: Measured
    force_later: float
    arm: Array
    shared: float

    @property
    def one_body(self) -> bool:
        """Whether both are shown to be on one body."""
        return self.shared >= SHARED

    @property
    def is_known(self) -> bool:
        """Whether the rotation is known so well that what is left of it is a misalignment."""
        return self.error < KNOWN

    @property
    def angle(self) -> Measured:
        """The angle of the rotation, rad."""
        return Measured(
            float(np.arccos(np.clip((np.trace(self.rotation) - 1.0) / 2.0, -1.0, 1.0))), self.error
        )

    def undone(self, read: Readings) -> Readings:
        """Return what the device read, in the recording's axes, on its clock and at its place."""
        rate = None if read.rate is None else self._turned(read.rate, 0.0)
        force = self._turned(read.force, self.force_later)
        if rate is not None:
            moved = of_arm(force.t, read_at(rate, force.t).xyz) @ self.arm
            force = replace(force, xyz=frozen(force.xyz + moved))
        return Readings(force, rate)

    def _turned(self, samples: Samples, later: float) -> Samples:
        t, xyz = self.clock.back(samples.t - later), samples.xyz @ self.rotation.T
        return replace(samples, t=frozen(t), xyz=frozen(xyz))


@dataclass(frozen=True, slots=True, eq=False)
class _Both:
    """One kind of sensor of both: means of the recording's readings and of the other's, and where they move.

    arm: (n, 3, 3), what a distance between the two does; None for a gyroscope, and where none is there.
    """

    own: Samples
    other: Samples
    pieces: list[slice]
    arm: Array | None = None

    @property
    def is_force(self) -> bool:
        """Whether these are accelerometers."""
        return self.own.sensor is Sensor.ACCELEROMETER

    def read(self, rotation: Array, clock: Clock, later: float) -> Array:
        """Return what the other reads at the recording's moments, in its axes, (n, 3)."""
        at = clock.at(self.own.t) + later * self.is_force
        return np.asarray(read_at(self.other, at).xyz @ rotation.T)

    def changes(self, values: Array) -> list[Array]:
        """Return values (n, ...) in every piece, less their mean there."""
        return [values[p] - values[p].mean(axis=0) for p in self.pieces]


def mounting(own: Readings, other: Readings) -> Mounting | None:
    """Return how another device stands to a recording's, as if it were on one body; None without motion."""
    both = _both(own, other)
    if not any(one.pieces for one in both):
        return None
    clock = roughly([(one.own, one.other) for one in both])
    rotation, later = _wahba(both, clock), 0.0
    for _ in range(ROUNDS):
        x, errors = _refined(both, rotation, clock, later)
        rotation = matrix(exponential(x[:3])) @ rotation
        clock, later = clock.moved(float(x[3]), float(x[4])), later + float(x[5])
    least = BETWEEN * max(float(s.t[1] - s.t[0]) for one in both for s in (one.own, one.other))
    late, drift = (float(np.hypot(e, least)) for e in errors[1:])
    return Mounting(
        rotation,
        float(errors[0]),
        clock,
        Measured(clock.delay, late),
        Measured(clock.rate, drift / clock.half),
        later,
        x[6:9],
        _shared(both, rotation, clock, later),
    )


def shared_as_it_is(own: Readings, other: Readings) -> float | None:
    """Return the part of the motion that another reads at the same stamps and axes; None without motion.

    It is that of the kind of sensor that shares more: one of another range, or with exchanged axes, is a
    difference of that sensor, and the motion is still one.
    """
    unmoved = Clock(float(own.force.t.mean()), float(np.ptp(own.force.t)) / 2.0)
    shared = [_shared([one], np.eye(3), unmoved, 0.0) for one in _both(own, other) if one.pieces]
    return max(shared, default=None)


def _both(own: Readings, other: Readings) -> list[_Both]:
    """Return what both have, the gyroscopes first, at even stamps."""
    out: list[_Both] = []
    for one, two in ((own.rate, other.rate), (own.force, other.force)):
        if one is None or two is None:
            continue
        step = max(STEP, sample_period(one.t), sample_period(two.t))
        means, there = means_over(one, step), means_over(two, step)
        if min(len(means), len(there)) >= LEAST_MEANS:
            arm = of_arm(means.t, read_at(out[0].own, means.t).xyz) if out else None
            out.append(_Both(means, there, _moving(means), arm))
    return out


def _moving(means: Samples) -> list[slice]:
    """Return pieces in which readings change by more than noise, `MOST_PIECES` at most, spread evenly.

    They are as long as lets `LEAST_PIECES` of them move; none where too little moves.
    """
    for length in PIECES:
        n = max(round(length / float(means.t[1] - means.t[0])), 8)
        moving = [p for i in range(0, len(means) - n + 1, n) if _moves(means.xyz[(p := slice(i, i + n))])]
        if len(moving) >= LEAST_PIECES:
            return moving[:: -(-len(moving) // MOST_PIECES)]
    return []


def _moves(values: Array) -> bool:
    """Whether values (n, 3) change by more than white noise does.

    That has twice its variance in first differences and 70 times in fourth ones; motion has next to none.
    """
    power = float((np.diff(values, axis=0) ** 2).mean())
    return float((np.diff(values, 4, axis=0) ** 2).mean()) / 35.0 < NOISY * power


def _wahba(both: list[_Both], clock: Clock) -> Array:
    """Return the rotation (3, 3) that takes the other's readings to the recording's best (Wahba's problem).

    Solved by singular values (Markley, J. Astronaut. Sci. 36, 1988). Each kind of sensor counts alike, and
    gravity's mean direction as much: turns about one axis do not tell how that axis is turned about.
    """
    total = np.zeros((3, 3))
    for one in both:
        read = one.read(np.eye(3), clock, 0.0)
        pairs = [(one.own.xyz.mean(axis=0)[None], read.mean(axis=0)[None])] if one.is_force else []
        if one.pieces:
            pairs.append((np.concatenate(one.changes(one.own.xyz)), np.concatenate(one.changes(read))))
        for a, b in pairs:
            total += a.T @ b / (np.linalg.norm(a) * np.linalg.norm(b) + 1e-300)
    u, _, v = np.linalg.svd(total)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(v)]) @ v)


def _refined(both: list[_Both], rotation: Array, clock: Clock, later: float) -> tuple[Array, Array]:
    """Return what to add to rotation (3), delay, drift and the force's own delay, and the arm (3): (9,).

    With the errors of the rotation about its worst axis, of delay and of drift, (3,). Least squares beside
    scale and misalignment, under priors. The errors are those of pieces which scatter as they do. That of the
    rotation is at least what both together turn about other axes: noise alone, which the other's readings
    have too, would seem to tell it.
    """
    apart = SIZE if len(both) > 1 else SIZE * ALIKE
    sizes = np.array(
        [*[TURNED] * 3, DELAYED, DELAYED, apart, *[ARM] * 3, *[MISALIGNMENT_SIZE] * OWN * len(both)]
    )
    if len(both) == 1:
        sizes[-3:] *= ALIKE
    information, target = np.diag(sizes**-2.0), np.zeros(sizes.size)
    target[5] = -later / apart**2
    spread, turned, sums_of = information.copy(), information[:3, :3].copy(), []
    for i, one in enumerate(both):
        read = one.read(rotation, clock, later)
        left = one.own.xyz - read
        if one.is_force:
            lean, weight = -_crossed(read.mean(axis=0)[None])[0], 0.5 / BIAS_SIZE**2
            for each in (information, spread, turned):
                each[:3, :3] += weight * lean.T @ lean
            target[:3] += weight * lean.T @ left.mean(axis=0)
        if not one.pieces:
            continue
        columns = _columns(one, read, clock, sizes.size, COMMON + OWN * i)
        sums = Regression.of(one.changes(columns), one.changes(left))
        scale = float(sums.power.sum() / (3.0 * sums.count.sum())) + 1e-300
        sums_of.append((sums, scale))
        information += sums.information.sum(axis=0) / scale
        target += sums.target.sum(axis=0) / scale
        alike = np.concatenate(one.changes(one.own.xyz)).T @ np.concatenate(one.changes(read))
        turned += (np.trace(alike) * np.eye(3) - (alike + alike.T) / 2.0) / scale
    x = np.linalg.solve(information, target)
    for sums, scale in sums_of:
        pulls = (sums.target - sums.information @ x) / scale
        spread += pulls.T @ pulls
    inverse = np.linalg.inv(information)
    covariance = inverse @ spread @ inverse
    scattered = float(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    told = 1.0 / max(float(np.linalg.eigvalsh(turned)[0]), TURNED**-2.0)
    variances: Array = np.array([max(scattered, told), covariance[3, 3], covariance[4, 4]])
    return np.asarray(x[:COMMON], dtype=np.float64), np.sqrt(variances)


def _columns(one: _Both, read: Array, clock: Clock, count: int, first: int) -> Array:
    """Return what the parameters do to the recording's readings, (n, 3, count); `first`: of own gains."""
    t = one.own.t
    out = np.zeros((t.size, 3, count))
    late = np.gradient(read, t, axis=0)
    out[:, :, :3] = -_crossed(read)
    out[:, :, 3] = late
    out[:, :, 4] = late * ((t - clock.middle) / clock.half)[:, None]
    if one.is_force:
        out[:, :, 5] = late
        out[:, :, first + len(GAINS) : first + OWN] = -_crossed(read)
    if one.arm is not None:
        out[:, :, 6:COMMON] = one.arm
    for j, (a, b) in enumerate(GAINS):
        out[:, a, first + j] = read[:, b]
        out[:, b, first + j] = read[:, a]
    return out


def _crossed(v: Array) -> Array:
    """Return the matrices (n, 3, 3) of v x."""
    return np.asarray(np.cross(v[:, None, :], np.eye(3)).swapaxes(1, 2))


def _shared(both: list[_Both], rotation: Array, clock: Clock, later: float) -> float:
    """Return the part of the motion's power that the other reads too, of the middle piece."""
    one = next(b for b in both if b.pieces)
    left = one.own.xyz - one.read(rotation, clock, later)
    power = [float((x**2).sum()) for x in one.changes(one.own.xyz)]
    rest = [float((x**2).sum()) for x in one.changes(left)]
    return float(np.median([1.0 - r / p for r, p in zip(rest, power, strict=True)]))
