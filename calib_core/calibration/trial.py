"""Terms that a diagnosis proposes, tested on rests that came after it.

A diagnosis fits a term to the rests that it saw. Whether the calibration takes the term up is decided by
later rests: each is predicted from the rests before it, with the term and without. The term is taken up
where they are predicted better by more than chance, hour by hour, and one in use is dropped where they are
predicted worse. Temperature needs no trial: its curve is fitted at every check (calibration/bias_curve).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.acceptance import flipped_share
from stillcal.calib_core.calibration.bias_curve.evidence import BLOCK_S
from stillcal.calib_core.calibration.bias_curve.learn import learn_gyroscope
from stillcal.calib_core.calibration.bias_curve.learnt import DROPPED, TAKEN_UP, Learnt
from stillcal.calib_core.calibration.corrections.catalogue import ADOPTABLE, CORRECTIONS, check_terms
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.following import with_learnt_gyroscope
from stillcal.calib_core.calibration.record import Acceptance, CalibrationRecord, Evidence
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.memory import Memory

TESTED = tuple(
    effect
    for effect in ADOPTABLE
    if (correction := CORRECTIONS[effect]).sensor is Sensor.GYROSCOPE
    and not (correction.of_reading or correction.by_start or correction.has_forecast)
)
"""Effects that a trial can decide on: those of the gyroscope's bias whose driver a rest keeps.

A rest shows none of what follows the rate, and does not say how long the sensors were on. What the
accelerometer reads at rest is a length, which bias and scale make together: its effects change both.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A term under test. since: s; only rests after this time count, because none before it is held out."""

    term: Term
    since: float

    def __post_init__(self) -> None:
        check_terms([self.term])


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """A trial's outcome. record: with the change carried out, None without one.

    decided: whether enough hours with rests have passed. What is decided and changes nothing is over.
    """

    record: CalibrationRecord | None
    decided: bool


def is_held(record: CalibrationRecord, effect: str) -> bool:
    """Tell whether a calibration corrects an effect."""
    return any(term.effect == effect for term in record.terms)


def judge(
    trial: Trial, record: CalibrationRecord, memory: Memory, t: float, settings: QualitySettings
) -> Outcome:
    """Decide at t (s) whether the term on trial is taken up or, where it is in use, dropped."""
    others = tuple(term for term in record.terms if term.effect != trial.term.effect)
    held = is_held(record, trial.term.effect)
    records = replace(record, terms=others), replace(record, terms=(*others, trial.term))
    without, with_term = (learn_gyroscope(memory, r, t, settings) for r in records)
    if without is None or with_term is None:
        return Outcome(None, False)
    better, figures = _compared(without, with_term, trial.since)
    if better.size < settings.held_out_rests:
        return Outcome(None, False)
    chance = flipped_share(-better if held else better)
    if chance > settings.chance:
        return Outcome(None, True)
    change, changed, learnt = (DROPPED, records[0], without) if held else (TAKEN_UP, records[1], with_term)
    reason = (
        f"{trial.term.effect} {change}: over {better.size} hours since it was found, rests are typically "
        f"predicted to {figures['typical_with']:.2g} rad/s with it, {figures['typical_without']:.2g} without"
    )
    evidence: Evidence = {"hours": better.size, "chance": chance, **figures}
    acceptance = Acceptance(how="terms", reason=reason, evidence=evidence)
    return Outcome(replace(with_learnt_gyroscope(changed, learnt, t), acceptance=acceptance), True)


def _compared(without: Learnt, with_term: Learnt, since: float) -> tuple[Array, dict[str, float]]:
    """Return what the term gains in each hour after `since` (s), (n,) nats, and the figures."""
    after = with_term.t > since
    errors = [learnt.errors[after] for learnt in (without, with_term)]
    own = np.minimum(without.errors_sd, with_term.errors_sd)[after] ** 2
    gains = np.log((errors[0] ** 2 + own) / (errors[1] ** 2 + own))
    if not gains.size:
        return np.zeros(0), {}
    _, hour = np.unique(np.floor(with_term.t[after] / BLOCK_S), return_inverse=True)
    figures = {"gain": float(gains.sum())}
    figures |= {
        f"typical_{name}": float(np.median(error))
        for name, error in zip(("without", "with"), errors, strict=True)
    }
    return np.bincount(hour, gains).astype(np.float64), figures
