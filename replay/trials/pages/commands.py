"""The page of all commands, from their own help.

`python -m stillcal.replay.trials.pages.commands > docs/commands.md` writes it.
"""

from __future__ import annotations

from collections.abc import Iterator

import click

from stillcal.daemon.cli import exits
from stillcal.daemon.cli.main import cli

NAME = "stillcal"
WIDTH = 100

HEAD = """\
# Commands

*For people who want to look an option up.*

Made from the commands' own help by `python -m stillcal.replay.trials.pages.commands > docs/commands.md`; a
test holds this page against them. `stillcal COMMAND --help` prints the same in a terminal.
"""

SHELLS = """\
## Completion in the shell

Names of commands and options are completed by bash (4.4 or later), zsh and fish once they are told how. Write
the script that stillcal prints, and read it where the shell starts (`. ~/.stillcal-complete.bash` in
`~/.bashrc`, `. ~/.stillcal-complete.zsh` in `~/.zshrc`; fish finds it by itself):

    _STILLCAL_COMPLETE=bash_source stillcal > ~/.stillcal-complete.bash
    _STILLCAL_COMPLETE=zsh_source stillcal > ~/.stillcal-complete.zsh
    _STILLCAL_COMPLETE=fish_source stillcal > ~/.config/fish/completions/stillcal.fish
"""

MEANINGS = (
    (0, "done; on SIGTERM, for what runs until told to stop"),
    (
        exits.NOT_MET,
        "a bar not met, a store damaged, or refused by the daemon: the command's help says which",
    ),
    (exits.BAD_INPUT, "bad input: one line on standard error names the file, the row and the remedy"),
    (
        exits.TOO_LITTLE,
        "the recording, or what the daemon has gathered, does not support it; what is missing is said",
    ),
    (exits.NO_DAEMON, "no daemon answers"),
    (exits.VERDICT, "the diagnosis came to a verdict that `--fail-on` names"),
    (exits.NOT_SAVED, "the daemon was stopped, and its newest calibration could not be written to the store"),
    (exits.TRY_AGAIN, "a passing fault of the machine stopped the daemon: start it again"),
    (exits.INTERRUPTED, "interrupted; nothing is left half-written"),
)


def page() -> str:
    """Return the page in Markdown."""
    codes = "\n".join(f"| {code} | {meaning} |" for code, meaning in MEANINGS)
    parts = [HEAD, *_commands(cli, click.Context(cli, info_name=NAME)), SHELLS]
    return "\n".join([*parts, f"## Exit codes\n\n| code | means |\n|---|---|\n{codes}"])


def _commands(command: click.Command, context: click.Context) -> Iterator[str]:
    """Yield a section for a command, and after it for each that it holds."""
    level = "##" if context.parent is None or not context.parent.parent else "###"
    yield f"{level} {context.command_path}\n\n```\n{_help(command, context)}\n```\n"
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            if inner is not None:
                yield from _commands(inner, click.Context(inner, info_name=name, parent=context))


def _help(command: click.Command, context: click.Context) -> str:
    """Return a command's help at one width, whatever the terminal's."""
    context.terminal_width = context.max_content_width = WIDTH
    context.help_option_names = ["-h", "--help"]
    return "\n".join(line.rstrip() for line in command.get_help(context).splitlines())


if __name__ == "__main__":
    click.echo(page())
