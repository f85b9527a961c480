"""White noise at rest: its density against what is claimed, and one axis' against another's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import of_means
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Measured,
    direct_finding,
    mean_of,
    of_measured,
    vector,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Claims, Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import SoundPhones, Usual, usual
from stillcal.calib_core.diagnosis.noise.low_pass import SHARED, Quiet, Spectra, judged
from stillcal.calib_core.maths.robust import MAD_TO_SD

LINE = 1.5
USABLE = 0.3
WHITE = 0.5
UNSTEADY = 2.0
FLOOR = 3e-3
SPREAD = 3.0
SUPPRESSED = 0.8
TWO_SIDED = float(np.sqrt(2.0))

OF_MEDIAN = float(1.0 / np.log(2.0))
"""Relative sd of the median of n exponential numbers, as the power at a frequency is, times sqrt(n)."""


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """White noise by axis. density: three numbers, unit/sqrt(Hz); pieces: (P, 3) the same by piece.

    white: whether most of the band is flat. steady: whether rests differ no more than chance would have it.
    least: the lowest density (3,) in the band. loud: whether it is louder than any sensor's noise.
    """

    density: tuple[Measured, Measured, Measured]
    pieces: Array
    white: bool
    steady: bool
    least: Array
    loud: bool = False

    @property
    def alike(self) -> bool:
        """Whether it is noise that all rests have: white, and as strong in each."""
        return self.white and self.steady

    @property
    def own(self) -> bool:
        """Whether it is the sensor's own: such noise, and no louder than sensors have it."""
        return self.alike and not self.loud

    def less(self, shared: float) -> Levels:
        """Return what is each axis' own where axes share a part of the noise's power, 0 to 1."""
        part = float(np.sqrt(1.0 - shared))
        x, y, z = (Measured(part * d.value, part * d.error) for d in self.density)
        return replace(self, density=(x, y, z), pieces=part * self.pieces, least=part * self.least)

    def values(self) -> Array:
        """Return the densities (3,)."""
        return np.array([d.value for d in self.density])

    def errors(self) -> Array:
        """Return their relative standard errors (3,)."""
        return np.array([d.error / max(d.value, 1e-300) for d in self.density])


def level_part(spectrum: Spectra) -> tuple[Array, NDArray[np.bool_], bool]:
    """Return the power (P, F, 3) before a low-pass, where (F,) it is level, and whether it is white.

    Lines and slow wander are left out; all of the band is taken where they are most of it. Few rests show
    it only of several frequencies together.
    """
    shape = spectrum.shape()
    flat = spectrum.power / shape[None]
    band = spectrum.band & (shape > USABLE).all(axis=1)
    typical = np.median(flat, axis=0)
    for seen in (typical, _smooth(typical, band, float(spectrum.averages.sum()))):
        level = np.median(seen[band], axis=0)
        clean = band & (seen < LINE * level).all(axis=1) & (seen > level / LINE).all(axis=1)
        if clean.sum() >= WHITE * band.sum():
            return flat, clean, True
    return flat, band, False


def _smooth(power: Array, band: NDArray[np.bool_], averages: float) -> Array:
    """Return power (F, 3), in the band of so many neighbours that chance stays below a third of `LINE`.

    averages: how many the power at one frequency has. Few rests scatter it by more than a line stands out.
    Over more than half of the band any noise would be alike.
    """
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    scatter = OF_MEDIAN / np.sqrt(averages)
    wanted = int(np.ceil(SHARED * (3.0 * scatter / np.log(LINE)) ** 2))
    count = min(wanted, int(band.sum()) // 2)
    if count <= SHARED:
        return power
    smooth = power.copy()
    smooth[band] = uniform_filter1d(power[band], count, axis=0)
    return smooth


def levels(spectrum: Spectra, floor: float = 0.0) -> Levels:
    """Measure densities where the spectrum is white, lines and slow wander left out.

    floor: density^2 of the steps' own noise, taken off. Where rests differ more than chance would have it
    (people walk by, a road), the quietest tenth of them tells the sensor's own noise.
    """
    flat, used, white = level_part(spectrum)
    power = np.maximum(flat[:, used].mean(axis=1) - floor, 1e-30)
    expected = np.sqrt(SHARED / (spectrum.averages * used.sum()))
    measured = [_of_axis(power[:, a], expected) for a in range(3)]
    x, y, z = (m for m, _ in measured)
    least = np.sqrt(np.maximum(np.median(spectrum.power, axis=0)[spectrum.band].min(axis=0) - floor, 0.0))
    return Levels((x, y, z), np.sqrt(power), white, all(steady for _, steady in measured), least)


def _of_axis(power: Array, expected: Array) -> tuple[Measured, bool]:
    """Return the density of one axis from its pieces' power (P,) and their expected relative scatter."""
    middle = float(np.median(power))
    chance = float(np.median(expected))
    scatter = MAD_TO_SD * float(np.median(np.abs(power / middle - 1.0)))
    if scatter < UNSTEADY * chance + 0.02:
        mean = mean_of(power, FLOOR * middle)
        return Measured(float(np.sqrt(mean.value)), 0.5 * mean.error / float(np.sqrt(mean.value))), True
    quietest = float(np.quantile(power, 0.1)) * (1.0 + 1.28 * chance)
    density = float(np.sqrt(quietest))
    return Measured(density, density * max(2.0 * chance / np.sqrt(power.size), FLOOR)), False


def density(still: Quiet, floor: float = 0.0) -> Array:
    """Return the densities (3,) of a sensor at rest, below any cutoff; needs three pieces.

    floor: density^2 of the steps' own noise, which comes after a low-pass and is taken off.
    """
    seen = judged(still, floor)
    if seen is None:
        raise ValueError(f"{len(still.pieces)} pieces of rest: at least three are needed")
    return levels(seen, floor).values()


def claimed(sensor: str, claims: Claims) -> float | None:
    """Return the declared density of a sensor, unit/sqrt(Hz)."""
    return claims.accel_noise_density if sensor == "accel" else claims.gyro_noise_density


def convention(measured: dict[str, Levels], claims: Claims) -> float:
    """Return sqrt(2) where the claims are plainly densities of two-sided spectra, else 1.

    Continuous-time models quote those (sd = density sqrt(rate)). Plainly: one sensor at least is that much
    above its claim, and none is as claimed.
    """
    told = {s: claimed(s, claims) for s in measured}
    ratios = np.array(
        [float(np.median(m.values())) / t for s, m in measured.items() if (t := told[s]) and m.own]
    )
    if ratios.size < 2:
        return 1.0
    near = 1.0 + thresholds.LEVEL_TOLERANCE
    two_sided = np.abs(np.log(ratios / TWO_SIDED)) < np.log(near)
    return TWO_SIDED if two_sided.any() and not (np.abs(np.log(ratios)) < np.log(near)).any() else 1.0


def noise_findings(
    sensor: str, measured: Levels, claim: float | None, sound: SoundPhones, where: Where
) -> list[Finding]:
    """Return what densities show. claim: of the same convention as the measured ones.

    Where something shakes the phone, the quietest rests bound the sensor's own noise from above, and no more.
    Noise that is not white has no level: coarse steps that a slow sway crosses show only a part of it.
    """
    found = [_unequal(sensor, measured, sound, claim, where)] if measured.own else []
    below = claim is not None and measured.white and measured.values()[_base(measured, claim)].max() < claim
    if claim is not None and (measured.own or below):
        found.append(_level(sensor, measured, sound["noise_level_declared"], claim, where))
    return [f for f in found if f is not None]


def suppressed(measured: Levels, claim: float | None) -> bool:
    """Whether a low-pass takes noise away.

    What only shakes the phone leaves the claimed noise at every frequency.
    """
    return claim is None or bool((measured.least < SUPPRESSED * claim).all())


def _base(measured: Levels, claim: float) -> list[int]:
    """Return the axes that have the sensor's own level: those near the claim, else near the middle one."""
    values = measured.values()
    near = np.log(1.0 + thresholds.LEVEL_TOLERANCE)
    own = np.flatnonzero(np.abs(np.log(values / claim)) < near)
    if own.size == 0:
        own = np.flatnonzero(np.abs(np.log(values / float(np.sort(values)[1]))) < near)
    return [int(a) for a in own]


def _reference(measured: Levels, base: list[int]) -> Measured:
    """Return the level of the base axes; its error knows how far they are apart, where that is no chance."""
    values, errors = measured.values()[base], measured.errors()[base]
    mean = float(values.mean())
    chance = float(np.sqrt((errors**2).sum())) / len(base)
    apart = float(values.std(ddof=1)) / mean if len(base) > 1 else 0.0
    beyond = apart if apart > SPREAD * float(errors.max()) else 0.0
    return Measured(mean, mean * float(np.hypot(chance, beyond / np.sqrt(len(base)))))


def imbalance(measured: Levels) -> dict[str, Measured]:
    """Return how unequal the axes' densities are, as natural logarithms of ratios.

    plane: x over y. upright: z over the geometric mean of x and y.
    """
    x, y, z = np.log(np.maximum(measured.values(), 1e-300))
    ex, ey, ez = measured.errors()
    return {
        "plane": Measured(x - y, float(np.hypot(ex, ey))),
        "upright": Measured(z - 0.5 * (x + y), float(np.sqrt(ez**2 + 0.25 * (ex**2 + ey**2)))),
    }


def odd_one_out(logs: Array, errors: Array, axis: int) -> Measured:
    """Return the ratio of an axis to the geometric mean of the others, as a natural logarithm.

    logs, errors: (3,) logarithms of the densities, and their standard errors.
    """
    ratios, own = ratios_to_others(logs, errors, axis)
    return Measured(float(ratios[axis]), float(own[axis]))


def ratios_to_others(logs: Array, errors: Array, axis: int) -> tuple[Array, Array]:
    """Return all axes (3,) over the geometric mean of the two but `axis`, as logarithms, and their errors."""
    weight = np.eye(3) - np.where(np.arange(3) == axis, 0.0, 0.5)
    return weight @ logs, np.sqrt(weight**2 @ errors**2)


def _unequal(
    sensor: str, measured: Levels, sound: SoundPhones, claim: float | None, where: Where
) -> Finding | None:
    """Find the axis whose density stands to that of the others as in no sound phone.

    Sound phones have a usual x over y and a usual z over both. With one axis odd, its own ratio is anything
    and only what the other two are to each other is usual.
    """
    ratios = imbalance(measured)
    common = {name: usual(sound, f"{sensor}_noise_{name}", claim) for name in ratios}
    sound_log = sum(common[name].log_sound(m.value, m.error) for name, m in ratios.items())
    # Of z and one of x and y, the ratio is usual as z over both is.
    logs = np.log(np.maximum(measured.values(), 1e-300))
    x, y, z = (odd_one_out(logs, measured.errors(), a) for a in range(3))
    pair = {
        0: (common["upright"], ratios["upright"].value + 0.5 * ratios["plane"].value),
        1: (common["upright"], ratios["upright"].value - 0.5 * ratios["plane"].value),
        2: (common["plane"], ratios["plane"].value),
    }
    gains = [
        common["upright"].log_faulty(own.value, own.error) + pair[a][0].log_sound(pair[a][1], own.error)
        for a, own in enumerate((x, y, z))
    ]
    axis = int(np.argmax(gains))
    own, others = (x, y, z)[axis], [a for a in range(3) if a != axis]
    reference = float(np.exp(np.log(measured.values()[others]).mean()))
    ratio = measured.values() / reference
    relative = np.log(measured.pieces[:, axis] / np.sqrt(measured.pieces[:, others].prod(axis=1)))
    typical = common["upright"].middle * (1.0 if axis == 2 else -0.5)
    seen = DirectEvidence(
        float(gains[axis] - sound_log) - float(np.log(3.0)),
        of_means(relative, np.array([typical])),
        common["upright" if axis == 2 else "plane"].rarity(own.value if axis == 2 else ratios["plane"].value),
    )
    say = (
        f"{NAME[sensor].capitalize()} noise differs between axes: {AXES[axis]} is"
        f" {ratio[axis]:.2f} times as noisy as the other two."
    )
    parameters = {"ratio": vector(ratio, ratio * np.hypot(measured.errors(), own.error), "1")}
    return direct_finding("noise_unequal_axes", sensor, [axis], where, parameters, statement=say, seen=seen)


def level_ratio(measured: Levels, claim: float) -> tuple[Measured, list[int]]:
    """Return the natural logarithm of the level over the claimed one, and the axes that it is of."""
    base = _base(measured, claim)
    reference = _reference(measured, base)
    return Measured(float(np.log(reference.value / claim)), reference.error / reference.value), base


def _level(sensor: str, measured: Levels, common: Usual, claim: float, where: Where) -> Finding | None:
    """Find a level that is not the claimed one."""
    ratio, base = level_ratio(measured, claim)
    pieces = np.log(measured.pieces[:, base].mean(axis=1) / claim)
    held_out = of_means(pieces, np.clip(np.array([ratio.value]), *common.between))
    value = float(np.exp(ratio.value))
    say = f"{NAME[sensor].capitalize()} white noise is {value:.2f} times the datasheet value."
    parameters = {"ratio": Measured(value, value * ratio.error).parameter("1")}
    return direct_finding(
        "noise_level",
        sensor,
        base,
        where,
        parameters,
        statement=say,
        seen=of_measured(ratio, common, held_out),
    )
