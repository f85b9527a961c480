"""A vibration and its harmonics are one: each line says which of the others it belongs to.

A motor, a fan or a wheel shakes at multiples of its speed too. Above half of the sample rate these fold back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.line import middle_hz

MOST = 6
"""The highest harmonic that is looked for."""

ALIKE = 1e-4
"""Part of a frequency by which a harmonic may be off beside both errors. By chance two lines are as near to a
whole ratio in one of 300 pairs."""


def with_harmonics(lines: Sequence[Finding], rate: float) -> list[Finding]:
    """Return the lines of one sensor, in whose remarks stands which are harmonics of which; rate: Hz.

    What a harmonic is an alias of is no question any more.
    """
    rest = sorted(lines, key=middle_hz)
    said = {id(line): line.remark for line in lines}
    known: set[int] = set()
    while rest:
        of_each = [_harmonics(base, rest, rate) for base in rest]
        k = int(np.argmax([len(one) for one in of_each]))
        base, harmonics = rest[k], of_each[k]
        if harmonics:
            listed = ", ".join(f"{order} at {middle_hz(line):.4g} Hz" for order, line in harmonics)
            said[id(base)] = " ".join(filter(None, (f"It has harmonics: {listed}.", base.remark)))
        for order, line in harmonics:
            own = order * middle_hz(base)
            of = f"harmonic {order} of the vibration at {middle_hz(base):.4g} Hz"
            # Folded back, a few of whole Hz meet by chance.
            beyond = f"It may be {of}, {own:.4g} Hz folded back."
            said[id(line)] = beyond if own > rate / 2.0 else f"It is {of}."
            known.add(id(line))
        rest = [line for line in rest if line is not base and id(line) not in known]
    return [replace(f, remark=said[id(f)]) for f in lines]


def folded(frequency: float, rate: float) -> float:
    """Return where a frequency is seen that is sampled at a rate, Hz.

    >>> folded(60.0, 100.0)
    40.0
    """
    return float(abs(frequency - rate * np.rint(frequency / rate)))


def _harmonics(base: Finding, lines: Sequence[Finding], rate: float) -> list[tuple[int, Finding]]:
    """Return which of the lines are harmonics of one, each with its order."""
    orders = [(_order(line, base, rate), line) for line in lines if line is not base]
    return sorted(((n, line) for n, line in orders if n is not None), key=lambda one: one[0])


def _order(line: Finding, base: Finding, rate: float) -> int | None:
    """Return which harmonic of another line a line is; None where it is none, or at another time."""
    if not _together(line, base):
        return None
    own, lowest = middle_hz(line), middle_hz(base)
    for n in range(2, MOST + 1):
        off = n * _half(base) + _half(line) + ALIKE * n * lowest
        if abs(folded(n * lowest, rate) - own) < off:
            return n
    return None


def _together(one: Finding, other: Finding) -> bool:
    """Whether two lines are there at the same time, for half of the shorter one's at least."""
    a, b = one.where, other.where
    shared = min(a.t_end, b.t_end) - max(a.t_start, b.t_start)
    return shared >= 0.5 * min(a.t_end - a.t_start, b.t_end - b.t_start)


def _half(line: Finding) -> float:
    """Return half of the interval of a line's frequency, Hz."""
    low, high = line.where.band_hz
    return (high - low) / 2.0
