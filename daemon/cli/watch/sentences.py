"""Sentences about a running daemon: whether the phone is at rest, and what happens next.

Pure functions of two snapshots, the newest and the one before. Nothing is drawn here and no daemon is asked.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.accelerometer.known_attitudes import FACE_DIRECTIONS, FACE_WORDS
from stillcal.calib_core.accelerometer.observability import (
    Attitude,
    amplification,
    most_helpful_attitude,
)
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.rest_pool import PoolSettings
from stillcal.calib_core.static.rest import attitude_labels, directions
from stillcal.daemon.cli.watch.snapshot import Answer, Snapshot
from stillcal.daemon.system.plain_words import duration

LIMIT = 1.0
"""Amplification (observability.py) up to which the rests support every direction: no attitude is missing."""


def up_directions(now: Snapshot) -> Array:
    """Return the unit vectors (n, 3), body axes, that pointed up in the rests held, newest first."""
    forces = [rest["force"] for rest in now.stillness.get("rests", [])]
    return directions(np.array(forces, dtype=np.float64).reshape(-1, 3))


def attitudes(now: Snapshot) -> list[tuple[Array, int]]:
    """Return the distinct orientations held, as unit vectors (3,), and the number of rests in each."""
    up = up_directions(now)
    labels = attitude_labels(up, PoolSettings().attitude_angle)
    return [(up[labels == k][0], int(np.sum(labels == k))) for k in range(int(labels.max(initial=-1)) + 1)]


def wanted_attitude(now: Snapshot) -> Attitude | None:
    """Return the orientation to record next; None where those held support every direction.

    While known faces are laid it is the next of them.
    """
    if now.faces.get("stage") == "laying":
        faces = map(Attitude, FACE_DIRECTIONS, FACE_WORDS)
        return next((face for face in faces if face.words in now.faces["missing"]), None)
    held = np.array([up for up, _ in attitudes(now)]).reshape(-1, 3)
    return None if amplification(held) <= LIMIT else most_helpful_attitude(held)


def stillness(now: Snapshot, before: Snapshot | None) -> str:
    """Say whether the phone lies still, from the windows judged between two snapshots."""
    status, windows = now.status, now.stillness
    if not status.get("connected"):
        return "no phone"
    if not status.get("sensing"):
        return "sensors asleep"
    if before is None or not before.stillness or not windows:
        return "measuring"
    still = windows["windows_still"] - before.stillness["windows_still"]
    judged = windows["windows"] - before.stillness["windows"]
    if judged <= 0:
        return "measuring"
    return "at rest" if still == judged else "moving" if still == 0 else "partly at rest"


def last_rest(now: Snapshot) -> str:
    """Say when the last rest was and how long it lasted."""
    rests = now.stillness.get("rests", [])
    if not rests:
        return "no rest yet"
    age, length = rests[0].get("age_s"), rests[0]["t_end_s"] - rests[0]["t_start_s"]
    when = "" if age is None else f"{duration(age)} ago, "
    return f"last rest {when}for {length:.0f} s"


def next_step(now: Snapshot) -> str:
    """Say what the daemon needs or does next, the most urgent first."""
    status = now.status
    if status.get("trouble"):
        return f"the disk refuses writes: {status['trouble']}"
    if not status.get("connected"):
        return "waiting for the phone to connect"
    if now.faces.get("stage") == "laying":
        return laying_faces(now.faces)
    if status.get("sensor_faults") or status.get("degraded"):
        return "; ".join(status.get("sensor_faults", [])) or "needs new rests: the calibration no longer fits"
    if now.calibration is None or not now.calibration.get("accelerometer"):
        return _missing_for_calibration(now)
    due = status.get("decides_in_s")
    return "no decision is planned" if due is None else f"next measurement in {duration(due)}"


def laying_faces(faces: Answer) -> str:
    """Say how far six known faces have come, and how to lay the phone next. faces: as GetFaces answers."""
    note = f"{faces['note']}; " if faces["note"] else ""
    return f"{note}{faces['done']} of {len(FACE_DIRECTIONS)} faces: {faces['missing'][0]}"


MOST_FINDINGS = 3
"""Findings that are shown in the frame."""

HANDLED = {"corrected": "corrected", "on_trial": "being tested", "reported": "not corrected"}
"""What became of a finding, in words."""


def diagnosis(now: Snapshot) -> str:
    """Say what the newest self-diagnosis found, and what became of it."""
    found = now.diagnosis
    if found.get("trouble"):
        return f"no result: {found['trouble']}"
    if found.get("at_s") is None:
        return "none yet: it runs at night on the charger"
    effects = [f"{f['statement'].partition(':')[0]} ({HANDLED[f['handled']]})" for f in found["findings"]]
    if len(effects) > MOST_FINDINGS:
        more = len(effects) - MOST_FINDINGS
        effects = [*effects[:MOST_FINDINGS], f"{more} more, see `stillcal query GetFindings`"]
    return f"{duration(found.get('age_s'))} ago: {'. '.join(effects) or 'nothing beyond bias and scale'}"


def _missing_for_calibration(now: Snapshot) -> str:
    status, missing = now.status, now.status.get("missing") or []
    if missing:
        more = f"; {len(missing) - 1} more needed after that" if len(missing) > 1 else ""
        return f"{missing[0]}{more}"
    if not status.get("rests_held"):
        return "leave the phone lying still"
    if status.get("charging") is False:
        return "connect the charger: calibration runs while the phone charges"
    return "leave the phone lying in further orientations"
