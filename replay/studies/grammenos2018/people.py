"""A day with nobody helping: rests found, time to a calibration, iterations (Grammenos et al. 2018, 4.2)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer.fit import AccelerometerSettings
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.engine.actions import Publish
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.rest import attitude_labels
from stillcal.calib_core.static.settings import DetectorSettings
from stillcal.calib_core.streams.events import Charging
from stillcal.replay.phone import Phone, Scenario, draw_rests, load_scenario, population, simulate
from stillcal.replay.phone.plan import Plan, play
from stillcal.replay.phone.settings import SensorSettings
from stillcal.replay.studies.claim import (
    Cause,
    Claim,
    Evidence,
    Progress,
    Study,
    Verdict,
    holds,
    picture,
    table,
)
from stillcal.replay.studies.drawing import BLUE, GREEN, RED, panels, save
from stillcal.replay.studies.grammenos2018.first_fits import (
    SCATTER_MG,
    UNCHECKED,
    FirstFits,
    converged_norms,
    first_fits,
)

NAME, TITLE, WORK = "people", "A day with nobody helping (4.2)", "Grammenos 2018"
PEOPLE, WATCHED, RATE_HZ = 100, 40, 5.0
"""People whose rests are drawn as they lie; how many of them go through the engine, and at what rate."""

HOUR_S, DAY_S = 3600.0, 12 * 3600.0
FOUND = (11, 13)
"""States that the paper found on its two days; nearby states are merged (4.4), so they are attitudes."""

PAUSES_S = (60.0, 300.0, 900.0, 1800.0, 3600.0)
"""Mean pauses between probes that are tried; Algorithm 1 draws them from 1 to an n that is not printed."""

STATES = 9
"""After so many the paper makes its first calibration (5.3)."""

DATA = f"{PEOPLE} simulated people of `day`, its first 12 h; their rests drawn as they lie, phones drawn"
PAPER = {
    "states": ("4.2", "stationary states in 12 h of a working day", "11 and 13 (two days of one person)"),
    "day": ("4.2", "first calibration within one day", "normally"),
    "own": ("4.2", "first calibration as the product makes it, and its intervals", "not said"),
    "enough": ("4.2", "fewer than 10 positions are needed", "usually"),
    "iterations": ("4.2", "iterations of the product's fit to everyday rests", "about 10, of Eq. 6"),
    "engine": ("4.2, 4.4", "rests found by the detector within its energy allowance", "not said"),
}


@dataclass(frozen=True, slots=True)
class Life:
    """One person's twelve hours.

    rests, attitudes: how many, and how many attitudes they are in. nine_at, calibrated_at: s until so many
    attitudes and until the first calibration of the accelerometer, infinite where it never came. iterations:
    of its fit.
    sensing: share of the time that the sensors were asked for, NaN where rests were drawn.
    """

    rests: int
    attitudes: int
    nine_at: float
    calibrated_at: float
    iterations: int
    sensing: float


def slowed(phone: Phone, rate_hz: float) -> Phone:
    """Return the phone with both sensors at another rate, without a low-pass that this rate cannot have."""

    def sensor(settings: SensorSettings) -> SensorSettings:
        beyond = settings.cutoff_hz is not None and settings.cutoff_hz >= 0.5 * rate_hz
        cutoff = None if beyond else settings.cutoff_hz
        return msgspec.structs.replace(settings, rate_hz=rate_hz, cutoff_hz=cutoff)

    gyro = None if phone.gyro is None else sensor(phone.gyro)
    return msgspec.structs.replace(phone, accel=sensor(phone.accel), gyro=gyro)


def live(phone: Phone, scenario: Scenario, seed: int) -> Life:
    """Let the daemon's engine live through it."""
    simulation, engine = simulate(scenario, phone, seed), Engine()
    nine, calibrated, iterations = np.inf, np.inf, 0
    for chunk in simulation.chunks():
        items = () if chunk.gyroscope is None else (chunk.gyroscope,)
        for action in engine.feed(*items, chunk.accelerometer, *chunk.events):
            if not isinstance(action, Publish) or np.isfinite(calibrated):
                continue
            if (fit := action.record.accelerometer) is not None:
                calibrated, iterations = action.t, fit.iterations or 0
        if engine.present.attitudes >= STATES:
            nine = min(nine, chunk.t_end)
    state = engine.present
    sensing = engine.ledger.asked_s / simulation.duration
    return Life(state.counters.rests, state.attitudes, nine, calibrated, iterations, sensing)


def drawn_life(phone: Phone, scenario: Scenario, seed: int) -> Life:
    """Take every rest of the day that is long enough, drawn as it lies, and calibrate while charging."""
    plan, shortest = play(scenario, seed), DetectorSettings().settle_s + DetectorSettings().w_min_s
    still = [p for p in plan.pieces if p.still and min(p.t_end, plan.duration) - p.t_start >= shortest]
    up = np.array([p.attitude[2] for p in still])
    ends = np.array([min(p.t_end, plan.duration) for p in still])
    rests = draw_rests(phone, len(still), seed, attitudes=up, gravity=still[0].gravity)
    labels = attitude_labels(up, AccelerometerSettings().attitude_angle)
    distinct = np.cumsum(np.bincount(np.unique(labels, return_index=True)[1], minlength=len(up)))
    nine = ends[distinct >= STATES]
    calibrated, iterations = np.inf, 0
    for t in _occasions(plan, ends):
        n = int(np.sum(ends <= t))
        try:
            fit = accelerometer.fit(rests.forces[:n], rests.uncertainties[:n], rests.gravity)
        except NotSupported:
            continue
        calibrated, iterations = t, fit.iterations
        break
    first = float(nine[0]) if nine.size else np.inf
    return Life(len(still), int(distinct[-1]), first, calibrated, iterations, np.nan)


def _occasions(plan: Plan, ends: Array) -> list[float]:
    """Return when a calibration is tried: as a charger is plugged in, and after each rest while it is (s)."""
    events = [e for e in plan.events if isinstance(e, Charging)]
    closes = [*(e.t for e in events[1:]), plan.duration]
    spans = [(e.t, close) for e, close in zip(events, closes, strict=True) if e.on]
    return sorted(
        t for begin, close in spans for t in (begin, *ends[(ends > begin) & (ends <= close)].tolist())
    )


def day_scenario() -> Scenario:
    """Return the first twelve hours of the scenario `day`."""
    return msgspec.structs.replace(load_scenario("day"), duration_s=DAY_S)


def lives(people: int, watched: int, seed: int, progress: Progress) -> tuple[list[Life], list[Life]]:
    """Return everybody's day as drawn, and the first few's as the engine lived through it."""
    scenario = day_scenario()
    phones = population(people, seed)
    drawn, lived = [], []
    for k, phone in enumerate(phones):
        drawn.append(drawn_life(phone, scenario, seed + k))
        progress(0.2 * (k + 1) / people)
    for k, phone in enumerate(phones[:watched]):
        lived.append(live(slowed(phone, RATE_HZ), scenario, seed + k))
        progress(0.2 + 0.8 * (k + 1) / watched)
    return drawn, lived


def everyday_attitudes(scenario: Scenario, seed: int) -> Array:
    """Return the up direction of every rest of the scenario that is long enough, in order, (n, 3)."""
    shortest = DetectorSettings().settle_s + DetectorSettings().w_min_s
    plan = play(scenario, seed)
    still = [p for p in plan.pieces if p.still and min(p.t_end, plan.duration) - p.t_start >= shortest]
    return np.array([p.attitude[2] for p in still])


def merged(up: Array) -> Array:
    """Return the first of each attitude, (n, 3) to (k, 3); the paper merges "nearby" states (Figure 4)."""
    labels = attitude_labels(up, AccelerometerSettings().attitude_angle)
    return np.asarray(up[np.sort(np.unique(labels, return_index=True)[1])])


def fewest_positions(phone: Phone, up: Array, seed: int, *, checked: bool = True) -> float:
    """Return with how many of the attitudes (n, 3), in order, the accelerometer can first be calibrated.

    checked: whether a fit is refused that the attitudes do not support well; else it only has to converge to
    a model of a phone's size, as the paper asks. Infinite where all n do not suffice.
    """
    rests = draw_rests(phone, len(up), seed, attitudes=up)
    settings = AccelerometerSettings() if checked else UNCHECKED
    for n in range(3, len(up) + 1):
        try:
            accelerometer.fit(rests.forces[:n], rests.uncertainties[:n], rests.gravity, settings=settings)
        except NotSupported:
            continue
        return float(n)
    return np.inf


def calibrated_share(phones: list[Phone], days: list[Array], seed: int, states: int) -> float:
    """Return the share of phones calibrated from so many of their day's attitudes, drawn among all."""
    done = []
    for k, (phone, up) in enumerate(zip(phones, days, strict=True)):
        chosen = np.sort(np.random.default_rng(seed + k).permutation(len(up))[:states])
        rests = draw_rests(phone, len(chosen), seed + k, attitudes=up[chosen])
        try:
            accelerometer.fit(rests.forces, rests.uncertainties, rests.gravity)
        except NotSupported:
            done.append(False)
        else:
            done.append(True)
    return float(np.mean(done))


def probed(plan: Plan, pause: float, seed: int) -> tuple[int, int]:
    """Return how many probes of a day meet a rest, and in how many attitudes, drawn as by Algorithm 1.

    Pauses are even between none and twice the mean `pause`, s; a window of the shortest length must lie in a
    rest.
    """
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.0, 2.0 * pause, int(3.0 * plan.duration / pause)))
    least = DetectorSettings().w_min_s
    still = [p for p in plan.pieces if p.still]
    met = [p for t in times for p in still if p.t_start <= t and t + least <= min(p.t_end, plan.duration)]
    return len(met), len(merged(np.array([p.attitude[2] for p in met]))) if met else 0


def positions(phones: list[Phone], everyday: list[Array], seed: int) -> dict[str, Array]:
    """Return how many merged positions each phone needs: of its day, unchecked, and in random attitudes."""
    anywhere = [draw_rests(phone, 20, seed + k).true_forces for k, phone in enumerate(phones)]
    spread = [up / np.linalg.norm(up, axis=1, keepdims=True) for up in anywhere]
    return {
        "everyday": np.array([fewest_positions(p, everyday[k], seed + k) for k, p in enumerate(phones)]),
        "unchecked": np.array(
            [fewest_positions(p, everyday[k], seed + k, checked=False) for k, p in enumerate(phones)]
        ),
        "random": np.array([fewest_positions(p, spread[k], seed + k) for k, p in enumerate(phones)]),
    }


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Let a hundred people live through twelve hours."""
    found, lived = lives(PEOPLE, WATCHED, seed, progress)
    phones = population(PEOPLE, seed)
    days = [everyday_attitudes(day_scenario(), seed + k) for k in range(PEOPLE)]
    states = [merged(up) for up in days]
    drawn = tuple(calibrated_share(phones, states, seed, n) for n in FOUND)
    fewest = positions(phones, states, seed)
    norms = converged_norms(phones, states, seed, FOUND[0])
    raw = [len(merged(up[:: max(len(up) // FOUND[0], 1)][: FOUND[0]])) for up in days]
    plans = [play(day_scenario(), seed + k) for k in range(WATCHED)]
    met = {
        pause: np.array([probed(plan, pause, seed + k) for k, plan in enumerate(plans)]) for pause in PAUSES_S
    }
    claims = (
        _states(found, met),
        _day(fewest, drawn, raw, norms),
        _own([first_fits(phones, states, seed, n, SCATTER_MG) for n in FOUND], len(phones)),
        _enough(fewest),
        _iterations(found),
        _engine(found, lived),
    )
    file = _draw(found, figures)
    progress(1.0)
    return Study(NAME, TITLE, claims, _text(found, lived, fewest, file), (file,), seed)


def _column(found: list[Life], name: str) -> Array:
    return np.array([float(getattr(life, name)) for life in found])


def _span(values: Array) -> tuple[float, float, float]:
    low, mid, high = np.percentile(values, [5, 50, 95], method="closest_observation")
    return float(low), float(mid), float(high)


def _states(found: list[Life], met: dict[float, Array]) -> Claim:
    rests, attitudes = _span(_column(found, "rests")), _span(_column(found, "attitudes"))
    ours = (
        f"{rests[1]:.0f} rests (5 to 95 %: {rests[0]:.0f} to {rests[2]:.0f}) in {attitudes[1]:.0f} attitudes"
        f" ({attitudes[0]:.0f} to {attitudes[2]:.0f})"
    )
    why = "would hold with 11 and 13 within 5 to 95 % of the distinct attitudes"
    listed = ", ".join(
        f"{pause / 60.0:.0f} min {np.median(own[:, 0]):.0f} in {np.median(own[:, 1]):.0f}"
        for pause, own in met.items()
    )
    often = [float(np.median(own[:, 1])) for own in met.values()]
    cause = Cause(
        "how often one looks. Probed as Algorithm 1 does, the same days give, by the mean pause between"
        f" probes, states in attitudes: {listed} (medians of {WATCHED} days). The paper does not print its"
        " pauses",
        shown=min(often) <= FOUND[1] and max(often) >= FOUND[0],
    )
    good = attitudes[0] <= FOUND[0] and attitudes[2] >= FOUND[1]
    return Claim(
        WORK, *PAPER["states"], ours, DATA, holds(good), why, evidence=Evidence.SIMULATION, cause=cause
    )


def _day(fewest: dict[str, Array], drawn: tuple[float, ...], raw: list[int], norms: Array) -> Claim:
    """Judge a first calibration. drawn: share calibrated from FOUND attitudes of any time of the day.

    raw: how many attitudes as many rests lie in that are spread over the day and not merged.
    """
    eleven, thirteen = (float(np.mean(fewest["everyday"] <= n)) for n in FOUND)
    ours = f"{eleven:.0%} of phones from {FOUND[0]} states, {thirteen:.0%} from {FOUND[1]}"
    why = (
        "normally: in more than half, from as many merged states (4.4) as the paper found in 12 h on either"
        " of its days, the day's first ones, as in the next row; drawn from the whole day"
        f" {' and '.join(f'{share:.0%}' for share in drawn)}. That is until the fit is not refused; one that"
        f" only has to converge, as in the paper, does so from {FOUND[0]} states for {len(norms)} of {PEOPLE}"
        f" phones (norm over all directions off by {np.median(norms[:, 0]):.2f} →"
        f" {np.median(norms[:, 1]):.3f} m/s² on the median)"
    )
    enough = float(np.mean(np.isfinite(fewest["everyday"])))
    cause = Cause(
        f"all attitudes of such a day calibrate {enough:.0%} of phones: {FOUND[0]} are too few. Not merged,"
        f" {FOUND[0]} rests lie in {np.median(raw):.0f} attitudes",
        shown=enough > 0.5,
    )
    good = min(eleven, thirteen) > 0.5
    return Claim(WORK, *PAPER["day"], ours, DATA, holds(good), why, evidence=Evidence.SIMULATION, cause=cause)


def _own(fits: list[FirstFits], phones: int) -> Claim:
    """State the product's own first calibrations from FOUND states."""
    done, held, worse = (
        " and ".join(form.format(getattr(fit, name)) for fit in fits)
        for name, form in (("done", "{:.0%}"), ("held", "{:.1%}"), ("worse", "{}"))
    )
    ours = f"{done} of phones from {FOUND[0]} and {FOUND[1]} states; {held} of their 95 % intervals hold"
    why = (
        "the first states of the day, as in the row before, with what data sheets say of sound phones where"
        f" they do not suffice; the bias differs by {SCATTER_MG:g} mg (rms) from rest to rest; intervals of"
        f" the parameters. Norms over all directions are further off than raw for {worse} of {phones} phones"
    )
    return Claim(WORK, *PAPER["own"], ours, DATA, Verdict.OPEN, why, evidence=Evidence.SIMULATION)


def _enough(fewest: dict[str, Array]) -> Claim:
    low, mid, high = _span(fewest["everyday"])
    under = {name: float(np.mean(values < 10)) for name, values in fewest.items()}
    ours = f"{under['everyday']:.0%} of phones; median {mid:.0f} (5 to 95 %: {low:.0f} to {high:.0f})"
    why = (
        "usually: in more than half; distinct everyday attitudes, in the order of a day, until the fit is not"
        " refused"
    )
    cause = Cause(
        f"{under['random']:.0%} in random attitudes, which are less alike than everyday ones;"
        f" {under['unchecked']:.0%} where a fit only has to converge, as in the paper",
        shown=min(under["random"], under["unchecked"]) > 0.5,
    )
    data = f"{PEOPLE} phones drawn as in Stisen et al., their rests as they lie in `day`"
    return Claim(
        WORK,
        *PAPER["enough"],
        ours,
        data,
        holds(under["everyday"] > 0.5),
        why,
        evidence=Evidence.SIMULATION,
        cause=cause,
    )


def _iterations(found: list[Life]) -> Claim:
    steps = np.array([life.iterations for life in found if np.isfinite(life.calibrated_at)], dtype=float)
    low, mid, high = _span(steps)
    why = (
        "Eq. 8 at 1e-6 with Marquardt's damping, not the paper's fixed delta, which it does not print: see"
        " `minimisation`"
    )
    ours = f"{mid:.0f} (5 to 95 %: {low:.0f} to {high:.0f})"
    return Claim(WORK, *PAPER["iterations"], ours, DATA, Verdict.OPEN, why, evidence=Evidence.SIMULATION)


def _engine(found: list[Life], lived: list[Life]) -> Claim:
    """Hold the engine's days against the same people's as drawn."""
    share = np.median(_column(lived, "rests") / _column(found[: len(lived)], "rests"))
    here, there = _column(lived, "calibrated_at"), _column(found[: len(lived)], "calibrated_at")
    late = int(np.sum(here > there + HOUR_S))
    ours = f"{share:.0%} of the rests, sensing {np.median(_column(lived, 'sensing')):.1%} of the time"
    why = (
        "medians, against all rests of the same days, drawn; first calibration after"
        f" {_span(here / HOUR_S)[1]:.1f} h on the median, over an hour later for {late} of {len(lived)}"
    )
    data = f"{len(lived)} of these people, sample by sample at {RATE_HZ:.0f} Hz through the engine"
    return Claim(WORK, *PAPER["engine"], ours, data, Verdict.OPEN, why, evidence=Evidence.SIMULATION)


def _draw(found: list[Life], folder: Path) -> str:
    figure, (left, right) = panels(2)
    attitudes = _column(found, "attitudes")
    left.hist(attitudes, list(np.arange(attitudes.min() - 0.5, attitudes.max() + 1.5)), color=BLUE)
    for state in FOUND:
        left.axvline(state, color=RED, linestyle="--")
    left.set(xlabel="distinct attitudes in 12 h (dashed: the paper's merged states)", ylabel="people")
    for name, colour, label in (
        ("nine_at", GREEN, "nine attitudes"),
        ("calibrated_at", BLUE, "first calibration"),
    ):
        hours = np.sort(_column(found, name)) / HOUR_S
        hours = np.minimum(hours, DAY_S / HOUR_S)
        right.step(hours, np.arange(1, len(hours) + 1) / len(hours), where="post", color=colour, label=label)
    right.set(xlabel="hours since the start", ylabel="share of people", xlim=(0, 12))
    right.legend(loc="lower right")
    return save(figure, folder, NAME)


def _text(found: list[Life], lived: list[Life], fewest: dict[str, Array], file: str) -> str:
    rows = []
    for name, words, unit in (
        ("rests", "rests", 1.0),
        ("attitudes", "distinct attitudes", 1.0),
        ("nine_at", f"{STATES} attitudes after, h", HOUR_S),
        ("calibrated_at", "first calibration after, h", HOUR_S),
        ("iterations", "iterations of its fit", 1.0),
    ):
        rows.append((f"{words}, drawn", *(f"{v:.3g}" for v in _span(_column(found, name) / unit))))
        rows.append((f"{words}, engine", *(f"{v:.3g}" for v in _span(_column(lived, name) / unit))))
    for name, words in (
        ("everyday", "distinct everyday attitudes until a fit is not refused"),
        ("unchecked", "the same until a fit converges"),
        ("random", "random attitudes until a fit is not refused"),
    ):
        rows.append((words, *(f"{v:.0f}" for v in _span(fewest[name]))))
    return "\n\n".join(
        [
            "Each person lives the first twelve hours of the scenario `day` with a course, attitudes and a"
            " phone of their own. Rests are drawn as they lie, with the phone's errors and noise, and"
            " calibrated by the product's fit whenever a charger is plugged in and after each rest while it"
            f" is. For {len(lived)} of them the engine itself lives through the day, with its detector and"
            " its energy allowance. Calibrations are the accelerometer's: the engine states the gyroscope's"
            " bias after its first rests already. An infinite time means not within the twelve hours.",
            f"The paper found {FOUND[0]} and {FOUND[1]} states in twelve hours; a simulated day has"
            f" {np.median(_column(found, 'rests')):.0f} rests in {np.median(_column(found, 'attitudes')):.0f}"
            " attitudes. The paper merges nearby states, so attitudes are what its states are compared with:"
            " rests of one attitude tell a fit little that is new. From all rests of the day"
            f" {np.mean(np.isfinite(_column(found, 'calibrated_at'))):.0%} of phones are calibrated while a"
            " charger is plugged in, which is what the times in the table are of. The drawn days fit"
            " the rests alone; the engine adds what is known of sound phones, so that its first calibration"
            " comes with the first charge.",
            picture(file, "Attitudes found in twelve hours; time to nine attitudes and to a calibration"),
            table(("", "5 %", "median", "95 %"), rows),
        ]
    )
