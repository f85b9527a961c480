"""How small an effect of samples and stamps one recording would have shown, nine times in ten.

It is the number at which the evidence of `measurement.of_measured` reaches what a finding needs, plus 1.28 of
its standard errors. The error is the recording's own; of a share of samples it is the binomial one there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.diagnosis.direct import quantities
from stillcal.calib_core.diagnosis.direct import repeated_values as repeats
from stillcal.calib_core.diagnosis.model.measurement import NINE_IN_TEN, Measured, of_measured, share_of
from stillcal.calib_core.diagnosis.model.sound_phones import SoundPhones, Usual, usual
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.stamps import clock
from stillcal.calib_core.diagnosis.stamps import timestamps as stamps
from stillcal.calib_core.diagnosis.stamps.rate_changes import stretches
from stillcal.calib_core.streams.samples import Samples

TRIED = 400
"""Numbers that are tried, evenly over the range of faults."""

SHARES = {
    "dropped_samples": stamps.LEAST_SHARE,
    "arrival_bursts": clock.LEAST_SHARE,
    "held_samples": repeats.LEAST_SHARE,
}
"""Shares of samples by population, with what is added to them before the logarithm is taken."""

FEW_FAULTS = 0.1
"""An effect is hardly shown where no more than this part of its faults is large enough."""

Unlucky = Callable[[float, int], Measured]
"""What one recording in ten measures of a number, or less; faults are above (1) or below (-1)."""


@dataclass(frozen=True, slots=True)
class SmallestSize:
    """The smallest size of an effect's parameter that is found nine times in ten, in `unit`.

    reason: why the effect is hardly shown at all; "" where it is.
    """

    effect: str
    parameter: str
    value: float
    unit: str
    reason: str = ""


def smallest_number(common: Usual, unlucky: Unlucky) -> float | None:
    """Return the least number on a population's scale that is stated nine times in ten; None if none is.

    unlucky: what one recording in ten measures of it. Of faults on both sides it is the one above.
    """
    side = common.side or 1
    edge = common.faulty[1] if side > 0 else common.faulty[0]
    for number in np.linspace(common.middle, edge, TRIED):
        seen = unlucky(float(number), side)
        if side * (seen.value - common.middle) > 0.0 and of_measured(seen, common).stated:
            return float(number)
    return None


def _why_hardly(common: Usual, number: float, share_floor: float) -> str:
    """Say why a share of samples is hardly shown; "" where more than `FEW_FAULTS` of its faults are larger.

    number: the least that is stated; on the population's scale, log10 of the share plus a floor.
    """
    edge = common.faulty[1]
    if edge - number > FEW_FAULTS * (edge - common.middle):
        return ""
    if not common.devices.size:
        return "there are too few samples"
    highest = 10.0**common.highest - share_floor
    return f"{common.devices.size} real devices show up to {highest:.0%} (nominal_rate_hz would tell more)"


def _constant(error: float) -> Unlucky:
    return lambda number, side: Measured(number - side * NINE_IN_TEN * error, error)


def _of_share(floor: float, samples: int, together: float) -> Unlucky:
    def unlucky(number: float, side: int) -> Measured:
        share = float(np.clip(10.0**number - floor, 0.0, 1.0))
        spread = float(np.sqrt(share * (1.0 - share) * together / samples))
        seen = float(np.clip(share - side * NINE_IN_TEN * spread, 0.0, 1.0))
        return share_of(seen * samples, float(samples), together).log(floor)

    return unlucky


def of_stamps_and_values(samples: Samples, sound: SoundPhones, nominal: float | None) -> list[SmallestSize]:
    """Return the smallest clock error, jitter and shares of samples that one stream shows.

    nominal: its declared rate.
    """
    measured = quantities.of_stamps(samples) | quantities.of_values(samples)
    period, out = sample_period(samples.t), _of_clock(samples, sound, nominal)
    for name, number in measured.items():
        common = usual(sound, name, nominal)
        if name in SHARES:
            least = smallest_number(common, _of_share(SHARES[name], len(samples), _together(name, samples)))
            size = None if least is None else 10.0**least - SHARES[name]
            reason = "" if least is None else _why_hardly(common, least, SHARES[name])
            parameter, unit = "fraction", "1"
        else:
            least = smallest_number(common, _constant(number.error))
            size = None if least is None else (10.0**least - stamps.LEAST_JITTER) * period
            parameter, unit, reason = "sigma", "s", ""
        if size is not None:
            out.append(SmallestSize(name, parameter, float(size), unit, reason))
    return out


def _of_clock(samples: Samples, sound: SoundPhones, nominal: float | None) -> list[SmallestSize]:
    """Return the smallest error of the clock's rate; none where neither arrivals nor a rate are known."""
    if len(samples) < clock.LEAST_SAMPLES or sample_period(samples.t) <= 0.0:
        return []
    known = None if stretches(samples.t) else nominal
    parts = clock.rate_errors(samples.t, clock.arrivals(samples), known, sound)
    sizes = [smallest_number(common, _constant(rate.error)) for rate, _, common in parts]
    shown = [size for size in sizes if size is not None]
    return [SmallestSize("clock_skew", "relative", min(shown), "1")] if shown else []


def _together(name: str, samples: Samples) -> float:
    """Return how many samples come together: bursts are of three at least."""
    return float(clock.LEAST_GROUP) if name == "arrival_bursts" else 1.0


def of_delay(delay: Measured, sound: SoundPhones) -> list[SmallestSize]:
    """Return the smallest delay of the gyroscope that motion shows as well as it showed this one."""
    size = smallest_number(sound["time_offset"], _constant(delay.error))
    return [] if size is None else [SmallestSize("accel_gyro_time_offset", "delay", size, "s")]


def of_noise(
    measured: Mapping[str, Measured], sound: SoundPhones, sensor: str, rate: float, claim: float | None
) -> list[SmallestSize]:
    """Return the smallest ratio of z's noise, excess kurtosis, and largest cutoff, that rests show.

    measured: of the sensor's noise at rest. rate: Hz. claim: the declared density, None without one.
    """
    out = []
    for name, effect, parameter, unit in (
        (f"{sensor}_noise_upright", "noise_unequal_axes", "ratio", "1"),
        ("excess_kurtosis", "noise_heavy_tailed", "excess_kurtosis", "1"),
        ("bandwidth", "bandwidth", "cutoff", "Hz"),
    ):
        if name not in measured:
            continue
        least = smallest_number(usual(sound, name, claim), _constant(measured[name].error))
        if least is not None:
            value = least if name == "excess_kurtosis" else float(np.exp(least))
            out.append(SmallestSize(effect, parameter, value * (rate if unit == "Hz" else 1.0), unit))
    return out
