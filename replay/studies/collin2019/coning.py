"""Coning as a feature of motion: what is lost where a gyroscope's 20 Hz are averaged to 1 Hz.

Collin et al. 2019, 4.2, Eq. 26-27, Fig. 11 and 12. The paper's recordings are not published; real walking is
that of UCI HAR (a phone at the waist), a real watch that of HHAR (its wearer stands and sits).
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.trace import read_all
from stillcal.replay.phone import Scenario, load_phone, simulate
from stillcal.replay.phone.activities.carried import Drive, Walk
from stillcal.replay.phone.activities.resting import Rest
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
from stillcal.replay.studies.methods.coning import coning_errors

WORK = "Collin 2019"
RATE_HZ, SPAN_S = 20.0, 1.0
BIASES = (0.0, 0.01, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Biases that are tried on a drive, rad/s."""

LARGEST_BIAS = 0.3
"""The largest of them that is not absurd, rad/s: 17 deg/s, sixty times that of Table 1's consumer grade."""


def at_20_hz(t: Array, rates: Array) -> tuple[Array, Array]:
    """Return rates as a 20 Hz gyroscope gives them: means over its intervals, at their middles."""
    edges = np.arange(t[0], t[-1], 1.0 / RATE_HZ)
    rows = np.searchsorted(t, edges)
    total = np.vstack((np.zeros(3), np.cumsum(rates, axis=0)))
    count = np.maximum(np.diff(rows), 1)[:, None]
    return edges[:-1] + 0.5 / RATE_HZ, np.asarray((total[rows[1:]] - total[rows[:-1]]) / count)


def simulated(activity: Walk | Drive | Rest, phone: str, seed: int) -> tuple[Array, Array]:
    """Return 20 Hz rates of a simulated activity, its first ten seconds (the phone is put there) left out."""
    gyro = simulate(Scenario(segments=(activity,)), load_phone(phone), seed).whole().gyroscope
    assert gyro is not None, "the phones have gyroscopes"
    later = gyro.between(10.0, np.inf)
    return at_20_hz(later.t, later.xyz)


def scenarios(seed: int) -> dict[str, tuple[Array, Array]]:
    """Return the simulated stand-ins of Fig. 11: (t, rates) by name."""
    return {
        "walking, simulated": simulated(Walk(duration_s=310.0), "typical", seed),
        "driving, simulated": simulated(Drive(duration_s=310.0), "typical", seed),
        "stationary with a bias, simulated": simulated(Rest(duration_s=310.0), "typical", seed),
    }


def real(data: Path) -> dict[str, Array]:
    """Return coning errors of real recordings, rad: UCI HAR's windows by activity, and HHAR's watch."""
    with np.load(data / "ucihar" / "ucihar_subset.npz") as found:
        rates, label = found["train_body_gyro"].astype(np.float64), found["train_y"]
    t = np.arange(rates.shape[1]) / 50.0
    watch = read_all(data / "hhar" / "Watch_accelerometer.csv.gz", "hhar", None).gyroscope
    out = {
        name: np.concatenate([coning_errors(*at_20_hz(t, window)) for window in rates[np.isin(label, which)]])
        for name, which in (("walking, UCI HAR", [1, 2, 3]), ("standing, UCI HAR", [5]))
    }
    if watch is not None:
        out["watch, standing and sitting, HHAR"] = coning_errors(*at_20_hz(watch.t, watch.xyz))
    return out


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Compare the coning errors of the paper's three scenarios, and what a bias does to them."""
    simulations = scenarios(seed)
    errors = {name: coning_errors(*rates, SPAN_S) for name, rates in simulations.items()}
    progress(0.5)
    errors |= {} if data is None else real(data)
    biased = {bias: _biased(simulations["driving, simulated"], bias) for bias in BIASES}
    rows = [(name, *_marks(e)) for name, e in errors.items()]
    claims = (
        _order_claim(errors),
        _still_claim(errors),
        _bias_claim(biased, walker(errors)),
        _watch_claim(data),
    )
    text = f"{_WORDS}\n\n{table(('', '10 %, deg', 'median', '90 %', 'largest'), rows)}\n\n" + picture(
        _draw(simulations, errors, figures),
        "As Fig. 11 and 12: rates at 20 Hz, coning errors by second",
    )
    progress(1.0)
    return Study("coning", "Coning", claims, text, ("coning.png",), seed)


_WORDS = """The error of each second: the angle between the rotation of all its 20 Hz rates and that of their
mean. No recording of a watch on a walker's wrist is at hand; walking with the phone at the waist or in the
pocket stands in for it, and turns less than a wrist does."""


def _marks(errors: Array) -> tuple[str, ...]:
    return tuple(f"{np.degrees(mark):.2g}" for mark in np.percentile(errors, [10, 50, 90, 100]))


def _order_claim(errors: dict[str, Array]) -> Claim:
    names = (walking_of(errors), "driving, simulated", "stationary with a bias, simulated")
    found = [float(np.degrees(np.median(errors[n]))) for n in names]
    return Claim(
        WORK,
        "4.2, Fig. 12",
        "coning is large on a walker, clearly less in a car, negligible at rest",
        "a watch > a car > a table",
        ", ".join(f"{f:.2g}" for f in found) + " deg (medians)",
        "; ".join(names),
        holds(in_order(found)),
        "each at most a third of the one before",
        evidence=Evidence.SIMULATION,
    )


def in_order(errors: list[float]) -> bool:
    """Tell whether each is at most a third of the one before."""
    return all(3.0 * after < before for before, after in pairwise(errors))


def _still_claim(errors: dict[str, Array]) -> Claim:
    largest = float(np.degrees(errors["stationary with a bias, simulated"].max()))
    return Claim(
        WORK,
        "4.2",
        "a stationary gyroscope with a constant bias has negligible coning error",
        "negligible",
        f"{largest:.1g} deg at most",
        f"simulated rest of 5 min, {_bias():.1f} deg/s of bias",
        holds(largest < 0.01),
        "below 0.01 deg, about what noise turns in a second",
        evidence=Evidence.SIMULATION,
    )


def _bias() -> float:
    """Return the size of the simulated gyroscope's bias, deg/s."""
    gyro = load_phone("typical").gyro
    assert gyro is not None
    return float(np.degrees(np.linalg.norm(gyro.bias)))


def _biased(rates: tuple[Array, Array], bias: float) -> float:
    """Return the median coning error, degrees, with a bias about the axis ahead, rad/s."""
    t, w = rates
    return float(np.degrees(np.median(coning_errors(t, w + np.array([bias, 0.0, 0.0]), SPAN_S))))


def walking_of(errors: dict[str, Array]) -> str:
    """Return the name of the walk among the errors: the real one where it is given."""
    return "walking, UCI HAR" if "walking, UCI HAR" in errors else "walking, simulated"


def walker(errors: dict[str, Array]) -> float:
    """Return the median coning error of a walker, degrees."""
    return float(np.degrees(np.median(errors[walking_of(errors)])))


def _bias_claim(biased: dict[float, float], walking: float) -> Claim:
    """Judge the errors of a drive, degrees, by its bias, against a walker's, which the paper calls large."""
    between = ", ".join(f"{e:.2g} deg with {b:g} rad/s" for b, e in biased.items())
    needed = min((b for b, e in biased.items() if e >= 0.5 * walking), default=np.inf)
    return Claim(
        WORK,
        "4.2",
        "a bias with moderate motion, as in a vehicle, may make a large coning error",
        "may be large",
        f"{biased[LARGEST_BIAS]:.2g} deg with a bias of {LARGEST_BIAS:g} rad/s; a walker's is {walking:.2g}"
        " deg",
        "simulated drive",
        holds(biased[LARGEST_BIAS] >= 0.5 * walking),
        f"large: half of a walker's, which the paper calls quite large, by a bias of {LARGEST_BIAS:g} rad/s"
        f" ({np.degrees(LARGEST_BIAS):.0f} deg/s) or less; medians over seconds",
        evidence=Evidence.SIMULATION,
        cause=Cause(
            f"larger biases: {between}. Half of a walker's error takes {needed:g} rad/s of those tried; the"
            f" simulated gyroscope's own bias is {np.radians(_bias()):.2g} rad/s. What a bias adds is as"
            " large as the car's turns within a second, and those are small",
            shown=needed > LARGEST_BIAS,
        ),
    )


def _watch_claim(data: Path | None) -> Claim:
    return Claim(
        WORK,
        "Fig. 11a, 12a",
        "coning of a watch on a walker's wrist",
        "-",
        "-",
        "" if data is None else "HHAR's watch: its wearer only stands and sits",
        Verdict.UNTESTED,
        "no such recording at hand, and the paper prints no figures",
        evidence=Evidence.NONE,
    )


def _draw(simulations: dict[str, tuple[Array, Array]], errors: dict[str, Array], figures: Path) -> str:
    figure, axes = drawing.panels(3, 2)
    for column, (name, (t, rates)) in enumerate(simulations.items()):
        rows = (t > t[0] + 60.0) & (t < t[0] + 90.0)
        for (axis, colour, _), rate in zip(drawing.AXES, np.degrees(rates[rows]).T, strict=True):
            axes[column].plot(t[rows] - t[rows][0], rate, color=colour, linewidth=0.8, label=axis)
        axes[column].set(title=name.removesuffix(", simulated"), ylabel="rate, deg/s", xlabel="time, s")
        axes[3 + column].plot(np.degrees(errors[name]), linewidth=0.8, color=drawing.BLUE)
        axes[3 + column].set(ylabel="coning error, deg", xlabel="time, s", ylim=(0.0, None))
    axes[0].legend(ncols=3, loc="upper right")
    axes[0].set_ylim(top=1.3 * axes[0].get_ylim()[1])
    return drawing.save(figure, figures, "coning")
