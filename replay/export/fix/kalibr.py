"""kalibr's imu.yaml, corrected: noise densities, random walks and update_rate, wherever they stand in it.

The lines are changed in their place, so that comments and everything else stay. What the numbers mean is
said, with sources, in `stillcal.replay.export.kalibr`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.diagnosis.comparison.noise import OF_DENSITY
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.maths.rms import rms
from stillcal.replay.export.fix.findings import (
    SENSORS,
    CannotHold,
    Finding,
    Fixed,
    apply_findings,
    common_level,
    note_change,
    recorded,
    walk_of,
)


def fix(text: str | None, findings: Sequence[Finding]) -> Fixed:
    """Return the file with the differences in it; a new one with what was found where there is none."""
    fixed = Fixed("rostopic: /imu0\n" if text is None else text)

    def change(key: str, finding: Finding, name: str, own: float) -> None:
        """Change the number after `key:` wherever it stands; in a new file put the recording's own."""

        def changed(found: re.Match[str]) -> str:
            before = _number(found[2], key)
            after = common_level(before, finding, name, own)
            note_change(fixed, key, before, after)
            return f"{found[1]}{after:.10g}"

        line = re.compile(rf"^([ \t]*{key}[ \t]*:[ \t]*)([^\s#]+)", re.MULTILINE)
        if line.search(fixed.text):
            fixed.text = line.sub(changed, fixed.text)
        elif text is None:
            fixed.text += f"{key}: {own:.10g}\n"
            note_change(fixed, key, np.nan, own)
        else:
            raise CannotHold(f"there is no {key} in it")

    def rate(finding: Finding) -> None:
        change("update_rate", finding, "rate", float(recorded(finding, "rate")))

    def white(finding: Finding) -> None:
        own = rms(recorded(finding, "density")) / float(np.sqrt(2.0))
        change(f"{SENSORS[finding['sensor']]}_noise_density", finding, "density", own)

    def slow(finding: Finding) -> None:
        own = rms(walk_of(recorded(finding, "allan_deviation_100s")))
        change(f"{SENSORS[finding['sensor']]}_random_walk", finding, "allan_deviation_100s", own)

    handlers = {"sample_rate": rate, "accel_slow_noise": slow, "gyro_slow_noise": slow}
    handlers |= dict.fromkeys(OF_DENSITY, white)
    apply_findings(findings, handlers, fixed)
    return fixed


def _number(text: str, key: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise UserError(f"{key}: {text!r} is not a number") from error
