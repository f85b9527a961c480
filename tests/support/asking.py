"""Questions to the daemon's socket: by the independent varlink client, and by hand."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import varlink

from stillcal.daemon.store.store import Store

STILLCAL = str(Path(sys.executable).with_name("stillcal"))
NAME = "io.stillcal.Calibration"

Line = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@contextlib.contextmanager
def client(folder: Path) -> Iterator[Any]:
    with varlink.Client(address=f"unix:{folder}/socket") as found, found.open(NAME) as opened:
        yield opened


async def asked(folder: Path, ask: Callable[[Any], Any]) -> Any:
    def run() -> Any:
        with client(folder) as opened:
            return ask(opened)

    return await asyncio.to_thread(run)


def stored(folder: Path, *records: Any) -> None:
    for record in records:
        Store(folder / "store.json").publish(record)


async def connected(folder: Path) -> Line:
    return await asyncio.open_unix_connection(str(folder / "socket"))


async def ask(line: Line, method: str, **more: Any) -> Any:
    line[1].write(json.dumps({"method": f"{NAME}.{method}", **more}).encode() + b"\0")
    return json.loads((await line[0].readuntil(b"\0"))[:-1])
