"""Android's SensorAdditionalInfo: calibration, sampling and delay as a sensor's driver reports them to apps.

Android, hardware/libhardware/include/hardware/sensors-base.h, frameworks/base/core/java/android/hardware/
SensorAdditionalInfo.java: TYPE_VEC3_CALIBRATION (0x10002) has the first three rows of a homogeneous
matrix in row major order, calibrated = R raw + shift: R = scale, shift = -scale @ bias. TYPE_SAMPLING
(0x10004): sample period and its standard deviation, s. TYPE_UNTRACKED_DELAY (0x10000): delay and its standard
deviation, s. Axes are Android's, SI units, float. There is no file of these: a driver is compiled with them.
The JSON here names them; `uncalibrated_bias` is what values[3..5] of the uncalibrated sensor types carry.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from stillcal.calib_core.errors import UserError
from stillcal.daemon.store.document import pretty
from stillcal.replay.export.imu import ImuParameters, SensorPart
from stillcal.replay.export.target import Target, finite, text_of

VEC3_CALIBRATION, SAMPLING, UNTRACKED_DELAY = 0x10002, 0x10004, 0x10000
NAMES = {VEC3_CALIBRATION: "TYPE_VEC3_CALIBRATION", SAMPLING: "TYPE_SAMPLING"}
NAMES[UNTRACKED_DELAY] = "TYPE_UNTRACKED_DELAY"


class Android(Target):
    """JSON with one list of SensorAdditionalInfo frames a sensor."""

    name = "android"
    title = "Android"
    source = "Android sensors-base.h, SensorAdditionalInfo.java"

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return the whole affine correction, and the gyroscope's delay."""
        affine = imu.named("scale", "misalignment", "bias")
        return affine | {"gyroscope delay"}

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return JSON; the remarks are its member `comment`."""
        out: dict[str, Any] = {"comment": list(remarks)}
        for name, part in imu.parts():
            out[name] = _frames(part, imu.delay_s if name == "gyroscope" else None)
        return (pretty(out) + "\n").encode()

    def read(self, data: bytes) -> ImuParameters:
        """Return scale and bias of each sensor."""
        try:
            value = json.loads(text_of(data))
        except (ValueError, RecursionError) as error:
            raise UserError("not JSON") from error
        if not isinstance(value, dict):
            raise UserError("expected a JSON object with accelerometer or gyroscope")
        accelerometer, gyroscope = (_part(value.get(n), n) for n in ("accelerometer", "gyroscope"))
        if accelerometer is None and gyroscope is None:
            what = f"additional_info of type {VEC3_CALIBRATION} (TYPE_VEC3_CALIBRATION)"
            raise UserError(f"neither accelerometer nor gyroscope has {what}")
        return ImuParameters(accelerometer=accelerometer, gyroscope=gyroscope)


def _frames(part: SensorPart, delay: float | None) -> dict[str, Any]:
    frames = []
    out: dict[str, Any] = {}
    if part.scale is not None:
        rows = np.column_stack([part.scale, -part.scale @ part.offset])
        frames.append(_frame(VEC3_CALIBRATION, rows.ravel().tolist()))
        out["uncalibrated_bias"] = part.offset.tolist()
    if part.noise is not None:
        frames.append(_frame(SAMPLING, [1.0 / part.noise.rate_hz, 0.0]))
    if delay is not None:
        frames.append(_frame(UNTRACKED_DELAY, [delay, 0.0]))
    return out | {"additional_info": frames}


def _frame(kind: int, values: list[float]) -> dict[str, Any]:
    return {"type": kind, "name": NAMES[kind], "floatValues": values}


def _part(value: Any, name: str) -> SensorPart | None:
    """Return a sensor's correction, None where it has none: a sensor may be listed for its delay alone."""
    frames = value.get("additional_info") if isinstance(value, dict) else None
    for frame in frames if isinstance(frames, list) else []:
        if isinstance(frame, dict) and frame.get("type") == VEC3_CALIBRATION:
            rows = finite(frame.get("floatValues"), (3, 4), f"{name}: floatValues")
            scale = rows[:, :3]
            if abs(np.linalg.det(scale)) < 1e-6:
                raise UserError(f"{name}: floatValues have no inverse")
            return SensorPart(scale=scale, bias=np.asarray(-np.linalg.solve(scale, rows[:, 3]), np.float64))
    return None
