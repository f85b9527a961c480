"""What drives an effect: time, temperature, charging, force and rate, at any moments of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import Index
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.windows import WINDOW
from stillcal.calib_core.streams.resample import interpolate
from stillcal.calib_core.streams.samples import Samples
from stillcal.calib_core.streams.time_series import TimeSeries


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """The recording as a whole. span: (start, end) s; activity: (w, 2) s and 1 where the phone moved.

    switches: (m, 2) s and 1 on or 0 off the charger, None without charging events; reference_c: degC about
    which temperatures are counted, None without a thermometer. columns: further logged columns by name, each
    in its own unit about its mean in the static bins.
    """

    span: tuple[float, float]
    activity: Array
    switches: Array | None = None
    reference_c: float | None = None
    columns: Mapping[str, TimeSeries] = field(default_factory=dict)

    @property
    def charger_moved(self) -> bool:
        """Whether the phone was plugged in or out during the recording."""
        return self.switches is not None and moves(self.switches[:, 1])

    def heat_throughout(self, tau_s: float, plug: float, use: float, start: float) -> Array:
        """Return what `heat` is in every window of the recording, (w,)."""
        times = self.activity[:, 0]
        return self.heat(times, np.full(times.size, WINDOW), tau_s, plug, use, start)

    def heat(  # noqa: PLR0917 - a moment and four shares
        self, t: Array, duration: Array, tau: float, plug: float, use: float, start: float
    ) -> Array:
        """Solution (n,) of tau z' = plug on(t) + use active(t) - z, z(0) = start.

        t, duration: (n,) s, the middles of what it is averaged over, and how long that is.
        """
        times, active = self.activity[:, 0], self.activity[:, 1]
        on = np.zeros_like(times)
        if self.switches is not None:
            changed, states = self.switches.T
            on = states[np.maximum(np.searchsorted(changed, times, side="right") - 1, 0)]
        z = filtered(plug * on + use * active, np.exp(-WINDOW / tau))
        return TimeSeries(times, z + start * np.exp(-(times - times[0]) / tau)).mean(t, duration)


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """The drivers at n moments.

    t, duration: (n,) s, the middle of what a moment is the mean over and how long that is (0: an instant).
    force: (n, 3) m/s^2 and rate: (n, 3) rad/s, what true sensors would read, body axes; None where unknown.
    temperature: (n,) K about `history.reference_c`; charging: (n,) part of the moment on the charger;
    vibration: (n,) (m/s^2)^2; rest: (n,) index of the rest; None where not recorded. force_powers: means
    (n, 3) of powers of the force, by exponent, where the force changes within a moment.
    """

    t: Array
    duration: Array
    history: History
    force: Array | None = None
    rate: Array | None = None
    temperature: Array | None = None
    charging: Array | None = None
    vibration: Array | None = None
    rest: Index | None = None
    force_powers: Mapping[int, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.t.size)

    @property
    def age(self) -> Array:
        """Time (n,) since the recording began, s."""
        return np.asarray(self.t - self.history.span[0])

    @property
    def up(self) -> Array | None:
        """Direction (n, 3) of the force."""
        if self.force is None:
            return None
        return np.asarray(self.force / np.linalg.norm(self.force, axis=1, keepdims=True))

    def force_power(self, exponent: int) -> Array:
        """Return the mean (n, 3) of a power of the force on each axis; it must be known."""
        assert self.force is not None, "asked only where the force is known"
        known = self.force_powers.get(exponent)
        return np.asarray(self.force**exponent if known is None else known)

    def column(self, name: str) -> Array:
        """Return a further logged column (n,), in its own unit, about its mean in the static bins."""
        return self.history.columns[name].mean(self.t, self.duration)

    def during(self, rows: slice) -> Moments:
        """Return the drivers at some of the moments, those of motion only."""

        def of(values: Array | None) -> Array | None:
            return None if values is None else np.asarray(values[rows])

        force, rate, warm, plugged = map(of, (self.force, self.rate, self.temperature, self.charging))
        return Moments(self.t[rows], self.duration[rows], self.history, force, rate, warm, plugged)

    def border(self, i: int) -> float:
        """Time between moments i - 1 and i, s."""
        return float((self.t[i - 1] + self.duration[i - 1] / 2 + self.t[i] - self.duration[i] / 2) / 2)


def mean_in(course: TimeSeries, bins: Bins) -> float:
    """Return the mean of a logged column in static bins."""
    return float(course.mean(bins.t, bins.duration).mean())


def moments_of(bins: Bins, force: Array | None, covariates: Mapping[str, TimeSeries]) -> Moments:
    """Return the drivers in static bins. force: (n, 3) m/s^2, gravity in body axes; None where unknown.

    covariates: further logged columns by name, each in its own unit.
    """
    columns = {
        name: replace(course, values=course.values - mean_in(course, bins))
        for name, course in covariates.items()
    }
    warm, (start, end) = bins.temperature, bins.span
    reference = None if warm is None or not warm.size else float(warm.mean())
    return Moments(
        bins.t,
        bins.duration,
        History((float(start), float(end)), bins.activity, bins.charging_switches, reference, columns),
        force,
        np.zeros((len(bins), 3)),
        None if warm is None else np.asarray(warm - (reference or 0.0)),
        bins.charging,
        bins.vibration,
        bins.rest,
    )


def moves(curve: Array, least: float = 1e-9) -> bool:
    """Whether a driver changes at all."""
    return curve.size > 0 and float(np.ptp(curve)) > least


def filtered(source: Array, decay: float) -> Array:
    """First-order response to a source at each of its samples, from nothing."""
    from scipy.linalg.blas import dtbsv  # noqa: PLC0415 - the daemon stays light

    # Each value less `decay` of the one before it is (1 - decay) of the source: two diagonals of a matrix.
    diagonals = np.stack([np.ones(source.size), np.full(source.size, -decay)])
    return np.asarray(dtbsv(1, diagonals, (1.0 - decay) * source, lower=1, diag=1))


def first_order(course: TimeSeries, tau: float) -> TimeSeries:
    """Return what a first-order system of a time constant, s, makes of a course: in balance at first."""
    t = np.arange(course.t[0], course.t[-1] + WINDOW, WINDOW)
    source = course.mean(t, np.full(t.size, WINDOW))
    return TimeSeries(t, source[0] + filtered(source - source[0], float(np.exp(-WINDOW / tau))))


def at_samples(
    t: Array,
    history: History,
    sensors: tuple[Samples, Samples | Array | None],
    temperature: Array | None = None,
    charging: Array | None = None,
) -> Moments:
    """Return the drivers at samples t (n,), s. temperature: K about that of the history.

    sensors: the accelerometer and the gyroscope, or the rate (n, 3); what they read stands for the truth. A
    gyroscope without samples is none.
    """
    accelerometer, rate = sensors
    if isinstance(rate, Samples):
        rate = interpolate(t, rate.t, rate.xyz) if len(rate) else None
    force = interpolate(t, accelerometer.t, accelerometer.xyz)
    return Moments(t, np.zeros(t.size), history, force, rate, temperature, charging)


def turning(moments: Moments, t: Array, rate: Array, temperature: float) -> Moments:
    """Return the drivers during a turn. t: (n,) s; rate: (n, 3) rad/s; temperature: degC, constant."""
    reference = moments.history.reference_c
    warm = None if reference is None else np.full(t.size, temperature - reference)
    return replace(
        moments,
        t=t,
        duration=np.zeros(t.size),
        force=None,
        rate=rate,
        temperature=warm,
        charging=None,
        vibration=None,
        rest=None,
    )
