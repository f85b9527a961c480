"""Allan deviation: slopes of each noise, agreement with allantools, and N, B, K found from a curve.

Collin et al. 2019, 2.1.2. Records are of the simulated phone's own noise, whose amplitudes are known.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.noise.allan import FLOOR, AllanCurve, allan_curve, fit_allan
from stillcal.replay.phone.noise import Wander, White, flicker_bank, seeded
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import Claim, Evidence, Progress, Study, Verdict, holds, picture, table

WORK = "Collin 2019"
NAMES = ("N", "B", "K")
TRUTH = (0.025, 0.0025, 1e-4)
"""N, B, K of the records, such as a consumer gyroscope has in deg/s: a floor that three noises share."""
RATE, HOURS, RECORDS = 10.0, 4.0, 40
FEW = 10.0
"""Degrees of freedom below which a point of a curve says little."""


@dataclass(frozen=True, slots=True, eq=False)
class Recovered:
    """What three-axis records gave.

    fitted, read: (n, 3) of N, B, K over truth; errors: (n, 3) of the fit's
    logarithms; held: share of points whose band holds the mean curve; curve: one of them.
    """

    fitted: Array
    read: Array
    errors: Array
    held: float
    curve: AllanCurve


def record(truth: tuple[float, float, float], duration: float, rate: float, seed: int) -> Array:
    """Return white, flicker and random-walk noise of N, B, K as a sensor of the simulated phone has it."""
    n, b, k = (np.full(3, value) for value in truth)
    t = np.arange(int(duration * rate)) / rate
    wander = Wander(flicker_bank(b), k, seed, "allan")
    return White(n * np.sqrt(rate), 0.0, 1.0, seeded(seed, "allan", "white")).draw(t.size) + wander.at(t)


def read_slopes(curve: AllanCurve) -> Array:
    """Return N, B, K as tools read them off: a line of slope -1/2, 0, 1/2 where the curve comes nearest."""
    slope = np.diff(np.log(curve.deviation)) / np.diff(np.log(curve.tau))
    tau, deviation = curve.tau, curve.deviation
    rows = [int(np.abs(slope - wanted).argmin()) for wanted in (-0.5, 0.0, 0.5)]
    n, b, k = (deviation[row] for row in rows)
    return np.array([n * np.sqrt(tau[rows[0]]), b / FLOOR, k / np.sqrt(tau[rows[2]] / 3.0)])


def recover(records: int, seed: int, progress: Progress, hours: float = HOURS) -> Recovered:
    """Draw records and find N, B and K from each axis by both ways."""
    curves, fits = [], []
    for number in range(records):
        values = record(TRUTH, hours * 3600.0, RATE, seed * 100_003 + number)
        curves += [allan_curve(column, RATE) for column in values.T]
        progress((number + 1) / records)
    fits = [fit_allan(curve) for curve in curves]
    mean = np.sqrt(np.mean([c.deviation**2 for c in curves], axis=0))
    held = np.mean([(c.low <= mean) & (mean <= c.high) for c in curves])
    return Recovered(
        np.array([(f.N, f.B, f.K) for f in fits]) / TRUTH,
        np.array([read_slopes(c) for c in curves]) / TRUTH,
        np.array([f.errors for f in fits]),
        float(held),
        curves[0],
    )


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Compare curves with allantools, and two ways to read them with the truth."""
    found = recover(RECORDS, seed, lambda share: progress(0.9 * share))
    file = _draw(found, figures)
    records = f"{RECORDS} simulated records of {HOURS:.0f} h, 3 axes, {RATE:.0f} Hz"
    claims = (
        *_slope_claims(seed),
        *_fit_claims(found, records),
    )
    text = _text(found, records, file, _library(seed))
    progress(1.0)
    return Study("allan", "Allan deviation", claims, text, (file,), seed)


def _slope_claims(seed: int) -> list[Claim]:
    cases = (
        ("white noise falls as the root of averaging time", (1.0, 0.0, 0.0), -0.5, 1.0, 300.0),
        ("1/f noise levels off", (0.0, 1.0, 0.0), 0.0, 8.0, 300.0),
        ("rate random walk rises as its root", (0.0, 0.0, 1.0), 0.5, 1.0, 300.0),
    )
    return [_slope_claim(claim, truth, slope, (low, high), seed) for claim, truth, slope, low, high in cases]


def _slope_claim(
    claim: str, truth: tuple[float, float, float], slope: float, span: tuple[float, float], seed: int
) -> Claim:
    """Fit the slope of each axis of several records; the scatter over them is the tolerance."""
    slopes = []
    for number in range(8):
        for column in record(truth, 14400.0, 2.0, seed * 7919 + number).T:
            curve = allan_curve(column, 2.0)
            rows = (curve.tau >= span[0]) & (curve.tau <= span[1])
            slopes.append(np.polyfit(np.log(curve.tau[rows]), np.log(curve.deviation[rows]), 1)[0])
    ours, error = float(np.mean(slopes)), float(np.std(slopes, ddof=1) / np.sqrt(len(slopes)))
    room = 3.0 * error + 0.02
    return Claim(
        WORK,
        "2.1.2, Fig. 2",
        claim,
        f"slope {slope:+.1f}",
        f"{ours:+.3f} +- {error:.3f}",
        "24 simulated records of 4 h",
        holds(abs(ours - slope) <= room),
        f"within {room:.3f}: three standard errors, and 0.02 as ten processes are not quite 1/f",
        evidence=Evidence.SIMULATION,
    )


def _library(seed: int) -> str:
    """Say how far a curve is from allantools'."""
    if importlib.util.find_spec("allantools") is None:
        return "allantools is not installed here."
    worst = library_difference(record(TRUTH, 7200.0, RATE, seed)[:, 0])
    return f"The overlapping Allan deviation is that of allantools to {worst:.0e} of it (one record of 2 h)."


def library_difference(values: Array) -> float:
    """Return the largest relative difference from allantools' oadev."""
    import allantools  # noqa: PLC0415 - needed by this comparison only

    curve = allan_curve(values, RATE)
    theirs = allantools.oadev(values, rate=RATE, data_type="freq", taus=np.array(curve.tau))
    if theirs[1].shape != curve.deviation.shape:
        return float("inf")
    return float(np.abs(theirs[1] / curve.deviation - 1.0).max())


def _fit_claims(found: Recovered, data: str) -> list[Claim]:
    claims = []
    for axis, name in enumerate(NAMES):
        fit, read = rms_error(found.fitted[:, axis]), rms_error(found.read[:, axis])
        claims.append(
            Claim(
                WORK,
                "2.1.2, Fig. 2",
                f"{name} is found from a curve",
                "read off its slopes",
                f"fitted to all of it: {np.median(found.fitted[:, axis]):.2f} of the truth, rms {fit:.0%};"
                f" read off: {np.median(found.read[:, axis]):.2f}, rms {read:.0%}",
                data,
                Verdict.OPEN,
                "the paper does not say how well; medians and rms relative errors",
                evidence=Evidence.SIMULATION,
            )
        )
    return claims


def rms_error(ratios: Array) -> float:
    """Return the rms relative error of ratios to truth."""
    return rms(ratios - 1.0)


def _text(found: Recovered, data: str, file: str, library: str) -> str:
    rows = []
    for axis, name in enumerate(NAMES):
        for way, ratios in (("fitted", found.fitted[:, axis]), ("read off", found.read[:, axis])):
            marks = np.percentile(ratios * TRUTH[axis], [5, 50, 95])
            rows.append(
                (name, f"{TRUTH[axis]:g}", way, *(f"{m:.3g}" for m in marks), f"{rms_error(ratios):.0%}")
            )
    within = np.abs(np.log(found.fitted)) <= 1.96 * found.errors
    covered = ", ".join(f"{name} {share:.0%}" for name, share in zip(NAMES, within.mean(axis=0), strict=True))
    head = ("", "true", "way", "5 %", "median", "95 %", "rms error")
    return "\n\n".join(
        [
            f"N, B and K of {data}; the floor is shared by three noises, as is common in phones, so that the"
            " curve's least value is not the flicker's alone and no stretch of it has any one slope. The fit"
            " is right on average. K is what a record of this length shows least: in"
            f" {np.mean(found.fitted[:, 2] < 0.2):.0%} of the records the fit finds next to none of it, and"
            " says so by an open interval; a reading always finds some, and too much.",
            table(head, rows),
            f"The fit's 95 % intervals hold the truth for {covered} of the records. In the figure the fit"
            f" leaves the last points: they are of few bins (shaded: under {FEW:.0f} degrees of freedom),"
            " weigh little, and lie below the truth more often than above it.",
            f"Our own checks, of which the paper says nothing: {library} The 68 % bands hold the mean curve"
            f" at {found.held:.1%} of points.",
            picture(file, "An Allan deviation with its band, and N, B, K over truth by both ways"),
        ]
    )


def _draw(found: Recovered, figures: Path) -> str:
    figure, (left, right) = drawing.panels(2)
    curve, fit = found.curve, fit_allan(found.curve)
    left.fill_between(
        curve.tau, curve.low, curve.high, color=drawing.BLUE, alpha=0.25, linewidth=0, label="68 %"
    )
    left.loglog(curve.tau, curve.deviation, ".", color=drawing.BLUE, label="measured")
    left.loglog(curve.tau, fit.deviation(curve.tau), color=drawing.RED, label="fit")
    for part, name in zip(np.diag(TRUTH), NAMES, strict=True):
        alone = np.sqrt(part[0] ** 2 / curve.tau + (FLOOR * part[1]) ** 2 + part[2] ** 2 * curve.tau / 3.0)
        left.loglog(curve.tau, alone, ":", color=drawing.GREY)
        left.annotate(name, (curve.tau[-1 if name == "K" else 0], alone[-1 if name == "K" else 0]))
    left.plot([], [], ":", color=drawing.GREY, label="true parts")
    left.set(xlabel="averaging time, s", ylabel="Allan deviation, deg/s", ylim=(curve.low.min() / 4, None))
    few = curve.tau[curve.edf < FEW]
    left.axvspan(few[0], few[-1], color="0.92", zorder=0, label="few bins, little weight")
    left.legend(fontsize="small")
    places = np.arange(3)
    for shift, colour, values, label in (
        (-0.17, drawing.RED, found.fitted, "fitted"),
        (0.17, drawing.GREY, found.read, "read off"),
    ):
        parts = right.boxplot(
            list(values.T),
            positions=places + shift,
            widths=0.3,
            whis=(5, 95),
            showfliers=False,
            patch_artist=True,
            medianprops={"color": "black"},
        )
        for box in parts["boxes"]:
            box.set(facecolor=colour, alpha=0.6)
        right.plot([], [], "s", color=colour, alpha=0.6, label=label)
    right.axhline(1.0, color="black", linewidth=0.8)
    right.set(ylabel="found over true", yscale="log")
    right.set_yticks([0.5, 0.7, 1.0, 1.5, 2.0, 3.0], ["0.5", "0.7", "1", "1.5", "2", "3"])
    right.minorticks_off()
    right.set_xticks(places, NAMES)
    right.legend()
    return drawing.save(figure, figures, "allan")
