"""How far a command has come, shown on standard error where somebody may look."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress


@contextmanager
def progress(what: str, total: float, quiet: bool) -> Iterator[Callable[[float], None]]:
    """Give a function to say how much of `total` is done; shown on a terminal only, and not if `quiet`."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=quiet or not console.is_terminal) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)
