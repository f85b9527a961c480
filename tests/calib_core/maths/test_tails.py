"""Tails of chi-squared and F, far out too, beside scipy.stats; and that a diagnosis does without it."""

from __future__ import annotations

import subprocess
import sys
from functools import partial

import numpy as np
from scipy.stats import chi2, f, t

from stillcal.calib_core.maths import chi_squared, f_distribution


def test_tails_are_those_of_scipy_stats() -> None:
    alike = partial(np.testing.assert_allclose, rtol=1e-11, atol=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(200):
        x, more, free = rng.uniform(0.1, 200.0), int(rng.integers(1, 30)), int(rng.integers(3, 300))
        np.testing.assert_allclose(chi_squared.log_tail(x, free), chi2.logsf(x, free), rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(
            f_distribution.log_tail(x, more, free), f.logsf(x, more, free), rtol=1e-11, atol=1e-12
        )
        alike(f_distribution.log_tail(x**2, 1, free), np.log(2.0) + t.logsf(x, free))
        chance = 10.0 ** rng.uniform(-12.0, -0.1)
        alike(chi_squared.exceeded(chance, free), chi2.isf(chance, free))


def test_tails_have_ends() -> None:
    assert f_distribution.log_tail(0.0, 2, 9) == 0.0 and f_distribution.log_tail(np.inf, 2, 9) == -np.inf
    assert float(chi_squared.log_tail(0.0, 2)) == 0.0 and f_distribution.log_tail(1e-20, 2, 9) == 0.0
    assert f_distribution.log_tail(1e300, 2, 9) < -1000.0 and f_distribution.tail(1e300, 2, 9) == 0.0


def test_what_is_surer_than_a_float_holds_is_still_told_apart() -> None:
    """Else of several lines beyond doubt the first would be the clearest."""
    far = chi_squared.log_tail(np.array([5e3, 5e4]), 2)
    np.testing.assert_allclose(far, [-2.5e3, -2.5e4])
    for freedom in (1, 3, 6, 600):
        value = 1400.0 + 2.0 * freedom  # scipy still holds it here
        np.testing.assert_allclose(
            chi_squared._far(np.array(value), freedom), chi2.logsf(value, freedom), rtol=2e-6
        )


def test_a_diagnosis_and_a_simulation_import_neither_scipy_stats_nor_scipy_signal() -> None:
    """They take most of a second, a quarter of a short diagnosis."""
    program = (
        "import sys\n"
        "from stillcal import diagnose, load, simulate\n"
        "simulate('lab')\n"
        "diagnose(load('sample:lab', stop=400))\n"
        "print([m for m in ('scipy.special', 'scipy.stats', 'scipy.signal') if m in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "['scipy.special']\n"
