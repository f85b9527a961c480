"""The gyroscope's bias alone, before the rests support a full calibration.

One rest shows a gyroscope's bias, while an accelerometer needs many attitudes. The bias is therefore
published after the first good rests. It is provisional, because a bias moves while the phone warms up after
its start: a rest START_UP_S later confirms it or replaces it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.calibration.candidate import gyroscope_record, validity_of
from stillcal.calib_core.calibration.drift_check import Drift, QualitySettings, check_gyroscope
from stillcal.calib_core.calibration.record import Acceptance, CalibrationRecord, Provenance
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.model import SensorModel

START_UP_S = 300.0
"""s: a rest that ends so long after the first one began can confirm the bias. A phone's board warms up within
minutes of its start."""


def first_bias(
    rests: Pool, gravity: Gravity, t: float, settings: QualitySettings
) -> CalibrationRecord | None:
    """Return a provisional calibration of the gyroscope's bias from the first rests, at sample time t (s).

    None where no rest has a rate, or where the bias is more uncertain than drift may be (gyro_limit).
    """
    return _measured(rests, gravity, t, settings, "provisional until a later rest confirms it")


def followed_up(
    record: CalibrationRecord, rests: Pool, t: float, settings: QualitySettings
) -> CalibrationRecord | None:
    """Return a provisional calibration confirmed by later rests, or replaced where they disagree.

    rests: all that are held. None where there is no later rest, or only one too soon to confirm it.
    """
    assert record.gyroscope is not None
    later = _with_rates(rests.since(record.provenance.t_end))
    if not later.held:
        return None
    began, gravity = record.provenance.t_start, record.gravity or Gravity()
    if check_gyroscope(record.gyroscope.bias, later.held, settings) is Drift.DRIFTED:
        return _measured(later, gravity, t, settings, "the bias has moved since the start; provisional again")
    if began is None or later.rests[-1].t_end - began < START_UP_S:
        return None
    confirmed = _measured(rests.since(began), gravity, t, settings, "confirmed by a later rest")
    if confirmed is None:
        return None
    return replace(confirmed, acceptance=replace(confirmed.acceptance, evidence={}))


def _measured(
    rests: Pool, gravity: Gravity, t: float, settings: QualitySettings, remark: str
) -> CalibrationRecord | None:
    """Return a provisional calibration of the gyroscope's bias from all rests that have a rate."""
    measured = _with_rates(rests)
    if not measured.held:
        return None
    fit = gyroscope.fit([], SensorModel.identity(), gravity.value, rests=measured.rests)
    if np.sqrt(np.diag(fit.bias.covariance)).max() > settings.gyro_limit:
        return None
    n = len(measured.held)
    reason = f"gyroscope bias alone, measured on {n} rest{'' if n == 1 else 's'}; {remark}"
    return CalibrationRecord(
        gyroscope=gyroscope_record(fit, t),
        gravity=gravity,
        fitted_at=t,
        validity=validity_of(measured.rests),
        acceptance=Acceptance(how="zeroing", reason=reason, evidence={"provisional": True}),
        provenance=Provenance(t_start=measured.rests[0].t_start, t_end=measured.rests[-1].t_end),
    )


def _with_rates(rests: Pool) -> Pool:
    return rests.where(lambda rest: rest.rate is not None)
