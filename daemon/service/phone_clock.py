"""Map the phone's time to the engine's: a constant offset, until the phone's clock starts again.

The engine runs on sample time, which must never run back. A phone that restarts counts from zero again, and
a broken one may leap by years. In both cases the engine's time continues by as much as the host's steady
clock has advanced; the host's wall clock plays no part. No clock is read here: `host` is CLOCK_BOOTTIME in s,
which goes on while the host is suspended.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.events import Charging, End, Event, Location, Temperature, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor

LEAP_S = 86400.0
"""A stamp ahead by more than this and the host's elapsed time is a fault of the clock, not a gap, s."""

BACK_S = 1.0
"""A stream that falls back by more than this has restarted; by less, its samples are out of order, s."""

LEAST_GAP_S = 1.0
"""Least engine time that a restart takes, s."""

GAP_S = 60.0
"""A pause between stamps above this has deadlines of the engine within it, whatever it was told, s."""

GAPS_S = 14 * LEAP_S
"""Pauses that the engine can be given at once: some 5 s of computing. A pause counts for a day at most, s."""

Timed = Samples | Event


@dataclass(slots=True)
class PhoneClock:
    """engine time = phone time + offset.

    session: the phone's number of its run, if it gives one. newest: engine time of the newest stamp, s;
    host: when it came, s of the host's clock, None after a restart of the daemon. latest: engine time of
    each stream's newest sample. restarts, leaps, disordered: what happened so far, the last in samples.
    _gaps: s, pauses between stamps since the engine last caught up.
    """

    offset: float = 0.0
    session: int | None = None
    newest: float = -math.inf
    host: float | None = None
    latest: dict[Sensor, float] = field(default_factory=dict)
    restarts: int = 0
    leaps: int = 0
    disordered: int = 0
    _anew: bool = False
    _gaps: float = 0.0

    def meet(self, session: int) -> bool:
        """Take the phone's session number; return whether it is a new session, whose clock starts again."""
        other = self.session is not None and session != self.session and math.isfinite(self.newest)
        self.session = session
        self._anew = self._anew or other
        return other

    def mapped(self, item: Timed, host: float) -> Timed | None:
        """Return a record with engine times, or None where nothing of it can be used."""
        first = float(item.t[0]) if isinstance(item, Samples) else item.t
        self._settle(first, item, host)
        self._gaps += _gap(first + self.offset - self.newest)
        if isinstance(item, Samples):
            return self._samples(item, host)
        t = item.t + self.offset
        self._note(t, host)
        return _at(item, t)

    def caught_up(self) -> None:
        """Note that the engine has been given all that was mapped."""
        self._gaps = 0.0

    def now(self, host: float) -> float | None:
        """Return the engine time at the host's time; None where no stamp has come since the start."""
        return None if self.host is None else self.newest + (host - self.host)

    def looked_at(self, stamp: float, host: float) -> float:
        """Return the engine time of a stamp that is not taken: it moves nothing, nor leaps ahead."""
        elapsed = 0.0 if self.host is None else max(host - self.host, 0.0)
        t = stamp + self.offset
        leaps = self._anew or t > self.newest + LEAP_S + elapsed
        return self.newest + elapsed if leaps and math.isfinite(self.newest) else t

    def phone(self, t: float) -> float:
        """Return the phone's time for an engine time."""
        return t - self.offset

    def _settle(self, first: float, item: Timed, host: float) -> None:
        """Choose a new offset where the phone's time does not continue."""
        t = first + self.offset
        elapsed = LEAST_GAP_S if self.host is None else max(host - self.host, LEAST_GAP_S)
        known = math.isfinite(self.newest)
        back = isinstance(item, Samples) and t < self.latest.get(item.sensor, -math.inf) - BACK_S
        ahead = known and (t > self.newest + LEAP_S + elapsed or self._gaps + _gap(t - self.newest) > GAPS_S)
        if (self._anew and known) or back or ahead:
            self.restarts += not ahead
            self.leaps += ahead
            self.offset = self.newest + elapsed - first
        self._anew = False

    def _samples(self, item: Samples, host: float) -> Samples | None:
        t = item.t if self.offset == 0.0 else frozen(item.t + self.offset)
        near = self._near(t)
        if near < len(t):
            self.disordered += len(t) - near
            item, t = item[:near], t[:near]
        late = int(np.searchsorted(t, self.latest.get(item.sensor, -math.inf), side="left"))
        self.disordered += late
        if late == len(t):
            return None
        self.latest[item.sensor] = float(t[-1])
        self._note(float(t[-1]), host)
        return replace(item, t=t)[late:] if late or self.offset else item

    def _near(self, t: Array) -> int:
        """Return how many stamps of a block come before more pauses than the engine can be given."""
        pauses = np.diff(np.maximum(t, self.newest))
        passed = self._gaps + np.cumsum(np.where(pauses > GAP_S, np.minimum(pauses, LEAP_S), 0.0))
        pauses_near = int(np.searchsorted(passed, GAPS_S, side="right"))
        if pauses_near:
            self._gaps = float(passed[pauses_near - 1])
        return pauses_near + 1

    def _note(self, t: float, host: float) -> None:
        if t >= self.newest:
            self.newest, self.host = t, host


def _gap(pause: float) -> float:
    """Return what a pause counts for, s."""
    return min(pause, LEAP_S) if GAP_S < pause < math.inf else 0.0


def _at(event: Event, t: float) -> Event:
    if isinstance(event, Charging):
        return Charging(t, event.on)
    if isinstance(event, Location):
        return Location(t, event.latitude, event.longitude, event.altitude)
    if isinstance(event, Temperature):
        return Temperature(t, event.celsius)
    return Tick(t) if isinstance(event, Tick) else End(t)
