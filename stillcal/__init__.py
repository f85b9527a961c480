"""stillcal: calibrates a phone's accelerometer and gyroscope, and says what a sensor model leaves out.

>>> import stillcal
>>> recording = stillcal.load("sample:lab")
>>> calibration = stillcal.calibrate(recording)
>>> calibration.accelerometer.bias.round(2).tolist()
[0.39, -0.29, 0.2]

`load`, `calibrate`, `apply`, `diagnose`, `simulate` and what they return are the public interface; everything
below `stillcal.calib_core`, `stillcal.daemon`, `stillcal.replay` and `stillcal.config` is internal and may
change. Importing stillcal alone loads neither numpy nor scipy: the daemon imports this module too.
"""

from __future__ import annotations

from stillcal._version import __version__

TYPE_CHECKING = False  # typing's, whose import takes as long as all of this
if TYPE_CHECKING:
    from typing import Any

    from stillcal.api import (
        Calibration,
        Diagnosis,
        NotSupported,
        Recording,
        UserError,
        apply,
        calibrate,
        diagnose,
        load,
        simulate,
    )

__all__ = [
    "Calibration",
    "Diagnosis",
    "NotSupported",
    "Recording",
    "UserError",
    "__version__",
    "apply",
    "calibrate",
    "diagnose",
    "load",
    "simulate",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module 'stillcal' has no attribute {name!r}")
    from stillcal import api  # noqa: PLC0415 - it imports numpy and scipy

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted(__all__)
