"""What an effect follows, as it says so in words: a logged column may be named uptime, or temperature 2."""

from __future__ import annotations

COLUMN = "the column "


def driver_of(column: str) -> str:
    """Return what an effect of a logged column follows, in words."""
    return COLUMN + column


def column_of(driver: str) -> str | None:
    """Return the logged column that an effect with this driver follows; None where it is none."""
    return driver.removeprefix(COLUMN) if driver.startswith(COLUMN) else None


def follows_time(driver: str) -> bool:
    """Whether an effect with this driver needs to know when a rest was."""
    return column_of(driver) is None and ("time" in driver or driver.startswith("charging"))


def follows_temperature(driver: str) -> bool:
    """Whether an effect with this driver needs a thermometer."""
    return column_of(driver) is None and "temperature" in driver
