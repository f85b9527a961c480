"""The first fit, with what is known of sound phones: from few everyday attitudes, and honest about it."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer.fit import AccelerometerFit
from stillcal.calib_core.accelerometer.observability import sphere
from stillcal.calib_core.accelerometer.prior import SOUND_PHONES
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.rest import ATTITUDE_ANGLE, attitude_labels
from stillcal.replay.phone.activities.resting import drawn_support
from stillcal.replay.phone.motion.attitudes import lying

G = 9.80665
MG = G / 1000
EVERYDAY = {
    "screen_up": 0.3, "screen_down": 0.12, "leaning": 0.14, "stand_landscape": 0.08, "on_long_edge": 0.1,
    "upright": 0.05, "upside_down": 0.03, "cushion": 0.12, "bag": 0.06,
}  # fmt: skip
"""Supports of the simulated day, all of its parts together."""


def phone(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a phone as tests/calib_core/calibration/test_truth.py has them: 30 mg, 1 %, 0.4 %."""
    cross = 0.004 * rng.standard_normal((3, 3)) * (1 - np.eye(3))
    return np.eye(3) + cross + np.diag(0.01 * rng.standard_normal(3)), 30 * MG * rng.standard_normal(3)


def everyday_rests(
    rng: np.random.Generator, forward: np.ndarray, bias: np.ndarray, attitudes: int
) -> np.ndarray:
    """Draw rests as phones lie until so many attitudes are there; the bias wanders by 1 mg about itself."""
    forces = np.empty((0, 3))
    while not len(forces) or attitude_labels(forces, ATTITUDE_ANGLE).max() + 1 < attitudes:
        up = lying(drawn_support(EVERYDAY, rng), rng)[2]
        forces = np.vstack((forces, forward @ (G * up) + bias + MG * rng.standard_normal(3)))
    return forces


def fitted(forces: np.ndarray) -> AccelerometerFit:
    return accelerometer.fit(forces, np.full(forces.shape, 1e-3), G, prior=SOUND_PHONES)


def symmetric(forward: np.ndarray) -> np.ndarray:
    inverse = np.linalg.inv(forward)
    values, vectors = np.linalg.eigh(inverse.T @ inverse)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)


@pytest.mark.slow
@pytest.mark.parametrize("attitudes", [8, 11, 13])
def test_nine_phones_in_ten_are_calibrated_from_everyday_attitudes_and_intervals_hold(
    attitudes: int, capsys: pytest.CaptureFixture[str]
) -> None:
    phones, done, alone, inside, worst = 200, 0, 0, [], []
    for number in range(phones):
        rng = np.random.default_rng([attitudes, number])
        forward, bias = phone(rng)
        forces = everyday_rests(rng, forward, bias, attitudes)
        alone += calibrated_alone(forces)
        try:
            fit = fitted(forces)
        except NotSupported:
            continue
        done += 1
        scale = symmetric(forward)
        truth = np.r_[bias, np.diag(scale), scale[np.triu_indices(3, 1)]]
        low, high = fit.interval().T
        inside.append((low <= truth) & (truth <= high))
        norms = np.linalg.norm(fit.model.apply(G * sphere() @ forward.T + bias), axis=1)
        worst.append(float(np.abs(norms - G).max()))
    with capsys.disabled():
        print(
            f"\n{attitudes} everyday attitudes, {phones} phones: {done} calibrated, {alone} without a prior; "
            f"{100 * np.mean(inside):.1f} % of the 95 % intervals hold the truth; norm off along the worst "
            f"direction by {np.median(worst):.3f} m/s^2 (median), {np.quantile(worst, 0.95):.3f} (95 %)"
        )
    assert done >= 0.9 * phones
    assert np.mean(inside) >= 0.93
    assert np.median(worst) < 0.15  # raw: 0.5 m/s^2


def calibrated_alone(forces: np.ndarray) -> bool:
    """Tell whether rests are fitted without a prior."""
    try:
        accelerometer.fit(forces, np.full(forces.shape, 1e-3), G)
    except NotSupported:
        return False
    return True


def helped(forces: np.ndarray) -> bool:
    """Tell whether rests are fitted with the prior's help."""
    try:
        return fitted(forces).with_prior
    except NotSupported:
        return False


def test_only_where_the_attitudes_do_not_suffice() -> None:
    rng = np.random.default_rng(3)
    forward, bias = phone(rng)
    assert helped(everyday_rests(rng, forward, bias, 9))
    assert not helped(G * sphere(40) @ forward.T + bias)


def test_what_attitudes_do_not_show_is_stated_as_uncertain() -> None:
    up = np.array([[np.sin(a), 0.0, np.cos(a)] for a in np.linspace(0.0, 2 * np.pi, 12, endpoint=False)])
    settings = accelerometer.AccelerometerSettings(max_prior_sd=1.0)
    forces = G * up + np.array([0.2, 0.0, 0.1])
    fit = accelerometer.fit(forces, np.full(forces.shape, 1e-3), G, prior=SOUND_PHONES, settings=settings)
    sd = np.sqrt(np.diag(fit.covariance))
    assert sd[1] > 0.3 and max(sd[0], sd[2]) < 0.01
    assert not helped(forces)  # as uncertain as that is no calibration


@pytest.mark.parametrize("spoil", ["seven attitudes", "scatter", "no sound phone"])
def test_too_few_attitudes_rests_that_disagree_and_strange_phones_are_not_helped(spoil: str) -> None:
    rng = np.random.default_rng(4)
    forward, bias = phone(rng)
    forces = everyday_rests(rng, forward, bias, 7 if spoil == "seven attitudes" else 9)
    if spoil == "scatter":
        forces = forces + 0.4 * rng.standard_normal(forces.shape)
    if spoil == "no sound phone":
        forces = forces @ np.diag([1.25, 1.0, 0.8])
    assert not helped(forces)
