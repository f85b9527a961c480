"""What the phone is told, so that its sensors are on only when the engine looks: pure decisions.

The engine's wants come in, commands go out. All times are the engine's, in s; whoever sends the commands
turns them into the phone's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.daemon.wire.messages import Grant

PROBE_STEP_S = 1.0
"""A phone in step with the engine goes on by this at most during a probe, which may be given up early."""

STEP_S = 60.0
"""The same where the engine names no time at all."""


@dataclass(slots=True)
class DutyCommands:
    """Remembers what the phone was told last. asleep_until: None where it was told nothing or to sense."""

    asleep_until: float | None = None
    commanded: bool = False

    def forget(self) -> None:
        """Assume nothing of the phone, as after it was plugged in or has restarted."""
        self.asleep_until, self.commanded = None, False

    def asleep(self, now: float) -> bool:
        """Say whether the phone sleeps at `now` as far as it was told."""
        return self.asleep_until is not None and now < self.asleep_until

    def due(self, want: Sense | Sleep, decides: float, now: float) -> list[Sense | Sleep]:
        """Return the commands that bring the phone to what is wanted.

        decides: when the engine decides anew. A sleep that lasts to its next decision is ordered without
        end, so that the phone does not wake for a decision that concerns no sample.
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
    """Let a phone in step with the engine go on to the next time at which its orders may change."""
    goal = min(want.until, decides)
    if isinstance(want, Sense) and want.until < decides:
        goal = min(goal, now + PROBE_STEP_S)
    if not math.isfinite(goal):
        goal = now + STEP_S
    return Grant(goal if goal > now else now + PROBE_STEP_S)
