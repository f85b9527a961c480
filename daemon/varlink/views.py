"""Convert the daemon's records into the socket's answers. Pure, and bounded in size."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from stillcal._version import __version__
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.base import Drivers
from stillcal.calib_core.calibration.corrections.catalogue import follows_charger
from stillcal.calib_core.calibration.record import CalibrationRecord, GyroscopeRecord, SensorRecord
from stillcal.calib_core.calibration.rest_pool import HeldRest
from stillcal.calib_core.calibration.terms import offsets, terms_uncertainty
from stillcal.calib_core.engine.laid_faces import Stage
from stillcal.calib_core.engine.sensor_faults import failure
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.static.settings import Label, Sense
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.service.energy_ledger import Day
from stillcal.daemon.service.engine_thread import View
from stillcal.daemon.service.finding_outcomes import outcome
from stillcal.daemon.service.subscribers import Notification
from stillcal.daemon.sources.base import Source
from stillcal.daemon.store.document import HistoryEntry, StoreDocument
from stillcal.daemon.varlink import types as api
from stillcal.daemon.varlink.daemon import Daemon

DAY_S = 86400.0


@functools.lru_cache(maxsize=128)
def identity(record: CalibrationRecord) -> str:
    """Return a record's id, which is a hash of the whole record; the newest ones are cached."""
    return record.id


def calibration(
    record: CalibrationRecord, daemon: Daemon, temperature_c: float | None = None
) -> api.Calibration:
    """Return a calibration with its age, what is known of its soundness, and its biases now.

    temperature_c: degC, of the sensor now; where None is told, the thermometer's latest reading.
    """
    warmth = _warmth(daemon, temperature_c)
    view, now, gravity, validity = daemon.view, daemon.now, record.gravity, record.validity
    current = daemon.document.current
    accelerometer = _sensor(record.accelerometer, None)
    gyroscope = _sensor(record.gyroscope, _age(getattr(record.gyroscope, "zeroed_at", None), now))
    accelerometer = _at_present(record, Sensor.ACCELEROMETER, accelerometer, daemon, warmth)
    if accelerometer is not None and view.degraded and view.trouble is not None:
        accelerometer = _widened(accelerometer, np.full(3, view.trouble.size))
    gyroscope = _at_present(record, Sensor.GYROSCOPE, gyroscope, daemon, warmth)
    if gyroscope is not None and record.provisional:
        gyroscope = dataclasses.replace(gyroscope, provisional=True)
    return api.Calibration(
        id=identity(record),
        how=record.acceptance.how,
        reason=record.acceptance.reason,
        confidence=_confidence(record, view),
        stored=current is not None and identity(current) == identity(record),
        gravity=None if gravity is None else gravity.value,
        gravity_uncertainty=None if gravity is None else gravity.uncertainty,
        fitted_at_s=record.fitted_at,
        age_s=_age(record.fitted_at, now),
        checked_age_s=_age(view.checked, now),
        temperature_min_c=validity.temperature_min,
        temperature_max_c=validity.temperature_max,
        temperature_c=warmth.celsius,
        temperature_age_s=warmth.age_s,
        accelerometer=accelerometer,
        gyroscope=gyroscope,
    )


def _at_present(
    record: CalibrationRecord,
    sensor: Sensor,
    part: api.SensorCalibration | None,
    daemon: Daemon,
    warmth: _Warmth,
) -> api.SensorCalibration | None:
    """Add a sensor's bias now at a temperature, and what was learnt of its temperature and wander."""
    if part is None:
        return None
    now, celsius = daemon.now, warmth.celsius
    at, late = None if celsius is None else np.array([celsius]), _lagged(daemon, celsius)
    charged = None if now is None else daemon.view.charger.at(now)
    drivers = Drivers(celsius=at, lagged=late, charged=charged)
    bias = np.array(part.bias) + np.ravel(offsets(record, sensor, drivers))
    forecast, step = record.forecast.get(str(sensor)), daemon.view.suspected.get(sensor)
    told = dataclasses.replace(
        part,
        bias_now=_finite(bias),
        bias_uncertainty_now=_finite(
            record.bias_uncertainty_at(sensor, now, celsius, late, charged, stray_k=warmth.stray_k)
        ),
        follows_temperature=any(
            t.effect.endswith("_temperature") and t.sensor == sensor for t in record.terms
        ),
        follows_charging=any(follows_charger(t) and t.sensor == sensor for t in record.terms),
    )
    typical = bias + (STANDARD / np.sqrt(3.0) if sensor is Sensor.ACCELEROMETER else 0.0)
    by_terms = terms_uncertainty(record, sensor, dataclasses.replace(drivers, raw=typical[None]))
    told = _widened(told, np.ravel(by_terms))
    if step is not None:
        told = _widened(told, step.uncertainty)
    if forecast is None:
        return told
    return dataclasses.replace(
        told,
        learnt_min_c=forecast.temperature_min,
        learnt_max_c=forecast.temperature_max,
        lag_s=forecast.lag_s,
        wander_per_day=float(np.sqrt(forecast.wander.growth(DAY_S))),
    )


@dataclasses.dataclass(frozen=True, slots=True)
class _Warmth:
    """A temperature, degC, that an answer is for, None where unknown.

    age_s: s, of the reading that it is, None where the caller told it. stray_k: K, its standard uncertainty
    for that age.
    """

    celsius: float | None = None
    age_s: float | None = None
    stray_k: float = 0.0


def _warmth(daemon: Daemon, told_c: float | None) -> _Warmth:
    """Return the temperature that the caller told, degC, else that of the thermometer's latest reading."""
    if told_c is not None or daemon.now is None:
        return _Warmth(told_c)
    reading = daemon.view.thermometer.latest(daemon.now)
    return _Warmth() if reading is None else _Warmth(reading.celsius, reading.age_s, reading.stray_k)


def _lagged(daemon: Daemon, temperature_c: float | None) -> Array | None:
    """Return the temperatures now of sensors that follow the thermometer late, (k,), None where unknown."""
    if temperature_c is None or daemon.now is None:
        return None
    return daemon.view.thermometer.lagged(daemon.now, temperature_c)


def _widened(part: api.SensorCalibration, sizes: Array) -> api.SensorCalibration:
    """Return a sensor's answer with its present uncertainty larger by so much on each axis (3,)."""
    if part.bias_uncertainty_now is None:
        return part
    widened = np.hypot(part.bias_uncertainty_now, sizes)
    return dataclasses.replace(part, bias_uncertainty_now=widened.tolist())


def corrected(
    daemon: Daemon,
    sensor: Sensor,
    raw: Array,
    temperature_c: float | None,
    force: list[list[float]] | None,
) -> Array:
    """Correct raw readings (n, 3) by the current calibration. A term applies where its quantity is given.

    Raises NotCalibratedError, and ValueError where `force` does not go with the readings.
    """
    record = daemon.view.record
    assert record is not None
    forces = None if force is None else np.array(force, dtype=np.float64).reshape(-1, 3)
    if forces is not None and forces.shape != raw.shape:
        raise ValueError(f"force has {len(forces)} rows, the samples have {len(raw)}")
    temperatures = None if temperature_c is None else np.full(len(raw), temperature_c)
    charged = None if daemon.now is None else daemon.view.charger.at(daemon.now)
    at = Drivers(
        celsius=temperatures,
        lagged=_lagged(daemon, temperature_c),
        charged=charged,
        force=forces,
        raw=raw,
    )
    offset = offsets(record, sensor, at)
    return record.apply(raw - offset, sensor)


def status(daemon: Daemon) -> api.Status:
    """Return the daemon's status."""
    view, clock, source, now = daemon.view, daemon.saved.clock, daemon.source, daemon.now
    return api.Status(
        version=__version__,
        uptime_s=daemon.uptime_s,
        connected=source.connected,
        device=source.device,
        phone=daemon.saved.device,
        watch=str(view.watch),
        sensing=isinstance(view.want, Sense),
        degraded=view.degraded,
        rests_held=view.rests_held,
        refusal=view.refusal.reason if view.refusal else "",
        missing=list(view.refusal.missing) if view.refusal else [],
        trouble=daemon.trouble,
        failed_checks=view.trouble.failed if view.trouble else 0,
        diagnosis=view.diagnosis,
        store=daemon.store_name,
        restarts=clock.restarts,
        leaps=clock.leaps,
        disordered_samples=clock.disordered,
        counts=api.Counts(**_named(view.counters, api.Counts)),
        wire=_wire(source),
        calibration=None if view.record is None else identity(view.record),
        charging=view.charging,
        time_s=now,
        decides_in_s=None if now is None or math.isinf(view.decides) else max(view.decides - now, 0.0),
        gravity=view.gravity.value,
        seed=daemon.seed,
        sensor_faults=[failure(sensor, fault) for sensor, fault in view.faults.items()],
    )


def history(document: StoreDocument, limit: int) -> list[api.Entry]:
    """Return the current calibration and at most `limit` others, newest first."""
    current = document.current
    entries = [_entry(e.calibration, e.what, e.reason, e.at) for e in _newest(document.history, limit)]
    if current is None:
        return entries
    return [_entry(current, "current", current.acceptance.reason, current.fitted_at), *entries]


def stillness(daemon: Daemon, limit: int) -> api.Stillness:
    """Return the newest rests held, newest first."""
    view, now = daemon.view, daemon.now
    held = view.pool.held[::-1][:limit]
    residuals = _residuals(held, view.record)
    windows = view.ledger.windows
    return api.Stillness(
        windows=sum(windows.values()),
        windows_still=windows.get(Label.STILL, 0),
        rests_held=view.rests_held,
        rests=[_rest(h, residual, now) for h, residual in zip(held, residuals, strict=True)],
    )


def energy(days: list[Day], limit: int) -> list[api.EnergyDay]:
    """Return the accounts of the newest days, oldest first."""
    names = [field.name for field in dataclasses.fields(api.EnergyDay)]
    return [
        api.EnergyDay(*(getattr(day, name) for name in names)) for day in days[max(len(days) - limit, 0) :]
    ]


def findings(daemon: Daemon) -> api.Findings:
    """Return the newest self-diagnosis, and what became of each finding."""
    report, view = daemon.saved.night, daemon.view
    read = report.read()
    outcomes = [outcome(finding, view, daemon.document, daemon.now) for finding in read]
    return api.Findings(
        at_s=report.at,
        age_s=_age(report.at, daemon.now),
        rests=report.rests,
        verdict=report.verdict,
        trouble=report.trouble,
        findings=[
            api.Finding(
                effect=finding["effect"],
                sensor=finding["sensor"],
                axes=finding["axes"],
                statement=finding["statement"],
                probability=finding["probability"],
                size=finding.get("size", ""),
                handled=became.handled,
                outcome=became.words,
                json=text,
            )
            for finding, became, text in zip(read, outcomes, report.findings, strict=True)
        ],
        processor_s=report.processor_s,
        memory_bytes=report.memory_bytes,
    )


def faces(daemon: Daemon) -> api.Faces:
    """Return how far the six faces have come."""
    laid = daemon.view.faces
    if laid is None:
        return api.Faces("none", 0, [], "")
    lost = laid.stage is Stage.LAYING and not daemon.source.connected
    note = "waiting for the phone to connect" if lost else laid.note
    return api.Faces(laid.stage.value, len(laid.done), list(laid.missing), note)


def event(notification: Notification, daemon: Daemon) -> api.Event:
    """Return a notification as an event."""
    return api.Event(
        notification.what, notification.reason, notification.t, calibration(notification.record, daemon)
    )


def standing(daemon: Daemon) -> api.Event:
    """Return the first event of a subscription: the present state."""
    record = daemon.view.record
    held = None if record is None else calibration(record, daemon)
    return api.Event("current", held.reason if held else "no calibration yet", daemon.now, held)


def _residuals(held: Sequence[HeldRest], record: CalibrationRecord | None) -> Sequence[float | None]:
    """Return by how much the calibrated force of each rest is longer than gravity, m/s^2; None without."""
    if record is None or record.accelerometer is None or not held:
        return [None] * len(held)
    forces = np.array([h.rest.specific_force for h in held])
    norms = np.linalg.norm(record.accelerometer.model.apply(forces), axis=1)
    residuals: list[float | None] = (norms - [h.gravity.value for h in held]).tolist()
    return residuals


def _rest(held: HeldRest, residual: float | None, now: float | None) -> api.Rest:
    rest = held.rest
    return api.Rest(
        t_start_s=rest.t_start,
        t_end_s=rest.t_end,
        force=rest.specific_force.tolist(),
        age_s=_age(rest.t_end, now),
        residual=residual,
        temperature_c=rest.temperature,
    )


def _confidence(record: CalibrationRecord, view: View) -> api.Confidence:
    if view.degraded:
        return "failing"
    if record.accelerometer is None:
        return "unchecked" if record.provisional else "confirmed"
    since_fit = view.checked is not None and view.checked > (record.fitted_at or -math.inf)
    return "confirmed" if since_fit else "unchecked"


def _sensor(part: SensorRecord | None, zeroed_age_s: float | None) -> api.SensorCalibration | None:
    if part is None:
        return None
    return api.SensorCalibration(
        scale=part.scale.tolist(),
        bias=part.bias.tolist(),
        unit=str(getattr(part, "unit", "")),
        parameters=part.parameters,
        n_rests=part.n_rests,
        n_states=part.n_states,
        bias_uncertainty=_finite(part.bias_uncertainty),
        rms_residual=part.rms_residual,
        zeroed_age_s=zeroed_age_s,
        most_helpful_attitude=getattr(part, "most_helpful_attitude", None),
        with_prior=getattr(part, "with_prior", False),
        slow_rotation_deg_per_h=None if not isinstance(part, GyroscopeRecord) else _slow_rotation(part),
    )


def _slow_rotation(part: GyroscopeRecord) -> list[float] | None:
    """Return a gyroscope's bound on undetected rotation in degrees per hour; None where it has none."""
    bound = part.rotation_admitted
    return None if bound is None else _finite(np.degrees(bound) * 3600.0)


def _finite(values: Array | None) -> list[float] | None:
    known = values is not None and bool(np.isfinite(values).all())
    return values.tolist() if known and values is not None else None


def _age(t: float | None, now: float | None) -> float | None:
    return None if t is None or now is None else max(now - t, 0.0)


def _newest(entries: tuple[HistoryEntry, ...], limit: int) -> list[HistoryEntry]:
    return list(reversed(entries[-limit:])) if limit > 0 else []


def _entry(record: CalibrationRecord, what: str, reason: str, at: float | None) -> api.Entry:
    part = record.accelerometer
    return api.Entry(
        id=identity(record),
        what=what,
        reason=reason,
        at_s=at,
        rms_residual=None if part is None else part.rms_residual,
        n_states=None if part is None else part.n_states,
    )


def _wire(source: Source) -> api.Wire:
    return api.Wire(**_named(source.wire, api.Wire) | _named(source.link, api.Wire))


def _named(counters: Any, kind: type) -> dict[str, Any]:
    """Return those of the counters that `kind` has a field for."""
    wanted = {f.name for f in dataclasses.fields(kind)}
    return {f.name: getattr(counters, f.name) for f in dataclasses.fields(counters) if f.name in wanted}
