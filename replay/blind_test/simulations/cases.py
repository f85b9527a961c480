"""Making cases of given simulations: a recording and a simulation of it, in other motion, rate and length."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.blind_test import simulator_cases as simulated
from stillcal.replay.blind_test.case import Case
from stillcal.replay.blind_test.designs import Design
from stillcal.replay.blind_test.keys import Key, TrueEffect
from stillcal.replay.blind_test.power import detectability as power
from stillcal.replay.blind_test.power.sizing import Stage, d_of_walks, put_in
from stillcal.replay.blind_test.simulations.scaled import (
    CONSTANTS,
    drawn,
    scaled,
    told_by_stamps,
    with_constant,
    without_own,
)
from stillcal.replay.blind_test.world import phones
from stillcal.replay.blind_test.world.day import binned, over_bins
from stillcal.replay.blind_test.world.days import Day, play
from stillcal.replay.blind_test.world.forward_model import FORWARD, played
from stillcal.replay.blind_test.world.phones import Additions, MadeRecording, Phone
from stillcal.replay.phone import phone as phone_files
from stillcal.replay.phone.scenario import Scenario

LENGTHS_S = (900.0, 1500.0)
RATES_HZ = (25.0, 50.0)
"""A recording has one of each, its simulation the other."""


@dataclass(frozen=True, slots=True)
class _Days:
    """Settings of both recordings: length in s and rate in Hz of each."""

    lengths: tuple[float, float]
    rates: tuple[float, float]


def make_simulated(design: Design, rng: np.random.Generator) -> Case:
    """Return a recording, a simulation with a share of its effect, and the relation that is true.

    The maker is that of the recording; the simulation is always the simulated phone's.
    """
    days, name = _drawn_days(rng), design.names[0]
    # A phone whose jitter is usual at the higher rate is usual at both.
    base = without_own(_phone(design, max(days.rates), rng), name)
    stages = _stages(design, base, days, rng)
    full = told_by_stamps(drawn(stages[0], name, design.d_prime), max(days.rates))
    assert design.share is not None, "the plan draws a share for every case of this kind"
    shares = (0.0, 1.0) if design.reverse else (1.0, design.share)
    recordings = [
        _played(stage, scaled(full, share), rng) for stage, share in zip(stages, shares, strict=True)
    ]
    sizes = [_d_prime(stage, full) for stage in stages]
    relation = "superfluous" if design.reverse else _relation(design.share)
    key = Key(
        design.kind,
        design.family,
        design.maker,
        variant=name,
        effects=[full],
        entailed=["sample_rate"],
        relation=relation,
        share=design.share,
        can_tell=_can_tell(sizes, shares),
    )
    return Case(recordings[0], key, simulation=recordings[1])


def _relation(share: float) -> str:
    return {0.0: "lacking", 0.5: "too_small", 1.0: "agreed"}.get(share, "too_large")


def _can_tell(sizes: list[float], shares: tuple[float, float]) -> bool:
    """Return whether an observer of both recordings can tell the relation, each part of it at d' = 8 or more.

    sizes: d' of the whole effect in either. What one of the two has must be seen in it, and unless they agree
    the difference must be.
    """
    seen = all(share * d >= 8.0 for share, d in zip(shares, sizes, strict=True) if share > 0.0)
    apart = abs(shares[0] - shares[1]) / math.sqrt(sum(d**-2.0 for d in sizes))
    return seen and (apart >= 8.0 or shares[0] == shares[1])


def _d_prime(stage: Stage, effect: TrueEffect) -> float:
    """Return d' of an effect in a day; where rests do not tell it, that which it was drawn for, or enough.

    Of a random walk it is that of one stronger by a factor of e: how strong it is, a day tells roughly.
    """
    if effect.effect.endswith("_random_walk"):
        return d_of_walks(stage, effect.sensor, float(effect.parameters["density"][0]))
    if effect.effect not in FORWARD:
        return effect.d_prime or 1e3
    delta = over_bins(stage.world, stage.bins, played(stage.world, effect.effect, effect.parameters))
    return max(power.d_prime(stage.weight(effect.sensor), delta), 1e-3)


def _drawn_days(rng: np.random.Generator) -> _Days:
    lengths, rates = rng.permutation(LENGTHS_S), rng.permutation(RATES_HZ)
    return _Days((float(lengths[0]), float(lengths[1])), (float(rates[0]), float(rates[1])))


def _phone(design: Design, rate: float, rng: np.random.Generator) -> Phone:
    phone = phones.drawn_phone(design.family, rate, STANDARD, rng)
    return replace(phone, thermometer=True)


def _stages(design: Design, base: Phone, days: _Days, rng: np.random.Generator) -> tuple[Stage, Stage]:
    """Return both days with the phone that lives through them: the same but for its rate."""
    stages: list[Stage] = []
    for maker, length, rate in zip((design.maker, "simulator"), days.lengths, days.rates, strict=True):
        phone = _at_rate(base, rate)
        if maker == "simulator":
            day, seed = simulated.drawn_day(length, rng), int(rng.integers(2**31))
            world = simulated.world_of(simulated.simulated(phone, day, [], seed), rate)
            stages.append(_SimulatedStage(world, binned(world), phone, rng, {}, day, seed))
        else:
            gravity = float(rng.uniform(9.764, 9.834))
            phone = replace(phone, claims=msgspec.structs.replace(phone.claims, gravity=round(gravity, 5)))
            world = play(Day(length, rate, attitudes=int(rng.integers(12, 20)), gravity=gravity), rng)
            stages.append(Stage(world, binned(world), phone, rng))
    return stages[0], stages[1]


@dataclass(eq=False)
class _SimulatedStage(Stage):
    """A day of the simulated phone, with its scenario and seed."""

    day: Scenario | None = None
    seed: int = 0


def _at_rate(phone: Phone, rate: float) -> Phone:
    claims = msgspec.structs.replace(phone.claims, nominal_rate_hz=rate)
    return replace(phone, clock=replace(phone.clock, rate_hz=rate), claims=claims)


def _played(stage: Stage, effect: TrueEffect, rng: np.random.Generator) -> MadeRecording:
    """Return the recording of a day with an effect."""
    phone = with_constant(stage.phone, effect) if effect.effect in CONSTANTS else stage.phone
    constant = effect.effect in CONSTANTS
    if isinstance(stage, _SimulatedStage):
        assert stage.day is not None, "a simulated stage is made with its day"
        entries = [] if constant or _is_nothing(effect) else [simulated.entry_of(phone, effect)]
        return simulated.recorded(simulated.simulated(phone, stage.day, entries, stage.seed), phone)
    there = Stage(stage.world, stage.bins, phone, rng)
    added = Additions.none(stage.world)
    if not constant and not _is_nothing(effect):
        put_in(there, effect, added)
    return phones.recorded(stage.world, there.phone, added, rng)


def _is_nothing(effect: TrueEffect) -> bool:
    """Return whether an effect has no size left."""
    return scaled(effect, 0.0).parameters == effect.parameters


def make_written_back(design: Design, rng: np.random.Generator) -> Case:
    """Return a day of a phone, its phone file that lacks one effect, and a fresh day of the phone."""
    days, name = _drawn_days(rng), design.names[0]
    phone = _phone(design, days.rates[0], rng)
    stage = _stages(replace(design, maker="simulator"), phone, days, rng)[0]
    effect = drawn(stage, name, design.d_prime)
    lacking = phone_files.dump_phone(
        msgspec.convert(simulated.phone_table(phone, []), type=phone_files.Phone)
    )
    first = _played(stage, effect, rng)
    fresh_day, seed = simulated.drawn_day(days.lengths[1], rng), int(rng.integers(2**31))
    fresh = simulated.simulated(phone, fresh_day, [simulated.entry_of(phone, effect)], seed)
    key = Key(design.kind, design.family, "simulator", variant=name, effects=[effect])
    return Case(first, key, phone=lacking, fresh=simulated.recorded(fresh, phone))
