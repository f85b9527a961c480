"""What the engine wants done: its lines in the log, calibrations into the store, news to subscribers."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from stillcal.calib_core.calibration.fingerprint import is_other_phone
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.actions import Action, Diagnose, Forget, Log, Publish, Reject
from stillcal.daemon.service.saving import Saving
from stillcal.daemon.service.storage import Storage, with_provenance
from stillcal.daemon.service.subscribers import CalibrationSubscribers
from stillcal.daemon.store.document import PASSING
from stillcal.daemon.system.log import say

FACES = "faces"
"""What is logged of known faces: each is saved at once, since a person laid it."""

REMEDY = "run `stillcal record day.csv.gz --hours 24`, then `stillcal diagnose day.csv.gz`"
"""Advice where recalibrating does not help."""


class EngineActions:
    """Carries out the engine's actions. provenance: returns the phone's line and name now."""

    def __init__(
        self,
        storage: Storage,
        saving: Saving,
        subscribers: CalibrationSubscribers,
        provenance: Callable[[], tuple[str, str]],
    ) -> None:
        self._storage, self._saving, self._subscribers = storage, saving, subscribers
        self._provenance = provenance

    def carry_out(self, actions: Iterable[Action]) -> None:
        """Carry out actions in order, without waiting."""
        for action in actions:
            if isinstance(action, Log):
                say(str(action.level), action.what, action.why, t=action.t, **action.fields)
                self._saving.changed(at_once=action.what == FACES)
            elif isinstance(action, Diagnose):
                say("warning", "diagnose", f"{action.reason}: {REMEDY}", t=action.t)
            elif isinstance(action, Publish | Reject | Forget):
                self._enqueue(action)

    def _enqueue(self, action: Publish | Reject | Forget) -> None:
        if isinstance(action, Publish):
            self._say_whose(action.record)
        self._storage.enqueue(with_provenance(action, *self._provenance()))
        self._saving.changed(at_once=action.record.acceptance.how not in PASSING)
        self._subscribers.announce(action)

    def _say_whose(self, record: CalibrationRecord) -> None:
        """Log where bias and scale are another phone's than those in use, and of which calibration before."""
        document = self._storage.document
        if not is_other_phone(record, document.current):
            return
        before = (
            entry.calibration for entry in reversed(document.history) if entry.calibration.accelerometer
        )
        again = next((c.id for c in before if not is_other_phone(record, c)), None)
        why = "bias and scale are not those of the phone before" + (
            ", but of an earlier one" if again else ""
        )
        say("warning", "another phone", why, calibration=record.id, earlier=again)
