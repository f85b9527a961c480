"""The scores that a study's verdicts were judged on: recorded while it runs, and judged again without it.

`python -m tests.support.judged NAME ...` runs studies on the real recordings and keeps their scores. A
function that judges is known by its annotations: it returns claims, and is given no verdict. What it was
called with is kept as it is, and comes back by those annotations.
"""

from __future__ import annotations

import importlib
import inspect
import json
import lzma
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
import pytest

from stillcal.replay.studies.claim import Claim, Verdict
from stillcal.replay.studies.registry import STUDIES, run

FOLDER = Path(__file__).parents[1] / "replay" / "studies" / "scores"
PACKAGE = "stillcal.replay.studies"
MOST, LARGE = 100_000, 10_000_000
"""Bytes of one call's scores, compressed and not. What is called with more is not kept: recordings."""

QUICK_S = 0.5
"""Processor time within which scores are judged, but for imports."""

Judging = Callable[..., Any]


class Call(msgspec.Struct, frozen=True):
    """One call of a function that judges. arguments: by parameter, encoded by `_plain`."""

    module: str
    function: str
    arguments: bytes


def kept_at(name: str) -> Path:
    """Return where a study's scores are kept."""
    return FOLDER / f"{name}.msgpack.xz"


def kept(name: str) -> list[Call]:
    """Read a study's scores."""
    return msgspec.msgpack.decode(lzma.decompress(kept_at(name).read_bytes()), type=list[Call])


def keep(name: str, calls: Sequence[Call]) -> None:
    """Keep a study's scores; without any there is no file."""
    if not calls:
        kept_at(name).unlink(missing_ok=True)
        return
    FOLDER.mkdir(exist_ok=True)
    kept_at(name).write_bytes(lzma.compress(msgspec.msgpack.encode(calls)))


def judged(call: Call) -> list[Claim]:
    """Judge kept scores by the function as it is now."""
    function = getattr(importlib.import_module(call.module), call.function)
    names = list(inspect.signature(function).parameters)
    hints = get_type_hints(function)
    types: Any = tuple.__class_getitem__(tuple(hints[name] for name in names))
    values = msgspec.msgpack.decode(call.arguments, type=types, dec_hook=_rich)
    claims = function(**dict(zip(names, values, strict=True)))
    return [claims] if isinstance(claims, Claim) else list(claims)


def recorded(name: str, data: Path, seed: int = 0) -> list[Call]:
    """Run a study, and return the scores of everything that can be judged again without it."""
    importlib.import_module(STUDIES[name].split(":")[0])
    whole = Seen(None, [])
    inside = [whole]
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as figures:
        for place in [m for n, m in sys.modules.items() if n.startswith(PACKAGE)]:
            for key, value in list(vars(place).items()):
                if inspect.isfunction(value) and value.__module__.startswith(PACKAGE) and _judges(value):
                    patch.setattr(place, key, _watched(value, inside))
        run(name, data, Path(figures), seed, lambda share: None)
    return whole.kept()


@dataclass
class Seen:
    """A call as it was seen, None where its scores cannot be kept, and those that it made itself."""

    call: Call | None
    within: list[Seen]

    def kept(self) -> list[Call]:
        """Return the call, or where it does not come back those within."""
        if self.call is not None and _comes_back(self.call):
            return [self.call]
        return [call for seen in self.within for call in seen.kept()]


def _judges(function: Judging) -> bool:
    if "Claim" not in str(function.__annotations__.get("return")):
        return False
    hints = get_type_hints(function)
    returned = hints.pop("return", None)
    parts = get_args(returned) if get_origin(returned) in {list, tuple} else (returned,)
    decided = any(hint in (bool, list[bool], Verdict) for hint in hints.values())
    return Claim in parts and set(parts) <= {Claim, ...} and not decided


def _watched(function: Judging, inside: list[Seen]) -> Judging:
    @wraps(function)
    def watched(*args: Any, **named: Any) -> Any:
        bound = inspect.signature(function).bind(*args, **named)
        bound.apply_defaults()
        arguments = _encoded(tuple(bound.arguments.values()))
        call = Call(function.__module__, function.__name__, arguments) if arguments is not None else None
        inside[-1].within.append(Seen(call, []))
        inside.append(inside[-1].within[-1])
        try:
            return function(*args, **named)
        finally:
            inside.pop()

    return watched


def _encoded(values: tuple[Any, ...]) -> bytes | None:
    try:
        encoded = msgspec.msgpack.encode(values, enc_hook=_plain)
    except (TypeError, NotImplementedError):
        return None
    small = len(encoded) <= LARGE and len(lzma.compress(encoded)) <= MOST
    return encoded if small else None


def _comes_back(call: Call) -> bool:
    """Tell whether the scores make claims again, and soon: what takes long measures, and does not judge."""
    begun = time.process_time()
    try:
        claims = judged(call)
    except (TypeError, msgspec.ValidationError):
        return False
    return bool(claims) and time.process_time() - begun <= QUICK_S


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype != object:
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.random.Generator):
        return json.dumps(value.bit_generator.state)
    raise NotImplementedError(type(value))


def _rich(kind: Any, value: Any) -> Any:
    if (get_origin(kind) or kind) is np.ndarray:
        dtype, shape, data = value
        return np.frombuffer(data, dtype).reshape(shape).copy()
    if kind is np.random.Generator:
        rng = np.random.default_rng()
        rng.bit_generator.state = json.loads(value)
        return rng
    raise NotImplementedError(kind)


if __name__ == "__main__":
    for study in sys.argv[1:]:
        found = recorded(study, Path(os.environ.get("STILLCAL_DATA", "../shared/data")))
        keep(study, found)
        print(study, sum(len(judged(call)) for call in found), "claims", flush=True)
