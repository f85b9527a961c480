"""Options that several commands share, so that they mean the same everywhere."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])
Option = Callable[[Command], Command]


class FiniteRange(click.FloatRange):
    """A number within bounds. click's own range lets NaN pass, because it is neither below nor above one."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number. Raises BadParameter where it is not finite or out of range."""
        try:
            number = float(value)
        except ValueError:
            self.fail(f"{value!r} is not a number.", param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return float(super().convert(number, param, ctx))


config_option: Option[Any] = click.option(
    "--config", type=click.Path(path_type=Path), help="Settings file (TOML; '-': standard input)."
)
socket_option: Option[Any] = click.option(
    "--socket", "path", default="", help="The daemon's socket [default: the user's, else the system's]."
)
quiet_option: Option[Any] = click.option("--quiet", is_flag=True, help="Print nothing but errors.")
