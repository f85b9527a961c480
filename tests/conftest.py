"""Fixtures that all tests share: where the real recordings are."""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the commands do; before numpy is first imported
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # or each process that is started compiles stillcal anew

import pytest


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real recordings, from STILLCAL_DATA or beside the checkout; skips where absent."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("STILLCAL_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"real recordings not found at {folder}: set STILLCAL_DATA to their folder")
    return folder
