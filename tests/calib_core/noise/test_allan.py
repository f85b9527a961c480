"""The Allan curve against allantools, its band, and N, B, K against exact curves and SP1065."""

import allantools
import numpy as np
import pytest

from stillcal.calib_core.noise.allan import (
    FLOOR,
    AllanCurve,
    allan_curve,
    averaging_factors,
    edf_of,
    fit_allan,
)


def exact(n: float, b: float, k: float, edf: float = 1e4) -> AllanCurve:
    tau = np.logspace(-1, 4, 30)
    deviation = np.sqrt(n**2 / tau + 2.0 * np.log(2.0) / np.pi * b**2 + k**2 * tau / 3.0)
    return AllanCurve(tau, deviation, deviation, deviation, np.full(30, edf))


@pytest.mark.parametrize("colour", ["white", "walk"])
def test_curve_is_allantools(colour: str) -> None:
    values = np.random.default_rng(1).standard_normal(4000)
    values = values if colour == "white" else values.cumsum()
    curve = allan_curve(values, 5.0)
    tau, deviation, _, _ = allantools.oadev(values, rate=5.0, data_type="freq", taus=np.array(curve.tau))
    assert tau == pytest.approx(curve.tau)
    assert deviation == pytest.approx(curve.deviation, rel=1e-9)


@pytest.mark.parametrize(("alpha", "slope"), [(0, -1.0), (-1, 0.0), (-2, 1.0)])
@pytest.mark.parametrize(
    "m", [2, 17, 900]
)  # at m = 1 allantools drops the square of SP1065's flicker formula
def test_degrees_of_freedom_are_allantools(alpha: int, slope: float, m: int) -> None:
    assert edf_of(5001, m, slope) == pytest.approx(max(allantools.edf_simple(5001, m, alpha), 1.0), rel=1e-12)


def test_degrees_of_freedom_of_flicker_at_one_sample_are_those_of_sp1065() -> None:
    # SP1065, Table 5: 2 (N - 2)^2 / (2.3 N - 4.9)
    assert edf_of(1001, 1, 0.0) == pytest.approx(2.0 * 999.0**2 / (2.3 * 1001.0 - 4.9))


def test_band_of_white_noise_holds_the_truth_as_often_as_it_says() -> None:
    rng, held = np.random.default_rng(3), []
    for _ in range(200):
        curve = allan_curve(rng.standard_normal(512), 1.0, confidence=0.9)
        truth = 1.0 / np.sqrt(curve.tau)
        held.append((curve.low <= truth) & (truth <= curve.high))
    # points of one curve are not independent: 200 curves of some 6 independent points, 3 standard errors
    assert np.mean(held) == pytest.approx(0.9, abs=3.0 * np.sqrt(0.09 / 1200))


@pytest.mark.parametrize("truth", [(0.025, 0.0025, 1e-4), (1.0, 0.3, 0.02), (3e-3, 1e-3, 2e-5)])
def test_exact_curve_gives_its_own_noise(truth: tuple[float, float, float]) -> None:
    fit = fit_allan(exact(*truth))
    assert pytest.approx(truth, rel=1e-3) == (fit.N, fit.B, fit.K)
    assert fit.deviation(np.array([10.0])) == pytest.approx(
        np.sqrt(truth[0] ** 2 / 10.0 + FLOOR**2 * truth[1] ** 2 + truth[2] ** 2 * 10.0 / 3.0), rel=1e-3
    )


def test_noise_that_a_curve_does_not_show_has_no_error_bar() -> None:
    fit = fit_allan(allan_curve(np.random.default_rng(5).standard_normal(20_000), 10.0))
    assert pytest.approx(1.0 / np.sqrt(10.0), rel=0.03) == fit.N  # 2 % is three errors of 20,000 values
    assert fit.errors[0] < 0.02
    assert np.isinf(fit.errors[2])


def test_factors_rise_and_leave_four_bins() -> None:
    factors = averaging_factors(1000)
    assert factors == sorted(set(factors))
    assert factors[0] == 1
    assert factors[-1] <= 250
    with pytest.raises(ValueError, match="at least 16"):
        allan_curve(np.ones(8), 1.0)
