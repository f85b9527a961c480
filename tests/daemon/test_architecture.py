"""docs/architecture.md against the code: which part imports which, and that what it names is there."""

from __future__ import annotations

import ast
import re
import tomllib
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "architecture.md"
PREFIX = "stillcal."


@cache
def packages() -> list[str]:
    """All import packages, the inner ones first."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    code = [name.removeprefix(PREFIX) for name in settings]
    folders = [name for name in code if list((ROOT / name.replace(".", "/")).glob("*.py"))]
    return sorted(folders, key=lambda name: -name.count("."))


@cache
def part_of(module: str) -> str | None:
    """The innermost package that a module of ours lies in."""
    return next((p for p in packages() if module == p or module.startswith(p + ".")), None)


def imported(file: Path) -> set[str]:
    """Names of our modules that a file imports anywhere, those for type checkers only included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(PREFIX):
            module = node.module.removeprefix(PREFIX)
            found |= {f"{module}.{name.name}" for name in node.names}
    return found


@cache
def arrows() -> dict[str, set[str]]:
    """Which part imports which, as the code has it."""
    known = packages()
    found: dict[str, set[str]] = {}
    for part in known:
        files = (ROOT / part.replace(".", "/")).glob("*.py")
        to = {part_of(module) for file in files for module in imported(file)}
        found[part] = {name for name in to if name and name != part}
    return found


def drawn() -> dict[str, set[str]]:
    """The same as the page's table has it."""
    rows = re.findall(r"^\| `([\w.]+)` \| ([^|]*) \| [^|]* \|$", PAGE.read_text(), flags=re.MULTILINE)
    return {name: set(re.findall(r"`([\w.]+)`", to)) for name, to in rows}


def test_each_part_imports_what_the_page_says() -> None:
    written, found = drawn(), arrows()
    wrong = {part: sorted(to) for part, to in found.items() if to and written.get(part) != to}
    assert not wrong, "docs/architecture.md: these rows are not what the code imports"


def test_no_part_is_missing_and_none_is_invented() -> None:
    assert set(drawn()) == {name for name in packages() if not name.startswith("config")} | {"config"}


def test_the_drawing_points_one_way() -> None:
    """Nothing below is held together in a ring with what stands on it."""
    found = arrows()
    for low, high in (("calib_core", "daemon"), ("calib_core", "replay"), ("calib_core.misfit", "replay")):
        assert not any(to == high or to.startswith(high + ".") for to in found[low])
    for name in re.findall(r"`((?:calib_core|daemon|replay)/[\w/]+\.py)`", PAGE.read_text()):
        assert (ROOT / name).is_file(), name
