"""The noise floor: by octaves of rate, the lowest level that enough windows share, learnt and forgotten."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.static.noise_floor import Floor, counted, lowest_cluster, rate_class, renewed
from stillcal.calib_core.static.settings import DetectorSettings

SETTINGS = DetectorSettings()
BIN = 2.0**0.25  # a quarter of an octave


def middle(number):
    """Return the spread in the middle of a bin: quarters of octaves from 2^-18 on."""
    return 2.0 ** ((number + 0.5) / 4 - 18)


def learnt(*groups, rate=50.0, settings=SETTINGS, floor=None):
    """Learn groups of (windows, spread) in one epoch; return the floor."""
    floor = floor or Floor()
    for windows, spread in groups:
        floor = counted(floor, rate_class(np.full(windows, rate)), np.full(windows, spread))
    return renewed(floor, settings)


def level(floor, rate=50.0):
    return float(floor.level[rate_class(np.array([rate]))[0]])


@pytest.mark.parametrize(
    ("rate", "octave"),
    [
        (0.1, 0),
        (2.0, 0),
        (3.999, 0),
        (4.0, 1),
        (7.999, 1),
        (8.0, 2),
        (50.0, 4),
        (511.9, 7),
        (512.0, 8),
        (9e9, 8),
    ],
)
def test_rates_are_sorted_into_octaves_from_2_hz_to_512_hz(rate, octave):
    assert rate_class(np.array([rate])).tolist() == [octave]


@pytest.mark.parametrize("spread", [1e-5, 3.3e-4, 0.002, 0.02, 0.7, 12.0])
def test_a_level_that_windows_share_is_found_to_half_a_bin(spread):
    assert abs(np.log(level(learnt((20, spread))) / spread)) <= np.log(BIN) / 2 + 1e-12


def test_the_ends_of_the_histogram_take_what_lies_beyond():
    assert level(learnt((20, 1e-9))) == pytest.approx(middle(0))
    assert level(learnt((20, 2.0**-18))) == pytest.approx(middle(0))
    assert level(learnt((20, 2.0**-18 * BIN * 1.001))) == pytest.approx(middle(1))
    assert level(learnt((20, 63.9))) == pytest.approx(middle(95))
    assert level(learnt((20, 1e4))) == pytest.approx(middle(95))


def test_each_octave_of_rate_has_its_own_level():
    floor = learnt((20, 0.01), rate=25.0)
    floor = learnt((20, 0.04), rate=200.0, floor=floor)
    assert level(floor, 25.0) == pytest.approx(0.01, rel=0.1)
    assert level(floor, 30.0) == level(floor, 25.0)
    assert level(floor, 200.0) == pytest.approx(0.04, rel=0.1)
    assert level(floor, 50.0) == level(floor, 100.0) == np.inf


def test_nothing_is_used_before_it_is_renewed_and_no_spread_is_no_window():
    fresh = counted(Floor(), rate_class(np.full(20, 50.0)), np.full(20, 0.02))
    assert level(fresh) == np.inf
    assert fresh.fresh.sum() == 20 and fresh.past.sum() == 0
    same = counted(fresh, rate_class(np.full(5, 50.0)), np.zeros(5))
    assert same is fresh
    some = counted(Floor(), rate_class(np.full(3, 50.0)), np.array([0.0, 0.02, 0.02]))
    assert some.fresh.sum() == 2
    nothing = Floor()
    assert renewed(nothing, SETTINGS) is nothing


def test_what_was_learnt_is_let_in_once():
    floor = learnt((20, 0.02))
    assert floor.past.sum() == 20 and floor.fresh.sum() == 0


def test_half_is_forgotten_by_a_half_life_of_windows_of_the_same_rate():
    """At half a second a window and a half-life of 60 s, 240 windows leave a quarter; other rates stay."""
    settings = DetectorSettings(half_life_s=60.0)
    floor = learnt((64, 0.02), settings=settings)
    floor = learnt((10, 0.02), rate=200.0, settings=settings, floor=floor)
    assert floor.past[4].sum() == pytest.approx(64)
    floor = learnt((240, 0.02), settings=settings, floor=floor)
    assert floor.past[4].sum() == pytest.approx(16 + 240)
    assert floor.past[6].sum() == pytest.approx(10)


def test_a_level_that_is_not_seen_again_is_forgotten():
    settings = DetectorSettings(half_life_s=60.0)
    floor = learnt((40, 0.01), settings=settings)
    for _ in range(4):
        floor = learnt((120, 0.08), settings=settings, floor=floor)
    assert level(floor) == pytest.approx(0.08, rel=0.1)


@pytest.mark.parametrize(("windows", "known"), [(7, False), (8, True)])
def test_eight_windows_make_a_level(windows, known):
    assert (level(learnt((windows, 0.02))) < np.inf) == known


@pytest.mark.parametrize(("quiet", "known"), [(20, False), (21, True)])
def test_a_hundredth_of_all_windows_makes_a_level(quiet, known):
    """Beside 2000 loud windows: 1 % of 2020 is 20.2."""
    found = level(learnt((quiet, 0.01), (2000, 1.0)))
    assert found == pytest.approx(0.01 if known else 1.0, rel=0.1)


def test_the_lowest_level_is_the_floor_however_many_are_louder():
    assert level(learnt((30, 0.01), (1000, 0.1), (500, 1.0))) == pytest.approx(0.01, rel=0.1)


def histogram(**counts):
    out = np.zeros(96)
    for name, count in counts.items():
        out[int(name[1:])] = count
    return out


@pytest.mark.parametrize(("bins", "known"), [((40, 41, 42, 43), True), ((40, 41, 42, 44), False)])
def test_windows_within_one_octave_count_together(bins, known):
    counts = np.zeros(96)
    counts[list(bins)] = 2
    assert (lowest_cluster(counts, SETTINGS) < np.inf) == known


def test_the_level_is_the_weighted_middle_of_the_peak_and_two_bins_beside_it():
    assert lowest_cluster(histogram(b40=1, b41=2, b42=9, b43=2, b44=1), SETTINGS) == pytest.approx(middle(42))
    lopsided = lowest_cluster(histogram(b39=3, b40=4, b42=8, b44=2, b45=7), SETTINGS)
    assert lopsided == pytest.approx(middle((40 * 4 + 42 * 8 + 44 * 2) / 14))


def test_the_peak_is_sought_in_the_first_full_octave_and_the_next():
    """The first octave with eight windows begins at bin 40; bins 40 to 46 belong to one cluster."""
    assert lowest_cluster(histogram(b40=4, b43=4, b46=50), SETTINGS) == pytest.approx(middle(46), rel=0.05)
    apart = lowest_cluster(histogram(b40=4, b43=4, b47=50), SETTINGS)
    assert apart == pytest.approx(middle(40), rel=0.05)


def test_a_peak_at_either_end_is_cut_there():
    assert lowest_cluster(histogram(b0=7), SETTINGS) == np.inf
    assert lowest_cluster(histogram(b0=8), SETTINGS) == pytest.approx(middle(0))
    assert lowest_cluster(histogram(b0=8, b1=4), SETTINGS) == pytest.approx(middle(4 / 12))
    assert lowest_cluster(histogram(b94=4, b95=8), SETTINGS) == pytest.approx(middle((94 * 4 + 95 * 8) / 12))
    assert lowest_cluster(np.zeros(96), SETTINGS) == np.inf
