"""Noise that two axes share is no sound sensor's, as long as it is more than real phones have."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.clear_bins import still_bins
from stillcal.calib_core.diagnosis.model.records import Claims, Where
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones, usual
from stillcal.calib_core.diagnosis.noise import noise_level
from stillcal.calib_core.diagnosis.noise.low_pass import Quiet, judged
from stillcal.calib_core.diagnosis.noise.shared_noise import Shared, shared_noise, shared_noise_finding
from stillcal.calib_core.diagnosis.stream import Stream, direct_findings
from stillcal.calib_core.streams.samples import Samples, Sensor

WHERE = Where(0.0, 1.0, (0.0, 1.0), "noise at rest")
NOISE = 0.002
CLAIMS = Claims(accel_noise_density=NOISE / float(np.sqrt(50.0)))


def still(correlation: float, pieces: int = 20) -> Quiet:
    """Return rests in which x has z's noise with a correlation, and y its own."""
    noise = np.random.default_rng(3).normal(size=(pieces, 1000, 3))
    own = np.sqrt(1.0 - correlation**2)
    noise[..., 0] = correlation * noise[..., 2] + own * noise[..., 0]
    return Quiet(tuple(noise * [1.0, 1.0, 1.6]), tuple(10.0 * np.arange(pieces)), 100.0)


def seen_in(rests: Quiet) -> Shared | None:
    """Return what the axes of some rests share."""
    spectrum = judged(rests)
    assert spectrum is not None
    return shared_noise(rests, spectrum)


@pytest.mark.parametrize("correlation", [-0.5, 0.3, 0.8])
def test_noise_that_axes_share_is_measured_and_has_no_name(correlation: float) -> None:
    found = seen_in(still(correlation))
    assert found is not None
    assert found.axes == (0, 2)
    assert found.coefficient.value == pytest.approx(abs(correlation), abs=0.03)
    stated = shared_noise_finding(found, "accel", usual(sound_phones(), "noise_shared", 0.01), WHERE)
    assert stated is not None
    assert (stated.effect, stated.axes) == ("unknown", ["x", "z"])
    assert stated.where.driver == "noise of the other axes"


@pytest.mark.parametrize("claim", [None, 0.01])
@pytest.mark.parametrize("correlation", [0.0, 0.08])
def test_as_little_as_real_phones_have_is_sound(correlation: float, claim: float | None) -> None:
    found = seen_in(still(correlation))
    assert found is not None
    assert shared_noise_finding(found, "accel", usual(sound_phones(), "noise_shared", claim), WHERE) is None


def test_the_level_is_judged_by_what_is_each_axis_own() -> None:
    rng = np.random.default_rng(8)
    noise = rng.normal(size=(20, 1000, 3)) + rng.normal(size=(20, 1000, 1))
    rests = Quiet(tuple(noise), tuple(10.0 * np.arange(20)), 100.0)
    seen, found = judged(rests), seen_in(rests)
    assert seen is not None
    assert found is not None
    levels, claim = noise_level.levels(seen), float(np.sqrt(2.0 / 100.0))

    def told(of: noise_level.Levels) -> list[str]:
        return [f.effect for f in noise_level.noise_findings("accel", of, claim, sound_phones(), WHERE)]

    assert told(levels) == ["noise_level"]
    assert told(levels.less(found.coefficient.value)) == []


def test_two_rests_tell_nothing() -> None:
    assert judged(still(0.9, pieces=2)) is None


def humming(overtones: int, rests: int = 12) -> Stream:
    """Return an accelerometer with the noise claimed, on something that hums at 8.1 Hz and overtones."""
    t = np.arange(0.0, 10.0 * rests, 0.01)
    xyz = np.random.default_rng(2).normal(0.0, NOISE, (t.size, 3))
    xyz[:, 2] += 9.81
    for k in range(1, overtones + 1):
        xyz += 0.02 * np.sin(2.0 * np.pi * 8.1 * k * t + k)[:, None]
    samples = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz))
    return Stream.of("accel", samples, still_bins(samples, None, ()))


@pytest.mark.parametrize("overtones", [1, 5])
def test_a_vibration_is_no_noise_that_axes_share(overtones: int) -> None:
    """Also where it has more overtones than lines are stated."""
    stream = humming(overtones)
    found = direct_findings([stream], CLAIMS, sound_phones())
    assert {f.effect for f in found} == {"vibration_tone"}
    assert stream.levels is not None
    assert stream.levels.values() == pytest.approx(CLAIMS.accel_noise_density, rel=0.03)
