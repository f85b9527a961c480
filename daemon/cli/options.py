"""Options that several commands share, so that they mean the same everywhere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])
Option = Callable[[Command], Command]

config_option: Option[Any] = click.option(
    "--config", type=click.Path(path_type=Path), help="Settings file (TOML)."
)
socket_option: Option[Any] = click.option(
    "--socket", "path", default="", help="The daemon's socket [default: the user's, else the system's]."
)
quiet_option: Option[Any] = click.option("--quiet", is_flag=True, help="Print nothing but errors.")
