"""Commands that are imported when they are called, so that the daemon loads nothing it does not use."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import Any

import click

from stillcal.daemon.cli.interruption import raise_when_interrupted
from stillcal.daemon.system.imports import without_collection


def examples(*lines: str) -> str:
    """Return an epilog that click does not rewrap."""
    return "\n".join(["\b", "Examples:", *(f"  {line}" for line in lines)])


class LazyGroup(click.Group):
    """A group of its own commands and of those that packages register by entry point.

    own: name to "module:attribute". sections: heading in the help to the entry point group whose commands
    stand under it, or to None for the group's own. Entry points are read only for a name that is not the
    group's own.
    """

    def __init__(
        self,
        *args: Any,
        own: Mapping[str, str],
        sections: Mapping[str, str | None],
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self._own, self._groups = dict(own), dict(sections)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return all names, section after section."""
        return [name for _, places in self._sections() for name in places]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None where there is none of this name."""
        if cmd_name in self._own:
            return _imported(self._own[cmd_name])
        place = dict(pair for _, places in self._sections() for pair in places.items()).get(cmd_name)
        return None if place is None else _imported(place)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under the headings of their sections."""
        sections = list(self._sections())
        width = max(len(name) for _, places in sections for name in places)
        for heading, places in sections:
            commands = [(name, self.get_command(ctx, name)) for name in places]
            limit = formatter.width - 6 - width
            rows = [
                (name.ljust(width), command.get_short_help_str(limit))
                for name, command in commands
                if command
            ]
            if rows:
                with formatter.section(heading):
                    formatter.write_dl(rows)

    def _sections(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        for heading, group in self._groups.items():
            yield heading, self._own if group is None else _registered(group)


class OpenGroup(click.Group):
    """A group of its own commands, then those that packages register in the entry point group `more`."""

    def __init__(self, *args: Any, more: str, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._more = more

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the group's own names, then the registered ones."""
        return [*super().list_commands(ctx), *_registered(self._more)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command, imported where it is registered; None where there is none of this name."""
        own = super().get_command(ctx, cmd_name)
        place = None if own is not None else _registered(self._more).get(cmd_name)
        return own if place is None else _imported(place)


def _registered(group: str) -> dict[str, str]:
    from importlib.metadata import entry_points  # noqa: PLC0415 - the daemon holds no parser of mail headers

    return {point.name: point.value for point in entry_points(group=group)}


def _imported(place: str) -> click.Command:
    module, attribute = place.split(":")
    with without_collection():
        command: click.Command = getattr(importlib.import_module(module), attribute)
    raise_when_interrupted()
    return command
