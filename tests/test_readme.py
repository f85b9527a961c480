"""README.md: its commands run as they stand, and its Python does; every page: its links lead somewhere."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from stillcal.daemon.cli.main import cli

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, flags=re.MULTILINE | re.DOTALL)


def test_the_quick_start_runs_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib", reason="the extra report")
    monkeypatch.chdir(tmp_path)
    (block,) = blocks("console")
    install, *commands = [line.removeprefix("$ ") for line in block.splitlines()]
    assert install == "pip install '.[report]'"
    assert len(commands) == 3
    said = ""
    for command in commands:
        name, *words = shlex.split(command)
        assert name == "stillcal"
        said += CliRunner().invoke(cli, words, catch_exceptions=False).stdout
    assert sorted(p.name for p in tmp_path.iterdir() if p.suffix in {".csv", ".html"}) == [
        "lab-calibrated.csv",
        "lab.html",
    ]
    (before, after) = re.findall(r"\((\S+ mg) before, (\S+ mg) after\)", TEXT)[0]
    assert f"{before} before, {after} after" in " ".join(said.split())
    assert "temperature" in said


def test_the_python_runs_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = blocks("python")
    exec(code, {})
    assert (tmp_path / "lab-calibrated.csv").is_file()


FOLDERS = ("*", "docs/*", "config/*/*", "examples/*/*")
PAGES = [page for folder in FOLDERS for page in ROOT.glob(f"{folder}.md")]


def anchors(page: Path) -> set[str]:
    """The names that GitHub gives to a page's headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    """Links to files beside the page and to their headings; those to the web are not followed."""
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if "://" in link:
            continue
        name, _, heading = link.partition("#")
        target = (page.parent / name) if name else page
        assert target.exists(), link
        assert not heading or heading in anchors(target), link


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: page.name)
def test_every_page_says_whom_it_is_for(page: Path) -> None:
    assert re.match(r"# .+\n\n\*For ", page.read_text())
