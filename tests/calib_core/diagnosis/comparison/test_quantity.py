"""The decision whether two recordings differ, against integrals, known chances and simulated truth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import norm

from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import of_difference
from stillcal.calib_core.diagnosis.comparison.quantity import (
    Part,
    Quantity,
    posterior,
    subtract,
    weighed,
)
from stillcal.calib_core.diagnosis.comparison.records import LEAST_JUDGED, Comparison, NotCompared, p_of
from stillcal.calib_core.diagnosis.inference.bayes_factor import SIZES
from stillcal.calib_core.diagnosis.model.settings import CERTAIN

Floats = NDArray[np.float64]


def quantity(
    value: list[float],
    sd: float | list[float] = 1.0,
    size: float = 10.0,
    *,
    tolerance: float = 0.0,
    logarithmic: bool = False,
) -> Quantity:
    numbers = np.array(value, dtype=np.float64)
    k = numbers.size
    return Quantity(
        "effect",
        "accel",
        (Part("slope", "m/s^2/K", k),),
        numbers,
        np.diag(np.broadcast_to(sd, k) ** 2.0),
        np.full(k, size),
        np.full(k, tolerance),
        np.arange(k) % 3 if k > 1 else np.array([-1]),
        logarithmic=logarithmic,
    )


@pytest.mark.parametrize("apart", [0.0, 1.0, 4.0, 9.0])
def test_the_bayes_factor_is_the_ratio_of_the_two_integrals(apart: float) -> None:
    found = subtract(quantity([apart], 0.8, 5.0, tolerance=0.3), quantity([0.0], 1.1, 5.0, tolerance=0.3))
    noise = np.sqrt(0.8**2 + 1.1**2 + 0.3**2)
    different = np.mean([norm.pdf(apart, 0.0, np.hypot(noise, 5.0 * part)) for part in SIZES])
    largest, _ = quad(
        lambda d: norm.pdf(apart, d, noise) * norm.pdf(d, 0.0, 5.0), -60.0, 60.0, points=[0.0, apart]
    )
    assert largest == pytest.approx(norm.pdf(apart, 0.0, np.hypot(noise, 5.0)), rel=1e-6)
    assert found.log_bayes_factor == pytest.approx(np.log(different / norm.pdf(apart, 0.0, noise)), rel=1e-6)


def test_a_difference_on_one_axis_is_seen_though_the_others_agree() -> None:
    one = subtract(quantity([4.0, 0.0, 0.0]), quantity([0.0, 0.0, 0.0], 0.01))
    alone = subtract(quantity([4.0]), quantity([0.0], 0.01))
    assert alone.log_bayes_factor > one.log_bayes_factor > alone.log_bayes_factor - np.log(6.0) - 0.2


@pytest.mark.parametrize(
    ("recorded", "simulated", "relation"),
    [
        (10.0, 0.0, "lacking"),
        (10.0, 5.0, "too_small"),
        (10.0, 20.0, "too_large"),
        (0.0, 10.0, "superfluous"),
        (-10.0, -5.0, "too_small"),
        (10.0, -20.0, "too_large"),
        (10.0, -5.0, "too_small"),
    ],
)
def test_the_relation_says_how_the_simulation_stands(
    recorded: float, simulated: float, relation: str
) -> None:
    assert subtract(quantity([recorded], 0.5), quantity([simulated], 0.5)).relation() == relation


@pytest.mark.parametrize(
    ("recorded", "simulated", "relation"),
    [
        (60.0, 1.6, "lacking"),
        (1.6, 60.0, "superfluous"),
        (60.0, 3.0, "too_small"),
        (3.0, 60.0, "too_large"),
        (8.0, 1.6, "too_small"),
    ],
)
def test_a_doubtful_value_beside_a_large_one_is_none(
    recorded: float, simulated: float, relation: str
) -> None:
    """3.2 standard errors are something beside 16 of them, and none beside 120; six are beyond doubt."""
    assert subtract(quantity([recorded], 0.5), quantity([simulated], 0.5)).relation() == relation


def test_a_simulation_with_smaller_numbers_of_mixed_signs_is_too_small() -> None:
    recorded, simulated = quantity([88.0, 126.0, -100.0], 0.3), quantity([5.0, -3.0, 8.0], 0.3)
    assert subtract(recorded, simulated).relation() == "too_small"
    assert subtract(simulated, recorded).relation() == "too_large"


@pytest.mark.parametrize(
    ("ratio", "relation"),
    [(2.0, "too_small"), (0.5, "too_large"), (150.0, "lacking"), (0.006, "superfluous")],
)
def test_of_a_positive_quantity_a_hundredth_is_none(ratio: float, relation: str) -> None:
    recorded = quantity([np.log(ratio)], 0.01, logarithmic=True)
    assert subtract(recorded, quantity([0.0], 0.01, logarithmic=True)).relation() == relation


def test_what_is_alike_is_rarely_called_different() -> None:
    """Of recordings with the same truth at most one in twenty of all answers has a false difference."""
    rng = np.random.default_rng(7)
    false, answers, compared = 0, 1500, 10
    for _ in range(answers):
        truth = rng.normal(0.0, 10.0, (compared, 3))
        pairs = [
            subtract(quantity(list(t + rng.normal(size=3))), quantity(list(t + rng.normal(size=3))))
            for t in truth
        ]
        false += any(d.probability >= CERTAIN for d in weighed(pairs, compared))
    assert false / answers <= 1.0 - CERTAIN


def test_probabilities_of_differences_are_calibrated() -> None:
    """One quantity in eleven differs, by the prior: of those called 0.5 to 0.95 as many do differ."""
    rng, compared = np.random.default_rng(3), 10
    said, true = [], []
    for _ in range(20_000):
        differs = rng.random() < 1.0 / (1.0 + compared)
        apart = rng.normal(0.0, 10.0 * rng.choice(SIZES)) * differs
        found = subtract(quantity([apart + rng.normal()]), quantity([rng.normal()]))
        said.append(posterior(found.log_bayes_factor, compared))
        true.append(differs)
    share, hits = np.array(said), np.array(true)
    for low, high in ((0.0, 0.1), (0.1, 0.5), (0.5, 0.95), (0.95, 1.0)):
        inside = (share >= low) & (share <= high)
        error = np.sqrt(share[inside] @ (1.0 - share[inside])) / inside.sum()
        assert abs(hits[inside].mean() - share[inside].mean()) < 3.5 * error


def test_a_small_difference_that_is_plain_is_not_called_agreement() -> None:
    """Nine numbers that may be a thousand of their errors; a difference of two errors in each is one."""
    value = 2.15 * np.tile([1.0, -1.0, 1.0], 3)
    found = subtract(quantity(list(value), size=1e3), quantity([0.0] * 9, 1e-6, 1e3))
    (found,) = weighed([found], 10)
    assert found.of_usual_size < -10.0 and found.probability > 0.5 and not found.agrees
    (none,) = weighed([subtract(quantity([1.0], size=1e3), quantity([0.0], size=1e3))], 10)
    assert none.agrees


def test_the_smallest_visible_difference_is_seen_nine_times_in_ten() -> None:
    rng, compared = np.random.default_rng(11), 10
    least = subtract(quantity([0.0], 0.6), quantity([0.0], 0.8)).visible_from(compared)[0]
    seen = [
        posterior(
            subtract(
                quantity([least + 0.6 * rng.normal()], 0.6), quantity([0.8 * rng.normal()], 0.8)
            ).log_bayes_factor,
            compared,
        )
        >= CERTAIN
        for _ in range(4000)
    ]
    assert np.mean(seen) == pytest.approx(0.9, abs=0.02)


@pytest.mark.slow
def test_p_of_many_comparisons_is_uniform_at_most() -> None:
    """Under no difference p falls below a level no more often than the level says."""
    rng = np.random.default_rng(5)
    values = [
        p_of(
            [subtract(quantity([rng.normal()]), quantity([rng.normal()])).log_bayes_factor for _ in range(8)]
        )
        for _ in range(4000)
    ]
    for level in (0.1, 0.01):
        assert np.mean(np.array(values) < level) <= level + 3.0 * np.sqrt(level / 4000)
    assert p_of([]) == 1.0 and p_of([500.0, 0.0]) < 1e-200


def test_less_than_a_third_of_the_checks_is_no_verdict() -> None:
    def missing(count: int) -> list[NotCompared]:
        return [NotCompared(f"effect {i}", "accel", "it has no such thing") for i in range(count)]

    assert Comparison(comparisons=4, not_compared=missing(8)).verdict(1.0) == "match"
    assert Comparison(comparisons=4, not_compared=missing(9)).verdict(1.0) == "not_judged"
    assert pytest.approx(1.0 / 3.0) == LEAST_JUDGED


def test_a_ratio_beyond_a_thousand_is_not_told_as_the_smallest_that_shows() -> None:
    """Levels that hardly show: with errors of a factor e^900 no ratio is a number."""
    known, unknown = (subtract(q, q) for q in (_level(0.1), _level(900.0)))
    assert [s.effect for s in of_difference(known, 10)] == ["effect"]
    assert of_difference(unknown, 10) == []


def _level(sd: float) -> Quantity:
    return quantity([0.0], sd, 1.0, logarithmic=True)
