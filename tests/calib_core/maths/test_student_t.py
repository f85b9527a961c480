"""Student's quantiles against scipy's; and that a fit loads no scipy."""

from __future__ import annotations

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import stdtrit

from stillcal.calib_core.maths.student_t import quantile

FREEDOM = st.one_of(st.integers(1, 5000), st.floats(0.5, 5000.0))


@given(FREEDOM, st.floats(0.501, 1.0 - 1e-9))
def test_quantiles_are_scipys(freedom: float, p: float) -> None:
    """To what 1 - p, rounded, allows in a tail of 1e-9."""
    assert quantile(freedom, p) == pytest.approx(stdtrit(freedom, p), rel=1e-6)


def test_tabled_quantiles() -> None:
    """Abramowitz and Stegun, Table 26.10: two-sided 0.95 and 0.99."""
    assert [round(quantile(n, 0.975), 3) for n in (1, 2, 5, 30)] == [12.706, 4.303, 2.571, 2.042]
    assert [round(quantile(n, 0.995), 3) for n in (1, 5, 120)] == [63.657, 4.032, 2.617]
    assert quantile(7, 0.1) == pytest.approx(-quantile(7, 0.9))
    assert quantile(7, 0.5) == 0.0


@pytest.mark.parametrize(("freedom", "p"), [(5, 0.0), (5, 1.0), (0, 0.9), (float("inf"), 0.9)])
def test_what_has_no_quantile_is_refused(freedom: float, p: float) -> None:
    with pytest.raises(ValueError, match="no quantile"):
        quantile(freedom, p)


def test_a_fit_loads_no_scipy() -> None:
    """It would stay in the daemon's memory, and its import would hold up the daemon's loop.

    Nor does the diagnosis load its signal package before it is needed: that costs 0.8 s and 70 MB.
    """
    fit = "from stillcal.replay.trials.faults.kill import example; example()"
    diagnosis = "import stillcal.replay.commands.diagnose"
    loaded = "print({!r} in sys.modules)"
    script = "; ".join(["import sys", fit, loaded.format("scipy"), diagnosis, loaded.format("scipy.signal")])
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["False", "False"]
