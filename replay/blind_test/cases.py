"""Making the cases of a blind test: hidden effect, phone, motion, and the recording with its key."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.blind_test import simulator_cases as simulated
from stillcal.replay.blind_test.case import Case
from stillcal.replay.blind_test.designs import HIDDEN, WITH_TURNS, Design
from stillcal.replay.blind_test.hidden.kind import HiddenKind
from stillcal.replay.blind_test.keys import Exam, Key, TrueEffect
from stillcal.replay.blind_test.power import detectability as power
from stillcal.replay.blind_test.power.misfit import left_by_names
from stillcal.replay.blind_test.power.sizing import Stage, as_recorded, drawn_effect, put_in
from stillcal.replay.blind_test.simulations.cases import make_simulated, make_written_back
from stillcal.replay.blind_test.world import phones
from stillcal.replay.blind_test.world.day import World, binned, over_bins
from stillcal.replay.blind_test.world.days import Day, play
from stillcal.replay.blind_test.world.noise import log_uniform
from stillcal.replay.blind_test.world.phones import Additions, MadeRecording, Phone

LENGTHS_S = (900.0, 1800.0)
"""Shortest and longest recording, s; one in fifty is longer."""

LARGEST = {"accel": 0.6, "gyro": 0.1}
"""Largest value that effects may add at rest, m/s^2 and rad/s: only a broken phone has more."""

LOCAL_GRAVITY = (9.764, 9.834)
"""Span of gravity over the Earth's surface, m/s^2 (Hirt et al. 2013, GGMplus: 9.7639 to 9.8337)."""


def make_case(design: Design, seed: int, index: int) -> Case:
    """Return a case; it depends only on the design, seed and index."""
    rng = np.random.default_rng([seed, 1, index])
    if design.kind == "simulated":
        return make_simulated(design, rng)
    if design.kind == "phone_file":
        return make_written_back(design, rng)
    rate = float(rng.choice([25.0, 50.0]))
    duration = 3600.0 if design.full_length else log_uniform(rng, *LENGTHS_S)
    if not design.full_length and duration > 1200.0:
        rate = 25.0
    make = _by_simulator if design.maker == "simulator" else _by_examiner
    while True:
        case = make(design, rate, duration, rng)
        if _plausible(case.key):
            return case
        design = replace(design, d_prime=0.7 * design.d_prime)


def _plausible(key: Key) -> bool:
    """Return whether a real phone might have what was added."""
    assert key.exam is not None, "the examiner's own keys tell of the bins"
    slopes = [e.parameters["slope"] for e in key.effects if "scale" in e.effect and "slope" in e.parameters]
    scale = np.abs(slopes).max(initial=0.0)
    sizes = {name: float(np.abs(getattr(key.exam, name)).max()) for name in LARGEST}
    return all(sizes[name] <= LARGEST[name] for name in LARGEST) and bool(scale <= 5e-3)


def _by_simulator(design: Design, rate: float, duration: float, rng: np.random.Generator) -> Case:
    hidden = HIDDEN.get(design.names[0]) if design.names else None
    phone = _phone(design, rate, STANDARD, rng)
    day = simulated.drawn_day(duration, rng, design.ground, wandering=design.names == ("thermometer",))
    seed, creep = int(rng.integers(2**31)), simulated.creep_of(design.ground, rng)
    world = simulated.world_of(simulated.simulated(phone, day, creep, seed), rate)
    stage, added = Stage(world, binned(world), phone, rng), Additions.none(world)
    if hidden is not None:
        misfit = _add_hidden(hidden, stage, added, design.d_prime)
        plain = simulated.simulated(phone, day, creep, seed, rounded=False)
        return _altered(design, stage, added, simulated.recorded(plain, phone, added), misfit)
    effects = [] if design.kind == "decoy" else [drawn_effect(stage, n, design.d_prime) for n in design.names]
    entries = [*creep, *(simulated.entry_of(phone, e) for e in effects)]
    recording = simulated.recorded(simulated.simulated(phone, day, entries, seed), phone)
    for effect in effects:
        put_in(stage, effect, added)
    return Case(recording, _key(design, stage, added, effects))


def _by_examiner(design: Design, rate: float, duration: float, rng: np.random.Generator) -> Case:
    hidden = HIDDEN.get(design.names[0]) if design.names else None
    world, phone = _scene(design, rate, duration, rng)
    stage, added = Stage(world, binned(world), phone, rng), Additions.none(world)
    if hidden is not None:
        misfit = _add_hidden(hidden, stage, added, design.d_prime)
        return _altered(design, stage, added, phones.recorded(world, phone, added, rng), misfit)
    effects = [] if design.kind == "decoy" else [drawn_effect(stage, n, design.d_prime) for n in design.names]
    for effect in effects:
        put_in(stage, effect, added)
    return Case(phones.recorded(world, stage.phone, added, rng), _key(design, stage, added, effects))


def _scene(design: Design, rate: float, duration: float, rng: np.random.Generator) -> tuple[World, Phone]:
    """Draw motion and a phone that suit a design."""
    name = design.names[0] if design.names else ""
    hidden = HIDDEN.get(name)
    turned = hidden is not None or bool(set(design.names) & set(WITH_TURNS))
    calm = design.ground != "firm" or name == "heartbeat" or (rng.random() < 0.3 and not turned)
    # The more attitudes, the less of an effect of attitude is taken for scale or for another such effect.
    attitudes = (1, 4) if calm else (8, 20) if hidden is None else (16, 28)
    gravity = round(float(rng.uniform(*LOCAL_GRAVITY)), 5)
    day = Day(
        duration,
        rate,
        rest_s=(90.0, 400.0) if calm else (20.0, 80.0),
        attitudes=int(rng.integers(*attitudes)),
        ground="heartbeat" if name == "heartbeat" else design.ground,
        vivid=name.endswith("_saturation") or (hidden is not None and hidden.vivid),
        pivot=name == "lever_arm",
        wandering_k=4.0 if name == "thermometer" else 0.0,
        gravity=gravity,
    )
    return play(day, rng), _phone(design, rate, gravity, rng)


def _phone(design: Design, rate: float, gravity: float, rng: np.random.Generator) -> Phone:
    """Draw a phone that suits a design."""
    phone = phones.drawn_phone(design.family, rate, gravity, rng)
    phone = replace(phone, thermometer=_thermometer(design, rng))
    if design.names == ("location",):
        phone = replace(phone, claims=phones.without_gravity(phone.claims))
    return phones.coarse(phone, rng) if design.names == ("quantisation",) else phone


def _thermometer(design: Design, rng: np.random.Generator) -> bool:
    if "thermal_latent" in design.names:
        return False
    hidden = [HIDDEN[n].thermometer for n in design.names if n in HIDDEN]
    needed = (
        any("temperature" in n for n in design.names) or design.names == ("thermometer",) or True in hidden
    )
    return bool(rng.random() < 0.6) or needed


def _add_hidden(hidden: HiddenKind, stage: Stage, added: Additions, d: float) -> float | None:
    """Add a hidden kind to the readings; return what names leave of it, as d', where it is sized by that."""
    if hidden.added is None:
        return None
    course = hidden.added(stage)
    if hidden.sized:
        delta = over_bins(stage.world, stage.bins, course)
        weight = stage.weight(hidden.sensor)
        left = left_by_names(stage.bins, hidden.sensor, weight, delta, hidden.nearest or None)
        course = course * (d / max(left, 1e-12))
    getattr(added, hidden.sensor)[:] += course
    return d if hidden.sized else None


def _altered(
    design: Design, stage: Stage, added: Additions, recording: MadeRecording, misfit: float | None
) -> Case:
    """Return the case of a hidden kind, its finished recording altered where the kind does that."""
    hidden = HIDDEN[design.names[0]]
    begin, end = 0.0, stage.world.duration
    if hidden.altered is not None:
        recording, begin, end = hidden.altered(recording, stage)
    reached = None
    if hidden.sized:
        delta = over_bins(stage.world, stage.bins, getattr(added, hidden.sensor))
        reached = power.d_prime(stage.weight(hidden.sensor), delta)
    truth = TrueEffect(design.names[0], hidden.sensor, ["x", "y", "z"], {}, reached, begin, end)
    key = _key(design, stage, added, [truth])
    return Case(
        recording, replace(key, entailed=[*hidden.entailed], nearest=[*hidden.nearest], misfit=misfit)
    )


def _key(design: Design, stage: Stage, added: Additions, effects: list[TrueEffect]) -> Key:
    variant = design.names[0] if design.kind not in ("null", "single", "pair") else None
    return Key(
        design.kind,
        design.family,
        design.maker,
        design.full_length,
        variant,
        [as_recorded(stage.phone, effect) for effect in effects],
        ground=design.ground,
        exam=exam_of(stage, added),
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
        _short(bins.north),
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
