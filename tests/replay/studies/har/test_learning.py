"""Features, learners and scores of activity recognition, on signals whose answers are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sklearn.metrics import f1_score

from stillcal.replay.studies.har import scoring
from stillcal.replay.studies.har.data import ACTIVITIES, read_windows
from stillcal.replay.studies.har.features import (
    BINS,
    FAMILIES,
    ecdf_features,
    frequency_features,
    time_features,
)

RNG = np.random.default_rng(0)


def tone(frequency: float, rate: float, seconds: float = 2.0) -> np.ndarray:
    """One window of gravity along z that swings at a frequency."""
    t = np.arange(round(rate * seconds)) / rate
    window = np.zeros((1, t.size, 3))
    window[0, :, 2] = 9.8 + np.sin(2 * np.pi * frequency * t)
    return window


@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0])
@pytest.mark.parametrize("frequency", [0.5, 2.0, 7.5, 20.0])
def test_a_tone_fills_its_own_bin_at_any_rate(frequency: float, rate: float) -> None:
    features = frequency_features(tone(frequency, rate))[0]
    assert features[:BINS].argmax() == round(2 * frequency) - 1
    assert features[:BINS].max() == pytest.approx(1.0, abs=1e-6)
    assert features[BINS + 1] == pytest.approx(frequency)
    assert features[-1] == pytest.approx(9.8, abs=1e-9)


def test_spectrum_stops_at_half_the_rate() -> None:
    features = frequency_features(9.8 + RNG.normal(size=(4, 50, 3)))
    assert features.shape == (4, BINS + 5)
    assert (features[:, 25:BINS] == 0.0).all()  # 12.5 Hz is the highest of 25 samples a second


def test_ecdf_of_an_even_ramp_is_the_ramp() -> None:
    ramp = np.tile(np.linspace(0.0, 29.0, 291)[None, :, None], (2, 1, 3))
    features = ecdf_features(ramp)
    assert features.shape == (2, 93)
    assert features[0, :30] == pytest.approx(np.arange(30.0))
    assert features[0, 90:] == pytest.approx(14.5)


def test_time_features_of_a_constant() -> None:
    features = time_features(np.tile([0.0, 3.0, 4.0], (1, 60, 1)))[0]
    assert features[:4] == pytest.approx([0.0, 3.0, 4.0, 5.0])  # means, the norm last
    assert features[4:8] == pytest.approx(0.0)
    assert features.size == 43


def test_ecdf_does_not_know_the_order_of_samples() -> None:
    windows = RNG.normal(size=(3, 100, 3))
    shuffled = windows[:, RNG.permutation(100)]
    assert ecdf_features(shuffled) == pytest.approx(ecdf_features(windows))
    assert np.abs(frequency_features(shuffled) - frequency_features(windows)).max() > 0.01


def test_weighted_f1_is_that_of_scikit_learn() -> None:
    truth, predicted = RNG.integers(0, 4, 200), RNG.integers(0, 4, 200)
    assert scoring.weighted_f1(truth, predicted) == pytest.approx(
        f1_score(truth, predicted, average="weighted")
    )


def test_folds_never_share_a_person() -> None:
    person = RNG.integers(0, 13, 300)
    tested = np.zeros(300, dtype=int)
    for mask in scoring.folds(person, 5, np.random.default_rng(1)):
        assert not set(person[mask]) & set(person[~mask])
        tested += mask
    assert (tested == 1).all()


def test_interval_holds_the_mean_of_a_normal_sample() -> None:
    values = RNG.normal(2.0, 1.0, 400)
    low, high = scoring.interval(values)
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(400), rel=0.15)
    assert scoring.with_interval(values) == f"{values.mean():+.1f} ({low:+.1f} to {high:+.1f})"


@pytest.mark.parametrize("learner", [*scoring.LEARNERS.values(), scoring.radial_svm, scoring.network(25)])
def test_learners_tell_what_lies_apart(learner: scoring.Learner) -> None:
    labels = np.repeat([0, 1], 60)
    features = RNG.normal(size=(120, 5)) + 4.0 * labels[:, None]
    model = scoring.fitted(learner, features[::2], labels[::2], 0)
    # one axis alone tells 97.7 % apart (4 sd between), sixty answers give that 2 %
    assert np.mean(model.predict(features[1::2]) == labels[1::2]) > 0.9


def test_activities_are_told_apart_on_people_never_seen(data_dir: Path) -> None:
    """Walking against lying, by any family: gravity itself turns."""
    windows = read_windows(data_dir).of("walk", "lie")
    windows = windows.only(np.arange(0, len(windows), 8))
    test = windows.person <= 10
    for make in FAMILIES.values():
        features = make(windows.accel)
        model = scoring.fitted(scoring.nearest, features[~test], windows.label[~test], 0)
        assert scoring.weighted_f1(windows.label[test], model.predict(features[test])) > 0.9


def test_windows_are_whole(data_dir: Path) -> None:
    windows = read_windows(data_dir)
    assert windows.accel.shape == (3350, 128, 3)
    assert len(windows.people) == 30
    norm = np.linalg.norm(windows.of("stand").accel.mean(axis=1), axis=1).mean()
    assert norm / 9.81 - 1 == pytest.approx(0.0, abs=0.085)  # no phone of Figure 1 is farther off
    assert set(windows.label) == set(range(len(ACTIVITIES)))


def test_mcnemar_is_the_textbook_s() -> None:
    """Ten against two discordant pairs: (|10 - 2| - 1)^2 / 12 = 4.083, p = 0.0433 with one degree."""
    one, other = np.r_[np.ones(10), np.zeros(2), np.ones(50)], np.r_[np.zeros(10), np.ones(2), np.ones(50)]
    assert scoring.mcnemar(one, other) == pytest.approx((49 / 12, 0.0433), rel=2e-3)
    assert scoring.mcnemar(one, one) == (0.0, 1.0)


def test_principal_components_keep_what_varies() -> None:
    rng = np.random.default_rng(1)
    hidden = rng.normal(size=(300, 2))
    features = hidden @ rng.normal(size=(2, 12))
    model = scoring.principal(scoring.tree)(0).fit(features, (hidden[:, 0] > 0).astype(int))
    assert model[1][0].n_components_ <= 2
