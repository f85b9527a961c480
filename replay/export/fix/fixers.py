"""The tools whose configuration can be corrected, each imported when it is asked for."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from stillcal.replay.export.fix.findings import Finding, Fixed, findings_of

FIXERS = {
    "phone": "phone",
    "gazebo": "gazebo",
    "airsim": "airsim",
    "gnss-ins-sim": "gnss_ins_sim",
    "imusensor": "imusensor",
    "kalibr": "kalibr",
}
"""Tool to module within this package; each has fix(text or None, findings)."""


def fixed_for(tool: str, text: str | None, answer: Mapping[str, Any]) -> Fixed:
    """Return a tool's configuration with the differences of an answer in it.

    text: the configuration of the simulation that was judged; None where there is none yet. Raises UserError
    where it is not the tool's, KeyError for a tool that is not known.
    """
    fix: Callable[[str | None, Sequence[Finding]], Fixed]
    fix = importlib.import_module(f"{__package__}.{FIXERS[tool]}").fix
    return fix(text, findings_of(answer))
