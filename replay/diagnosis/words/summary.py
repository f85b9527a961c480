"""The answer in some lines for a terminal: the verdict, what differs, what was not compared and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stillcal.calib_core.calibration.adoption import refusal
from stillcal.calib_core.calibration.corrections.catalogue import ADOPT
from stillcal.calib_core.diagnosis.comparison.direct import LINE
from stillcal.calib_core.diagnosis.comparison.quantity import EVEN
from stillcal.calib_core.diagnosis.comparison.records import LEVEL
from stillcal.calib_core.diagnosis.model.settings import CERTAIN
from stillcal.replay.diagnosis.words.names import BUILT_IN, capital, noun, simulation_text
from stillcal.replay.diagnosis.words.relation_text import with_interval

VERDICTS = {
    "match": "No difference found",
    "identified": "Differences found, all identified",
    "partly_identified": "Differences found, not all identified",
    "unidentified": "Differences found, of unknown cause",
    "not_judged": "Not judged: too few of the checks could be made",
}
NAMED_ONLY = "Differences found and named, but the corrected simulation does not fit"
IN_PART = "Not judged as a whole: too few of the checks could be made; those made show differences"
NOT_DECIDED = "No difference is sure, but likely: "
BASIC = ("accel_bias", "accel_scale", "gyro_bias", "gyro_scale")
"""Effects of which "no difference" says something in any case: where they were not compared, it is said."""

NOT_WHOSE = "Differences found, not all of them surely the recording's"

LINES = 14
"""Longest summary; it is to be read at a glance."""


def headline(answer: Mapping[str, Any]) -> str:
    """Return the verdict in a sentence, with how many of the checks this recording allows."""
    text, made, of = VERDICTS[answer["verdict"]], answer["checks"]["made"], answer["checks"]["of"]
    named = all(f["effect"] != "unknown" for f in answer["findings"])
    if answer["verdict"] == "partly_identified" and named and "p_after" in answer["fit"]:
        text = NAMED_ONLY
    if any(max(f["owners"].values()) < CERTAIN for f in answer["findings"] if "owners" in f):
        text = NOT_WHOSE
    if answer["verdict"] == "not_judged" and answer["findings"]:
        text = IN_PART
    likely = [one for one in answer["not_compared"] if one.get("probability", 0.0) > EVEN]
    if answer["verdict"] == "match" and likely:
        text = NOT_DECIDED + _some([noun(one["effect"], one["sensor"]) for one in likely])
    elif answer["verdict"] == "match":
        unknown = [noun(x["effect"], x["sensor"]) for x in answer["not_compared"] if x["effect"] in BASIC]
        text += f" in what was compared; not compared: {_some(unknown, len(BASIC))}" if unknown else ""
    checks = f"{made} of {of} checks possible"
    return f"{text} ({checks})"


def outcome(answer: Mapping[str, Any]) -> str:
    """Return how the simulation fits with what was found put into it; "" where nothing was found."""
    if not answer["findings"]:
        return ""
    simulation, fit = simulation_text(answer["simulation"]), answer["fit"]
    if "p_after" not in fit:
        return f"{capital(simulation)} could not be played with what was found: the phone is never at rest."
    nameless = "unknown" in fit["not_put_in"]
    # One effect on both sensors is named once.
    left = ", ".join(dict.fromkeys(noun(effect, "") for effect in fit["not_put_in"] if effect != "unknown"))
    without = f" These could not be put in and are left out of both: {left}." if left else ""
    if {f["effect"] for f in answer["findings"]} <= set(fit["not_put_in"]):
        return (
            _nothing_put_in(simulation, fit, left) if not nameless else _nameless(simulation, fit) + without
        )
    passes = "passes" if fit["p_after"] >= LEVEL else "still fails"
    numbers = f"bound of p: {fit['p_after']:.2g}; before {fit['p_before']:.2g}"
    still = ", ".join(noun(one["effect"], one["sensor"]) for one in fit["still_different"])
    where = f" What differs then: {still}." if still else ""
    both = " What has no name could not be put in and counts in both." if nameless else ""
    put = "what has a name" if nameless else "what was found"
    return f"With {put} put in, {simulation} {passes} the same comparison ({numbers}).{where}{both}{without}"


def _nothing_put_in(simulation: str, fit: Mapping[str, Any], left: str) -> str:
    """Return how a simulation fits apart from what was found, none of which can be put into it."""
    passes = "passes" if fit["p_before"] >= LEVEL else "fails"
    return (
        f"This cannot be put into the samples of {simulation}: {left}. In all else it {passes} the comparison"
        f" (bound of p: {fit['p_before']:.2g})."
    )


def _nameless(simulation: str, fit: Mapping[str, Any]) -> str:
    """Return how a simulation fits of which all that was found has no name."""
    passes = "passes" if fit["p_before"] >= LEVEL else "fails"
    return (
        f"What has no name cannot be put into {simulation}: it {passes} the comparison as before"
        f" (bound of p: {fit['p_before']:.2g})."
    )


def summary(answer: Mapping[str, Any], lines: int = LINES) -> list[str]:
    """Return the answer in some lines for a terminal, the verdict first."""
    simulation = simulation_text(answer["simulation"])
    out = [f"{answer['recording']} against {simulation}: {headline(answer)}"]
    out += [f"  {f['statement']} (probability {f['probability']:.2f})" for f in answer["findings"]]
    out += [f"  {text}" for text in (outcome(answer), remedy(answer)) if text]
    witnesses = answer.get("witnesses", [])
    out += [f"  witness: {told['note']}" for one in witnesses for told in (*one["findings"], one)]
    agreed = ", ".join(_with_frequency(a) for a in answer["agreed"] if "note" not in a)
    if agreed:
        out.append(f"  agreed: {agreed}")
    out += [f"  no finding: {_noted(a)}" for a in answer["agreed"] if "note" in a]
    out += [f"  not compared: {_some(what)} - {why}" for why, what in reasons(answer).items()]
    if len(out) > lines:
        out = [*out[: lines - 1], f"  and {len(out) - lines + 1} more lines in --json and --report"]
    return out


def remedy(answer: Mapping[str, Any]) -> str:
    """Return how recordings of this phone can be corrected for what was found; "" where they cannot.

    What differs from a given simulation may be the simulation's fault, and is no reason to correct the phone.
    """
    if answer["simulation"] != BUILT_IN:
        return ""
    effects = ", ".join(dict.fromkeys(f["effect"] for f in answer["findings"] if not refusal(f)))
    if not effects:
        return ""
    return (
        f"Recordings of this phone can be corrected for {effects}: {ADOPT} STORE DIAGNOSIS (the file"
        " of --json), then stillcal apply."
    )


def _with_frequency(one: Mapping[str, Any]) -> str:
    """Return what agrees; a line with its frequency, for another of the same sensor may differ."""
    name = noun(one["effect"], one["sensor"])
    hertz = one["parameters"].get(LINE)
    return name if hertz is None else f"{name}, {with_interval(LINE, hertz, [0])}"


def _noted(one: Mapping[str, Any]) -> str:
    """Return what agrees only because sound phones do it too, with its numbers."""
    numbers = "; ".join(
        with_interval(name, p, range(np.size(p["value"]))) for name, p in one["parameters"].items()
    )
    return f"{noun(one['effect'], one['sensor'])}, {numbers}: {one['note']}"


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
