"""Which checks a recording allows, which it does not, and why.

A check that was not made is listed with the condition that failed: without that, "no difference found" would
read as if everything had been checked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.diagnosis.effects.temperature import LEAST_SPAN
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.rotation_alignment import LEAST_TURNS
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.static.rest import attitude_labels
from stillcal.replay.diagnosis.wording import counted

ATTITUDE_ANGLE = 0.2
"""Attitudes further apart than this count as different, rad: the angle of the diagnosis itself."""

LEAST_PIECES = 3
"""Static bins that noise and spectra are taken from, at least."""

NONLINEARITY_ATTITUDES, FORCE_ATTITUDES = 6, 4
"""Attitudes needed beside the affine model: for nonlinearity, and for the gyroscope's g-sensitivity."""


@dataclass(frozen=True, slots=True)
class Check:
    """One family of effects. done: whether it could be checked; how: on what, or why not."""

    what: str
    done: bool
    how: str


@dataclass(frozen=True, slots=True)
class Facts:
    """What a recording offers.

    samples: of the accelerometer, 0 for a table of rests. bins: number of static bins; still_s: s, their
    length in all. attitudes: number of distinct ones. kelvin: K, span of temperature over the static bins,
    None where it is not known. switches: how often the charger was switched, None without events.
    thermometer, gyroscope, arrivals, stamps: whether temperatures, rates, arrival times and times of rows
    were recorded. rates: whether the rate at rest is known.
    """

    samples: int
    bins: int
    rests: int
    attitudes: int
    still_s: float
    kelvin: float | None
    switches: int | None
    thermometer: bool
    gyroscope: bool
    rates: bool
    arrivals: bool
    stamps: bool


def facts_of(
    bins: Bins,
    samples: int,
    *,
    arrivals: bool = False,
    stamps: bool = True,
    thermometer: bool | None = None,
    gyroscope: bool | None = None,
) -> Facts:
    """Count what the static bins of a recording offer.

    samples: of the accelerometer, 0 for a table of rests. thermometer, gyroscope: whether the recording has
    these columns; None to take it from the bins.
    """
    attitudes = len(np.unique(attitude_labels(bins.force, ATTITUDE_ANGLE))) if len(bins) else 0
    return Facts(
        samples=samples,
        bins=len(bins),
        rests=len(np.unique(bins.rest)),
        attitudes=attitudes,
        still_s=float(bins.duration.sum()),
        kelvin=None if bins.temperature is None else float(np.ptp(bins.temperature)),
        switches=None if bins.charging_switches is None else len(bins.charging_switches) - 1,
        thermometer=bins.temperature is not None if thermometer is None else thermometer,
        gyroscope=bins.rate is not None if gyroscope is None else gyroscope,
        rates=bins.rate is not None,
        arrivals=arrivals,
        stamps=stamps,
    )


def checks(facts: Facts) -> list[Check]:
    """Return every family of effects with whether it could be checked and why not."""
    return [*_of_samples(facts), *_slow(facts), *_of_gyroscope(facts)]


Condition = tuple[bool, str]
"""Whether a condition holds, and the sentence that says why the check is not possible where it does not."""


def _check(what: str, how: str, *conditions: Condition) -> Check:
    """Return a check with the first condition that fails as its reason, or with `how` where all hold."""
    reason = next((why for holds, why in conditions if not holds), None)
    return Check(what, reason is None, how if reason is None else reason)


def _of_samples(facts: Facts) -> list[Check]:
    if facts.samples == 0:
        return [Check("time stamps, noise, values, vibration", False, "a table of rests has no samples")]
    clock = "against the host's clock" if facts.arrivals else "against the nominal rate (no arrival times)"
    quiet = (facts.bins >= LEAST_PIECES, f"{_still(facts)}, {LEAST_PIECES} are needed")
    return [
        Check("time stamps: jitter, missing samples, clock rate", True, clock),
        _check("arrival in bursts", "arrival times", (facts.arrivals, "no arrival times were recorded")),
        _check("noise, bandwidth, quantisation and saturation", _still(facts), quiet),
        Check("vibration", True, "steady segments of 8 s and more, where there are enough"),
    ]


def _still(facts: Facts) -> str:
    return f"{counted(facts.bins, 'static interval')} ({facts.still_s:.0f} s at rest)"


def _enough_rest(facts: Facts) -> Condition:
    """Return whether there are bins enough for slow effects, with how much rest they would need."""
    least = thresholds.LEAST_BINS
    if facts.samples == 0:
        return facts.bins >= least, f"only {counted(facts.bins, 'rest')}, {least} are needed"
    if facts.bins == 0:
        return False, "the phone never lies still"
    needed = facts.still_s * least / facts.bins
    return facts.bins >= least, f"only {facts.still_s:.0f} s at rest, {needed:.0f} s are needed"


def _slow(facts: Facts) -> list[Check]:
    rest = _enough_rest(facts)
    between = f"{_still(facts)} in {counted(facts.rests, 'rest')}"
    bias = [_check("slow changes of bias at rest", between, rest)]
    if not facts.stamps:
        bias = [
            _check("bias and scale between rests", between, rest),
            Check("drift, warm-up, steps in time", False, "the table's rows have no time"),
        ]
    span, attitudes = facts.kelvin or 0.0, facts.attitudes
    return [
        *bias,
        _check(
            "temperature",
            f"it varied by {span:.2g} K",
            (facts.thermometer, "no temperature was recorded"),
            rest,
            (span >= LEAST_SPAN, f"it varied by {span:.2g} K, {LEAST_SPAN} K are needed"),
        ),
        _check(
            "charging",
            f"the charger was switched {counted(facts.switches or 0, 'time')}",
            (bool(facts.switches), "no charging events were recorded"),
            rest,
        ),
        _check(
            "accelerometer nonlinearity",
            counted(attitudes, "attitude"),
            rest,
            _attitudes(attitudes, NONLINEARITY_ATTITUDES),
        ),
    ]


def _attitudes(count: int, least: int) -> Condition:
    return count >= least, f"only {counted(count, 'attitude')}, {least} are needed"


def _of_gyroscope(facts: Facts) -> list[Check]:
    if not (facts.gyroscope and facts.rates):
        why = "vibration hides the rate at rest" if facts.gyroscope else "no gyroscope was recorded"
        return [Check("gyroscope, and time offset between the sensors", False, why)]
    sensitivity = _check(
        "gyroscope's sensitivity to acceleration",
        counted(facts.attitudes, "attitude"),
        _enough_rest(facts),
        _attitudes(facts.attitudes, FORCE_ATTITUDES),
    )
    if facts.samples == 0:
        return [
            sensitivity,
            Check("gyroscope's scale, time offset", False, "a table of rests has no motion"),
        ]
    turns = max(facts.rests - 1, 0)
    rotations = counted(turns, "rotation")
    return [
        sensitivity,
        _check(
            "gyroscope's scale and linearity, lever arm",
            f"at most {rotations} from rest to rest",
            (turns >= LEAST_TURNS, f"at most {rotations} from rest to rest, {LEAST_TURNS} are needed"),
        ),
    ]


def limits(facts: Facts) -> list[str]:
    """Return what a table of rests cannot show at all; what else is missing the diagnosis says itself."""
    if facts.samples:
        return []
    texts = ["A table of rests: time stamps, noise, values, vibration and motion could not be checked"]
    return (
        texts
        if facts.stamps
        else [*texts, "Its rows have no time: effects that change with time were not checked"]
    )
