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
NAME_OF_SET = re.compile(r"\b[0-9a-f]{12}\b")
ALL_DIGITS = re.compile(r"-?\d\.\d{12,}")
"""A processor may round the last digit otherwise, and a calibration's name is made of every one of them."""

DIGITS = 11
"""Significant digits of such a number that must be those of the page."""

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


def without_last_digits(text: str) -> str:
    """Return a text that is the same on every processor."""
    text = NAME_OF_SET.sub("its name", text)
    return ALL_DIGITS.sub(lambda number: f"{float(number[0]):.{DIGITS}g}", text)


def test_every_command_says_what_the_page_says(data_dir: Path, tmp_path: Path) -> None:
    shutil.copy(data_dir / "mikoff" / "imu0.log", tmp_path)
    shown = [pair for block in BLOCK.findall(PAGE.read_text()) for pair in commands(block)]
    assert len(shown) >= 10
    for command, said in shown:
        answer = without_last_digits(ran(command, tmp_path))
        assert answer == without_last_digits(said), f"docs/tutorial.md: {command}"
