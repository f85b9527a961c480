"""docs/tutorial.md: every command in it is run on the recording it names, and says what the page says."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

from tests.support.forked import Forked

PAGE = Path(__file__).parents[3] / "docs" / "tutorial.md"
BLOCK = re.compile(r"^```console\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
NAME_OF_SET = re.compile(r"(?<=json as )[0-9a-f]{12}")
"""The name is made of every digit of the numbers, and a processor may round the last one otherwise."""

TERMINAL = {"COLUMNS": "90", "LANG": "C.UTF-8"}


def ran(command: str, folder: Path) -> str:
    """Run a line of the shell, in a terminal of 90 columns; return what it said."""
    first, then, rest = command.partition(";")
    said = ""
    if first.startswith("stillcal "):
        with Forked(shlex.split(first)[1:], folder=folder, more=TERMINAL, together=True) as stillcal:
            said = stillcal.said()[0]
        command = f"(exit {stillcal.returncode}){then}{rest}"
    return "".join(line.rstrip() + "\n" for line in (said + shell(command, folder)).splitlines())


def shell(command: str, folder: Path) -> str:
    return subprocess.run(
        command,
        shell=True,
        cwd=folder,
        env=os.environ | TERMINAL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    ).stdout


def commands(block: str) -> list[tuple[str, str]]:
    """Split a block into its commands and what each says."""
    parts = re.split(r"^\$ (.*)\n", block, flags=re.MULTILINE)
    return list(zip(parts[1::2], parts[2::2], strict=True))


def test_every_command_says_what_the_page_says(data_dir: Path, tmp_path: Path) -> None:
    shutil.copy(data_dir / "mikoff" / "imu0.log", tmp_path)
    shown = [pair for block in BLOCK.findall(PAGE.read_text()) for pair in commands(block)]
    assert len(shown) >= 10
    for command, said in shown:
        answer = NAME_OF_SET.sub("its name", ran(command, tmp_path))
        assert answer == NAME_OF_SET.sub("its name", said), f"docs/tutorial.md: {command}"
