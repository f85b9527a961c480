"""Drawing the cases of a blind test: hidden effect, phone, motion, and the recording with its key."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from itertools import cycle
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.blind_test import simulator_cases as simulated
from stillcal.replay.blind_test.keys import Exam, Key, TrueEffect
from stillcal.replay.blind_test.off_catalogue import OFF_CATALOGUE, drawn_span
from stillcal.replay.blind_test.power import detectability as power
from stillcal.replay.blind_test.power.sizing import NAMES, Stage, as_recorded, drawn_effect, put_in
from stillcal.replay.blind_test.world import phones
from stillcal.replay.blind_test.world.day import World, binned, over_bins
from stillcal.replay.blind_test.world.days import Day, play
from stillcal.replay.blind_test.world.noise import FAMILIES, log_uniform
from stillcal.replay.blind_test.world.phones import Additions, MadeRecording, Phone

SHARES = {"null": 0.32, "decoy": 0.14, "single": 0.36, "pair": 0.06, "off_catalogue": 0.12}
"""Share of each kind among the trials."""

DECOYS = ("thermometer", "breathing", "heartbeat", "creep", "vehicle", "quantisation", "location")
LADDER = (2.0, 4.0, 6.0, 8.0, 12.0, 20.0)
"""Values of d' for single effects, from invisible to obvious."""

CLEAR = (10.0, 16.0, 25.0)
"""Values of d' for pairs and for effects outside the catalogue."""

FULL_EVERY = 50
"""One case in this many is one hour long; the others are shorter."""

PAIRS = (
    ("accel_bias_temperature", "gyro_bias_step"),
    ("accel_charging_bias", "gyro_g_sensitivity"),
    ("accel_bias_step", "dropped_samples"),
    ("gyro_bias_temperature", "accel_nonlinearity"),
    ("accel_scale_temperature", "noise_level"),
    ("gyro_warmup", "accel_bias_temperature"),
    ("clock_skew", "gyro_charging_bias"),
    ("accel_bias_temperature", "accel_charging_bias"),
)
WITH_TURNS = (
    "accel_scale_temperature",
    "accel_nonlinearity",
    "gyro_g_sensitivity",
    "gyro_scale_temperature",
    "gyro_nonlinearity",
    "accel_gyro_time_offset",
    "accel_saturation",
    "gyro_saturation",
    "lever_arm",
)
"""Effects that show only in a phone that is rotated often."""

LARGEST = {"accel": 0.6, "gyro": 0.1}
"""Largest value that effects may add, m/s^2 and rad/s: only a broken phone has more."""

LOCAL_GRAVITY = (9.764, 9.834)
"""Span of gravity over the Earth's surface, m/s^2 (Hirt et al. 2013, GGMplus: 9.7639 to 9.8337)."""


@dataclass(frozen=True, slots=True)
class Design:
    """The design of a case. names: of the effects, or of the variant; d_prime: of each effect."""

    kind: str
    family: str
    maker: str
    names: tuple[str, ...]
    d_prime: float
    full_length: bool


def planned(trials: int, seed: int) -> list[Design]:
    """Return the designs of all trials, in random order."""
    rng = np.random.default_rng([seed, 0])
    counts = {kind: max(round(trials * share), 1) for kind, share in SHARES.items()}
    counts["null"] = max(trials - sum(n for k, n in counts.items() if k != "null"), 1)
    designs = [d for kind, count in counts.items() for d in _of_kind(kind, count, rng)]
    return [designs[i] for i in rng.permutation(len(designs))][:trials]


def _of_kind(kind: str, count: int, rng: np.random.Generator) -> list[Design]:
    variants: dict[str, list[tuple[str, ...]]] = {
        "null": [()],
        "decoy": [(d,) for d in DECOYS],
        "single": [(n,) for n in NAMES],
        "pair": [*PAIRS],
        "off_catalogue": [(n,) for n in OFF_CATALOGUE],
    }
    names = cycle([variants[kind][i] for i in rng.permutation(len(variants[kind]))])
    ladder = LADDER if kind == "single" else CLEAR
    return [_design(kind, next(names), float(rng.choice(ladder)), i, rng) for i in range(count)]


def _design(kind: str, names: tuple[str, ...], d: float, i: int, rng: np.random.Generator) -> Design:
    can = (
        kind == "null"
        or names == ("creep",)
        or (kind in ("single", "pair") and set(names) <= set(simulated.CAN))
    )
    # Two thirds of what the simulated phone can play go to it, so that it makes about half of all cases.
    maker = "simulator" if can and rng.random() < 2.0 / 3.0 else "examiner"
    return Design(kind, FAMILIES[i % len(FAMILIES)], maker, names, d, i % FULL_EVERY == FULL_EVERY - 1)


def make_case(design: Design, seed: int, index: int) -> tuple[MadeRecording, Key]:
    """Return the recording of a case and its key; they depend only on the design, seed and index."""
    rng = np.random.default_rng([seed, 1, index])
    rate = float(rng.choice([25.0, 50.0]))
    duration = 3600.0 if design.full_length else log_uniform(rng, 900.0, 1800.0)
    if not design.full_length and duration > 1200.0:
        rate = 25.0
    make = _by_simulator if design.maker == "simulator" else _by_examiner
    while True:
        recording, key = make(design, rate, duration, rng)
        if _plausible(key):
            return recording, key
        design = replace(design, d_prime=0.7 * design.d_prime)


def _plausible(key: Key) -> bool:
    """Return whether a real phone might have what was added."""
    assert key.exam is not None, "the examiner's own keys tell of the bins"
    scale = np.abs([e.parameters["slope"] for e in key.effects if "scale" in e.effect]).max(initial=0.0)
    sizes = {name: float(np.abs(getattr(key.exam, name)).max()) for name in LARGEST}
    return all(sizes[name] <= LARGEST[name] for name in LARGEST) and bool(scale <= 5e-3)


def _by_simulator(
    design: Design, rate: float, duration: float, rng: np.random.Generator
) -> tuple[MadeRecording, Key]:
    phone = phones.drawn_phone(design.family, rate, STANDARD, rng)
    phone = replace(phone, thermometer=_thermometer(design, rng))
    day, seed = simulated.drawn_day(duration, rng), int(rng.integers(2**31))
    creep = design.names == ("creep",)
    world = simulated.world_of(simulated.simulated(phone, day, [], seed, creep))
    stage = Stage(world, binned(world), phone, rng)
    effects = [] if creep else [drawn_effect(stage, name, design.d_prime) for name in design.names]
    recording = simulated.recorded(simulated.simulated(phone, day, effects, seed, creep), phone)
    added = Additions.none(world)
    for effect in effects:
        put_in(stage, effect, added)
    return recording, _key(design, stage, added, effects)


def _by_examiner(
    design: Design, rate: float, duration: float, rng: np.random.Generator
) -> tuple[MadeRecording, Key]:
    world, phone = _scene(design, rate, duration, rng)
    stage, added = Stage(world, binned(world), phone, rng), Additions.none(world)
    if design.kind == "off_catalogue":
        return _with_off_catalogue(design, stage, added)
    effects = [] if design.kind == "decoy" else [drawn_effect(stage, n, design.d_prime) for n in design.names]
    for effect in effects:
        put_in(stage, effect, added)
    return phones.recorded(world, stage.phone, added, rng), _key(design, stage, added, effects)


def _scene(design: Design, rate: float, duration: float, rng: np.random.Generator) -> tuple[World, Phone]:
    """Draw motion and a phone that suit a design."""
    name = design.names[0] if design.names else ""
    calm = name in ("breathing", "creep", "heartbeat") or (
        rng.random() < 0.3 and design.kind != "off_catalogue" and not set(design.names) & set(WITH_TURNS)
    )
    gravity = round(float(rng.uniform(*LOCAL_GRAVITY)), 5)
    day = Day(
        duration,
        rate,
        rest_s=(90.0, 400.0) if calm else (20.0, 80.0),
        attitudes=int(rng.integers(1, 4)) if calm else int(rng.integers(8, 20)),
        stirred=name if name in ("breathing", "heartbeat", "creep", "vehicle") else None,
        vivid=name.endswith("_saturation"),
        pivot=name == "lever_arm",
        wandering_k=4.0 if name == "thermometer" else 0.0,
        gravity=gravity,
    )
    phone = phones.drawn_phone(design.family, rate, gravity, rng)
    phone = replace(phone, thermometer=_thermometer(design, rng))
    if name == "location":
        phone = replace(phone, claims=phones.without_gravity(phone.claims))
    if name == "quantisation":
        phone = phones.coarse(phone, rng)
    return play(day, rng), phone


def _thermometer(design: Design, rng: np.random.Generator) -> bool:
    if "thermal_latent" in design.names:
        return False
    needed = any("temperature" in n for n in design.names) or design.names == ("thermometer",)
    return needed or bool(rng.random() < 0.6)


def _with_off_catalogue(design: Design, stage: Stage, added: Additions) -> tuple[MadeRecording, Key]:
    """Make a recording with an effect outside the catalogue."""
    effect, world, rng = OFF_CATALOGUE[design.names[0]], stage.world, stage.rng
    begin, end, reached = 0.0, world.duration, None
    if effect.course is not None:
        course = effect.course(world, rng)[:, None] * stage.direction()
        unit = power.d_prime(stage.weight(effect.sensor), over_bins(world, stage.bins, course))
        getattr(added, effect.sensor)[:] += course * (design.d_prime / unit)
        reached = design.d_prime
    recording = phones.recorded(world, stage.phone, added, rng)
    corrupt = effect.corrupt
    if corrupt is not None:
        span = drawn_span(world, rng)
        begin, end = span.t_start, span.t_end
        recording = phones.with_corrupted(recording, effect.sensor, lambda values: corrupt(values, span, rng))
    truth = TrueEffect(design.names[0], effect.sensor, ["x", "y", "z"], {}, reached, begin, end)
    return recording, _key(design, stage, added, [truth], list(effect.entailed))


def _key(
    design: Design,
    stage: Stage,
    added: Additions,
    effects: list[TrueEffect],
    entailed: list[str] | None = None,
) -> Key:
    variant = design.names[0] if design.kind in ("decoy", "off_catalogue") else None
    return Key(
        design.kind,
        design.family,
        design.maker,
        design.full_length,
        variant,
        [as_recorded(stage.phone, effect) for effect in effects],
        entailed or [],
        exam_of(stage, added),
    )


def exam_of(stage: Stage, added: Additions) -> Exam:
    """Return the bins and additions that a key stores, by which an answer's model is scored."""
    bins = stage.bins
    return Exam(
        bins.width,
        _short(bins.t),
        _short(bins.rest),
        _short(bins.since),
        _short(bins.force),
        _short(bins.temperature),
        _short(bins.charging),
        _short(bins.drive),
        _short(over_bins(stage.world, bins, added.accel)),
        _short(over_bins(stage.world, bins, added.gyro)),
        asdict(stage.phone.accel.colour),
        asdict(stage.phone.gyro.colour),
    )


def _short(values: Array) -> Any:
    """Return values as nested lists to ten digits, so that keys stay small."""
    return np.array([float(f"{v:.9e}") for v in values.ravel()]).reshape(values.shape).tolist()
