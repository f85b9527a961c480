"""Steps found by correlating the norm with a template, beside crossings of g.

Collin et al. 2019, 3.2: the template is formed offline from a sample walk. Every phone and way of carrying is
judged with the one template of a faultless phone in a pocket.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.phone import Scenario, load_phone, simulate
from stillcal.replay.phone.activities.carried import Drive, Walk
from stillcal.replay.phone.activities.resting import Table
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import Claim, Evidence, Progress, Study, holds, picture, table
from stillcal.replay.studies.collin2019.step_detection import CARRIES, WALK_S, walked
from stillcal.replay.studies.methods.steps import StepSettings, detect_steps, even

NAME, TITLE, WORK, WHERE = "step-template", "Steps by correlation with a template", "Collin 2019", "3.2"
PHONES = ("ideal", "consumer", "mpu6050")
LEAST = 0.5
"""Least correlation of a step: half of the most."""
RATE_HZ = StepSettings().rate


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """One step's norm less its mean, of length 1. shape: (m,) at RATE_HZ."""

    shape: Array


def recorded(carry: str, phone: str, seed: int) -> Samples:
    """Return the forces of a simulated walk, the same that `walked` counts."""
    scenario = Scenario(segments=(Walk(duration_s=WALK_S, carry=carry),))  # type: ignore[arg-type]  # of CARRIES
    return simulate(scenario, load_phone(phone), seed).whole().accelerometer


def form(sample: Samples) -> Template:
    """Form a template from a sample walk: the mean of its steps, each as long as the median one."""
    steps = detect_steps(sample.t, sample.xyz, STANDARD)
    size = round(float(np.median(np.diff(steps.start))) * RATE_HZ)
    first = np.searchsorted(steps.t, steps.start)
    first = first[first + size <= steps.t.size]
    mean = np.mean(steps.norm[first[:, None] + np.arange(size)], axis=0)
    centred = mean - mean.mean()
    return Template(centred / np.linalg.norm(centred))


def correlation(norm: Array, template: Template) -> Array:
    """Return the correlation of the norm (n,) with the template at each place, (n - m + 1,), -1 to 1."""
    windows = np.lib.stride_tricks.sliding_window_view(norm, template.shape.size)
    centred = windows - windows.mean(axis=1, keepdims=True)
    return np.asarray(centred @ template.shape / np.maximum(np.linalg.norm(centred, axis=1), 1e-12))


def count(samples: Samples, template: Template, least: float = LEAST) -> int:
    """Count steps: highest points of the correlation above `least`, as far apart as detected steps are."""
    from scipy.signal import find_peaks  # noqa: PLC0415 - for those who evaluate

    norm = np.linalg.norm(even(samples.t, samples.xyz)[1], axis=1)
    apart = max(1, round(StepSettings().least_s * RATE_HZ))
    return int(find_peaks(correlation(norm, template), height=least, distance=apart)[0].size)


def false_counts(activity: Drive | Table, template: Template, seed: int) -> float:
    """Return steps found for each minute of something that is no walk."""
    samples = simulate(Scenario(segments=(activity,)), load_phone("typical"), seed).whole().accelerometer
    return count(samples, template) / float(samples.t[-1] / 60.0)


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Count the steps of simulated walks by template and by crossings of g."""
    template = form(recorded("pocket", "ideal", seed + 1))
    cells = [(carry, phone) for carry in CARRIES for phone in PHONES]
    true, crossed, matched = np.zeros((3, len(cells)))
    for k, (carry, phone) in enumerate(cells):
        true[k], crossed[k] = walked(carry, phone, seed)
        matched[k] = count(recorded(carry, phone, seed), template)
        progress((k + 1) / len(cells))
    driving = false_counts(Drive(duration_s=WALK_S), template, seed)
    resting = false_counts(Table(duration_s=WALK_S), template, seed)
    off = matched / true - 1.0
    rows = [
        (carry, phone, f"{t:.0f}", f"{c:.0f}", f"{m:.0f}", f"{100 * (m / t - 1):+.1f} %")
        for (carry, phone), t, c, m in zip(cells, true, crossed, matched, strict=True)
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
            " (crossings of g: see `steps`), so it needs a test of size beside it. Dynamic time warping,"
            " which the paper names as an improvement, was not tried.",
            table(("carried in the", "phone", "steps taken", "crossings of g", "template", "off"), rows),
            picture(file, "The template: mean of a sample walk's steps"),
        ]
    )
    return Study(NAME, TITLE, (claim,), text, (file,), seed)


def _cause(cells: Sequence[tuple[str, str]], off: Array) -> str:
    """Say how far the counts are off by the way of carrying."""
    ways = [(way, np.abs(off[[carry == way for carry, _ in cells]]).max()) for way in CARRIES]
    return "at most " + ", ".join(f"{100 * value:.1f} % in the {way}" for way, value in ways)


def _draw(template: Template, figures: Path) -> str:
    figure, (axis,) = drawing.panels(1)
    axis.plot(np.arange(template.shape.size) / RATE_HZ, template.shape, "o-", color=drawing.BLUE)
    axis.set(xlabel="time from a crossing of g, s", ylabel="norm less its mean, scaled to length 1")
    return drawing.save(figure, figures, NAME)
