"""The peers, each optional: what is not installed is left out, and said so. Licences as packages state them.

scikit-digital-health (MIT), vqf (MIT), imucal (MIT), allantools (LGPL 3 or later; called, not copied), scipy
and pandas (BSD), pyarrow (Apache-2.0). imucal calibrates sessions whose regions a person has marked
(Ferraris), which no unaided recording has: only named here.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from types import ModuleType

PACKAGES = {
    "skdh": "scikit-digital-health",
    "vqf": "vqf",
    "imucal": "imucal",
    "allantools": "allantools",
    "scipy": "scipy",
    "pandas": "pandas",
    "pyarrow": "pyarrow",
}


def peer(module: str) -> ModuleType | None:
    """Import a peer; None where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        return None


def versions() -> dict[str, str | None]:
    """Return the version of every peer, None where it is not installed."""
    found: dict[str, str | None] = {}
    for package in PACKAGES.values():
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = None
    return found
