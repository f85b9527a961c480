"""What a running daemon's answers mean, in sentences: whether the phone lies still, what it waits for.

Pure functions of two snapshots, the newest and the one before; nothing is drawn or asked here.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.accelerometer.observability import (
    Attitude,
    amplification,
    directions,
    most_helpful_attitude,
)
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.rest_pool import PoolSettings
from stillcal.calib_core.static.rest import attitude_labels
from stillcal.daemon.cli.watch.snapshot import Snapshot

LIMIT = 1.0
"""Amplification (observability.py) up to which the rests support every direction: no attitude is missing."""


def duration(seconds: float | None) -> str:
    """Say a length of time in its two largest units.

    >>> duration(5025.0), duration(42.4), duration(None)
    ('1 h 23 min', '42 s', '-')
    """
    if seconds is None:
        return "-"
    whole = round(seconds)
    for unit, name, part, smaller in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if whole >= unit:
            rest = whole % unit // part
            return f"{whole // unit} {name}" + (f" {rest} {smaller}" if rest else "")
    return f"{whole} s"


def up_directions(now: Snapshot) -> Array:
    """Return the directions (n, 3), newest first, that pointed up in the rests held."""
    forces = [rest["force"] for rest in now.stillness.get("rests", [])]
    return directions(np.array(forces, dtype=np.float64).reshape(-1, 3))


def attitudes(now: Snapshot) -> list[tuple[Array, int]]:
    """Return the distinct attitudes of the rests held and how many rests each has."""
    up = up_directions(now)
    labels = attitude_labels(up, PoolSettings().attitude_angle)
    return [(up[labels == k][0], int(np.sum(labels == k))) for k in range(int(labels.max(initial=-1)) + 1)]


def wanted_attitude(now: Snapshot) -> Attitude | None:
    """Return the attitude that would help most; None where those held leave no direction to a guess."""
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
        return "being watched"
    still = windows["windows_still"] - before.stillness["windows_still"]
    judged = windows["windows"] - before.stillness["windows"]
    if judged <= 0:
        return "being watched"
    return "lies still" if still == judged else "moves" if still == 0 else "comes to rest"


def last_rest(now: Snapshot) -> str:
    """Say when the phone last lay still and for how long."""
    rests = now.stillness.get("rests", [])
    if not rests:
        return "no rest yet"
    age, length = rests[0].get("age_s"), rests[0]["t_end_s"] - rests[0]["t_start_s"]
    when = "" if age is None else f"{duration(age)} ago, "
    return f"last rest {when}for {length:.0f} s"


def next_step(now: Snapshot) -> str:
    """Say what the daemon waits for, the most pressing first."""
    status = now.status
    if status.get("trouble"):
        return f"the disk: {status['trouble']}"
    if not status.get("connected"):
        return "the phone: its line is not open"
    if now.calibration is None:
        return _missing_for_calibration(now)
    if status.get("degraded"):
        return "rests: the calibration no longer fits"
    due = status.get("decides_in_s")
    return "nothing" if due is None else f"its next look, in {duration(due)}"


def _missing_for_calibration(now: Snapshot) -> str:
    status, missing = now.status, now.status.get("missing") or []
    if missing:
        return f"attitudes: {missing[0]}" + (f", and {len(missing) - 1} more" if len(missing) > 1 else "")
    if not status.get("rests_held"):
        return "the phone to lie still"
    if status.get("charging") is False:
        return "the charger: it calibrates while the phone charges"
    return "more attitudes"
