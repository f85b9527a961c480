"""The accelerometer's fit against known truth: simulated phones at rest in random attitudes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import polar

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer.fit import AccelerometerSettings
from stillcal.calib_core.errors import NotSupported

G = 9.81
ANYTHING = AccelerometerSettings(
    max_amplification=np.inf, max_norm_sd=np.inf, max_bias=99.0, max_scale_error=0.99, outlier_level=0.0
)


@dataclass
class Phone:
    """Truth by polar decomposition: what gravity can show of the scale is its symmetric factor."""

    scale: NDArray
    rotation: NDArray
    bias: NDArray

    @classmethod
    def random(cls, rng, bias=0.4, scale_error=0.02, cross_axis=0.01):
        full = np.eye(3) + np.diag(rng.uniform(-scale_error, scale_error, 3))
        full += cross_axis * (1 - np.eye(3)) * rng.uniform(-1, 1, (3, 3))
        rotation, symmetric = polar(full)
        return cls(symmetric, rotation, rng.uniform(-bias, bias, 3))

    @property
    def values(self):
        s = self.scale
        return np.r_[self.bias, np.diag(s), s[0, 1], s[0, 2], s[1, 2]]

    def rests(self, rng, n, white, wander, states=None):
        """Raw means with declared uncertainty from `white` and an undeclared wander of each rest."""
        up = rng.normal(size=(n, 3))
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        if states:
            up = up[np.r_[np.arange(states), rng.integers(0, states, n - states)]]
        declared = white * np.exp(rng.uniform(-1, 1, (n, 1))) * np.ones(3)
        truth = G * up @ np.linalg.inv(self.scale).T + self.bias
        return truth + declared * rng.normal(size=(n, 3)) + wander * rng.normal(size=(n, 3)), declared


@pytest.mark.parametrize("n", [12, 20])
def test_converges_from_identity_for_large_errors_always(n):
    """Biases to 2 m/s^2, scale errors to 15 %, cross-axis to 5 %, whatever the attitudes."""
    rng = np.random.default_rng(n)
    for _ in range(200):
        phone = Phone.random(rng, bias=2.0, scale_error=0.15, cross_axis=0.05)
        raw, declared = phone.rests(rng, n, white=1e-3, wander=0.0)
        fit = accelerometer.fit(raw, declared, G, parameters=9, settings=ANYTHING)
        off = np.abs(fit.values - phone.values) / np.sqrt(np.diag(fit.covariance))
        assert off.max() < 8.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n", "states", "white", "wander"),
    [(14, None, 1e-3, 3e-3), (20, None, 3e-3, 0.0), (20, None, 3e-3, 3e-3), (40, 14, 1e-3, 3e-3)],
)
def test_intervals_cover_truth_over_500_phones(n, states, white, wander):
    """Wander of unknown size, none included: 93-97 %, with the sampling error of 500 phones (0.006)."""
    rng = np.random.default_rng(0)
    covered = []
    while len(covered) < 500:
        phone = Phone.random(rng)
        raw, declared = phone.rests(rng, n, white, wander, states)
        try:
            low, high = accelerometer.fit(raw, declared, G, parameters=9).interval(0.95).T
        except NotSupported:
            continue
        covered.append(((low <= phone.values) & (phone.values <= high)).mean())
    assert 0.93 - 0.006 < np.mean(covered) < 0.97 + 0.006


def test_vectors_on_unseen_attitudes_within_their_stated_uncertainty():
    """Calibrated vectors scatter about truth as `uncertainty` says: mean square ratio 1, its sd is 0.05
    (300 phones, three axes, one direction each; Student's t tails of 16 degrees widen it).
    """
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(300):
        phone = Phone.random(rng)
        raw, declared = phone.rests(rng, 30, 1e-3, 3e-3)
        fit = accelerometer.fit(raw, declared, G, parameters=9)
        up = rng.normal(size=3)
        force = G * up / np.linalg.norm(up)
        seen = np.linalg.inv(phone.scale) @ force + phone.bias
        ratios.append((fit.model.apply(seen) - force) / fit.uncertainty(seen))
    assert 0.8 < np.mean(np.square(ratios)) < 1.25


@pytest.mark.parametrize("bad", [1, 2, 3])
def test_bad_rests_are_dropped_and_good_ones_kept(bad):
    rng = np.random.default_rng(11 + bad)
    found = wrong = 0
    for _ in range(30):
        phone = Phone.random(rng)
        raw, declared = phone.rests(rng, 25, 1e-3, 3e-3)
        rows = rng.choice(25, bad, replace=False)
        raw[rows] *= 1.0 + 0.03 * rng.choice([-1.0, 1.0], (bad, 1))
        fit = accelerometer.fit(raw, declared, G, parameters=9)
        dropped = {d.row for d in fit.dropped}
        found += len(dropped & set(rows))
        wrong += len(dropped - set(rows))
        assert "norm is" in fit.dropped[0].reason
        assert fit.used.sum() == 25 - len(dropped)
    assert found >= 0.95 * 30 * bad
    assert wrong <= 0.1 * 30


def test_rest_that_only_support_hangs_on_is_never_dropped():
    """Six attitudes for six parameters: nothing can be spared, so nothing is dropped."""
    faces = G * np.vstack((np.eye(3), -np.eye(3)))
    faces[2] *= 1.05
    raw = np.vstack((faces, faces[:2] + 0.001))
    fit = accelerometer.fit(raw, np.full(raw.shape, 1e-3), G, parameters=6)
    assert not fit.dropped
    assert fit.n_states == 6


def test_what_six_parameters_leave_out_is_no_bad_rest():
    """Cross-axis terms that 6 parameters cannot follow widen their intervals; no rest is blamed for them.

    Among 20 phones one false drop is allowed: the level is 1 % a fit.
    """
    rng = np.random.default_rng(9)
    settings = AccelerometerSettings(max_norm_sd=1.0)
    dropped = 0
    for _ in range(20):
        phone = Phone.random(rng, cross_axis=0.02)
        raw, declared = phone.rests(rng, 25, 1e-3, 1e-3)
        six, nine = (accelerometer.fit(raw, declared, G, parameters=p, settings=settings) for p in (6, 9))
        dropped += len(six.dropped)
        assert six.excess_attitude > 3.0 * nine.excess_attitude
    assert dropped <= 1


def test_attitude_held_often_does_not_outvote_others():
    """One attitude with a lasting error, held 1 or 60 times: the same fit, up to its better mean."""
    rng = np.random.default_rng(2)
    phone = Phone.random(rng)
    raw, _ = phone.rests(rng, 20, 1e-3, 0.0)
    raw[0] *= 1.001
    many = np.vstack((raw, np.repeat(raw[:1], 59, axis=0) + 1e-4 * rng.normal(size=(59, 3))))
    settings = AccelerometerSettings(outlier_level=0.0, attitude_angle=1e-3)
    once = accelerometer.fit(raw, None, G, parameters=9, settings=settings)
    often = accelerometer.fit(many, None, G, parameters=9, settings=settings)
    assert often.n_states == once.n_states == 20
    assert np.abs(often.values - once.values).max() < 0.2 * np.sqrt(np.diag(once.covariance)).max()
    assert often.repeatability == pytest.approx(1e-4, rel=0.3)  # sd of an sd on 59 degrees is 9 %
    assert once.repeatability is None
