"""A comparison in plain sentences: what each relation means for the simulation, in the units people use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stillcal.calib_core import gravity
from stillcal.calib_core.diagnosis.comparison.compare import LEVEL
from stillcal.calib_core.diagnosis.effects.catalogue import named_effects

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
    "noise_unequal_axes": "white noise that differs between axes",
    "accel_bias_random_walk": "random walk of the accelerometer's bias",
    "gyro_bias_random_walk": "random walk of the gyroscope's bias",
    "held_samples": "samples that repeat the one before",
    "missing_codes": "values that never occur",
    "axis_exchange": "exchanged axes",
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
    "bandwidth": "limit of the bandwidth",
    "lever_arm": "distance of the accelerometer from the pivot",
    "unknown": "something that no named effect explains",
}
"""What differences are called within a sentence; effects of the catalogue have their own noun."""

THE_BUILT_IN = "the built-in simulation"

OF_EITHER = frozenset(
    {
        "noise_level",
        "noise_unequal_axes",
        "noise_heavy_tailed",
        "vibration_tone",
        "bandwidth",
        "held_samples",
        "missing_codes",
        "axis_exchange",
        "thermal_latent",
        "unknown",
    }
)
"""Effects of either sensor whose name does not say of which."""

BUILT_IN = "built-in"
"""The built-in simulation's name: an ideal affine sensor with plain noise, moved as the recording moved."""

SENSORS = {"accel": "accelerometer", "gyro": "gyroscope"}

SHOWN_AS = (
    ("m/s^2", "mg", 1000.0 / gravity.STANDARD),
    ("rad/s", "deg/s", float(np.rad2deg(1.0))),
)
"""Units as they are computed, as people read them, and the factor between."""

INVERSE = ("1/(", "/(m/s^2)")
"""Units with a sensor's unit below the line are left as they are."""

NEARLY_CERTAIN = 0.9995
"""Probability that three digits would round to one."""

VERDICTS = {
    "match": "No difference found",
    "identified": "Differences found, all identified",
    "partly_identified": "Differences found, some identified",
    "unidentified": "Differences found, of unknown cause",
    "not_judged": "Not judged: too few of the checks could be made",
}


def noun(effect: str, sensor: str) -> str:
    """Return what an effect is called in a sentence."""
    named = {e.name: e.called() for e in named_effects()}
    name = NOUNS.get(effect) or named.get(effect) or effect.replace("_", " ")
    return f"{name} ({SENSORS[sensor]})" if effect in OF_EITHER and sensor in SENSORS else name


def readable(value: float, unit: str) -> tuple[float, str]:
    """Return a value and its unit as people read them: mg for m/s^2, deg/s for rad/s."""
    if not unit.startswith(INVERSE[0]) and INVERSE[1] not in unit:
        for si, shown, factor in SHOWN_AS:
            if unit.startswith(si):
                return value * factor, shown + unit.removeprefix(si)
    return value, "" if unit == "1" else unit


def probability_text(probability: float) -> str:
    """Return a probability in three digits; what rounds to certainty is said to be above 0.999."""
    return "above 0.999" if probability > NEARLY_CERTAIN else f"{probability:.3f}"


def labels_of(name: str, count: int) -> list[str]:
    """Return what the numbers of a parameter belong to: axes, pairs of axes, or their place in the list."""
    if count == len(AXES):
        return ["xy", "xz", "yz"] if name == "misalignment" else list(AXES)
    if count == len(AXES) ** 2:
        return [f"{a} by {b}" for a in AXES for b in AXES]
    return [""] if count == 1 else [str(i + 1) for i in range(count)]


def with_interval(parameter: Mapping[str, Any], labels: Sequence[str], shown: Sequence[int]) -> str:
    """Return the numbers `shown` of a parameter, each with its label and half of its 95 % interval."""
    values = np.asarray(parameter["value"], dtype=np.float64).ravel()
    has = "ci95" in parameter
    ends = np.asarray(parameter["ci95"] if has else np.zeros((values.size, 2)), dtype=np.float64)
    ends = ends.reshape(values.size, 2)
    return ", ".join(
        f"{labels[i]} {_plus_minus(float(values[i]), ends[i], parameter['unit'], has)}".strip() for i in shown
    )


def shown_of(finding: Mapping[str, Any], name: str, axes: Sequence[str]) -> list[int]:
    """Return which numbers of a parameter to show: the same ones for the recording and the simulation.

    Of a matrix it is the one that differs most, of three axes the named ones, else all.
    """
    sides = [finding.get(side, {}) for side in ("difference", "parameters", "simulated")]
    values = np.asarray(next(s[name] for s in sides if name in s)["value"], dtype=np.float64).ravel()
    labels = labels_of(name, values.size)
    if values.size == len(AXES) ** 2:
        return [int(np.abs(values).argmax())]
    return [i for i, label in enumerate(labels) if label in axes] or list(range(values.size))


def _plus_minus(value: float, ends: Any, unit: str, has: bool) -> str:
    shown, name = readable(value, unit)
    text = f"{shown:.3g}"
    if has:
        half, _ = readable(float(ends[1] - ends[0]) / 2.0, unit)
        text += f" ± {half:.2g}"
    return f"{text} {name}".strip()


OF_CORRECTION = (
    " The numbers are those of the correction: a sensor that reads 1 % too much has a scale of -0.01."
)
"""Said of scale and misalignment, whose sign a simulator's own settings may have the other way round."""


def statement(finding: Mapping[str, Any], names: tuple[str, str]) -> str:
    """Return what differs and what to do about it in the simulation, in one to three sentences."""
    text = _statement(finding, names).replace(f". {THE_BUILT_IN}", f". {_capital(THE_BUILT_IN)}")
    text = _capital(text) if text.startswith(THE_BUILT_IN) else text
    text += _undistinguished(finding)
    return text + OF_CORRECTION if finding["effect"] in ("accel_scale", "gyro_scale") else text


def _undistinguished(finding: Mapping[str, Any]) -> str:
    """Return which other effects would look the same in this recording; "" where none would."""
    alike = [noun(a["effect"], finding["sensor"]) for a in finding["alternatives"] if a["indistinguishable"]]
    return f" This recording cannot tell it from: {', or '.join(alike)}." if alike else ""


def _statement(finding: Mapping[str, Any], names: tuple[str, str]) -> str:
    recording, simulation = names[0], simulation_text(names[1])
    what = noun(finding["effect"], finding["sensor"])
    name = _clearest(finding)
    recorded, simulated = (_side(finding, side, name) for side in ("parameters", "simulated"))
    relation = finding["relation"]
    if finding["effect"] == "unknown":
        owner, other = (recording, simulation) if relation == "lacking" else (simulation, recording)
        return f"{owner} shows {what}; it follows {finding['where']['driver']}. {other} does not show it."
    if relation == "lacking":
        return f"{simulation} lacks the {what} that {recording} shows: {recorded}. Add it."
    if relation == "superfluous":
        return f"{simulation} has a {what} of {simulated} that {recording} does not show. Take it out."
    word = _word(finding, name)
    return f"The {what} {word} in {simulation}: {simulated}, recorded {recorded}."


def _clearest(finding: Mapping[str, Any]) -> str | None:
    """Return the parameter whose difference is largest beside its interval; None without any parameter."""
    strength: dict[str, float] = {
        str(name): float(np.max(np.abs(p["value"]) / np.maximum(np.ptp(p["ci95"], axis=-1), 1e-300)))
        for name, p in finding["difference"].items()
        if name in finding["parameters"] and "ci95" in p
    }
    if strength:
        return max(strength, key=lambda name: strength[name])
    names = [str(name) for name in finding["parameters"] or finding["simulated"]]
    return names[0] if names else None


def _side(finding: Mapping[str, Any], side: str, name: str | None) -> str:
    if name is None or name not in finding[side]:
        return "no value"
    parameter = finding[side][name]
    labels = labels_of(name, np.size(parameter["value"]))
    text = with_interval(parameter, labels, shown_of(finding, name, finding["axes"]))
    # A number without a unit, or one that belongs to a pair of axes, says too little without its name.
    named = name == "misalignment" or parameter["unit"] == "1"
    return f"{name.replace('_', ' ')} {text}" if named else text


def _word(finding: Mapping[str, Any], name: str | None) -> str:
    """Return how the simulated numbers that are shown stand to the recorded ones, where all stand alike."""
    assert name is not None, "what both have, has parameters"
    shown = shown_of(finding, name, finding["axes"])
    recorded, simulated = (
        np.asarray(finding[side][name]["value"], dtype=np.float64).ravel()[shown]
        for side in ("parameters", "simulated")
    )
    if (recorded * simulated < 0.0).all():
        return "has the opposite sign"
    if (recorded * simulated >= 0.0).all():
        if (np.abs(simulated) < np.abs(recorded)).all():
            return "is too small"
        if (np.abs(simulated) > np.abs(recorded)).all():
            return "is too large"
    return "has other values"


LINES = 14
"""Longest summary; it is to be read at a glance."""


def simulation_text(name: str) -> str:
    """Return what a simulation is called in a sentence."""
    return THE_BUILT_IN if name == BUILT_IN else name


def headline(answer: Mapping[str, Any]) -> str:
    """Return the verdict in a sentence, with how many of the checks this recording allows."""
    text, made, of = VERDICTS[answer["verdict"]], answer["checks"]["made"], answer["checks"]["of"]
    checks = f"{made} of {of} checks possible"
    return f"{text} ({checks})"


def outcome(answer: Mapping[str, Any]) -> str:
    """Return how the simulation fits with what was found put into it; "" where nothing was found."""
    if not answer["findings"]:
        return ""
    simulation, fit = simulation_text(answer["simulation"]), answer["fit"]
    if "p_after" not in fit:
        return f"{_capital(simulation)} could not be played with what was found: the phone is never at rest."
    passes = "passes" if fit["p_after"] >= LEVEL else "still fails"
    numbers = f"p = {fit['p_after']:.2g}; before {fit['p_before']:.2g}"
    # One effect on both sensors is named once.
    left = ", ".join(dict.fromkeys(noun(effect, "") for effect in fit["not_put_in"]))
    but = f" These could not be put in and are left out of it: {left}." if left else ""
    return f"With what was found put in, {simulation} {passes} the same comparison ({numbers}).{but}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def summary(answer: Mapping[str, Any], lines: int = LINES) -> list[str]:
    """Return the answer in some lines for a terminal, the verdict first."""
    simulation = simulation_text(answer["simulation"])
    out = [f"{answer['recording']} against {simulation}: {headline(answer)}"]
    out += [
        f"  {f['statement']} (probability {probability_text(f['probability'])})" for f in answer["findings"]
    ]
    out += [f"  {text}" for text in [outcome(answer)] if text]
    agreed = ", ".join(noun(a["effect"], a["sensor"]) for a in answer["agreed"])
    if agreed:
        out.append(f"  agreed: {agreed}")
    out += [f"  not compared: {_some(what)} - {why}" for why, what in reasons(answer).items()]
    if len(out) > lines:
        out = [*out[: lines - 1], f"  and {len(out) - lines + 1} more lines in --json and --report"]
    return out


def _some(what: Sequence[str], most: int = 3) -> str:
    """Return the first few of a list, and how many there are besides."""
    shown = ", ".join(what[:most])
    return shown if len(what) <= most else f"{shown} and {len(what) - most} more"


def reasons(answer: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return what could not be compared, by the reason why not."""
    out: dict[str, list[str]] = {}
    for one in answer["not_compared"]:
        out.setdefault(one["reason"], []).append(noun(one["effect"], one["sensor"]))
    return out
