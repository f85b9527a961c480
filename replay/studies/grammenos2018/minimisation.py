"""The fit itself: nine or twelve parameters, and how fast Eq. 6 converges.

Grammenos et al. 2018, 1, 4.2.1 and Eq. 5-8. The Hessian and the damping are those of Eq. 6 and 7 as printed;
the product's own minimisation (Levenberg and Marquardt's) stands beside them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.accelerometer.equations import Norms
from stillcal.calib_core.accelerometer.parameters import basis
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.levenberg_marquardt import Damping, minimise
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.maths.rotation import exponential, matrix
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import (
    Cause,
    Claim,
    Evidence,
    Progress,
    Study,
    Verdict,
    holds,
    picture,
    table,
)

NAME, TITLE, WORK = "minimisation", "Nine or twelve parameters, and convergence (4.2.1)", "Grammenos 2018"
PHONES, RESTS, OTHERS = 200, 24, 500
"""Simulated phones, rests that each is calibrated from, and attitudes that its calibration is tried in."""
NOISE = 1e-3
"""Standard deviation of a rest's mean force, of gravity: what a phone's rests scatter by."""
EPSILON = 1e-6
"""Eq. 8's bound."""
DAMPINGS = (0.5, 0.6, 0.7, 0.75, 0.8, 0.9, 1.0)
"""Factors delta of Eq. 6; the paper says below 1, and no more."""
LEAST_ERROR = 1e-11
"""Distances from the minimum below this are rounding, and say nothing of convergence."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedSensor:
    """raw = X a + y in units of gravity. rests, others: (n, 3) raw forces; up: (n, 3) true ones of others."""

    rests: Array
    others: Array
    up: Array


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One minimisation by Eq. 6. v: (p,). errors: (k,) distance from the last iterate, start first.

    iterations: steps until Eq. 8 holds.
    """

    v: Array
    errors: Array
    iterations: int

    @property
    def ratios(self) -> Array:
        """Return by what factor each step shortened the distance, (k - 1,), as far as rounding lets see."""
        sure = self.errors[self.errors > LEAST_ERROR]
        return np.asarray(sure[1:] / sure[:-1])

    @property
    def order(self) -> float:
        """Return the order of convergence by the last three distances: 1 linear, 2 quadratic."""
        steps = np.log(self.ratios[-2:])
        return float(steps[1] / steps[0])


def sensor(rng: np.random.Generator) -> SimulatedSensor:
    """Draw a sensor (bias 3 %, scale 2 %, cross-axis 1 %, not symmetric), its rests and other attitudes."""
    x = np.eye(3) + 0.01 * rng.standard_normal((3, 3)) + np.diag(0.02 * rng.standard_normal(3))
    y = 0.03 * rng.standard_normal(3)
    up = rng.standard_normal((RESTS + OTHERS, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    raw = up @ x.T + y
    rests = raw[:RESTS] + NOISE * rng.standard_normal((RESTS, 3))
    return SimulatedSensor(rests, raw[RESTS:], up[RESTS:])


def equations(rests: Array, parameters: int) -> Norms:
    """Return Eq. 4 of each rest, equally weighted; every rest its own attitude."""
    n = len(rests)
    return Norms(rests, np.zeros((n, 3)), np.ones(n), np.arange(n), basis(parameters))


def determined(norms: Norms, v: Array) -> int:
    """Return how many parameters the rests determine: the rank of Eq. 4's Jacobian."""
    singular = np.linalg.svd(norms.residuals(v)[1], compute_uv=False)
    return int(np.sum(singular > 1e-9 * singular[0]))


def change_by_turning(norms: Norms, rng: np.random.Generator) -> float:
    """Return the largest change of Eq. 4 where S becomes Q S, over ten random rotations Q."""
    twelve = norms.matrix @ norms.start()
    before, largest = norms.residuals(norms.start())[0], 0.0
    for p in rng.standard_normal((10, 3)):
        turned = matrix(exponential(p)) @ twelve[3:].reshape(3, 3)
        after = norms.residuals(np.r_[twelve[:3], turned.ravel()])[0]
        largest = max(largest, float(np.abs(after - before).max()))
    return largest


def by_equation_6(norms: Norms, damping: float, *, full: bool = True, most: int = 100) -> Run:
    """Minimise Eq. 5 by Eq. 6 from an ideal sensor.

    full: with the Hessian of Eq. 7; otherwise with Gauss and Newton's J^T J. Twelve parameters take the
    shortest of the steps that solve Eq. 6, its Hessian being singular. Steps go on for a while after Eq. 8
    holds: the last iterate stands for the minimum.
    """
    v, passed, iterations = norms.start(), [norms.start()], 0
    for k in range(1, most + 1):
        residuals, jacobian = norms.residuals(v)
        hessian = _hessian(norms, v) if full else jacobian.T @ jacobian
        new = v - damping * np.linalg.pinv(hessian, rcond=1e-9, hermitian=True) @ (jacobian.T @ residuals)
        change = np.abs(new - v) / np.maximum(np.abs(new + v) / 2.0, EPSILON)
        v = new
        passed.append(v)
        if not iterations and change.max() < EPSILON:
            iterations = k
        if float(np.abs(passed[-1] - passed[-2]).max()) < 1e-15:
            break
    errors = np.linalg.norm(np.array(passed[:-1]) - v, axis=1)
    return Run(v, np.asarray(errors), iterations)


def _hessian(norms: Norms, v: Array) -> Array:
    """Return the second derivatives of half of Eq. 5, (p, p), by central differences of its gradient."""

    def gradient(at: Array) -> Array:
        residuals, jacobian = norms.residuals(at)
        return np.asarray(jacobian.T @ residuals)

    step = 1e-5
    rows = [(gradient(v + step * e) - gradient(v - step * e)) / (2.0 * step) for e in np.eye(v.size)]
    return np.asarray((np.array(rows) + np.array(rows).T) / 2.0)


def norm_error(one: SimulatedSensor, norms: Norms, v: Array) -> float:
    """Return the RMS error of the calibrated norm in attitudes that were not fitted, of gravity."""
    twelve = norms.matrix @ v
    calibrated = (one.others - twelve[:3]) @ twelve[3:].reshape(3, 3).T
    return rms(np.linalg.norm(calibrated, axis=1) - 1.0)


def tilt_error(one: SimulatedSensor, norms: Norms, v: Array) -> float:
    """Return the RMS angle between calibrated force and truth in those attitudes, degrees."""
    twelve = norms.matrix @ v
    calibrated = (one.others - twelve[:3]) @ twelve[3:].reshape(3, 3).T
    off = np.linalg.norm(np.cross(calibrated, one.up), axis=1) / np.linalg.norm(calibrated, axis=1)
    return float(np.degrees(np.sqrt(np.mean(np.arcsin(off) ** 2))))


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Of all sensors. rank: (n, 2) with 9 and 12 parameters; turning: change of Eq. 4 by rotations.

    norm, tilt: (n, 3) with 6, 9, 12, of gravity and degrees. order: (n,) of convergence by full steps;
    damped: (n,) the same with delta 0.75; ratio: (n,) of delta 0.75's last step; gauss_newton: (n,) last
    ratio of its full steps; ours: (n,) steps of the product's minimisation. iterations: by delta, (n,).
    runs: by delta, the first sensor's, for the figure.
    """

    rank: Array
    turning: float
    norm: Array
    tilt: Array
    order: Array
    damped: Array
    ratio: Array
    gauss_newton: Array
    ours: Array
    iterations: dict[float, Array]
    runs: dict[float, Run]


def find(phones: int, seed: int, progress: Progress) -> Found:
    """Fit so many simulated phones in all ways."""
    rng = np.random.default_rng(seed)
    rank, norm, tilt, order, damped, ratio, plain, ours = [], [], [], [], [], [], [], []
    steps: dict[float, list[int]] = {delta: [] for delta in DAMPINGS}
    runs: dict[float, Run] = {}
    turning = 0.0
    for k in range(phones):
        one = sensor(rng)
        forms = {p: equations(one.rests, p) for p in (6, 9, 12)}
        rank.append([determined(forms[p], forms[p].start()) for p in (9, 12)])
        turning = max(turning, change_by_turning(forms[12], rng))
        fits = {p: by_equation_6(form, 1.0, full=False) for p, form in forms.items()}
        norm.append([norm_error(one, forms[p], fits[p].v) for p in forms])
        tilt.append([tilt_error(one, forms[p], fits[p].v) for p in forms])
        nine = {delta: by_equation_6(forms[9], delta) for delta in DAMPINGS}
        for delta, run in nine.items():
            steps[delta].append(run.iterations)
        order.append(nine[1.0].order)
        damped.append(nine[0.75].order)
        ratio.append(nine[0.75].ratios[-1])
        plain.append(fits[9].ratios[-1])
        ours.append(minimise(forms[9].residuals, forms[9].start(), Damping()).iterations)
        runs = runs or nine
        progress((k + 1) / phones)
    iterations = {delta: np.array(values) for delta, values in steps.items()}
    return Found(
        rank=np.array(rank),
        turning=turning,
        norm=np.array(norm),
        tilt=np.array(tilt),
        order=np.array(order),
        damped=np.array(damped),
        ratio=np.array(ratio),
        gauss_newton=np.array(plain),
        ours=np.array(ours),
        iterations=iterations,
        runs=runs,
    )


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Fit simulated phones with 6, 9 and 12 parameters, by Eq. 6 and by the product's minimisation."""
    found = find(PHONES, seed, progress)
    words = f"{PHONES} simulated sensors, {RESTS} rests each over the sphere"
    claims = (_twelve(found, words), _added(found, words), *_convergence(found, words))
    file = _draw(found, figures)
    return Study(NAME, TITLE, claims, _text(found, file), (file,), seed)


def _twelve(found: Found, data: str) -> Claim:
    nine, twelve = (int(column.max()) for column in found.rank.T)
    return Claim(
        WORK,
        "4.2.1",
        "twelve parameters can be fitted to norms, as nine can",
        "12 or 9, by configuration",
        f"norms determine {nine} of 9 and {twelve} of 12",
        data,
        holds(twelve == 12 and nine == 9),
        "rank of Eq. 4's Jacobian",
        evidence=Evidence.THEORY,
        cause=Cause(
            f"S and QS give the same E for every rotation Q (Eq. 4 changed by {found.turning:.0e} at most"
            " over ten rotations of each), so three of twelve stay open",
            shown=found.turning < 1e-9,
        ),
    )


def _added(found: Found, data: str) -> Claim:
    norm, tilt = 1e3 * np.median(found.norm, axis=0), np.median(found.tilt, axis=0)
    return Claim(
        WORK,
        "4.2.1",
        "what more parameters bring, in attitudes that were not fitted",
        "-",
        f"6, 9, 12: norm off by {_three(norm)} mg; tilt by {_three(tilt)} degrees",
        data,
        Verdict.OPEN,
        "medians of RMS; twelve by the shortest steps. Their norms are those of nine: what they are is one of"
        " the many S with the same norms",
        evidence=Evidence.SIMULATION,
    )


def _convergence(found: Found, data: str) -> list[Claim]:
    order, damped = float(np.median(found.order)), float(np.median(found.damped))
    counts = {delta: float(np.median(values)) for delta, values in found.iterations.items()}
    return [
        Claim(
            WORK,
            "1, Eq. 6",
            "the damped steps of Eq. 6 converge quadratically",
            "ensured, with delta < 1",
            f"order {damped:.2f} at delta 0.75: a step leaves {np.median(found.ratio):.3f} of the distance",
            data,
            holds(damped > 1.5),
            "holds with an order nearer to 2 than to 1",
            evidence=Evidence.SIMULATION,
            cause=Cause(
                "the factor delta, as a step leaves 1 - delta of the distance. With delta 1 the order is"
                f" {order:.2f} (median), and with Gauss and Newton's Hessian a step leaves"
                f" {100 * float(np.median(found.gauss_newton)):.1g} %",
                shown=order > 1.5,
            ),
        ),
        Claim(
            WORK,
            "4.2.1, Eq. 8",
            "iterations of Eq. 6, by its factor delta",
            "around 10; delta not printed",
            f"{counts[min(counts)]:.0f} at delta {min(counts):g} to {counts[max(counts)]:.0f} at"
            f" {max(counts):g}; the product's minimisation {np.median(found.ours):.0f}",
            data,
            Verdict.OPEN,
            "medians; until Eq. 8 holds at 1e-6, from an ideal sensor",
            evidence=Evidence.SIMULATION,
        ),
    ]


def _three(values: Array) -> str:
    return ", ".join(f"{value:.2g}" for value in values)


def _text(found: Found, file: str) -> str:
    rows = [
        (f"{delta:g}", f"{np.median(found.iterations[delta]):.0f}", f"{found.iterations[delta].max():.0f}")
        for delta in DAMPINGS
    ]
    return "\n\n".join(
        [
            f"Sensors with 3 % of bias, 2 % of scale and 1 % of cross-axis error (standard deviations, the"
            f" cross-axis part not symmetric), rests that scatter by {1e3 * NOISE:g} mg. Eq. 6 starts from an"
            " ideal sensor and has the Hessian of Eq. 7. The product shortens steps only where one would"
            " raise E (Levenberg and Marquardt), so that it need not choose a delta.",
            table(("delta", "iterations until Eq. 8 holds, median", "most"), rows),
            picture(file, "Distance from the minimum, by steps of Eq. 6 and by delta"),
        ]
    )


def _draw(found: Found, figures: Path) -> str:
    figure, (axis,) = drawing.panels(1)
    for colour, delta in zip(drawing.COLOURS, (0.5, 0.75, 0.9, 1.0), strict=False):
        axis.semilogy(
            np.maximum(found.runs[delta].errors, 1e-16), "o-", markersize=3, color=colour, label=f"{delta:g}"
        )
    axis.set(xlabel="steps", ylabel="distance from the minimum", xlim=(0, 30))
    axis.legend(title="delta")
    return drawing.save(figure, figures, NAME)
