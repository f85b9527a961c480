"""Algorithm 1 as printed beside the product's detector: rests found, energy, motion accepted.

Grammenos et al. 2018, 4.4 and Algorithm 1. What is right is known of simulated days; real devices that lie
still are those of the still experiment of Stisen et al. 2015.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.accelerometer.fit import AccelerometerSettings
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import attitude_labels
from stillcal.calib_core.static.settings import DetectorSettings, Mode
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.phone import Chunk, Simulation, Truth, population, simulate
from stillcal.replay.phone.simulation import TrueInterval
from stillcal.replay.studies.claim import (
    Claim,
    Evidence,
    Progress,
    Study,
    Verdict,
    holds,
    picture,
    table,
)
from stillcal.replay.studies.drawing import BLUE, RED, panels, save
from stillcal.replay.studies.grammenos2018.algorithm_1 import PaperRun, algorithm_1
from stillcal.replay.studies.grammenos2018.people import day_scenario, slowed
from stillcal.replay.studies.har.recordings import read_still

NAME, TITLE, WORK = (
    "stationary-states",
    "Stationary states: Algorithm 1 beside the detector",
    "Grammenos 2018",
)
PEOPLE, RATE_HZ = 4, 25.0
EVERY = 10_000
"""More states than a day holds: the algorithm runs to the end."""

LONG_WALK_S = 30.0
"""s without a stop: the algorithm is switched on at the beginning of such walks."""

EDGE_S = 0.5
"""s, a window of the detector: so far a state may reach over the ends of a true rest."""

STARTS = {"near 0": 0.01, "1 rad/s": 1.0, "0.1 mrad/s": 1e-4}
"""Where the gyroscope's minimum starts, rad/s: line 4 says "near 0", and gives no figure."""

PAPER = {
    "right": ("4.4, Algorithm 1", "what is accepted is a stationary state", "stated"),
    "start": ("4.4, Algorithm 1", "states by where its line 4 starts the minimum", "near 0, no figure"),
    "energy": ("4.4", "probing spares energy: share of time that sensors are on", "the point"),
    "merged": ("4.4, Figure 4", "nearby states are merged: states, and distinct attitudes", "merged"),
    "real": ("4.4, Algorithm 1", "a device that lies still is found to be stationary at a probe", "stated"),
    "ours": ("4.4", "the same by the product's detector, probing", "-"),
}


@dataclass(frozen=True, slots=True)
class Found:
    """What one detector made of days.

    states, attitudes: how many a day. right: share of states that lay still throughout, to a window of half a
    second at either end. walking, driving: states a day that did not, with walking or driving in them.
    rests: share of true rests of 5 s or more that a state lies in. sensing: share of the time that the
    sensors were on.
    """

    states: float
    attitudes: float
    right: float
    walking: float
    driving: float
    rests: float
    sensing: float


def joined(intervals: list[TrueInterval]) -> list[tuple[float, float]]:
    """Return the spans of intervals, s, those that follow one another without a pause as one."""
    found: list[tuple[float, float]] = []
    for i in intervals:
        if found and i.t_start - found[-1][1] < 1e-3:
            found[-1] = (found[-1][0], i.t_end)
        else:
            found.append((i.t_start, i.t_end))
    return found


def spans_of(truth: Truth, activity: str) -> list[tuple[float, float]]:
    """Return when somebody moved in one activity, s."""
    return joined([i for i in truth.intervals if i.activity == activity and not i.still])


def judge(spans: Array, up: Array, sensing: float, truth: Truth, duration: float) -> Found:
    """Hold states' spans (n, 2) s with their mean forces (n, 3) against what was really going on."""
    still = joined([i for i in truth.intervals if i.still])
    inside = np.array(
        [any(begin - EDGE_S <= a and b <= end + EDGE_S for begin, end in still) for a, b in spans], dtype=bool
    )
    moving = {
        activity: sum(
            any(a < end and begin < b for begin, end in spans_of(truth, activity))
            for (a, b), right in zip(spans, inside, strict=True)
            if not right
        )
        for activity in ("walk", "drive")
    }
    long = [(begin, end) for begin, end in still if end - begin >= 5.0]
    hit = [any(begin - EDGE_S <= a and b <= end + EDGE_S for a, b in spans) for begin, end in long]
    labels = attitude_labels(up, AccelerometerSettings().attitude_angle) if len(up) else np.zeros(0)
    return Found(
        states=float(len(spans)),
        attitudes=float(len(np.unique(labels))),
        right=float(inside.mean()) if len(spans) else np.nan,
        walking=float(moving["walk"]),
        driving=float(moving["drive"]),
        rests=float(np.mean(hit)),
        sensing=sensing / duration,
    )


def by_paper(simulation: Simulation, whole: Chunk, start: float) -> Found:
    """Run Algorithm 1 as printed over a simulation, all of whose samples are `whole`."""
    run = algorithm_1(whole.accelerometer, whole.gyroscope, states=EVERY, sigma_gyro_min=start)
    spans = np.array([(s.t_start, s.t_end) for s in run.states]).reshape(-1, 2)
    up = np.array([s.specific_force for s in run.states]).reshape(-1, 3)
    return judge(spans, up, run.sensing_s, simulation.truth, simulation.duration)


def first_while_walking(truth: Truth, whole: Chunk, start: float) -> list[bool]:
    """Return for each long walk whether Algorithm 1, switched on as it begins, first accepts walking."""
    eager = DetectorSettings(probe_min_s=0.0, probe_max_s=5.0)
    assert whole.gyroscope is not None, "the population has gyroscopes"
    found = []
    for begin, end in spans_of(truth, "walk"):
        if end - begin < LONG_WALK_S:
            continue
        accel, gyro = (s.between(begin, begin + 600.0) for s in (whole.accelerometer, whole.gyroscope))
        run = algorithm_1(accel, gyro, states=1, sigma_gyro_min=start, settings=eager)
        found.append(bool(run.states) and run.states[0].t_end <= end)
    return found


def by_detector(simulation: Simulation, mode: Mode) -> Found:
    """Run the product's detector over a simulation, probing or looking all the time."""
    detector = StationaryDetector(DetectorSettings(mode=mode))
    rests = []
    for chunk in simulation.chunks():
        assert chunk.gyroscope is not None, "the population has gyroscopes"
        rests += detector.feed(chunk.gyroscope, chunk.accelerometer)
    rests += detector.finish()
    spans = np.array([(r.t_start, r.t_end) for r in rests]).reshape(-1, 2)
    up = np.array([r.specific_force for r in rests]).reshape(-1, 3)
    on = detector.ledger.asked_s if mode is Mode.PROBE else simulation.duration
    return judge(spans, up, on, simulation.truth, simulation.duration)


def over_days(
    people: int, seed: int, progress: Progress
) -> tuple[dict[str, list[Found]], dict[str, list[bool]]]:
    """Run every detector over the days of simulated people; and Algorithm 1 from the start of each walk."""
    found: dict[str, list[Found]] = {}
    walks: dict[str, list[bool]] = {}
    for k, phone in enumerate(population(people, seed)):
        simulation = simulate(day_scenario(), slowed(phone, RATE_HZ), seed + k)
        whole = simulation.whole()
        for name, start in STARTS.items():
            found.setdefault(f"Algorithm 1, start {name}", []).append(by_paper(simulation, whole, start))
            walks.setdefault(name, []).extend(first_while_walking(simulation.truth, whole, start))
        found.setdefault("detector, probing", []).append(by_detector(simulation, Mode.PROBE))
        found.setdefault("detector, all the time", []).append(by_detector(simulation, Mode.SCAN))
        progress((k + 1) / people)
    return found, walks


def on_real_rests(data: Path) -> tuple[Array, Array]:
    """Return what share of probes Algorithm 1 accepts on devices that lie still; of time, our detector; (n,).

    Probes follow one another within a second.
    """
    printed, ours = [], []
    settings = DetectorSettings(probe_min_s=0.0, probe_max_s=1.0)
    for still in read_still(data):
        if still.frozen:
            continue
        accel = Samples.checked(Sensor.ACCELEROMETER, still.creation, still.accel)
        run: PaperRun = algorithm_1(accel, None, states=EVERY, settings=settings)
        printed.append(len(run.states) / max(run.probes, 1))
        detector = StationaryDetector()
        rests = [*detector.feed(accel), *detector.finish()]
        ours.append(sum(r.duration for r in rests) / float(still.creation[-1]))
    return np.array(printed), np.array(ours)


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Compare both on simulated days, and on real devices at rest."""
    found, walks = over_days(PEOPLE, seed, lambda share: progress(0.8 * share))
    mean = {name: mean_of(days) for name, days in found.items()}
    real = None if data is None else on_real_rests(data)
    claims = (*_claims(mean, walks), _real(real))
    files = (_draw(mean, real, figures),)
    progress(1.0)
    return Study(NAME, TITLE, claims, _text(mean, files[0]), files, seed)


def mean_of(days: list[Found]) -> Found:
    """Return the mean over days; right is that of all states, NaN without any."""
    columns = {f: np.array([getattr(d, f) for d in days]) for f in Found.__slots__}
    weight = columns["states"]
    right = np.nansum(columns["right"] * weight) / weight.sum() if weight.sum() else np.nan
    means = {name: float(values.mean()) for name, values in columns.items() if name != "right"}
    return Found(right=float(right), **means)


def _claims(mean: dict[str, Found], walks: dict[str, list[bool]]) -> list[Claim]:
    printed, ours = mean["Algorithm 1, start near 0"], mean["detector, probing"]
    high, low = mean["Algorithm 1, start 1 rad/s"], mean["Algorithm 1, start 0.1 mrad/s"]
    data = f"{PEOPLE} simulated people of `day`, its first 12 h at {RATE_HZ:.0f} Hz, phones drawn"
    rows = (
        (
            "right",
            f"{printed.right:.0%} of {printed.states:.0f} states a day lay still",
            holds(printed.right >= 0.95),
            f"holds for 95 % of states or more; start at {STARTS['near 0']:g} rad/s; from 1 rad/s"
            f" {high.right:.0%} of {high.states:.0f}",
        ),
        (
            "start",
            f"a day: {low.states:.0f} from 1e-4 rad/s, {printed.states:.0f} from 0.01, {high.states:.0f}"
            " from 1",
            Verdict.OPEN,
            "a start below the sensor's noise accepts nothing, ever, so that the minimum never learns."
            f" Switched on as a walk begins, the first state accepted is walking in {_of(walks['1 rad/s'])}"
            f" walks from 1 rad/s, in {_of(walks['near 0'])} from 0.01",
        ),
        (
            "energy",
            f"{printed.sensing:.1%} of the time, {printed.rests:.0%} of rests of 5 s and more",
            Verdict.OPEN,
            f"follows the pauses between probes, which the paper does not print: ours are drawn from"
            f" {DetectorSettings().probe_min_s:g} to {DetectorSettings().probe_max_s:g} s",
        ),
        (
            "merged",
            f"{printed.states:.0f} states in {printed.attitudes:.0f} attitudes a day",
            Verdict.OPEN,
            "distinct beyond 5 degrees; the paper shows one example, without figures",
        ),
        (
            "ours",
            f"{ours.right:.0%} of {ours.states:.0f} states lay still; {ours.rests:.0%} of rests found;"
            f" sensors on {ours.sensing:.1%} of the time",
            Verdict.OPEN,
            f"the same pauses between probes; {ours.walking:.1f} states a day with walking in them",
        ),
    )
    return [
        Claim(
            WORK,
            *PAPER[key],
            figure,
            data,
            verdict,
            why,
            evidence=Evidence.SIMULATION,
        )
        for key, figure, verdict, why in rows
    ]


def _real(real: tuple[Array, Array] | None) -> Claim:
    if real is None:
        why = "the real recordings are not here (--data)"
        return Claim(WORK, *PAPER["real"], "", "", Verdict.UNTESTED, why, evidence=Evidence.NONE)
    printed, ours = real
    figure = f"at {np.median(printed):.0%} of probes (quartiles {_quartiles(printed)})"
    why = (
        "holds where half of the recordings are accepted at nine probes in ten; accelerometer alone."
        f" The product's detector takes {np.median(ours):.0%} of a recording's time for rest"
    )
    data = f"hhar_still: {len(printed)} recordings of devices that lie still"
    good = float(np.median(printed)) >= 0.9
    return Claim(WORK, *PAPER["real"], figure, data, holds(good), why, evidence=Evidence.REAL)


def _of(flags: list[bool]) -> str:
    return f"{sum(flags)} of {len(flags)}"


def _quartiles(values: Array) -> str:
    low, high = np.percentile(values, [25, 75])
    return f"{low:.0%} to {high:.0%}"


def _draw(mean: dict[str, Found], real: tuple[Array, Array] | None, folder: Path) -> str:
    figure, (left, right) = panels(2)
    names = list(mean)
    place = np.arange(len(names))
    wrong = [mean[n].states * (1.0 - mean[n].right) if mean[n].states else 0.0 for n in names]
    left.barh(place, [mean[n].states for n in names], color=BLUE, label="all")
    left.barh(place, wrong, color=RED, label="not wholly at rest")
    left.set_yticks(place, [n.replace(", ", ",\n") for n in names])
    for row, name in enumerate(names):
        if not mean[name].states:
            left.text(0.0, row, " none: nothing is ever accepted", va="center", fontsize="small")
    left.invert_yaxis()
    left.set(xlabel="states a day (12 h)")
    left.legend(fontsize="small")
    if real is not None:
        right.hist(
            list(real),
            list(np.linspace(0.0, 1.0, 11)),
            color=[RED, BLUE],
            label=["Algorithm 1: probes accepted", "detector: time covered"],
        )
        right.legend(fontsize="small", loc="upper left")
    right.set(xlabel="share", ylabel="recordings", yscale="log", title="Real devices that lie still")
    return save(figure, folder, NAME)


def _text(mean: dict[str, Found], file: str) -> str:
    rows = [
        (
            name,
            f"{f.states:.0f}",
            f"{f.attitudes:.0f}",
            f"{f.right:.1%}" if f.states else "-",
            f"{f.walking:.1f}, {f.driving:.1f}",
            f"{f.rests:.0%}",
            f"{f.sensing:.1%}",
        )
        for name, f in mean.items()
    ]
    head = (
        "detector",
        "states a day",
        "attitudes",
        "lay still",
        "walking, driving in it",
        "rests found",
        "sensors on",
    )
    return "\n\n".join(
        [
            "Algorithm 1 is run as it is printed (`algorithm_1.py`): running minima of both deviations, a"
            " short window first, a longer one where that is calm. Line 4 starts the gyroscope's minimum"
            " *near 0*; three readings of that are tried. The product's detector probes with the same pauses,"
            f" or looks all the time. Means over {PEOPLE} days of twelve hours; *rests found*: share of true"
            " rests of 5 s or more with a state inside.",
            table(head, rows),
            picture(file, "States a day and those not wholly at rest; real devices that lie still"),
        ]
    )
