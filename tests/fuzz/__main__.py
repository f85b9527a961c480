"""Parsers tried with bytes that nobody meant: `make fuzz`, or `python -m tests.fuzz`.

Each target takes bytes and may raise only what its parser says it raises. Inputs are good ones that were cut,
spliced and changed (hypothesis), and bytes at random. An input also fails that takes longer than SLOWEST_S,
more memory than MOST_MEMORY, or ends the process. What makes a target fail is kept in tests/corpus/TARGET,
which the test suite feeds to it for ever after.
"""

from __future__ import annotations

import hashlib
import resource
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import click
from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from hypothesis import strategies as st

from tests.fuzz import files, protocols, recordings
from tests.fuzz.target import Target

EXAMPLES = 200
"""Inputs of one round; rounds follow one another until the time is up."""

MOST_BYTES = 2000
SLOWEST_S = 60
MOST_MEMORY = 1 << 30
"""Bytes that the process may grow by; seeds and their recordings are far below it."""

TARGETS: dict[str, Target] = {**protocols.TARGETS, **files.TARGETS, **recordings.TARGETS}


class TooMuchError(BaseException):
    """An input took too long. No Exception, which the readers of damaged files catch."""


def inputs(seeds: list[bytes]) -> st.SearchStrategy[bytes]:
    """Return a strategy for changed seeds: pieces of them joined by anything, and anything alone."""
    which = st.integers(0, len(seeds) - 1)
    piece = st.tuples(which, st.integers(0, _PLACES), st.integers(0, _PLACES)).map(
        lambda cut: _piece(seeds[cut[0]], *sorted(cut[1:]))
    )
    change = st.tuples(st.integers(0, _PLACES), st.binary(min_size=1, max_size=8) | st.sampled_from(_ENDS))
    changed = st.tuples(which, st.lists(change, min_size=1, max_size=6)).map(
        lambda change: _changed(seeds[change[0]], change[1])
    )
    spliced = st.lists(piece | which.map(lambda i: seeds[i]) | st.binary(max_size=40), max_size=5)
    return st.one_of(st.binary(max_size=MOST_BYTES), spliced.map(b"".join), changed, changed)


_PLACES = 1 << 20
_ENDS = [bytes(4), bytes(8), b"\xff" * 4, b"\xff" * 8, b"\xff\xff\xff\x7f", b"\0\0\xc0\x7f"]
_ENDS += [b"1e308", b"-1,", b"nan", b"99999999999999999999"]
"""Ends of ranges, as binary and as text."""


def _piece(data: bytes, first: int, last: int) -> bytes:
    """Return a stretch of a seed. first, last: shares of its length, in _PLACES."""
    return data[first * len(data) // _PLACES : last * len(data) // _PLACES]


def _changed(data: bytes, changes: list[tuple[int, bytes]]) -> bytes:
    """Write some bytes over a seed at places within it."""
    for place, over in changes:
        at = place % (len(data) + 1)
        data = data[:at] + over + data[at + len(over) :]
    return data


@contextmanager
def _limited() -> Iterator[None]:
    """Raise TooMuchError in whatever runs for longer than SLOWEST_S."""

    def late(*_: object) -> NoReturn:
        raise TooMuchError(f"more than {SLOWEST_S} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SLOWEST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def peak_bytes() -> int:
    """Return the most memory that this process has ever taken."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def feed_within(target: Target, data: bytes, room: int) -> None:
    """Give a target an input; raise TooMuchError beyond SLOWEST_S, or beyond a peak of `room` bytes."""
    with _limited():
        target.feed(data)
    if peak_bytes() > room:
        raise TooMuchError(f"more than {MOST_MEMORY} bytes of memory")


def fuzzed(
    target: Target, seconds: float, start: int, examples: int = EXAMPLES, trying: Path | None = None
) -> tuple[int, bytes | None]:
    """Try a target for so long, one round at least; return how many inputs, and the least one that failed.

    seconds: processor time of this process, which other programs do not use up.
    trying: where the input on trial is written, so that it is there when it ends the process.
    """
    until, tried, failed = time.process_time() + seconds, 0, [b""]
    seeds = target.seeds()
    for data in seeds:
        target.feed(data)
    room = peak_bytes() + MOST_MEMORY
    strategy = inputs(seeds)
    while True:

        @seed(start)
        @settings(
            max_examples=examples,
            phases=[Phase.generate, Phase.shrink],
            deadline=None,
            database=None,
            verbosity=Verbosity.quiet,
            suppress_health_check=list(HealthCheck),
        )
        @given(strategy)
        def round_(data: bytes) -> None:
            nonlocal tried
            tried, failed[0] = tried + 1, data
            if trying is not None:
                trying.write_bytes(data)
            feed_within(target, data, room)

        try:
            round_()
        except (Exception, TooMuchError):  # whatever it is, the input that did it is what is kept
            return tried, failed[0]
        start += 1
        if time.process_time() >= until:
            return tried, None


def keep(name: str, data: bytes, corpus: Path) -> Path:
    """Keep an input that made a target fail; return where."""
    path = corpus / name / hashlib.sha256(data).hexdigest()[:16]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


@click.command()
@click.option("--seconds", default=600.0, show_default=True, help="Processor time for each target.")
@click.option("--target", "chosen", type=click.Choice(list(TARGETS)), multiple=True, help="Only these.")
@click.option("--seed", "start", default=1, show_default=True)
@click.option("--corpus", type=click.Path(path_type=Path), default=Path("tests/corpus"), show_default=True)
def main(seconds: float, chosen: tuple[str, ...], start: int, corpus: Path) -> None:
    """Try every parser with inputs that nobody meant; exit code 1 where one failed."""
    failures = 0
    for name in chosen or TARGETS:
        trying = corpus / name / "on-trial"
        trying.parent.mkdir(parents=True, exist_ok=True)
        tried, failed = fuzzed(TARGETS[name], seconds, start, trying=trying)
        trying.unlink()
        outcome = "no failure" if failed is None else f"FAILED: {keep(name, failed, corpus)}"
        if failed is None and not any(trying.parent.iterdir()):
            trying.parent.rmdir()
        failures += failed is not None
        click.echo(f"{name:20}{tried:>9} inputs in {seconds:g} s of processor time: {outcome}")
    sys.exit(failures > 0)


if __name__ == "__main__":
    main()
