"""What a recording's stamps, values and noise measure, on the scales of the populations of sound phones.

Jitter and shares have the errors of another recording, as what comes and goes is there by chance.
"""

from __future__ import annotations

from stillcal.calib_core.diagnosis.direct import quantisation
from stillcal.calib_core.diagnosis.direct import repeated_values as repeats
from stillcal.calib_core.diagnosis.model.measurement import Measured, mean_in_time, share_in_time
from stillcal.calib_core.diagnosis.noise import (
    gathered_noise,
    heavy_tails,
    low_pass,
    noise_level,
    shared_noise,
)
from stillcal.calib_core.diagnosis.segments.sample_period import bunched, sample_period
from stillcal.calib_core.diagnosis.stamps import clock
from stillcal.calib_core.diagnosis.stamps import timestamps as stamps
from stillcal.calib_core.diagnosis.stamps.interval_memory import Memory
from stillcal.calib_core.streams.samples import Samples


def of_stamps(samples: Samples, period: float = 0.0) -> dict[str, Measured]:
    """Return jitter, missing samples and bursts of one stream; what cannot be told is absent.

    period: s, of samples among which those that arrive together are counted, if that is longer than their
    own: what is delivered every 5 ms comes four at a time at 800 Hz, and one at a time at 100 Hz.
    """
    grid = grid_of(samples)
    if grid is None:
        return {}
    out = {"dropped_samples": grid.missing().log(stamps.LEAST_SHARE)} if grid.told else {}
    sigma = grid.jitter(mean_in_time)
    if sigma is not None:
        relative = Measured(sigma.value / grid.period, sigma.error / grid.period)
        out["timestamp_jitter"] = relative.log(stamps.LEAST_JITTER)
    arrived = clock.arrivals(samples)
    if arrived is not None:
        every = max(round(period / grid.period), 1)
        waited, together = clock.waited(samples.t[::every], arrived[::every], every * grid.period)
        share = share_in_time(waited, float(waited.size), together)
        out["arrival_bursts"] = share.log(clock.LEAST_SHARE)
    return out


def of_intervals(samples: Samples) -> dict[str, Measured]:
    """Return how the scatter of one stream's stamps grows with time, which is no effect's own number."""
    grid = grid_of(samples)
    memory = None if grid is None else Memory.of(grid)
    return {} if memory is None else {"interval_memory": memory.size()}


def grid_of(samples: Samples) -> stamps.Grid | None:
    """Return the grid of one stream's stamps; None where they are too few, or have none."""
    period = sample_period(samples.t)
    if len(samples) < clock.LEAST_SAMPLES or period <= 0.0 or bunched(samples.t):
        return None
    return stamps.Grid.of(samples.t, period)


def of_values(samples: Samples) -> dict[str, Measured]:
    """Return the share of held samples of one sensor."""
    seen = repeats.Repeats.of(samples)
    return {} if seen is None else {"held_samples": seen.foretold().log(repeats.LEAST_SHARE)}


def of_noise(
    sensor: str,
    still: low_pass.Quiet,
    steps: quantisation.Steps,
    spectra: low_pass.Spectra | None,
    levels: noise_level.Levels | None,
) -> dict[str, Measured]:
    """Return step, bandwidth, tails, inequality and correlation of one sensor's noise, if rests show it."""
    out = {}
    if len(still.pieces) >= low_pass.LEAST_PIECES:
        out["step_over_noise"] = quantisation.relative_step(steps)
    if spectra is None or levels is None or steps.blurs_level():
        return out
    out[low_pass.population(spectra)] = low_pass.relative_cutoff(spectra)
    tails = heavy_tails.excess_kurtosis(still) if steps.dithered() else None
    if tails is not None:
        out["excess_kurtosis"] = tails
    if levels.own:
        out |= {f"{sensor}_noise_{k}": v for k, v in noise_level.imbalance(levels).items()}
        shared = shared_noise.shared_noise(still, spectra)
        out |= {} if shared is None else {"noise_shared": shared.size()}
        out["noise_gathered"] = gathered_noise.gathered_noise(spectra).excess
    return out
