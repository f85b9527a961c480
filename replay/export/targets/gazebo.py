"""Gazebo's SDF: the noise of an <imu> sensor, by axis.

gazebosim/gz-sensors, src/GaussianNoiseModel.cc: output = true + bias + N(mean, stddev) in every sample, SI
units. The bias is drawn from N(bias_mean, bias_stddev) and its sign by the throw of a coin. A constant bias
with a known sign is therefore a `mean`. The dynamic bias is the Gauss-Markov process of ethz-asl/
rotors_simulator, gazebo_imu_plugin.cpp: dynamic_bias_stddev is the density of its driving noise, so that in
the long run it spreads by dynamic_bias_stddev sqrt(dynamic_bias_correlation_time / 2).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import numpy as np

from stillcal.calib_core.errors import UserError
from stillcal.replay.export.imu import ImuParameters, SensorNoise, SensorPart
from stillcal.replay.export.target import Target, text_of

ELEMENTS = {"gyroscope": "angular_velocity", "accelerometer": "linear_acceleration"}
LONG_S = 1000.0
"""s: correlation time for slow noise without one of its own; over less time it is a random walk."""


class Gazebo(Target):
    """A model with one IMU, whose <imu> element is to be copied into the user's own."""

    name = "gazebo"
    title = "Gazebo"
    source = "gazebosim/gz-sensors GaussianNoiseModel.cc; ethz-asl/rotors_simulator gazebo_imu_plugin.cpp"

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return biases and noise."""
        return imu.named("bias", "white noise", "slow noise")

    def notes(self, imu: ImuParameters) -> list[str]:
        """Return what a user must add."""
        if imu.rate_hz is None:
            return ["the noise is not known, so stddev is 0: add --phone"]
        return ["stddev is that of one sample at update_rate: change both together"]

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return SDF."""
        comment = "".join(f"  {escape(line).replace('--', '- -')}\n" for line in remarks)
        rate = "" if imu.rate_hz is None else f"        <update_rate>{imu.rate_hz!r}</update_rate>\n"
        text = (
            f"<?xml version='1.0'?>\n<!--\n{comment}-->\n<sdf version='1.7'>\n  <model name='imu'>\n"
            "    <link name='link'>\n      <sensor name='imu' type='imu'>\n        <always_on>1</always_on>\n"
            f"{rate}        <imu>\n"
        )
        parts = dict(imu.parts())
        for name, element in ELEMENTS.items():
            if name in parts:
                text += f"          <{element}>\n{_axes(parts[name])}          </{element}>\n"
        return (text + "        </imu>\n      </sensor>\n    </link>\n  </model>\n</sdf>\n").encode()

    def read(self, data: bytes) -> ImuParameters:
        """Return the biases of the first <imu> in the file: each axis' mean."""
        imu = imu_element(text_of(data))
        parts = {}
        for name, element in ELEMENTS.items():
            means = [imu.findtext(f"{element}/{axis}/noise/mean") for axis in "xyz"]
            if None not in means:
                try:
                    parts[name] = SensorPart(bias=np.array([float(m or 0.0) for m in means]))
                except ValueError as error:
                    raise UserError(f"{element}: a mean is not a number") from error
        if not parts:
            raise UserError("its imu has no noise with a mean on x, y and z")
        return ImuParameters(accelerometer=parts.get("accelerometer"), gyroscope=parts.get("gyroscope"))


def imu_element(text: str) -> ElementTree.Element:
    """Return the first <imu> of an SDF file. Raises UserError."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UserError(f"not XML: {error}") from error
    found = root if root.tag == "imu" else root.find(".//imu")
    if found is None:
        raise UserError("holds no <imu> element")
    return found


def _axes(part: SensorPart) -> str:
    out = ""
    for axis, name in enumerate("xyz"):
        rows = "".join(f"                <{k}>{v!r}</{k}>\n" for k, v in noise_elements(part, axis))
        out += f"            <{name}>\n              <noise type='gaussian'>\n{rows}"
        out += f"              </noise>\n            </{name}>\n"
    return out


def noise_elements(part: SensorPart, axis: int) -> Iterator[tuple[str, float]]:
    """Yield the elements of one axis' <noise>, in the order of SDF's schema."""
    yield "mean", float(part.offset[axis])
    yield "stddev", 0.0 if part.noise is None else float(part.noise.sample_sd[axis])
    if part.noise is not None and part.noise.slow:
        density, tau = dynamic_bias(part.noise)
        yield "dynamic_bias_stddev", float(density[axis])
        yield "dynamic_bias_correlation_time", tau


def dynamic_bias(noise: SensorNoise) -> tuple[np.ndarray, float]:
    """Return density (3,) and correlation time, s: of a lone Gauss-Markov process exactly, else alike."""
    lone = len(noise.gauss_markov) == 1 and not noise.flicker.any() and not noise.random_walk.any()
    if lone:
        sigma, tau = noise.gauss_markov[0]
        return np.asarray(sigma * np.sqrt(2.0 / tau)), tau
    return noise.walk_alike(), LONG_S
