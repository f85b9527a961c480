"""A difference in plain sentences: what each relation means for the simulation, in the units people use."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import LOW_PASS, of_some_axes
from stillcal.calib_core.diagnosis.effects.followed import column_of
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.settings import AXIS_SIGMA, LEVEL_TOLERANCE
from stillcal.calib_core.diagnosis.noise.coloured_noise import DRIVER as COLOURED
from stillcal.calib_core.diagnosis.noise.noise_level import TWO_SIDED
from stillcal.replay.diagnosis.words.correction_code import equation_of
from stillcal.replay.diagnosis.words.moments import moment, span
from stillcal.replay.diagnosis.words.names import (
    BUILT_IN,
    THE_BUILT_IN,
    behaviour,
    capital,
    noun,
    parameter_noun,
    simulation_text,
)
from stillcal.replay.diagnosis.words.units import plain, shown_in, within

AXES = "xyz"

MOST_PARAMETERS = 3
"""Parameters that a sentence names."""

EXCHANGE = "exchange"
"""Parameter of exchanged axes (3, 3): one sign in each row, which takes what was read to the true axes."""

MOST_ELEMENTS = 3
"""Elements of a matrix that a sentence gives; the page and --json have all nine."""


def labels_of(name: str, count: int) -> list[str]:
    """Return what the numbers of a parameter belong to: axes, pairs of axes, or their place in the list."""
    if count == len(AXES):
        return ["xy", "xz", "yz"] if name == "misalignment" else list(AXES)
    if count == len(AXES) ** 2:
        return [f"{a} by {b}" for a in AXES for b in AXES]
    return [""] if count == 1 else [str(i + 1) for i in range(count)]


def interval_of(parameter: Mapping[str, Any]) -> Array:
    """Return the ends (k, 2) of each number's 95 % interval; twice the number where it has none."""
    values = np.asarray(parameter["value"], dtype=np.float64).ravel()
    ends = parameter.get("ci95", np.column_stack([values, values]))
    return np.asarray(ends, dtype=np.float64).reshape(values.size, 2)


def with_interval(
    name: str, parameter: Mapping[str, Any], shown: Sequence[int], beside: Sequence[Mapping[str, Any]] = ()
) -> str:
    """Return the numbers `shown` of a parameter, each with its label and 95 % interval, if any.

    beside: the same parameter of the other sides; all are given in the unit that fits the largest.
    """
    values = np.asarray(parameter["value"], dtype=np.float64).ravel()
    labels = labels_of(name, values.size)
    sides = [values, *(np.asarray(p["value"], dtype=np.float64).ravel() for p in beside)]
    factor, unit = shown_in([side[list(shown)] for side in sides], parameter["unit"], name)
    ends = interval_of(parameter) * factor
    numbers = [f"{within(values[i] * factor, *ends[i])} {unit}".strip() for i in shown]
    if labels == list(AXES) and len(numbers) == len(AXES) and len(set(numbers)) == 1:
        return f"{numbers[0]} on each axis"
    return ", ".join(f"{labels[i]} {number}".strip() for i, number in zip(shown, numbers, strict=True))


def shown_of(finding: Mapping[str, Any], name: str, axes: Sequence[str]) -> list[int]:
    """Return which numbers of a parameter to show: the same ones for the recording and the simulation.

    Of a matrix it is those that differ beyond their errors, the largest `MOST_ELEMENTS` of them at most; of
    three axes the named ones, else all.
    """
    sides = [finding.get(side, {}) for side in ("difference", "parameters", "simulated")]
    parameter = next(s[name] for s in sides if name in s)
    values = np.asarray(parameter["value"], dtype=np.float64).ravel()
    labels = labels_of(name, values.size)
    if values.size == len(AXES) ** 2:
        largest = np.argsort(-np.abs(values)).tolist()
        clear = _clear(parameter) or largest[:1]
        return sorted([i for i in largest if i in clear][:MOST_ELEMENTS])
    return [i for i, label in enumerate(labels) if label in axes] or list(range(values.size))


def _clear(parameter: Mapping[str, Any]) -> list[int]:
    """Return which numbers of a parameter are beyond their errors."""
    values = np.abs(np.asarray(parameter["value"], dtype=np.float64).ravel())
    half = np.ptp(interval_of(parameter), axis=1) / 2.0
    return np.flatnonzero(values > AXIS_SIGMA / NORMAL_95 * half).tolist()


OF_EITHER = "Which of the two has it is not known, as neither alone shows it clearly more than the other."

SCALES = ("accel_scale", "gyro_scale")
CONSTANTS = ("accel_bias", "gyro_bias", *SCALES)
OF_CORRECTION = (
    " The numbers are those of the correction: a sensor that reads 1 % too much has a scale of -1 %."
)
"""Said of scale and misalignment, whose sign a simulator's own settings may have the other way round."""


BEGINS_WITH_BUILT_IN = re.compile(rf"(^|[.]\)? ){THE_BUILT_IN}")
"""The built-in simulation at the beginning of a sentence, also after one that ends within parentheses."""


def statement(finding: Mapping[str, Any], names: tuple[str, str], observed: str = "") -> str:
    """Return what differs and what to do about it in the simulation, in one to four sentences.

    observed: what was observed of something without a name, a sentence; "" where that is not known.
    """
    text = BEGINS_WITH_BUILT_IN.sub(rf"\1{capital(THE_BUILT_IN)}", _statement(finding, names, observed))
    text += (
        _at_temperature(finding)
        + _without_effect(finding)
        + _when_settled(finding)
        + _two_sided(finding, names[1])
    )
    text += _together(finding) + _undistinguished(finding) + _departing(finding)
    text += _exchanged(finding) + _when(finding) + _on_some_axes(finding)
    return text + OF_CORRECTION if finding["effect"] in SCALES else text


def told_of_sensor(finding: Mapping[str, Any]) -> dict[str, str]:
    """Return what a finding says of the sensor itself, where nobody made a simulation: statement and size."""
    if finding["effect"] == "unknown":
        size = _sizes(finding, "parameters")
        said = f"{behaviour('unknown', finding['sensor'])}; it follows {finding['where']['driver']}"
    else:
        size, said = _every(finding, "parameters"), behaviour(finding["effect"], finding["sensor"])
    text = f"{said}: {size}." + _at_temperature(finding) + _undistinguished(finding) + _departing(finding)
    assumed = f" {finding['assumption']}" if "assumption" in finding else ""
    return {"statement": text + assumed, "size": size}


def _at_temperature(finding: Mapping[str, Any]) -> str:
    """Return at which temperature numbers hold that are others at another; "" where they hold at any."""
    at = finding.get("reference", {}).get("temperature_c")
    bends = not {"quadratic", "cubic"}.isdisjoint(finding["parameters"])
    if at is None or not (bends or finding["effect"].endswith(("_bias", "_scale"))):
        return ""
    return f" The numbers hold at {at:.1f} °C."


def _without_effect(finding: Mapping[str, Any]) -> str:
    """Return where an effect of temperature or of a logged column adds nothing; "" for any other."""
    at = finding.get("reference", {})
    if at and (column := column_of(finding["where"]["driver"])) in at:
        return f" It adds nothing where {column} is {at[column]:.4g}."
    if "temperature_c" not in at or not finding["effect"].endswith("_temperature"):
        return ""
    return f" It adds nothing at {at['temperature_c']:.1f} °C."


def _when_settled(finding: Mapping[str, Any]) -> str:
    """Return when a bias that settles has its numbers, or from what the settling counts; "" otherwise."""
    settled = finding.get("reference", {}).get(SETTLED)
    if settled is None:
        return ""
    if finding["effect"].endswith("_bias"):
        return f" It is the bias {'once settled' if settled else 'at the start'}."
    return f" It counts from the settled bias: {equation_of(finding)}." if settled else ""


def _two_sided(finding: Mapping[str, Any], simulation: str) -> str:
    """Return what else makes a noise sqrt(2) times the claimed one; "" for any other difference."""
    if finding["effect"] != "noise_level" or simulation != BUILT_IN:
        return ""
    ratio = float(np.max(finding["parameters"]["ratio"]["value"]))
    if abs(np.log(ratio / TWO_SIDED)) > np.log(1.0 + LEVEL_TOLERANCE):
        return ""
    return (
        " A claimed density that is meant for a two-sided spectrum, √2 below a one-sided one, looks the same."
    )


def _together(finding: Mapping[str, Any]) -> str:
    """Return that a named effect is sure and its sizes are not, where no axis shows it by itself; else ""."""
    sizes = finding["difference"].values()
    if finding["effect"] == "unknown" or not sizes or any(_apart(p) for p in sizes):
        return ""
    return " On each axis by itself it may be nothing, but not on all of them together."


def _undistinguished(finding: Mapping[str, Any]) -> str:
    """Return which other effects would look the same in this recording; "" where none would."""
    alike = [noun(a["effect"], finding["sensor"]) for a in finding["alternatives"] if a["indistinguishable"]]
    if not alike:
        return ""
    told = f"this recording cannot tell it from: {', or '.join(alike)}."
    if finding["effect"] == "unknown":
        return f" It may have a name all the same: {told}"
    return f" {capital(told)}"


def _exchanged(finding: Mapping[str, Any]) -> str:
    """Return when axes are exchanged, and what else it may be; "" for anything else."""
    if finding["effect"] != "axis_exchange":
        return ""
    start, end = finding["where"]["t_start"], finding["where"]["t_end"]
    shown = f" The turns between rests show it {span(start, end)}"
    if told := finding.get("put_right"):
        return f"{shown}. {told}"
    return f"{shown}; they do not tell it from an exchange of the other sensor's axes."


def _on_some_axes(finding: Mapping[str, Any]) -> str:
    """Return which axes a low-pass filters, if not all of them."""
    if finding["effect"] != LOW_PASS or not of_some_axes(finding["axes"]):
        return ""
    return f" It filters {' and '.join(finding['axes'])} alone."


def _when(finding: Mapping[str, Any]) -> str:
    """Return when a step comes, or a vibration lasts that is there for a part of the recording; else ""."""
    if finding["effect"].endswith("_bias_step"):
        return f" It comes at {moment(finding['where']['t_start'])}."
    fraction = finding[side_of(finding)].get("fraction", {"value": 1.0})["value"]
    if finding["effect"] != "vibration_tone" or float(np.max(fraction)) >= 1.0:
        return ""
    return f" It lasts {span(finding['where']['t_start'], finding['where']['t_end'])}."


def side_of(finding: Mapping[str, Any]) -> str:
    """Return under which key the numbers stand of the one that has the effect."""
    return "simulated" if finding["relation"] == "superfluous" else "parameters"


def _departing(finding: Mapping[str, Any]) -> str:
    """Return in what an effect departs from the form of its name; "" where it does not."""
    departure = finding.get("departure")
    if departure is None:
        return ""
    return (
        f" This is not all of it: the effect goes {departure['way']}, which makes"
        f" {100.0 * departure['part']:.0f} % of its size and has no name."
    )


def _statement(finding: Mapping[str, Any], names: tuple[str, str], observed: str) -> str:
    recording, simulation = names[0], simulation_text(names[1])
    what = noun(finding["effect"], finding["sensor"])
    name = _clearest(finding)
    relation = finding["relation"]
    if finding["effect"] == "unknown":
        return _nameless(finding, recording, simulation, observed)
    if finding.get("of_either"):
        differ = f"{recording} and {simulation} differ by the {what}: {_every(finding, 'parameters')}."
        return f"{differ} {OF_EITHER} Added to {simulation}, it makes both agree."
    if relation == "lacking" and finding["effect"] in CONSTANTS:
        by = _every(finding, "difference")
        return f"The {what} of {recording} differs from that of {simulation} by {by}. Add it."
    if relation == "lacking":
        return (
            f"{simulation} lacks the {what} that {recording} shows: {_every(finding, 'parameters')}. Add it."
        )
    if relation == "superfluous":
        own = _every(finding, "simulated")
        return f"{simulation} has what {recording} does not show: {what}, {own}. Take it out."
    return _of_both(finding, recording, simulation, name)


def _nameless(finding: Mapping[str, Any], recording: str, simulation: str, observed: str) -> str:
    """Return what is said of something without a name: what was observed of it, else what it follows."""
    what = noun(finding["effect"], finding["sensor"])
    side = side_of(finding)
    owner, other = (simulation, recording) if side == "simulated" else (recording, simulation)
    seen = "".join(f", {text}" for text in (_where(finding, side), _sizes(finding, side)) if text)
    follows = "" if observed else f"; it follows {finding['where']['driver']}{_band(finding)}"
    if finding.get("of_either"):
        differ = f"{recording} and {simulation} differ by {what}{seen}{follows}."
        return " ".join(filter(None, (differ, observed, OF_EITHER)))
    shows = f"{owner} shows {what}{seen}{follows}."
    beside = f"{other} does not show it."
    if finding["relation"] in ("too_small", "too_large") and finding["simulated"]:
        beside = f"{other} shows it too, {_sizes(finding, 'simulated')}."
    return " ".join(filter(None, (shows, observed, beside)))


def _band(finding: Mapping[str, Any]) -> str:
    """Return from where to where in the spectrum something is, ", 12 to 19 Hz"; "" where it is in no band."""
    if finding["where"]["driver"] != COLOURED:
        return ""
    low, high = finding["where"]["band_hz"]
    return f", {low:.3g} to {high:.3g} Hz"


def _of_both(finding: Mapping[str, Any], recording: str, simulation: str, name: str | None) -> str:
    """Return how a parameter that both have differs, and by how much to change it."""
    what = noun(finding["effect"], finding["sensor"])
    recorded, simulated = (_side(finding, side, name) for side in ("parameters", "simulated"))
    what = f"cutoff of the {what}" if finding["effect"] == LOW_PASS else what
    word = _word(finding, name)
    text = f"The {what} {word} in {simulation}: {simulated}; {recording} has {recorded}."
    if name not in finding["difference"]:
        return f"{text} Set it to that."
    if name == "scale" and "scale_against_mean" in finding["difference"] and _overlap(finding, name):
        return f"{text} The difference is {_side(finding, 'difference', 'scale_against_mean')}."
    by = _side(finding, "difference", name).removeprefix(f"{parameter_noun(str(name))} ")
    return f"{text} Change it by {by}."


def _overlap(finding: Mapping[str, Any], name: str | None) -> bool:
    """Whether intervals of a number that is shown overlap: the difference may be surer than they are."""
    if any(name not in finding[side] for side in ("parameters", "simulated", "difference")):
        return False
    if any("ci95" not in finding[side][name] for side in ("parameters", "simulated")):
        return False
    shown = shown_of(finding, str(name), finding["axes"])
    recorded, simulated = (
        np.asarray(finding[side][name]["ci95"], dtype=np.float64).reshape(-1, 2)[shown]
        for side in ("parameters", "simulated")
    )
    low = np.maximum(recorded[:, 0], simulated[:, 0])
    return bool((low < np.minimum(recorded[:, 1], simulated[:, 1])).any())


def _where(finding: Mapping[str, Any], side: str) -> str:
    """Return on which axes, where they are told apart, and when something is seen."""
    apart = all(_apart(p) for p in finding[side].values())
    where, axes = finding["where"], " and ".join(finding["axes"]) if apart else ""
    return f"{f'on {axes} ' if axes else ''}{span(where['t_start'], where['t_end'])}"


def _sizes(finding: Mapping[str, Any], side: str) -> str:
    """Return the parameters of what has no name; of a parameter with many numbers the largest."""
    texts = []
    for name in list(finding[side])[:MOST_PARAMETERS]:
        text = _side(finding, side, name)
        values = np.abs(np.asarray(finding[side][name]["value"], dtype=np.float64))
        if values.size > len(AXES):
            factor, unit = shown_in(values.max(), finding[side][name]["unit"], name)
            text = f"up to {plain(float(values.max()) * factor)} {unit}".strip()
        elif not _apart(finding[side][name]):
            factor, unit = shown_in(values.max(), finding[side][name]["unit"], name)
            text = f"up to {plain(float(values.max()) * factor)} {unit} (the axes are not told apart)"
        texts.append(text if text.startswith(parameter_noun(name)) else f"{parameter_noun(name)} {text}")
    return "; ".join(texts)


def _apart(parameter: Mapping[str, Any]) -> bool:
    """Whether one of three axes at least is beyond its own 95 % interval from nothing."""
    if np.size(parameter["value"]) != len(AXES) or "ci95" not in parameter:
        return True
    low, high = np.asarray(parameter["ci95"], dtype=np.float64).reshape(-1, 2).T
    return bool((low * high > 0.0).any())


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


def _every(finding: Mapping[str, Any], side: str) -> str:
    """Return the parameters of one side, each with its name where there are several."""
    texts = {name: _side(finding, side, name) for name in list(finding[side])[:MOST_PARAMETERS]}
    if len(texts) < 2:
        return "".join(texts.values()) or "no value"
    named = [t if t.startswith(parameter_noun(n)) else f"{parameter_noun(n)} {t}" for n, t in texts.items()]
    return "; ".join(named)


def _side(finding: Mapping[str, Any], side: str, name: str | None) -> str:
    if name is None or name not in finding[side]:
        return "no value"
    parameter = finding[side][name]
    if name == EXCHANGE:
        return f"{EXCHANGE} undone by {_undone_by(parameter['value'])}"
    beside = [finding[s][name] for s in ("parameters", "simulated") if name in finding[s]]
    shown = shown_of(finding, name, finding["axes"])
    text = with_interval(name, parameter, shown, beside)
    if np.size(parameter["value"]) == len(AXES) ** 2:
        text += f" ({len(shown)} of 9 elements)"
    # A number without a unit, or one that belongs to a pair of axes, says too little without its name.
    named = name == "misalignment" or parameter["unit"] == "1"
    return f"{parameter_noun(name)} {text}" if named else text


def _undone_by(exchange: ArrayLike) -> str:
    """Return in plain words what puts exchanged axes right, "x = -y, y = x": a true axis and one as read."""
    rows = np.asarray(exchange, dtype=np.float64).round().astype(int)
    moved = [(axis, row) for axis, row in zip(AXES, rows, strict=True) if row[AXES.index(axis)] != 1]
    return ", ".join(f"{a} = {'-' * int(row.sum() < 0)}{AXES[np.abs(row).argmax()]}" for a, row in moved)


def _word(finding: Mapping[str, Any], name: str | None) -> str:
    """Return how the simulated numbers stand to the recorded ones, where all that are shown stand so."""
    assert name is not None, "what both have, has parameters"
    shown = shown_of(finding, name, finding["axes"])
    recorded, simulated = (
        np.asarray(finding[side][name]["value"], dtype=np.float64).ravel()[shown]
        for side in ("parameters", "simulated")
    )
    if (recorded * simulated < 0.0).all():
        return "has the opposite sign"
    same = (recorded * simulated >= 0.0).all()
    if same and finding["relation"] == "too_small" and (np.abs(simulated) < np.abs(recorded)).all():
        return "is too small"
    if same and finding["relation"] == "too_large" and (np.abs(simulated) > np.abs(recorded)).all():
        return "is too large"
    return "has other values"
