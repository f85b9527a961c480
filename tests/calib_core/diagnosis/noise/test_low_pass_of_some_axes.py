"""A low-pass of one axis or two is told with its axes, and compared with another recording's axis by axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.noise.low_pass import LowPass, Quiet, judged
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.given_simulation import judge_simulation
from stillcal.replay.diagnosis.pair.paired import judge_paired
from stillcal.replay.diagnosis.sample_changes import changes
from stillcal.replay.formats.trace import Recording
from tests.support.diagnosis.turned_pairs import turned

RATE, SECONDS = 100.0, 200


def resting(seed: int, axes: list[int], cutoff: float = 15.0, louder: float = 1.0) -> Samples:
    """Return an accelerometer at rest with a low-pass on some axes. louder: the noise of all but these."""
    white = np.random.default_rng(seed).normal(0.0, 0.02, (int(RATE * SECONDS), 3))
    b, a = butter(2, cutoff, fs=RATE)
    for axis in range(3):
        white[:, axis] = lfilter(b, a, white[:, axis]) if axis in axes else louder * white[:, axis]
    force = np.array([0.3, -0.5, 9.78]) + white
    return Samples(Sensor.ACCELEROMETER, frozen(np.arange(len(white)) / RATE), frozen(force))


def examined(samples: Samples) -> Examination:
    return examine(samples, None, sought=())


def differing(one: Examination, other: Examination) -> Comparison:
    return compare(one, other, ("a.csv", "b.csv"))


def seen(samples: Samples) -> LowPass | None:
    pieces = tuple(
        np.array(samples.xyz[k : k + 1000]) - samples.xyz.mean(axis=0) for k in range(0, 20_000, 1000)
    )
    found = judged(Quiet(pieces, tuple(10.0 * np.arange(len(pieces))), RATE))
    assert found is not None
    return found.low_pass


@pytest.mark.parametrize("axes", [[0, 1], [2], [0], [0, 1, 2]])
def test_the_axes_that_a_low_pass_filters_are_told(axes: list[int]) -> None:
    for seed in range(3):
        found = seen(resting(seed, axes))
        assert found is not None and found.axes == tuple(axes)
        assert abs(found.cutoff.value - 15.0) < 3.0 * found.cutoff.error


def test_noise_that_is_louder_on_one_axis_may_be_added_behind_the_filter() -> None:
    """It hides whether that axis is filtered."""
    found = seen(resting(1, [0, 1], louder=5.0))
    assert found is not None and found.axes == (0, 1, 2)


def test_no_sound_phone_filters_some_axes_alone() -> None:
    """15 Hz of 100 is what several phones have, on all axes."""

    def stated(axes: list[int]) -> list[tuple[str, list[str]]]:
        findings = (s.finding for s in examined(resting(1, axes)).statements)
        return [(f.effect, f.axes) for f in findings]

    assert stated([0, 1, 2]) == []
    assert stated([0, 2]) == [("bandwidth", ["x", "z"])]


def test_low_passes_are_compared_on_the_axes_that_only_one_filters() -> None:
    every, two, same, one = (examined(resting(k, a)) for k, a in enumerate(([0, 1, 2], [0, 1], [0, 1], [2])))

    def told(a: Examination, b: Examination) -> list[tuple[str, list[str]]]:
        return [(d.relation, d.axes) for d in differing(a, b).discrepancies if d.effect == "bandwidth"]

    assert told(two, every) == [("superfluous", ["z"])]
    assert told(every, two) == [("lacking", ["z"])]
    assert told(two, same) == []
    assert told(one, two) == [("lacking", ["z"])]


def test_what_is_put_in_filters_those_axes_alone() -> None:
    every, two = examined(resting(0, [0, 1, 2])), resting(1, [0, 1])
    ((_, change),) = changes(differing(every, examined(two)).discrepancies, 0)
    put_in = change(two)
    assert np.array_equal(put_in.xyz[:, :2], two.xyz[:, :2])
    found = seen(put_in)
    assert found is not None and found.axes == (0, 1, 2)


def test_a_low_pass_of_one_axis_is_told_beside_a_wide_one_of_all() -> None:
    """Parts come with a filter near half the rate: the other axes then are not quite white."""
    every = resting(3, [0, 1, 2], cutoff=42.0)
    filtered = lfilter(*butter(1, 4.0, fs=RATE), every.xyz[:, 1] - every.xyz[:, 1].mean())
    xyz = np.column_stack([every.xyz[:, 0], filtered, every.xyz[:, 2]])
    found = seen(replace(every, xyz=frozen(xyz)))
    assert found is not None and found.axes == (1,)
    assert found.cutoff.value == pytest.approx(4.0, abs=3.0 * found.cutoff.error)


def one_axis_filtered(recording: Recording, cutoff: float) -> Recording:
    """Return a recording whose gyroscope's y passes a first-order low-pass. cutoff: part of the rate."""
    assert recording.gyroscope is not None
    xyz = recording.gyroscope.xyz.copy()
    xyz[:, 1] = lfilter(*butter(1, 2.0 * cutoff), xyz[:, 1])
    return replace(recording, gyroscope=replace(recording.gyroscope, xyz=frozen(xyz)))


def test_what_a_low_pass_of_one_axis_delays_is_no_second_difference() -> None:
    """40 ms on y alone were a delay without a name, or a scale of 2.7 %, x by y, in turns by hand."""
    filtered = one_axis_filtered(turned(1), 0.16)
    found = [judge_simulation(filtered, turned(2, motion=5)), judge_paired(filtered, turned(2))]
    for told in found:
        assert [(f["effect"], f["axes"]) for f in told.answer["findings"]] == [("bandwidth", ["y"])]
