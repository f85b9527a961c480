"""White noise at rest: its density against what is claimed, and one axis' against another's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct.low_pass import SHARED, Quiet, Spectra, judged
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.left_out import of_means
from stillcal.calib_core.diagnosis.model.measurement import (
    SIGNIFICANT,
    Measured,
    direct_finding,
    mean_of,
    vector,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Claims, Finding, Where

LINE = 1.5
USABLE = 0.3
WHITE = 0.5
UNSTEADY = 2.0
FLOOR = 3e-3
SPREAD = 3.0
SUPPRESSED = 0.8
TWO_SIDED = float(np.sqrt(2.0))


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """White noise by axis. density: three numbers, unit/sqrt(Hz); pieces: (P, 3) the same by piece.

    white: whether most of the band is flat. steady: whether rests differ no more than chance would have it.
    least: the lowest density (3,) in the band.
    """

    density: tuple[Measured, Measured, Measured]
    pieces: Array
    white: bool
    steady: bool
    least: Array

    @property
    def own(self) -> bool:
        """Whether the noise is the sensor's own: white, and alike in all rests."""
        return self.white and self.steady

    def values(self) -> Array:
        """Return the densities (3,)."""
        return np.array([d.value for d in self.density])

    def errors(self) -> Array:
        """Return their relative standard errors (3,)."""
        return np.array([d.error / max(d.value, 1e-300) for d in self.density])


def levels(spectrum: Spectra, floor: float = 0.0) -> Levels:
    """Measure densities where the spectrum is white, lines and slow wander left out.

    floor: density^2 of the steps' own noise, taken off. Where rests differ more than chance would have it
    (people walk by, a road), the quietest tenth of them tells the sensor's own noise.
    """
    shape = spectrum.shape()
    flat = spectrum.power / shape[None, :, None]
    band = spectrum.band & (shape > USABLE)
    typical = np.median(flat, axis=0)
    level = np.median(typical[band], axis=0)
    clean = band & (typical < LINE * level).all(axis=1) & (typical > level / LINE).all(axis=1)
    white = bool(clean.sum() >= WHITE * band.sum())
    used = clean if white else band
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
    scatter = 1.4826 * float(np.median(np.abs(power / middle - 1.0)))
    if scatter < UNSTEADY * chance + 0.02:
        mean = mean_of(power, FLOOR * middle)
        return Measured(float(np.sqrt(mean.value)), 0.5 * mean.error / float(np.sqrt(mean.value))), True
    quietest = float(np.quantile(power, 0.1)) * (1.0 + 1.28 * chance)
    density = float(np.sqrt(quietest))
    return Measured(density, density * max(2.0 * chance / np.sqrt(power.size), FLOOR)), False


def density(still: Quiet) -> Array:
    """Return the densities (3,) of a sensor at rest, its steps' own noise in them; needs three pieces."""
    seen = judged(still)
    if seen is None:
        raise ValueError(f"{len(still.pieces)} pieces of rest: at least three are needed")
    return levels(seen).values()


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


def noise_findings(sensor: str, measured: Levels, claim: float | None, where: Where) -> list[Finding]:
    """Return what densities show. claim: of the same convention as the measured ones.

    Where something shakes the phone, the quietest rests bound the sensor's own noise from above, and no more.
    """
    base, others = _base(measured, claim)
    found = [_unequal(sensor, measured, base, others, where)] if measured.own else []
    if claim is not None and (measured.own or measured.values()[base].max() < claim):
        found.append(_level(sensor, measured, base, claim, where))
    return [f for f in found if f is not None]


def suppressed(measured: Levels, claim: float | None) -> bool:
    """Whether a low-pass takes noise away.

    What only shakes the phone leaves the claimed noise at every frequency.
    """
    return claim is None or bool((measured.least < SUPPRESSED * claim).all())


def _base(measured: Levels, claim: float | None) -> tuple[list[int], list[int]]:
    """Return the axes that have the sensor's own level, and the others.

    Its own are those near the claim; else two or three that agree with the middle one.
    """
    values = measured.values()
    near = np.log(1.0 + thresholds.LEVEL_TOLERANCE)
    middle = float(np.sort(values)[1])
    own = np.flatnonzero(np.abs(np.log(values / (claim or middle))) < near)
    if own.size == 0:
        own = np.flatnonzero(np.abs(np.log(values / middle)) < near)
    return [int(a) for a in own], [a for a in range(3) if a not in own]


def _reference(measured: Levels, base: list[int]) -> Measured:
    """Return the level of the base axes; its error knows how far they are apart, where that is no chance."""
    values, errors = measured.values()[base], measured.errors()[base]
    mean = float(values.mean())
    chance = float(np.sqrt((errors**2).sum())) / len(base)
    apart = float(values.std(ddof=1)) / mean if len(base) > 1 else 0.0
    beyond = apart if apart > SPREAD * float(errors.max()) else 0.0
    return Measured(mean, mean * float(np.hypot(chance, beyond / np.sqrt(len(base)))))


def _unequal(
    sensor: str, measured: Levels, base: list[int], others: list[int], where: Where
) -> Finding | None:
    """Find axes whose density differs from that of the others."""
    if not others:
        return None
    reference = _reference(measured, base)
    ratio = measured.values() / reference.value
    error = ratio * np.hypot(measured.errors(), reference.error / reference.value)
    top = 1.0 + thresholds.LEVEL_TOLERANCE
    sigmas = [Measured(float(r), float(e)).beyond(1.0 / top, top) for r, e in zip(ratio, error, strict=True)]
    axes = [a for a in others if sigmas[a] >= SIGNIFICANT]
    if not axes:
        return None
    text = ", ".join(f"{AXES[a]} is {ratio[a]:.2f} times as noisy as the sensor's own level" for a in axes)
    say = f"{NAME[sensor].capitalize()} noise differs between axes: {text}."
    relative = measured.pieces[:, axes] / measured.pieces[:, base].mean(axis=1, keepdims=True)
    seen = of_means(relative, (1.0 / top, top), max(sigmas))
    parameters = {"ratio": vector(ratio, error, "1")}
    return direct_finding("noise_unequal_axes", sensor, axes, where, parameters, statement=say, seen=seen)


def _level(sensor: str, measured: Levels, base: list[int], claim: float, where: Where) -> Finding | None:
    """Find a level that is not the claimed one."""
    reference = _reference(measured, base)
    ratio = Measured(reference.value / claim, reference.error / claim)
    top = 1.0 + thresholds.LEVEL_TOLERANCE
    sigmas = ratio.beyond(1.0 / top, top)
    if sigmas < SIGNIFICANT:
        return None
    say = f"{NAME[sensor].capitalize()} white noise is {ratio.value:.2f} times the datasheet value."
    seen = of_means(measured.pieces[:, base].mean(axis=1) / claim, (1.0 / top, top), sigmas)
    parameters = {"ratio": ratio.parameter("1")}
    return direct_finding("noise_level", sensor, base, where, parameters, statement=say, seen=seen)
