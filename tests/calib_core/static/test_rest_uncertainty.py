"""Are a rest's uncertainties honest? Coverage of the known truth over many rests and kinds of noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.streams.samples import Samples, Sensor

G = 9.80665
RATE = 50


def white(rng, n):
    return rng.normal(size=(n, 3))


def autoregressive(memory):
    def noise(rng, n):
        x = rng.normal(size=(n + 2000, 3)) * np.sqrt(1 - memory**2)
        return lfilter([1.0], [1.0, -memory], x, axis=0)[2000:]

    return noise


def held(times):
    return lambda rng, n: white(rng, n // times + 1).repeat(times, axis=0)[:n]


def white_and_slow(rng, n):
    """White, and a Gauss-Markov wander of 1 s with a quarter of its deviation."""
    return white(rng, n) + 0.25 * autoregressive(np.exp(-1 / RATE))(rng, n)


# noise, and for how long it remembers, s
NOISES = {
    "white": (white, 0.0),
    "AR(1) 0.6": (autoregressive(0.6), 0.04),
    "AR(1) 0.9": (autoregressive(0.9), 0.19),
    "held x3": (held(3), 0.06),
    "white + 1 s wander": (white_and_slow, 1.0),
}


def coverage(noise, duration, rests, seed):
    """Shares of mean forces within 1 and 2 standard uncertainties of the truth, and rests found."""
    rng, off = np.random.default_rng(seed), []
    n = int(duration * RATE)
    t = np.arange(n) / RATE
    for _ in range(rests):
        force = [0.0, 0.0, G] + 0.02 * noise(rng, n)
        detector = StationaryDetector()
        found = detector.feed(Samples.checked(Sensor.ACCELEROMETER, t, force)) + detector.finish()
        for rest in found:
            off += list((rest.specific_force - [0, 0, G]) / rest.force_uncertainty)
    return np.mean(np.abs(off) < 1), np.mean(np.abs(off) < 2), len(off) / 3 / rests


@pytest.mark.slow
@pytest.mark.parametrize("duration", [1.5, 3.0, 10.0, 60.0])
@pytest.mark.parametrize("name", NOISES)
def test_uncertainties_cover_the_truth(name, duration):
    """Never too small: 68 % within one, 95 % within two, less 4 standard errors; nor uselessly large.

    What the noise remembers for longer than 1/25 of the rest, the rest itself cannot show: there, the
    shares only must not fall below what one in two, three in four would be.
    """
    noise, memory = NOISES[name]
    one, two, found = coverage(noise, duration, 150, seed=42)
    visible = duration > 25 * memory
    print(
        f"\n{name}, {duration} s: within 1 u {one:.3f}, within 2 u {two:.3f}, rests {found:.2f}, {visible=}"
    )
    assert found > 0.9
    assert one > (0.683 if visible else 0.5) - 4 * np.sqrt(0.68 * 0.32 / 450)
    assert two > (0.954 if visible else 0.75) - 4 * np.sqrt(0.95 * 0.05 / 450)
    assert one < 0.97


@pytest.mark.parametrize("place", [0.25, 0.4])
@pytest.mark.parametrize("sd", [0.25, 0.3, 0.4])
def test_noise_on_three_codes_is_trusted_as_far_as_it_dithers_wherever_the_mean_lies(sd, place):
    """The rest's variance is largest between two codes and does not show there how small the noise is."""
    rng, found = np.random.default_rng(8), []
    t = np.arange(60 * RATE) / RATE
    for _ in range(20):
        codes = np.round(np.array([100.0, -100.0, 200.0]) + place + rng.normal(0, sd, (t.size, 3)))
        rows = StationaryDetector()
        rests = rows.feed(Samples.checked(Sensor.ACCELEROMETER, t, 0.04 * codes)) + rows.finish()
        found += [
            (r.specific_force / 0.04 - [100, -100, 200] - place, r.force_uncertainty / 0.04) for r in rests
        ]
    off, uncertainty = np.array(found).transpose(1, 0, 2)
    assert np.mean(np.abs(off) < 1.96 * uncertainty) > 0.9
    if sd == 0.4:
        assert np.median(uncertainty) < 0.1  # a third of a step over the root of twelve


@pytest.mark.parametrize("sd", [0.02, 0.1, 0.3, 1.0])
def test_quantised_readings_cover_the_truth(sd):
    """Any place of the truth between two codes, noise of `sd` steps: the mean's own rounding is admitted."""
    rng, lsb, off = np.random.default_rng(5), 0.04, []
    t = np.arange(20 * RATE) / RATE
    for _ in range(200):
        truth = [0.0, 0.0, G] + rng.uniform(-0.5, 0.5, 3) * lsb
        xyz = np.round((truth + rng.normal(0, sd * lsb, (t.size, 3))) / lsb) * lsb
        detector = StationaryDetector()
        rests = detector.feed(Samples.checked(Sensor.ACCELEROMETER, t, xyz)) + detector.finish()
        for r in rests:
            off += list((r.specific_force - truth) / r.force_uncertainty)
    assert len(off) >= 200
    assert np.mean(np.abs(off) < 1) > 0.55
    assert np.mean(np.abs(off) < 2) > 0.95
    if sd >= 0.3:
        assert len(off) == 600
