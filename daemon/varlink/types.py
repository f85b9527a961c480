"""The records of the socket's answers. Field names carry their unit; sensors are SI.

The interface's description is made from these annotations, so this module must not postpone their
evaluation, and it names only what varlink has: no `from __future__ import annotations`, no arrays.
"""

from dataclasses import dataclass
from typing import Literal, TypedDict

from stillcal.daemon.service.finding_outcomes import Handled

SensorName = Literal["accelerometer", "gyroscope"]
Confidence = Literal["unchecked", "confirmed", "failing"]
Stage = Literal["none", "laying", "calibrated", "given_up", "stopped"]


@dataclass(frozen=True)
class SensorCalibration:
    """One sensor: calibrated = scale @ (raw - bias). unit: of bias and its uncertainty (1 sd).

    rms_residual: m/s^2 of rests' norms, or rad of turns. zeroed_age_s: since the bias was measured alone.
    most_helpful_attitude: how to lay the phone so that the accelerometer's would gain most. provisional: the
    bias was measured right after the start, and no later rest has confirmed it. slow_rotation_deg_per_h:
    of the gyroscope, per axis, how large a bias error slow rotation in the rests may have caused unseen, by
    all rests held; not part of bias_uncertainty and bias_uncertainty_now (1 deg/h is 4.85e-6 rad/s); absent
    where nothing bounds it. bias_now, bias_uncertainty_now (1 sd): at the calibration's temperature_c,
    at this moment, by what was learnt of temperature and of the wander of this phone's bias; where no
    temperature is known the uncertainty is larger. learnt_min_c, learnt_max_c: the span of temperatures
    learnt from; beyond it the uncertainty grows. follows_temperature: whether a term for temperature is in
    use. follows_charging: the same for the heat of charging, which stands in where there is no
    thermometer. lag_s: how late the sensor follows the thermometer, or the charger. wander_per_day:
    standard deviation by which the bias changes within a day at one temperature. with_prior: the
    attitudes do not show all parameters yet, and what is known of sound phones stands in for the rest.
    """

    scale: list[list[float]]
    bias: list[float]
    unit: str
    parameters: int
    n_rests: int
    n_states: int
    bias_uncertainty: list[float] | None = None
    rms_residual: float | None = None
    zeroed_age_s: float | None = None
    most_helpful_attitude: str | None = None
    provisional: bool = False
    slow_rotation_deg_per_h: list[float] | None = None
    bias_now: list[float] | None = None
    bias_uncertainty_now: list[float] | None = None
    learnt_min_c: float | None = None
    learnt_max_c: float | None = None
    follows_temperature: bool = False
    follows_charging: bool = False
    lag_s: float | None = None
    wander_per_day: float | None = None
    with_prior: bool = False


@dataclass(frozen=True)
class Calibration:
    """The current calibration. Times in s of the sensors' own clock; ages in s of the same.

    checked_age_s: since it was last checked or fitted.
    confidence: unchecked (no check since it was fitted), confirmed (passed its last check), failing.
    temperature_min_c, temperature_max_c: where it was measured; outside it is extrapolation. temperature_c:
    that bias_now is for, as asked for or else as the thermometer last read it, temperature_age_s ago; absent
    where its last reading is older than ten minutes.
    """

    id: str
    how: str
    reason: str
    confidence: Confidence
    stored: bool
    gravity: float | None = None
    gravity_uncertainty: float | None = None
    fitted_at_s: float | None = None
    age_s: float | None = None
    checked_age_s: float | None = None
    temperature_min_c: float | None = None
    temperature_max_c: float | None = None
    temperature_c: float | None = None
    temperature_age_s: float | None = None
    accelerometer: SensorCalibration | None = None
    gyroscope: SensorCalibration | None = None


class Corrected(TypedDict):
    """Corrected samples. delay_s: how late they come because they were smoothed, where they were."""

    samples: list[list[float]]
    delay_s: float | None


@dataclass(frozen=True)
class Entry:
    """A calibration of the history, newest first. what: current, replaced, rejected or rolled_back."""

    id: str
    what: str
    reason: str
    at_s: float | None = None
    rms_residual: float | None = None
    n_states: int | None = None


@dataclass(frozen=True)
class Wire:
    """Counts of the phone's line since the daemon started."""

    connections: int
    disconnections: int
    bytes: int
    samples: int
    lost_samples: int
    bad_frames: int
    bad_lines: int
    resynchronisations: int
    invalid_samples: int
    commands_sent: int


@dataclass(frozen=True)
class Counts:
    """Counts since the engine first started. turns: between rests, usable for the gyroscope's scale.

    undersampled: turns too fast for the gyroscope's sampling rate.
    """

    rests: int
    turns: int
    calibrations: int
    rejected: int
    refused: int
    checks: int
    zeroings: int
    degradations: int
    undersampled: int = 0


@dataclass(frozen=True)
class Status:
    """The daemon's status. watch: how the sensors are sampled (continuous, probing, idle).

    sensing: whether they are wanted on now; decides_in_s: until the engine decides anew. trouble: why the
    last write to the disk failed, empty where it did not. missing: what a refused calibration still needs.
    failed_checks: in a row, after a calibration was tried anew. diagnosis: why somebody should look for
    what the model leaves out, empty where there is no cause. seed: of the random pauses between probes; a
    replay with it in its settings has the same pauses. sensor_faults: what is wrong with a sensor, a sentence
    each, by the newest hourly check.
    """

    version: str
    uptime_s: float
    connected: bool
    device: str
    phone: str
    watch: str
    sensing: bool
    degraded: bool
    rests_held: int
    refusal: str
    missing: list[str]
    trouble: str
    failed_checks: int
    diagnosis: str
    sensor_faults: list[str]
    store: str
    restarts: int
    leaps: int
    disordered_samples: int
    counts: Counts
    wire: Wire
    calibration: str | None = None
    charging: bool | None = None
    time_s: float | None = None
    decides_in_s: float | None = None
    gravity: float | None = None
    seed: int = 0


@dataclass(frozen=True)
class Rest:
    """A rest of the phone. force: its raw mean, m/s^2.

    age_s: since its end. residual: norm of the corrected force less gravity, m/s^2, where there is a
    calibration.
    """

    t_start_s: float
    t_end_s: float
    force: list[float]
    age_s: float | None = None
    residual: float | None = None
    temperature_c: float | None = None


@dataclass(frozen=True)
class Stillness:
    """Rests held, the last ones newest first. windows, windows_still: looked at since the engine began."""

    windows: int
    windows_still: int
    rests_held: int
    rests: list[Rest]


@dataclass(frozen=True)
class EnergyDay:
    """The cost of one day (86400 s of sensor time from the first sample on; number from 0).

    sensors_on_s, wakeups: as the phone tells, of the first no more than the time that passed meanwhile;
    asked_s: what the engine asked for. cpu_s: of the daemon.
    """

    number: int
    observed_s: float
    sensors_on_s: float
    asked_s: float
    samples: int
    wakeups: int
    cpu_s: float


@dataclass(frozen=True)
class Finding:
    """What the newest self-diagnosis found of a sensor beyond constant bias and scale.

    handled: corrected (a term of the calibration takes it off), on_trial (a term is tested on the rests
    since) or reported (the calibration does not describe it). outcome: the same in words, with the reason.
    size: the parameters as the statement has them. probability: of the effect. json: the whole finding, as
    `stillcal diagnose --json` has it.
    """

    effect: str
    sensor: str
    axes: list[str]
    statement: str
    size: str
    handled: Handled
    outcome: str
    json: str
    probability: float | None = None


@dataclass(frozen=True)
class Findings:
    """The newest self-diagnosis of the rests kept. at_s: when, absent before the first; age_s: since then.

    rests: that it saw. verdict: match, identified, partly_identified, unidentified or not_judged. trouble:
    why the newest one has no result, empty where it has; verdict and findings are then of the one before.
    processor_s, memory_bytes: what it took.
    """

    rests: int
    verdict: str
    trouble: str
    findings: list[Finding]
    processor_s: float
    memory_bytes: int
    at_s: float | None = None
    age_s: float | None = None


@dataclass(frozen=True)
class Faces:
    """How far the six faces have come that LayFaces asked for.

    stage: none (never asked for), laying, calibrated, given_up (no further face for half an hour), stopped.
    done: how many of the six the phone has lain on. missing: how to lay it for the others, the next one
    first. note: what to know of the newest rest, why faces are asked for again, or how it ended.
    """

    stage: Stage
    done: int
    missing: list[str]
    note: str


@dataclass(frozen=True)
class Event:
    """A change of the calibration.

    what: current (the first event: the present state), calibrated, zeroed (the gyroscope's bias was measured
    anew), followed (the accelerometer's follows its newest rests), rejected, forgotten (the phone is
    another one) or rolled_back.
    """

    what: str
    reason: str
    at_s: float | None = None
    calibration: Calibration | None = None


@dataclass(frozen=True)
class Block:
    """A piece of a recording: samples of one sensor, or an event, or (first) what the phone claims to be.

    claims: JSON, by the names of a recording's NAME.json. samples: rows [t, x, y, z], s and m/s^2 or rad/s,
    raw. temperature_c: of each sample. t_s: of an event. charging: the charger was plugged in or unplugged.
    location: latitude, longitude, degrees, and altitude, m, where it is known.
    """

    claims: str | None = None
    sensor: SensorName | None = None
    samples: list[list[float]] | None = None
    temperature_c: list[float] | None = None
    t_s: float | None = None
    charging: bool | None = None
    location: list[float] | None = None


@dataclass(frozen=True)
class StreamBlock:
    """A piece of the live stream: corrected samples of one sensor, or a notice.

    notice: "begun" first of all; later, why samples before and after do not belong together (the phone was
    lost, or restarted). calibrated: whether the samples are corrected; without a calibration of their sensor
    they are raw. samples: rows [t, x, y, z], t in s of GetStatus's time_s, m/s^2 or rad/s, axes as
    on Android. host_s: CLOCK_BOOTTIME of this computer when they were read, s.
    """

    notice: str | None = None
    sensor: SensorName | None = None
    calibrated: bool | None = None
    host_s: float | None = None
    samples: list[list[float]] | None = None
