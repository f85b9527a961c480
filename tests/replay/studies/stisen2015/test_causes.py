"""Each cause of a difference that was tried, where it is known whether it is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.replay.studies.claim import Verdict
from stillcal.replay.studies.har.data import Windows
from stillcal.replay.studies.har.features import BINS, FAMILIES, time_features, without_counts
from stillcal.replay.studies.har.scoring import LEARNERS
from stillcal.replay.studies.stisen2015 import families, gyroscope, heterogeneity
from stillcal.replay.studies.stisen2015.modes.rows import Rows, other_windows
from stillcal.replay.studies.stisen2015.recorded import METHODS, by_rate
from stillcal.replay.studies.stisen2015.remedies import causes as remedy_causes

RNG = np.random.default_rng(0)


def test_features_that_count_by_the_sample_are_left_out_and_no_others() -> None:
    """The same wave sampled twice as fast: what stays the same is kept, what halves is not."""
    t = np.arange(200) / 100.0
    wave = 9.8 + np.stack([np.sin(2 * np.pi * f * t) for f in (5.3, 6.1, 6.7)], axis=1)
    fast, slow = (time_features(w[None])[0] for w in (wave, wave[::2]))
    ratio = slow / fast
    counted = (ratio > 1.7) & (ratio < 2.3)
    assert counted.sum() == 8
    kept = without_counts(fast[None])[0]
    assert kept.size == fast.size - 8
    assert kept == pytest.approx(fast[~counted])


def a_score(lost_watch: float, lost_phone: float, by_rate: float = 0.0) -> families.Scores:
    """Return F1 of 0.9 throughout, less what all heterogeneities cost two watches and two phones."""
    shape = (len(FAMILIES), len(LEARNERS), len(families.COLUMNS), 4, families.FOLDS)
    values = np.full(shape, 0.9) - 0.1 * np.arange(len(FAMILIES))[:, None, None, None, None]
    values = values - 0.01 * np.arange(len(LEARNERS))[:, None, None, None]
    column = families.COLUMNS.index("all")
    values[:, :, column, :2] -= lost_watch
    values[:, :, column, 2:] -= lost_phone
    uncounted = np.full((len(LEARNERS), len(families.UNCOUNTED), 4, families.FOLDS), 0.9)
    uncounted[:, families.UNCOUNTED.index("rate")] -= by_rate
    return families.Scores(values, values[1], np.zeros((3, len(families.COLUMNS))), uncounted)


def test_watches_are_held_against_phones() -> None:
    alike, level, wrist = heterogeneity._watches(a_score(0.3, 0.1), [True, True, False, False], "data")
    assert alike.verdict is Verdict.UNTESTED  # the same motion in both ranks alike by construction
    assert "watches lose -30.0, phones -10.0; apart -20.0" in level.ours
    assert (level.verdict, wrist.verdict) == (Verdict.OPEN, Verdict.UNTESTED)


def interpolated(**cells: tuple[float, float]) -> families.Scores:
    """Return F1 of frequency features of 0.9, less what a kind costs as recorded and interpolated."""
    names = (*families.COLUMNS, *families.ONLY_FREQUENCY)
    frequency = np.full((len(LEARNERS), len(names), 4, families.FOLDS), 0.9)
    for name, lost in cells.items():
        for suffix, points in zip(("", ", interpolated"), lost, strict=True):
            frequency[:, names.index(name.replace("_", " ") + suffix)] -= points
    return replace(a_score(0.0, 0.0), frequency=frequency)


MENDED, LEFT = (0.04, 0.01), (0.04, 0.03)
"""What interpolation gives back three quarters of, and a quarter."""


@pytest.mark.parametrize(
    "rate, uneven, verdict",
    [
        (MENDED, LEFT, Verdict.REPRODUCED),
        (MENDED, MENDED, Verdict.DIFFERS),
        (LEFT, LEFT, Verdict.DIFFERS),
        (LEFT, MENDED, Verdict.DIFFERS),
    ],
)
def test_interpolation_must_mend_rates_and_not_unevenness(
    rate: tuple[float, float], uneven: tuple[float, float], verdict: Verdict
) -> None:
    """Whatever errors and all together do."""
    found = interpolated(rate=rate, uneven=uneven, errors=(0.1, 0.1), all=(0.2, 0.1))
    assert heterogeneity._uneven(found, "data").verdict is verdict


@pytest.mark.parametrize(
    "errors, both, shown", [(0.06, MENDED, True), (0.04, MENDED, False), (0.06, LEFT, False)]
)
def test_what_interpolation_leaves_is_the_errors_where_they_are_half_of_it(
    errors: float, both: tuple[float, float], shown: bool
) -> None:
    cells = {"rate": MENDED, "uneven": MENDED, "rate_and_uneven": both, "errors": (errors, errors)}
    cause = heterogeneity._uneven(interpolated(**cells, all=(0.2, 0.1)), "data").cause
    assert cause is not None
    assert cause.shown is shown


def test_the_advice_on_families_is_judged_family_by_family() -> None:
    found = a_score(0.0, 0.0)
    column = families.COLUMNS.index("all")
    for lost, verdicts in (
        ((0.05, 0.10, 0.01), (Verdict.REPRODUCED, Verdict.REPRODUCED)),
        ((0.12, 0.10, 0.01), (Verdict.REPRODUCED, Verdict.DIFFERS)),
        ((0.05, 0.10, 0.06), (Verdict.DIFFERS, Verdict.REPRODUCED)),
    ):
        values = found.values.copy()
        values[:, :, column] -= np.array(lost)[:, None, None, None]
        claims = heterogeneity._recommended(replace(found, values=values), "data")
        assert tuple(claim.verdict for claim in claims) == verdicts


def test_what_uncounted_features_lose_is_of_their_own_column() -> None:
    found = a_score(0.0, 0.0, by_rate=0.2)
    assert found.without_counts("rate") == pytest.approx(-20.0)
    assert found.without_counts("errors") == pytest.approx(0.0)


def test_devices_are_grouped_by_the_nearest_rate_and_the_widest_cluster_is_named() -> None:
    rates = [39.0, 197.0, 99.0, 52.0]
    device = np.repeat(np.arange(4), 3)
    groups = by_rate(device, rates)
    assert [int(g) for g in groups[::3]] == [1, 3, 2, 1]
    zeros = np.zeros(12, dtype=np.intp)
    rows = Rows({}, zeros, zeros, zeros, device, zeros, np.array([0, 0, 1, 1])[device])
    assert remedy_causes._most_mixed(rows, np.array(rates)) == (39.0, 197.0)
    assert remedy_causes._most_mixed(replace(rows, cluster=device), np.array(rates))[1] < 198.0


def some_scores(*means: float) -> gyroscope.Scores:
    """Return F1 of these means by sensor, percent, in ten folds that scatter a little."""
    noise = 0.1 * np.random.default_rng(1).normal(size=10)
    f1 = np.array(means)[:, None, None, None] + noise * np.ones((1, len(FAMILIES), len(LEARNERS), 1))
    n = 3000  # a hundred windows of each of thirty people, as large a share of them judged rightly
    right = (np.arange(n) // 30 + 0.5)[None, :] < np.array(means)[:, None]
    every = np.broadcast_to(right[:, None, None], (len(means), len(FAMILIES), len(LEARNERS), n))
    return gyroscope.Scores(f1, every, np.arange(n) % 30)


@pytest.mark.parametrize("both, good", [(71.0, False), (81.0, True), (94.0, False)])
def test_both_sensors_must_be_ahead_by_people_and_by_little(both: float, good: bool) -> None:
    """Of each person's windows 80 % are judged rightly; with both sensors 71, 81 or 94 %."""
    whole = some_scores(79.9, 60.0, both)
    without = {name: (some_scores(65.0), whole) for name in ("six activities", "in motion")}
    fusion = gyroscope._claims(whole, whole, without, whole)[2]
    assert (fusion.verdict is Verdict.REPRODUCED) is good


def test_sensors_are_held_against_each_other_by_recogniser() -> None:
    """One recogniser is better by far: it is one of twelve, however many windows there are."""
    whole = some_scores(80.0, 80.0, 80.0)
    right = whole.right.copy()
    right[0, 0, 0], right[1, 0, 0] = True, False
    whole = replace(whole, right=right)
    without = {name: (some_scores(65.0), some_scores(80.0, 79.0)) for name in ("six activities", "in motion")}
    order = gyroscope._claims(whole, whole, without, whole)[0]
    assert "better in 1, worse in 0 of 12 recognisers at p < 0.01" in order.because


def test_attitude_is_the_part_of_the_difference_that_goes_with_the_mean_force() -> None:
    """Of 20 points 5 are left without it, of 10 all."""
    whole, moving = some_scores(80.0, 60.0, 81.0), some_scores(75.0, 65.0, 76.0)
    without = {"six activities": (some_scores(65.0), whole), "in motion": (some_scores(75.0), moving)}
    order, motion, _, _ = gyroscope._claims(whole, moving, without, moving)
    assert order.verdict is Verdict.DIFFERS
    assert "65.0 against 60.0 %, +5.0" in order.why_it_differs
    assert "attitude is 75% of the difference" in order.why_it_differs
    assert "attitude is 0% of the difference" in motion.why_it_differs
    assert order.explained
    assert not motion.explained


@pytest.mark.parametrize("gyro, shown", [(71.0, True), (69.0, False)])
def test_the_norm_is_a_cause_where_nine_people_differ_by_little_on_each_axis(
    gyro: float, shown: bool
) -> None:
    """With frequency features of each axis 75 % is right by forces, and by rates 71 or 69 %."""
    whole, moving = some_scores(80.0, 60.0, 81.0), some_scores(75.0, 65.0, 76.0)
    without = {"six activities": (some_scores(65.0), whole), "in motion": (some_scores(75.0), moving)}
    motion = gyroscope._claims(whole, moving, without, some_scores(75.0, gyro))[1]
    assert motion.verdict is Verdict.DIFFERS
    assert motion.explained is shown


def test_the_norm_of_a_turn_to_and_fro_has_twice_its_frequency() -> None:
    """1 Hz about one axis: the norm's peak is at 2 Hz, that of the axis at 1."""
    t = np.arange(100) / 50.0
    turning = np.stack([np.sin(2 * np.pi * t), 0.0 * t, 0.0 * t], axis=1)[None]
    norm, x, _, _ = gyroscope.BY_AXIS["frequency"](turning)[0].reshape(4, -1)
    assert (norm[BINS + 1], x[BINS + 1]) == (2.0, 1.0)


@pytest.mark.slow
def test_supposed_causes_are_found_where_they_are_and_not_elsewhere() -> None:
    """Time: all in what counts. Clusters: by rate."""
    n = 240
    rng = np.random.default_rng(2)
    device, person, label = np.arange(n) // 60, np.arange(n) % 12, rng.integers(0, 6, n)
    told, blind = 6.0 * label[:, None] + rng.normal(size=(n, 4)), rng.normal(size=(n, 4))
    moves = (label < 3)[:, None]
    time = rng.normal(size=(n, 43))
    counted, level = time.copy(), time.copy()
    counted[:, 32:40] += 6.0 * label[:, None]
    level[:, :32] += 6.0 * label[:, None]
    rate_sign = np.where(device < 2, 1.0, -1.0)[:, None]  # devices of one rate agree, those of the other not

    def rows(time: np.ndarray, frequency: np.ndarray) -> Rows:
        features = {"time": time, "frequency": frequency, "ECDF": rate_sign * told}
        return Rows(features, label, person, np.arange(n) % 60, device, device // 2, device % 2)

    ways = {
        "raw": rows(counted, np.where(moves, blind, told)),
        "smoothed": rows(level, np.where(moves, told, blind)),
        **{way: rows(level, told) for way in ("nearest", "linear", "cubic")},
    }
    still = Windows(np.tile([0.0, 0.0, 9.8], (40, 128, 1)), label[:40], person[:40])
    found = remedy_causes.of_rows(ways, [50.0, 52.0, 198.0, 200.0], 0)
    assert all(min(gain.values()) > 30.0 for gain in found.uncounted.values())
    ways = (remedy_causes.OUT, remedy_causes.USER, remedy_causes.WITHIN)
    for own in (found.uncounted_p[way] for way in ways):
        assert own.shape == (len(METHODS), len(LEARNERS))
        assert ((own > 0.0) & (own < 1e-3)).all()
    assert min(found.within.values()) > 10.0
    assert min(gain[2].mean() for gain in found.same_rate.values()) > 10.0
    within = remedy_causes.WITHIN
    assert list(found.within) == list(found.same_rate) == [within, other_windows(within)]
    assert found.mixed == (50.0, 198.0)
    ceiling = remedy_causes.faultless(still, remedy_causes.COMMON_HZ, 0, learners=("SVM",))
    assert ceiling < 40.0  # nobody moves: nothing is to be told
    slower = ceiling - remedy_causes.faultless(still, remedy_causes.RATE_HZ, 0, learners=("SVM",))
    assert slower == pytest.approx(0.0, abs=10.0)
