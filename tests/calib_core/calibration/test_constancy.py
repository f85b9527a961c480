"""A calibration that would mislead is refused, widened or marked: drift, steps, another phone, no test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import f as scipy_f

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.candidate import CalibrateSettings, fit_candidate
from stillcal.calib_core.calibration.constancy import (
    LEAST_SIDE,
    LEVEL,
    Change,
    Shape,
    _excursions,
    _explained,
    find_change,
)
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.full_calibration import FitTask, fit_and_decide
from stillcal.calib_core.engine.schedule import Occasion
from stillcal.calib_core.gravity import STANDARD, Gravity
from stillcal.calib_core.maths.f_distribution import tail
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Charging, End
from stillcal.replay.phone import load_phone, load_scenario, simulate

MG = STANDARD / 1000
NOISE = 2e-4
"""m/s^2, of a rest's mean on each axis: 0.02 mg."""

GRAVITY = Gravity(STANDARD, 1e-6, "given")
BIAS = np.array([0.3, -0.2, 0.1])


def rest(i: int, raw: Array, temperature: float | None = None) -> HeldRest:
    """The i-th rest, a minute after the one before."""
    t, sd = 60.0 * i, frozen(np.full(3, NOISE))
    return HeldRest(
        RestState(t, t + 10.0, 1000, frozen(raw), sd, sd, NOISE, temperature=temperature), GRAVITY
    )


def pool(
    n: int,
    seed: int,
    added: Callable[[int, float], Array] = lambda i, t: np.zeros(3),
    warm: bool = False,
) -> Pool:
    """Rests of a phone in n attitudes all over the sphere, a minute apart; added: to each raw force."""
    rng = np.random.default_rng(seed)
    up = rng.normal(size=(n, 3))
    up *= STANDARD / np.linalg.norm(up, axis=1)[:, None]
    raw = [
        force * (1.01, 0.99, 1.005) + BIAS + added(i, i / (n - 1)) + rng.normal(0.0, NOISE, 3)
        for i, force in enumerate(up)
    ]
    return Pool(tuple(rest(i, r, 20.0 + 5.0 * i / n if warm else None) for i, r in enumerate(raw)), ())


def change(rests: Pool) -> Change | None:
    return fit_candidate(rests, GRAVITY, 1e4, CalibrateSettings()).change


@pytest.mark.parametrize("ratio", [0.0, 1e-3, 0.5, 3.0, 40.0, 1e4])
@pytest.mark.parametrize(("more", "free"), [(1, 1), (3, 9), (9, 13), (3, 500)])
def test_the_tail_of_f_is_scipys(ratio: float, more: int, free: int) -> None:
    assert tail(ratio, more, free) == pytest.approx(float(scipy_f.sf(ratio, more, free)), rel=1e-10)


def test_where_nothing_changes_nothing_is_found() -> None:
    """200 phones of 25 rests: at a level of 0.001 one finding is likely in five such tests, three in none."""
    found = [change(pool(25, seed)) for seed in range(200)]
    assert LEVEL == 1e-3 and sum(c is not None for c in found) <= 2


@pytest.mark.parametrize("where", [0, 3, 12, 24])
def test_one_bad_rest_is_no_change(where: int) -> None:
    for seed in range(10):
        found = change(pool(25, seed, lambda i, t: np.full(3, 5 * MG * (i == where))))
        assert found is None


@pytest.mark.parametrize("warm", [False, True])
def test_a_drift_is_measured_said_and_widens_the_interval_to_hold_either_end(warm: bool) -> None:
    drift = np.array([5.0, 0.0, 0.0]) * MG
    rests = pool(25, 1, lambda i, t: drift * (t - 0.5), warm)
    candidate = fit_candidate(rests, GRAVITY, 1e4, CalibrateSettings())
    found, part = candidate.change, candidate.record.accelerometer
    assert found is not None and found.shape is Shape.DRIFT and part is not None
    assert found.size == pytest.approx(drift, abs=0.3 * MG)
    assert ("as the temperature does" in found.words()) is warm
    for end in (-0.5, 0.5):
        error = part.bias - (BIAS + drift * end)
        assert part.bias_uncertainty is not None
        assert (np.abs(error) < 2 * part.bias_uncertainty).all()


def decided(rests: Pool, occasion: Occasion = Occasion.END, t: float = 2000.0) -> Any:
    confirmed = (True,) * len(rests.held)
    return fit_and_decide(FitTask(t=t, occasion=occasion, pool=rests, confirmed=confirmed, gravity=GRAVITY))


def test_after_a_large_step_only_the_rests_since_count() -> None:
    step = np.array([20.0, 0.0, 0.0]) * MG
    outcome = decided(pool(30, 2, lambda i, t: step * (i >= 15)))
    assert outcome.accepted and outcome.since == pytest.approx(15 * 60.0, abs=61.0)
    assert "only its rests from" in outcome.reason
    part = outcome.record.accelerometer
    assert part.bias == pytest.approx(BIAS + step, abs=0.2 * MG)


@pytest.mark.parametrize(("n", "at"), [(60, 20), (60, 32), (104, 54), (240, 161)])
def test_a_step_between_two_of_the_places_tried_is_found_at_its_own_rest(n: int, at: int) -> None:
    """Of more than 40 rests not every one is tried: a rest of the old sensor would spoil the new fit."""
    step = np.array([20.0, 10.0, -15.0]) * MG
    outcome = decided(pool(n, 2, lambda i, t: step * (i >= at)))
    assert outcome.accepted and outcome.since == 60.0 * at
    assert outcome.record.accelerometer.rms_residual < 2 * NOISE


def test_after_a_large_step_with_too_few_rests_since_nothing_is_fitted() -> None:
    step = np.array([20.0, 0.0, 0.0]) * MG
    outcome = decided(pool(30, 2, lambda i, t: step * (i >= 25)))
    assert outcome.record is None and "another sensor" in outcome.reason and outcome.missing


@pytest.mark.parametrize(("off", "told"), [(2, True), (3, True), (1, False)])
def test_the_newest_rests_of_a_step_too_late_to_be_found_are_said_not_to_fit(off: int, told: bool) -> None:
    """20 mg before the last rests: the fit holds for the time before; one bad rest is no change."""
    step = np.array([20.0, 20.0, 20.0]) * MG
    outcome = decided(pool(30, 2, lambda i, t: step * (i >= 30 - off)))
    assert (outcome.late is not None) is told
    assert ("the newest rests, from 1680 s on, do not fit it" in outcome.reason) is (off == 2)
    assert outcome.record.accelerometer.bias == pytest.approx(BIAS, abs=0.2 * MG)


def test_newest_rests_within_what_a_check_tolerates_are_not_said_to_be_off() -> None:
    slight = np.array([1.0, 1.0, 1.0]) * MG
    assert decided(pool(30, 2, lambda i, t: slight * (i >= 28))).late is None


def test_a_calibration_whose_newest_rests_do_not_fit_is_degraded_at_once() -> None:
    engine = Engine()
    step = np.array([20.0, 20.0, 20.0]) * MG
    held = pool(30, 2, lambda i, t: step * (i >= 27)).held
    engine.add_rests([h.rest for h in held])
    engine.feed(End(2000.0))
    assert engine.state.degraded and engine.state.sound_until == pytest.approx(27 * 60.0)


def test_a_small_step_keeps_all_rests_and_widens_the_interval() -> None:
    step = np.array([3.0, 0.0, 0.0]) * MG
    outcome = decided(pool(30, 2, lambda i, t: step * (i >= 15)))
    part = outcome.record.accelerometer
    assert outcome.since is None and "widens its interval" in outcome.reason
    for before in (0.0, 1.0):
        assert (np.abs(part.bias - BIAS - before * step) < 2 * part.bias_uncertainty).all()


@pytest.mark.parametrize("size_mg", [1.0, 3.0])
def test_a_step_out_and_back_is_said_and_the_interval_holds_both_biases(size_mg: float) -> None:
    """Eight of 25 rests are off, for which no single step stands; without it the bias was 10 sd off."""
    away = np.array([size_mg * MG, 0.0, 0.0])
    for seed in range(10):
        rests = pool(25, seed, lambda i, t: away * (8 <= i < 16))
        candidate = fit_candidate(rests, GRAVITY, 1e4, CalibrateSettings())
        found, part = candidate.change, candidate.record.accelerometer
        assert found is not None and found.shape is Shape.EXCURSION
        assert found.largest == pytest.approx(size_mg * MG, rel=0.25)
        assert abs(found.at - 8 * 60.0) <= 120.0 and abs(found.at + found.span_s - 16 * 60.0) <= 120.0
        assert "and back by" in found.words()
        for bias in (BIAS, BIAS + away):
            assert np.all(np.abs(part.bias - bias) < 3 * part.bias_uncertainty)


def test_the_best_of_many_excursions_is_the_one_that_each_by_itself_would_show() -> None:
    """The running sums give what a fit with three more columns gives, one place after the other."""
    rng = np.random.default_rng(1)
    design, by_bias, residuals = rng.normal(size=(20, 6)), rng.normal(size=(20, 3)), rng.normal(size=20)
    begins, ends = _excursions(20)
    assert (begins >= 1).all() and (ends <= 19).all() and (ends - begins).min() == LEAST_SIDE
    assert (20 - (ends - begins)).min() == LEAST_SIDE
    fell = _explained(residuals, design, by_bias, begins, ends)
    rows = np.arange(20)
    for begin, end, explained in list(zip(begins, ends, fell, strict=True))[::7]:
        extra = by_bias * ((rows >= begin) & (rows < end))[:, None]
        squares = [
            float(np.sum((residuals - d @ np.linalg.lstsq(d, residuals, rcond=None)[0]) ** 2))
            for d in (design, np.hstack((design, extra)))
        ]
        assert explained == pytest.approx(squares[0] - squares[1], rel=1e-9)


def test_as_many_attitudes_as_parameters_are_said_to_be_untested_and_one_more_is_not() -> None:
    faces = np.vstack((np.eye(3), -np.eye(3), [[0.6, 0.6, 0.52]])) * STANDARD
    for n, untested in ((6, True), (7, False)):
        held = [rest(i, force * STANDARD / np.linalg.norm(force) + BIAS) for i, force in enumerate(faces[:n])]
        outcome = decided(Pool(tuple(held), ()), t=500.0)
        sd = outcome.record.accelerometer.bias_uncertainty
        assert ("nothing is left to test it" in outcome.reason) is untested
        assert bool(sd.min() > 0.5 * MG) is untested


def test_a_change_between_two_checks_is_noticed_at_the_next_review() -> None:
    """Calibrated, then 20 mg: degraded within minutes of two rests, though the check is due in an hour."""
    simulation = simulate(load_scenario("lab"), load_phone("typical"), 1)
    engine, noticed, calibrated = Engine(), None, None
    for chunk in simulation.chunks():
        accel = chunk.accelerometer
        late = accel.t >= 430.0
        xyz = accel.xyz + np.array([20.0, 0.0, 0.0]) * MG * late[:, None]
        events = [] if calibrated is not None or accel.t[-1] < 350.0 else [Charging(float(accel.t[0]), True)]
        engine.feed(chunk.gyroscope, replace(accel, xyz=frozen(xyz)), *events)
        if engine.state.calibrated and calibrated is None:
            calibrated = float(accel.t[-1])
            engine.feed(Charging(float(accel.t[-1]), False))
        if noticed is None and engine.state.counters.degradations:
            noticed = float(accel.t[-1])
    assert calibrated is not None and calibrated < 430.0
    assert noticed is not None and noticed < 600.0


def test_too_few_rests_to_tell_are_not_asked() -> None:
    rests = pool(9, 3)
    candidate = fit_candidate(rests, GRAVITY, 1e4, CalibrateSettings())
    assert find_change(candidate.accelerometer, rests.held) is None
