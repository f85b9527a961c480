"""What comes again with a steady period of a quarter of a second to some seconds, all along the recording.

It is slower than vibrations are sought and quicker than bins tell: a radio that sends, a display that is
refreshed, a supply that is switched. Bodies sway at such frequencies too, but keep no phase.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.model.records import NAME, Finding
from stillcal.calib_core.diagnosis.noise.lines.coherent_line import CoherentSpectrum
from stillcal.calib_core.diagnosis.noise.lines.line import middle_hz
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import (
    APART_HZ,
    LEAST_LINE_HZ,
    MOST_LINES,
    SHORT,
    AtRest,
)
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.streams.samples import Samples

DRIVER = "a steady period"

LEAST_CYCLES = 3.0
"""In a stretch: of slower ones its mean, which is taken off, and its taper leave little."""

LEAST_KEPT = 200.0
"""Cycles in the recording, at least. From one to the next breaths differ by a tenth and heartbeats by a
twentieth, so that these are half a cycle off after 25 and 100; in a short recording they keep their phase."""


def steady_period(samples: Samples, sensor: str, rests: AtRest | None = None) -> Finding | None:
    """State, without a name, the lines below those of vibrations that keep their phase; None without one.

    rests: of these samples, where they are laid out already.
    """
    rests = rests or AtRest.of(samples, sensor)
    left = None if rests.short is None else rests.coherent
    if rests.places is None or left is None:
        return None
    lowest = max(LEAST_CYCLES / SHORT, LEAST_KEPT / (left.seen.whole[1] - left.seen.whole[0]))
    tried: list[Finding] = []
    while len(tried) < MOST_LINES:
        one = left.clearest(sensor, (lowest, LEAST_LINE_HZ), [middle_hz(f) for f in tried])
        if one is None or not left.in_step(one):
            break
        tried.append(one)
        left = CoherentSpectrum.of(rests.places, left.seen.without(middle_hz(one), APART_HZ))
    found = [f for f in tried if middle_hz(f) <= LEAST_LINE_HZ]
    return _unknown(found) if found else None


def _unknown(lines: list[Finding]) -> Finding:
    """Return the clearest line, the first, without its name; the others may be its overtones."""
    first = lines[0]
    size = np.atleast_1d(np.asarray(first.parameters["amplitude"].value, dtype=np.float64))
    sizes = ", ".join(f"{axis} {size['xyz'.index(axis)]:.3g}" for axis in first.axes)
    beside = " and ".join(f"{middle_hz(line):.4g}" for line in lines[1:])
    say = (
        f"The {NAME[first.sensor]}'s data at rest rise and fall every {1.0 / middle_hz(first):.4g} s"
        f" ({middle_hz(first):.4g} Hz), amplitude {sizes} {UNIT[first.sensor]}, and keep in step all along,"
        f" as no body does{f'; so they do at {beside} Hz' if beside else ''}."
    )
    return replace(first, effect="unknown", where=replace(first.where, driver=DRIVER), statement=say)
