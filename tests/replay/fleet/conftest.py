"""A fleet of a few simulated phones, made once."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="needs the extra fleet")

from stillcal.replay.fleet.simulate_fleet import fleet


@pytest.fixture(scope="session")
def phones(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight readable recordings and two that are not."""
    folder = tmp_path_factory.mktemp("fleet")
    fleet(folder, 8, bad=2)
    return folder
