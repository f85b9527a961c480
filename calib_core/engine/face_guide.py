"""Guides a person who lays the phone on its six faces, and has it calibrated when the sixth is there."""

from __future__ import annotations

from dataclasses import replace

from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.engine.actions import Action, Level, Log
from stillcal.calib_core.engine.decisions import CalibrationPolicy
from stillcal.calib_core.engine.laid_faces import LaidFaces, Stage, begun
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.detector import StationaryDetector

LOOK_S = 1.0
"""s between two looks at what the phone lies on."""

FACE_S = 10.0
"""s after which a rest is not waited for any longer, and counts while the phone still lies there."""

GIVE_UP_S = 1800.0
"""s without a further face after which it is given up: the sensors are on all the while."""


class FaceGuide:
    """Moves the laying of faces in the engine's `state` on. actions: what is to be logged is added here."""

    def __init__(
        self,
        state: EngineState,
        detector: StationaryDetector,
        policy: CalibrationPolicy,
        actions: list[Action],
    ) -> None:
        self._state, self._detector, self._policy, self._actions = state, detector, policy, actions

    @property
    def laying(self) -> bool:
        """Whether faces are being laid."""
        return self._state.faces is not None and self._state.faces.stage is Stage.LAYING

    def begin(self, t: float) -> None:
        """Begin to lay faces at t (s); where some are laid already, go on with the others."""
        if not self.laying:
            self._state.faces = begun(t)
            self._say(t, "lay the phone on each of its six faces")

    def stop(self, t: float) -> None:
        """Give up at t (s) what was asked for, if it still goes on."""
        self._end(t, Stage.STOPPED, "stopped before the sixth face")

    def look(self, t: float) -> None:
        """Take the rests up to t (s); calibrate where the sixth face is there, give up after a long wait."""
        before = self._state.faces
        if before is None or not self.laying:
            return
        pool = self._state.pool.where(self._detector.still_valid)
        laid = self._state.faces = before.after(pool, t)
        if laid.done != before.done:
            self._say(t, laid.words)
        if not laid.missing:
            self._calibrate(laid, pool, t)
        elif t - laid.active_at > GIVE_UP_S:
            self._end(t, Stage.GIVEN_UP, f"given up: no further face for {GIVE_UP_S / 60:.0f} minutes")

    def _calibrate(self, laid: LaidFaces, pool: Pool, t: float) -> None:
        try:
            reason = self._policy.calibrate_by_faces(t, laid.counted(pool), laid.asked_again)
        except NotSupported as refusal:
            self._state.faces = laid.again(refusal, t)
            self._say(t, str(refusal))
        else:
            self._state.faces = replace(laid, stage=Stage.CALIBRATED, note=reason)

    def _end(self, t: float, stage: Stage, note: str) -> None:
        if self._state.faces is not None and self.laying:
            self._state.faces = replace(self._state.faces, stage=stage, note=note)
            self._say(t, note)

    def _say(self, t: float, why: str) -> None:
        self._actions.append(Log(t, Level.INFO, "faces", why))
