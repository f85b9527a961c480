"""MATLAB's imuSensor, corrected: assignments such as imu.Gyroscope.ConstantBias = [x y z]; in an .m file.

Units, signs and the reference of 25 degC are explained, with sources, in
`stillcal.replay.export.targets.imusensor`. Comments and everything else stay; a property that is missing is
added below the sensor's other lines.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import OF_DENSITY
from stillcal.calib_core.errors import UserError
from stillcal.replay.export.fix.findings import (
    SLOW_NOISE,
    WHITE,
    CannotHold,
    Finding,
    Fixed,
    apply_findings,
    common_ratio,
    gain_after,
    level,
    note_change,
    on_its_axes,
    recorded,
    reference_c,
    refuse_bends,
    rounded,
    slow_walk,
    to_add,
)
from stillcal.replay.export.targets.imusensor import PERCENT, REFERENCE_C

SENSORS = {"accel": "Accelerometer", "gyro": "Gyroscope"}
SIGNS = {"accel": -1.0, "gyro": 1.0}
NEW = "function imu = corrected_imu()\nimu = imuSensor('accel-gyro');\nend\n"


def fix(text: str | None, findings: Sequence[Finding]) -> Fixed:
    """Return the file with the differences in it; a new function where there is none."""
    fixed = Fixed(NEW if text is None else text)
    _variable(fixed.text)

    def bias(finding: Finding) -> None:
        sign = SIGNS[finding["sensor"]]
        before = sign * _get(fixed, finding, "ConstantBias", np.zeros(3))
        _add(fixed, finding, "ConstantBias", sign * to_add(finding, "bias", before))

    def slope(finding: Finding) -> None:
        sign, at = SIGNS[finding["sensor"]], reference_c(finding)
        delta = to_add(finding, "slope", sign * _get(fixed, finding, "TemperatureBias", np.zeros(3)))
        if at is None:
            raise CannotHold("the finding does not say from which temperature its slope counts")
        _add(fixed, finding, "TemperatureBias", sign * delta)
        _add(fixed, finding, "ConstantBias", sign * delta * (REFERENCE_C - at))
        refuse_bends(finding)

    def scale(finding: Finding) -> None:
        before = _get(fixed, finding, "AxesMisalignment", PERCENT * np.eye(3))
        _set(fixed, finding, "AxesMisalignment", before, PERCENT * gain_after(finding, before / PERCENT))

    def scale_slope(finding: Finding) -> None:
        before = _get(fixed, finding, "TemperatureScaleFactor", np.zeros(3)) / PERCENT
        _add(fixed, finding, "TemperatureScaleFactor", PERCENT * to_add(finding, "slope", before))

    def white(finding: Finding) -> None:
        before = _get(fixed, finding, "NoiseDensity", np.zeros(3))
        after = level(before, finding, WHITE, recorded(finding, WHITE))
        _set(fixed, finding, "NoiseDensity", before, after)

    def slow(finding: Finding) -> None:
        if _get(fixed, finding, "BiasInstability", np.zeros(3)).any():
            raise CannotHold("its BiasInstability is slow noise too, and RandomWalk would be added to it")
        before = _get(fixed, finding, "RandomWalk", np.zeros(3))
        after = on_its_axes(finding, slow_walk(finding) / np.sqrt(2.0), before)
        _set(fixed, finding, "RandomWalk", before, after)

    def rate(finding: Finding) -> None:
        _sample_rate(fixed, common_ratio(finding, "rate"))

    both = {"bias": bias, "bias_temperature": slope, "scale": scale, "scale_temperature": scale_slope}
    handlers = {f"{s}_{name}": handler for s in SENSORS for name, handler in both.items()}
    handlers |= dict.fromkeys(SLOW_NOISE, slow)
    apply_findings(findings, handlers | dict.fromkeys(OF_DENSITY, white) | {"sample_rate": rate}, fixed)
    return fixed


def _variable(text: str) -> str:
    """Return the name of the variable that holds the sensor."""
    found = re.search(r"^[ \t]*(\w+)[ \t]*=[ \t]*imuSensor\b", text, re.MULTILINE)
    if found is None:
        raise UserError("holds no line such as imu = imuSensor('accel-gyro');")
    return found[1]


def _line(fixed: Fixed, finding: Finding, key: str) -> re.Match[str] | None:
    """Return the assignment of a property: what is before its value, the value, what ends it.

    Semicolons and ends of lines inside brackets end a row, not the value.
    """
    name = rf"{_variable(fixed.text)}\.{SENSORS[finding['sensor']]}\.{key}"
    value = r"(?:\[[^\]]*\]|[^\[;%\n])*"
    return re.search(rf"^([ \t]*{name}[ \t]*=[ \t]*)({value})(;?)", fixed.text, re.MULTILINE)


def _get(fixed: Fixed, finding: Finding, key: str, default: Array) -> Array:
    """Return a property, `default` where it is not set. Raises CannotHold where its shape is another one."""
    match = _line(fixed, finding, key)
    if match is None:
        return default
    rows = [row.replace(",", " ").split() for row in re.split("[;\n]", match[2].strip().strip("[]"))]
    try:
        values = np.array([[float(x) for x in row] for row in rows if row], dtype=np.float64)
    except ValueError as error:
        raise CannotHold(f"{key} is {match[2].strip()[:40]}, which is not made of plain numbers") from error
    values = values[0] if len(values) == 1 else values
    values = np.full(3, values[0]) if values.shape == (1,) else values
    if values.shape != default.shape or not np.isfinite(values).all():
        wanted = " by ".join(map(str, default.shape))
        raise CannotHold(f"{key} is {match[2].strip()[:40]}, which is not {wanted} numbers")
    return values


def _add(fixed: Fixed, finding: Finding, key: str, delta: Array) -> None:
    before = _get(fixed, finding, key, np.zeros(3))
    _set(fixed, finding, key, before, before + delta)


def _set(fixed: Fixed, finding: Finding, key: str, before: Array, after: Array) -> None:
    rows = np.atleast_2d(rounded(after))
    literal = "[" + "; ".join(" ".join(map(repr, row)) for row in rows.tolist()) + "]"
    match = _line(fixed, finding, key)
    sensor = SENSORS[finding["sensor"]]
    if match is not None:
        fixed.text = f"{fixed.text[: match.start()]}{match[1]}{literal};{fixed.text[match.end() :]}"
    else:
        variable = _variable(fixed.text)
        own = list(re.finditer(rf"^[ \t]*{variable}\b[^\n]*(?:\n|$)", fixed.text, re.MULTILINE))
        end = own[-1].end()
        fixed.text = f"{fixed.text[:end]}{variable}.{sensor}.{key} = {literal};\n{fixed.text[end:]}"
    note_change(fixed, f"{sensor}.{key}", before, after)


def _sample_rate(fixed: Fixed, factor: float) -> None:
    match = re.search(r"('SampleRate'\s*,\s*|SampleRate\s*=\s*)([0-9.eE+-]+)", fixed.text)
    if match is None:
        raise CannotHold("there is no SampleRate in it")
    try:
        before = float(match[2])
    except ValueError as error:
        raise CannotHold(f"SampleRate is {match[2]}, which is no number") from error
    after = float(f"{before * factor:.6g}")
    fixed.text = f"{fixed.text[: match.start()]}{match[1]}{after!r}{fixed.text[match.end() :]}"
    note_change(fixed, "SampleRate, Hz", before, after)
