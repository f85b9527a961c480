"""Features of motion on signals that are known, Bayes' rule on normal classes, coning at 20 Hz."""

import numpy as np
import pytest

from stillcal.replay.studies.claim import Verdict
from stillcal.replay.studies.collin2019.coning import _bias_claim, at_20_hz, in_order
from stillcal.replay.studies.collin2019.motion_features import MODES, Motion, simulated
from stillcal.replay.studies.collin2019.motion_modes import (
    _error_claim,
    _errors,
    error_by_person,
    judge_by_bayes,
)
from stillcal.replay.studies.collin2019.step_detection import _count_claims
from stillcal.replay.studies.methods.motion_modes import NAMES, Bayes, features, peak_frequency

RATE = 100.0
T = np.arange(500) / RATE


def test_features_of_a_sinusoid_are_its_own() -> None:
    norms = 9.81 + 2.0 * np.sin(2 * np.pi * 2.0 * T)[None]
    found = dict(zip(NAMES, features(norms, np.zeros((1, 500, 3)), RATE)[0], strict=True))
    assert 10 ** found["standard deviation (log)"] == pytest.approx(np.sqrt(2.0), rel=1e-6)
    assert found["peak frequency"] == pytest.approx(2.0)
    assert found["skewness"] == pytest.approx(0.0, abs=1e-6)
    assert 10 ** found["mean absolute deviation (log)"] == pytest.approx(4.0 / np.pi, rel=2e-3)  # 50 a period
    assert found["zero-crossing rate"] == pytest.approx(4.0, abs=0.3)
    assert found["change of peak frequency over 4 parts"] == pytest.approx(0.0, abs=1e-9)
    assert found["coning error (log)"] < -8


def test_noise_has_more_entropy_than_a_tone() -> None:
    noise = np.random.default_rng(1).standard_normal((1, 500))
    tone = np.sin(2 * np.pi * 5.0 * T)[None]
    entropy = [
        features(x, np.zeros((1, 500, 3)), RATE)[0, NAMES.index("spectral entropy")] for x in (noise, tone)
    ]
    assert entropy[0] > 0.85 > 0.3 > entropy[1]
    assert peak_frequency(tone, RATE) == pytest.approx([5.0])


def test_bayes_rule_gives_the_posterior_of_normal_classes() -> None:
    model = Bayes(np.array([[0.0], [2.0]]), np.ones((2, 1, 1)), np.array([0.75, 0.25]))
    # log odds of two unit normals two apart: ln 3 + (2 - 2 z)
    z = np.array([[0.0], [1.0], [1.7]])
    odds = 3.0 * np.exp(2.0 - 2.0 * z[:, 0])
    assert model.posterior(z)[:, 0] == pytest.approx(odds / (1.0 + odds))


def test_bayes_reaches_the_error_of_theory_on_normal_classes() -> None:
    rng = np.random.default_rng(2)
    label = np.repeat([0, 1], 4000)
    z = rng.standard_normal((8000, 2)) + 2.0 * label[:, None] * [1.0, 0.0]
    learnt = Bayes.learnt(z[::2], label[::2], 2)
    wrong = np.mean(learnt.posterior(z[1::2]).argmax(axis=1) != label[1::2])
    assert wrong == pytest.approx(0.1587, abs=3.0 * np.sqrt(0.1587 * 0.84 / 4000) + 0.002)  # Phi(-1)


def test_simulated_modes_differ_as_in_fig_9_and_are_told_apart() -> None:
    people = simulated(3, 1, minutes=2.0)
    sd = [np.median(people.sd[people.mode == m]) for m in range(len(MODES))]
    assert sd[0] > 2.0 * sd[1] > 2.0 * sd[2]
    assert error_by_person(people, judge_by_bayes(people, (0, 1))).mean() < 0.1


def test_every_classifier_must_misjudge_fewer_than_a_tenth() -> None:
    """Ten windows of one person: one classifier that is always right beside one that errs now and then."""
    mode = np.zeros(10, dtype=int)
    motion = Motion(np.zeros((10, 1)), mode, mode, np.zeros(10))
    for wrong, verdict in ((0, Verdict.REPRODUCED), (1, Verdict.DIFFERS)):
        ways = {("Bayes", "two"): mode, ("Bayes", "all"): (np.arange(10) < wrong).astype(int)}
        assert _error_claim("two modes, real people", _errors(motion, ways), "data").verdict is verdict


@pytest.mark.parametrize("most, verdict", [(0.049, Verdict.REPRODUCED), (0.051, Verdict.DIFFERS)])
def test_every_count_of_steps_must_be_within_a_twentieth(most: float, verdict: Verdict) -> None:
    by_vertical, by_norm = _count_claims(np.array([0.0, most]), np.zeros(2))
    assert (by_vertical.verdict, by_norm.verdict) == (verdict, Verdict.REPRODUCED)


@pytest.mark.parametrize(
    "errors, ordered",
    [
        ((1.0, 0.3, 0.09), True),
        ((1.0, 0.34, 0.09), False),
        ((1.0, 0.3, 0.11), False),
        ((1.0, 0.3, 0.2), False),
    ],
)
def test_coning_falls_to_a_third_twice(errors: tuple[float, ...], ordered: bool) -> None:
    assert in_order(list(errors)) is ordered


@pytest.mark.parametrize(
    "by_bias, verdict, shown",
    [
        ({0.0: 0.01, 0.3: 0.45, 3.0: 0.9}, Verdict.REPRODUCED, False),
        ({0.0: 0.01, 0.3: 0.35, 3.0: 0.9}, Verdict.DIFFERS, True),
    ],
)
def test_a_large_coning_error_is_half_of_a_walkers(
    by_bias: dict[float, float], verdict: Verdict, shown: bool
) -> None:
    claim = _bias_claim(by_bias, 0.8)
    assert claim.verdict is verdict
    assert claim.cause is not None
    assert claim.cause.shown is shown


def test_twenty_hertz_keep_the_mean_rate() -> None:
    t = np.arange(0.0, 10.0, 0.005)
    rates = np.column_stack((np.sin(t), np.cos(t), t))
    slow, mean = at_20_hz(t, rates)
    assert np.diff(slow) == pytest.approx(0.05)
    # an interval holds its first sample and not its last: its mean leads by half a sample, a whole one if
    # rounding moves a sample over the edge
    assert np.abs(mean[:, 2] - (slow - 0.0025)).max() < 0.005 + 1e-9
