"""kalibr's imu.yaml, corrected: noise densities, random walks and update_rate, wherever they stand in it.

The lines are changed in their place, so that comments and everything else stay. What the numbers mean is
said, with sources, in `stillcal.replay.export.targets.kalibr`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from stillcal.calib_core.diagnosis.comparison.noise.white_noise import OF_DENSITY
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.maths.rms import rms
from stillcal.replay.export.fix.findings import (
    SENSORS,
    SLOW_NOISE,
    WHITE,
    CannotHold,
    Finding,
    Fixed,
    apply_findings,
    common_level,
    note_change,
    recorded,
    slow_walk,
)


def fix(text: str | None, findings: Sequence[Finding]) -> Fixed:
    """Return the file with the differences in it; a new one with what was found where there is none."""
    fixed = Fixed("rostopic: /imu0\n" if text is None else text)

    def change(key: str, own: float, level: Callable[[float], float] | None = None) -> None:
        """Change the number after `key:` wherever it stands; in a new file put the recording's own.

        level: what becomes of a number that is there, the recording's own without it.
        """

        def changed(found: re.Match[str]) -> str:
            before = _number(found[2], key)
            after = own if level is None else level(before)
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
        own = float(recorded(finding, "rate"))
        change("update_rate", own, lambda before: common_level(before, finding, "rate", own))

    def white(finding: Finding) -> None:
        own = rms(recorded(finding, WHITE)) / float(np.sqrt(2.0))
        key = f"{SENSORS[finding['sensor']]}_noise_density"
        change(key, own, lambda before: common_level(before, finding, WHITE, own))

    def slow(finding: Finding) -> None:
        own = rms(slow_walk(finding))
        if own == 0.0:
            raise CannotHold("the recording shows none, and kalibr wants a random walk above 0")
        change(f"{SENSORS[finding['sensor']]}_random_walk", own)

    handlers = {"sample_rate": rate, **dict.fromkeys(SLOW_NOISE, slow), **dict.fromkeys(OF_DENSITY, white)}
    apply_findings(findings, handlers, fixed)
    return fixed


def _number(text: str, key: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise UserError(f"{key}: {text!r} is not a number") from error
