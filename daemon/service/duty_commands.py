"""Decide which commands keep the phone's sensors on only when the engine needs them. Pure.

The engine's wish comes in, commands go out. All times are the engine's, in s; the sender converts them to
the phone's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.daemon.wire.messages import Grant

PROBE_STEP_S = 1.0
"""Most credit at once during a probe, s: the probe may end early."""

LEAST_STEP_S = 1e-6
"""Least credit, s: less is lost where it is rounded on the phone's clock, and the phone waits for ever."""

STEP_S = 60.0
"""Credit where the engine plans no decision, s."""


@dataclass(slots=True)
class DutyCommands:
    """Remembers the last command. asleep_until: None where it was to sense or there was none."""

    asleep_until: float | None = None
    commanded: bool = False

    def forget(self) -> None:
        """Assume nothing about the phone, as after a connection or a restart."""
        self.asleep_until, self.commanded = None, False

    def asleep(self, now: float) -> bool:
        """Return whether the phone sleeps at `now`, by the last command."""
        return self.asleep_until is not None and now < self.asleep_until

    def due(self, want: Sense | Sleep, decides: float, now: float) -> list[Sense | Sleep]:
        """Return the commands that bring the phone into the wanted state.

        decides: time of the engine's next decision. A sleep that lasts until then is commanded without end,
        so that the phone does not wake for a decision that needs no sample.
        """
        if isinstance(want, Sense):
            return self._sense(want, now)
        if want.until <= now:
            return []
        until = math.inf if want.until >= decides else want.until
        if self.commanded and self.asleep_until == until:
            return []
        self.asleep_until, self.commanded = until, True
        return [Sleep(until)]

    def _sense(self, want: Sense, now: float) -> list[Sense | Sleep]:
        if self.commanded and not self.asleep(now):
            self.asleep_until = None
            return []
        self.asleep_until, self.commanded = None, True
        return [want]


def credit(want: Sense | Sleep, decides: float, now: float) -> Grant:
    """Return credit up to the next time at which the commands may change (flow control of the wire)."""
    goal = min(want.until, decides)
    if isinstance(want, Sense) and want.until < decides:
        goal = min(goal, now + PROBE_STEP_S)
    if not math.isfinite(goal):
        goal = now + STEP_S
    return Grant(max(goal, now + LEAST_STEP_S) if goal > now else now + PROBE_STEP_S)
