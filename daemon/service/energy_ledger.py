"""The energy ledger: what each day cost in sensor time, samples, wake-ups and processor time.

Power is what Grammenos et al. 2018 (5.3) judge calibration by. Days are of engine time, 86400 s each from
the first sample on. Only sums here; nothing is measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from stillcal.daemon.wire.messages import Status

DAY_S = 86400.0
KEPT_DAYS = 400
MOMENT_S = 1.0
"""What comes so shortly after a day, s, is counted to it: a stream that lasts a day ends just beyond it."""


@dataclass(slots=True)
class Day:
    """A day's account. number: from 0.

    observed_s: engine time that went by. sensors_on_s, wakeups: told by the phone, 0 where it does not say.
    asked_s: for which the engine wanted the sensors on. samples: of both sensors. cpu_s: of this process.
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
    """Accounts by day, the oldest forgotten after KEPT_DAYS; what is counted up elsewhere comes as totals."""

    days: list[Day] = field(default_factory=list)
    began: float | None = None
    newest: float = -math.inf
    told: Status | None = None
    asked_s: float = 0.0
    cpu_s: float = 0.0

    def samples(self, t: float, count: int) -> None:
        """Count samples that end at t (s)."""
        self._day(t).samples += count

    def status(self, t: float, status: Status) -> None:
        """Take the phone's own totals; they begin anew when it restarts."""
        last = self.told
        if last is None or status.on_time < last.on_time or status.wakeups < last.wakeups:
            last = Status(0.0, 0.0, False, 0)
        day = self._day(t)
        day.sensors_on_s += status.on_time - last.on_time
        day.wakeups += status.wakeups - last.wakeups
        self.told = status

    def totals(self, t: float, asked_s: float, cpu_s: float) -> None:
        """Take the engine's asked-for time and this process's processor time, both in s since it began."""
        day = self._day(t)
        day.asked_s += max(asked_s - self.asked_s, 0.0)
        day.cpu_s += max(cpu_s - self.cpu_s, 0.0)
        self.asked_s, self.cpu_s = asked_s, cpu_s

    def copy(self) -> EnergyLedger:
        """Return a copy that goes its own way."""
        return replace(self, days=[replace(day) for day in self.days])

    def restarted(self) -> None:
        """Expect this process's processor time to count from 0 again."""
        self.cpu_s = 0.0

    def _day(self, t: float) -> Day:
        """Return the day of t (s), or the newest where t is older."""
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
        """Begin a new day: what went by up to midnight was the old one's; days nobody saw have no account."""
        assert self.began is not None
        last = self.days[-1]
        last.observed_s += max(self.began + (last.number + 1) * DAY_S - self.newest, 0.0)
        self.newest = max(self.newest, self.began + number * DAY_S)
        self.days = [*self.days, Day(number)][-KEPT_DAYS:]
