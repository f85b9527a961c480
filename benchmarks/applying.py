"""Item 3: correcting samples, beside one update of a textbook Kalman filter for the same sample."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from peers import peer
from subject import BIAS, FORWARD
from timing import Row, middle, ratio, rounds

from stillcal.calib_core.model import SensorModel

BLOCK, SINGLE = 100_000, 2_000


class Kalman:
    """The textbook filter of a three-axis signal: x a random walk, z = x + noise (Welch and Bishop 2006)."""

    def __init__(self) -> None:
        self.x, self.p = np.zeros(3), np.eye(3)
        self.q, self.r, self.one = 1e-4 * np.eye(3), 1e-2 * np.eye(3), np.eye(3)

    def update(self, z: np.ndarray) -> np.ndarray:
        """Predict, weigh, correct."""
        p = self.p + self.q
        k = p @ np.linalg.inv(p + self.r)
        self.x = self.x + k @ (z - self.x)
        self.p = (self.one - k) @ p
        return self.x


def run(quick: bool) -> Iterator[Row]:
    """Yield the rows of item 3."""
    model = SensorModel.of(np.linalg.inv(FORWARD), BIAS)
    raw = np.random.default_rng(0).normal(0.0, 5.0, (BLOCK, 3))
    singles = list(raw[:SINGLE])
    cases = {
        "block": lambda: model.apply(raw),
        "single": lambda: [model.apply(z) for z in singles],
        "Kalman": lambda: [kalman.update(z) for z in singles],
    }
    kalman = Kalman()
    vqf = peer("vqf")
    if vqf is not None:
        gyro, accel = np.ascontiguousarray(raw * 0.1), np.ascontiguousarray(raw)
        cases["vqf"] = lambda: vqf.VQF(0.02).updateBatch(gyro, accel)
    timed = rounds(cases, 5 if quick else 25)
    update = timed["Kalman"].seconds / SINGLE
    for name, count in (("block", BLOCK), ("single", SINGLE)):
        own = timed[name].seconds / count
        versus = middle(update / own)
        goal, met = "at most a third", versus[0] >= 3.0
        what = f"correcting a sample, {name}"
        nanoseconds, margin = middle(own * 1e9), versus[0] / 3.0
        peer_is = "a Kalman update, numpy"
        yield Row("3", what, nanoseconds, "ns", peer_is, versus, goal, met, margin=margin)
    own = timed["block"]
    if vqf is not None:
        versus, what = ratio(own, timed["vqf"]), "correcting a sample, block"
        yield Row("3", what, own.spread(1e9 / BLOCK), "ns", "vqf's whole filter, C++", versus)
    copied = rounds({"ours": lambda: model.apply(raw), "copy": raw.copy}, 5 if quick else 25, 20)
    yield Row(
        "3",
        "copying a sample, block: the memory's limit",
        copied["copy"].spread(1e9 / BLOCK),
        "ns",
        accuracy=f"correcting takes {1 / ratio(copied['ours'], copied['copy'])[0]:.1f} times as long",
    )
