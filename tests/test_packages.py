"""The wheel holds every package of the product: a new one has to be named in pyproject.toml."""

from __future__ import annotations

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
NOT_SHIPPED = {"studies", "trials", "real_data"}
"""What only a checkout has: the papers' evaluation, the trials behind the docs, other people's recordings."""


def test_every_package_of_the_product_is_named() -> None:
    named = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    found = {
        ".".join(("stillcal", *init.parent.relative_to(ROOT).parts))
        for top in ("calib_core", "daemon", "replay")
        for init in (ROOT / top).rglob("__init__.py")
        if NOT_SHIPPED.isdisjoint(init.parts)
    }
    assert found <= named
