"""Libraries that only some formats need, each in an extra of its own."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from stillcal.replay.formats.errors import TraceError


def library(module: str, extra: str, path: Path, kind: str) -> Any:
    """Import the library that reads a kind of file. Raises TraceError, naming the extra, without it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.split(".", maxsplit=1)[0]
        what = f"is {kind}, and {package}, which reads it, is not installed"
        raise TraceError(path, what, f"pip install 'stillcal[{extra}]'") from None
