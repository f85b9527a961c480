"""What a diagnosis found, taken into a calibration as terms.

A calibration was fitted without the effect, and its bias and scale hold a part of it. So it is fitted anew to
its own rests, once the effect is taken off them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer.fit import AccelerometerSettings
from stillcal.calib_core.accelerometer.parameters import ALL, DIAGONAL, basis, inverse
from stillcal.calib_core.accelerometer.prior import SOUND_PHONES
from stillcal.calib_core.accelerometer.result import AccelerometerFit
from stillcal.calib_core.accelerometer.six_faces import common_rotation
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.candidate import accelerometer_record, fit_accelerometer, with_wander
from stillcal.calib_core.calibration.constancy import find_change
from stillcal.calib_core.calibration.corrections.base import Correction, Drivers, uncertainty_of
from stillcal.calib_core.calibration.corrections.catalogue import ADOPTABLE, CORRECTIONS
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.calibration.terms import compensated
from stillcal.calib_core.codec import from_plain
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.gyroscope.bias import BiasEstimate, bias_from_rests
from stillcal.calib_core.static.rest import forces
from stillcal.calib_core.streams.beginning import Beginning
from stillcal.calib_core.streams.samples import Sensor

_WITH_THE_START = 0.25
"""Of its time constant: a warm-up that is first seen later after the start is not followed back to it."""

_NO_TERM = "a calibration has no correction for it"
_ANEW = "it is over once the phone is calibrated anew"
_WHY_NOT = {
    "_bias_step": _ANEW,
    "_bias_drift": _ANEW,
    BY_CHARGING: "the daemon learns it at its hourly checks",
}
"""Why an effect is not taken up, by the end of its name."""


def refusal(finding: Mapping[str, Any]) -> str:
    """Return why a finding cannot be taken up into any calibration, "" where it can be."""
    effect = str(finding["effect"])
    if effect not in ADOPTABLE:
        return next((why for end, why in _WHY_NOT.items() if effect.endswith(end)), _NO_TERM)
    if finding.get("relation") == "superfluous":
        return "the simulation has it, and the recording does not show it"
    alike = [a["effect"] for a in finding.get("alternatives", ()) if a.get("indistinguishable")]
    return f"{' or '.join(alike)} fits as well" if alike else ""


def beginning_of(answer: Mapping[str, Any]) -> Beginning | None:
    """Return when the recording of a diagnosis (its JSON) began; None where that does not say it.

    Raises ValueError where it is malformed.
    """
    began = answer.get("beginning")
    return None if began is None else from_plain(began, Beginning)


def adopt(
    record: CalibrationRecord, findings: Iterable[Mapping[str, Any]], diagnosed: Beginning | None = None
) -> tuple[CalibrationRecord, dict[str, str]]:
    """Return the calibration with terms for those findings (of `diagnose --json`) that can be applied.

    The second is why others are left out, by effect. A finding replaces an earlier term of the same effect.
    diagnosed: the beginning of the recording that was diagnosed, None where unknown. Raises NotSupported
    where none of the findings can be applied; ValueError on a malformed finding.
    """
    fresh, refused = _sorted_out(record, findings, diagnosed)
    if not fresh:
        why = "; ".join(f"{effect}: {text}" for effect, text in refused.items())
        raise NotSupported(f"no finding can be applied{f' ({why})' if why else ''}")
    others = [term for term in record.terms if term.effect not in fresh]
    started = _started(record)
    refitting = [term for term in fresh.values() if _is_held(record, term, started)]
    after = replace(
        record,
        terms=(*others, *fresh.values()),
        acceptance=replace(record.acceptance, how="terms", reason=_reason(fresh.values(), refitting)),
    )
    known = _known(record, refitting, started)
    for sensor, refitted in ((Sensor.ACCELEROMETER, _accelerometer), (Sensor.GYROSCOPE, _gyroscope)):
        if any(term.sensor == sensor for term in refitting):
            after = refitted(record, after, known, started)
    return after, refused


def _sorted_out(
    record: CalibrationRecord, findings: Iterable[Mapping[str, Any]], diagnosed: Beginning | None
) -> tuple[dict[str, Term], dict[str, str]]:
    """Return the terms of findings that a calibration can take up, and why not of the others, by effect."""
    terms: dict[str, Term] = {}
    refused: dict[str, str] = {}
    for finding in findings:
        effect = str(finding["effect"])
        try:
            terms[effect] = _supported(record, finding, diagnosed)
        except NotSupported as error:
            refused[effect] = str(error)
    return terms, refused


def _supported(record: CalibrationRecord, finding: Mapping[str, Any], diagnosed: Beginning | None) -> Term:
    """Return the term of a finding. Raises NotSupported where the calibration cannot take it up."""
    if why := refusal(finding):
        raise NotSupported(why)
    term = _term(record, finding)
    correction = CORRECTIONS[term.effect]
    if correction.refits and not correction.without_rests:
        part = record.accelerometer if term.sensor is Sensor.ACCELEROMETER else record.gyroscope
        if part is None:
            raise NotSupported(f"the calibration is not of the {term.sensor}", [f"one of the {term.sensor}"])
        if correction.by_start:
            term = correction.from_start(term, _seen_after(record, term, finding, diagnosed))
        _require_drivers(record, term, _started(record))
    if term.sensor is Sensor.GYROSCOPE and record.gyroscope is not None:
        _turn_powers(record.gyroscope, term)
    return term


def _started(record: CalibrationRecord) -> float | None:
    """Return when the recording began that a calibration is of, s; None where it is of a running phone."""
    return None if record.provenance.beginning is None else record.provenance.beginning.t


def _reason(terms: Iterable[Term], refitting: Collection[Term]) -> str:
    """Return in words what was taken up, and what was fitted anew without it.

    What follows the rate leaves the gyroscope's bias as it is, and its turns are not kept.
    """
    reason = f"{', '.join(term.effect for term in terms)} taken up from a diagnosis"
    force = any(term.sensor is Sensor.ACCELEROMETER for term in refitting)
    rate = any(t.sensor is Sensor.GYROSCOPE and not CORRECTIONS[t.effect].of_reading for t in refitting)
    anew = (*(["the accelerometer's bias and scale"] * force), *(["the gyroscope's bias"] * rate))
    return f"{reason}; {' and '.join(anew)} fitted anew without it" if anew else reason


def terms_of(record: CalibrationRecord, findings: Iterable[Mapping[str, Any]]) -> dict[str, Term]:
    """Return the terms, by effect, of those findings that can be applied; errors as `adopt`."""
    return {f["effect"]: _term(record, f) for f in findings if not refusal(f)}


def mean_temperature(record: CalibrationRecord) -> float | None:
    """Return the mean temperature (degC) of the rests fitted to, else the middle of the range of validity."""
    known = _temperatures(record)
    return float(np.mean(known)) if known else None


def _temperatures(record: CalibrationRecord) -> list[float]:
    """Return the temperatures (degC) of the rests fitted to, else the ends of the range of validity."""
    known = [s.temperature for s in record.states if s.temperature is not None]
    ends = record.validity.temperature_min, record.validity.temperature_max
    return known or [end for end in ends if end is not None]


def _term(record: CalibrationRecord, finding: Mapping[str, Any]) -> Term:
    """Turn a finding into a term that counts from where the calibration holds."""
    correction, reference = CORRECTIONS[finding["effect"]], {}
    if "temperature" in correction.references:
        at = mean_temperature(record)
        if at is None:
            missing = "a calibration from a recording with temperature"
            raise NotSupported("the calibration's rests have no temperature", [missing])
        reference = {"temperature": at}
        if correction.keeps_spread:
            reference["temperature_sd"] = float(np.std(_temperatures(record)))
    assert correction.sensor is not None, "the heat of charging is refused"
    return correction.term(correction.sensor, finding, reference)


def _seen_after(
    record: CalibrationRecord, term: Term, finding: Mapping[str, Any], diagnosed: Beginning | None
) -> float:
    """Return how long after the start of the recording (s) a finding begins, from which its term counts.

    That is not 0 where the other sensor began first. Raises NotSupported where it is too late, or where the
    calibration's rests are not known to count from the same start.
    """
    own = record.provenance.beginning
    if diagnosed is None:
        raise NotSupported(
            "the diagnosis does not say when its recording began",
            ["a diagnosis of a recording by this version"],
        )
    after = float(finding["where"]["t_start"]) - diagnosed.t
    if not after <= _WITH_THE_START * float(term.parameters["tau_s"].value):
        raise NotSupported(
            "only a part of the recording was diagnosed, which began later",
            ["a diagnosis without --from"],
        )
    if own is not None and own != diagnosed:
        name = record.provenance.source or "without a name"
        remedy = CORRECTIONS[term.effect].remedy
        raise NotSupported(f"the calibration is of another recording ({name})", [remedy])
    return after


def _at_states(record: CalibrationRecord, started: float | None) -> Drivers:
    """Return what terms follow at the rests of a calibration."""
    rests = [state.rest() for state in record.states]
    force = np.array([rest.specific_force for rest in rests]).reshape(-1, 3)
    t = np.array([0.5 * (rest.t_start + rest.t_end) for rest in rests])
    return Drivers(
        celsius=np.array([np.nan if rest.temperature is None else rest.temperature for rest in rests]),
        charged=np.array([rest.charged for rest in rests]),
        age=None if started is None else t - started,
        force=None if record.accelerometer is None else record.accelerometer.model.apply(force),
        reading=force,
    )


def _require_drivers(record: CalibrationRecord, term: Term, started: float | None) -> None:
    """Raise NotSupported where the calibration's rests do not tell what a term follows."""
    correction: Correction = CORRECTIONS[term.effect]
    if not record.states:
        raise NotSupported(
            "the calibration is without its rests, as one that was imported or rolled back to",
            ["a calibration by stillcal replay, or by the daemon"],
        )
    if not _known(record, [term], started).any():
        raise NotSupported(f"the calibration's rests do not say {correction.driver}", [correction.remedy])


def _is_held(record: CalibrationRecord, term: Term, started: float | None) -> bool:
    """Tell whether a calibration holds a part of a term that its rests tell."""
    force = term.sensor is Sensor.ACCELEROMETER
    part = record.accelerometer if force else record.gyroscope
    measured = part is not None and (force or any(state.rate is not None for state in record.states))
    return CORRECTIONS[term.effect].refits and measured and bool(_known(record, [term], started).any())


def _known(record: CalibrationRecord, terms: Iterable[Term], started: float | None) -> NDArray[np.bool_]:
    """Tell at which rests (n,) of a calibration all that terms follow is known."""
    at, known = _at_states(record, started), np.ones(len(record.states), dtype=bool)
    for term in terms:
        correction = CORRECTIONS[term.effect]
        offset = correction.offset(term, at)
        known &= offset is not None and np.isfinite(offset).all(axis=1)
        if at.celsius is not None and "temperature" in correction.references:
            known &= np.isfinite(at.celsius)
    return known


def _rests(record: CalibrationRecord, known: NDArray[np.bool_], started: float | None) -> Pool:
    """Return the rests of a calibration at which its terms are known, with these taken off."""
    gravity = record.gravity or Gravity()
    states = [state for state, used in zip(record.states, known.tolist(), strict=True) if used]
    return compensated(Pool(tuple(HeldRest(state.rest(), gravity) for state in states)), record, started)


def _accelerometer(
    before: CalibrationRecord, after: CalibrationRecord, known: NDArray[np.bool_], started: float | None
) -> CalibrationRecord:
    """Return a calibration whose accelerometer is fitted anew to its rests, with the terms taken off.

    One that has followed later rests since is that of an unknown state of what the terms follow; it begins
    anew from its own rests. The rotation common to all axes stays.
    """
    part, gravity = after.accelerometer, after.gravity or Gravity()
    if part is None:
        raise NotSupported("the calibration has no accelerometer part", ["a full calibration"])

    def fitted(record: CalibrationRecord) -> tuple[AccelerometerFit, Pool]:
        pool, prior = _rests(record, known, started), SOUND_PHONES if part.with_prior else None
        return fit_accelerometer(
            pool.held, gravity, AccelerometerSettings(), min(part.parameters, 9), prior
        ), pool

    new, pool = fitted(after)
    turned = common_rotation(part.scale) if part.parameters == ALL else np.eye(3)
    own = accelerometer_record(new, find_change(new, pool.held), forces(pool.rests))
    by_terms = _by_terms(before, after, Sensor.ACCELEROMETER, lambda r: fitted(r)[0].values - new.values)
    changed = replace(
        part,
        scale=frozen(turned @ new.model.scale),
        bias=new.model.bias,
        covariance=None if own.covariance is None else _with_rotation(part, own.covariance + by_terms),
        rms_residual=own.rms_residual,
        n_rests=own.n_rests,
        n_states=own.n_states,
    )
    return _without_forecast(replace(after, accelerometer=changed), Sensor.ACCELEROMETER)


_SHARE = 0.1
"""Of a standard uncertainty: the step of a derivative."""


def _by_terms(
    before: CalibrationRecord,
    after: CalibrationRecord,
    sensor: Sensor,
    moved: Callable[[CalibrationRecord], Array],
) -> Array:
    """Return the covariance (p, p) of what is fitted anew, by how uncertain the parameters of the terms are.

    moved: by how much the fit with the terms of a record differs from that of `after`, (p,).
    """
    total: Array | float = 0.0
    for k, term in enumerate(after.terms):
        if term in before.terms or term.sensor is not sensor or not CORRECTIONS[term.effect].refits:
            continue
        for name, parameter in term.parameters.items():
            for step in np.diag(uncertainty_of(parameter).ravel()):
                size = _SHARE * np.copysign(step.reshape(parameter.value.shape), parameter.value)
                larger = replace(parameter, value=frozen(parameter.value + size))
                other = replace(term, parameters=term.parameters | {name: larger})
                row = moved(replace(after, terms=(*after.terms[:k], other, *after.terms[k + 1 :])))
                total = total + np.outer(row, row) / _SHARE**2
    return np.asarray(total)


def _with_rotation(part: AccelerometerRecord, covariance: Array) -> Array:
    """Return the covariance of a fit to rests, with what the calibration has of the rotation of all axes.

    No rest shows that rotation: it is the part of a scale that is not symmetric.
    """
    if part.parameters != ALL or part.covariance is None:
        return frozen(covariance)
    symmetric = basis(9)
    turned = np.eye(ALL) - symmetric @ inverse(9)
    return frozen(symmetric @ covariance @ symmetric.T + turned @ part.covariance @ turned.T)


def _without_forecast(record: CalibrationRecord, sensor: Sensor) -> CalibrationRecord:
    """Return a record without the forecast of a bias that is another one now."""
    kept = {name: forecast for name, forecast in record.forecast.items() if name != str(sensor)}
    return replace(record, forecast=kept)


def _gyroscope(
    before: CalibrationRecord, after: CalibrationRecord, known: NDArray[np.bool_], started: float | None
) -> CalibrationRecord:
    """Return a calibration with its gyroscope's bias, and its scale, less what they hold of the terms.

    A bias that was learnt begins anew from the newest of its own rests, else from all of them. Terms that
    follow the rate leave it as it is.
    """
    part = after.gyroscope
    if part is None:
        raise NotSupported("the calibration has no gyroscope part", ["a recording with a gyroscope"])
    biased = [t for t in after.terms if t not in before.terms and not CORRECTIONS[t.effect].of_reading]
    moves = any(term.sensor is Sensor.GYROSCOPE for term in biased)
    bias, covariance = part.bias, part.covariance
    if moves:
        measured = _at_rest(_rests(after, known, started), after)
        bias = measured.bias

        def moved(record: CalibrationRecord) -> Array:
            return _at_rest(_rests(record, known, started), record).bias - bias

        by_terms = _by_terms(before, after, Sensor.GYROSCOPE, moved)
        covariance = with_wander(covariance, replace(measured, covariance=measured.covariance + by_terms))
    held = _held_by_scale(part, after) - _held_by_scale(part, before)
    changed = replace(
        part,
        bias=frozen(bias),
        scale=frozen(part.scale @ np.diag(1.0 / (1.0 - held))),
        covariance=_less_certain(part.names, covariance, held),
    )
    changed_record = replace(after, gyroscope=changed)
    return _without_forecast(changed_record, Sensor.GYROSCOPE) if moves else changed_record


def _at_rest(pool: Pool, record: CalibrationRecord) -> BiasEstimate:
    """Return the gyroscope's bias as a calibration's rests show it. NotSupported where they do not."""
    rests = [rest for rest in pool.rests if rest.rate is not None]
    if str(Sensor.GYROSCOPE) in record.forecast:
        rests = rests[-1:]
    return bias_from_rests(rests)


_HELD_SD = 0.5
"""Relative standard uncertainty of what a scale holds of an effect: a turn about the vertical counts for
nothing in its fit, and is counted here."""


def _less_certain(names: Sequence[str], covariance: Array | None, held: Array) -> Array | None:
    """Return the covariance of a gyroscope whose scale was changed by `held`, (3,) of one."""
    if covariance is None or not set(DIAGONAL) <= set(names):
        return covariance
    wider = np.array(covariance)
    rows = [names.index(name) for name in DIAGONAL]
    wider[rows, rows] += (_HELD_SD * held) ** 2
    return frozen(wider)


def _held_by_scale(part: GyroscopeRecord, record: CalibrationRecord) -> Array:
    """Return by how much, (3,) of one, terms of the gyroscope change the turns that its scale comes from."""
    total = np.zeros(3)
    for term in record.terms:
        correction = CORRECTIONS.get(term.effect)
        if term.sensor is Sensor.GYROSCOPE and correction is not None:
            total = total + correction.held_by_scale(term, _turn_powers(part, term))
    return total


def _turn_powers(part: GyroscopeRecord, term: Term) -> Array:
    """Return what the scale was fitted to, as the record has it; zeros where it was not fitted."""
    if part.parameters == 3 or not CORRECTIONS[term.effect].in_turns:
        return np.zeros((2, 3))
    if part.turn_powers is None:
        raise NotSupported(
            "the calibration does not say how fast the turns were that its scale comes from",
            ["a new calibration by stillcal replay, or by the daemon"],
        )
    return part.turn_powers
