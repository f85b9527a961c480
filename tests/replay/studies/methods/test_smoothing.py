"""Rolling mean and median: Table 2's windows, Table 1's claim on real rests, splits, long runs."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillcal.calib_core.codec import packed, unpacked
from stillcal.replay.studies.methods.smoothing import (
    RollingMean,
    RollingState,
    rolling_median,
    window_for_rate,
)

# Grammenos et al. 2018, Table 1: window -> (median variance, averaging variance)
PAPER = {10: (4.6495e-05, 3.4568e-05), 20: (2.6465e-05, 1.8359e-05)}


@pytest.mark.parametrize(
    ("rate", "steps"),
    [
        *[(0.5, 3), (1, 3), (5, 3), (20, 3), (20.5, 3), (21, 5), (50, 5), (79.9, 5), (80, 10)],
        *[(100, 10), (120, 10), (120.1, 20), (200, 20), (400, 20)],
    ],
)
def test_window_follows_table_2(rate, steps):
    assert window_for_rate(rate) == steps


@pytest.mark.parametrize("rate", [0.0, -5.0, float("nan")])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ValueError, match="rate_hz"):
        window_for_rate(rate)


@pytest.mark.parametrize("window", [1, 3, 20])
def test_equals_the_mean_written_out(window):
    x = np.random.default_rng(3).normal(size=(60, 3))
    expected = [x[max(i - window + 1, 0) : i + 1].mean(axis=0) for i in range(60)]
    np.testing.assert_allclose(RollingMean(window).feed(x), expected, atol=1e-15)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 20), st.lists(st.integers(0, 50), max_size=12), st.integers(0, 2**32))
def test_splits_and_saved_states_change_no_bit(window, lengths, seed):
    x = np.random.default_rng(seed).normal(9.8, 0.05, (sum(lengths) + 7, 3))
    whole = RollingMean(window).feed(x)
    rolling, parts, at = RollingMean(window), [], 0
    for n in [*lengths, 7]:
        parts.append(rolling.feed(x[at : at + n]))
        at += n
        rolling = RollingMean(window, unpacked(packed(rolling.state), RollingState))
    assert np.concatenate(parts).tobytes() == whole.tobytes()


def test_no_rounding_builds_up_after_a_huge_value():
    """A cumulative sum loses 1e16's worth of digits for good; a window forgets it."""
    x = np.full((1000, 1), 0.1)
    x[10] = 1e16
    naive = np.cumsum(x, axis=0)
    naive = (naive[5:] - naive[:-5]) / 5
    assert abs(naive[-1, 0] - 0.1) > 1e-3
    assert RollingMean(5).feed(x)[-1, 0] == pytest.approx(0.1, abs=1e-16)


def test_median_of_a_window_longer_than_the_data_is_refused():
    with pytest.raises(ValueError, match="window"):
        rolling_median(np.zeros((3, 3)), 4)


def test_median_equals_the_median_written_out():
    x = np.random.default_rng(1).normal(size=(30, 2))
    expected = [np.median(x[i : i + 7], axis=0) for i in range(24)]
    np.testing.assert_array_equal(rolling_median(x, 7), expected)


def rests_at_full_resolution(data_dir: Path):
    """Norms of the recordings of devices at rest whose sensors resolve their own noise.

    On a coarse sensor the median sticks to one code and its variance says nothing of noise; recordings with
    real motion (above 0.06 m/s^2) are no rests.
    """
    acc = np.load(data_dir / "hhar_still" / "still_accel.npz")["acc"]
    for row in csv.DictReader((data_dir / "hhar_still" / "index.csv").open()):
        first, count = int(row["start"]), int(row["count"])
        xyz = acc[first : first + min(count, 4000)].astype(float)
        codes = min(np.unique(xyz[:, i]).size for i in range(3))
        if codes > 30 and xyz.std(axis=0).max() < 0.06:
            yield np.linalg.norm(xyz, axis=1)[:, None]


def test_table_1_on_real_rests(data_dir):
    """At rest the mean leaves less variance than the median, at 10 and at 20 steps, and 20 less than 10."""
    norms = list(rests_at_full_resolution(data_dir))
    print(f"\n{len(norms)} real rests; variance of the norm, (m/s^2)^2, median over rests")
    print("steps   paper: median   mean   ratio | here: median   mean   ratio")
    ratios = {}
    for steps, (median_paper, mean_paper) in PAPER.items():
        median = np.array([rolling_median(x, steps).var() for x in norms])
        mean = np.array([RollingMean(steps).feed(x)[steps - 1 :].var() for x in norms])
        ratios[steps] = median / mean
        print(
            f"{steps:5d}   {median_paper:.4e} {mean_paper:.4e} {median_paper / mean_paper:.2f} |"
            f" {np.median(median):.4e} {np.median(mean):.4e} {np.median(ratios[steps]):.2f}"
        )
        assert (mean < median).mean() > 0.95
        assert np.median(ratios[steps]) > 1.1
    assert len(norms) >= 60
