"""Plain NumPy: a .npz of named arrays, or a .py with a function to import or paste.

The arrays are the store's own: scale (3, 3), bias (3,), bias_slope, bias_quadratic and bias_cubic (3,) of K,
reference_temperature_c (), temperature_limits_c (2,) beyond which the curve stays as it is, each with
accelerometer_ or gyroscope_ before it, and gyroscope_g_sensitivity (3, 3). The function is
correct(t, temperature, force, rate) with raw force (n, 3) m/s^2 and rate (n, 3) rad/s, or None; it returns
both corrected. temperature: (n,) degC or None.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.calibration.terms import ROUNDS
from stillcal.calib_core.errors import UserError
from stillcal.replay.export import of_reading
from stillcal.replay.export.imu import CORRECTION, ImuParameters, SensorPart
from stillcal.replay.export.target import Target, commented, finite

FIELDS = {
    "scale": ("scale", (3, 3)),
    "bias": ("bias", (3,)),
    "bias_slope": ("slope", (3,)),
    "bias_quadratic": ("quadratic", (3,)),
    "bias_cubic": ("cubic", (3,)),
    "reference_temperature_c": ("reference_c", ()),
    "temperature_limits_c": ("limits", (2,)),
    "g_sensitivity": ("matrix", (3, 3)),
    "white_noise_density": ("", (3,)),
}
"""Name in the file, name in the record, shape."""


def arrays(imu: ImuParameters) -> dict[str, Array]:
    """Return all that is known as named arrays."""
    out: dict[str, Array] = {}
    for name, part in imu.parts():
        for key, (attribute, _) in FIELDS.items():
            value = getattr(part, attribute) if attribute else None
            if value is not None:
                out[f"{name}_{key}"] = np.asarray(value, dtype=np.float64)
        if part.noise is not None:
            out[f"{name}_white_noise_density"] = part.noise.white
    return out


class Npz(Target):
    """np.load(FILE)["accelerometer_scale"], and so on."""

    name = "npz"
    title = "a NumPy archive"
    source = "numpy.savez"

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return everything but slow noise and delay."""
        return imu.named(*CORRECTION, "white noise")

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return the archive; its array `remarks` holds the comments."""
        file = io.BytesIO()
        np.savez(file, remarks=np.array(list(remarks)), **arrays(imu))  # type: ignore[arg-type]
        return file.getvalue()

    def read(self, data: bytes) -> ImuParameters:
        """Return what the archive holds; arrays of other names are left alone."""
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as archive:
                values = {name: np.asarray(archive[name]) for name in archive.files if name != "remarks"}
        except Exception as error:  # the libraries raise whatever they meet: a version, a cipher, damage
            raise UserError("not a NumPy archive (.npz)") from error
        return of_arrays(values)


def of_arrays(values: dict[str, Array]) -> ImuParameters:
    """Return parameters from named arrays. Raises UserError where none is there or a shape is wrong."""
    parts = {}
    for name in ("accelerometer", "gyroscope"):
        found = {
            attribute: finite(values[f"{name}_{key}"], shape, f"{name}_{key}")
            for key, (attribute, shape) in FIELDS.items()
            if attribute and f"{name}_{key}" in values
        }
        if found:
            reference, limits = found.pop("reference_c", None), found.pop("limits", None)
            part = SensorPart(
                reference_c=None if reference is None else float(reference),
                limits=None if limits is None else (float(limits[0]), float(limits[1])),
            )
            parts[name] = replace(part, **found)  # type: ignore[arg-type]  # FIELDS says which
    if not parts:
        raise UserError(
            "holds none of accelerometer_scale, accelerometer_bias, gyroscope_scale, gyroscope_bias"
        )
    return ImuParameters(accelerometer=parts.get("accelerometer"), gyroscope=parts.get("gyroscope"))


class Python(Target):
    """A Python module with the numbers and the function `correct`."""

    name = "numpy"
    title = "a Python module"
    source = "the store's own model, docs/api.md"
    invertible = False

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return all that a correction uses."""
        return imu.named(*CORRECTION) | imu.of_reading()

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return the module."""
        text = commented(remarks) + "import numpy as np\n\n"
        own = [term for _, part in imu.parts() for term in part.terms]
        for name, value in (arrays(imu) | of_reading.constants(own)).items():
            if not name.endswith("density"):
                text += (
                    f"{name} = np.array({value.tolist()!r})\n"
                    if value.ndim
                    else f"{name} = {float(value)!r}\n"
                )
        return (text + "\n\n" + _function(imu)).encode()


def _own(argument: str, terms: Sequence[Term]) -> list[str]:
    """Return the lines that take off what a reading itself adds, solved for by rounds."""
    if not terms:
        return []
    start, reach = of_reading.counts_from(terms), of_reading.reach(terms)
    warmer = f"0.0 if temperature is None else np.nan_to_num(temperature - {start!r})[:, None]"
    return [
        *([] if start is None else [f"warmer = {warmer}"]),
        "own = 0.0",
        f"for _ in range({ROUNDS}):",
        f"    x = {argument} - own",
        *([] if reach is None else [f"    held = np.clip(x, {-reach!r}, {reach!r})"]),
        f"    own = {of_reading.error(terms)}",
        f"{argument} = {argument} - own",
    ]


def _function(imu: ImuParameters) -> str:
    lines = [
        "def correct(t, temperature, force, rate):",
        '    """Return force (n, 3) m/s^2 and rate (n, 3) rad/s, or None, corrected."""',
    ]
    for argument, (name, part) in (
        ("force", ("accelerometer", imu.accelerometer)),
        ("rate", ("gyroscope", imu.gyroscope)),
    ):
        if part is None:
            continue
        body = [f"offset = {name}_bias" if part.bias is not None else "offset = np.zeros(3)"]
        if part.slope is not None:
            body += [
                "if temperature is not None:",
                f"    held = np.clip(temperature, *{name}_temperature_limits_c)"
                if part.limits
                else "    held = temperature",
                f"    warmer = np.nan_to_num(held - {name}_reference_temperature_c)[:, None]",
                f"    offset = offset + warmer * {name}_bias_slope",
            ]
            powers = (("quadratic", 2), ("cubic", 3))
            body += [
                f"    offset = offset + warmer**{power} * {name}_bias_{key}"
                for key, power in powers
                if getattr(part, key) is not None
            ]
        if part.matrix is not None:
            body += ["if force is not None:", f"    offset = offset + force @ {name}_g_sensitivity.T"]
        body += [f"{argument} = {argument} - offset", *_own(argument, part.terms)]
        if part.scale is not None:
            body.append(f"{argument} = {argument} @ {name}_scale.T")
        lines += [f"    if {argument} is not None:", *(f"        {line}" for line in body)]
    return "\n".join([*lines, "    return force, rate"]) + "\n"
