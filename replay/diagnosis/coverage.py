"""What a recording let be checked, and what not and why: silence about the unchecked would read as praise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.rotation_alignment import LEAST_TURNS
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.regressors import LEAST_SPAN
from stillcal.calib_core.static.rest import attitude_labels
from stillcal.replay.diagnosis.wording import counted

ATTITUDE_ANGLE = 0.2
"""Attitudes further apart than this count as different, rad."""

LEAST_PIECES = 3
"""Still bins that noise and spectra are taken from, at least."""


NEVER_STILL = (
    "the phone never lies still for long enough: bias, scale, temperature and noise could not be checked at"
    " all; what is said is about stamps, values and motion"
)


@dataclass(frozen=True, slots=True)
class Check:
    """One family of departures. how: what it was checked on, or why it could not be."""

    what: str
    done: bool
    how: str


@dataclass(frozen=True, slots=True)
class Facts:
    """What a recording offers. attitudes: number of distinct ones; switches: of the charger."""

    samples: int
    bins: int
    rests: int
    attitudes: int
    still_s: float
    kelvin: float | None
    switches: int | None
    gyroscope: bool
    arrivals: bool
    stamps: bool


def facts_of(bins: Bins, samples: int, *, arrivals: bool = False, stamps: bool = True) -> Facts:
    """Count what the still bins of a recording offer; samples: of the accelerometer, 0 for a rest table."""
    attitudes = len(np.unique(attitude_labels(bins.force, ATTITUDE_ANGLE))) if len(bins) else 0
    switches = None if bins.charging_switches is None else len(bins.charging_switches) - 1
    kelvin = None if bins.temperature is None else float(np.ptp(bins.temperature))
    rests = len(np.unique(bins.rest))
    still = float(bins.duration.sum())
    return Facts(
        samples, len(bins), rests, attitudes, still, kelvin, switches, bins.rate is not None, arrivals, stamps
    )


def checks(facts: Facts) -> list[Check]:
    """Return every family of departures with what it was checked on."""
    return [*_of_samples(facts), *_slow(facts), *_of_gyroscope(facts)]


def _of_samples(facts: Facts) -> list[Check]:
    if facts.samples == 0:
        why = "a table of rests holds no samples"
        return [Check("stamps, noise, values, vibration", False, why)]
    clock = "against the host's clock" if facts.arrivals else "no arrival times: the nominal rate only"
    quiet = facts.bins >= LEAST_PIECES
    still = counted(facts.bins, "still bin")
    noise = still if quiet else f"{still}, {LEAST_PIECES} are needed"
    return [
        Check("stamps: jitter, drops, clock", True, clock),
        Check("arrival in bursts", facts.arrivals, "arrival times" if facts.arrivals else "no arrival times"),
        Check("noise, bandwidth, steps and limits of values", quiet, noise),
        Check("vibration", True, "steady stretches of 8 s and more, where there are enough"),
    ]


def _slow(facts: Facts) -> list[Check]:
    enough = facts.bins >= thresholds.LEAST_BINS
    still = counted(facts.bins, "still bin")
    long = f"{still} in {counted(facts.rests, 'rest')}, {facts.still_s / 60.0:.0f} min"
    short = f"{still}, {thresholds.LEAST_BINS} are needed: let the phone lie"
    bins = [Check("slow bias at rest", enough, long if enough else short)]
    if not facts.stamps:
        bins = [Check("bias and scale between rests", enough, long if enough else short)]
        bins.append(Check("drift, warm-up, steps in time", False, "the table's rows have no time"))
    return [
        *bins,
        Check("temperature", enough and (facts.kelvin or 0.0) >= LEAST_SPAN, _thermometer(facts)),
        Check("charging", enough and (facts.switches or 0) > 0, _charger(facts)),
        Check(
            "accelerometer nonlinearity",
            enough and facts.attitudes >= 6,
            f"{counted(facts.attitudes, 'attitude')}, 6 are needed",
        ),
    ]


def _thermometer(facts: Facts) -> str:
    if facts.kelvin is None:
        return "no temperature was recorded"
    return f"it varied by {facts.kelvin:.1f} K, {LEAST_SPAN} K are needed"


def _charger(facts: Facts) -> str:
    return (
        "no charging events"
        if not facts.switches
        else "the charger switched " + counted(facts.switches, "time")
    )


def _of_gyroscope(facts: Facts) -> list[Check]:
    if not facts.gyroscope:
        return [Check("gyroscope, and time between the sensors", False, "no gyroscope was recorded")]
    enough = facts.bins >= thresholds.LEAST_BINS
    between = facts.rests - 1
    attitudes = f"{counted(facts.attitudes, 'attitude')}, 4 are needed"
    checked = [Check("gyroscope's sensitivity to force", enough and facts.attitudes >= 4, attitudes)]
    if facts.samples == 0:
        return [*checked, Check("gyroscope's scale, time offset", False, "a table of rests holds no motion")]
    turns = f"at most {counted(max(between, 0), 'turn')} from rest to rest, {LEAST_TURNS} are needed"
    return [*checked, Check("gyroscope's scale and linearity, lever arm", between >= LEAST_TURNS, turns)]


def limits(facts: Facts) -> list[str]:
    """Say in words what could not be checked at all, beside what the diagnosis says itself."""
    if facts.bins == 0:
        return [NEVER_STILL]
    if facts.samples == 0:
        texts = ["a table of rests: stamps, noise, values, vibration and motion could not be checked"]
        return (
            texts if facts.stamps else [*texts, "its rows have no time: nothing that follows time was tried"]
        )
    return []
