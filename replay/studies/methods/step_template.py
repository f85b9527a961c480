"""Steps found by their likeness to a template that was formed from a sample walk.

Collin et al. 2019, Inertial Sensors and Their Applications, 3.2: by correlation, or by dynamic time warping.
A likeness does not see how large the signal is: where nobody walks it needs a test of size beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.studies.methods.steps import StepSettings, detect_steps, even

LEAST = 0.5
"""Least correlation of a step: half of the most."""

WARP = 2
"""Samples that warping may put one off: 0.08 s."""

RATE_HZ = StepSettings().rate


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """One step's norm less its mean, of length 1. shape: (m,) at RATE_HZ."""

    shape: Array


def form(samples: Sequence[Samples]) -> Template:
    """Form a template from sample walks: the mean of their steps, each as long as the median one."""
    walks = [detect_steps(sample.t, sample.xyz, STANDARD) for sample in samples]
    size = round(float(np.median(np.concatenate([np.diff(steps.start) for steps in walks]))) * RATE_HZ)
    shapes = []
    for steps in walks:
        first = np.searchsorted(steps.t, steps.start)
        first = first[first + size <= steps.t.size]
        shapes.append(steps.norm[first[:, None] + np.arange(size)])
    mean = np.concatenate(shapes).mean(axis=0)
    centred = mean - mean.mean()
    return Template(centred / np.linalg.norm(centred))


def stretched(template: Template, factor: float) -> Template:
    """Return the template of a walk whose steps take `factor` times as long."""
    m = template.shape.size
    shape = np.interp(np.linspace(0.0, m - 1.0, round(m * factor)), np.arange(m), template.shape)
    centred = shape - shape.mean()
    return Template(centred / np.linalg.norm(centred))


def correlation(norm: Array, template: Template) -> Array:
    """Return the correlation of the norm (n,) with the template at each place, (n - m + 1,), -1 to 1."""
    windows = np.lib.stride_tricks.sliding_window_view(norm, template.shape.size)
    centred = windows - windows.mean(axis=1, keepdims=True)
    return np.asarray(centred @ template.shape / np.maximum(np.linalg.norm(centred, axis=1), 1e-12))


def warped(norm: Array, template: Template) -> Array:
    """Return 1 - D^2 / 2 at each place, (n - m + 1,), D the distance by dynamic time warping.

    Of windows centred and of length 1, as the template is: without warping D^2 is 2 - 2 r and this is the
    correlation r. A sample may be put up to WARP samples off.
    """
    windows = np.lib.stride_tricks.sliding_window_view(norm, template.shape.size)
    centred = windows - windows.mean(axis=1, keepdims=True)
    unit = centred / np.maximum(np.linalg.norm(centred, axis=1, keepdims=True), 1e-12)
    m, far = template.shape.size, np.full(len(unit), np.inf)
    row = [far] * (m + 1)
    for i in range(m):
        above, row = row, [far] * (m + 1)
        for j in range(max(0, i - WARP), min(m, i + WARP + 1)):
            least = np.minimum(np.minimum(above[j], above[j + 1]), row[j]) if i or j else np.zeros(len(unit))
            row[j + 1] = least + (unit[:, j] - template.shape[i]) ** 2
    return np.asarray(1.0 - row[m] / 2.0)


Likeness = Callable[[Array, Template], Array]
"""Norms (n,), a template -> how alike each place is to it, 1 at most: `correlation` or `warped`."""


def places(norm: Array, template: Template, alike: Likeness, least: float = LEAST) -> Array:
    """Return where steps are, (k,) samples: highest points above `least`, as far apart as detected ones."""
    from scipy.signal import find_peaks  # noqa: PLC0415 - for those who evaluate

    apart = max(1, round(StepSettings().least_s * RATE_HZ))
    return np.asarray(find_peaks(alike(norm, template), height=least, distance=apart)[0], dtype=np.float64)


def count(samples: Samples, template: Template, alike: Likeness = correlation, least: float = LEAST) -> int:
    """Count the steps of samples: places as alike as `least` or more."""
    norm = np.linalg.norm(even(samples.t, samples.xyz)[1], axis=1)
    return int(places(norm, template, alike, least).size)
