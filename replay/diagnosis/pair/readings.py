"""What recordings of one motion read, one less the other, and which are refused because theirs is another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.pair.alignment import Readings
from stillcal.calib_core.diagnosis.comparison.pair.delay import SURE, late
from stillcal.calib_core.diagnosis.comparison.pair.mounting import SHARED, shared_as_it_is
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.vibrations import shared_streams
from stillcal.calib_core.diagnosis.model.records import NAME
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams.resample import read_at, temperature_at
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.formats.trace import Recording

SAME_STAMP = 0.1
"""Part of the sample period by which two stamps of one moment may differ: rounding, and no more."""

SHIFTED = 0.02
"""s by which both sensors may be late alike: the narrowest filter of a phone's sensor delays by 19 ms
(MPU-6050, 5 Hz). More is a matter of stamps."""


def refuse_itself(recording: Recording, others: Sequence[Recording], *, simulated: bool = False) -> None:
    """Raise UserError where another recording holds the same samples: nothing is left between them.

    simulated: the others are simulations, of which a change of one sensor alone leaves the other's samples.
    """
    for other in others:
        same = [np.array_equal(b.xyz, a.xyz) for a, b in shared_streams(recording, other).values()]
        if all(same if simulated else same[:1]):
            raise UserError(
                f"{other.name}: holds the very samples of {recording.name}; give what another sensor, or a"
                " simulation, reads of the same motion"
            )


def refuse_other_stamps(recording: Recording, simulation: Recording) -> None:
    """Raise UserError where two recordings are not of the same moments, naming the first that differs."""
    for sensor, (own, other) in shared_streams(recording, simulation).items():
        n = min(len(own), len(other))
        apart = np.abs(own.t[:n] - other.t[:n]) > SAME_STAMP * float(np.median(np.diff(own.t)))
        if apart.any():
            i = int(np.argmax(apart))
            why = f"sample {i + 1} of the {NAME[sensor]} is stamped {other.t[i]:.6g} s, not {own.t[i]:.6g} s"
        elif len(own) != len(other):
            why = f"it has {len(other)} samples of the {NAME[sensor]}, not {len(own)}"
        else:
            continue
        raise UserError(
            f"{simulation.name}: {why} as in {recording.name}; --paired needs the same motion at the same"
            " stamps, leave it out for any other motion"
        )


def refuse_other_motion(recording: Recording, simulation: Recording) -> None:
    """Raise UserError where a simulation moves otherwise, by the rule for a witness on another body."""
    shared = shared_as_it_is(readings_of(recording), readings_of(simulation))
    if shared is not None and shared < SHARED:
        raise UserError(
            f"{simulation.name}: is of another motion than {recording.name}, late against it or in other"
            f" axes: it shares {max(shared, 0.0):.0%} of the motion, and at least {SHARED:.0%} is needed;"
            " leave --paired out for any other motion"
        )


def nearer(right: Recording, as_read: Recording, other: Recording) -> bool:
    """Whether what was put right of a recording reads the motion more as another recording does."""
    pairs = zip(*(shared_streams(one, other).values() for one in (right, as_read)), strict=True)
    return all(now is was or _apart(now, true) < _apart(was, true) for (now, true), (was, _) in pairs)


def _apart(own: Samples, other: Samples) -> float:
    return float(((own.xyz - other.xyz) ** 2).sum())


def refuse_shifted(recording: Recording, simulation: Recording) -> None:
    """Raise UserError where a simulation reads the motion by more earlier or later than filters delay.

    Low-passes that were found are on both: what these delay is not counted.
    """
    own, other = readings_of(recording), mean_readings(recording, [simulation])
    found = [late(own.force, other.force, "accel")]
    if own.rate is not None and other.rate is not None:
        found.append(late(own.rate, other.rate, "gyro"))
    delays = [one.delay for one in found if one is not None]
    alike = len(delays) == len(found) and abs(sum(np.sign(d.value) for d in delays)) == len(delays)
    if not alike or min(abs(d.value) - SURE * d.error for d in delays) < SHIFTED:
        return
    shift = float(np.mean([d.value for d in delays]))
    side = "earlier" if shift > 0.0 else "later"
    raise UserError(
        f"{simulation.name}: reads the motion {abs(shift) * 1e3:.0f} ms {side}"
        f" than {recording.name}; move its stamps by {shift * 1e3:+.0f} ms and interpolate it at those of"
        f" {recording.name}, or leave --paired out"
    )


def readings_of(recording: Recording) -> Readings:
    """Return what a recording's two sensors read."""
    return Readings(recording.accelerometer, recording.gyroscope)


def mean_readings(recording: Recording, others: Sequence[Recording]) -> Readings:
    """Return what the others read at the recording's stamps, on average."""
    force, rate = recording.accelerometer, recording.gyroscope
    rates = [o.gyroscope for o in others if o.gyroscope is not None]
    both = None if rate is None or not rates else _mean(rate, rates)
    return Readings(_mean(force, [o.accelerometer for o in others]), both)


def _mean(own: Samples, others: Sequence[Samples]) -> Samples:
    every = [read_at(o, own.t).xyz for o in others]
    return replace(own, xyz=frozen(np.mean(every, axis=0)))


def less(recording: Recording, true: Readings) -> Readings:
    """Return what the recording reads less what the others do, with the recording's own temperature."""
    force, rate = recording.accelerometer, recording.gyroscope
    warm = temperature_at(force, force.t)
    left = replace(
        force,
        xyz=frozen(force.xyz - true.force.xyz),
        temperature=None if warm is None else frozen(warm),
    )
    if rate is None or true.rate is None:
        return Readings(left, None)
    return Readings(left, replace(rate, xyz=frozen(rate.xyz - true.rate.xyz)))
