"""Findings of a diagnosis (JSON schema 2) as numbers to put into a configuration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import comb
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.bias_temperature import POWER_NAMES
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import OF_DENSITY
from stillcal.calib_core.diagnosis.slow.wander import WALK
from stillcal.calib_core.maths.rms import rms
from stillcal.replay.export.imu import LAG_S

Finding = Mapping[str, Any]

AXES = "xyz"
SENSORS = {"accel": "accelerometer", "gyro": "gyroscope"}
ORDER = ("sample_rate", "accel_scale", "gyro_scale")
"""Applied first: a noise per sample depends on the rate, and a bias is added to what is scaled."""

WALKS = tuple(f"{sensor}{WALK}" for sensor in SENSORS)
SLOW_NOISE = (*(f"{sensor}_slow_noise" for sensor in SENSORS), *WALKS)
DEVIATION, WHITE = "allan_deviation_100s", "density"
"""Parameters of slow noise, its Allan deviation at `LAG_S`, and of white noise."""

AT_MEAN = {f"{sensor}_bias_temperature": f"{sensor}_bias" for sensor in SENSORS}
"""Effects that a configuration without temperature can hold at one temperature, and what holds it."""


@dataclass(slots=True)
class Fixed:
    """A corrected configuration. changed: what was, a line each. not_held: effects, and why, a line each.

    left_out: the names of these effects.
    """

    text: str
    changed: list[str] = field(default_factory=list)
    not_held: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


class CannotHold(Exception):  # noqa: N818 - a refusal is not a failure
    """A configuration has no place for a finding; its text says why."""


class NothingToTakeOut(CannotHold):
    """A simulation has too much of what its configuration does not have at all."""

    def __init__(self) -> None:
        super().__init__("it has nothing of this to take out; the simulation must have it from elsewhere")


def apply_findings(
    findings: Iterable[Finding],
    handlers: Mapping[str, Callable[[Finding], None]],
    fixed: Fixed,
    otherwise: Callable[[Finding], None] | None = None,
) -> None:
    """Hand every finding to the handler of its effect; list what has none, or whose handler refuses it."""
    ordered = sorted(findings, key=lambda f: ORDER.index(f["effect"]) if f["effect"] in ORDER else len(ORDER))
    for finding in ordered:
        handler = handlers.get(finding["effect"], otherwise)
        try:
            if "assumption" in finding:
                raise CannotHold("the simulation logged no temperature and may have this already")
            if handler is not None:
                handler(finding)
            elif finding["effect"] in AT_MEAN and finding["relation"] != "superfluous":
                _put_in_bias(finding, handlers)
            else:
                raise CannotHold("it has no setting for this")
        except CannotHold as reason:
            fixed.not_held.append(f"{title(finding)}: {reason}")
            fixed.left_out.append(finding["effect"])


def _put_in_bias(finding: Finding, handlers: Mapping[str, Callable[[Finding], None]]) -> None:
    """Add what a bias that follows temperature is at the recording's mean temperature to the bias.

    Raises CannotHold in any case: the change with temperature has no place.
    """
    bias, mean, at = AT_MEAN[finding["effect"]], mean_c(finding), reference_c(finding)
    if bias not in handlers or mean is None or at is None:
        raise CannotHold("it has no setting for this")
    warmer = mean - at
    added = np.zeros(3)
    for power, name in enumerate(powers_of(finding), start=1):
        added += difference(finding, name) * warmer**power
    if not added.any():
        raise CannotHold("it has no setting for this")
    handlers[bias]({**finding, "difference": {"bias": {"value": added.tolist()}}})
    raise CannotHold(f"it has no setting for this; what it is at {mean:.1f} degC is in the bias")


def title(finding: Finding) -> str:
    """Return what a finding is about: its effect, and its sensor where the name does not say it."""
    sensor = finding["sensor"]
    named = finding["effect"].startswith(("accel_", "gyro_")) or sensor not in SENSORS
    return finding["effect"] if named else f"{finding['effect']} ({SENSORS[sensor]})"


def difference(finding: Finding, name: str) -> Array:
    """Return what to add to the simulation's parameter, zero on axes that the finding does not name.

    Where only the recording has the effect it is the recording's value, where only the simulation has it,
    minus the simulation's. Raises CannotHold where there is no such parameter.
    """
    if name in finding["difference"]:
        value = np.asarray(finding["difference"][name]["value"], dtype=np.float64)
    elif name in finding["parameters"]:
        value = np.asarray(finding["parameters"][name]["value"], dtype=np.float64)
    elif name in finding["simulated"]:
        value = -np.asarray(finding["simulated"][name]["value"], dtype=np.float64)
    else:
        raise CannotHold(f"the finding has no {name}")
    return on_its_axes(finding, value, 0.0) if value.shape == (3,) else value


def to_add(finding: Finding, name: str, before: Array) -> Array:
    """Return what to add to a configured parameter: the difference, or what takes a superfluous one out.

    Raises CannotHold where the configuration has nothing of it that could be taken out.
    """
    delta = difference(finding, name)
    if finding["relation"] != "superfluous":
        return delta
    gone = np.where(delta != 0.0, -np.asarray(before), 0.0)
    if not gone.any():
        raise NothingToTakeOut
    return gone


def recorded(finding: Finding, name: str) -> Array:
    """Return the recording's parameter. Raises CannotHold where it has none."""
    if name not in finding["parameters"]:
        raise CannotHold(f"the recording has no {name}")
    return np.asarray(finding["parameters"][name]["value"], dtype=np.float64)


def ratio(finding: Finding, name: str) -> Array:
    """Return recorded over simulated of a positive parameter, one on axes that the finding does not name."""
    one = recorded(finding, name)
    if name not in finding["simulated"]:
        raise CannotHold(f"the simulation has no {name}")
    out = one / np.asarray(finding["simulated"][name]["value"], dtype=np.float64)
    return on_its_axes(finding, out, 1.0) if out.shape == (3,) else out


def common_ratio(finding: Finding, name: str) -> float:
    """Return the ratio of powers over the axes, as one number of standard deviations."""
    one = recorded(finding, name)
    other = one / ratio(finding, name)
    return float(np.sqrt(np.sum(np.square(one)) / np.sum(np.square(other))))


def powers_of(finding: Finding) -> list[str]:
    """Return the powers of temperature that a finding has, the lowest first."""
    return [
        n
        for n in POWER_NAMES
        if any(n in finding[side] for side in ("difference", "parameters", "simulated"))
    ]


def restated(finding: Finding, warmer: float) -> Finding:
    """Return a polynomial in temperature with its differences about a temperature that is `warmer` K higher.

    About T + w a sum of c_p x^p has the coefficients sum over p of binomial(p, q) w^(p - q) c_p.
    """
    powers = powers_of(finding)
    given = [difference(finding, name) for name in powers]
    moved = {
        name: sum(comb(p, q) * warmer ** (p - q) * c for p, c in enumerate(given, start=1) if p >= q)
        for q, name in enumerate(powers, start=1)
    }
    values = {name: {"value": np.asarray(c).tolist()} for name, c in moved.items()}
    return {**finding, "difference": {**finding["difference"], **values}}


def refuse_bends(finding: Finding) -> None:
    """Raise CannotHold where a bias curves with temperature, after its slope has been put in."""
    bends = [name for name in POWER_NAMES[1:] if name in finding["parameters"]]
    if bends:
        raise CannotHold(f"its slope is put in, but there is no setting for {' and '.join(bends)}")


def level(before: Array, finding: Finding, name: str, own: Array) -> Array:
    """Return a configured level (3,) of noise as it must be.

    It is multiplied by the ratio of what was recorded to what was simulated. Where the simulation has as good
    as nothing there is nothing to multiply: it becomes the recording's own, in the configuration's units.
    """
    if finding["relation"] == "lacking":
        return np.broadcast_to(own, 3).copy()
    return np.where(before == 0.0, own, before * ratio(finding, name))


def common_level(before: float, finding: Finding, name: str, own: float) -> float:
    """Return the same for a configuration with one number for all axes."""
    if finding["relation"] == "lacking" or before == 0.0:
        return own
    return before * common_ratio(finding, name)


def reference_c(finding: Finding) -> float | None:
    """Return the temperature, degC, at which bias and slope of a finding are stated."""
    value = finding.get("reference", {}).get("temperature_c")
    return None if value is None else float(value)


def mean_c(finding: Finding) -> float | None:
    """Return the recording's mean temperature, degC."""
    value = finding.get("reference", {}).get("mean_temperature_c")
    return None if value is None else float(value)


def findings_of(answer: Mapping[str, Any]) -> list[Finding]:
    """Return an answer's findings; slow noise has beside it the recording's density of white noise.

    The density is that of another finding or, where the two agree, of what was compared.
    """
    compared = [*answer["findings"], *answer.get("agreed", ())]
    densities = {
        one["sensor"]: {WHITE: one["parameters"][WHITE]}
        for one in compared
        if one["effect"] in OF_DENSITY and WHITE in one["parameters"]
    }
    beside = {f"{sensor}_slow_noise": density for sensor, density in densities.items()}
    return [
        {**f, "parameters": {**beside.get(f["effect"], {}), **f["parameters"]}} for f in answer["findings"]
    ]


def slow_deviation(finding: Finding) -> Array:
    """Return the Allan deviation (3,) at `LAG_S` of the recording's slow noise alone.

    The one that was compared has white noise in it, by its square white^2 / (2 LAG_S) of a one-sided density
    (IEEE Std 952-1997, Annex C). Raises CannotHold where that is not known. A random walk has none in it.
    """
    if finding["effect"] in WALKS:
        return np.broadcast_to(recorded(finding, WHITE) * np.sqrt(LAG_S / 3.0), 3)
    if WHITE not in finding["parameters"]:
        raise CannotHold("how much of its Allan deviation is white noise is not known")
    whole, white = (recorded(finding, name) for name in (DEVIATION, WHITE))
    white = white if whole.size == 3 else np.array(rms(white))
    return np.broadcast_to(np.sqrt(np.maximum(whole**2 - white**2 / (2.0 * LAG_S), 0.0)), 3)


def slow_walk(finding: Finding) -> Array:
    """Return the random walk (3,), unit/sqrt(s), with the recording's slow noise at `LAG_S`."""
    return np.asarray(slow_deviation(finding) * np.sqrt(3.0 / LAG_S))


def on_its_axes(finding: Finding, after: Array, before: Array | float) -> Array:
    """Return `after` (3,) on the axes that a finding names, all where it names none, else `before` (3,)."""
    if not finding["axes"]:
        return np.asarray(after)
    return np.where([axis in finding["axes"] for axis in AXES], after, before)


def gain_after(finding: Finding, before: Array) -> Array:
    """Return a configured forward matrix (3, 3) as it must be: unity where it is superfluous.

    Raises CannotHold where it is superfluous and the configuration has none.
    """
    if finding["relation"] != "superfluous":
        return np.asarray(_gain_change(finding) @ before)
    if np.array_equal(before, np.eye(3)):
        raise NothingToTakeOut
    return np.eye(3)


def _gain_change(finding: Finding) -> Array:
    """Return the matrix (3, 3) that multiplies the simulated sensor's forward matrix from the left.

    A correction's matrix C belongs to the forward matrix inv(C): the simulation's becomes the recording's.
    """
    ours, theirs = (_correction(finding[side]) for side in ("parameters", "simulated"))
    return np.asarray(np.linalg.solve(ours, theirs))


def _correction(parameters: Mapping[str, Any]) -> Array:
    """Return a correction's matrix from its parts: less unity, by three scales and xy, xz, yz, or by nine."""
    if "scale" not in parameters:
        raise CannotHold("the finding has no scale")
    scale = np.asarray(parameters["scale"]["value"], dtype=np.float64)
    if scale.shape == (3, 3):
        return np.asarray(np.eye(3) + scale)
    out = np.diag(1.0 + scale)
    crossed = parameters.get("misalignment", {"value": [0.0, 0.0, 0.0]})["value"]
    for value, (a, b) in zip(crossed, ((0, 1), (0, 2), (1, 2)), strict=True):
        out[a, b] = out[b, a] = value
    return np.asarray(out)


def shown(values: Array | float) -> str:
    """Return numbers for a message, four digits each."""
    array = np.asarray(values)
    if array.ndim == 0:
        return f"{float(array):.4g}"
    return f"[{', '.join(shown(v) for v in array)}]"


def rounded(values: Array) -> Array:
    """Return numbers with ten significant digits: more than any recording shows, and short to read."""
    return np.asarray([float(f"{v:.10g}") for v in np.ravel(values)]).reshape(np.shape(values))


def note_change(fixed: Fixed, place: str, before: Array | float, after: Array | float) -> None:
    """Say what was changed, and from what to what."""
    fixed.changed.append(f"{place}: {shown(before)} -> {shown(after)}")


def changed_axes(delta: Sequence[float] | Array) -> list[int]:
    """Return the axes on which something is added."""
    return [i for i, value in enumerate(np.asarray(delta).tolist()) if value != 0.0]
