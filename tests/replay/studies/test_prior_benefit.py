"""What a fleet says of the next phone, against populations whose truth is known and against real devices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer import prior as fleet_prior
from stillcal.calib_core.accelerometer.prior import NOMINAL, FleetPrior
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.rest import directions
from stillcal.replay.phone import draw_rests
from stillcal.replay.phone.population import population
from stillcal.replay.studies import prior_benefit

SIZES = np.repeat([0.3, 0.01, 0.004], 3)


def truths(n: int, seed: int) -> np.ndarray:
    return NOMINAL + SIZES * np.random.default_rng(seed).standard_normal((n, 9))


def rests_of(values: np.ndarray, n: int, seed: int, sd: float = 0.003) -> tuple[np.ndarray, np.ndarray]:
    """Draw raw rests in any attitude of a sensor whose correction has these parameters."""
    rng = np.random.default_rng(seed)
    up = directions(rng.standard_normal((n, 3)))
    scale = np.diag(values[3:6])
    scale[np.triu_indices(3, 1)] = values[6:]
    scale.T[np.triu_indices(3, 1)] = values[6:]
    raw = 9.80665 * up @ np.linalg.inv(scale).T + values[:3]
    return raw + sd * rng.standard_normal(raw.shape), np.full(raw.shape, sd)


def test_a_prior_that_says_nothing_leaves_the_ordinary_fit() -> None:
    phone = population(1, 5)[0]
    drawn = draw_rests(phone, 40, 1)
    ordinary = accelerometer.fit(drawn.forces, drawn.uncertainties, drawn.gravity, parameters=9)
    wide = FleetPrior(NOMINAL, 1e4 * np.eye(9), scatter=max(ordinary.excess_attitude, 1e-9))
    found = fleet_prior.fit(drawn.forces, drawn.uncertainties, drawn.gravity, wide)
    sd = np.sqrt(np.diag(ordinary.covariance))
    np.testing.assert_array_less(np.abs(found.values - ordinary.values), 0.2 * sd)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), sd, rtol=0.1)
    assert found.shown.min() > 0.999


def test_without_rests_the_prior_is_the_answer() -> None:
    prior = FleetPrior(truths(1, 3)[0], np.diag(SIZES**2))
    found = fleet_prior.fit(np.empty((0, 3)), np.empty((0, 3)), 9.80665, prior)
    np.testing.assert_allclose(found.values, prior.mean)
    np.testing.assert_allclose(found.covariance, prior.covariance)
    assert found.shown.max() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("rests", [1, 3, 6])
def test_intervals_hold_the_truth_with_however_few_rests(rests: int) -> None:
    """Of 300 phones from the prior itself: twice the binomial's 3.3 sd, since nine go together, and 1 %."""
    prior = FleetPrior(NOMINAL, np.diag(SIZES**2), scatter=1e-6)
    inside = []
    for seed, values in enumerate(truths(300, 7)):
        found = fleet_prior.fit(*rests_of(values, rests, seed), 9.80665, prior)
        inside.append(np.abs(found.values - values) < 1.96 * np.sqrt(np.diag(found.covariance)))
    assert abs(np.mean(inside) - 0.95) < 0.01 + 3.3 * np.sqrt(0.95 * 0.05 / 300 / 9) * 2


def test_a_population_is_learnt_from_its_devices() -> None:
    """400 devices of 40 models: sd within to a quarter, between to a third, each device's doubt taken out."""
    rng = np.random.default_rng(2)
    model = np.repeat(np.arange(40), 10)
    within, between, own = 0.2 * SIZES, SIZES, 0.3 * SIZES
    values = (
        NOMINAL
        + (between * rng.standard_normal((40, 9)))[model]
        + within * rng.standard_normal((400, 9))
        + own * rng.standard_normal((400, 9))
    )
    learnt = fleet_prior.learn(values, np.broadcast_to(np.diag(own**2), (400, 9, 9)), model)
    np.testing.assert_allclose(np.sqrt(np.diag(learnt.within)), within, rtol=0.25)
    np.testing.assert_allclose(np.sqrt(np.diag(learnt.between)), between, rtol=0.35)
    np.testing.assert_array_less(np.abs(learnt.mean - NOMINAL), 3.5 * between / np.sqrt(40))
    seen, unseen = learnt.prior(3), learnt.prior()
    assert np.all(np.diag(seen.covariance) < 0.2 * np.diag(unseen.covariance))


def test_two_devices_are_no_fleet() -> None:
    with pytest.raises(NotSupported, match="2 calibrated devices"):
        fleet_prior.learn(truths(2, 0), np.zeros((2, 9, 9)), [0, 0])


def test_a_fleet_shortens_the_first_calibration_of_phones_alike_within_a_model() -> None:
    """Three rests on a table: no ordinary fit exists; the model's prior must halve the factory's error."""
    phones, truth = (
        prior_benefit.simulated(40, 0, prior_benefit.FAMILY_SD),
        prior_benefit.true_prior(prior_benefit.FAMILY_SD),
    )
    found = prior_benefit.of_simulated(phones, truth, lambda _: None, (0, 3, 20))
    by = {(p.way, p.rests): p for p in found}
    assert by["rests alone", 3].calibrated == 0.0
    assert by["fleet, by model", 3].high < by["factory", 3].low
    assert by["fleet, by model", 3].rms < 0.6 * by["factory", 3].rms
    assert by["fleet, by model", 0].ratio[2] < 1.0  # before any rest it beats the datasheet, for certain
    assert by["bound", 20].rms < by["bound", 3].rms < by["bound", 0].rms


def test_real_phones_are_calibrated_where_faces_are_missing(data_dir: Path) -> None:
    found = prior_benefit.of_real(prior_benefit.real(data_dir / "hhar_still"), lambda _: None, (5,))
    by = {(p.way, p.rests): p for p in found}
    assert by["rests alone", 5].calibrated == 0.0
    for way in ("datasheet", "fleet", "fleet, by model"):
        assert by[way, 5].high < by["factory", 5].low
