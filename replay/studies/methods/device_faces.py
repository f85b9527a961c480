"""The six-face calibration (ESGI'95, approach 2) of every device of Stisen et al.'s still experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stillcal.calib_core.accelerometer.known_attitudes import Broken, FaceCalibration, calibrate_faces
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.formats.hhar_still import DeviceRecordings


@dataclass(frozen=True, slots=True, eq=False)
class DeviceOutcome:
    """One device with its calibration, or the reason why there is none.

    broken: whether the sensor itself was refused, and not too few faces.
    """

    recordings: DeviceRecordings
    calibration: FaceCalibration | None
    broken: bool = False
    reason: str = ""


def calibrate_devices(devices: Sequence[DeviceRecordings], gravity: float = STANDARD) -> list[DeviceOutcome]:
    """Calibrate every device whose recordings allow it.

    gravity: m/s^2, the standard value where the place is unknown.
    """
    return [_outcome(device, gravity) for device in devices]


def _outcome(device: DeviceRecordings, gravity: float) -> DeviceOutcome:
    try:
        calibration = calibrate_faces(device.means, device.spreads, device.uncertainties, gravity)
    except NotSupported as error:
        return DeviceOutcome(device, None, isinstance(error, Broken), str(error))
    return DeviceOutcome(device, calibration)
