"""The rests that temperature and wander are learnt from: bounded, spread over temperature, attitude and age.

The pool of rests keeps a few rests of each attitude, the most certain ones. A curve of temperature needs
rests at all temperatures, and the wander of a bias needs pairs of rests at all distances in time. Here a rest
is dropped where most others are like it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.temperature.charger import CHARGER_LAGS_S
from stillcal.calib_core.temperature.thermometer import LAGS_S

MOST_RESTS = 240
"""Rests kept: a fit costs the third power, 2 ms at 240."""

MAX_AGE_S = 14 * 86400.0
_CELL_K = 1.5
_CELL_AGE_S = 1800.0
"""Rests are alike within these steps of temperature and age; steps of age double."""

_LIKELY_LAG = 1 + CHARGER_LAGS_S.index(1200.0)
"""Column of Memory.charged by which rests without a temperature are alike."""


def _empty(*shape: int) -> Array:
    return frozen(np.empty(shape))


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """Rests by their means, oldest first; n of them.

    t: (n,) s, middle of the rest. celsius: (n,) degC, NaN where unknown. force, force_sd: (n, 3) raw m/s^2
    and standard uncertainty. rate, rate_sd: (n, 3) raw rad/s, NaN without a gyroscope. gravity: (n,) m/s^2 at
    the place of the rest. lagged: (n, k) degC, of sensors that follow the thermometer with each of LAGS_S.
    charged: (n, 1 + k) K, the charger's readings, as Charger.course has them. since: (n,) s, between the rest
    before, kept or not, and this one; NaN where unknown.
    """

    t: Array = field(default_factory=lambda: _empty(0))
    celsius: Array = field(default_factory=lambda: _empty(0))
    force: Array = field(default_factory=lambda: _empty(0, 3))
    force_sd: Array = field(default_factory=lambda: _empty(0, 3))
    rate: Array = field(default_factory=lambda: _empty(0, 3))
    rate_sd: Array = field(default_factory=lambda: _empty(0, 3))
    gravity: Array = field(default_factory=lambda: _empty(0))
    lagged: Array = field(default_factory=lambda: _empty(0, len(LAGS_S)))
    charged: Array = field(default_factory=lambda: _empty(0, 1 + len(CHARGER_LAGS_S)))
    since: Array = field(default_factory=lambda: _empty(0))

    def __post_init__(self) -> None:
        for name in ("force", "force_sd", "rate", "rate_sd"):  # an empty table is read back without columns
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name)).reshape(-1, 3)))
        for name, k in (("lagged", len(LAGS_S)), ("charged", 1 + len(CHARGER_LAGS_S))):
            shape = (len(self.t), k)
            if np.shape(getattr(self, name)) != shape:  # a state saved before these were learnt has none
                object.__setattr__(self, name, frozen(np.full(shape, np.nan)))
        if len(self.since) != len(self.t):
            object.__setattr__(self, "since", frozen(np.full(len(self.t), np.nan)))

    def __len__(self) -> int:
        return len(self.t)

    def with_rest(self, rest: RestState, gravity: float) -> Memory:
        """Return the memory with one rest more, without old ones and without the most crowded one."""
        none = np.full(3, np.nan)
        has_rate = rest.rate is not None and rest.rate_uncertainty is not None
        middle = 0.5 * (rest.t_start + rest.t_end)
        row: tuple[Any, ...] = (
            middle,
            np.nan if rest.temperature is None else rest.temperature,
            rest.specific_force,
            rest.force_uncertainty,
            rest.rate if has_rate else none,
            rest.rate_uncertainty if has_rate else none,
            gravity,
            np.full(len(LAGS_S), np.nan) if rest.lagged is None else rest.lagged,
            np.full(1 + len(CHARGER_LAGS_S), np.nan) if rest.charged is None else rest.charged,
            middle - self.t[-1] if len(self) else np.nan,
        )
        longer = self._of(
            np.concatenate((column, [v])) for column, v in zip(self._columns(), row, strict=True)
        )
        young = longer.t[-1] - longer.t <= MAX_AGE_S
        kept = longer if young.all() else longer.where(young)
        return kept if len(kept) <= MOST_RESTS else kept.without(kept._most_crowded())

    def where(self, rows: NDArray[np.bool_]) -> Memory:
        """Return only the rests of some rows, by flags (n,)."""
        return self._of(column[rows] for column in self._columns())

    @property
    def newest(self) -> Memory:
        """The newest rest alone."""
        return self.where(np.arange(len(self)) == len(self) - 1)

    def without(self, row: int) -> Memory:
        """Return the memory without one rest."""
        return self.where(np.arange(len(self)) != row)

    def at_gravity(self, gravity: float) -> Memory:
        """Return the memory with every rest at a place of this gravity, m/s^2."""
        return replace(self, gravity=frozen(np.full(len(self), gravity)))

    @staticmethod
    def _of(columns: Iterable[Array]) -> Memory:
        return Memory(*map(frozen, columns))

    def _columns(self) -> tuple[Array, ...]:
        return tuple(getattr(self, name) for name in self.__slots__)

    def _most_crowded(self) -> int:
        """Return the oldest rest of those that most others are like."""
        up = self.force / np.linalg.norm(self.force, axis=1, keepdims=True)
        age = np.floor(np.log2(1.0 + (self.t[-1] - self.t) / _CELL_AGE_S))
        read = np.where(np.isfinite(self.celsius), self.celsius, self.charged[:, _LIKELY_LAG])
        warmth = np.round(np.nan_to_num(read, nan=-300.0) / _CELL_K)
        cells = list(zip(*np.round(1.5 * up).T.tolist(), age.tolist(), warmth.tolist(), strict=True))
        count = Counter(cells)
        return max(range(len(cells)), key=lambda row: count[cells[row]])
