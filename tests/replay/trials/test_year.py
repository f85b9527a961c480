"""The year's trial at small scale: a daemon lives for some days, and growth is told from ups and downs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.trials.year.__main__ import JUDGED, MIDNIGHT, SELDOM, growth, live
from stillcal.replay.trials.year.phone import YearPhone


def midnights(memory: list[int]) -> np.ndarray:
    return np.array([(day, size, 14, 3, 1000, 2000, 500, 8) for day, size in enumerate(memory)], MIDNIGHT)


@pytest.mark.parametrize(
    ("memory", "flat"),
    [([50, 60, 55, 60, 55, 60, 55, 60], True), ([50, 60, 60, 60, 60, 60, 64, 64], False)],
)
def test_growth_is_the_last_quarter_against_the_second(memory: list[int], flat: bool) -> None:
    found = {g.name: g.flat for g in growth(midnights(memory))}
    assert found == {name: flat if name == "memory" else True for name in JUDGED}


def test_three_days_have_no_quarters() -> None:
    with pytest.raises(ValueError, match="four are needed"):
        growth(midnights([1, 2, 3]))


@pytest.mark.slow
def test_a_daemon_lives_for_a_day_and_is_looked_at_at_midnight(tmp_path: Path) -> None:
    lived = live(1, YearPhone(1, 10.0), tmp_path, lambda line: None, SELDOM)
    (row,) = lived.midnights
    assert lived.exit_code == 0 and row["day"] == 1 and row["threads"] >= 2
    assert row["memory"] > 10_000_000 and row["state"] > 1000 and row["files"] >= 6
