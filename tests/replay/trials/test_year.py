"""The year's trial at small scale: a daemon lives for some days, and growth is told from ups and downs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.trials.year.__main__ import JUDGED, MIDNIGHT, SELDOM, growth, live
from stillcal.replay.trials.year.phone import YearPhone

RNG = np.random.default_rng(4)
UNEVEN = RNG.integers(50, 60, 364)
"""A figure that goes up and down by a fifth for a year."""


def midnights(memory: np.ndarray) -> np.ndarray:
    return np.array([(day, size, 14, 3, 1000, 2000, 500, 8, 50) for day, size in enumerate(memory)], MIDNIGHT)


def with_peaks(days: np.ndarray) -> np.ndarray:
    return np.where(np.isin(np.arange(364), days), 2 * UNEVEN, UNEVEN)


@pytest.mark.parametrize(
    ("memory", "flat"),
    [
        (UNEVEN, True),
        (with_peaks(RNG.choice(np.arange(273, 364), 10, replace=False)), True),
        (UNEVEN + np.arange(364) // 40, False),  # a little every day
        (UNEVEN + np.clip(np.arange(364) - 334, 0, None), False),  # a leak in the last 30 days
        (np.minimum(2 * UNEVEN, 60 + np.arange(364)), True),  # full after two months
    ],
)
def test_what_grows_is_told_from_what_goes_up_and_down(memory: np.ndarray, flat: bool) -> None:
    found = {g.name: g.flat for g in growth(midnights(memory))}
    assert found == {name: flat if name == "memory" else True for name in JUDGED}


def test_three_days_have_no_quarters() -> None:
    with pytest.raises(ValueError, match="four are needed"):
        growth(midnights(np.array([1, 2, 3])))


@pytest.mark.slow
def test_a_daemon_lives_for_a_day_and_is_looked_at_at_midnight(tmp_path: Path) -> None:
    lived = live(1, YearPhone(1, 10.0), tmp_path, lambda line: None, SELDOM)
    (row,) = lived.midnights
    assert lived.exit_code == 0 and row["day"] == 1 and row["threads"] >= 2
    assert row["memory"] > 10_000_000 and row["state"] > 1000 and row["files"] >= 6
