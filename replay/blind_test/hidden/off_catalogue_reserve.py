"""Ten more effects outside the catalogue, kept in reserve: drawn only with `--reserve`.

They are for the last proof, after the last change of the diagnosis, and are scored apart from the others.
"""

from __future__ import annotations

import math

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.hidden.kind import (
    Altered,
    HiddenKind,
    one_axis,
    samples_of,
    signed,
    since_move,
    whole,
    with_values,
)
from stillcal.replay.blind_test.hidden.off_catalogue import NOISE, REFERENCE_C, with_stamps
from stillcal.replay.blind_test.power.sizing import Stage
from stillcal.replay.blind_test.world.noise import log_uniform
from stillcal.replay.blind_test.world.phones import MadeRecording


def _warm_g_sensitivity(stage: Stage) -> Array:
    """Return a g-sensitivity that grows with temperature and is nothing at 25 degC.

    It stems from unequal suspension, which softens as silicon does, by 60 to 70 ppm/K of Young's modulus
    (Hopcroft, Nix and Kenny 2010, J. Microelectromech. Syst. 19, 229), and from stress, which is thermal.
    """
    matrix = stage.rng.standard_normal((3, 3)) * (stage.rng.random((3, 3)) < 0.5)
    matrix[one_axis(stage), one_axis(stage)] = 1.0
    return np.asarray((stage.world.temperature - REFERENCE_C)[:, None] * (stage.world.force @ matrix.T))


def _drive_beat(stage: Stage) -> Array:
    """Return the beat of two gyroscopes' drives, whose pitch follows how the phone warms.

    Two resonators a few hertz apart leak into each other's demodulator; the difference of their frequencies
    goes with temperature, at tens of ppm/K of some 20 kHz each, so the beat sweeps and never repeats.
    """
    slowest = 1.0 / stage.rng.uniform(60.0, 240.0)
    pitch = slowest * (1.0 + signed(stage, 0.3, 1.0) * (stage.world.temperature - REFERENCE_C) / 4.0)
    step = float(stage.world.t[1] - stage.world.t[0])
    phase = 2.0 * math.pi * (np.cumsum(pitch) * step + stage.rng.random())
    return np.asarray(np.sin(phase)[:, None] * stage.direction())


def _range_held(stage: Stage) -> Array:
    """Return an offset during the first 25 to 45 s after each move, and none from then on.

    A driver that widens the range while the phone is handled and returns to the narrow one after a while:
    each range of a part has an offset of its own.
    """
    inside = since_move(stage) < stage.rng.uniform(25.0, 45.0)
    return np.asarray(inside[:, None] * stage.direction())


def _reference_noise(stage: Stage) -> Array:
    """Return noise in proportion to the force on each axis: that of the converter's reference voltage.

    The reference multiplies the signal. On the axis that carries gravity it is once or twice as large as the
    sensor's own noise, on a level one it is nothing, whichever axis that is.
    """
    share = stage.sigma("accel") / 9.8 * stage.rng.uniform(1.0, 2.0)
    return np.asarray(share * stage.world.force * stage.rng.standard_normal((stage.world.t.size, 1)))


def _idle_tones(stage: Stage) -> Array:
    """Return tones whose pitch goes with the value that each axis measures, so each rest has its own.

    Idle tones of a sigma-delta converter: a constant input x comes out as a pattern that repeats in
    proportion to x (Gray 1990, IEEE Trans. Inf. Theory 36, 1220), folded by the output rate.
    """
    phase = 2.0 * math.pi * stage.rng.uniform(0.3, 0.9) * np.cumsum(stage.world.force, axis=0)
    return np.asarray(stage.sigma("accel") * stage.rng.uniform(0.3, 0.8) * np.sin(phase))


def _self_tests(recording: MadeRecording, stage: Stage) -> Altered:
    """Deflect one axis by 0.5 to 5 m/s^2 for 0.2 to 0.5 s, every one to three minutes.

    The electrostatic self-test, left on a timer: ST's sheet of the LSM6DSO gives 50 to 1700 mg for it.
    """
    samples = samples_of(recording, "accel")
    period, length = stage.rng.uniform(60.0, 180.0), stage.rng.uniform(0.2, 0.5)
    on = np.mod(samples.t + stage.rng.uniform(0.0, period), period) < length
    values = samples.xyz.copy()
    step = stage.phone.accel.lsb
    values[on, one_axis(stage)] += round(signed(stage, 0.5, 5.0) / step) * step
    return Altered(with_values(recording, "accel", values), *whole(recording))


def _stale_blocks(recording: MadeRecording, stage: Stage) -> Altered:
    """Deliver a block of 16 to 32 samples once more in the place of the next, in 3 to 10 % of the blocks.

    A ring buffer that is read before direct memory access has filled it again holds what was there before.
    """
    samples = samples_of(recording, "gyro")
    size = int(stage.rng.choice([16, 32]))
    values = samples.xyz.copy()
    blocks = np.arange(1, len(samples) // size)
    for block in blocks[stage.rng.random(blocks.size) < stage.rng.uniform(0.03, 0.1)]:
        values[block * size : (block + 1) * size] = values[(block - 1) * size : block * size]
    return Altered(with_values(recording, "gyro", values), *whole(recording))


def _clock_set(recording: MadeRecording, stage: Stage) -> Altered:
    """Set the clock of the stamps forward by 0.15 to 0.6 s, three to eight times; no sample is lost.

    Stamps by the wall clock, which the network's time corrects; Android offers the time since boot instead.
    """
    t = recording.accelerometer.t
    moments = np.sort(stage.rng.uniform(0.05, 0.95, int(stage.rng.integers(3, 9)))) * t[-1]
    leaps = np.cumsum(np.append(0.0, stage.rng.uniform(0.15, 0.6, moments.size)))
    return Altered(with_stamps(recording, t + leaps[np.searchsorted(moments, t)]), *whole(recording))


def _folded(recording: MadeRecording, stage: Stage) -> Altered:
    """Wrap readings beyond the range to its other end, where they should stop there.

    Two's complement that overflows: an offset is added to 16 bits without saturation. The range is what a
    few of the shakes between rests surpass.
    """
    samples = samples_of(recording, "accel")
    peaks = np.sort(np.abs(samples.xyz).ravel())
    limit = max(float(peaks[-int(stage.rng.integers(30, 200))]), 12.0)
    values = np.mod(samples.xyz + limit, 2.0 * limit) - limit
    return Altered(with_values(recording, "accel", values), *whole(recording))


def _low_power(recording: MadeRecording, stage: Stage) -> Altered:
    """Add noise as large as the sensor's own or larger for minutes at a time, and none between.

    Low-power modes of accelerometers save current by averaging fewer conversions into a sample (Bosch's BMA
    and ST's LIS2 sheets state a density for each mode), and the hub switches them.
    """
    samples = samples_of(recording, "accel")
    edges = np.cumsum(stage.rng.uniform(60.0, 240.0, int(samples.t[-1] / 60.0) + 2))
    low = np.searchsorted(edges, samples.t) % 2 == 1
    noise = stage.sigma("accel") * log_uniform(stage.rng, 1.0, 2.5)
    step = stage.phone.accel.lsb
    extra = np.round(noise * stage.rng.standard_normal(samples.xyz.shape) / step) * step
    values = np.where(low[:, None], samples.xyz + extra, samples.xyz)
    return Altered(with_values(recording, "accel", values), *whole(recording))


RESERVE: dict[str, HiddenKind] = {
    "warm_g_sensitivity": HiddenKind("gyro", _warm_g_sensitivity, sized=True, thermometer=True),
    "drive_beat": HiddenKind("gyro", _drive_beat, sized=True),
    "range_held": HiddenKind("accel", _range_held, sized=True),
    "reference_noise": HiddenKind("accel", _reference_noise, entailed=NOISE),
    "idle_tones": HiddenKind("accel", _idle_tones, entailed=("noise_level",)),
    "self_tests": HiddenKind("accel", altered=_self_tests, entailed=("noise_heavy_tailed",)),
    "stale_blocks": HiddenKind("gyro", altered=_stale_blocks),
    "clock_set": HiddenKind("timing", altered=_clock_set, entailed=("clock_skew",)),
    "folded_readings": HiddenKind("accel", altered=_folded, vivid=True),
    "low_power_mode": HiddenKind("accel", altered=_low_power, entailed=NOISE),
}
"""Effects in reserve by name; only keys use these names."""
