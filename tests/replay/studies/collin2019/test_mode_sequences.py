"""Motion modes in sequence: transitions, the forward recursion and windows that are not judged."""

import numpy as np
import pytest

from stillcal.replay.studies.claim import Verdict
from stillcal.replay.studies.collin2019.mode_sequences import (
    Judged,
    _six,
    among_resting,
    errors,
    forward,
    judge,
    transitions,
)
from stillcal.replay.studies.collin2019.motion_features import Motion
from stillcal.replay.studies.har.data import ACTIVITIES


def test_transitions_stay_within_a_person() -> None:
    label, person = np.array([0, 0, 1, 1, 0]), np.array([1, 1, 1, 2, 2])
    # counts of one each, and 0 -> 0, 0 -> 1, 1 -> 0; the step between people does not count
    assert transitions(label, person, 2) == pytest.approx(np.array([[0.5, 0.5], [2 / 3, 1 / 3]]))


def test_forward_recursion_is_bayes_rule_over_all_paths() -> None:
    rng = np.random.default_rng(0)
    likelihood, prior, chain = rng.random((3, 2)), np.array([0.3, 0.7]), np.array([[0.9, 0.1], [0.2, 0.8]])
    joint = np.zeros(2)
    for a in range(2):
        for b in range(2):
            for c in range(2):
                path = prior[a] * likelihood[0, a] * chain[a, b] * likelihood[1, b] * chain[b, c]
                joint[c] += path * likelihood[2, c]
    assert forward(likelihood, prior, chain)[-1] == pytest.approx(joint / joint.sum())


def test_confusion_at_rest_is_of_windows_judged_wrongly() -> None:
    """Of four mistakes two are among sitting, standing and lying, one leaves them, one is of walks."""
    walk, up, sit, stand, lie = (ACTIVITIES.index(a) for a in ("walk", "stairs up", "sit", "stand", "lie"))
    true = np.array([sit, stand, lie, sit, walk, walk])
    found = np.array([sit, lie, sit, walk, up, walk])
    labels = np.arange(len(ACTIVITIES))
    posterior = np.eye(len(ACTIVITIES))[found]
    motion = Motion(np.zeros((6, 1)), true, np.zeros(6, dtype=int), np.zeros(6))
    assert among_resting(Judged(motion, labels, posterior, posterior)) == 0.5


@pytest.mark.parametrize(
    "wrong, tilted, verdict, shown",
    [
        (0.3, 0.05, Verdict.DIFFERS, True),
        (0.3, 0.15, Verdict.DIFFERS, False),
        (0.05, 0.05, Verdict.REPRODUCED, True),
    ],
)
def test_six_activities_must_be_misjudged_below_a_tenth(
    wrong: float, tilted: float, verdict: Verdict, shown: bool
) -> None:
    claim = _six(errors(judged_wrongly(wrong)), errors(judged_wrongly(tilted)))
    assert claim.verdict is verdict
    assert claim.cause is not None
    assert claim.cause.shown is shown


def judged_wrongly(share: float) -> Judged:
    """Return a hundred windows of one person, a share of which is judged wrongly."""
    true = np.zeros(100, dtype=int)
    posterior = np.eye(2)[(np.arange(100) < round(100 * share)).astype(int)]
    motion = Motion(np.zeros((100, 1)), true, true, np.zeros(100))
    return Judged(motion, np.arange(2), posterior, posterior)


def test_sequence_and_refusal_lower_the_error_of_classes_that_overlap() -> None:
    rng = np.random.default_rng(1)
    person = np.repeat(np.arange(4), 400)
    mode = np.tile(np.repeat([0, 1, 0, 1], 100), 4)
    z = 1.5 * mode[:, None] + rng.standard_normal((1600, 2))
    found = judge(Motion(z, mode, person, z[:, 0]), (0, 1))
    alone = found.errors(found.posterior).mean()
    assert found.errors(found.filtered).mean() < 0.3 * alone
    assert found.errors(found.posterior, 0.95).mean() < 0.3 * alone
    assert 0.1 < found.refused(0.95) < 0.8
