"""The manual page stillcal(1), from the commands' own help.

`python -m stillcal.replay.trials.pages.manual > docs/stillcal.1` writes it.
"""

from __future__ import annotations

from collections.abc import Iterator

import click

from stillcal.daemon.cli.main import cli
from stillcal.replay.trials.pages.commands import MEANINGS, NAME

FILES = (
    ("/etc/stillcal/stillcal.toml", "Settings of the service; config/default.toml lists all."),
    ("/var/lib/stillcal/store.json", "The service's calibration store."),
    ("/run/stillcal/io.stillcal.Calibration", "The service's socket (varlink)."),
)


def page() -> str:
    """Return the page in the macros of man(7)."""
    parts = [
        f'.TH STILLCAL 1 "" "{NAME}" "User commands"',
        ".SH NAME",
        f"{NAME} \\- keep a phone\\(aqs accelerometer and gyroscope calibrated, and explain how they err",
        ".SH SYNOPSIS",
        f".B {NAME}\n.I COMMAND\n[OPTIONS]",
        ".SH DESCRIPTION",
        _text(cli.help or ""),
        _text(
            "A recording is a file or a folder of any format that is recognised by its content, '-' for"
            " standard input, or sample:lab, which comes with the package."
        ),
        ".SH COMMANDS",
        *_commands(cli, click.Context(cli, info_name=NAME)),
        ".SH EXIT STATUS",
        *(f".TP\n{code}\n{_text(meaning)}" for code, meaning in MEANINGS),
        ".SH FILES",
        *(f".TP\n.I {_text(path)}\n{_text(meaning)}" for path, meaning in FILES),
    ]
    return "\n".join(parts)


def _commands(group: click.Group, context: click.Context) -> Iterator[str]:
    """Yield the sections of a group's commands, and of what groups among them hold."""
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if command is None:
            continue
        inner = click.Context(command, info_name=name, parent=context)
        inner.help_option_names = ["-h", "--help"]
        yield f".SS {_text(inner.command_path)}"
        yield f".B {_text(inner.command_path)}\n{_text(' '.join(command.collect_usage_pieces(inner)))}"
        paragraphs = (command.help or "").replace("\f", "").split("\n\n")
        yield "\n".join(f".PP\n{_text(' '.join(p.split()))}" for p in paragraphs)
        for parameter in command.get_params(inner):
            record = parameter.get_help_record(inner) if isinstance(parameter, click.Option) else None
            if record is not None:
                yield f".TP\n.B {_text(record[0])}\n{_text(record[1])}"
        if command.epilog:
            yield f".PP\n.nf\n{_text(command.epilog.replace(chr(8), '').strip())}\n.fi"
        if isinstance(command, click.Group):
            yield from _commands(command, inner)


def _text(text: str) -> str:
    """Return text in which nothing is a macro or an escape (groff_char(7)); each line stays one."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-").replace('"', "\\(dq").replace("'", "\\(aq")
    for character, name in {"√": "\\(sr", "²": "\\(S2", "°": "\\(de", "±": "\\(+-"}.items():
        escaped = escaped.replace(character, name)
    return "\n".join(f"\\&{line}" if line.startswith(".") else line for line in escaped.split("\n"))


if __name__ == "__main__":
    click.echo(page())
