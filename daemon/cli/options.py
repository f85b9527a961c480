"""Options that several commands share, so that they mean the same everywhere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])
Option = Callable[[Command], Command]

_NAMES = (
    "hhar, imu_tk, mikoff, imucal, phyphox, sensorlogger, sensorlogger_ios, sensorlog, mpu6050, airbrakes"
)


def format_option(what: str = "TRACE", *, rests: bool) -> Option[Any]:
    """Return the option --format for `what`. rests: whether a rest table is accepted too."""
    known = f"csv, rest, {_NAMES}" if rests else f"csv, {_NAMES}"
    text = f"Format of {what}: {known}, or a column map (.toml); auto: by the content of each."
    return click.option("--format", "format_", default="auto", show_default=True, help=text)


config_option: Option[Any] = click.option(
    "--config", type=click.Path(path_type=Path), help="Settings file (TOML)."
)
socket_option: Option[Any] = click.option(
    "--socket", "path", default="", help="The daemon's socket [default: the user's, else the system's]."
)
quiet_option: Option[Any] = click.option("--quiet", is_flag=True, help="Print nothing but errors.")
