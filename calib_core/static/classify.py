"""Is this window still? Each window against the floor, the ceilings, and what a working sensor does.

Memoryless but for the floors and the sensor's coarseness, both handed in; joining windows is not done here.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.noise_floor import Floor, rate_class
from stillcal.calib_core.static.settings import DetectorSettings, Label
from stillcal.calib_core.static.windows import (
    COLUMNS,
    D2,
    GAP,
    HIGH,
    K_END,
    LOW,
    LSB,
    MEAN,
    Index,
    K,
    N,
    across,
    joined,
    matched,
    paired,
    spread,
)

# Fates that one window alone can have, by code; the first that applies is the window's.
LABELS = (
    Label.STILL,
    Label.GAP,
    Label.SPARSE,
    Label.IMPLAUSIBLE,
    Label.FROZEN,
    Label.ACCEL_MOVING,
    Label.GYRO_MOVING,
)
STILL, GAPPED, SPARSE, IMPLAUSIBLE, FROZEN, ACCEL_MOVING, GYRO_MOVING = range(7)

_FEW_CODES = 2.5
Codes = NDArray[np.int8]
Flags = NDArray[np.bool_]


def _no_step() -> Array:
    return frozen(np.full(3, np.inf))


@dataclass(slots=True)
class Coarseness:
    """How often a sensor at rest shows only a few codes, and their step.

    few, many: decayed counts of quiet windows; lsb: (3,) step of the few-code ones, inf unknown. fresh_*: not
    used before `renewed`.
    """

    few: float = 0.0
    many: float = 0.0
    lsb: Array = field(default_factory=_no_step)
    fresh_few: int = 0
    fresh_many: int = 0
    fresh_lsb: Array = field(default_factory=_no_step)

    @property
    def coarse(self) -> bool:
        """Whether exact repeats are this sensor's habit at rest, so that a window of them can be genuine."""
        return self.few > max(self.many, 2.0)

    @property
    def step(self) -> float:
        """Length of the vector of steps that coarseness alone may move a mean by, standard, SI; 0 if fine."""
        known = self.lsb[np.isfinite(self.lsb)]
        return float(np.sqrt((known**2).sum() / 12.0)) if self.coarse else 0.0

    def observed(self, half: SensorWindows, looked: Flags, ceiling: float) -> Coarseness:
        """Count windows that were looked at; nothing changes before `renewed`."""
        quiet = looked & (half.spread <= ceiling) & (half.rows[:, N] > 0) & ~half.constant
        if not quiet.any():
            return self
        few = quiet & half.few
        return replace(
            self,
            fresh_few=self.fresh_few + int(few.sum()),
            fresh_many=self.fresh_many + int((quiet & ~few).sum()),
            fresh_lsb=frozen(half.rows[few, LSB].min(axis=0, initial=np.inf)).clip(max=self.fresh_lsb),
        )

    def renewed(self, settings: DetectorSettings) -> Coarseness:
        """Let the fresh counts in and forget by as many windows as came."""
        came = self.fresh_few + self.fresh_many
        keep = 0.5 ** (came * settings.window_s / settings.half_life_s)
        lsb = self.fresh_lsb if self.fresh_few else self.lsb
        return Coarseness(self.few * keep + self.fresh_few, self.many * keep + self.fresh_many, lsb)


@dataclass(slots=True)
class SensorWindows:
    """What one sensor's windows show, whatever the floor: (n,) each. slack: m/s^2 or rad/s squared."""

    rows: Array
    spread: Array
    rates: NDArray[np.intp]
    constant: Flags
    few: Flags
    sparse: Flags
    quantisation_allowance: Array

    @classmethod
    def of(cls, rows: Array, settings: DetectorSettings) -> SensorWindows:
        """Derive from one sensor's rows."""
        if not rows[:, N].any():
            return cls.absent(rows)
        lsb = rows[:, LSB]
        narrow = rows[:, HIGH] - rows[:, LOW] <= _FEW_CODES * lsb
        quantisation_allowance = across(np.where(narrow & np.isfinite(lsb), 0.25 * lsb * lsb, 0.0)) / 3.0
        rate = rows[:, N] / ((rows[:, K_END] - rows[:, K]).clip(1.0) * settings.window_s)
        constant = across(rows[:, D2]) == 0
        few, sparse = (
            narrow[:, 0] & narrow[:, 1] & narrow[:, 2] & ~constant,
            2 * rows[:, N] < settings.min_samples,
        )
        return cls(rows, spread(rows), rate_class(rate), constant, few, sparse, quantisation_allowance)

    @classmethod
    def absent(cls, rows: Array) -> SensorWindows:
        """Return what rows of zeros show: no sample, nothing moved."""
        n = rows.shape[0]
        none, yes, no = np.zeros(n), np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
        return cls(rows, none, np.zeros(n, dtype=np.intp), yes, no, yes, none)

    def __getitem__(self, part: slice) -> SensorWindows:
        return SensorWindows(*(getattr(self, name)[part] for name in self.__slots__))

    def exceeds(self, floor: Floor, factor: float, ceiling: float) -> Flags:
        """Whether the spread is above `factor` floors (a coarse step allowed on top) or the ceiling."""
        limit = np.sqrt((factor * floor.level[self.rates]) ** 2 + self.quantisation_allowance)
        return np.asarray(self.spread > np.minimum(limit, ceiling))


@dataclass(slots=True)
class Windows:
    """Windows of both sensors side by side. rows: (n, 2 COLUMNS), gyroscope columns 0 where unusable."""

    rows: Array
    accel: SensorWindows
    gyro: SensorWindows

    @classmethod
    def of(cls, accel: Array, gyro: Array, widths: Index, settings: DetectorSettings) -> Windows:
        """Pair two sensors' cell rows. widths: of the window that each accelerometer row joins, in cells."""
        at, found = matched(accel[:, K], gyro[:, K])
        rows = paired(joined(accel, widths), joined(gyro[found], widths[at[found]]))
        gyro_rows = rows[:, COLUMNS:]
        unusable = (gyro_rows[:, GAP] > settings.gap_s) | (2 * gyro_rows[:, N] < settings.min_samples)
        gyro_rows[unusable | (across(gyro_rows[:, D2]) == 0)] = 0.0
        return cls(rows, SensorWindows.of(rows[:, :COLUMNS], settings), SensorWindows.of(gyro_rows, settings))

    def __len__(self) -> int:
        return int(self.rows.shape[0])

    def __getitem__(self, part: slice) -> Windows:
        if part == slice(0, len(self)):
            return self
        return Windows(self.rows[part], self.accel[part], self.gyro[part])


def classify(
    windows: Windows, floors: tuple[Floor, Floor], coarse: bool, settings: DetectorSettings
) -> Codes:
    """Return each window's fate as an index into FATES; `coarse`: the accelerometer may repeat itself."""
    accel, mean = windows.accel, windows.accel.rows[:, MEAN]
    norm = np.sqrt(mean[:, 0] ** 2 + mean[:, 1] ** 2 + mean[:, 2] ** 2)
    conditions = [
        accel.rows[:, GAP] > settings.gap_s,
        accel.sparse,
        (norm < settings.force_low) | (norm > settings.force_high),
        accel.constant & (not coarse),
        accel.exceeds(floors[0], settings.accel_factor, settings.accel_ceiling),
        windows.gyro.exceeds(floors[1], settings.gyro_factor, settings.gyro_ceiling),
    ]
    codes = np.full(len(windows), STILL, dtype=np.int8)
    for code in range(len(conditions), 0, -1):  # the first that applies is set last
        codes[conditions[code - 1]] = code
    return codes


def trainable(windows: Windows, codes: Codes) -> tuple[Flags, Flags]:
    """Which windows may teach the two floors: whole, plausible, and not frozen."""
    whole = (codes == STILL) | (codes >= ACCEL_MOVING)
    return whole & ~windows.accel.constant, whole & ~windows.gyro.constant
