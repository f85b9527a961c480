"""What a low-pass of one sensor does to motion: it delays it, and looks like a delay or like a lever arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from stillcal.calib_core.diagnosis.model.measurement import HeldOut, Seen
from stillcal.calib_core.diagnosis.model.records import Alternative, Finding, Where
from stillcal.calib_core.diagnosis.noise.low_pass import LowPass, Spectra, low_pass_finding

DELAY = "accel_gyro_time_offset"

AS_LATE = 2.0
"""Factor within which a delay is that of the low-pass seen: close below half the rate orders are hard to tell
apart, and the second delays by half as much as the fourth."""

MOST = 3.0
"""A low-pass delays by less than so many times 1 / (2 pi cutoff), up to the fourth order."""


def low_pass_for_delay(found: list[Finding], spectra: Mapping[str, Spectra]) -> list[Finding]:
    """Name the low-pass that one sensor's noise shows and a delay between the sensors confirms.

    Many a sound phone has such a filter on both sensors, which then do not differ. On one of them alone it
    delays that one, so the delay is its evidence. spectra: at rest, by sensor.
    """
    late = {s: _late(one.low_pass) for s, one in spectra.items() if one.low_pass is not None}
    if not late or any(f.effect == "bandwidth" for f in found):
        return found
    expected = late.get("gyro", 0.0) - late.get("accel", 0.0)
    sensor = "gyro" if expected > 0.0 else "accel"

    def named(one: Finding) -> Finding:
        if one.effect != DELAY:
            return one
        times = float(np.asarray(one.parameters["delay"].value)) / expected
        return _named(one, spectra[sensor], sensor) if 1.0 / AS_LATE < times < AS_LATE else one

    return [named(one) for one in found] if expected != 0.0 else found


def _late(low_pass: LowPass) -> float:
    """Return by how much a Butterworth low-pass of order n delays slow motion, s.

    1 / (2 pi cutoff sin(pi / 2n)), the slope of its phase at zero frequency.
    """
    return float(1.0 / (2.0 * np.pi * low_pass.cutoff.value * np.sin(np.pi / (2.0 * low_pass.order))))


def _named(delay: Finding, spectrum: Spectra, sensor: str) -> Finding:
    """Return a low-pass in the place of the delay that it causes; stamps that are late would cause it too."""
    where = Where(delay.where.t_start, delay.where.t_end, (0.0, spectrum.rate / 2.0), "noise at rest")
    own = delay.evidence
    held = None
    if own.heldout_log_score_gain is not None:
        before, after = own.heldout_rmse_before or 0.0, own.heldout_rmse_after or 0.0
        held = HeldOut(own.heldout_log_score_gain, before, after)
    seen = Seen(own.log_bayes_factor, held)
    others = [Alternative(DELAY, own.heldout_log_score_gain or 0.0, True)]
    return low_pass_finding(spectrum, sensor, where, seen, others) or delay


def without_group_delay(found: Sequence[Finding], gravity: float) -> list[Finding]:
    """Drop what a low-pass found on one sensor does to motion: delays, and what looks like a lever arm.

    A second-order filter delays slow motion by sqrt(2) / (2 pi fc), a first-order one by 1 / (2 pi fc). To
    second order it takes gravity's own curvature for as much of an arm as gravity / (2 pi fc)^2.
    """
    cutoffs = [f for f in found if f.effect == "bandwidth"]
    if len(cutoffs) != 1:
        return list(found)
    late = 1.0 / (2.0 * np.pi * np.asarray(cutoffs[0].parameters["cutoff"].value))
    sign = -1.0 if cutoffs[0].sensor == "accel" else 1.0

    def explained(one: Finding) -> bool:
        if one.effect == "lever_arm":
            return bool(np.linalg.norm(one.parameters["position"].value) < gravity * late**2)
        # Fast motion, which a low-pass keeps out, is delayed less: the delay goes with what motion there is.
        if one.sensor == "timing" and "growth" in one.parameters:
            return bool(abs(np.asarray(one.parameters["growth"].value)) < MOST * late)
        delayed = one.effect == DELAY
        return delayed and bool(0.0 < sign * np.asarray(one.parameters["delay"].value) / late < MOST)

    return [f for f in found if not explained(f)]
