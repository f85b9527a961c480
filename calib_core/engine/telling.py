"""What the engine tells: actions gathered in order until they are taken."""

from __future__ import annotations

from stillcal.calib_core.engine.actions import Action, Level, Log


class Telling:
    """Takes what is to be done or said; `taken` hands it on once."""

    def __init__(self) -> None:
        self._actions: list[Action] = []

    def act(self, action: Action) -> None:
        """Ask for something to be done."""
        self._actions.append(action)

    def log(self, t: float, level: Level, what: str, why: str, **fields: object) -> None:
        """Say what happened at t (s) and why."""
        self._actions.append(Log(t, level, what, why, fields))

    def taken(self) -> list[Action]:
        """Return what has gathered since the last time."""
        actions, self._actions = self._actions, []
        return actions
