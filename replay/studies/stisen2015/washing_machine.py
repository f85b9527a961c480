"""Phones on a washing machine: bulks of samples, and what stamps do (Stisen et al. 2015, 3.4, Figure 4).

Stamps are those of real devices at rest. Nobody taped one of them to a washing machine for these recordings:
what shakes them here is the simulated machine of the scenario `laundry`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.phone import load_phone, load_scenario, simulate
from stillcal.replay.phone.motion.trajectory import Waves
from stillcal.replay.studies.claim import Cause, Claim, Evidence, Progress, Study, holds, picture, table
from stillcal.replay.studies.drawing import BLUE, RED, panels, save
from stillcal.replay.studies.grammenos2018.people import slowed
from stillcal.replay.studies.har.data import without_recordings
from stillcal.replay.studies.har.devices import Device, read_devices
from stillcal.replay.studies.har.recordings import DATA, Still, by_device, read_still
from stillcal.replay.studies.stisen2015.families import few_devices

NAME, TITLE, WORK = "washing-machine", "On a washing machine (Figure 4)", "Stisen 2015"
SECONDS, EACH, RATE_HZ = 2.0, 20, 400.0
"""Length of a stretch, as the figure's; stretches a device; rate at which the machine's forces are made."""

A_MINUTE = 60.0 / SECONDS
"""Stretches in a minute."""

EARLY, LATE, NEAR = 0.25, 3.0, 0.2
"""Medians of the interval: a sample that comes within EARLY of the one before came in a bulk with it; nothing
for LATE is an outage; within NEAR of the median is almost equidistant."""

EVEN = 0.9
"""Share of intervals near the median above which samples are taken almost equidistantly."""

FOLLOWS = 0.9
"""Correlation of intervals by creation with those by arrival above which creation is stamped at delivery."""

SPIN_HZ = 5.0
"""Above it the machine spins, below it tumbles."""

SHOWN = ("LG-Nexus4", "Samsung-Galaxy-S+")
"""Models drawn here, the two that the paper put under load (Figure 2b)."""

PHONES = 2
"""Phones that Figure 4 shows, as examples. It names neither, so any models may be they."""

PAPER = {
    "bulks": (
        "3.4, Figure 4",
        "by arrival samples come in bulks, with outages between them",
        "two phones, not named",
    ),
    "even": (
        "3.4, Figure 4",
        "creation stamps show that such samples were taken almost equidistantly",
        "almost, two phones",
    ),
    "harm": ("3.4, Figure 4", "arrival stamps may be harmful where short events are timed", "may be"),
}


@dataclass(frozen=True, slots=True)
class Delivery:
    """How a phone's samples come. bulks, outages: in 2 s, by arrival; even: share of even creation intervals.

    interval: the median one, ms. together: correlation of the intervals by creation with those by arrival.
    late: rms of arrival less creation about its line, ms.
    """

    bulks: float
    outages: float
    even: float
    together: float
    late: float
    interval: float


def delivery(rests: list[Still]) -> Delivery:
    """Describe the deliveries of a phone's recordings, of the median interval by creation."""
    made = np.concatenate([np.diff(r.creation) for r in rests])
    came = np.concatenate([np.diff(r.arrival) for r in rests])
    middle, seconds = float(np.median(made)), sum(float(r.arrival[-1]) for r in rests)
    begins = (came < EARLY * middle) & ~np.r_[False, came[:-1] < EARLY * middle]
    return Delivery(
        bulks=SECONDS * int(begins.sum()) / seconds,
        outages=SECONDS * int(np.sum(came > LATE * middle)) / seconds,
        even=float(np.mean(np.abs(made / middle - 1.0) <= NEAR)),
        together=float(np.corrcoef(made, came)[0, 1]),
        late=1e3 * float(np.sqrt(np.mean(np.square(np.concatenate([lateness(r) for r in rests]))))),
        interval=1e3 * middle,
    )


def lateness(rest: Still) -> Array:
    """Return arrival less creation, (n,) s, about its straight line: the two clocks may run differently."""
    off = rest.arrival - rest.creation
    return np.asarray(off - np.polyval(np.polyfit(rest.creation, off, 1), rest.creation))


@dataclass(frozen=True, slots=True, eq=False)
class Shaken:
    """The machine's forces while it runs: pieces of (t, forces (n, 3) m/s^2, frequency Hz)."""

    pieces: list[tuple[Array, Array, float]]


def machine(seed: int) -> Shaken:
    """Let the simulated machine wash and spin beneath a faultless phone."""
    simulation = simulate(load_scenario("laundry"), slowed(load_phone("ideal"), RATE_HZ), seed)
    samples = simulation.whole().accelerometer
    pieces = []
    for piece in simulation.plan.pieces:
        course = piece.sways[0].course if piece.activity == "washer" and piece.sways else None
        if not isinstance(course, Waves) or piece.t_end - piece.t_start < 20.0:
            continue
        part = samples.between(piece.t_start + course.fade, piece.t_end - course.fade)
        pieces.append((part.t, part.xyz, float(course.frequency[0])))
    return Shaken(pieces)


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Two seconds as one device has them. made, came: (n,) s; forces: (n, 3) m/s^2; frequency: Hz, true."""

    made: Array
    came: Array
    forces: Array
    frequency: float


def stretch(shaken: Shaken, device: Device, rng: np.random.Generator) -> Stretch:
    """Sample the machine with a device's errors and noise at real creation stamps, drawn."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow to import

    rest = device.rests[rng.integers(len(device.rests))]
    first = int(rng.integers(np.searchsorted(rest.creation, rest.creation[-1] - SECONDS)))
    rows = slice(first, int(np.searchsorted(rest.creation, rest.creation[first] + SECONDS)))
    made = rest.creation[rows] - rest.creation[first]
    t, forces, frequency = shaken.pieces[rng.integers(len(shaken.pieces))]
    begin = rng.uniform(t[0], t[-1] - SECONDS)
    true = CubicSpline(t, forces)(begin + made)
    noise = device.noise(1, len(made), rng)[0]
    return Stretch(made, made + lateness(rest)[rows], device.distort(true) + noise, frequency)


def line(t: Array, forces: Array, frequency: float) -> float:
    """Return the amplitude, m/s^2, of the best sinusoid of a frequency in forces (n, 3) at t (n,).

    By least squares with a constant (Lomb and Scargle's), over the three axes together.
    """
    angle = 2.0 * np.pi * frequency * t
    waves = np.column_stack((np.cos(angle), np.sin(angle), np.ones(len(t))))
    return float(np.linalg.norm(np.linalg.lstsq(waves, forces, rcond=None)[0][:2]))


def kept(found: Stretch) -> float:
    """Return what share of the machine's line is left where samples are put at their arrival."""
    by_arrival, by_creation = (line(t, found.forces, found.frequency) for t in (found.came, found.made))
    return by_arrival / by_creation


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Describe real deliveries; put the simulated machine's forces at real stamps."""
    if data is None:
        return without_recordings(NAME, TITLE, [(WORK, *row) for row in PAPER.values()], seed)
    rests = [r for r in read_still(data) if not (r.reference or r.frozen or "iphone" in r.model)]
    deliveries = {name: delivery(own) for name, own in by_device(rests).items()}
    progress(0.2)
    shaken, devices = machine(seed), few_devices(read_devices(data))
    spins = Shaken([piece for piece in shaken.pieces if piece[2] > SPIN_HZ])
    stretches = {
        d.name: [stretch(spins, d, rng) for _ in range(EACH)]
        for d, rng in ((d, np.random.default_rng((seed, k))) for k, d in enumerate(devices))
    }
    progress(0.5)
    left = {name: float(np.median([kept(s) for s in found])) for name, found in stretches.items()}
    claims = _claims(deliveries)
    file = _draw(shaken, devices, seed, figures)
    progress(1.0)
    return Study(NAME, TITLE, claims, _text(deliveries, left, file), (file,), seed)


def bulky(found: dict[str, Delivery]) -> dict[str, Delivery]:
    """Return the phones with one bulk and one outage or more in two seconds."""
    return {name: d for name, d in found.items() if d.bulks >= 1.0 and d.outages >= 1.0}


def _claims(found: dict[str, Delivery]) -> tuple[Claim, ...]:
    """Judge by phone, as the figure shows two phones and names neither."""
    own = bulky(found)
    even = [name for name, d in own.items() if d.even >= EVEN]
    models = sorted({_model(name) for name in own})
    far = [name for name, d in own.items() if d.late >= d.interval]
    follow = ", ".join(f"{_short(n)} {d.together:.2f}" for n, d in own.items() if n not in even)
    late = [d.late for d in own.values()]
    rows = (
        (
            "bulks",
            f"{len(own)} of {len(found)} phones ({', '.join(map(_short, models)) or '-'})",
            len(own) >= PHONES,
            f"holds where {PHONES} phones or more, as many as the figure shows, have one bulk and one outage"
            f" or more in two seconds, {A_MINUTE:.0f} a minute. A bulk: samples within {EARLY:g} of the"
            f" median interval of one another; an outage: nothing for {LATE:g} of it. At rest: a machine has"
            " no part in it",
            Cause(f"every phone: {len(found) - len(own)} of {len(found)} deliver evenly", shown=False),
        ),
        (
            "even",
            f"{len(even)} of {len(own)} phones that come in bulks"
            f" ({', '.join(sorted({_short(_model(name)) for name in even})) or '-'})",
            len(even) >= PHONES,
            f"holds where {PHONES} of the phones that come in bulks or more have {EVEN:.0%} of intervals"
            f" within {NEAR:.0%} of the median",
            Cause(
                "how far intervals by creation follow those by arrival on the phones that come in bulks and"
                f" are not even: correlation {follow or '-'}. Where it is near 1 the creation stamp is given"
                " as the sample is delivered",
                shown=all(d.together > FOLLOWS for name, d in own.items() if name not in even),
            ),
        ),
        (
            "harm",
            f"by {min(late, default=0.0):.1f} to {max(late, default=0.0):.1f} ms rms; by an interval or more"
            f" on {len(far)} of {len(own)} phones",
            bool(far),
            "arrival less creation, about a line, on the phones that come in bulks; may: holds where a sample"
            " is put wrong by its own interval or more on one of them",
            Cause("every phone, see the table", shown=False),
        ),
    )
    return tuple(
        Claim(
            WORK,
            *PAPER[key],
            ours,
            f"{DATA}, all faces, without iPhones",
            holds(good),
            why,
            evidence=Evidence.REAL,
            cause=cause,
        )
        for key, ours, good, why, cause in rows
    )


def _model(name: str) -> str:
    """Return the model of a phone by its name, which ends with its own."""
    return name.rsplit(" ", 1)[0]


def _short(name: str) -> str:
    return name.removeprefix("Samsung-").removeprefix("LG-")


def _draw(shaken: Shaken, devices: list[Device], seed: int, folder: Path) -> str:
    figure, axes = panels(2, 2, sharey=False)
    chosen = [next(d for d in devices if d.model == model) for model in SHOWN]
    tumbling = Shaken([piece for piece in shaken.pieces if piece[2] <= SPIN_HZ][:1])
    for row, device in enumerate(chosen):
        found = stretch(tumbling, device, np.random.default_rng(seed))
        middle = float(np.median(np.diff(found.made)))
        for axis, t, title in (
            (axes[2 * row], found.came - found.came[0], "arrival"),
            (axes[2 * row + 1], found.made, "creation"),
        ):
            for k, (name, colour) in enumerate((("x", "0.78"), ("y", "0.5"), ("z", BLUE))):
                axis.plot(t, found.forces[:, k] - found.forces[:, k].mean(), ".-", color=colour, markersize=3,
                          linewidth=0.6, label=name)  # fmt: skip
            bulk = np.flatnonzero(np.diff(t) < EARLY * middle) + 1
            rows = np.unique(np.r_[bulk, bulk - 1]) if bulk.size else bulk
            axis.plot(t[rows], (found.forces[:, 2] - found.forces[:, 2].mean())[rows], ".", color=RED,
                      markersize=4, label="z, in bulks")  # fmt: skip
            axis.set(title=f"{_short(device.model)}, by {title}", xlabel="time, s", xlim=(0.0, SECONDS))
    for axis in axes[::2]:
        axis.set_ylabel("force less its mean, m/s²")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, markerscale=3)
    return save(figure, folder, NAME)


def _text(deliveries: dict[str, Delivery], left: dict[str, float], file: str) -> str:
    rows = [
        (name, f"{d.interval:.1f}", f"{d.bulks:.1f}", f"{d.outages:.1f}", f"{d.even:.0%}",
         f"{d.together:.2f}", f"{d.late:.1f}")
        for name, d in bulky(deliveries).items()
    ]  # fmt: skip
    head = (
        "phone",
        "median interval, ms",
        "bulks in 2 s",
        "outages in 2 s",
        "creation intervals near the median",
        "correlation with arrival's",
        "arrival off by, ms rms",
    )
    lines = ", ".join(f"{_short(name)} {share:.2f}" for name, share in left.items())
    return "\n\n".join(
        [
            "Stamps of real devices at rest, all faces; the table has those whose samples come in bulks."
            " Arrival was recorded to the millisecond; *off by*:"
            " arrival less creation, about a straight line in time.",
            table(head, rows),
            "No recording was made on a washing machine. The figure puts the simulated machine of the"
            " scenario `laundry` at the real stamps of two devices, with their own errors and noise, and"
            " shows what the paper's does. While the machine spins, at 10 to 25 Hz, its line keeps this share"
            f" of its amplitude where samples are put at their arrival: {lines}.",
            picture(
                file,
                "Two seconds of tumbling by arrival and by creation; blue: z, red: z of samples in bulks",
            ),
        ]
    )
