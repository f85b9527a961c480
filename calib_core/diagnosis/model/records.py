"""What a diagnosis is told and what it answers: plain records that encode to the documented JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stillcal.calib_core.gravity import STANDARD

AXES = ("x", "y", "z")
NAME = {"accel": "accelerometer", "gyro": "gyroscope"}
"""What a person calls a sensor."""

FARTHER = 1.1
"""Ratio of held-out errors, rms, from which they have grown: two standard errors of 200 bins."""

AT_REST = "noise at rest"
"""What drives an effect that the noise of the rests shows."""

SLOW_BAND = (0.0, 0.05)
"""Frequencies that means over bins of 10 s and more can show, Hz."""

Number = float | list[float] | list[list[float]]


@dataclass(frozen=True, slots=True)
class Claims:
    """What the maker says of the phone; None where it is silent. SI units, densities per sqrt(Hz)."""

    nominal_rate_hz: float | None = None
    gravity: float = STANDARD
    accel_range: float | None = None
    gyro_range: float | None = None
    accel_lsb: float | None = None
    gyro_lsb: float | None = None
    accel_noise_density: float | None = None
    gyro_noise_density: float | None = None


@dataclass(frozen=True, slots=True)
class Parameter:
    """A fitted parameter: value and 95 % interval of the same nesting, in `unit`."""

    value: Number
    ci95: Any
    unit: str


@dataclass(frozen=True, slots=True)
class Where:
    """Where an effect shows itself: s of the recording's stamps, Hz, and what it follows."""

    t_start: float
    t_end: float
    band_hz: tuple[float, float]
    driver: str


@dataclass(frozen=True, slots=True)
class Evidence:
    """How sure. log_bayes_factor: nats for the effect against none; rmse in the sensor's unit.

    heldout_log_score_gain: nats, of what was left out in `folds` folds; heldout_gain_in_one_noise: nats, the
    same with the effect's noise in both models, None where these have no noise of their own. named_in_folds:
    in how many folds the effect would have been chosen before its rivals without what is left out. What has
    no meaning for an effect is None: nothing is predicted of an effect that is certain by counting.
    """

    log_bayes_factor: float
    heldout_rmse_before: float | None = None
    heldout_rmse_after: float | None = None
    heldout_log_score_gain: float | None = None
    folds: int = 0
    named_in_folds: int | None = None
    heldout_gain_in_one_noise: float | None = None

    @property
    def contradicted(self) -> bool:
        """Whether what was left out of the fit is predicted no better with the effect than without it.

        That is, if it is no likelier or plainly farther from what is predicted: a score in which the noise is
        fitted anew may rise though an effect misses, for it then has larger noise to miss with. In one noise
        the score says which is farther; of noise that wanders the rms says little, for neighbours miss alike.
        """
        if self.heldout_log_score_gain is None:
            return False
        if self.heldout_gain_in_one_noise is not None:
            return min(self.heldout_log_score_gain, self.heldout_gain_in_one_noise) <= 0.0
        before, after = self.heldout_rmse_before or 0.0, self.heldout_rmse_after or 0.0
        return self.heldout_log_score_gain <= 0.0 or after > FARTHER * before


@dataclass(frozen=True, slots=True)
class Alternative:
    """Another effect that was considered for the same structure."""

    effect: str
    heldout_log_score_gain: float
    indistinguishable: bool


UNKNOWN = "Unknown effect"
"""How the statement of a finding without a name begins that tells no more than what it follows."""


def only_unknown(of: str, follows: str) -> str:
    """Return the statement of a finding without a name. of: "on", what and where; follows: its driver."""
    return f"{UNKNOWN} {of}; it follows {follows}."


@dataclass(frozen=True, slots=True)
class Departure:
    """How an effect departs from the form that its name gives, if it does.

    log_bayes_factor: nats for an open form against the name's own, as likely beforehand; part: of the
    effect's amplitude at rest that the likeliest departure has; way: what that is, in words.
    """

    log_bayes_factor: float
    part: float
    way: str

    @property
    def probability(self) -> float:
        """The probability that the name's own form is not kept."""
        return float(1.0 / (1.0 + np.exp(-min(self.log_bayes_factor, 700.0))))


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that an ideal sensor does not do.

    departure: None where its name's form holds; remark: what else is to be known of it, in sentences.
    echoes: what another sensor has of it, which is told in the remark.
    """

    effect: str
    sensor: str
    axes: list[str]
    where: Where
    parameters: dict[str, Parameter]
    evidence: Evidence
    alternatives: list[Alternative]
    statement: str
    departure: Departure | None = None
    remark: str = ""
    echoes: tuple[Finding, ...] = ()

    @property
    def observed(self) -> str:
        """What was observed of something without a name, in words; "" where only its driver is known."""
        told = self.effect == "unknown" and not self.statement.startswith(UNKNOWN)
        return self.statement if told else ""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What one recording shows beside constant bias and scale."""

    recording: str
    findings: list[Finding]
