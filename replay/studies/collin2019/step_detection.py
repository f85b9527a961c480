"""Steps found from the norm of the force: against the simulated walker's own, and on real walkers' spectra.

Collin et al. 2019, 3.2 and Fig. 4, Eq. 13. A window's strongest frequency tells a real walker's cadence by
itself.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.phone import Scenario, load_phone, simulate
from stillcal.replay.phone.activities.carried import Carry, Drive, Walk
from stillcal.replay.phone.activities.resting import Table
from stillcal.replay.phone.motion.trajectory import Waves
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import Claim, Evidence, Progress, Study, Verdict, holds, picture, table
from stillcal.replay.studies.methods.motion_modes import peak_frequency
from stillcal.replay.studies.methods.steps import detect_steps, patterns, vertical_only

WORK, WHERE = "Collin 2019", "3.2, Fig. 4"
CARRIES: tuple[Carry, ...] = ("pocket", "hand", "bag")
WALK_S = 600.0


def walked(carry: Carry, phone: str, seed: int) -> tuple[float, int, int]:
    """Return how many steps a simulated walker took, by his own cadence, and how many are found.

    Found by the norm of the force, and by its vertical component.
    """
    simulation = simulate(Scenario(segments=(Walk(duration_s=WALK_S, carry=carry),)), load_phone(phone), seed)
    true = 0.0
    for piece in simulation.plan.pieces:
        course = piece.sways[0].course if piece.activity == "walk" and piece.sways else None
        if isinstance(course, Waves):
            true += (piece.t_end - piece.t_start) * float(course.frequency[0])
    samples = simulation.whole().accelerometer
    signals = (samples.xyz, vertical_only(samples.xyz))
    by_norm, by_vertical = (detect_steps(samples.t, forces, STANDARD).start.size for forces in signals)
    return true, by_norm, by_vertical


def false_steps(activity: Drive | Table, seed: int) -> float:
    """Return steps found for each minute of something that is no walk."""
    samples = simulate(Scenario(segments=(activity,)), load_phone("typical"), seed).whole().accelerometer
    return float(detect_steps(samples.t, samples.xyz, STANDARD).start.size / (samples.t[-1] / 60.0))


def real_cadences(data: Path) -> tuple[Array, Array]:
    """Return cadences of UCI HAR's walking windows by their steps (Eq. 13) and by their spectra, (n,) Hz.

    A window without a whole step counts as NaN by its steps.
    """
    with np.load(data / "ucihar" / "ucihar_subset.npz") as found:
        forces = STANDARD * found["test_total_acc"][found["test_y"] == 1].astype(np.float64)
    t = np.arange(forces.shape[1]) / 50.0
    by_steps = []
    for window in forces:
        steps = detect_steps(t, window, STANDARD)
        by_steps.append(float(np.median(patterns(steps, STANDARD)[:, 0])) if steps.start.size else np.nan)
    norms = np.linalg.norm(forces, axis=2)
    return np.array(by_steps), peak_frequency(norms - norms.mean(axis=1, keepdims=True), 50.0)


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Count steps of simulated and real walkers, and of those who do not walk."""
    rows, off = [], []
    for number, (carry, phone) in enumerate(
        (c, p) for c in CARRIES for p in ("ideal", "consumer", "mpu6050")
    ):
        true, *found = walked(carry, phone, seed)
        rows.append((carry, phone, f"{true:.0f}", *map(str, found)))
        off.append([abs(number / true - 1.0) for number in found])
        progress((number + 1) / 12)
    driving, resting = false_steps(Drive(duration_s=600.0), seed), false_steps(Table(duration_s=600.0), seed)
    cadences = None if data is None else real_cadences(data)
    by_norm, by_vertical = np.array(off).T
    claims = (*_count_claims(by_vertical, by_norm), _real_claim(cadences))
    head = ("carried in the", "phone", "steps taken", "found by the norm", "by the vertical")
    text = (
        f"{table(head, rows)}\n\nWhere nobody walks, the detector finds {driving:.1f} steps a minute while"
        f" driving and {resting:.1f} on tables (simulated, 10 min each).\n\n"
    ) + picture(_draw(seed, figures), "As Fig. 4: the norm and the steps found")
    progress(1.0)
    return Study("steps", "Steps", claims, text, ("steps.png",), seed)


def _count_claims(by_vertical: Array, by_norm: Array) -> list[Claim]:
    """Judge shares (k,) that counts are off, by both signals that the paper names."""
    ways = (
        ("a step is easily detected from the vertical acceleration", "easily", by_vertical),
        ("the norm of the acceleration is another possibility", "other possibility", by_norm),
    )
    return [
        Claim(
            WORK,
            WHERE,
            claim,
            paper,
            f"counts off by {100 * off.mean():.1f} % (mean), {100 * off.max():.1f} % at most",
            f"{len(off)} simulated walks of {WALK_S / 60:.0f} min; vertical: along the walk's mean force",
            holds(bool(off.max() < 0.05)),
            "each count within 5 %, in pocket, hand and bag: the paper considers sensors on the torso, and"
            " says that the pattern varies with the place",
            evidence=Evidence.SIMULATION,
        )
        for claim, paper, off in ways
    ]


def _real_claim(cadences: tuple[Array, Array] | None) -> Claim:
    claim = "the main frequency is that of steps or, instead, that of the spectrum"
    if cadences is None:
        return Claim(
            WORK,
            "3.3, Eq. 13",
            claim,
            "alike",
            "-",
            "ucihar",
            Verdict.UNTESTED,
            "the real recordings are not here (--data)",
            evidence=Evidence.NONE,
        )
    steps, spectrum = cadences
    agree = float(np.mean(np.abs(steps - spectrum) <= 0.5 / 2.56 + 0.05 * spectrum))
    return Claim(
        WORK,
        "3.3, Eq. 13",
        claim,
        "alike",
        f"alike in {agree:.0%} of windows; medians {np.nanmedian(steps):.2f} and {np.median(spectrum):.2f}"
        " Hz",
        f"ucihar: {steps.size} windows of walking, 2.56 s",
        holds(agree > 0.9),
        "in over 90 % of windows, within half a bin of the spectrum and 5 %",
        evidence=Evidence.REAL,
    )


def _draw(seed: int, figures: Path) -> str:
    figure, (axis,) = drawing.panels(1)
    scenario = Scenario(segments=(Walk(duration_s=60.0),))
    samples = simulate(scenario, load_phone("typical"), seed).whole().accelerometer
    steps = detect_steps(samples.t, samples.xyz, STANDARD)
    rows = (steps.t > 20.0) & (steps.t < 30.0)
    axis.plot(steps.t[rows], steps.norm[rows], color=drawing.BLUE, label="norm, 25 Hz")
    starts = steps.start[(steps.start > 20.0) & (steps.start < 30.0)]
    axis.plot(starts, np.interp(starts, steps.t, steps.norm), "o", color=drawing.RED, label="step")
    axis.axhline(STANDARD, color=drawing.GREY, linestyle=":", label="g")
    axis.set(xlabel="time, s", ylabel="norm of the force, m/s²")
    axis.legend(loc="upper right", ncols=3)
    axis.set_ylim(top=13.9)
    figure.set_size_inches(7.0, 3.2)
    return drawing.save(figure, figures, "steps")
