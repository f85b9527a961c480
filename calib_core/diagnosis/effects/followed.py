"""What an effect follows, as it says so in words: a logged column may be named uptime, or temperature 2."""

from __future__ import annotations

COLUMN = "the column "


def driver_of(column: str) -> str:
    """Return what an effect of a logged column follows, in words."""
    return COLUMN + column


def follows_time(driver: str) -> bool:
    """Whether an effect with this driver needs to know when a rest was."""
    return not driver.startswith(COLUMN) and ("time" in driver or driver.startswith("charging"))


def follows_temperature(driver: str) -> bool:
    """Whether an effect with this driver needs a thermometer."""
    return not driver.startswith(COLUMN) and "temperature" in driver
