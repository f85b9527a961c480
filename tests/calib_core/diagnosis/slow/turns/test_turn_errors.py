"""Turns that no affine gyroscope explains have no name; sound ones, and a single odd one, are silent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.diagnose import diagnose
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.rotation_alignment import aligned
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.diagnosis.slow.turns.turn_errors import DRIVER, turn_errors
from stillcal.calib_core.diagnosis.slow.turns.turn_residuals import _unforeseen, turn_view
from stillcal.calib_core.streams.samples import Samples
from tests.calib_core.diagnosis.model.test_rotation_alignment import G, day


def scaled(gain: Array) -> tuple[Samples, Samples]:
    """Return the day with a gyroscope whose turn k reads 1 + gain (k,) times its rate."""
    force, spin, _ = day()
    turning = np.linalg.norm(spin.xyz - 0.005, axis=1) > 0.02
    which = np.minimum((spin.t / 29.0).astype(np.int64), gain.size - 1)
    rate = (spin.xyz - 0.005) * (1.0 + gain[which] * turning)[:, None] + 0.005
    return force, replace(spin, xyz=rate)


def found(force: Samples, gyroscope: Samples) -> Finding | None:
    bins = cut(force, gyroscope)
    return turn_errors(aligned(gyroscope, bins, G), bins, G)


def test_turns_with_a_gain_each_are_found() -> None:
    gain = 0.04 * np.random.default_rng(3).normal(size=40)
    stated = found(*scaled(gain))
    assert stated is not None and (stated.effect, stated.sensor, stated.where.driver) == (
        "unknown",
        "gyro",
        DRIVER,
    )
    low, high = stated.parameters["part_of_angle"].ci95
    # Across gravity, two of three axes are seen.
    assert low < 0.04 < 2.0 * high


@pytest.mark.parametrize("part", [2, 3])
def test_six_rests_tell_a_dead_axis_and_sound_ones_are_silent(part: int) -> None:
    """With fewer than nine turns a scale is not fitted; what scales as phones have them leave is told."""
    force, spin, _ = day()
    some = (spin.t > 145.0 * part) & (spin.t < 145.0 * part + 29.0 * 6)
    dead = replace(spin, xyz=spin.xyz * [0.0, 1.0, 1.0])
    stated = [found(force[some], one[some]) for one in (spin, dead)]
    assert stated[0] is None and stated[1] is not None


def test_where_the_device_is_turned_in_its_rests_gravity_tells_no_turn() -> None:
    force, spin = scaled(0.04 * np.random.default_rng(3).normal(size=40))
    bins = replace(cut(force, spin), breathes=True)
    assert turn_errors(aligned(spin, bins, G), bins, G) is None


def test_sound_turns_are_silent_and_so_is_one_that_is_off() -> None:
    assert found(*scaled(np.zeros(40))) is None
    assert found(*scaled(2e-3 * np.random.default_rng(4).normal(size=40))) is None
    assert found(*scaled(0.2 * (np.arange(40) == 17))) is None


def test_coarse_samples_of_quick_turns_are_allowed_for() -> None:
    force, spin = scaled(np.zeros(40))
    assert found(force, spin[::12]) is None


def in_packets(spin: Samples, seed: int, lost: float) -> Samples:
    """Return samples with the stamp of their packet of six, which comes late by chance; some are lost."""
    rng = np.random.default_rng(seed)
    packet = np.arange(spin.t.size) // 6
    late = rng.exponential(0.012, packet[-1] + 1)[packet]
    stamps = spin.t[np.minimum(6 * packet + 5, spin.t.size - 1)] + late + 1e-4 * (np.arange(packet.size) % 6)
    kept = (rng.random(packet[-1] + 1) >= lost)[packet]
    return Samples.checked(spin.sensor, stamps[kept], spin.xyz[kept])


def test_turns_whose_samples_came_in_packets_are_silent() -> None:
    force, spin = scaled(np.zeros(40))
    assert found(force, in_packets(spin, 7, 0.02)) is None


def test_turns_whose_samples_came_in_packets_are_as_unsure_as_they_are_off() -> None:
    force, spin = scaled(np.zeros(40))
    late = in_packets(spin, 9, 0.0)
    bins = cut(force, late)
    off = _unforeseen(turn_view(aligned(late, bins, G), bins))
    assert 0.8 < np.sqrt((off**2).mean()) < 1.15, "1.46 if all were as long as their stamps say"


def test_the_diagnosis_states_it() -> None:
    gain = 0.1 * np.random.default_rng(5).normal(size=40)
    stated = diagnose(*(sensor.between(0.0, 430.0) for sensor in scaled(gain))).findings
    assert [(f.effect, f.where.driver) for f in stated] == [("unknown", DRIVER)]
