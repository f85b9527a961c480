"""Terms beyond the affine model, applied to readings and rests.

A term is kept as the name of its effect, parameters, and what these count from (corrections/term.py). What
the effect does to readings, its class says (corrections/catalogue.py).

calibrated = scale @ (raw - bias - offsets of the terms)
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.corrections.base import Correction, Drivers
from stillcal.calib_core.calibration.corrections.bias_temperature import BiasTemperature
from stillcal.calib_core.calibration.corrections.catalogue import CORRECTIONS
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING, ChargingHeat
from stillcal.calib_core.calibration.corrections.term import Term, lag_of
from stillcal.calib_core.calibration.record import CalibrationRecord, NotCalibratedError
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.samples import Samples, Sensor, warmed
from stillcal.calib_core.temperature.charger import Charger
from stillcal.calib_core.temperature.memory import Memory
from stillcal.calib_core.temperature.thermometer import Thermometer

NO_READINGS = Thermometer()
NO_CHARGER = Charger()

ROUNDS = 6
"""Times that a reading is corrected by what its own corrected value gives: an error of a part in ten is left
at a part in a million."""


def correct(
    record: CalibrationRecord,
    samples: Samples,
    force: Array | None = None,
    thermometer: Thermometer = NO_READINGS,
    charger: Charger = NO_CHARGER,
    *,
    started: float | None = None,
) -> Samples:
    """Correct a run of samples by the model and by those terms whose drivers are known.

    force: (n, 3) m/s^2, the calibrated specific force at these samples' times, or None. The temperature comes
    with the samples; thermometer: its readings before them. charger: its changes up to the last of them.
    started: s, when the sensors were switched on, None where unknown. Raises NotCalibratedError where the
    record has no part of their sensor.
    """
    celsius, lagged, charged = samples.temperature, None, None
    if any(term.sensor == samples.sensor for term in record.terms):
        charged = charger.course(samples.t)
        if celsius is not None:
            celsius = thermometer.believed(samples.t, celsius)
            late = any(lag_of(term) for term in record.terms)
            lagged = thermometer.course(samples.t, celsius) if late else None
    at = Drivers(
        celsius=celsius,
        lagged=lagged,
        charged=charged,
        force=force,
        age=None if started is None else samples.t - started,
        raw=samples.xyz,
    )
    offset = offsets(record, samples.sensor, at)
    return record.model(samples.sensor).correct(replace(samples, xyz=samples.xyz - offset))


def correct_both(
    record: CalibrationRecord,
    accelerometer: Samples,
    gyroscope: Samples | None,
    thermometer: Thermometer = NO_READINGS,
    charger: Charger = NO_CHARGER,
    *,
    started: float | None = None,
) -> tuple[Samples, Samples | None]:
    """Correct both sensors' samples; a sensor that the record holds nothing of stays as it is.

    The gyroscope's terms that follow force take it from the corrected accelerometer, interpolated to the
    gyroscope's times; those that follow temperature take the accelerometer's where it has none of its own.
    Further arguments as in `correct`.
    """
    accel = _corrected(record, accelerometer, None, thermometer, charger, started=started)
    if gyroscope is None:
        return accel, None
    force = interpolated(accel, gyroscope.t)
    gyro = _corrected(record, warmed(gyroscope, accelerometer), force, thermometer, charger, started=started)
    return accel, replace(gyro, temperature=gyroscope.temperature)


def _corrected(
    record: CalibrationRecord,
    samples: Samples,
    force: Array | None,
    thermometer: Thermometer,
    charger: Charger,
    *,
    started: float | None,
) -> Samples:
    try:
        return correct(record, samples, force, thermometer, charger, started=started)
    except NotCalibratedError:
        return samples


def _known(record: CalibrationRecord, sensor: Sensor) -> list[tuple[Correction, Term]]:
    """Return a sensor's terms that can be applied, each with its correction."""
    return [
        (CORRECTIONS[term.effect], term)
        for term in record.terms
        if term.sensor == sensor and term.effect in CORRECTIONS
    ]


def bias_terms(
    record: CalibrationRecord,
    sensor: Sensor,
    temperature: Array | None,
    force: Array | None = None,
    lagged: Array | None = None,
    *,
    charged: Array | None = None,
) -> Array:
    """Return what the terms add to the bias, (n, 3) in raw units, or (3,) zeros where no term applies.

    The arguments are drivers (corrections/base.py), None where unknown.
    """
    return offsets(record, sensor, Drivers(celsius=temperature, force=force, lagged=lagged, charged=charged))


def offsets(record: CalibrationRecord, sensor: Sensor, at: Drivers) -> Array:
    """Return what the terms add to the readings, (n, 3) in raw units, or (3,) zeros where no term applies.

    A term whose driver is unknown adds nothing. Terms that follow the reading itself are solved for, and add
    nothing where `at` has no raw readings: they are no part of the bias. Outside the temperatures that the
    calibration was measured at, a slope is extrapolated as a straight line.
    """
    known = _known(record, sensor)
    bias = _sum([pair for pair in known if not pair[0].of_reading], at)
    of_reading = [pair for pair in known if pair[0].of_reading]
    if not of_reading or at.raw is None:
        return bias
    reading = at.raw - _bias(record, sensor) - bias
    own = np.zeros(3)
    for _ in range(ROUNDS):
        own = _sum(of_reading, replace(at, reading=reading - own))
    return bias + own


def _sum(known: list[tuple[Correction, Term]], at: Drivers) -> Array:
    total = np.zeros(3)
    for correction, term in known:
        offset = correction.offset(term, at)
        if offset is not None:
            total = total + np.nan_to_num(offset)
    return total


def _bias(record: CalibrationRecord, sensor: Sensor) -> Array:
    try:
        return record.model(sensor).bias
    except NotCalibratedError:
        return np.zeros(3)


def terms_uncertainty(record: CalibrationRecord, sensor: Sensor, at: Drivers) -> Array:
    """Return the standard uncertainty, (n, 3) or (3,), that a sensor's terms leave in a reading.

    It is that of their parameters, and of a term whose driver is unknown that of the effect as a whole. A
    bias that was learnt has its forecast for this; such terms add nothing. A reading `at.raw` counts for
    terms that follow it.
    """
    reading = None if at.raw is None else at.raw - _bias(record, sensor)
    squares = np.zeros(3)
    for correction, term in _known(record, sensor):
        if not correction.has_forecast:
            squares = squares + correction.uncertainty(term, replace(at, reading=reading)) ** 2
    return np.sqrt(squares)


def polynomial(term: Term, temperature: Array) -> Array:
    """Return the bias of a term that is learnt, at a sensor's own temperatures (n,), degC: (n, 3).

    For a term that follows the charger they are the readings (n,) K that it stands in for (charger.py). Zero
    where they are unknown.
    """
    if term.effect == BY_CHARGING:
        return ChargingHeat.of_heat(term, temperature)
    return BiasTemperature.of_temperature(term, temperature)


def compensated(pool: Pool, record: CalibrationRecord, started: float | None = None) -> Pool:
    """Return a pool whose rests have a record's terms taken off their means.

    The bias of the rests is then that at the terms' reference temperature and without force. Rests of unknown
    temperature keep what depends on it. Turns keep what depends on temperature and force, for their fit takes
    that from the rests around them; terms that follow the rate itself are taken off. started: s, when the
    sensors were switched on, None where unknown.
    """
    if not record.terms:
        return pool
    held = tuple(replace(h, rest=_compensated(h.rest, record, started)) for h in pool.held)
    return Pool(held, tuple(_compensated_turn(turn, record) for turn in pool.turns))


def _compensated(rest: RestState, record: CalibrationRecord, started: float | None) -> RestState:
    at = Drivers(
        celsius=None if rest.temperature is None else np.array([rest.temperature]),
        lagged=rest.lagged,
        charged=None if rest.charged is None else rest.charged[None],
        age=None if started is None else np.array([0.5 * (rest.t_start + rest.t_end) - started]),
        raw=rest.specific_force[None],
    )
    force = rest.specific_force - np.ravel(offsets(record, Sensor.ACCELEROMETER, at))
    if rest.rate is None:
        return msgspec.structs.replace(rest, specific_force=frozen(force))
    by_force = replace(at, force=_calibrated(record, force[None]), raw=rest.rate[None])
    rate = rest.rate - np.ravel(offsets(record, Sensor.GYROSCOPE, by_force))
    return msgspec.structs.replace(rest, specific_force=frozen(force), rate=frozen(rate))


def _compensated_turn(turn: RotationSegment, record: CalibrationRecord) -> RotationSegment:
    """Return a turn without what follows the rate itself."""
    if not any(correction.of_reading for correction, _ in _known(record, Sensor.GYROSCOPE)):
        return turn
    temperatures = [r.temperature for r in (turn.before, turn.after) if r.temperature is not None]
    celsius = np.full(len(turn.t), np.mean(temperatures)) if temperatures else None
    rows = Drivers(celsius=celsius)
    bias = offsets(record, Sensor.GYROSCOPE, rows)
    offset = offsets(record, Sensor.GYROSCOPE, replace(rows, raw=turn.rates))
    return replace(turn, rates=frozen(turn.rates - (offset - bias)))


def _calibrated(record: CalibrationRecord, raw: Array) -> Array:
    """Return specific forces (n, 3), calibrated where the accelerometer is."""
    part = record.accelerometer
    return raw if part is None else part.model.apply(raw)


def drivers_at(record: CalibrationRecord, sensor: Sensor, memory: Memory) -> Drivers:
    """Return what a sensor's terms follow at the rests that are kept for learning."""
    force = sensor is Sensor.ACCELEROMETER
    return Drivers(
        celsius=memory.celsius,
        lagged=memory.lagged,
        charged=memory.charged,
        force=None if force else _calibrated(record, memory.force),
        raw=memory.force if force else memory.rate,
    )


def interpolated(samples: Samples, t: Array) -> Array | None:
    """Interpolate readings linearly at times t (n,), s: (n, 3), or None where there are no samples."""
    if not len(samples):
        return None
    return np.column_stack([np.interp(t, samples.t, samples.xyz[:, axis]) for axis in range(3)])
