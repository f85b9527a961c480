"""The classification of windows: still, or why not.

Each window is compared with the noise floor, with the ceilings, and with what a working sensor can show. The
only memory is that of the noise floors and of the sensors' coarseness, which are passed in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.noise_floor import Floor, rate_class
from stillcal.calib_core.static.settings import DetectorSettings, Label
from stillcal.calib_core.static.windows import (
    COLUMNS,
    D2,
    FEW_CODES,
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
    longest_pause,
    paired,
    sparse,
    spread,
)

# Labels that one window alone can have, by code; a window gets the first one that applies.
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

MANY_CODES = 8.0
"""Steps of the quantiser: where one axis of a sensor has a wider range, noise moves the others too."""

Codes = NDArray[np.int8]
Flags = NDArray[np.bool_]


def _no_step() -> Array:
    return frozen(np.full(3, np.inf))


@dataclass(slots=True)
class Coarseness:
    """How often a sensor at rest shows only a few codes of its quantiser, and the step between them.

    few, many: decayed counts of quiet windows with few and with many codes. lsb: (3,) step of those with few,
    m/s^2 or rad/s, inf where unknown. fresh_few, fresh_many, fresh_lsb: the same, not used before `renewed`.
    """

    few: float = 0.0
    many: float = 0.0
    lsb: Array = field(default_factory=_no_step)
    fresh_few: int = 0
    fresh_many: int = 0
    fresh_lsb: Array = field(default_factory=_no_step)

    @property
    def coarse(self) -> bool:
        """Whether this sensor usually repeats itself at rest, so that a constant window can be genuine."""
        return self.few > max(self.many, 2.0)

    @property
    def step(self) -> float:
        """Standard uncertainty that quantisation alone puts into a mean, norm over axes, SI; 0 if fine."""
        if not self.coarse:
            return 0.0
        known = self.lsb[np.isfinite(self.lsb)]
        return float(np.sqrt((known**2).sum() / 12.0))

    def observed(self, windows: SensorWindows, looked: Flags, ceiling: float) -> Coarseness:
        """Count the windows looked at, (n,), that are quieter than `ceiling`; used only after `renewed`."""
        quiet = looked & (windows.spread <= ceiling) & (windows.rows[:, N] > 0) & ~windows.constant
        if not quiet.any():
            return self
        few = quiet & windows.few
        return replace(
            self,
            fresh_few=self.fresh_few + int(few.sum()),
            fresh_many=self.fresh_many + int((quiet & ~few).sum()),
            fresh_lsb=frozen(windows.rows[few, LSB].min(axis=0, initial=np.inf)).clip(max=self.fresh_lsb),
        )

    def renewed(self, settings: DetectorSettings) -> Coarseness:
        """Add the fresh counts to the past ones, which decay by as many windows."""
        n_fresh = self.fresh_few + self.fresh_many
        decay = 0.5 ** (n_fresh * settings.window_s / settings.half_life_s)
        lsb = self.fresh_lsb if self.fresh_few else self.lsb
        return Coarseness(self.few * decay + self.fresh_few, self.many * decay + self.fresh_many, lsb)


def stuck(rows: Array) -> Flags:
    """Tell in which rows (n, COLUMNS) one axis shows one value while another one shows many, (n,)."""
    holds = rows[:, D2] == 0
    many = ~holds & (rows[:, HIGH] - rows[:, LOW] > MANY_CODES * rows[:, LSB])
    return np.asarray(holds.any(axis=1) & many.any(axis=1))


@dataclass(slots=True)
class SensorWindows:
    """What one sensor's windows show, whatever the noise floor; (n,) each.

    rows: (n, COLUMNS). spread: standard deviation of single samples, SI. rates: octave of the sampling rate.
    constant: no value changed. stuck: one axis did not change while another had many codes. few: few codes
    on every axis. sparse: too few samples. quantisation_allowance: variance that rounding may add where there
    are few codes, SI squared.
    """

    rows: Array
    spread: Array
    rates: NDArray[np.intp]
    constant: Flags
    stuck: Flags
    few: Flags
    sparse: Flags
    quantisation_allowance: Array

    @classmethod
    def of(cls, rows: Array, settings: DetectorSettings) -> SensorWindows:
        """Derive from one sensor's rows (n, COLUMNS)."""
        if not rows[:, N].any():
            return cls.absent(rows)
        lsb = rows[:, LSB]
        narrow = rows[:, HIGH] - rows[:, LOW] <= FEW_CODES * lsb
        quantisation_allowance = across(np.where(narrow & np.isfinite(lsb), 0.25 * lsb * lsb, 0.0)) / 3.0
        rate = rows[:, N] / ((rows[:, K_END] - rows[:, K]).clip(1.0) * settings.window_s)
        constant = across(rows[:, D2]) == 0
        few = narrow[:, 0] & narrow[:, 1] & narrow[:, 2] & ~constant
        scarce = sparse(rows, settings.min_samples)
        return cls(
            rows, spread(rows), rate_class(rate), constant, stuck(rows), few, scarce, quantisation_allowance
        )

    @classmethod
    def absent(cls, rows: Array) -> SensorWindows:
        """Return the windows of a sensor that is not there: no sample, no change."""
        n = rows.shape[0]
        none, yes, no = np.zeros(n), np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
        return cls(rows, none, np.zeros(n, dtype=np.intp), yes, no, no, yes, none)

    @classmethod
    def joined(cls, parts: Sequence[SensorWindows]) -> SensorWindows:
        """Join windows, one run after another."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__slots__))

    def __getitem__(self, part: slice) -> SensorWindows:
        return SensorWindows(*(getattr(self, name)[part] for name in self.__slots__))

    def exceeds(self, floor: Floor, factor: float, ceiling: float) -> Flags:
        """Tell which spreads exceed `factor` times the floor, with rounding allowed for, or the ceiling."""
        limit = np.sqrt((factor * floor.level[self.rates]) ** 2 + self.quantisation_allowance)
        return np.asarray(self.spread > np.minimum(limit, ceiling))


@dataclass(slots=True)
class Windows:
    """Windows of both sensors. rows: (n, 2 COLUMNS), gyroscope columns 0 where they are unusable."""

    rows: Array
    accel: SensorWindows
    gyro: SensorWindows

    @classmethod
    def of(cls, accel: Array, gyro: Array, widths: Index, settings: DetectorSettings) -> Windows:
        """Join two sensors' cell rows into windows; widths: cells of the window of each accelerometer row."""
        nearest = np.minimum(np.searchsorted(accel[:, K], gyro[:, K]), widths.size - 1)
        window = settings.window_s
        rows = paired(joined(accel, widths, window), joined(gyro, widths[nearest], window))
        gyro_rows = rows[:, COLUMNS:]
        unusable = gyro_rows[:, GAP] > longest_pause(gyro_rows, window, settings.gap_s)
        unusable |= sparse(gyro_rows, settings.min_samples)
        gyro_rows[unusable | (across(gyro_rows[:, D2]) == 0) | stuck(gyro_rows)] = 0.0
        return cls(rows, SensorWindows.of(rows[:, :COLUMNS], settings), SensorWindows.of(gyro_rows, settings))

    @classmethod
    def joined(cls, parts: Sequence[Windows]) -> Windows:
        """Join windows, one run after another."""
        if len(parts) == 1:
            return parts[0]
        accel, gyro = (SensorWindows.joined([getattr(p, half) for p in parts]) for half in ("accel", "gyro"))
        return cls(np.concatenate([part.rows for part in parts]), accel, gyro)

    def __len__(self) -> int:
        return int(self.rows.shape[0])

    def __getitem__(self, part: slice) -> Windows:
        if part == slice(0, len(self)):
            return self
        return Windows(self.rows[part], self.accel[part], self.gyro[part])


def classify(
    windows: Windows, floors: tuple[Floor, Floor], coarse: bool, settings: DetectorSettings
) -> Codes:
    """Return each window's label as an index into LABELS, (n,).

    floors: of accelerometer and gyroscope. coarse: the accelerometer may repeat itself at rest.
    """
    accel, mean = windows.accel, windows.accel.rows[:, MEAN]
    norm = np.sqrt(mean[:, 0] ** 2 + mean[:, 1] ** 2 + mean[:, 2] ** 2)
    conditions = [
        accel.rows[:, GAP] > longest_pause(accel.rows, settings.window_s, settings.gap_s),
        accel.sparse,
        (norm < settings.force_low) | (norm > settings.force_high),
        accel.stuck | (accel.constant & (not coarse)),
        accel.exceeds(floors[0], settings.accel_factor, settings.accel_ceiling),
        windows.gyro.exceeds(floors[1], settings.gyro_factor, settings.gyro_ceiling),
    ]
    codes = np.full(len(windows), STILL, dtype=np.int8)
    for code in range(len(conditions), 0, -1):  # the first that applies is set last
        codes[conditions[code - 1]] = code
    return codes


def trainable(windows: Windows, codes: Codes) -> tuple[Flags, Flags]:
    """Tell which windows may train the two noise floors: whole, plausible and not frozen ones."""
    whole = (codes == STILL) | (codes >= ACCEL_MOVING)
    return whole & ~windows.accel.constant, whole & ~windows.gyro.constant
