"""Values that follow their own code: some codes are met too often, or noise is larger at some of them.

A converter and a register count in powers of two, and so does what is wrong with them: codes of unequal
width, a bit that is seldom set, a byte that was read before the other had changed. It repeats every 2^b
codes, and the Fourier transform of their histogram has a line there. No smooth density has. What chance and
few attitudes leave is the same at neighbouring periods, which are the null.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct.missing_codes import ON_GRID
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Index,
    direct_finding,
    of_chance,
    of_fit,
    sized,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.segments.value_grid import comb_step
from stillcal.calib_core.diagnosis.sequence.neighbours import REACH, residual, spread
from stillcal.calib_core.diagnosis.sequence.places import Noise
from stillcal.calib_core.maths.chi_squared import log_tail
from stillcal.calib_core.streams.samples import Samples

DRIVER = "own code"
BITS = 8
"""Bits, from the lowest, whose periods are looked at: a byte."""

WIDEST = 1 << 17
"""Codes that values may go through: 16 bits, and one more where signs are apart."""

NEARLY_ALL = 0.99
"""Part of the values that has one lowest bit where the grid is really twice as coarse."""

NEIGHBOURS = 12
"""Periods on either side that a line is held against."""

APART = 2
"""The first of these, in the least difference that the range of codes tells apart."""

BITS_OFF = (3, 16)
"""Bits that single values may be off by."""

CLEAR = 3.0
"""Spreads of six residuals that such a bit is worth at least, so that its multiples are apart."""

LOUDER, ABOUT, MANY = 2.5, 32, 0.1
"""Spreads beyond which noise has one residual in eighty; how many on either side; a part beyond noise's."""

FEWEST_FAR = 10
ALIKE = 5.0
"""Residuals that know of one value, and so may be off together."""

LEAST_NOISE = 1.0
"""Codes of noise, below which a rest gives but few of them, whatever its attitude."""

LEAST_SAMPLES = 1000
LEAST_PERIODS = 8
"""Periods that the codes must go through."""


@dataclass(frozen=True, slots=True)
class Repeats:
    """What repeats every 2^bit codes, by `what` it is, with nats for it."""

    bit: int
    what: str
    nats: float


def by_code(samples: Samples, sensor: str, noise: Noise | None) -> Finding | None:
    """Find axes whose values, or whose noise at rest, depend on the code modulo a power of two.

    noise: at rest; None where rests do not show it.
    """
    if len(samples) < LEAST_SAMPLES:
        return None
    found = {a: r for a in range(3) if (r := _of_axis(samples.xyz[:, a], noise)) is not None}
    if not found:
        return None
    best = max(found.values(), key=lambda r: r.nats)
    axes = [a for a, r in found.items() if DirectEvidence(r.nats - float(np.log(9.0))).stated] or [
        max(found, key=lambda a: found[a].nats)
    ]
    named, period = ", ".join(AXES[a] for a in axes), 2**best.bit
    say = f"The {NAME[sensor]}'s {best.what} on {named} depends on its code modulo {period}."
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), DRIVER)
    sizes = sized({"period_codes": (float(period), "codes")})
    # Three axes and three things that may depend on the code were tried.
    seen = DirectEvidence(best.nats - float(np.log(9.0)))
    return direct_finding("unknown", sensor, axes, where, sizes, statement=say, seen=seen)


def _of_axis(values: Array, noise: Noise | None) -> Repeats | None:
    code = codes(values)
    if code is None or float(spread(residual(code.astype(np.float64)[:, None]))[0]) < LEAST_NOISE:
        return None
    tried = [clearest(code, np.ones(code.size), "share of values"), lattice(code)]
    if noise is not None:
        tried.append(clearest(code[REACH:-REACH], noise.size, "noise at rest"))
    return max((r for r in tried if r is not None), key=lambda r: r.nats, default=None)


def lattice(code: Index) -> Repeats | None:
    """Return the power of two that single values are off by, or multiples of it; None where none is far off.

    What neighbours leave of them, six times, is then such a multiple too. Of other large residuals fewer lie
    about a multiple than half way to it: the larger they are, the rarer. Those of a vibration are not, but
    they come one after the other, or among such as are louder than noise and not as far off.
    """
    left = 6.0 * residual(code.astype(np.float64)[:, None])[:, 0]
    size, noise, found = np.abs(left), float(spread(left[:, None])[0]), []
    for bit in range(BITS_OFF[0], BITS_OFF[1] + 1):
        period = float(2**bit)
        if period < CLEAR * noise:
            continue
        single = _single(size > period / 2.0)
        if single.size < FEWEST_FAR:
            continue
        far = left[single[~_shaken(size, noise, period / 2.0)[single]]]
        if far.size < FEWEST_FAR:
            continue
        waves = float(np.cos(2.0 * np.pi * far / period).sum())
        sigmas = max(waves, 0.0) / np.sqrt(0.5 * ALIKE * far.size)
        found.append(Repeats(bit, "error of single values", of_fit(0.5 * sigmas**2, 1.0, far.size, BITS)))
    return max(found, key=lambda r: r.nats, default=None)


def _shaken(size: Array, noise: float, far: float) -> NDArray[np.bool_]:
    """Where (n,) many residuals about, of size (n,), are louder than noise and not far, as multiples are."""
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    between = ((size > LOUDER * noise) & (size <= far)).astype(np.float64)
    return np.asarray(uniform_filter1d(between, 2 * ABOUT + 1) > MANY)


def _single(far: NDArray[np.bool_]) -> Index:
    """Return the places of far residuals (n,) that have none near but those that know of the same value."""
    at = np.flatnonzero(far)

    def within(reach: int) -> Index:
        return np.asarray(np.searchsorted(at, at + reach, side="right") - np.searchsorted(at, at - reach))

    return np.asarray(at[within(4 * REACH) == within(2 * REACH)])


def codes(values: Array) -> Index | None:
    """Return the codes (n,) of values (n,), 0 the lowest; None where there is no grid, or too wide a one."""
    step = comb_step(values)
    if step is None:
        return None
    away = (values - float(np.median(values))) / step
    code = np.rint(away)
    if np.ptp(code) >= WIDEST or float(np.quantile(np.abs(away - code), 0.99)) > ON_GRID:
        return None
    whole = (code - code.min()).astype(np.int64)
    while True:
        odd = float((whole & 1).mean())
        if NEARLY_ALL > odd > 1.0 - NEARLY_ALL or whole.max() < 2:
            return np.asarray(whole)
        whole = whole >> 1


def clearest(code: Index, weight: Array, what: str) -> Repeats | None:
    """Return the power of two at which the weight (n,) of codes (n,) repeats most clearly; None for few."""
    span = int(code.max()) + 1
    least = 1 << int(np.ceil(np.log2(max(span, 64))))
    length = 4 * least
    power = np.abs(np.fft.rfft(np.bincount(code, weights=weight, minlength=span), length)) ** 2
    away = (np.arange(NEIGHBOURS) + APART) * (length // least)
    found = []
    for bit in range(1, BITS + 1):
        if LEAST_PERIODS << bit > span:
            break
        at = (np.arange(1, max((1 << bit) // 2, 2), 2) * length) >> bit
        near = np.abs(np.concatenate([at[:, None] - away, at[:, None] + away], axis=1))
        near = np.where(near > length // 2, length - near, near)
        usual = np.maximum(power[near].mean(axis=1), 1e-300)
        line = near.shape[1] * np.log1p(power[at] / usual / near.shape[1])
        # The line of every other code has no phase, and half as many numbers.
        nats = -float(log_tail(2.0 * line.sum(), 2 * at.size)) if bit > 1 else -float(log_tail(line[0], 1))
        found.append(Repeats(bit, what, of_chance(-nats, float(BITS))))
    return max(found, key=lambda r: r.nats, default=None)
