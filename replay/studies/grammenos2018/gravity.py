"""What a calibration loses by the wrong gravity (Grammenos et al. 2018, 4.5, Table 8)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.gravity import STANDARD, igf, somigliana
from stillcal.replay.formats.trace import open_trace
from stillcal.replay.phone import draw_rests, population
from stillcal.replay.runner import replay
from stillcal.replay.studies.claim import (
    Cause,
    Claim,
    Evidence,
    Progress,
    Study,
    agreement,
    holds,
    picture,
    table,
)
from stillcal.replay.studies.drawing import BLUE, RED, panels, save
from stillcal.replay.studies.grammenos2018.gyroscope_bias import RECORDINGS

NAME, TITLE, WORK = "gravity", "Default and local gravity (Table 8)", "Grammenos 2018"
LOCAL = 9.81676
"""The paper's place, m/s^2."""

STATES = (12, 20)
"""Stationary states of the paper's sequences (5.1)."""

EQUAL = 1e-3
"""m/s^2: uncertainty of every real rest alike, as Eq. 5 has none."""

PHONES, RESTS = 100, 40
DATA = f"{PHONES} phones drawn as in Stisen et al., {RESTS} rests each at g = {LOCAL} m/s²"
PAPER = {
    "cost": ("5.2, Table 8", "residual of E, accelerometer: default g, local g", "0.6015, 0.0090 (67 to 1)"),
    "fixed": (
        "5.2, Table 8",
        "the same with nothing fitted to make up for g",
        "0.6015, 0.0090 (67 to 1)",
    ),
    "gyro": ("5.2, Table 8", "gyroscope: default g, local g", "0.2015, 0.1276 (1.6 to 1)"),
    "formula": ("4.5, Eq. 16-18", "g from latitude and height is more accurate than the default", "stated"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Costs:
    """By phone and by gravity assumed (phones, 2), the default first.

    fitted: E of Eq. 5, (m/s^2)^4, after a fit. judged: E, against the default or the local g, of the model
    that was fitted to the local one. force: mean error of calibrated forces, m/s^2.
    """

    fitted: Array
    judged: Array
    force: Array


def cost(norms: Array, gravity: float) -> float:
    """Eq. 4-5: mean squared difference of squared norms (n,) m/s^2 from gravity's square."""
    return float(np.mean(np.square(np.square(norms) - gravity**2)))


def costs(phones: int, seed: int, progress: Progress) -> Costs:
    """Fit every phone's rests once by the default and once by the local g."""
    rows = []
    for k, phone in enumerate(population(phones, seed)):
        rests = draw_rests(phone, RESTS, seed + k, gravity=LOCAL)
        fits = [accelerometer.fit(rests.forces, rests.white_uncertainties, g) for g in (STANDARD, LOCAL)]
        calibrated = [fit.model.apply(rests.forces) for fit in fits]
        norms = [np.linalg.norm(c, axis=1) for c in calibrated]
        clean = rests.true_forces @ np.asarray(phone.accel.scale).T + phone.accel.bias
        fitted = [cost(n, g) for n, g in zip(norms, (STANDARD, LOCAL), strict=True)]
        judged = [cost(norms[1], g) for g in (STANDARD, LOCAL)]
        force = [float(np.abs(np.linalg.norm(f.model.apply(clean), axis=1) - LOCAL).mean()) for f in fits]
        rows.append((fitted, judged, force))
        progress((k + 1) / phones)
    columns = np.array(rows).swapaxes(0, 1)
    return Costs(columns[0], columns[1], columns[2])


def real_costs(data: Path) -> Array:
    """Return E against the default and the local g of real rests, fitted to the local one; (recordings, 2).

    The rests of each recording are first brought to LOCAL on the mean, as the paper makes its traces.
    """
    rows = []
    for name, form in RECORDINGS.items():
        engine = Engine()
        replay(open_trace(data / name, form).chunks(), engine, lambda action: None)
        forces = np.array([rest.specific_force for rest in engine.state.pool.rests])
        forces *= LOCAL / np.linalg.norm(forces, axis=1).mean()
        fit = accelerometer.fit(forces, np.full(forces.shape, EQUAL), LOCAL)
        norms = np.linalg.norm(fit.model.apply(forces), axis=1)
        rows.append([cost(norms, g) for g in (STANDARD, LOCAL)])
    return np.array(rows)


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Compare what is left by the default g with what is left by the local one."""
    found = costs(PHONES, seed, progress)
    real = real_costs(data) if data is not None else np.empty((0, 2))
    claims = (_fitted(found), _judged(found, real), _gyro(), _formula())
    file = _draw(found, figures)
    return Study(NAME, TITLE, claims, _text(found, file), (file,), seed)


def _fitted(found: Costs) -> Claim:
    ratios = found.fitted[:, 0] / found.fitted[:, 1]
    low, mid, high = np.percentile(ratios, [5, 50, 95])
    ours = f"{np.median(found.fitted[:, 0]):.4f}, {np.median(found.fitted[:, 1]):.4f} ({mid:.3f} to 1)"
    why = "holds where the default leaves at least twice as much in half of the phones"
    power = (STANDARD / LOCAL) ** 4
    cause = Cause(
        "a scale common to all axes takes up any error of g, so that a fit that converges leaves E in"
        f" proportion to g⁴, {power:.3f}; of the phones, 5 to 95 % have {low:.3f} to {high:.3f}",
        shown=abs(mid / power - 1.0) < 0.001,
    )
    return Claim(
        WORK, *PAPER["cost"], ours, DATA, holds(mid >= 2.0), why, evidence=Evidence.SIMULATION, cause=cause
    )


def _judged(found: Costs, real: Array) -> Claim:
    """Judge what a given calibration leaves by either g. real: E of real rests by both, (recordings, 2)."""
    floor = (LOCAL**2 - STANDARD**2) ** 2
    ours = f"{np.median(found.judged[:, 0]):.4f}, {np.median(found.judged[:, 1]):.4f}"
    ratio = float(np.median(found.judged[:, 0] / found.judged[:, 1]))
    why = "tolerance half of the paper's ratio"
    low, high = (n * floor for n in STATES)
    theirs = _off(0.0090 / (0.6015 / floor))
    ratios = real[:, 0] / real[:, 1]
    offs = [_off(e) for e in real[:, 1]]
    measured = (
        f" Rests of {len(real)} real recordings have {min(offs):.1f} to {max(offs):.1f} mm/s², which makes"
        f" {', '.join(f'{r:.0f}' for r in ratios)} to 1: the simulated ones are too alike"
        if len(real)
        else ""
    )
    cause = Cause(
        f"a trace free of error leaves (9.81676² - 9.80665²)² = {floor:.4f} by the default, in Eq. 5's mean."
        f" Summed over the paper's {STATES[0]} to {STATES[1]} states it is {low:.2f} to {high:.2f}, and"
        f" 0.6015 is that of {0.6015 / floor:.1f}: the paper may have left out the division by N. The ratio"
        f" is then set by how alike the norms of rests are: the paper's are {theirs:.1f} mm/s² off, those"
        f" simulated here {_off(float(np.median(found.judged[:, 1]))):.1f}.{measured}",
        shown=bool(len(real)) and bool(ratios.min() <= 67.0 <= ratios.max()),
    )
    return Claim(
        WORK,
        *PAPER["fixed"],
        f"{ours} ({ratio:.0f} to 1)",
        DATA,
        agreement(67, ratio, 33),
        why,
        evidence=Evidence.SIMULATION,
        cause=cause,
    )


def _off(error: float) -> float:
    """Return how far calibrated norms are off that leave this E, mm/s^2 rms."""
    return 1e3 * float(np.sqrt(error)) / (2.0 * LOCAL)


def _gyro() -> Claim:
    angle, alone = _shared_factor(), (LOCAL - STANDARD) ** 2
    cause = Cause(
        "Eq. 15's vectors are calibrated forces at two rests, so that a wrong g scales both alike, E_g by its"
        " square, and leaves the matrix that minimises it as it is. Where only one of the two carried the"
        f" wrong g, a turn would leave (9.81676 - 9.80665)² = {alone:.6f}; the paper's difference, 0.0739, is"
        f" that of {0.0739 / alone:.0f} turns, and between its {STATES[0]} to {STATES[1]} states are"
        f" {STATES[0] - 1} to {STATES[1] - 1}. 1.6 does not come of g",
        shown=False,
    )
    return Claim(
        WORK,
        *PAPER["gyro"],
        f"{angle:.4f} to 1",
        "arithmetic",
        agreement(1.58, angle, 0.01),
        "tolerance 1 %",
        evidence=Evidence.ARITHMETIC,
        cause=cause,
    )


def _shared_factor() -> float:
    """Return E_g by the default g over E_g by the local one: both gravity vectors carry g as a factor."""
    rng = np.random.default_rng(0)
    turned, measured = rng.normal(size=(2, 100, 3))
    errors = [np.sum(np.square(g * (turned - measured))) for g in (STANDARD, LOCAL)]
    return float(errors[0] / errors[1])


def formula_errors() -> tuple[Array, Array]:
    """Return how far Eq. 16-18 and the default are off WGS-84's normal gravity, (n,) places each, m/s^2."""
    places = [(float(p), float(h)) for p in np.linspace(-90.0, 90.0, 37) for h in np.linspace(0.0, 4000.0, 9)]
    exact = np.array([somigliana(*place) for place in places])
    return np.abs([igf(*place) for place in places] - exact), np.abs(STANDARD - exact)


def _formula() -> Claim:
    printed, default = formula_errors()
    ours = f"off by {1e3 * printed.max():.2f} mm/s² at most, the default by {1e3 * default.max():.0f}"
    why = (
        "against normal gravity of the WGS-84 ellipsoid, heights to 4000 m; holds where the formula is nearer"
        " at 95 % of places. The real field differs from the ellipsoid's by some 0.5 mm/s²"
    )
    good = float(np.mean(printed < default)) >= 0.95
    data = "all latitudes, heights to 4000 m"
    return Claim(WORK, *PAPER["formula"], ours, data, holds(good), why, evidence=Evidence.THEORY)


def _draw(found: Costs, folder: Path) -> str:
    figure, (left, right) = panels(2)
    bins = np.geomspace(max(found.fitted.min(), 1e-8), found.judged.max() * 1.1, 40)
    left.hist(found.judged[:, 0], list(bins), color=RED, alpha=0.7, label="judged by the default")
    left.hist(found.judged[:, 1], list(bins), color=BLUE, alpha=0.7, label="judged by the local g")
    left.set(xscale="log", xlabel="E, (m/s²)⁴", ylabel="phones", title="One calibration, two values of g")
    left.legend(fontsize=7)
    right.plot(found.fitted[:, 1], found.fitted[:, 0], "o", color=BLUE, markersize=4)
    span = [float(found.fitted.min()), float(found.fitted.max())]
    right.plot(span, span, color=RED, linewidth=0.8)
    right.set(xscale="log", yscale="log", xlabel="E fitted by the local g", ylabel="by the default g")
    right.set_title("A fit takes up the error of g")
    return save(figure, folder, NAME)


def _text(found: Costs, file: str) -> str:
    rows = [
        (name, *(f"{v:.4g}" for v in np.median(values, axis=0)))
        for name, values in (
            ("E after a fit, (m/s²)⁴", found.fitted),
            ("E of the local calibration, (m/s²)⁴", found.judged),
            ("calibrated norm off, m/s²", found.force),
        )
    ]
    return "\n\n".join(
        [
            "Gravity that is wrong cannot be seen in what a fit leaves over: it goes into the scale of all"
            " three axes. It is seen in the calibrated forces, which come out 0.1 % too small, and in a"
            " calibration that is judged by another g than the one it was fitted to, as when the phone has"
            " moved.",
            picture(file, "Residual costs by default and by local gravity"),
            table(("median over phones", "by 9.80665", "by 9.81676"), rows),
        ]
    )
