"""The whole diagnosis of one recording: arrays in, findings out."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from stillcal.calib_core.events import Charging
from stillcal.calib_core.misfit import thresholds
from stillcal.calib_core.misfit.bins import Bins, cut
from stillcal.calib_core.misfit.motion import motion_findings
from stillcal.calib_core.misfit.records import Claims, Diagnosis, Finding, Where, verdict_of
from stillcal.calib_core.misfit.scenes import scenes
from stillcal.calib_core.misfit.slow import slow_findings, turn_findings
from stillcal.calib_core.misfit.spectrum import noise_findings, noise_levels, quiet, tone
from stillcal.calib_core.misfit.timing import timing_findings
from stillcal.calib_core.misfit.values import comb_step, quantisation, saturation
from stillcal.calib_core.refusals import NotSupported
from stillcal.calib_core.samples import Samples

__all__ = ["Claims", "Diagnosis", "diagnose", "limits"]


def diagnose(
    accelerometer: Samples,
    gyroscope: Samples | None,
    events: Sequence[Charging] = (),
    claims: Claims | None = None,
    recording: str = "",
    *,
    without: Collection[str] = (),
) -> Diagnosis:
    """Say where a recording and its simulated twin differ, and what physics was left out.

    without: effects of which the catalogue knows nothing, to try what their cases are then called.
    Raises NotSupported where not even the stamps can be judged (fewer than 200 samples).
    """
    if len(accelerometer) < 200:
        raise NotSupported(f"{len(accelerometer)} samples of the accelerometer", ("at least 200",))
    claims = claims or Claims()
    bins = cut(accelerometer, gyroscope, events)
    found = timing_findings(accelerometer, claims)
    for sensor, samples in (("accel", accelerometer), ("gyro", gyroscope)):
        if samples is not None and len(samples) >= 200:
            found += _sample_findings(sensor, samples, bins, claims)
    made = scenes(bins, claims.gravity) if len(bins) else []
    found += [f for scene in made for f in slow_findings(scene, without)]
    if gyroscope is not None:
        found += motion_findings(accelerometer, gyroscope, bins, claims)
        if len(bins):
            found += turn_findings(accelerometer, gyroscope, bins, claims.gravity, without)
    found = [f for f in without_group_delay(found) if f.effect not in without]
    return Diagnosis(1, recording, verdict_of(found), found, limits(bins))


def _sample_findings(sensor: str, samples: Samples, bins: Bins, claims: Claims) -> list[Finding]:
    still = quiet(samples, bins)
    if len(still.pieces) < 3:
        return []
    levels = noise_levels(still)
    span = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, still.rate / 2.0), "noise at rest")
    lsb = claims.accel_lsb if sensor == "accel" else claims.gyro_lsb
    declared = claims.accel_range if sensor == "accel" else claims.gyro_range
    comb = quantisation(samples, sensor, levels.sd, lsb)
    # Noise that hides in a coarse step has no level, tails or bandwidth of its own.
    step = max(comb_step(samples.xyz[:, a]) or 0.0 for a in range(3))
    found = noise_findings(still, levels, sensor, claims, span, step=step) if comb is None else [comb]
    extra = (
        saturation(samples, sensor, np.maximum(levels.sd, 1e-9), declared),
        tone(samples, sensor) if sensor == "accel" else None,
    )
    return [*found, *(f for f in extra if f is not None)]


def without_group_delay(found: list[Finding]) -> list[Finding]:
    """Drop a time offset that a low-pass found on one sensor explains: sqrt(2) / (2 pi fc), within a half.

    A second-order filter delays slow motion by that much; a first-order one by 1 / (2 pi fc).
    """
    cutoffs = [f for f in found if f.effect == "bandwidth"]
    offsets = [f for f in found if f.effect == "accel_gyro_time_offset"]
    if len(cutoffs) != 1 or not offsets:
        return found
    cutoff, delay = cutoffs[0].parameters["cutoff"].value, offsets[0].parameters["delay"].value
    assert isinstance(cutoff, float) and isinstance(delay, float)
    expected = (-1.0 if cutoffs[0].sensor == "accel" else 1.0) / (2.0 * np.pi * cutoff)
    explained = 0.5 < delay / expected < 2.1
    return [f for f in found if f is not offsets[0]] if explained else found


def limits(bins: Bins) -> list[str]:
    """Say what this recording cannot show."""
    said = []
    if len(bins) < thresholds.LEAST_BINS:
        said.append(
            f"{len(bins)} still bins of 10 s: slow effects need {thresholds.LEAST_BINS}; let the phone lie"
        )
    if bins.rate is None:
        said.append("no gyroscope: nothing is said of it, nor of the time between the sensors")
    if bins.temperature is None:
        said.append("no temperature: thermal effects are only seen through charging and use")
    if len(np.unique(bins.rest)) < 6:
        said.append("fewer than six rests: scale, nonlinearity and g-sensitivity are not separable from bias")
    return said
