"""Steps found by correlating the norm with a template, beside crossings of g.

Collin et al. 2019, 3.2: the template is formed offline from a sample walk. Every phone and way of carrying is
judged with the one template of a faultless phone in a pocket.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.phone import Scenario, load_phone, simulate
from stillcal.replay.phone.activities.carried import Drive, Walk
from stillcal.replay.phone.activities.resting import Table
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
from stillcal.replay.studies.collin2019.step_detection import CARRIES, WALK_S, walked
from stillcal.replay.studies.har.data import read_windows
from stillcal.replay.studies.methods.motion_modes import peak_frequency
from stillcal.replay.studies.methods.step_template import (
    LEAST,
    RATE_HZ,
    WARP,
    Likeness,
    Template,
    correlation,
    count,
    form,
    places,
    stretched,
    warped,
)
from stillcal.replay.studies.methods.steps import even

NAME, TITLE, WORK, WHERE = "step-template", "Steps by correlation with a template", "Collin 2019", "3.2"
PHONES = ("ideal", "consumer", "mpu6050")
STRICT, SLOWER = 0.9, 1.25
"""A likeness that a step of the template's own pace reaches; times as long a step of another pace takes."""

WINDOWS_HZ, BIN_HZ = 50.0, 0.5 / 2.56
"""Rate of the real windows; half a bin of their spectrum."""


def recorded(carry: str, phone: str, seed: int) -> Samples:
    """Return the forces of a simulated walk, the same that `walked` counts."""
    scenario = Scenario(segments=(Walk(duration_s=WALK_S, carry=carry),))  # type: ignore[arg-type]  # of CARRIES
    return simulate(scenario, load_phone(phone), seed).whole().accelerometer


def real_cadences(data: Path, alike: Likeness) -> tuple[Array, Array]:
    """Return cadences of real walkers by a template and by their spectra, (n,) Hz, NaN below two steps.

    The template is formed from the windows of every other person, and tried on the others'.
    """
    walks = read_windows(data).of("walk")
    learn = np.isin(walks.person, walks.people[::2])
    t = np.arange(walks.accel.shape[1]) / WINDOWS_HZ
    template = form([Samples.checked(Sensor.ACCELEROMETER, t, w) for w in walks.accel[learn]])
    windows = walks.accel[~learn]
    found = [places(np.linalg.norm(even(t, w)[1], axis=1), template, alike) for w in windows]
    cadence = [RATE_HZ / float(np.median(np.diff(own))) if own.size > 1 else np.nan for own in found]
    norms = np.linalg.norm(windows, axis=2)
    return np.array(cadence), peak_frequency(norms - norms.mean(axis=1, keepdims=True), WINDOWS_HZ)


def false_counts(activity: Drive | Table, template: Template, seed: int) -> float:
    """Return steps found for each minute of something that is no walk."""
    samples = simulate(Scenario(segments=(activity,)), load_phone("typical"), seed).whole().accelerometer
    return count(samples, template) / float(samples.t[-1] / 60.0)


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Count the steps of simulated walks by template and by crossings of g."""
    template = form([recorded("pocket", "ideal", seed + 1)])
    cells = [(carry, phone) for carry in CARRIES for phone in PHONES]
    true, crossed, matched, bent = np.zeros((4, len(cells)))
    strict, slower = np.zeros((2, len(cells))), stretched(template, SLOWER)
    for k, (carry, phone) in enumerate(cells):
        true[k], crossed[k], _ = walked(carry, phone, seed)
        walk = recorded(carry, phone, seed)
        matched[k], bent[k] = (count(walk, template, alike) for alike in (correlation, warped))
        strict[:, k] = [count(walk, slower, alike, STRICT) / true[k] - 1.0 for alike in (correlation, warped)]
        progress((k + 1) / len(cells))
    driving = false_counts(Drive(duration_s=WALK_S), template, seed)
    resting = false_counts(Table(duration_s=WALK_S), template, seed)
    off, bent_off = matched / true - 1.0, bent / true - 1.0
    rows = [
        (carry, phone, f"{t:.0f}", f"{c:.0f}", f"{m:.0f}", f"{w:.0f}")
        for (carry, phone), t, c, m, w in zip(cells, true, crossed, matched, bent, strict=True)
    ]
    claim = Claim(
        WORK,
        WHERE,
        "steps can be detected by correlating with a template formed from a sample walk",
        "can be used",
        f"counts off by {100 * np.mean(np.abs(off)):.1f} % (mean), {100 * np.abs(off).max():.1f} % at most",
        f"{len(cells)} simulated walks of {WALK_S / 60:.0f} min; template of another walk, in the pocket",
        holds(bool(np.abs(off).max() < 0.05)),
        f"each count within 5 %, as for crossings of g; {_cause(cells, off)}",
        evidence=Evidence.SIMULATION,
    )
    file = _draw(template, figures)
    text = "\n\n".join(
        [
            f"A step is a place where the norm, at {RATE_HZ:g} Hz, correlates with the template by {LEAST:g}"
            " or more, and more than around it. A correlation does not see how large the signal is. Where"
            f" nobody walks it finds {driving:.0f} steps a minute while driving and {resting:.0f} on tables"
            " (crossings of g: see `steps`), so it needs a test of size beside it. *Warped*: 1 - D²/2, D the"
            " distance to the template by dynamic time warping, which without warping is the correlation.",
            table(("carried in the", "phone", "steps taken", "crossings of g", "template", "warped"), rows),
            picture(file, "The template: mean of a sample walk's steps"),
        ]
    )
    return Study(
        NAME,
        TITLE,
        (claim, _better(cells, off, bent_off, strict, template.shape.size), _real(data)),
        text,
        (file,),
        seed,
    )


def _better(cells: Sequence[tuple[str, str]], off: Array, bent_off: Array, strict: Array, size: int) -> Claim:
    """Compare the counts of warping with those of correlation, shares (k,) off the truth.

    strict: (2, k), of correlation and of warping, by STRICT and a template of another pace.
    """
    tight = [float(np.mean(np.abs(own))) for own in strict]
    return Claim(
        WORK,
        WHERE,
        "the correlation can be improved by dynamic time warping",
        "can be improved",
        f"counts off by {100 * np.mean(np.abs(bent_off)):.1f} %, by correlation"
        f" {100 * np.mean(np.abs(off)):.1f} % (means)",
        f"the same {len(cells)} walks; a sample put up to {WARP} of {size} off",
        holds(bool(np.mean(np.abs(bent_off)) < np.mean(np.abs(off)))),
        f"holds where the mean is smaller; {_cause(cells, bent_off)}",
        evidence=Evidence.SIMULATION,
        cause=Cause(
            f"a step is a likeness of {LEAST:g} and more here, by which correlation misses none, so that none"
            f" is lacking: it finds {100 * np.mean(off):+.1f} % more steps than were taken, warping"
            f" {100 * np.mean(bent_off):+.1f} %. Where {STRICT:g} is asked for and the template is of"
            f" a pace {100 * (SLOWER - 1.0):.0f} % slower, correlation is off by"
            f" {100 * tight[0]:.1f} % and warping by {100 * tight[1]:.1f} %",
            shown=tight[1] < 0.5 * tight[0] and bool(np.mean(off) >= 0.0),
        ),
    )


def _real(data: Path | None) -> Claim:
    claim = "the same on real walkers, with the template of other people"
    if data is None:
        why = "the real recordings are not here (--data)"
        return Claim(
            WORK, WHERE, claim, "can be used", "", "none", Verdict.UNTESTED, why, evidence=Evidence.NONE
        )
    shares = []
    for alike in (correlation, warped):
        steps, spectrum = real_cadences(data, alike)
        shares.append(float(np.mean(np.abs(steps - spectrum) <= BIN_HZ + 0.05 * spectrum)))
    doubled = float(np.mean(np.abs(2.0 * steps - spectrum) <= BIN_HZ + 0.05 * spectrum))
    return Claim(
        WORK,
        WHERE,
        claim,
        "can be used",
        f"cadence as the spectrum's in {shares[0]:.0%} of windows; warped {shares[1]:.0%}",
        f"ucihar: {steps.size} windows of walking, 2.56 s, of the people that the template was not formed"
        " from",
        holds(shares[0] > 0.9),
        "in over 90 % of windows, within half a bin of the spectrum and 5 %, as for crossings of g; by"
        " correlation",
        evidence=Evidence.REAL,
        cause=Cause(
            f"in {doubled:.0%} of windows (warped) every other step is found",
            shown=doubled >= 0.5 * (1.0 - shares[1]),
        ),
    )


def _cause(cells: Sequence[tuple[str, str]], off: Array) -> str:
    """Say how far the counts are off by the way of carrying."""
    ways = [(way, np.abs(off[[carry == way for carry, _ in cells]]).max()) for way in CARRIES]
    return "at most " + ", ".join(f"{100 * value:.1f} % in the {way}" for way, value in ways)


def _draw(template: Template, figures: Path) -> str:
    figure, (axis,) = drawing.panels(1)
    axis.plot(np.arange(template.shape.size) / RATE_HZ, template.shape, "o-", color=drawing.BLUE)
    axis.set(xlabel="time from a crossing of g, s", ylabel="norm less its mean, scaled to length 1")
    return drawing.save(figure, figures, NAME)
