"""gnss-ins-sim's IMU errors, corrected: the dictionary in the Python script that runs it.

Aceinna/gnss-ins-sim, gnss_ins_sim/sim/imu_model.py: gyro_b and gyro_b_stability in deg/h, gyro_arw in
deg/sqrt(h), accel_b and accel_b_stability in m/s^2, accel_vrw in m/s/sqrt(h), three numbers each.
pathgen/pathgen.py, acc_gen and gyro_gen: measured = true + b + drift + noise; a sample's standard deviation
is the walk's density times sqrt(rate), and the true force is the specific force. bias_drift: the drift is a
Gauss-Markov process with the deviation gyro_b_stability or accel_b_stability and the time gyro_b_corr
or accel_b_corr, s; without such a time it is white. Only these numbers are changed in the script's text.
"""

from __future__ import annotations

import ast
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
    level,
    note_change,
    on_its_axes,
    recorded,
    rounded,
    slow_deviation,
    to_add,
)
from stillcal.replay.export.imu import gauss_markov_allan
from stillcal.replay.export.targets.airsim import DEG_PER_HOUR, DEG_PER_ROOT_HOUR

BIAS = {"accel": ("accel_b", 1.0), "gyro": ("gyro_b", DEG_PER_HOUR)}
WALK = {"accel": ("accel_vrw", 1.0 / 60.0), "gyro": ("gyro_arw", DEG_PER_ROOT_HOUR)}
STABILITY = {"accel": ("accel_b_stability", 1.0), "gyro": ("gyro_b_stability", DEG_PER_HOUR)}
CORRELATION = {"accel": "accel_b_corr", "gyro": "gyro_b_corr"}

NEW = """import numpy as np

imu_err = {
    'gyro_b': np.array([0.0, 0.0, 0.0]),
    'gyro_arw': np.array([0.0, 0.0, 0.0]),
    'gyro_b_stability': np.array([0.0, 0.0, 0.0]),
    'gyro_b_corr': np.array([100.0, 100.0, 100.0]),
    'accel_b': np.array([0.0, 0.0, 0.0]),
    'accel_vrw': np.array([0.0, 0.0, 0.0]),
    'accel_b_stability': np.array([0.0, 0.0, 0.0]),
    'accel_b_corr': np.array([100.0, 100.0, 100.0]),
}
# from gnss_ins_sim.sim import imu_model; imu = imu_model.IMU(accuracy=imu_err, axis=6, gps=False)
"""


def fix(text: str | None, findings: Sequence[Finding]) -> Fixed:
    """Return the script with the differences in it; a new module with the dictionary where there is none."""
    fixed = Fixed(NEW if text is None else text)
    _entries(fixed.text)

    def bias(finding: Finding) -> None:
        key, unit = BIAS[finding["sensor"]]
        before = _get(fixed, key) * unit
        _set(fixed, key, (before + to_add(finding, "bias", before)) / unit)

    def white(finding: Finding) -> None:
        key, unit = WALK[finding["sensor"]]
        own = recorded(finding, WHITE) / np.sqrt(2.0) / unit
        _set(fixed, key, level(_get(fixed, key), finding, WHITE, own))

    def slow(finding: Finding) -> None:
        sensor = finding["sensor"]
        (key, unit), time = STABILITY[sensor], CORRELATION[sensor]
        before, tau = _get(fixed, key), _get(fixed, time)
        if not (tau > 0.0).all():
            raise CannotHold(f"{time} is not above 0")
        spread = slow_deviation(finding) / np.sqrt(gauss_markov_allan(tau))
        _set(fixed, key, on_its_axes(finding, spread / unit, before))

    handlers = {
        "accel_bias": bias,
        "gyro_bias": bias,
        **dict.fromkeys(OF_DENSITY, white),
        **dict.fromkeys(SLOW_NOISE, slow),
    }
    apply_findings(findings, handlers, fixed)
    return fixed


def _entries(text: str) -> dict[str, ast.expr]:
    """Return the values of the first dictionary literal that has gyro_b and accel_b."""
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError) as error:
        raise UserError(f"not a Python script: {error}") from error
    for node in ast.walk(tree):
        if isinstance(node, ast.Dict):
            keys = [k.value if isinstance(k, ast.Constant) else None for k in node.keys]
            if "gyro_b" in keys and "accel_b" in keys:
                return {str(k): v for k, v in zip(keys, node.values, strict=True) if k is not None}
    raise UserError("holds no dictionary with gyro_b and accel_b, as imu_model.IMU(accuracy=...) takes it")


def _get(fixed: Fixed, key: str) -> Array:
    entries = _entries(fixed.text)
    if key not in entries:
        raise CannotHold(f"its dictionary has no {key}")
    try:
        values = np.broadcast_to(_evaluated(entries[key], key), 3).astype(np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise CannotHold(f"{key} is not three numbers") from error
    if not np.isfinite(values).all():
        raise CannotHold(f"{key} is not three finite numbers")
    return values


def _set(fixed: Fixed, key: str, values: Array) -> None:
    before, node = _get(fixed, key), _entries(fixed.text)[key]
    lines = fixed.text.encode().splitlines(keepends=True)
    start = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    assert node.end_lineno is not None and node.end_col_offset is not None, "every parsed node has an end"
    end = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
    data = fixed.text.encode()
    literal = f"np.array({rounded(values).tolist()!r})"
    fixed.text = (data[:start] + literal.encode() + data[end:]).decode()
    note_change(fixed, key, before, values)


def _evaluated(node: ast.expr, key: str) -> Array:
    """Return the number or numbers of an expression of literals, np.array, pi and arithmetic."""
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return np.float64(node.value)  # type: ignore[return-value]  # a number is an array of no dimension
    if isinstance(node, ast.List | ast.Tuple):
        return np.array([_evaluated(n, key) for n in node.elts])
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return -_evaluated(node.operand, key)
    if isinstance(node, ast.Call) and node.args and ast.unparse(node.func).endswith(("array", "asarray")):
        return _evaluated(node.args[0], key)
    if isinstance(node, ast.Attribute) and node.attr == "pi":
        return np.float64(np.pi)  # type: ignore[return-value]
    lists = (ast.List, ast.Tuple)  # a list times a number is the list repeated, no arithmetic
    if isinstance(node, ast.BinOp) and not isinstance(node.left, lists) and type(node.op) in _ARITHMETIC:
        one, other = _evaluated(node.left, key), _evaluated(node.right, key)
        return np.asarray(_ARITHMETIC[type(node.op)](one, other))
    raise CannotHold(f"{key} is {ast.unparse(node)[:60]}, which is not made of plain numbers")


_ARITHMETIC = {ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide}
