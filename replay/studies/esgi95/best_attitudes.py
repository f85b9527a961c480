"""Where to lay a phone to calibrate it, and how far its parameters can be trusted.

ESGI'95, 2.5, names both as future work. Best is D-optimal: the attitudes whose information on nine parameters
has the largest determinant (Kiefer and Wolfowitz 1960). The product names the next one by the same measure.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer import observability
from stillcal.calib_core.accelerometer.parameters import basis, norm_rows
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.static.rest import directions
from stillcal.replay.phone import Phone, draw_rests, load_phone
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
from stillcal.replay.studies.esgi95.published import RANGES, dataset
from stillcal.replay.studies.methods.esgi import ESGI_GRAVITY, AxisAngleSettings, fit_axis_angles

WORK, WHERE = "ESGI'95", "2.5"
PARAMETERS = 9
REPEATS = 300


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """Weights (n,) on directions (n, 3), their sum one, and the largest variance that they leave, in p's."""

    directions: Array
    weights: Array
    worst: float


def information(directions: Array, weights: Array | None = None) -> Array:
    """Return the information (9, 9) of attitudes, unit vectors (n, 3), a weighted mean over them."""
    rows = norm_rows(directions, basis(PARAMETERS))
    weights = np.full(len(rows), 1.0 / len(rows)) if weights is None else weights
    return np.asarray(rows.T @ (weights[:, None] * rows))


def optimum(candidates: Array, rounds: int = 4000) -> Design:
    """Return the D-optimal weights on candidates (n, 3) by Titterington's multiplication (1976)."""
    rows = norm_rows(candidates, basis(PARAMETERS))
    weights = np.full(len(rows), 1.0 / len(rows))
    for _ in range(rounds):
        weights = weights * _variances(rows, information(candidates, weights)) / PARAMETERS
        weights /= weights.sum()
    return Design(candidates, weights, float(_variances(rows, information(candidates, weights)).max()))


def efficiency(directions: Array, best: Array) -> float:
    """Return the D-efficiency of attitudes (n, 3) against the information of the optimum."""
    sign, log = np.linalg.slogdet(information(directions))
    return 0.0 if sign <= 0 else float(np.exp((log - np.linalg.slogdet(best)[1]) / PARAMETERS))


def best_of(n: int, seed: int, starts: int = 12) -> Array:
    """Return n attitudes of the largest determinant found by exchanges, (n, 3) (Fedorov 1972)."""
    candidates, rng = observability.sphere(), np.random.default_rng(seed)
    rows = norm_rows(candidates, basis(PARAMETERS))
    found: list[tuple[float, NDArray[np.int64]]] = []
    for _ in range(starts):
        held = rng.choice(len(candidates), n, replace=False)
        while True:
            new = _exchanged(rows, held)
            if np.array_equal(new, held):
                break
            held = new
        found.append((float(np.linalg.slogdet(rows[held].T @ rows[held])[1]), held))
    return candidates[max(found, key=lambda pair: pair[0])[1]]


def greedy(n: int) -> Array:
    """Return the first n attitudes that the product asks for where it has none, (n, 3)."""
    held = np.empty((0, 3))
    for _ in range(n):
        held = np.vstack((held, observability.most_helpful_attitude(held, PARAMETERS).up))
    return held


def icosahedron() -> Array:
    """Return the 12 corners of an icosahedron, unit vectors: an even design, exactly D-optimal."""
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    first = np.array([[0.0, s, t * golden] for s in (1, -1) for t in (1, -1)])
    corners = np.vstack([np.roll(first, k, axis=1) for k in range(3)])
    return np.asarray(corners / np.linalg.norm(corners, axis=1, keepdims=True))


def coverage(seed: int, wander: bool, repeats: int = REPEATS) -> tuple[Array, Array, Array]:
    """Return scatter, mean stated sd and share held, (9,), of calibrations in dataset 1's positions 1-20.

    wander: whether the phone's noise has its 1/f part. Errors are those of the fit from its mean, in the nine
    symmetric parameters; shares of 95 % intervals.
    """
    up = directions(dataset(1)[RANGES["1-20"]])
    phone, found, stated = _phone(wander), [], []
    for number in range(repeats):
        draws = draw_rests(phone, len(up), seed * 10_007 + number, attitudes=up, duration_s=20.0)
        fit = accelerometer.fit(draws.forces, draws.uncertainties, draws.gravity, parameters=9)
        model = np.r_[fit.model.bias, fit.model.scale.ravel()]
        found.append(basis(9).T @ model / np.array([1.0] * 6 + [2.0] * 3))
        stated.append(np.sqrt(np.diag(fit.covariance)))
    errors, sd = np.array(found) - np.mean(found, axis=0), np.array(stated)
    return errors.std(axis=0, ddof=1), sd.mean(axis=0), (np.abs(errors) <= 1.96 * sd).mean(axis=0)


def _phone(wander: bool) -> Phone:
    phone = load_phone("typical")
    if wander:
        return phone
    noise = msgspec.structs.replace(phone.accel.noise, flicker=0.0)
    return msgspec.structs.replace(phone, accel=msgspec.structs.replace(phone.accel, noise=noise))


def upright_added() -> tuple[float, float]:
    """Return dataset 3's largest relative error by positions 3-23, and with position 1 (upright) as well."""
    table3 = dataset(3)
    settings = AxisAngleSettings(cost="norm", signs=(-1, -1, -1))
    rows = np.arange(2, 23)
    errors = []
    for chosen in (rows, np.r_[0, rows]):
        fit = fit_axis_angles(table3[chosen], ESGI_GRAVITY, settings)
        errors.append(float(np.abs(fit.relative_errors(table3, ESGI_GRAVITY)).max()))
    return errors[0], errors[1]


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Find the best attitudes, rank others by them, and test the uncertainties that fits state."""
    design = optimum(observability.sphere())
    best = information(design.directions, design.weights)
    progress(0.3)
    sets = {
        f"dataset {n}, positions {name}": directions(dataset(n)[rows])
        for n in (1, 2, 3)
        for name, rows in RANGES.items()
    }
    sets |= {
        "six faces": observability.places()[:6],
        "faces, edges and corners of a cube": observability.places(),
    }
    sets |= {"icosahedron": icosahedron()}
    sets |= {f"best {n} by exchange": best_of(n, seed) for n in (9, 10, 12, 20)}
    sets |= {f"first {n} that stillcal asks for": greedy(n) for n in (9, 12, 20)}
    progress(0.6)
    rows = [_row(name, up, best) for name, up in sets.items()]
    claims = [
        _optimum_claim(design),
        _greedy_claim(sets),
        _paper_claim(sets, best),
        _upright_claim(*upright_added()),
    ]
    claims += [_uncertainty_claim(seed, wander) for wander in (False, True)]
    text = _TEXT.format(
        sets=table(("attitudes", "number", "D-efficiency", "worst standard error"), rows),
        first="; ".join(observability.describe(up) for up in greedy(2)),
        picture=picture(_draw(sets, best, figures), "D-efficiency of attitudes for nine parameters"),
    )
    progress(1.0)
    name = "best-attitudes"
    return Study(name, "Best attitudes and uncertainty", tuple(claims), text, (f"{name}.png",), seed)


def _row(name: str, up: Array, best: Array) -> tuple[str, ...]:
    return name, str(len(up)), f"{efficiency(up, best):.2f}", f"{observability.amplification(up):.2f}"


def _variances(rows: Array, held: Array) -> Array:
    """Return the variance that information (9, 9) leaves along each row (n, 9)."""
    return np.asarray(np.einsum("ij,ij->i", rows, np.linalg.solve(held, rows.T).T))


_TEXT = """D-efficiency: the share of rests that the best attitudes would need for the same determinant. Worst
standard error: of the norm of a calibrated force along the worst direction, in units of one rest's noise.

{sets}

The best are spread evenly: twelve as an icosahedron's corners reach the optimum exactly; six faces do not
show the angles at all. From nothing, `stillcal` asks first: {first}.

{picture}"""


def _exchanged(rows: Array, held: NDArray[np.int64]) -> NDArray[np.int64]:
    """Replace each held row in turn by the candidate that most raises the determinant."""
    held = held.copy()
    for k in range(held.size):
        others = np.delete(held, k)
        info = rows[others].T @ rows[others] + 1e-9 * np.eye(rows.shape[1])
        gain = np.einsum("ij,ij->i", rows, np.linalg.solve(info, rows.T).T)
        if gain.max() > gain[held[k]] * (1.0 + 1e-9):
            held[k] = int(gain.argmax())
    return held


def _optimum_claim(design: Design) -> Claim:
    even = efficiency(icosahedron(), information(design.directions, design.weights))
    return Claim(
        WORK,
        WHERE,
        "the optimal positions should be determined",
        "left open",
        f"even ones: 12 as an icosahedron, D-efficiency {even:.4f}; largest variance of the optimum"
        f" {design.worst:.4f}",
        "theory; 426 candidates",
        Verdict.OPEN,
        "the equivalence theorem: an optimum leaves a largest variance equal to the number of parameters, 9",
        evidence=Evidence.THEORY,
    )


def agrees_with_brute_force(up: Array) -> bool:
    """Tell whether the attitude that the product names raises the determinant more than any other place."""
    named = observability.most_helpful_attitude(up, PARAMETERS).up
    ridge = 1e-6 * np.eye(PARAMETERS)

    def log_determinant(place: Array) -> float:
        held = np.vstack((up, place))
        return float(np.linalg.slogdet(len(held) * information(held) + ridge)[1])

    values = [log_determinant(place) for place in observability.places()]
    return bool(log_determinant(named) >= max(values) - 2e-3)


def _greedy_claim(sets: dict[str, Array]) -> Claim:
    tested = [up for name, up in sets.items() if name.startswith("dataset") or name == "six faces"]
    right = sum(agrees_with_brute_force(up) for up in tested)
    return Claim(
        WORK,
        WHERE,
        "which attitude to add: the one that stillcal names is the best of 26",
        "left open",
        f"{right} of {len(tested)}",
        "the attitudes of its tables, and six faces",
        Verdict.OPEN,
        "brute force over all 26 places; ties within 0.1 % of variance count",
        evidence=Evidence.ARITHMETIC,
    )


def _paper_claim(sets: dict[str, Array], best: Array) -> Claim:
    found = {name: efficiency(up, best) for name, up in sets.items() if name.startswith("dataset")}
    least = min(found, key=lambda name: found[name])
    return Claim(
        WORK,
        "2.4",
        "distinct positions matter: dataset 3's positions 3-23 are the worst choice",
        "0.98 % of error",
        f"least efficient: {least}, {found[least]:.2f}; others"
        f" {min(v for k, v in found.items() if k != least):.2f} to {max(found.values()):.2f}",
        "its printed tables",
        holds(least == "dataset 3, positions 3-23"),
        "the least D-efficient of the six choices",
        evidence=Evidence.PRINTED,
    )


def _upright_claim(before: float, after: float) -> Claim:
    """Judge what 3-23's largest error, a share, becomes with position 1 added and both like ones kept."""
    named = observability.most_helpful_attitude(directions(dataset(3)[RANGES["3-23"]]), PARAMETERS)
    return Claim(
        WORK,
        "2.4",
        "dataset 3, 3-23: two like positions bias the fit",
        "0.98 % with both, 0.26 % with one",
        f"{100 * before:.2f} %; with position 1 added {100 * after:.2f} %, positions 3 and 21 both kept",
        "its table 3",
        holds(after > 0.5 * before),
        "would hold where more than half of the error stays with both like positions kept",
        evidence=Evidence.PRINTED,
        cause=Cause(
            f"position 1 added, both kept: the error falls to {after / before:.0%}, so that it is the missing"
            f" attitude, not the likeness; {named.words} is what stillcal asks for",
            shown=after <= 0.5 * before,
        ),
    )


def _uncertainty_claim(seed: int, wander: bool) -> Claim:
    scatter, stated, held = coverage(seed, wander)
    ratio, room = stated / scatter, 3.0 * np.sqrt(0.95 * 0.05 / REPEATS)
    kind = "white noise and 1/f" if wander else "white noise alone"
    why = f"right would be 95 %, within {room:.1%}, three errors of {REPEATS} repeats"
    if wander:
        why += (
            f"; what 1/f noise keeps through a whole session moves the bias by {scatter[:3].mean():.1g} m/s^2"
            " and no rest of that session shows it, and takes less from the scale than is stated"
        )
    return Claim(
        WORK,
        WHERE,
        f"the error with which the parameters are found, {kind}",
        "left open",
        f"stated over actual {ratio.min():.2f} to {ratio.max():.2f}; 95 % intervals hold "
        f"{100 * held.min():.0f} to {100 * held.max():.0f} %",
        f"{REPEATS} simulated calibrations, attitudes of dataset 1, 1-20",
        Verdict.OPEN,
        why,
        evidence=Evidence.SIMULATION,
    )


def _draw(sets: dict[str, Array], best: Array, figures: Path) -> str:
    figure, (axis,) = drawing.panels(1)
    names = list(sets)[::-1]
    kinds = (("dataset", drawing.RED), ("first", drawing.BLUE))
    colours = [next((c for word, c in kinds if n.startswith(word)), drawing.GREY) for n in names]
    values = [efficiency(sets[n], best) for n in names]
    axis.barh(names, values, color=colours)
    for row, value in enumerate(values):
        if value == 0.0:
            axis.text(0.01, row, "cannot be fitted: the angles are not seen", va="center", fontsize="small")
    figure.set_size_inches(7.0, 4.4)
    axis.set(xlabel="D-efficiency", xlim=(0.0, 1.02))
    for colour, label in (
        (drawing.RED, "of the report"),
        (drawing.BLUE, "stillcal's"),
        (drawing.GREY, "others"),
    ):
        axis.barh([names[0]], [0.0], color=colour, label=label)
    figure.legend(loc="outside upper right", ncols=3)
    axis.grid(visible=False, axis="y")
    axis.tick_params(axis="y", labelsize="small")
    return drawing.save(figure, figures, "best-attitudes")
