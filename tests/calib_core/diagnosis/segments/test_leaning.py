"""What leans the force without a turn makes it longer; what the gyroscope confirms is a tilt and does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.segments.leaning import without_leaning
from tests.support.diagnosis import nulls


def leaning() -> tuple[nulls.Day, np.ndarray]:
    """Return half an hour whose force leans by up to 0.05 rad, and the rates (n, 3) of such a tilt."""
    t = np.arange(1800.0)
    angle = 0.05 * np.clip(np.sin(2.0 * np.pi * t / 360.0), 0.0, None) ** 2
    up = np.stack([np.sin(angle), np.zeros_like(t), np.cos(angle)], axis=1)
    turn = np.cross(np.gradient(up, axis=0), up)
    return nulls.Day(t, np.zeros(t.size, dtype=np.int64), up, 25.0 + 0.0 * t, 0.0 * t), turn


@pytest.mark.parametrize("tilts", [True, False])
def test_a_train_that_brakes_makes_the_force_longer_and_a_tilt_does_not(tilts: bool) -> None:
    """A train pushes sideways by the tangent of the lean, so that the force across is added to gravity."""
    (day, turn), rng = leaning(), np.random.default_rng(1)
    bins = nulls.bins_of(rng, day, "white", gyro_error=turn if tilts else None)
    sideways = np.tan(np.interp(bins.t, day.t, np.arcsin(day.up[:, 0])))
    force = nulls.G * np.stack([sideways, 0.0 * sideways, 1.0 + 0.0 * sideways], axis=1)
    if tilts:
        force /= np.sqrt(1.0 + sideways**2)[:, None]
    bins = replace(bins, force=force + rng.normal(0.0, 1e-4, force.shape))
    length = np.linalg.norm(without_leaning(bins).force, axis=1)
    assert np.ptp(np.linalg.norm(force, axis=1)) > 0.01 or tilts
    assert length == pytest.approx(nulls.G, abs=1.5e-3)


def test_a_phone_that_tilts_evenly_all_through_a_rest_leans_by_no_acceleration() -> None:
    """Its rate is the same in all of the rest, as a bias is; most rests have only the bias."""
    t, rng = np.arange(1800.0), np.random.default_rng(1)
    rest = (t // 300.0).astype(np.int64)
    angle = np.where(rest == 2, 5e-4 * (t - 600.0), np.where(rest == 4, 4e-4 * (t - 1200.0), 0.0))
    up = np.stack([np.sin(angle), np.zeros_like(t), np.cos(angle)], axis=1)
    turn = np.stack([0.0 * t, np.where(rest == 2, -5e-4, np.where(rest == 4, -4e-4, 0.0)), 0.0 * t], axis=1)
    day = nulls.Day(t, rest, up, 25.0 + 0.0 * t, 0.0 * t)
    bins = nulls.bins_of(rng, day, "white", gyro_error=turn + np.array([0.01, -0.02, 0.03]))
    force = nulls.G * bins.force / np.linalg.norm(bins.force, axis=1, keepdims=True)
    length = np.linalg.norm(without_leaning(replace(bins, force=force)).force, axis=1)
    assert length == pytest.approx(nulls.G, abs=1e-3)


@pytest.mark.parametrize(("along", "rests", "kept"), [(0.0, 2, 4), (0.0, 1, 6), (0.3, 2, 6), (-0.3, 2, 6)])
def test_rests_in_which_a_train_pushes_are_none(along: float, rests: int, kept: int) -> None:
    """0.6 m/s^2 in a third of each; a bias that jumps has a part along gravity, and once may be a bias."""
    t, rng = np.arange(1800.0), np.random.default_rng(1)
    rest = (t // 300.0).astype(np.int64)
    day = nulls.Day(t, rest, np.tile([0.0, 0.0, 1.0], (t.size, 1)), 25.0 + 0.0 * t, 0.0 * t)
    pushed = ((t % 300.0 > 200.0) & np.isin(rest, (2, 4)[:rests]))[:, None] * [0.6, 0.0, along]
    bins = nulls.bins_of(rng, day, "white", accel_error=pushed)
    assert np.unique(without_leaning(bins).rest).size == kept


@pytest.mark.parametrize(
    ("what", "kept"), [("lasts", 3), ("drifts", 3), ("follows the plug", 3), ("follows no plug", 2)]
)
def test_a_bias_across_gravity_that_leans_for_long_slowly_or_with_the_charger_pushes_nothing(
    what: str, kept: int
) -> None:
    """0.5 m/s^2 for 250 s is 450 km/h; a train that starts twice in a rest is plugged in at another time."""
    t, rng = np.arange(2700.0), np.random.default_rng(1)
    rest = (t // 900.0).astype(np.int64)
    plugged = (np.abs(t - 1080.0) < 60.0) | (np.abs(t - 1500.0) < 60.0)
    size = {
        "lasts": np.where((rest < 2) & (t % 900.0 > 650.0), 0.5, 0.0),
        "drifts": np.where(rest > 0, 0.25 * np.sin(2.0 * np.pi * t / 600.0), 0.0),
        "follows the plug": 0.3 * plugged,
        "follows no plug": 0.3 * plugged,
    }[what]
    charging = np.roll(plugged, 400 if what == "follows no plug" else 0).astype(np.float64)
    day = nulls.Day(t, rest, np.tile([0.0, 0.0, 1.0], (t.size, 1)), 25.0 + 0.0 * t, charging)
    bins = nulls.bins_of(rng, day, "white", accel_error=size[:, None] * [1.0, 0.0, 0.0])
    assert np.unique(without_leaning(bins).rest).size == kept


def test_a_bias_that_follows_the_plug_is_not_made_as_long_as_gravity() -> None:
    """Of 0.6 m/s^2 across gravity, -0.018 m/s^2 were told along it, and 1 mm/s^2 less across."""
    t, rng = np.arange(1800.0), np.random.default_rng(1)
    plugged = np.abs(t % 450.0 - 200.0) < 60.0
    day = nulls.Day(t, (t // 900.0).astype(np.int64), np.tile([0.0, 0.0, 1.0], (t.size, 1)), 25.0 + 0.0 * t,
                    plugged.astype(np.float64))  # fmt: skip
    bins = nulls.bins_of(rng, day, "white", accel_error=0.6 * plugged[:, None] * [1.0, 0.0, 0.0])
    kept = without_leaning(bins)
    assert kept.charging is not None
    on, off = (kept.force[chosen].mean(axis=0) for chosen in (kept.charging > 0.9, kept.charging < 0.1))
    assert on - off == pytest.approx([0.6, 0.0, 0.0], abs=1e-3)
