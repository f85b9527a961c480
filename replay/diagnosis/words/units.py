"""Units as people read them: mg and deg/s for m/s^2 and rad/s, ms for small times, per cent for shares."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core import gravity

G, DEGREE = gravity.STANDARD, float(np.rad2deg(1.0))

Scale = tuple[float, str]
"""What a value is multiplied by, and the unit that it is then in."""

SCALES: dict[str, tuple[Scale, ...]] = {
    "m/s^2": ((1e3 / G, "mg"), (1e6 / G, "µg")),
    "rad/s": ((DEGREE, "deg/s"), (3600.0 * DEGREE, "deg/h")),
    "rad": ((1e3, "mrad"),),
    "s": ((1.0, "s"), (1e3, "ms"), (1e6, "µs")),
    "m": ((1.0, "m"), (1e3, "mm")),
}
"""By SI unit, the coarsest unit first."""

WHOLE: dict[str, Scale] = {
    "m/s^2/s": (3.6e6 / G, "mg/h"),
    "rad/s/s": (3600.0 * DEGREE, "deg/s/h"),
    "1/K": (1e6, "ppm/K"),
    "(rad/s)/(m/s^2)": (DEGREE * G, "deg/s/g"),
    "1/(m/s^2)": (100.0 * G, "%/g"),
    "1/(m/s^2)^2": (100.0 * G**2, "%/g²"),
    "1/(rad/s)": (100.0 / DEGREE, "%/(deg/s)"),
    "1/(rad/s)^2": (100.0 / DEGREE**2, "%/(deg/s)²"),
}
"""Units that are shown in one way, whatever the size."""

SHARES = ("fraction", "scale", "scale_against_mean", "misalignment", "gain")
"""Parameters without a unit that are read as per cent."""

SMALL = 0.01
"""Size, in a unit, from which that unit is used."""

SMALL_IN = {"m": 0.1, "s": 0.5}
"""The same for units that are read in other sizes."""


def shown_in(values: ArrayLike, unit: str, name: str = "") -> Scale:
    """Return the factor and the unit in which values of a parameter are easily read.

    Changes with temperature are in the coarsest unit whatever their size, so that all are in one.
    values: in `unit`, any shape; name: of the parameter, which tells what a number without a unit is.
    """
    if unit == "1":
        small = float(np.max(np.abs(np.asarray(values, dtype=np.float64)), initial=0.0)) < SMALL
        if name == "relative" and small:
            return 1e6, "ppm"
        return (100.0, "%") if name in (*SHARES, "relative") else (1.0, "")
    if unit in WHOLE:
        return WHOLE[unit]
    base = next((b for b in ("m/s^2", "rad/s", "rad", "m", "s") if _is_of(unit, b)), None)
    if base is None:
        return 1.0, pretty(unit)
    suffix = pretty(unit.removeprefix(base))
    size = float(np.max(np.abs(np.asarray(values, dtype=np.float64)), initial=0.0))
    scales = SCALES[base][:1] if suffix.startswith("/K") else SCALES[base]
    for factor, shown in scales:
        if size * factor >= SMALL_IN.get(shown, SMALL):
            return factor, shown + suffix
    factor, shown = scales[0] if size == 0.0 else scales[-1]
    return factor, shown + suffix


DIGITS, DIGITS_OF_ERROR = 3, 2
"""Significant digits of a number by itself, and of its error, which says how many the number has."""

LOPSIDED = 1.5
"""Ratio of the two parts of an interval beyond which both its ends are given."""

LEAST_PLAIN = 1e-4
"""Below this size a number is written with a power of ten."""


def plain(value: float, error: float | None = None) -> str:
    """Return a number in plain digits; error: of the same unit, half of its interval, or None.

    A number with an error has the digits that its error has: 118 ± 160, -0.109 ± 0.032.
    """
    size = abs(value) if error is None else error
    if max(size, abs(value)) < LEAST_PLAIN or not np.isfinite(value) or size == 0.0:
        return f"{value:.3g}" if error is None else f"{value:.3g} ± {error:.2g}"
    digits = DIGITS if error is None else DIGITS_OF_ERROR
    decimals = digits - 1 - int(np.floor(np.log10(size)))
    numbers = (value,) if error is None else (value, error)
    rounded = (round(x, decimals) + 0.0 for x in numbers)
    return " ± ".join(f"{x:.{max(decimals, 0)}f}" for x in rounded)


def within(value: float, low: float, high: float) -> str:
    """Return a number with half of its 95 % interval, or with the interval where one side is the longer."""
    shorter, longer = sorted((value - low, high - value))
    if longer <= 0.0:
        return plain(value)
    if longer > LOPSIDED * shorter:
        return f"{plain(value)} ({plain(low)} to {plain(high)})"
    return plain(value, (high - low) / 2.0)


def _is_of(unit: str, base: str) -> bool:
    """Whether a unit is a base unit, or that by something else: mg/K, deg/s/sqrt(Hz)."""
    rest = unit.removeprefix(base)
    return unit.startswith(base) and (not rest or rest.startswith(("/K", "/sqrt")))


def pretty(text: str) -> str:
    """Return a text with its units as people write them: m/s² for m/s^2."""
    text = text.replace("^2", "²").replace("^3", "³")
    return text.replace("sqrt(Hz)", "√Hz").replace("sqrt(s)", "√s").replace("degC", "°C")
