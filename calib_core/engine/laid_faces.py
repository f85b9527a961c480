"""How far six known faces have come that a person lays a phone on, one after another (ESGI'95, 3.4).

A face counts where the phone was laid on it since it is wanted: what it lay on before does not count, nor a
face that has to be laid again as long as the phone is not lifted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from stillcal.calib_core.accelerometer.known_attitudes import (
    FACE_DIRECTIONS,
    FACE_WORDS,
    faces_up,
    missing_faces,
)
from stillcal.calib_core.accelerometer.six_faces import SixFacesSettings
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.rest import RestState, directions, forces

SHORTEST_S = 5.0
"""s of the shortest rest that counts, of a phone that was lifted before."""

_REACH = SixFacesSettings().max_off_axis
_FACES = range(len(FACE_DIRECTIONS))


class Stage(StrEnum):
    """How the laying of faces stands."""

    LAYING = "laying"
    CALIBRATED = "calibrated"
    GIVEN_UP = "given_up"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class LaidFaces:
    """How far six faces have come.

    since: (6,) s, since when each face of FACE_DIRECTIONS is wanted. active_at: s, when the last one was
    laid, or wanted. done: numbers of the faces laid. newest: s, end of the newest rest that counts; last:
    number of the face that it was on, -1 for none. note: what to know of that rest, why faces are wanted
    again, or how it ended. asked_again: numbers of the faces that were wanted again: laid so a second time,
    they are taken as they lie, for a case need not be flat.
    """

    since: tuple[float, ...]
    active_at: float
    stage: Stage = Stage.LAYING
    done: tuple[int, ...] = ()
    newest: float = -math.inf
    last: int = -1
    note: str = ""
    asked_again: tuple[int, ...] = ()

    @property
    def missing(self) -> tuple[str, ...]:
        """How to lay the phone on the faces that are missing, in words, the next one first."""
        return missing_faces(np.array(self.done))

    @property
    def words(self) -> str:
        """How many faces are there."""
        return f"{len(self.done)} of {len(_FACES)} faces"

    def counted(self, pool: Pool) -> Pool:
        """Return the rests that count, and the rotation segments of the same time.

        Of several times that the phone was laid on one face the last one counts.
        """
        up, laid_at = faces_up(forces(pool.rests), _REACH), _laid_at(pool.rests)
        long = np.array([rest.duration for rest in pool.rests]) >= SHORTEST_S
        counts = (laid_at >= np.array((*self.since, min(self.since)))[up]) & long
        for face in _FACES:
            last = laid_at[counts & (up == face)].max(initial=-np.inf)
            counts &= (up != face) | (laid_at == last)
        held = tuple(held for held, one in zip(pool.held, counts.tolist(), strict=True) if one)
        return replace(pool.since(min(self.since)), held=held)

    def after(self, pool: Pool, t: float) -> LaidFaces:
        """Return how far it has come at t (s), with these rests held."""
        rests = self.counted(pool).rests
        if not rests or rests[-1].t_end <= self.newest:
            return self
        up = faces_up(forces(rests), _REACH)
        done, last = tuple(k for k in _FACES if k in up), int(up[-1])
        note = _tilted(rests[-1]) if last < 0 else ""
        if last in self.done and last != self.last:
            note = "the phone lay on that face before: the last time counts"
        active_at = t if len(done) > len(self.done) else self.active_at
        return replace(self, done=done, active_at=active_at, newest=rests[-1].t_end, last=last, note=note)

    def again(self, refusal: NotSupported, t: float) -> LaidFaces:
        """Return it with the faces that a refusal names wanted anew from t (s) on, or all six."""
        named = [k for k in _FACES if FACE_WORDS[k] in refusal.missing]
        wanted = named or _FACES
        since = tuple(t if k in wanted else since for k, since in enumerate(self.since))
        done = tuple(k for k in self.done if k not in wanted)
        asked = tuple(sorted({*self.asked_again, *wanted}))
        return replace(self, since=since, done=done, active_at=t, note=refusal.reason, asked_again=asked)


def begun(t: float) -> LaidFaces:
    """Return the state before the first face, all of them wanted from t (s) on."""
    return LaidFaces((t,) * len(_FACES), t)


def _laid_at(rests: Sequence[RestState]) -> Array:
    """Return when the phone was laid where it lay in each rest, (n,) s.

    That was before the rest where it goes on with another one: within two sample intervals of its end.
    """
    starts, ends = (np.array([getattr(rest, name) for rest in rests]) for name in ("t_start", "t_end"))
    counts = np.array([rest.n for rest in rests])
    went_on = starts - np.r_[-np.inf, ends][: len(rests)] <= 2.0 * (ends - starts) / counts
    return np.asarray(np.maximum.accumulate(np.where(went_on, -np.inf, starts)))


def _tilted(rest: RestState) -> str:
    """Return what to say of a rest on no face."""
    off = math.degrees(math.acos(float((directions(forces([rest])) @ FACE_DIRECTIONS.T).max())))
    return f"the phone lay {off:.0f} degrees from the nearest face: lay it flat on one"
