"""A comparison in plain sentences: what each relation means for the simulation, in the units people use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stillcal.calib_core import gravity

AXES = "xyz"

NOUNS = {
    "accel_bias": "accelerometer bias",
    "gyro_bias": "gyroscope bias",
    "accel_scale": "accelerometer scale and misalignment",
    "gyro_scale": "gyroscope scale and misalignment",
    "noise_level": "white noise",
    "accel_slow_noise": "slow noise of the accelerometer's bias",
    "gyro_slow_noise": "slow noise of the gyroscope's bias",
    "sample_rate": "sample rate",
    "accel_bias_temperature": "change of the accelerometer's bias with temperature",
    "gyro_bias_temperature": "change of the gyroscope's bias with temperature",
    "accel_scale_temperature": "change of the accelerometer's scale with temperature",
    "gyro_scale_temperature": "change of the gyroscope's scale with temperature",
    "accel_warmup": "settling of the accelerometer's bias after the start",
    "gyro_warmup": "settling of the gyroscope's bias after the start",
    "thermal_latent": "change of bias with heat from charging and use",
    "accel_bias_drift": "steady drift of the accelerometer's bias",
    "gyro_bias_drift": "steady drift of the gyroscope's bias",
    "accel_bias_step": "step of the accelerometer's bias",
    "gyro_bias_step": "step of the gyroscope's bias",
    "accel_charging_bias": "change of the accelerometer's bias while charging",
    "gyro_charging_bias": "change of the gyroscope's bias while charging",
    "gyro_g_sensitivity": "sensitivity of the gyroscope to acceleration",
    "accel_nonlinearity": "nonlinearity of the accelerometer",
    "gyro_nonlinearity": "nonlinearity of the gyroscope",
    "accel_saturation": "limit of the accelerometer's range",
    "gyro_saturation": "limit of the gyroscope's range",
    "accel_quantisation": "step of the accelerometer's values",
    "gyro_quantisation": "step of the gyroscope's values",
    "noise_heavy_tailed": "heavy tails of the noise",
    "vibration_tone": "vibration at one frequency",
    "clock_skew": "error of the clock's rate",
    "timestamp_jitter": "jitter of the time stamps",
    "dropped_samples": "share of samples lost",
    "arrival_bursts": "share of samples that arrive in bursts",
    "accel_gyro_time_offset": "delay between the sensors",
    "bandwidth": "bandwidth",
    "lever_arm": "distance of the accelerometer from the pivot",
    "unknown": "something that no named effect explains",
}

SENSORS = {"accel": "accelerometer", "gyro": "gyroscope"}

SHOWN_AS = (
    ("m/s^2", "mg", 1000.0 / gravity.STANDARD),
    ("rad/s", "deg/s", float(np.rad2deg(1.0))),
)
"""Units as they are computed, as people read them, and the factor between."""

INVERSE = ("1/(", "/(m/s^2)")
"""Units with a sensor's unit below the line are left as they are."""

VERDICTS = {
    "match": "no difference found",
    "identified": "differences found, all identified",
    "partly_identified": "differences found, some identified",
    "unidentified": "differences found, of unknown cause",
    "not_judged": "not judged: too few of the checks could be made",
}


def noun(effect: str, sensor: str) -> str:
    """Return what an effect is called in a sentence."""
    name = NOUNS.get(effect, effect.replace("_", " "))
    needs_sensor = effect in ("noise_level", "noise_heavy_tailed", "vibration_tone", "bandwidth", "unknown")
    return f"{name} ({SENSORS[sensor]})" if needs_sensor and sensor in SENSORS else name


def readable(value: float, unit: str) -> tuple[float, str]:
    """Return a value and its unit as people read them: mg for m/s^2, deg/s for rad/s."""
    if not unit.startswith(INVERSE[0]) and INVERSE[1] not in unit:
        for si, shown, factor in SHOWN_AS:
            if unit.startswith(si):
                return value * factor, shown + unit.removeprefix(si)
    return value, "" if unit == "1" else unit


def with_interval(parameter: Mapping[str, Any], axes: Sequence[str]) -> str:
    """Return a parameter on the named axes, each with half of its 95 % interval."""
    values = np.atleast_1d(np.asarray(parameter["value"], dtype=np.float64))
    has = "ci95" in parameter
    ends = np.asarray(parameter["ci95"] if has else np.zeros((values.size, 2)), dtype=np.float64)
    ends = ends.reshape(*values.shape, 2)
    if values.ndim == 2:
        row, column = np.unravel_index(int(np.abs(values).argmax()), values.shape)
        text = _plus_minus(values[row, column], ends[row, column], parameter["unit"], has)
        return f"{text} (largest: {AXES[int(row)]} by {AXES[int(column)]})"
    if values.size != 3:
        return _plus_minus(float(values[0]), ends[0], parameter["unit"], has)
    shown = [a for a in AXES if a in axes] or list(AXES)
    rows = [AXES.index(a) for a in shown]
    return ", ".join(
        f"{a} {_plus_minus(float(values[r]), ends[r], parameter['unit'], has)}"
        for a, r in zip(shown, rows, strict=True)
    )


def _plus_minus(value: float, ends: Any, unit: str, has: bool) -> str:
    shown, name = readable(value, unit)
    text = f"{shown:.3g}"
    if has:
        half, _ = readable(float(ends[1] - ends[0]) / 2.0, unit)
        text += f" ± {half:.2g}"
    return f"{text} {name}".strip()


def statement(finding: Mapping[str, Any], names: tuple[str, str]) -> str:
    """Return what differs and what to do about it in the simulation, in one or two sentences."""
    recording, simulation = names
    what = noun(finding["effect"], finding["sensor"])
    recorded = _first(finding["parameters"], finding["axes"])
    simulated = _first(finding["simulated"], finding["axes"])
    relation = finding["relation"]
    if finding["effect"] == "unknown":
        owner, other = (recording, simulation) if relation == "lacking" else (simulation, recording)
        return f"{owner} shows {what}; it follows {finding['where']['driver']}. {other} does not show it."
    if relation == "lacking":
        return f"{simulation} lacks the {what} that {recording} shows: {recorded}. Add it."
    if relation == "superfluous":
        return f"{simulation} has a {what} of {simulated} that {recording} does not show. Take it out."
    word = "small" if relation == "too_small" else "large"
    return f"The {what} is too {word} in {simulation}: {simulated}, recorded {recorded}."


def _first(parameters: Mapping[str, Any], axes: Sequence[str]) -> str:
    return with_interval(next(iter(parameters.values())), axes) if parameters else "no value"


def comparison_summary(answer: Mapping[str, Any], lines: int = 12) -> list[str]:
    """Return the answer in some lines for a terminal, the verdict first."""
    checks = len(answer["sensitivity"]) and len({(s["effect"], s["sensor"]) for s in answer["sensitivity"]})
    missed = len(answer["not_compared"])
    head = f"{answer['recording']} against {answer['simulation']}: {VERDICTS[answer['verdict']]}"
    out = [f"{head} ({checks} quantities compared, {missed} could not be)"]
    out += [f"  {f['statement']} (probability {f['probability']:.3f})" for f in answer["findings"]]
    agreed = ", ".join(noun(a["effect"], a["sensor"]) for a in answer["agreed"])
    if agreed:
        out.append(f"  agreed: {agreed}")
    out += [
        f"  not compared: {noun(n['effect'], n['sensor'])} - {n['reason']}" for n in answer["not_compared"]
    ]
    if len(out) > lines:
        out = [*out[: lines - 1], f"  and {len(out) - lines + 1} more lines in --json"]
    return out
