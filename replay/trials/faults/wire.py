"""The wire under fault, counted: `python -m stillcal.replay.trials.faults.wire` prints the figures.

Random bytes, single flipped bits on a long stream, and a pseudo-terminal that is pulled out in the middle
of frames and comes back under another name. Each part also checks what must hold and exits with 1 if it
does not.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import sys
import tempfile
import tty
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.sources.base import SerialSettings
from stillcal.daemon.sources.serial import SerialSource
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Message
from stillcal.daemon.wire.reassembly import WireCounters

READ = 4095
"""Bytes that one read from a terminal gives at most."""

BLOCK = 16


@dataclass(frozen=True, slots=True)
class Figures:
    """What one kind of fault came to. holds: whether all that must hold did."""

    name: str
    holds: bool
    counts: dict[str, int]


def block(index: int) -> Samples:
    """Return the index-th block of a stream whose every number tells its place."""
    number = index * BLOCK + np.arange(BLOCK)
    return Samples(Sensor.ACCELEROMETER, frozen(number / 100), frozen(np.sin(number[:, None] + np.arange(3))))


def delivered(messages: Iterable[Message]) -> list[int]:
    """Return the index of each block that came, -1 for one that is not bit for bit as it was sent."""

    def index(message: Message) -> int:
        if not isinstance(message, Samples) or not len(message):
            return -1
        at = round(float(message.t[0]) * 100) // BLOCK
        sent = block(at)
        same = sent.t.tobytes() == message.t.tobytes() and sent.xyz.tobytes() == message.xyz.tobytes()
        return at if same else -1

    return [index(message) for message in messages]


def random_bytes(count: int, seed: int) -> Figures:
    """Feed random bytes, then one block: nothing but the block may come."""
    decoder = WireDecoder()
    came = _fed(decoder, np.random.default_rng(seed).bytes(count))
    after = delivered(decoder.feed(b"\0" + WireEncoder().encode(block(0))))
    holds = not came and after == [0]
    return Figures(f"{count} random bytes", holds, {"accepted": len(came), **_told(decoder.counters)})


def flipped_bits(flips: int, seed: int) -> Figures:
    """Flip one bit in each of `flips` frames among three times as many: all others must come, in order."""
    rng = np.random.default_rng(seed)
    frames = list(_frames(3 * flips + 1))
    hit = set((rng.choice(3 * flips - 1, flips, replace=False) + 1).tolist())  # the ends show what is missing
    for i in hit:
        bit = int(rng.integers(8 * len(frames[i])))
        frames[i] = _flipped(frames[i], bit)
    decoder = WireDecoder()
    came = delivered(_fed(decoder, b"".join(frames)))
    intact = [i for i in range(len(frames)) if i not in hit]
    holds = came == intact and decoder.counters.lost_samples == BLOCK * flips
    counts = {"frames": len(frames), "intact": len(intact), "delivered": len(came)}
    counts["damaged and delivered"] = sum(i in hit or i < 0 for i in came)
    return Figures(f"{flips} single-bit flips", holds, counts | _told(decoder.counters))


def pulled_out(times: int, seed: int) -> Figures:
    """Pull a device out in the middle of a frame, again and again, each time to return by another name."""
    with tempfile.TemporaryDirectory() as folder:
        return asyncio.run(_pulled_out(times, np.random.default_rng(seed), Path(folder)))


async def _pulled_out(times: int, rng: np.random.Generator, folder: Path) -> Figures:
    frames, sent, came, written = _frames(1 << 62), 0, [], 0
    settings = SerialSettings(str(folder / "tty*"), retry_s=0.001, retry_max_s=0.01)
    async with SerialSource(settings) as source:
        for life in range(times):
            whole = b"".join(itertools.islice(frames, 5))
            half = next(frames)
            half = half[: int(rng.integers(3, len(half) - 1))]
            garbage = rng.bytes(int(rng.integers(1, 200))).replace(b"\0", b"\1")
            device = _Device(folder / f"tty{life}")
            while source.device != str(device.path):
                await asyncio.sleep(0)
            device.write(garbage + whole + half)
            written += len(garbage + whole + half)
            while source.wire.bytes < written:
                await asyncio.sleep(0)
            device.unplug()
            while source.connected:
                await asyncio.sleep(0)
            records = await source.take()
            came += delivered(r for r in records if isinstance(r, Samples))
            sent += 5
        expected = [i for i in range(6 * times) if i % 6 != 5]
        holds = came == expected and source.wire.truncated == times
        holds &= source.wire.lost_samples == BLOCK * (times - 1)
        counts = {"whole blocks sent": sent, "delivered": len(came), "connections": source.link.connections}
        return Figures(f"{times} times pulled out", holds, counts | _told(source.wire))


class _Device:
    """A pseudo-terminal under a name of its own."""

    def __init__(self, path: Path) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = path
        path.symlink_to(os.ttyname(self._slave))

    def write(self, data: bytes) -> None:
        if os.write(self._master, data) != len(data):
            raise BlockingIOError("the terminal did not take all")

    def unplug(self) -> None:
        self.path.unlink()
        os.close(self._master)
        os.close(self._slave)


def _frames(count: int) -> Iterator[bytes]:
    encoder = WireEncoder(WireSettings(block=BLOCK))
    return (encoder.encode(block(i)) for i in range(count))


def _flipped(frame: bytes, bit: int) -> bytes:
    changed = bytearray(frame)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def _fed(decoder: WireDecoder, data: bytes) -> list[Message]:
    return [m for i in range(0, len(data), READ) for m in decoder.feed(data[i : i + READ])]


def _told(counters: WireCounters) -> dict[str, int]:
    names = (
        "bad_frames",
        "crc_errors",
        "bad_lines",
        "malformed",
        "foreign",
        "truncated",
        "resynchronisations",
    )
    return {name: getattr(counters, name) for name in (*names, "lost_samples", "garbage_bytes")}


@click.command()
@click.option("--bytes", "count", default=1_000_000, show_default=True, help="Random bytes to feed.")
@click.option("--flips", default=20_000, show_default=True, help="Bits to flip, each in its own frame.")
@click.option("--times", default=100, show_default=True, help="How often to pull the device out.")
@click.option("--seed", default=1, show_default=True)
def main(count: int, flips: int, times: int, seed: int) -> None:
    """Count what faults on the wire come to; exit code 1 where something that must hold does not."""
    results = (random_bytes(count, seed), flipped_bits(flips, seed), pulled_out(times, seed))
    for figures in results:
        click.echo(f"{figures.name}: {'holds' if figures.holds else 'FAILS'}")
        for name, value in figures.counts.items():
            click.echo(f"  {name.replace('_', ' '):24}{value:>12}")
    sys.exit(not all(figures.holds for figures in results))


if __name__ == "__main__":
    main()
