"""Errors over time: constant, Gauss-Markov, random walk, autoregressive and 1/f, by their spectra.

Collin et al. 2019, Eq. 2-5 and Fig. 3. Theory is written here by itself: the spectra of difference equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.phone.noise import WANDER_STEP, GaussMarkov, Wander, flicker_bank, seeded
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import Claim, Evidence, Progress, Study, holds, picture, table

WORK, WHERE = "Collin 2019", "2.1.3"
STEPS = 2**19
SEGMENT = 2**14
EDGE = 4  # lowest bins of each segment, where its window still blurs a steep spectrum
CORRELATION = 300
"""Correlation time of Fig. 3's Gauss-Markov process, samples."""
BANK_ROOM = 0.05
"""Share by which a bank of processes a factor of four apart may miss 1/f on average over decades."""
ONE = np.ones(3)


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """One-sided densities, measured and theory. f, power, theory: (k,) Hz, 1/Hz; segments: averaged."""

    name: str
    f: Array
    power: Array
    theory: Array
    segments: int

    @property
    def ratio(self) -> float:
        """Mean of measured over theory, over bands even in the logarithm so that all scales count alike."""
        return float(np.mean([ratio for ratio, _ in self._bands()]))

    @property
    def error(self) -> float:
        """Standard error of the ratio: each bin of a Hann window is 1/1.5 of an independent exponential."""
        bands = self._bands()
        return float(np.sqrt(sum(1.5 / (n * self.segments) for _, n in bands)) / len(bands))

    def _bands(self) -> list[tuple[float, int]]:
        edges = np.geomspace(self.f[0], self.f[-1] * 1.0001, 7)
        rows = [np.flatnonzero((self.f >= a) & (self.f < b)) for a, b in pairwise(edges)]
        return [(float(np.mean(self.power[r] / self.theory[r])), r.size) for r in rows if r.size]


def gauss_markov(tau: float, seed: int, n: int = STEPS) -> Array:
    """Return a Gauss-Markov process of unit variance (Eq. 3), as the simulated phone makes it, (n, 3)."""
    return _wander([GaussMarkov(ONE, tau)], 0.0 * ONE, seed, n)


def random_walk(seed: int, n: int = STEPS) -> Array:
    """Return a random walk of unit density (Eq. 4), as the simulated phone makes it, (n, 3)."""
    return _wander([], ONE, seed, n)


def flicker(seed: int, n: int = STEPS) -> Array:
    """Return 1/f noise of unit bias instability, as the simulated phone makes it, (n, 3)."""
    return _wander(flicker_bank(ONE), 0.0 * ONE, seed, n)


def autoregressive(coefficients: tuple[float, ...], rng: np.random.Generator, n: int = STEPS) -> Array:
    """Return x(t) = sum of coefficients times the values before + unit white noise (Eq. 5), (n, 3)."""
    from scipy.signal import lfilter  # noqa: PLC0415 - for those who evaluate

    settling = 4096
    driving = rng.standard_normal((n + settling, 3))
    return np.asarray(lfilter([1.0], [1.0, *(-c for c in coefficients)], driving, axis=0)[settling:])


def difference_spectrum(coefficients: tuple[float, ...], step: float) -> Callable[[Array], Array]:
    """Return the one-sided spectrum of Eq. 5 driven by unit white noise, as a function of f in Hz."""

    def spectrum(f: Array) -> Array:
        turn = np.exp(-2j * np.pi * f * step)
        transfer = 1.0 - sum(c * turn ** (k + 1) for k, c in enumerate(coefficients))
        return np.asarray(2.0 * step / np.abs(transfer) ** 2)

    return spectrum


def spectra(seed: int, n: int = STEPS) -> list[Spectrum]:
    """Measure the spectrum of each process and put theory beside it."""
    step, tau = WANDER_STEP, CORRELATION * WANDER_STEP
    keep = float(np.exp(-step / tau))
    resonant = (1.6, -0.9)
    return [
        _spectrum(
            "Gauss-Markov",
            gauss_markov(tau, seed, n),
            step,
            lambda f: (1.0 - keep**2) * difference_spectrum((keep,), step)(f),
        ),
        _spectrum(
            "random walk", random_walk(seed, n), step, lambda f: step * difference_spectrum((1.0,), step)(f)
        ),
        _spectrum(
            "autoregressive, two values",
            autoregressive(resonant, seeded(seed, "AR"), n),
            1.0,
            difference_spectrum(resonant, 1.0),
        ),
        _spectrum("1/f", flicker(seed, n), step, lambda f: 1.0 / (np.pi * f), top=0.3),
    ]


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Judge the limits that the paper names; check each process of the simulator by its spectrum."""
    found = spectra(seed)
    progress(0.8)
    claims = [*_limit_claims(seed), _growth_claim(seed)]
    file = _draw(found, seed, figures)
    rows = [(s.name, f"{s.f[0]:.3g} to {s.f[-1]:.3g} Hz", f"{s.ratio:.4f}", f"{s.error:.4f}") for s in found]
    text = "\n\n".join(
        [
            "Spectra are of the simulated phone's own noise (its slow wander on a grid of 0.05 s), but for"
            " the autoregressive process, which no phone here has. Ratios are measured over theory: our own"
            " check that the simulator's noise is what its equation says, of which the paper claims nothing."
            f" Ten processes stand for 1/f, which may move its ratio by {BANK_ROOM:.0%}.",
            table(("process", "band", "ratio", "standard error"), rows),
            picture(file, "Left: as Fig. 3, one white noise and what it drives. Right: spectra on theory"),
        ]
    )
    progress(1.0)
    return Study("noise-processes", "Error processes", tuple(claims), text, (file,), seed)


def _wander(processes: list[GaussMarkov], walk: Array, seed: int, n: int) -> Array:
    return Wander(processes, walk, seed, "processes").at(np.arange(n, dtype=np.float64) * WANDER_STEP)


def _spectrum(
    name: str,
    values: Array,
    step: float,
    theory: Callable[[Array], Array],
    *,
    top: float = np.inf,
) -> Spectrum:
    from scipy.signal import welch  # noqa: PLC0415 - for those who evaluate

    f, power = welch(values, fs=1.0 / step, nperseg=SEGMENT, noverlap=0, axis=0)
    rows = (np.arange(f.size) >= EDGE) & (f <= top) & (np.arange(f.size) < f.size - 1)
    segments = 3 * (len(values) // SEGMENT)
    return Spectrum(name, f[rows], power.mean(axis=1)[rows], theory(f[rows]), segments)


def _limit_claims(seed: int) -> list[Claim]:
    """Gauss-Markov turns into a random walk as its correlation time grows, into white noise as it shrinks."""
    n, long = 2000, 1e6
    slow = gauss_markov(long, seed, n) * np.sqrt(long / 2.0)
    steps = np.diff(slow, axis=0)
    grown = float(np.var(steps) / WANDER_STEP)
    fast = gauss_markov(WANDER_STEP / 50.0, seed, STEPS)
    left = float(np.mean(fast[1:] * fast[:-1]) / np.mean(fast**2))
    size = 3.0 * np.sqrt(2.0 / steps.size)
    return [
        Claim(
            WORK,
            WHERE,
            "Gauss-Markov of infinite correlation time is a random walk",
            "steps' variance dt",
            f"{grown:.3f} dt",
            f"{steps.size} steps",
            holds(abs(grown - 1.0) <= size),
            f"within {size:.3f}: three standard errors",
            evidence=Evidence.SIMULATION,
        ),
        Claim(
            WORK,
            WHERE,
            "Gauss-Markov of no correlation time is white noise",
            "correlation 0",
            f"{left:+.4f}",
            f"{fast.size} values",
            holds(abs(left) <= 3.0 / np.sqrt(fast.size)),
            "three standard errors of zero",
            evidence=Evidence.SIMULATION,
        ),
    ]


def _growth_claim(seed: int) -> Claim:
    white, markov, walk = _fig3(seed, 2**17)
    sizes = float(markov.std() / white.std()), float(walk.std() / white.std())
    keep = np.exp(-1.0 / CORRELATION)
    return Claim(
        WORK,
        f"{WHERE}, Fig. 3",
        "correlated processes are far larger than the noise that drives them",
        "significantly higher",
        f"Gauss-Markov {sizes[0]:.1f} times, random walk {sizes[1]:.0f} times",
        f"{white.size} samples of one driving noise",
        holds(abs(sizes[0] * np.sqrt(1.0 - keep**2) - 1.0) < 0.1 and sizes[1] > sizes[0]),
        f"Gauss-Markov within 10 % of its theory, {1.0 / np.sqrt(1.0 - keep**2):.1f} times",
        evidence=Evidence.SIMULATION,
    )


def _fig3(seed: int, n: int) -> tuple[Array, Array, Array]:
    """Return white noise and the Gauss-Markov process and random walk that it drives, (n,) each."""
    from scipy.signal import lfilter  # noqa: PLC0415 - for those who evaluate

    white = seeded(seed, "figure 3").standard_normal(n)
    keep = float(np.exp(-1.0 / CORRELATION))
    return white, np.asarray(lfilter([1.0], [1.0, -keep], white)), np.cumsum(white)


def _draw(found: list[Spectrum], seed: int, figures: Path) -> str:
    figure, (left, right) = drawing.panels(2)
    for values, label in zip(_fig3(seed, 1000), ("white noise", "Gauss-Markov", "random walk"), strict=True):
        left.plot(values, label=label, linewidth=0.9)
    left.set(xlabel="sample", ylabel="value")
    left.legend()
    for s in found:
        edges = np.unique(np.geomspace(1, s.f.size, 40).astype(int)) - 1
        rows = [slice(a, b) for a, b in pairwise(edges)]
        right.loglog([s.f[r].mean() for r in rows], [s.power[r].mean() for r in rows], ".", label=s.name)
        right.loglog(s.f, s.theory, color="black", linewidth=0.8)
    right.set(xlabel="frequency, Hz", ylabel="spectral density, 1/Hz")
    right.legend()
    return drawing.save(figure, figures, "noise-processes")
