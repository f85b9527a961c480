"""Terms that follow what an axis itself reads, as lines that Python and C share.

Their formulas are those of calib_core/calibration/corrections; tests hold the written code against them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.catalogue import CORRECTIONS
from stillcal.calib_core.calibration.corrections.nonlinearity import Nonlinearity
from stillcal.calib_core.calibration.corrections.scale_temperature import ScaleTemperature
from stillcal.calib_core.calibration.corrections.term import Term


def is_of_reading(term: Term) -> bool:
    """Tell whether a term can be written as code: it follows the reading, and the temperature at most."""
    return isinstance(CORRECTIONS.get(term.effect), Nonlinearity | ScaleTemperature)


def constants(terms: Iterable[Term]) -> dict[str, Array]:
    """Return the numbers of terms by the names that `error` calls them."""
    return {
        f"{term.effect}_{name}": parameter.value
        for term in terms
        for name, parameter in term.parameters.items()
    }


def error(terms: Sequence[Term], axis: str = "") -> str:
    """Return what terms add to a reading. x: the reading, held: the same within `reach`, warmer: K.

    axis: what stands behind a constant of three axes, such as "[i]".
    """
    parts = []
    for term in terms:
        if isinstance(CORRECTIONS[term.effect], ScaleTemperature):
            parts.append(f"{term.effect}_slope{axis} * warmer * x")
        else:
            powers = {"quadratic": "held * held", "cubic": "held * held * held"}
            parts += [f"{term.effect}_{name}{axis} * {powers[name]}" for name in term.parameters]
    return " + ".join(parts)


def reach(terms: Iterable[Term]) -> float | None:
    """Return the reading beyond which an error stays as it is; None where no term has one."""
    kinds = [CORRECTIONS[term.effect] for term in terms]
    return next((kind.reach for kind in kinds if isinstance(kind, Nonlinearity)), None)


def counts_from(terms: Iterable[Term]) -> float | None:
    """Return the temperature, degC, that `warmer` counts from; None where no term follows it."""
    return next((t.reference["temperature"] for t in terms if "temperature" in t.reference), None)
