"""A C header with the numbers and a function that corrects one sample; C99, no library but math.h.

calibrated = scale (raw - bias - slope (T - T_ref) - matrix force), rows first, SI units and degC, the axes of
the recording: the store's own model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.calibration.terms import ROUNDS
from stillcal.replay.export import of_reading
from stillcal.replay.export.imu import CORRECTION, ImuParameters, SensorPart
from stillcal.replay.export.target import Target, commented


class CHeader(Target):
    """calibration.h."""

    name = "c"
    title = "a C header"
    source = "the store's own model"
    invertible = False

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return all that a correction uses."""
        return imu.named(*CORRECTION) | imu.of_reading()

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return the header."""
        text = commented(remarks, "// ") + "#ifndef STILLCAL_CALIBRATION_H\n#define STILLCAL_CALIBRATION_H\n"
        text += "#include <math.h>\n\n"
        for name, part in imu.parts():
            text += _constants(name, part)
        return (text + _function(imu) + "\n#endif\n").encode()


def _constants(name: str, part: SensorPart) -> str:
    text = ""
    for suffix, value in (("scale", part.scale), ("g_sensitivity", part.matrix)):
        if value is not None:
            rows = ", ".join("{" + _row(row) + "}" for row in value)
            text += f"static const double {name}_{suffix}[3][3] = {{{rows}}};\n"
    curve = (("slope", part.slope), ("quadratic", part.quadratic), ("cubic", part.cubic))
    for suffix, value in (("bias", part.bias), *((f"bias_{key}", value) for key, value in curve)):
        if value is not None:
            text += f"static const double {name}_{suffix}[3] = {{{_row(value)}}};\n"
    for constant, value in of_reading.constants(part.terms).items():
        text += f"static const double {constant}[3] = {{{_row(value)}}};\n"
    if part.reference_c is not None:
        text += f"static const double {name}_reference_temperature_c = {part.reference_c!r};\n"
    return text


def _row(values: Array) -> str:
    return ", ".join(map(repr, values.tolist()))


def _function(imu: ImuParameters) -> str:
    text = (
        "\n// Correct one sample in place: force[3] m/s^2, rate[3] rad/s. temperature: degC or NAN.\n"
        "static inline void stillcal_correct(double temperature, double force[3], double rate[3]) {\n"
        "  double offset[3], unbiased[3];\n"
        "  (void)temperature; (void)force; (void)rate; (void)offset; (void)unbiased;\n"
    )
    for argument, (name, part) in zip(("force", "rate"), _named(imu), strict=True):
        if part is not None:
            text += _correction(argument, name, part)
    return text + "}\n"


def _own(terms: Sequence[Term]) -> str:
    """Return the lines that take off what a reading itself adds, solved for by rounds."""
    if not terms:
        return ""
    start, reach = of_reading.counts_from(terms), of_reading.reach(terms)
    text = "    double own = 0.0;\n"
    if start is not None:
        text += f"    double warmer = isnan(temperature) ? 0.0 : temperature - {start!r};\n"
    text += (
        f"    for (int k = 0; k < {ROUNDS}; k++) {{\n      double x = unbiased[i] - own;\n      (void)x;\n"
    )
    if reach is not None:
        text += f"      double held = fmin(fmax(x, {-reach!r}), {reach!r});\n"
    return text + f"      own = {of_reading.error(terms, '[i]')};\n    }}\n    unbiased[i] -= own;\n"


def _named(imu: ImuParameters) -> list[tuple[str, SensorPart | None]]:
    return [("accelerometer", imu.accelerometer), ("gyroscope", imu.gyroscope)]


def _correction(argument: str, name: str, part: SensorPart) -> str:
    bias = "0.0" if part.bias is None else f"{name}_bias[i]"
    text = f"  for (int i = 0; i < 3; i++) {{\n    offset[i] = {bias};\n"
    if part.slope is not None:
        low, high = part.limits or (-math.inf, math.inf)
        held = "temperature"
        if math.isfinite(low):
            held = f"fmin(fmax(temperature, {low!r}), {high!r})"
        terms = [f"warmer * {name}_bias_slope[i]"]
        terms += [
            f"warmer * warmer * {'warmer * ' if key == 'cubic' else ''}{name}_bias_{key}[i]"
            for key in ("quadratic", "cubic")
            if getattr(part, key) is not None
        ]
        text += (
            "    if (!isnan(temperature)) {\n"
            f"      double warmer = {held} - {name}_reference_temperature_c;\n"
            f"      offset[i] += {' + '.join(terms)};\n    }}\n"
        )
    if part.matrix is not None:
        text += f"    for (int j = 0; j < 3; j++) offset[i] += {name}_g_sensitivity[i][j] * force[j];\n"
    text += f"    unbiased[i] = {argument}[i] - offset[i];\n{_own(part.terms)}  }}\n"
    text += f"  for (int i = 0; i < 3; i++) {{\n    {argument}[i] = unbiased[i];\n"
    if part.scale is not None:
        text += f"    {argument}[i] = 0.0;\n    for (int j = 0; j < 3; j++)"
        text += f" {argument}[i] += {name}_scale[i][j] * unbiased[j];\n"
    return text + "  }\n"
