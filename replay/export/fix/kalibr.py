"""kalibr's imu.yaml, corrected: noise densities, random walks and update_rate, wherever they stand in it.

The lines are changed in their place, so that comments and everything else stay. What the numbers mean is
said, with sources, in `stillcal.replay.export.kalibr`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.errors import UserError
from stillcal.replay.export.fix.findings import (
    SENSORS,
    CannotHold,
    Finding,
    Fixed,
    apply_findings,
    common_ratio,
    note_change,
    recorded,
    walk_of,
)
from stillcal.replay.export.imu import root_mean_square


def fix(text: str | None, findings: Sequence[Finding]) -> Fixed:
    """Return the file with the differences in it; a new one with what was found where there is none."""
    fixed = Fixed("rostopic: /imu0\n" if text is None else text)

    def rate(finding: Finding) -> None:
        _multiply(
            fixed,
            "update_rate",
            common_ratio(finding, "rate"),
            float(recorded(finding, "rate")),
            text is None,
        )

    def white(finding: Finding) -> None:
        key = f"{SENSORS[finding['sensor']]}_noise_density"
        own = root_mean_square(recorded(finding, "density")) / float(np.sqrt(2.0))
        _multiply(fixed, key, common_ratio(finding, "density"), own, text is None)

    def slow(finding: Finding) -> None:
        name = "allan_deviation_100s"
        own = root_mean_square(walk_of(recorded(finding, name)))
        _multiply(
            fixed, f"{SENSORS[finding['sensor']]}_random_walk", common_ratio(finding, name), own, text is None
        )

    handlers = {"sample_rate": rate, "noise_level": white, "accel_slow_noise": slow, "gyro_slow_noise": slow}
    apply_findings(findings, handlers, fixed)
    return fixed


def _multiply(fixed: Fixed, key: str, factor: float, own: float, new: bool) -> None:
    """Multiply the number after `key:` wherever it stands; where it is missing, put the recording's own."""
    line = re.compile(rf"^([ \t]*{key}[ \t]*:[ \t]*)([^\s#]+)", re.MULTILINE)
    found = line.findall(fixed.text)
    if not found and not new:
        raise CannotHold(f"there is no {key} in it")
    if not found:
        fixed.text += f"{key}: {own:.10g}\n"
        note_change(fixed, key, np.nan, own)
        return

    def replaced(match: re.Match[str]) -> str:
        try:
            before = float(match[2])
        except ValueError as error:
            raise UserError(f"{key}: {match[2]!r} is not a number") from error
        after = before * factor
        note_change(fixed, key, before, after)
        return f"{match[1]}{after:.10g}"

    fixed.text = line.sub(replaced, fixed.text)
