"""Sound phones must be silent: real phones on a table, judged by what other phones commonly show.

    python -m stillcal.replay.real_data.sound_phones FOLDER            # how many recordings have a finding
    python -m stillcal.replay.real_data.sound_phones FOLDER --learn    # the populations, as sound_phones.toml
    python -m stillcal.replay.real_data.sound_phones FOLDER --halves   # how many differ from half to half

FOLDER holds the still experiment of Stisen et al. 2015 (index.csv, still_accel.npz). Devices are dealt into
parts; the recordings of each part are judged by populations that were learnt from the devices of the others.
Every finding is looked for again in both halves of its recording.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.records import Discrepancy
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.direct import quantities
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.sound_phones import SoundPhones, Usual, sound_phones
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.formats.hhar_still import StillRecording, recordings

Device = tuple[str, str]

LEAST_LEVELS = 2
"""Different values on every axis: a sensor that gives one value always is broken, and tells of no other."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A recording with its findings, and those of them that both of its halves have too."""

    recording: StillRecording
    findings: list[Finding]
    confirmed: list[Finding]


Unlike = tuple[StillRecording, list[Discrepancy]]
"""A recording and how its second half differs from the first."""


def measured(samples: Samples) -> dict[str, Measured]:
    """Return what a recording measures of the quantities that populations are known of."""
    return measured_of(examine(samples, None))


def measured_of(exam: Examination) -> dict[str, Measured]:
    """Return the same of an examined recording, of the accelerometer where both sensors show it."""
    out = quantities.of_stamps(exam.accelerometer) | quantities.of_intervals(exam.accelerometer)
    for stream in reversed(exam.streams):
        out |= quantities.of_values(stream.samples)
        out |= stream.measured()
    return out


def by_device(recorded: Sequence[StillRecording]) -> dict[Device, dict[str, float]]:
    """Return every working device's quantities: the medians over its recordings."""
    values: dict[Device, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for one in recorded:
        for name, number in measured(one.samples).items():
            values[one.model, one.device][name].append(number.value)
    return {
        device: {name: float(np.median(numbers)) for name, numbers in own.items()}
        for device, own in values.items()
    }


def learnt(devices: Mapping[Device, Mapping[str, float]]) -> SoundPhones:
    """Return the populations that come with the package, with the numbers of these devices in them."""
    out = dict(sound_phones())
    for name, usual in out.items():
        numbers = np.sort([own[name] for own in devices.values() if name in own])
        if usual.devices.size and numbers.size:
            out[name] = Usual.of(numbers, usual.faulty, usual.source)
    return out


def judged(one: StillRecording, sound: SoundPhones) -> Judged:
    """Judge a recording, and its halves where it has a finding."""
    found = _findings(one.samples, sound)
    if not found:
        return Judged(one, [], [])
    middle = len(one.samples) // 2
    halves = [_findings(part, sound) for part in (one.samples[:middle], one.samples[middle:])]
    names = [{(f.effect, f.sensor) for f in half} for half in halves]
    confirmed = [f for f in found if all((f.effect, f.sensor) in half for half in names)]
    return Judged(one, found, confirmed)


def _findings(samples: Samples, sound: SoundPhones) -> list[Finding]:
    try:
        return [s.finding for s in examine(samples, None, sound=sound).statements]
    except NotSupported:
        return []


def held_out(recorded: Sequence[StillRecording], parts: int) -> list[Judged]:
    """Judge all recordings, each by populations learnt from the devices of the other parts."""
    devices = by_device([r for r in recorded if works(r)])
    order = sorted(devices | {(r.model, r.device): {} for r in recorded})
    part = {device: i % parts for i, device in enumerate(order)}
    out = []
    for k in range(parts):
        sound = learnt({d: own for d, own in devices.items() if part[d] != k})
        out += [judged(r, sound) for r in recorded if part[r.model, r.device] == k]
    return out


def unlike_halves(one: StillRecording) -> list[Discrepancy]:
    """Return how the second half of a recording differs from the first, compared as its simulation."""
    middle = len(one.samples) // 2
    exams = [examine(part, None) for part in (one.samples[:middle], one.samples[middle:])]
    return compare(exams[0], exams[1], ("the first half", "the second half")).discrepancies


def unlike(recorded: Sequence[StillRecording]) -> list[Unlike]:
    """Return the recordings whose halves differ, each with how."""
    return [(one, found) for one in recorded if (found := unlike_halves(one))]


def works(one: StillRecording) -> bool:
    """Whether the sensor gives more than one value on every axis."""
    return all(np.unique(one.samples.xyz[:, a]).size >= LEAST_LEVELS for a in range(3))


def as_toml(devices: Mapping[Device, Mapping[str, float]]) -> str:
    """Return the lines `devices = [...]` of sound_phones.toml, by quantity."""
    names = sorted({name for own in devices.values() for name in own})
    lines = []
    for name in names:
        numbers = sorted(own[name] for own in devices.values() if name in own)
        lines += [f"[{name}]", f"devices = [{', '.join(f'{x:.3f}' for x in numbers)}]", ""]
    return "\n".join(lines)


@click.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--learn", is_flag=True, help="Print what the devices show, quantity by quantity.")
@click.option("--halves", is_flag=True, help="Compare the second half of every recording with its first.")
@click.option("--parts", type=click.IntRange(min=2), default=5, help="Parts that devices are dealt into.")
@click.option("--verbose", is_flag=True, help="Print every finding.")
def main(folder: Path, parts: int, *, learn: bool, halves: bool, verbose: bool) -> None:
    """Count the recordings of real phones on a table that have a finding."""
    recorded = recordings(folder)
    if learn:
        click.echo(as_toml(by_device([r for r in recorded if works(r)])))
        return
    if halves:
        _say_unlike(recorded)
        return
    answers = held_out(recorded, parts)
    alarmed = [a for a in answers if a.findings]
    for answer in alarmed if verbose else []:
        one = answer.recording
        click.echo(f"{one.model} {one.device} {one.position}")
        for finding in answer.findings:
            where = "both halves" if finding in answer.confirmed else "not in both halves"
            click.echo(f"  {finding.effect} ({where}): {finding.statement}")
    counts = Counter(f.effect for a in answers for f in a.findings)
    click.echo(
        f"{len(alarmed)} of {len(answers)} recordings have a finding ({len(alarmed) / len(answers):.0%})"
    )
    click.echo(", ".join(f"{name} {count}" for name, count in counts.most_common()))
    every = sum(len(a.findings) for a in answers)
    click.echo(f"{sum(len(a.confirmed) for a in answers)} of {every} findings are in both halves too")


def _say_unlike(recorded: Sequence[StillRecording]) -> None:
    """Print how many recordings differ from half to half, and each that does."""
    differ = unlike(recorded)
    for one, found in differ:
        named = ", ".join(f"{d.effect} ({d.sensor}) {d.relation}" for d in found)
        click.echo(f"{one.model} {one.device} {one.position}: {named}")
    share = len(differ) / max(len(recorded), 1)
    click.echo(f"{len(differ)} of {len(recorded)} recordings differ from half to half ({share:.1%})")


if __name__ == "__main__":
    main()
