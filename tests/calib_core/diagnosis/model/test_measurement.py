"""Evidence of direct measurements, against the same probabilities written out in full."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    HeldOut,
    Measured,
    direct_finding,
    mean_in_time,
    mean_of,
    of_chance,
    of_counts,
    of_fit,
    of_measured,
    of_vector,
    posterior,
    share_in_time,
    share_of,
)
from stillcal.calib_core.diagnosis.model.records import Evidence, Where
from stillcal.calib_core.diagnosis.model.settings import DIRECT_CHECKS
from stillcal.calib_core.diagnosis.model.sound_phones import Usual, sound_phones

WHERE = Where(0.0, 1.0, (0.0, 1.0), "")
STATED_RANGE = Usual(np.zeros(0), (-0.1, 0.1), (-1.0, 1.0), "")


@pytest.mark.parametrize("value", [0.0, 0.12, 0.5, -0.3])
def test_a_number_against_a_range_is_the_ratio_of_two_smeared_uniforms(value: float) -> None:
    def density(low: float, high: float) -> float:
        return float(integrate.quad(lambda x: stats.norm.pdf(value, x, 0.05) / (high - low), low, high)[0])

    expected = np.log(density(-1.0, 1.0) / density(-0.1, 0.1))
    assert of_measured(Measured(value, 0.05), STATED_RANGE).log_bayes_factor == pytest.approx(
        expected, abs=1e-6
    )


def test_a_number_far_outside_has_finite_evidence() -> None:
    nats = of_measured(Measured(0.9, 1e-3), STATED_RANGE).log_bayes_factor
    assert np.isfinite(nats) and nats == pytest.approx(0.5 * 800.0**2, rel=0.01)


@pytest.mark.parametrize(
    ("hits", "trials", "sound"), [(0, 50, 0.1), (5, 50, 0.1), (30, 50, 0.1), (9, 9, 0.5)]
)
def test_counts_are_marginal_likelihoods_of_uniform_shares(hits: int, trials: int, sound: float) -> None:
    def mean(low: float, high: float) -> float:
        area = integrate.quad(lambda p: stats.binom.pmf(hits, trials, p), low, high, epsabs=0.0)[0]
        return float(area / (high - low))

    expected = np.log(mean(sound, 1.0) / mean(0.0, sound))
    assert of_counts(hits, trials, sound) == pytest.approx(expected, abs=1e-5)


def test_counts_far_beyond_chance_have_finite_evidence() -> None:
    assert 2e4 < of_counts(5000.0, 5000.0, 0.01) < 5000.0 * np.log(100.0) + 1.0


def test_a_vector_is_a_ratio_of_normal_densities() -> None:
    noise = np.array([[0.02, 0.005], [0.005, 0.03]])
    value = np.array([0.3, -0.2])
    both = stats.multivariate_normal(np.zeros(2), noise + 0.25 * np.eye(2)).logpdf(value)
    assert of_vector(value, noise, 0.5) == pytest.approx(
        both - stats.multivariate_normal(np.zeros(2), noise).logpdf(value)
    )


def test_chance_fit_and_prior_are_as_they_say() -> None:
    assert of_chance(-20.0 * np.log(2.0), 4.0) == pytest.approx(18.0 * np.log(2.0))
    assert of_fit(30.0, 2.0, np.e**4) == pytest.approx(26.0)
    assert posterior(np.log(DIRECT_CHECKS)) == pytest.approx(0.5)
    assert share_of(0.0, 1000.0).error > 0.0, "no success in 1,000 trials is no certainty of none"


def test_what_held_out_parts_contradict_is_not_stated() -> None:
    def stated(seen: DirectEvidence) -> bool:
        return direct_finding("bandwidth", "gyro", [0], WHERE, {}, statement="Said.", seen=seen) is not None

    assert stated(DirectEvidence(50.0)) and stated(DirectEvidence(50.0, HeldOut(3.0, 2.0, 1.0)))
    assert not stated(DirectEvidence(50.0, HeldOut(-3.0, 1.0, 2.0))), "a gain of -3 nats"
    assert not stated(DirectEvidence(5.0)), "one of 40 checks is expected to be as sure"


def test_evidence_has_only_what_was_computed() -> None:
    counted = direct_finding(
        "x", "gyro", [], WHERE, {}, statement="Said.", seen=DirectEvidence(50.0, None, "(Rare.)")
    )
    assert counted is not None and counted.statement == "Said. (Rare.)"
    assert counted.evidence.heldout_log_score_gain is None and counted.evidence.folds == 0
    assert counted.evidence.log_bayes_factor == 50.0
    seen = DirectEvidence(50.0, HeldOut(3.0, 1.0, 2.0))
    fitted = direct_finding("x", "gyro", [], WHERE, {}, statement="Said.", seen=seen)
    assert fitted is not None and fitted.evidence == Evidence(50.0, 1.0, 2.0, 3.0, folds=5)
    assert fitted.evidence.contradicted, "its noise is not fitted with it: the rms of the misses tells"


def test_less_than_what_a_sound_phone_shows_is_sound() -> None:
    """Numbers of devices with a gap: what lies in it is less than the device beyond it."""
    devices = np.array([0.0, 0.01, 0.02, 0.03, 1.0])
    one_sided = Usual.of(devices, (0.0, 5.0), "")
    assert one_sided.side == 1
    assert not of_measured(Measured(0.5, 0.01), one_sided).stated
    assert not of_measured(Measured(1.0, 0.01), one_sided).stated
    assert of_measured(Measured(4.5, 0.01), one_sided).stated
    assert one_sided.rarity(0.5).startswith("(1 of 5") and one_sided.rarity(4.5).startswith("(None of 5")
    assert Usual.of(devices, (-4.0, 4.0), "").side == 0


def test_every_population_has_a_source_and_a_range_of_faults() -> None:
    for name, one in sound_phones().items():
        assert one.source and one.source != "to be filled in", name
        assert one.faulty[0] < one.faulty[1], name
        assert one.devices.size >= 5 or one.between[0] < one.between[1], name
        if one.devices.size:
            assert 0.0 < one.width < np.ptp(one.devices), name


def test_pieces_that_are_alike_for_a_while_leave_a_mean_less_sure() -> None:
    """Real stamps jitter more for some seconds; taken for independent, their error was half as large."""
    pieces = 1.0 + np.random.default_rng(2).normal(0.0, 0.1, 40)
    assert mean_in_time(pieces) == mean_of(pieces)
    slow = pieces + np.repeat([0.0, 1.0, 0.0, 1.0, 1.0], 8)
    assert mean_in_time(slow).value == mean_of(slow).value
    assert mean_in_time(slow).error > 2.0 * mean_of(slow).error
    seldom = pieces + 9.0 * (np.arange(40) == 20)
    assert mean_in_time(seldom).value == pytest.approx(1.0, abs=0.1)
    assert mean_in_time(seldom).error > 5.0 * mean_of(seldom).error
    evenly = pieces + 9.0 * (np.arange(40) % 8 == 3)
    assert mean_in_time(evenly).value == pytest.approx(1.0, abs=0.1)
    assert mean_in_time(evenly).error > 20.0 * mean_of(evenly).error


def test_the_error_of_a_mean_in_time_is_that_of_independent_pieces_where_they_are() -> None:
    draws = np.random.default_rng(1).normal(size=(400, 40))
    apart = np.array([m.value / m.error for m in map(mean_in_time, draws)])
    assert np.mean(np.abs(apart) < 1.96) == pytest.approx(0.95, abs=0.03)
    larger = [mean_in_time(d).error > max(mean_of(d).error, d.std(ddof=1) / np.sqrt(40.0)) for d in draws]
    assert np.mean(larger) == pytest.approx(0.05, abs=0.03)


def test_hits_that_come_and_go_leave_a_share_less_sure() -> None:
    rng = np.random.default_rng(0)
    steady = (rng.uniform(size=20_000) < 0.05).astype(float)
    whole = share_of(float(steady.sum()), float(steady.size))
    assert share_in_time(steady, float(steady.size)).value == whole.value
    assert share_in_time(steady, float(steady.size)).error == pytest.approx(whole.error, rel=0.3)
    # Pieces of one block and of two scatter no more than those of one size.
    blocks = steady[:6_000].reshape(60, 100).sum(axis=1)
    of_blocks = share_of(float(blocks.sum()), 6_000.0)
    assert share_in_time(blocks, 6_000.0).error == pytest.approx(of_blocks.error, rel=0.4)
    gone = steady * (np.arange(steady.size) < 8_000)
    once = share_of(float(gone.sum()), float(gone.size))
    assert share_in_time(gone, float(gone.size)).value == once.value
    assert share_in_time(gone, float(gone.size)).error > 5.0 * once.error
