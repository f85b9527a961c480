"""kalibr's imu.yaml and imu chain, which OpenVINS reads too.

kalibr (ethz-asl/kalibr, aslam_offline_calibration/kalibr/python/kalibr_imu_camera_calibration/IccSensors.py,
IccScaledMisalignedImu) models raw force = M a + b and raw rate = M C_gyro_i w + A C_gyro_i a + b, with the
specific force a (acceleration less gravity), SI units, rows as lists. Its biases are splines that it
estimates anew and never writes down. kalibr_common/ConfigReader.py: noise_density is continuous, a sample has
a standard deviation of noise_density sqrt(update_rate); random_walk is per sqrt(s); both must be above 0.

OpenVINS (rpng/open_vins, ov_msckf, VioManagerOptions.h) reads Ta (M of the accelerometer), Tw (M of the
gyroscope), R_IMUtoGYRO (C_gyro_i), R_IMUtoACC and Tg. Its Propagator.cpp corrects with
force = R_IMUtoACC' inv(Ta) (raw - b) and rate = R_IMUtoGYRO' inv(Tw) (raw - b - Tg force). It keeps six
numbers of each inverse. So there the matrices are lower triangular, as kalibr makes its own, and the rotation
stands apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.maths.rms import rms
from stillcal.replay.export.imu import ImuParameters, SensorPart
from stillcal.replay.export.target import Target, commented, finite, one_number, text_of

MODEL = "scale-misalignment"


class Kalibr(Target):
    """One file: noise at the top level, as `--imu` wants it, and the chain with the matrices under imu0."""

    name = "kalibr"
    title = "kalibr"
    source = "ethz-asl/kalibr IccSensors.py, ConfigReader.py; rpng/open_vins VioManagerOptions.h"

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return scale, misalignment, g-sensitivity and noise; kalibr's files have no bias."""
        return imu.named("scale", "misalignment", "g-sensitivity", "white noise", "slow noise")

    def notes(self, imu: ImuParameters) -> list[str]:
        """Return what kalibr needs beyond the file."""
        out = one_number(imu)
        noises = [part.noise for _, part in imu.parts()]
        if None in noises or len(noises) < 2:
            out.append(
                "without the noise of both sensors kalibr does not accept this file as --imu; add --phone"
            )
        elif not all(noise is not None and noise.slow for noise in noises):
            out.append("kalibr wants a random walk above 0: put in the sensor's own where it is missing here")
        return out

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return YAML."""
        noise = dict(_noise(imu))
        chain: dict[str, Any] = {**noise, "T_i_b": np.eye(4), "time_offset": 0.0}
        chain |= {"model": MODEL} | _intrinsics(imu)
        text = commented(remarks) + _yaml(noise, 0) + "imu0:\n" + _yaml(chain, 1)
        return text.encode()

    def read(self, data: bytes) -> ImuParameters:
        """Return scale and g-sensitivity of imu0, or of the top level where there is no imu0."""
        document = _parsed(data)
        chain = document.get("imu0", document)
        if not isinstance(chain, Mapping):
            raise UserError("imu0: expected a mapping")
        accel, gyro = _matrices(chain)
        if accel is None and gyro is None:
            raise UserError(
                "holds no intrinsics: expected imu0 with accelerometers and gyroscopes, or Ta and Tw"
            )
        return ImuParameters(accelerometer=accel, gyroscope=gyro)


def _noise(imu: ImuParameters) -> Iterator[tuple[str, Any]]:
    if imu.rate_hz is None:
        return
    yield "rostopic", "/imu0"
    yield "update_rate", imu.rate_hz
    for name, part in imu.parts():
        if part.noise is not None:
            yield f"{name}_noise_density", rms(part.noise.two_sided)
            if part.noise.slow:
                yield f"{name}_random_walk", rms(part.noise.walk_alike())


def _intrinsics(imu: ImuParameters) -> dict[str, Any]:
    out: dict[str, Any] = {}
    accel, gyro = imu.accelerometer, imu.gyroscope
    if accel is not None and accel.scale is not None:
        lower, rotation = lower_times_rotation(accel.gain)
        out["accelerometers"] = {"M": accel.gain}
        out |= {"Ta": lower, "R_IMUtoACC": rotation}
    if gyro is not None and gyro.scale is not None:
        lower, rotation = lower_times_rotation(gyro.gain)
        matrix = np.zeros((3, 3)) if gyro.matrix is None else gyro.matrix @ rotation.T
        out["gyroscopes"] = {"M": lower, "A": matrix, "C_gyro_i": rotation}
        # OpenVINS multiplies Tg with the force in the body's own axes.
        tg = np.zeros((3, 3)) if gyro.matrix is None else gyro.matrix
        out |= {"Tw": lower, "R_IMUtoGYRO": rotation, "Tg": tg}
    return out


def lower_times_rotation(matrix: Array) -> tuple[Array, Array]:
    """Return a lower triangular matrix with a positive diagonal and a rotation whose product is `matrix`.

    The rotation of a triangular matrix is unity. A matrix that reflects leaves an improper rotation.
    """
    q, r = np.linalg.qr(matrix.T)
    sign = np.where(np.diag(r) < 0.0, -1.0, 1.0)
    return np.tril((sign[:, None] * r).T) + 0.0, np.asarray((q * sign).T)


def _matrices(chain: Mapping[str, Any]) -> tuple[SensorPart | None, SensorPart | None]:
    accel = _matrix(chain, "accelerometers", "M")
    if accel is None and "Ta" in chain:
        rotation = finite(chain.get("R_IMUtoACC", np.eye(3)), (3, 3), "R_IMUtoACC")
        accel = finite(chain["Ta"], (3, 3), "Ta") @ rotation
    gyro, matrix = _matrix(chain, "gyroscopes", "M"), _matrix(chain, "gyroscopes", "A")
    if gyro is not None:
        found = _matrix(chain, "gyroscopes", "C_gyro_i")
        rotation = np.eye(3) if found is None else found
        gyro, matrix = gyro @ rotation, None if matrix is None else matrix @ rotation
    elif "Tw" in chain:
        rotation = finite(chain.get("R_IMUtoGYRO", np.eye(3)), (3, 3), "R_IMUtoGYRO")
        gyro = finite(chain["Tw"], (3, 3), "Tw") @ rotation
        matrix = finite(chain["Tg"], (3, 3), "Tg") if "Tg" in chain else None
    kept = None if matrix is None or not matrix.any() else matrix
    return _part(accel, "accelerometers", None), _part(gyro, "gyroscopes", kept)


def _matrix(chain: Mapping[str, Any], sensor: str, key: str) -> Array | None:
    group = chain.get(sensor)
    if not isinstance(group, Mapping) or key not in group:
        return None
    return finite(group[key], (3, 3), f"{sensor}: {key}")


def _part(gain: Array | None, what: str, matrix: Array | None) -> SensorPart | None:
    if gain is None:
        return None
    if abs(np.linalg.det(gain)) < 1e-6:
        raise UserError(f"{what}: M has no inverse")
    return SensorPart(scale=np.asarray(np.linalg.inv(gain)), matrix=matrix)


def _parsed(data: bytes) -> Mapping[str, Any]:
    text = text_of(data)
    try:
        import yaml  # noqa: PLC0415 - an extra that only reading YAML needs
    except ImportError as error:
        raise UserError("reading YAML needs PyYAML: pip install 'stillcal[export]'") from error
    try:
        # OpenCV, with which OpenVINS reads, heads its files with a directive that YAML 1.1 does not know.
        document = yaml.safe_load(text.removeprefix("%YAML:1.0"))
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f", line {mark.line + 1}"
        raise UserError(f"not YAML{where}") from error
    if not isinstance(document, Mapping):
        raise UserError("expected a YAML mapping")
    return document


def _yaml(value: Mapping[str, Any], depth: int) -> str:
    pad, out = "  " * depth, ""
    for key, item in value.items():
        if isinstance(item, Mapping):
            out += f"{pad}{key}:\n{_yaml(item, depth + 1)}"
        elif isinstance(item, np.ndarray):
            rows = "".join(f"{pad}  - [{', '.join(map(_number, row))}]\n" for row in item.tolist())
            out += f"{pad}{key}:\n{rows}"
        else:
            out += f"{pad}{key}: {_number(item) if isinstance(item, float) else item}\n"
    return out


def _number(value: float) -> str:
    """Return a number that YAML 1.1 reads as one: it needs a point before an exponent."""
    text = repr(float(value))
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}e{exponent}" if e else text
