"""The command that is running, as a person would type it again."""

from __future__ import annotations

import shlex

import click
from click.core import ParameterSource


def command_line() -> str:
    """Return the running command with the options and arguments that it was given, quoted for a shell."""
    context = click.get_current_context()
    options, arguments = [], []
    for parameter in context.command.params:
        # A decorator may have gathered options into one value, so what was typed is asked for by the source.
        if context.get_parameter_source(parameter.name or "") is not ParameterSource.COMMANDLINE:
            continue
        value = context.params[parameter.name or ""]
        if isinstance(parameter, click.Argument):
            arguments.append(str(value))
            continue
        name = max(parameter.opts, key=len)
        if isinstance(parameter, click.Option) and parameter.is_flag:
            options.append(name)
            continue
        for one in value if parameter.multiple else [value]:
            options += [name, *map(str, one if isinstance(one, tuple) else [one])]
    return shlex.join([*context.command_path.split(), *arguments, *options])
