"""A full calibration: which rests are used, what is said of them, and when nothing is fitted."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.engine.full_calibration import (
    LEAST_UNSEEN_S,
    FitOutcome,
    FitTask,
    _rank,
    fit_and_decide,
)
from stillcal.calib_core.engine.schedule import Occasion
from tests.calib_core.calibration.test_constancy import GRAVITY, MG, pool
from tests.calib_core.calibration.test_fingerprint import replace_force

LAST = 24 * 60.0 + 10.0
"""End of the last of 25 rests, s; the first begins at 0."""


def decided(rests: Pool, **known: Any) -> FitOutcome:
    """Fit and decide; where nothing else is said all are confirmed, and the recording ends with the last."""
    usual: dict[str, Any] = {"t": LAST, "occasion": Occasion.END, "confirmed": (True,) * len(rests.held)}
    return fit_and_decide(FitTask(pool=rests, gravity=GRAVITY, **usual | known))


def quicker(rests: Pool) -> Pool:
    """Return the rests ten times as close: 25 of them within 145 s."""
    held = [
        replace(h, rest=msgspec.structs.replace(h.rest, t_start=h.rest.t_start / 10, t_end=h.rest.t_end / 10))
        for h in rests.held
    ]
    return replace(rests, held=tuple(held))


def test_too_few_rests_are_refused_with_what_is_missing() -> None:
    outcome = decided(pool(3, 1))
    assert outcome.record is None and not outcome.accepted
    assert outcome.reason and outcome.missing


@pytest.mark.parametrize(
    ("rests", "gap", "occasion", "said"),
    [
        (pool(25, 1), LAST, Occasion.END, ""),
        (pool(25, 1), LAST + 1.0, Occasion.END, "no rest in the last 1451 s"),
        (pool(25, 1), LAST + 1.0, Occasion.CHARGING, ""),
        (quicker(pool(25, 1)), LEAST_UNSEEN_S - 0.5, Occasion.END, ""),
        (quicker(pool(25, 1)), LEAST_UNSEEN_S + 1.0, Occasion.END, "no rest in the last 301 s"),
    ],
)
def test_a_recording_that_goes_on_for_long_without_a_rest_is_said_to(
    rests: Pool, gap: float, occasion: Occasion, said: str
) -> None:
    assert LEAST_UNSEEN_S == 300.0
    outcome = decided(rests, t=rests.held[-1].rest.t_end + gap, occasion=occasion)
    assert outcome.accepted and (said in outcome.reason if said else "no rest" not in outcome.reason)


@pytest.mark.parametrize("gain", [1.0, 1.005])
def test_after_a_failed_check_older_rests_stay_only_where_one_calibration_explains_all(gain: float) -> None:
    """The scale of x changes; the bias does not, by whose steps another sensor is told."""
    rests = pool(50, 3)
    newer = [replace(h, rest=replace_force(h.rest, np.diag([gain, 1.0, 1.0]))) for h in rests.held[25:]]
    rests = replace(rests, held=(*rests.held[:25], *newer))
    outcome = decided(rests, t=3000.0, degraded=True, sound_until=1500.0)
    part = outcome.record.accelerometer
    assert (outcome.since, part.n_rests) == ((None, 50) if gain == 1.0 else (1500.0, 25))
    assert part.scale[0, 0] == pytest.approx(1.0 / (1.01 * gain), abs=1e-4)
    assert "the sensor changed" not in outcome.reason
    sound = decided(rests, t=3000.0, sound_until=1500.0)
    assert (sound.since, sound.record.accelerometer.n_rests) == (None, 50)


@pytest.mark.parametrize(("off", "used"), [(20.0, 17), (5.0, 17), (0.0, 25)])
def test_doubtful_rests_that_scatter_are_left_out_and_others_are_used(off: float, used: int) -> None:
    """Eight of 25 are doubtful, by so many mg; with 20 mg all 25 together support no fit."""
    rng = np.random.default_rng(5)
    rests = pool(25, 4, lambda i, t: off * MG * rng.normal(size=3) * (i >= 17))
    outcome = decided(rests, confirmed=tuple(i < 17 for i in range(25)))
    assert outcome.accepted and outcome.record.accelerometer.n_rests == used


def test_where_confirmed_rests_alone_support_no_fit_all_are_used() -> None:
    outcome = decided(pool(25, 4), confirmed=tuple(i < 3 for i in range(25)))
    assert outcome.accepted and outcome.record.accelerometer.n_rests == 25


def test_fits_without_a_prior_come_first_then_more_parameters_then_the_less_uncertain() -> None:
    def fit(with_prior: bool, parameters: int, uncertainty: float) -> Any:
        return SimpleNamespace(
            with_prior=with_prior, parameters=parameters, worst_norm_uncertainty=uncertainty
        )

    best_first = [fit(False, 9, 2.0), fit(False, 9, 3.0), fit(False, 6, 1.0), fit(True, 9, 0.5)]
    assert sorted(reversed(best_first), key=_rank) == best_first
