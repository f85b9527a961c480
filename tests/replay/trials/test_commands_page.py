"""docs/commands.md is what the commands say of themselves; the shells' scripts are there."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from stillcal.daemon.cli.main import cli
from stillcal.daemon.settings import parse_settings
from stillcal.replay.formats.columns import parse_map
from stillcal.replay.trials.pages.commands import page

ROOT = Path(__file__).parents[3]
STILLCAL = str(Path(sys.executable).with_name("stillcal"))


def test_the_page_is_what_the_commands_say() -> None:
    """In a process of its own: click keeps a command's help option as it was first asked for."""
    command = [sys.executable, "-m", "stillcal.replay.trials.pages.commands"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    written = (ROOT / "docs" / "commands.md").read_text()
    assert written == said, "run: python -m stillcal.replay.trials.pages.commands > docs/commands.md"


def test_every_command_has_a_section_and_says_what_it_does() -> None:
    sections = re.split(r"^## ", page(), flags=re.MULTILINE)
    for name in cli.list_commands(click.Context(cli)):
        (section,) = [s for s in sections if s.startswith(f"stillcal {name}\n")]
        assert "Usage:" in section and len(section.split("\n\n")[2].strip()) > 10


@pytest.mark.parametrize(
    ("shell", "holds"), [("bash", "complete -o"), ("zsh", "#compdef"), ("fish", "complete ")]
)
def test_a_shell_is_told_how_to_complete(shell: str, holds: str) -> None:
    environment = os.environ | {"_STILLCAL_COMPLETE": f"{shell}_source"}
    done = subprocess.run([STILLCAL], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and holds in done.stdout and "stillcal" in done.stdout, done.stderr


def test_bash_completes_commands_and_options() -> None:
    for words, number, wanted in (("stillcal wa", 1, "watch"), ("stillcal watch --on", 2, "--once")):
        environment = os.environ | {
            "_STILLCAL_COMPLETE": "bash_complete",
            "COMP_WORDS": words,
            "COMP_CWORD": str(number),
        }
        done = subprocess.run([STILLCAL], env=environment, capture_output=True, text=True, check=False)
        assert f"plain,{wanted}" in done.stdout


def test_the_maps_and_settings_on_the_page_of_own_logs_are_valid() -> None:
    blocks = re.findall(r"^```toml\n(.*?)^```$", (ROOT / "docs" / "own_log.md").read_text(), re.M | re.S)
    maps = [block for block in blocks if "[accelerometer]" in block]
    settings = [block for block in blocks if "[source]" in block]
    assert len(maps) == len(settings) == 1
    assert parse_map(maps[0].encode(), Path("map.toml")).decimal == "auto"
    assert parse_settings(settings[0]).source.kind == "iio"


def test_no_line_of_the_overview_is_cut_short() -> None:
    """In 80 columns click ends a docstring that does not fit with three dots, or goes on below."""
    for words in ([], ["store"], ["challenge"]):
        shown = CliRunner().invoke(cli, [*words, "--help"], terminal_width=80).output
        sections = [
            part for part in shown.split("\n\n")[2:] if not part.startswith(("Options:", "  Examples:"))
        ]
        listed = [line for section in sections if ":\n" in section for line in section.splitlines()[1:]]
        assert len(listed) > 3 and not [line for line in listed if "..." in line or line[2] == " "]


def test_the_manual_page_is_made_of_the_help_and_holds_no_broken_macro() -> None:
    made = "stillcal.replay.trials.pages.manual"
    said = subprocess.run([sys.executable, "-m", made], capture_output=True, text=True, check=True).stdout
    written = ROOT / "docs" / "stillcal.1"
    assert written.read_text() == said, f"run: python -m {made} > docs/stillcal.1"
    if shutil.which("groff") is None:
        pytest.skip("groff is not installed")
    command = ["groff", "-man", "-Tutf8", "-ww", "-z", str(written)]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stderr == ""
