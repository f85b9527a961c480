"""A daemon on the test's own loop, and patience with limits: what the tests of this folder share."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

from stillcal.daemon.app import Service
from stillcal.daemon.app_launch import LaunchOptions
from stillcal.daemon.system.systemd import Notifier


def within_reason(test: Coroutine[Any, Any, None], seconds: float = 60.0) -> None:
    """Run a test's coroutine; one that hangs fails instead."""

    async def guarded() -> None:
        async with asyncio.timeout(seconds):
            await test

    asyncio.run(guarded())


def given_in(folder: Path, text: str = "") -> LaunchOptions:
    config = folder / "stillcal.toml"
    config.write_text(text)
    return LaunchOptions(config, str(folder / "tty"), str(folder / "store.json"), str(folder / "socket"))


async def until(holds: Callable[[], Any]) -> None:
    while not holds():
        await asyncio.sleep(0.001)


@contextlib.asynccontextmanager
async def started(
    given: LaunchOptions, environ: dict[str, str] | None = None
) -> AsyncIterator[tuple[Service, asyncio.Task[None]]]:
    """Run the daemon on this loop, with its task, and end it cleanly; what ended it is raised here."""
    service = Service(given.settings(), given, Notifier(environ or {}))
    service.open()
    task = asyncio.create_task(service.run())
    await until(lambda: hasattr(service, "session") or task.done())
    try:
        yield service, task
    finally:
        service.stop()
        await task


@contextlib.asynccontextmanager
async def running(given: LaunchOptions, environ: dict[str, str] | None = None) -> AsyncIterator[Service]:
    """Run the daemon on this loop and end it cleanly."""
    async with started(given, environ) as (service, _):
        yield service


@contextlib.asynccontextmanager
async def answering(folder: Path, text: str = "") -> AsyncIterator[Service]:
    """Run the daemon without a phone until it can be asked, or has ended."""
    async with started(given_in(folder, text)) as (service, task):
        await until(lambda: (folder / "socket").exists() or task.done())
        yield service
