"""A finding as an equation, and as a NumPy function to paste that takes the effect out of samples.

`to_paste` returns both for a finding in plain values (JSON schema 2). The function corrects the recording by
the recording's own parameters, or, where only the simulation has the effect, the simulation by its own. An
effect that no function of samples can take out, such as noise, has an equation only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.catalogue import named_effects
from stillcal.calib_core.diagnosis.effects.described import DESCRIBED
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED

Finding = Mapping[str, Any]

VARIABLE = {"accel": "force", "gyro": "rate"}


def to_paste(finding: Finding) -> dict[str, str]:
    """Return `equation` and `numpy` of a finding; what does not exist for it is absent."""
    out = {}
    if equation := equation_of(finding):
        out["equation"] = equation
    if code := code_of(finding):
        out["numpy"] = code
    return out


def equation_of(finding: Finding) -> str:
    """Return the physics as a formula in plain text; "" where the cause has no name."""
    effect = finding["effect"]
    for known in named_effects():
        if (known.name, known.sensor) == (effect, finding["sensor"]) and known.equation:
            return known.equation_at(finding.get("reference", {}))
    return DESCRIBED[effect].equation if effect in DESCRIBED else ""


def code_of(finding: Finding) -> str:
    """Return a module with the function `correct(t, temperature, force, rate)`; "" where there can be none.

    It takes t (n,) s, temperature (n,) degC or None, raw force (n, 3) m/s^2 and raw rate (n, 3) rad/s, all of
    one length, and returns t, force and rate without the effect. What is clipped cannot be known: it becomes
    NaN. Of a bias while charging the function takes that as well. What only the simulation has is taken out
    of the simulation's samples.
    """
    spare = finding.get("relation") == "superfluous"
    if spare:
        finding = {**finding, "parameters": finding["simulated"]}
    kind = finding["effect"].removeprefix("accel_").removeprefix("gyro_")
    body = CODE.get(finding["effect"]) or CODE.get(kind)
    if body is None or not finding["parameters"]:
        return ""
    try:
        lines = body(finding)
    except KeyError:  # the finding lacks a number that the function needs
        return ""
    charging = kind == "charging_bias"
    arguments = "t, temperature, force, rate" + (", charging" if charging else "")
    units = "t in s, temperature in degC, force and rate (n, 3), SI"
    units += "; charging (n,) is 1 on the charger" if charging else ""
    text = [
        "import numpy as np",
        "",
        "",
        f"def correct({arguments}):",
        f'    """Take {finding["effect"]} out of the {"simulation" if spare else "recording"}: {units}."""',
        *(f"    {line}" for line in lines),
        "    return t, force, rate",
    ]
    return "\n".join(text) + "\n"


def _value(finding: Finding, name: str) -> Array:
    """Return what the recording's numbers are stated at, or one of them. Raises KeyError without either."""
    if name in finding.get("reference", {}):
        return np.asarray(finding["reference"][name], dtype=np.float64)
    return np.asarray(finding["parameters"][name]["value"], dtype=np.float64)


def _literal(finding: Finding, name: str) -> str:
    """Return `name = numbers  # unit` with nine digits, far beyond what any recording shows."""
    values = _value(finding, name)
    rounded = np.array([float(f"{v:.9g}") for v in values.ravel()]).reshape(values.shape)
    unit = finding["parameters"].get(name, {}).get("unit", "")
    text = f"{name} = np.array({rounded.tolist()!r})" if values.ndim else f"{name} = {float(rounded)!r}"
    return f"{text}  # {unit}" if unit and unit != "1" else text


def _less(finding: Finding, expression: str) -> str:
    x = VARIABLE[finding["sensor"]]
    return f"{x} = {x} - {expression}"


def _bias(finding: Finding) -> list[str]:
    return [_literal(finding, "bias"), _less(finding, "bias")]


def _scale(finding: Finding) -> list[str]:
    x = VARIABLE[finding["sensor"]]
    scale = _value(finding, "scale")
    lines = [_literal(finding, "scale")]
    if scale.ndim == 2:
        lines.append("correction = np.eye(3) + scale")
    else:
        lines += ["correction = np.diag(1.0 + scale)"]
        if "misalignment" in finding["parameters"]:
            lines += [
                f"{_literal(finding, 'misalignment')}  # of xy, xz, yz",
                "for value, (a, b) in zip(misalignment, ((0, 1), (0, 2), (1, 2))):",
                "    correction[a, b] = correction[b, a] = value",
            ]
    return [*lines, f"{x} = {x} @ correction.T  # after the bias has been taken off"]


def _bias_temperature(finding: Finding) -> list[str]:
    lines = [_warmer(finding), _literal(finding, "slope"), _less(finding, "np.outer(warmer, slope)")]
    for power, name in ((2, "quadratic"), (3, "cubic")):
        if name in finding["parameters"]:
            lines += [_literal(finding, name), _less(finding, f"np.outer(warmer**{power}, {name})")]
    return lines


def _scale_temperature(finding: Finding) -> list[str]:
    x = VARIABLE[finding["sensor"]]
    return [_warmer(finding), _literal(finding, "slope"), f"{x} = {x} / (1.0 + np.outer(warmer, slope))"]


def _warmer(finding: Finding) -> str:
    """Return the line that counts the temperature from where the finding states bias and scale."""
    at = float(_value(finding, "temperature_c"))
    return f"warmer = np.nan_to_num(temperature - {at:.9g})  # K"


def _warmup(finding: Finding) -> list[str]:
    curve = "-np.exp" if finding.get("reference", {}).get(SETTLED) else "-np.expm1"
    return [
        _literal(finding, "amplitude"),
        _literal(finding, "tau_s"),
        _less(finding, f"np.outer({curve}(-(t - t[0]) / tau_s), amplitude)"),
    ]


def _drift(finding: Finding) -> list[str]:
    speed = _literal(finding, "rate").replace("rate = ", "speed = ", 1)
    return [speed, _less(finding, "np.outer(t - t[0], speed)")]


def _step(finding: Finding) -> list[str]:
    at = float(finding["where"]["t_start"])
    return [_literal(finding, "step"), _less(finding, f"np.outer(t >= {at:.9g}, step)")]


def _charging(finding: Finding) -> list[str]:
    return [_literal(finding, "step"), _less(finding, "np.outer(charging, step)")]


def _saturation(finding: Finding) -> list[str]:
    x = VARIABLE[finding["sensor"]]
    return [_literal(finding, "limit"), f"{x} = np.where(np.abs({x}) < limit, {x}, np.nan)"]


def _tone(finding: Finding) -> list[str]:
    x, hertz = VARIABLE[finding["sensor"]], _literal(finding, "frequency")
    start, end = (float(finding["where"][name]) for name in ("t_start", "t_end"))
    return [
        hertz,
        f"there = (t >= {start:.9g}) & (t <= {end:.9g})",
        "phase = 2.0 * np.pi * frequency * (t - t[0])",
        "wave = np.column_stack([np.cos(phase), np.sin(phase)]) * there[:, None]",
        f"line = np.linalg.lstsq(wave[there], ({x} - {x}[there].mean(axis=0))[there], rcond=None)[0]",
        _less(finding, "wave @ line"),
    ]


def _matrix(finding: Finding) -> list[str]:
    return [_literal(finding, "matrix"), _less(finding, "force @ matrix.T")]


def _nonlinearity(finding: Finding) -> list[str]:
    x = VARIABLE[finding["sensor"]]
    powers = [(2, "quadratic"), (3, "cubic")]
    used = [(p, name) for p, name in powers if name in finding["parameters"]]
    error = " + ".join(f"{name} * true**{p}" for p, name in used)
    slope = " + ".join(f"{p} * {name} * true" + (f"**{p - 1}" if p > 2 else "") for p, name in used)
    lines = [_literal(finding, name) for _, name in used]
    solved = [f"true = {x}", "for _ in range(8):  # Newton's steps"]
    step = f"    true = true - (true + {error} - {x}) / np.maximum(1.0 + {slope}, 0.2)"
    return [*lines, *solved, step, f"{x} = true"]


def _skew(finding: Finding) -> list[str]:
    return [_literal(finding, "relative"), "t = t[0] + (t - t[0]) / (1.0 + relative)"]


def _offset(finding: Finding) -> list[str]:
    return [
        _literal(finding, "delay"),
        "rate = np.column_stack([np.interp(t + delay, t, rate[:, axis]) for axis in range(3)])",
    ]


def _lever_arm(finding: Finding) -> list[str]:
    return [
        _literal(finding, "position"),
        "turning = np.gradient(rate, t, axis=0)",
        "force = force - np.cross(rate, np.cross(rate, position)) - np.cross(turning, position)",
    ]


CODE: dict[str, Callable[[Finding], list[str]]] = {
    "bias": _bias,
    "scale": _scale,
    "bias_temperature": _bias_temperature,
    "scale_temperature": _scale_temperature,
    "warmup": _warmup,
    "bias_drift": _drift,
    "bias_step": _step,
    "charging_bias": _charging,
    "saturation": _saturation,
    "vibration_tone": _tone,
    "g_sensitivity": _matrix,
    "nonlinearity": _nonlinearity,
    "clock_skew": _skew,
    "accel_gyro_time_offset": _offset,
    "lever_arm": _lever_arm,
}
"""Lines of the function by the effect's name, whole or without its sensor."""
