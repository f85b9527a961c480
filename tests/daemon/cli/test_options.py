"""Options that several commands share, over the whole command line."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest

from stillcal.daemon.cli.main import cli
from stillcal.daemon.cli.options import FiniteRange


def commands(command: click.Command, context: click.Context) -> Iterator[click.Command]:
    """Yield a command and all below it."""
    yield command
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            child = command.get_command(context, name)
            assert child is not None
            yield from commands(child, context)


@pytest.mark.parametrize("text", ["nan", "-nan", "inf", "-inf", "1e999"])
def test_no_range_of_an_option_takes_what_is_not_finite(text: str) -> None:
    context = click.Context(cli)
    options = [option for command in commands(cli, context) for option in command.params]
    ranges = [option for option in options if isinstance(option.type, click.FloatRange)]
    assert {"--hours", "--rotate", "--every", "--speed", "--from", "--to"} <= {o.opts[0] for o in ranges}
    for option in ranges:
        with pytest.raises(click.BadParameter, match="is not a finite number"):
            option.type.convert(text, option, context)


def test_a_range_keeps_its_bounds_and_refuses_words() -> None:
    bounded = FiniteRange(0, 10, min_open=True)
    assert bounded.convert("2.5", None, None) == 2.5
    for text in ("0", "10.1", "soon"):
        with pytest.raises(click.BadParameter):
            bounded.convert(text, None, None)
