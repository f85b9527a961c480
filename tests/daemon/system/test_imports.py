"""Importing without the search for garbage, by itself and where commands are imported."""

from __future__ import annotations

import gc
import sys
from pathlib import Path

import click
import pytest

from stillcal.daemon.cli.lazy import LazyGroup
from stillcal.daemon.system.imports import without_collection


def test_nothing_is_searched_meanwhile_and_all_is_as_before_afterwards() -> None:
    with pytest.raises(ImportError), without_collection():
        assert not gc.isenabled()
        raise ImportError
    assert gc.isenabled()
    gc.disable()
    try:
        with without_collection():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_commands_are_imported_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_command.py").write_text(
        "import gc, click\nSEARCHED = gc.isenabled()\n@click.command()\ndef command(): ...\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    group = LazyGroup("group", own={"own": "own_command:command"}, sections={"Own": None})
    try:
        assert group.get_command(click.Context(group), "own") is not None
        assert sys.modules["own_command"].SEARCHED is False
        assert gc.isenabled()
    finally:
        sys.modules.pop("own_command", None)
