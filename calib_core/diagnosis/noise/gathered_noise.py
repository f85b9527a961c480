"""Noise at rest that is gathered at few frequencies, at others in every rest: a line that moves.

A vibration whose speed changes, or an alias whose frequency follows temperature, leaves no line in the mean
of all rests, where it looks like more noise. Within one rest it is a line: power is far above its median over
frequencies there. White noise is above it by chance alone. It is a spectral kurtosis (Antoni, Mech. Syst.
Signal Process. 20, 282 (2006)) by robust means.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import of_means
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Measured,
    direct_finding,
    mean_of,
    of_measured,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.noise.lines.line import is_line
from stillcal.calib_core.diagnosis.noise.low_pass import Spectra
from stillcal.calib_core.diagnosis.noise.noise_level import level_part

DRIVER = "frequencies that change from rest to rest"


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """The axis whose noise is gathered most: the natural logarithm of mean power over what its median tells.

    pieces: (P,) the same piece by piece.
    """

    axis: int
    excess: Measured
    pieces: Array


def gathered_noise(spectrum: Spectra) -> Gathered:
    """Return the axis whose noise within rests is gathered most, where the mean of all rests has no line.

    The median of a spectrum of K averages is about (1 - 1/(9 K))^3 of its mean (Wilson and Hilferty, 1931).
    """
    flat, used, _ = level_part(spectrum)
    power = np.maximum(flat[:, used], 1e-300)
    chance = 3.0 * np.log(1.0 - 1.0 / (9.0 * spectrum.averages))
    excess = np.log(power.mean(axis=1) / np.median(power, axis=1)) + chance[:, None]
    found = [mean_of(excess[:, axis]) for axis in range(3)]
    axis = int(np.argmax([m.value for m in found]))
    return Gathered(axis, found[axis], excess[:, axis])


def gathered_noise_finding(found: Gathered, sensor: str, sound: Usual, where: Where) -> Finding | None:
    """State what no sound phone has; it has no name, for many a cause may have it."""
    seen = of_measured(found.excess, sound, of_means(found.pieces, np.array([sound.middle])))
    one_axis = DirectEvidence(seen.log_bayes_factor - float(np.log(3.0)), seen.held_out, seen.unusual)
    times = float(np.exp(found.excess.value))
    say = (
        f"The {NAME[sensor]}'s noise on {AXES[found.axis]} is gathered at few frequencies, at others in every"
        f" rest: its power is {times:.2f} times what most frequencies of a rest have."
    )
    parameters = {"ratio": Measured(times, times * found.excess.error).parameter("1")}
    own = Where(where.t_start, where.t_end, where.band_hz, DRIVER)
    return direct_finding("unknown", sensor, [found.axis], own, parameters, statement=say, seen=one_axis)


def without_parts(found: Sequence[Finding]) -> list[Finding]:
    """Leave out other lines beside lines that change from rest to rest: those that come back are of them."""
    if not any(f.where.driver == DRIVER for f in found):
        return list(found)
    return [f for f in found if not is_line(f)]
