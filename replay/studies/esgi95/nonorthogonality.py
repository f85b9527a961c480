"""What leaving out the angles between a sensor's axes costs: the worst case, and how errors are spread.

ESGI'95, 2.3 (problems 1 and 2, Fig. 3 and 4) and its words on a catastrophic position. Angles of the axes
within 2 % of right; printed as 0.98 pi to 1.02 pi, meant as halves of that, as its own solution shows.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer.fit import AccelerometerSettings
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import (
    Cause,
    Claim,
    Evidence,
    Progress,
    Study,
    Verdict,
    agreement,
    holds,
    picture,
    table,
)
from stillcal.replay.studies.esgi95.published import RANGES, dataset, fit_positions
from stillcal.replay.studies.methods.esgi import ESGI_GRAVITY
from stillcal.replay.studies.methods.navigation import strapdown

WORK = "ESGI'95"
LIMIT = 0.02
FIG3_ANGLES = np.array([1.53938, 1.60221, 1.60221])
"""phi, psi, theta of the sensor behind Fig. 3, as printed: corners of the allowed angles."""
ANGLE_ROOM = 0.01
"""rad, a third of what the corners are off right angles by."""
DRAWS = 400_000
UNCHECKED = AccelerometerSettings(max_amplification=np.inf, max_norm_sd=np.inf, spare_attitudes=0)
"""A fit that only has to converge."""

DATA = "computed; no data needed"


def cosines(angles: Array) -> Array:
    """Return the Gram matrix of unit axes that meet at angles phi (xy), psi (xz), theta (yz), (3, 3)."""
    a, b, c = np.cos(angles)
    return np.array([[1.0, a, b], [a, 1.0, c], [b, c, 1.0]])


def true_norm(readings: Array, angles: Array) -> Array:
    """Return the norm (n,) of what axes at these angles read, (n, 3) (Eq. 4, 7 and 10)."""
    return np.asarray(np.sqrt(np.einsum("ni,ij,nj->n", readings, np.linalg.inv(cosines(angles)), readings)))


def relative_errors(readings: Array, angles: Array) -> Array:
    """Return |a_nonorth - a_orth| / a_nonorth of readings (n, 3), (n,)."""
    truth = true_norm(readings, angles)
    return np.asarray(np.abs(truth - np.linalg.norm(readings, axis=1)) / truth)


def extremes(angles: Array) -> Array:
    """Return the relative error along each principal axis of a triad, (3,): by its eigenvalues, exactly.

    Of unit true norm, readings have the norm sqrt(u' G u), which lies between the roots of G's eigenvalues.
    """
    return np.asarray(np.abs(np.sqrt(np.linalg.eigvalsh(cosines(angles))) - 1.0))


def worst_numerically(gravity: float, seed: int) -> tuple[float, Array, Array]:
    """Solve problem 1 by search from many starts: return the error, m/s^2, the readings and the angles."""
    from scipy.optimize import minimize  # noqa: PLC0415 - for those who evaluate

    right = np.pi / 2.0
    rng = np.random.default_rng(seed)

    def split(x: Array) -> tuple[Array, Array]:
        angles = x[3:]
        return x[:3] * gravity / true_norm(x[None, :3], angles)[0], angles

    def cost(x: Array) -> float:
        readings, _ = split(x)
        return -abs(gravity - float(np.linalg.norm(readings)))

    bounds = [(-1.0, 1.0)] * 3 + [(right * (1.0 - LIMIT), right * (1.0 + LIMIT))] * 3
    runs = []
    for _ in range(24):
        start = np.r_[rng.uniform(-1.0, 1.0, 3), right * rng.uniform(1.0 - LIMIT, 1.0 + LIMIT, 3)]
        runs.append(minimize(cost, start, bounds=bounds, method="SLSQP", options={"ftol": 1e-14}))
    best = min(runs, key=lambda run: float(run.fun))
    readings, angles = split(best.x)
    return -float(best.fun), readings, angles


def worst_by_corners() -> float:
    """Return the largest relative error of all corners of the allowed angles."""
    right = np.pi / 2.0
    corners = product((right * (1.0 - LIMIT), right * (1.0 + LIMIT)), repeat=3)
    return max(float(extremes(np.array(corner)).max()) for corner in corners)


def left_out() -> list[tuple[int, float, float]]:
    """Return per printed table the largest error of the norm, share of g, of 6 and of 9 parameters."""
    found = []
    for number in (1, 2, 3):
        forces = dataset(number)
        errors = []
        for parameters in (6, 9):
            fit = accelerometer.fit(forces, None, ESGI_GRAVITY, parameters=parameters)
            norms = np.linalg.norm(fit.model.apply(forces), axis=1)
            errors.append(float(np.abs(norms / ESGI_GRAVITY - 1.0).max()))
        found.append((number, errors[0], errors[1]))
    return found


def as_assumed() -> list[float]:
    """Return how many times the largest error falls with the angles fitted, with axes off by the full 2 %.

    By table: its own attitudes and its own scatter about the fit, read by axes at FIG3_ANGLES.
    """
    axes = np.linalg.cholesky(cosines(FIG3_ANGLES))
    gains = []
    for number in (1, 2, 3):
        calibrated = accelerometer.fit(dataset(number), None, ESGI_GRAVITY, parameters=9).model.apply(
            dataset(number)
        )
        forces = calibrated @ axes.T
        errors = []
        for parameters in (6, 9):
            fit = accelerometer.fit(forces, None, ESGI_GRAVITY, parameters=parameters, settings=UNCHECKED)
            norms = np.linalg.norm(fit.model.apply(forces), axis=1)
            errors.append(float(np.abs(norms / ESGI_GRAVITY - 1.0).max()))
        gains.append(errors[0] / errors[1])
    return gains


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Solve both problems, draw Fig. 3, and see what the angles are worth on the printed tables."""
    error, readings, angles = worst_numerically(STANDARD, seed)
    progress(0.4)
    spread = relative_errors(np.random.default_rng(seed).uniform(-20.0, 20.0, (DRAWS, 3)), FIG3_ANGLES)
    tables = left_out()
    claims = [*_problem_claims(error, readings, angles, seed), *_spread_claims(spread)]
    claims += [*_worth_claims(tables, as_assumed()), _angles_claim(estimated_angles())]
    rows = [(str(n), f"{100 * six:.3f} %", f"{100 * nine:.3f} %") for n, six, nine in tables]
    text = (
        f"{_WORDS} {_drift(error)}\n\n"
        f"{table(('table', '6 parameters (right angles)', '9 parameters'), rows)}\n\n"
        "Largest error of the norm over all positions, fitted to all of them.\n\n"
        + picture(
            _draw(spread, figures),
            "As Fig. 3: errors of readings even over a cube; dashed, the eigenvalues'",
        )
    )
    progress(1.0)
    name = "nonorthogonality"
    return Study(name, "Axes that are not at right angles", tuple(claims), text, (f"{name}.png",), seed)


_WORDS = """Readings of axes with Gram matrix G have the norm sqrt(u' G u) where the force has norm one along
u, so errors lie between the roots of G's eigenvalues less one, and the corners of the allowed angles hold the
worst. The jump of Fig. 3 is the place of the two equal eigenvalues of the sensor's G: a whole plane of
directions errs by that much, and none by more on that side. The paper prints the bounds of the angles as
0.98 pi and 1.02 pi; its solution, 1.60221 = 1.02 pi / 2, shows that pi / 2 is meant."""


def _problem_claims(error: float, readings: Array, angles: Array, seed: int) -> list[Claim]:
    exact = worst_by_corners()
    g_paper = 0.3130299 / exact
    at = f"{np.abs(readings).mean():.5f}; {angles.mean():.5f}"
    return [
        Claim(
            WORK,
            "2.3, problem 1",
            "largest error by non-orthogonality at rest, m/s^2",
            "0.3130299",
            f"{error:.7f}",
            DATA,
            agreement(0.3130299, error, 0.3130299 * 2e-5),
            f"within 2e-5 of it: g is not given, and the printed figure is that of g = {g_paper:.4f}",
            evidence=Evidence.THEORY,
        ),
        Claim(
            WORK,
            "2.3, problem 1",
            "where it is reached: a_x = a_y = a_z; all angles",
            "5.48114; 1.60221",
            at,
            DATA,
            holds(_at_worst(readings, angles)),
            "within 3e-4 m/s^2 and 1e-5 rad: the digits printed, and g",
            evidence=Evidence.THEORY,
        ),
        Claim(
            WORK,
            "2.3, problem 2",
            "largest relative error, %",
            "3.192",
            f"{100 * exact:.4f}",
            DATA,
            agreement(3.192, 100 * exact, 5e-4),
            "the digits printed",
            evidence=Evidence.THEORY,
        ),
        Claim(
            WORK,
            "2.3, problem 2",
            "the same for ranges of 4, 8 and 16 g",
            "approximately the same",
            f"differ by {_scale_effect(seed):.1g}",
            DATA,
            holds(_scale_effect(seed) < 1e-12),
            "rounding alone: the error has no scale",
            evidence=Evidence.THEORY,
        ),
    ]


def _at_worst(readings: Array, angles: Array) -> bool:
    """Tell whether readings and angles are those printed, to their digits and to g's."""
    near = np.abs(np.abs(readings) - 5.48114).max() < 3e-4
    return bool(near and np.abs(angles - 1.60221).max() < 1e-5)


def _scale_effect(seed: int) -> float:
    """Return by how much errors of random readings differ where these are 4, 8 or 16 times as large."""
    readings = STANDARD * np.random.default_rng(seed).uniform(-1.0, 1.0, (1000, 3))
    one = relative_errors(readings, FIG3_ANGLES)
    return max(
        float(np.abs(one - relative_errors(k * readings, FIG3_ANGLES)).max()) for k in (4.0, 8.0, 16.0)
    )


def jump(spread: Array) -> float:
    """Return where a histogram of errors falls most steeply from one bin to the next, of 120 bins."""
    count, edges = np.histogram(spread, bins=120)
    return float(edges[int(np.argmax(count[:-1] - count[1:])) + 1])


def _spread_claims(spread: Array) -> list[Claim]:
    at, exact = jump(spread), np.sort(extremes(FIG3_ANGLES))
    width = float(np.ptp(spread)) / 120.0
    return [
        Claim(
            WORK,
            "2.3, Fig. 3 and 4",
            "the jump in the histogram of relative errors, %",
            "between 1.4 and 1.6",
            f"{100 * at:.2f}; by theory {100 * exact[0]:.3f}",
            f"{DRAWS} readings, even over a cube",
            holds(0.014 <= at <= 0.016 and abs(at - exact[0]) <= 2 * width),
            "within the paper's bounds, and two bins of the double eigenvalue's place",
            evidence=Evidence.SIMULATION,
        ),
        Claim(
            WORK,
            "2.3, Fig. 3",
            "largest error of that sensor, %",
            "about 3 (figure)",
            f"{100 * spread.max():.3f}",
            f"{DRAWS} readings, even over a cube",
            agreement(exact[-1], float(spread.max()), 1e-4),
            f"within 0.01 % of theory, {100 * exact[-1]:.3f} %; the figure is not printed as numbers",
            evidence=Evidence.SIMULATION,
        ),
    ]


def _drift(error: float) -> str:
    """Say what the largest error does to a position; the paper says "catastrophic", without a figure."""
    t = np.arange(0.0, 10.0 + 1e-9, 0.01)
    forces = np.tile([error, 0.0, STANDARD], (t.size, 1))
    path = strapdown(t, np.zeros((t.size, 3)), forces, np.eye(3), STANDARD).position[:, 0]
    marks = ", ".join(f"{np.interp(m, t, path):.2g} m after {m} s" for m in (2, 5, 10))
    return f"Along one level axis the largest error integrates to a position error of {marks}."


def _worth_claims(tables: list[tuple[int, float, float]], assumed: list[float]) -> list[Claim]:
    """Judge what fitting the angles is worth. assumed: times that errors fall with axes off by 2 %."""
    return [
        Claim(
            WORK,
            "2.3",
            "non-orthogonality of up to 2 % is very serious and cannot be neglected",
            "very serious",
            f"error falls {', '.join(f'{g:.1f}' for g in assumed)} times by fitting it",
            "attitudes and scatter of its three tables, read by axes off by 2 %",
            holds(min(assumed) >= 2.0),
            "largest error of each table; holds where it is halved on all three",
            evidence=Evidence.SIMULATION,
        ),
        Claim(
            WORK,
            "2.3",
            "what fitting the angles is worth on its own three tables",
            "-",
            f"error falls {', '.join(f'{six / nine:.2f}' for _, six, nine in tables)} times",
            "its three printed tables",
            Verdict.OPEN,
            "largest error of each table, with six parameters over that with nine",
            evidence=Evidence.PRINTED,
        ),
    ]


def estimated_angles() -> Array:
    """Return the angles that fits to both choices of positions of the printed tables give, (6, 3) rad."""
    return np.array([fit_positions(n, name).angles for n in (1, 2, 3) for name in RANGES])


def _angles_claim(estimated: Array) -> Claim:
    """Judge whether any fit (n, 3) gives the angles that 2.3 calls estimated."""
    nearest = float(np.abs(estimated - FIG3_ANGLES).max(axis=1).min())
    share = FIG3_ANGLES / (np.pi / 2.0)
    return Claim(
        WORK,
        "2.3, Fig. 3",
        "angles estimated by the calibration for the sensor used",
        ", ".join(f"{angle}" for angle in FIG3_ANGLES),
        f"{estimated.min():.3f} to {estimated.max():.3f}, nearest fit off by {nearest:.3f}",
        "its three printed tables, both choices of positions",
        holds(nearest < ANGLE_ROOM),
        f"rad; holds where some fit is within {ANGLE_ROOM:g} on all three, a third of what they are off right"
        " angles by",
        evidence=Evidence.PRINTED,
        cause=Cause(
            f"they are {', '.join(f'{s:.5f}' for s in share)} times pi / 2: the corners of what problem 1"
            " allows, not an estimate",
            shown=bool(np.abs(np.abs(share - 1.0) - LIMIT).max() < 1e-5),
        ),
    )


def _draw(spread: Array, figures: Path) -> str:
    figure, (axis,) = drawing.panels(1)
    axis.hist(100 * spread, bins=120, color=drawing.BLUE)
    for place in extremes(FIG3_ANGLES):
        axis.axvline(100 * place, color=drawing.RED, linestyle="--", linewidth=0.9)
    axis.set(xlabel="relative error, %", ylabel="readings")
    return drawing.save(figure, figures, "nonorthogonality")
