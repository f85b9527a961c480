"""The energy ledger: the sensor time, samples, wake-ups and processor time of each day.

Grammenos et al. 2018 (5.3) judge calibration by its power. A day is 86400 s of engine time, counted from the
first sample. The ledger adds up; others measure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from stillcal.daemon.wire.messages import Status

DAY_S = 86400.0
KEPT_DAYS = 92
"""Days that are kept: a quarter of a year, as long as rotation segments are remembered."""
MOMENT_S = 1.0
"""Time after the end of a day that still counts to it, s: a stream of one day ends just beyond it."""


@dataclass(slots=True)
class Day:
    """One day. number: from 0.

    observed_s: engine time that passed. sensors_on_s, wakeups: as the phone reports, 0 where it does not.
    asked_s: time for which the engine wanted them on. samples: of both sensors. cpu_s: of this process.
    """

    number: int
    observed_s: float = 0.0
    sensors_on_s: float = 0.0
    asked_s: float = 0.0
    samples: int = 0
    wakeups: int = 0
    cpu_s: float = 0.0


@dataclass(slots=True)
class EnergyLedger:
    """The days, oldest first, at most KEPT_DAYS. told: the phone's last status; told_at: its engine time."""

    days: list[Day] = field(default_factory=list)
    began: float | None = None
    newest: float = -math.inf
    told: Status | None = None
    asked_s: float = 0.0
    cpu_s: float = 0.0
    told_at: float | None = None

    def samples(self, t: float, count: int) -> None:
        """Count samples that end at t (s)."""
        self._day(t).samples += count

    def status(self, t: float, status: Status) -> float:
        """Take the phone's own totals, which start at 0 when it restarts.

        Sensors are on for no longer than the time since the last status, or the first record, and for
        no longer than a day in one day; more is left out. Returns by how much the phone said more, s.
        """
        last = self.told
        if last is None or status.on_time < last.on_time or status.wakeups < last.wakeups:
            last = Status(0.0, 0.0, False, 0)
        day = self._day(t)
        since = self.began if self.told_at is None else self.told_at
        passed = max(self.newest - (self.newest if since is None else since), 0.0)
        on = min(status.on_time - last.on_time, passed)
        day.sensors_on_s = min(day.sensors_on_s + on, DAY_S)
        day.wakeups += status.wakeups - last.wakeups
        known = self.told is not None and last is self.told
        self.told, self.told_at = status, self.newest
        return status.on_time - last.on_time - passed if known else 0.0

    def totals(self, t: float, asked_s: float, cpu_s: float) -> None:
        """Take the engine's asked-for time and this process's processor time, both in s since it began."""
        day = self._day(t)
        day.asked_s += max(asked_s - self.asked_s, 0.0)
        day.cpu_s += max(cpu_s - self.cpu_s, 0.0)
        self.asked_s, self.cpu_s = asked_s, cpu_s

    def copy(self) -> EnergyLedger:
        """Return an independent copy."""
        return replace(self, days=[replace(day) for day in self.days])

    def restarted(self) -> None:
        """Note a restart of this process, whose processor time counts from 0 again."""
        self.cpu_s = 0.0

    def _day(self, t: float) -> Day:
        """Return the day of t (s), or the newest day where t is before it."""
        if self.began is None:
            self.began = self.newest = t
        number = max(int((t - self.began - MOMENT_S) // DAY_S), self.days[-1].number if self.days else 0)
        if not self.days:
            self.days = [Day(number)]
        elif number > self.days[-1].number:
            self._turn_to(number)
        day = self.days[-1]
        day.observed_s += max(t - self.newest, 0.0)
        self.newest = max(t, self.newest)
        return day

    def _turn_to(self, number: int) -> None:
        """Begin a new day; time up to midnight belongs to the old one. Days without data have no entry."""
        assert self.began is not None
        last = self.days[-1]
        last.observed_s += max(self.began + (last.number + 1) * DAY_S - self.newest, 0.0)
        self.newest = max(self.newest, self.began + number * DAY_S)
        self.days = [*self.days, Day(number)][-KEPT_DAYS:]
