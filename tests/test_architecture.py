"""docs/architecture.md and the packaging against the code."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from stillcal.replay.trials.pages.architecture import page

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "architecture.md"
FROM_A_CHECKOUT = ("stillcal.replay.real_data", "stillcal.replay.studies", "stillcal.replay.trials")


def test_the_page_is_what_the_code_imports() -> None:
    """Making it also fails where packages import each other in a ring."""
    remedy = "run: python -m stillcal.replay.trials.pages.architecture > docs/architecture.md"
    assert PAGE.read_text() == page(), remedy


def test_files_that_the_page_names_are_there() -> None:
    named = re.findall(r"`((?:calib_core|daemon|replay)/[\w/]+\.py)`", PAGE.read_text())
    assert len(named) > 5
    assert [name for name in named if not (ROOT / name).is_file()] == []


def test_every_task_is_done_where_its_page_says() -> None:
    text = (ROOT / "docs" / "tasks.md").read_text()
    rows = re.findall(r"^\| .+ \| `([^`]+)` \| `([^`]+)` \|$", text, flags=re.MULTILINE)
    assert len(rows) == len(re.findall(r"^\*\*", text, flags=re.MULTILINE)) > 10
    assert [row for row in rows if row[1] not in (ROOT / row[0]).read_text()] == []
    folders = "calib_core|daemon|replay|config|tests"
    named = re.findall(rf"`((?:{folders})/[\w./]*)`", text)
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_every_package_is_installed_but_the_proofs() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    folders = [f for layer in ("calib_core", "daemon", "replay", "config") for f in (ROOT / layer).rglob("*")]
    folders += [ROOT / layer for layer in ("calib_core", "daemon", "replay", "config")]
    held = {
        f"stillcal.{'.'.join(f.relative_to(ROOT).parts)}" for f in folders if f.is_dir() and _holds_files(f)
    }
    assert set(listed) == {"stillcal"} | {name for name in held if not name.startswith(FROM_A_CHECKOUT)}


def _holds_files(folder: Path) -> bool:
    return folder.is_dir() and folder.name != "__pycache__" and any(f.is_file() for f in folder.iterdir())
