"""Whether rests would show a line of another recording: one is put in and looked for.

Rests that are fewer, shorter or louder do not show every line that others do, and no more than the surest are
stated of any.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.harmonics import folded
from stillcal.calib_core.diagnosis.noise.lines.intermittent_line import middle_hz
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import NEAR, SHORT, tones
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.streams.samples import Samples

PART = 0.7
"""Part of the amplitude that is put in, so that a line which is there and was missed is not called absent."""

ASIDE_HZ = 1.0
"""It is put in so far aside: on top of one that is there and was missed it would add to that."""

SAME_HZ = NEAR / SHORT
"""Difference of two lines' frequencies that is none, beside `CLOCKS`."""

CLOCKS = 1e-3
"""Part of a frequency by which two clocks may put one line apart."""


def would_show(samples: Samples, sensor: str, line: Finding) -> bool:
    """Whether the rests of one sensor would show a line that was found in those of another recording."""
    size = np.asarray(line.parameters["amplitude"].value, dtype=np.float64)
    share = float(np.asarray(line.parameters["fraction"].value))
    rate = 1.0 / sample_period(samples.t)
    own = folded(middle_hz(line), rate)
    aside = own + ASIDE_HZ if own < rate / 4.0 else own - ASIDE_HZ
    wave = np.sin(2.0 * np.pi * aside * (samples.t - samples.t[0]))
    louder = samples.xyz + PART * np.sqrt(share) * np.outer(wave, size)
    found = tones(replace(samples, xyz=frozen(louder)), sensor)
    return any(same_line(aside, middle_hz(one), rate) for one in found)


def same_line(one: float, other: float, rate: float) -> bool:
    """Whether two frequencies, Hz, are one where samples are taken at a rate, Hz: higher ones fold back."""
    apart = abs(folded(one, rate) - folded(other, rate))
    return apart < SAME_HZ + CLOCKS * max(one, other)
