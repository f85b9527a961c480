"""A dead bit is found with its axes; sound, still, coarse or printed values are silent."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.direct.missing_codes import beside, dead_bits
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.streams.samples import Samples, Sensor

STEP = 0.004788403


def counts(seed: int, moved: float = 1500.0) -> np.ndarray:
    """Forty rests of 400 samples, motion of 100 between them: codes (n, 3)."""
    rng = np.random.default_rng(seed)
    place = np.repeat(rng.uniform(-moved, moved, (40, 3)), 500, axis=0)
    moving = (np.arange(20000) % 500 < 100)[:, None]
    return np.rint(place + moving * rng.normal(0.0, moved / 3, place.shape) + rng.normal(0, 2.5, place.shape))


def said(values: np.ndarray) -> Finding | None:
    return dead_bits(Samples.checked(Sensor.ACCELEROMETER, np.arange(len(values)) / 50.0, values), "accel")


@pytest.mark.parametrize("bit", [1, 3, 5])
@pytest.mark.parametrize("value", [0, 1])
@pytest.mark.parametrize("bias", [0.0, 0.1234567])
def test_a_dead_bit_is_found_whatever_its_value_and_the_bias(bit: int, value: int, bias: float) -> None:
    codes = counts(bit).astype(int)
    codes[:, 2] = codes[:, 2] | (1 << bit) if value else codes[:, 2] & ~(1 << bit)
    found = said(codes * STEP + bias)
    assert found is not None and found.effect == "missing_codes" and found.axes == ["z"]
    assert found.parameters["bit"].value == [float(bit)]


@pytest.mark.parametrize("seed", range(5))
def test_sound_converters_are_silent(seed: int) -> None:
    codes = counts(seed)
    assert said(codes * STEP) is None
    assert said(np.round(codes * STEP, 3)) is None
    assert said(codes @ np.array([[1.0, 0.02, 0.0], [0.0, 0.99, 0.01], [0.01, 0.0, 1.01]]) * STEP) is None


def test_what_hardly_moves_shows_no_bit() -> None:
    """Within a few runs of eight codes a bit may rest by chance."""
    codes = counts(1, moved=20.0).astype(int)
    assert said((codes & ~8) * STEP) is None


@pytest.mark.parametrize("spread", [0.8, 2.0])
def test_noise_at_rest_that_never_is_between_two_runs_shows_a_dead_bit(spread: float) -> None:
    """A phone lies flat: two or three runs of two codes are seen, in 4000 samples."""
    codes = np.rint(np.random.default_rng(3).normal(1.6, spread, (4000, 3))).astype(int)
    assert said(codes * STEP) is None
    codes[:, 1] &= ~2
    found = said(codes * STEP + 0.01)
    assert found is not None and found.axes == ["y"] and found.parameters["bit"].value == [1.0]


def test_a_bias_that_jumps_to_and_fro_shows_no_bit() -> None:
    """It jumps by four codes, forty times."""
    noise = np.rint(np.random.default_rng(3).normal(0.5, 0.2, (4000, 3))).astype(int).clip(0, 1)
    jumps = 4 * (np.arange(4000) // 100 % 2)
    assert said((noise + jumps[:, None]) * STEP) is None


def test_a_dead_zone_that_noise_leaves_to_one_side_is_no_bit() -> None:
    codes = np.rint(np.random.default_rng(3).normal(4.0, 1.2, (4000, 3))).astype(int).clip(0, 8)
    assert said(np.where(codes < 5, 0, codes) * STEP) is None


def test_noise_of_an_axis_with_a_dead_bit_is_not_judged() -> None:
    def heavy(axes: list[int], effect: str = "noise_heavy_tailed") -> Finding | None:
        where, seen = Where(0.0, 1.0, (0.0, 1.0), "noise at rest"), DirectEvidence(99.0)
        return direct_finding(effect, "accel", axes, where, {}, statement="", seen=seen)

    codes = counts(1).astype(int)
    codes[:, 2] &= ~8
    bit = said(codes * STEP)
    assert beside([heavy([2])], bit) == [bit]
    assert beside([heavy([2], "unknown")], bit) == [bit], "outliers of one size are no noise"
    assert len(beside([heavy([0, 2])], bit)) == 2
    assert len(beside([heavy([2])], None)) == 1
