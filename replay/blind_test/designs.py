"""The plan of a blind test: how many cases of which kind, with which effect, by which maker, how large."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np

from stillcal.replay.blind_test import simulator_cases as simulated
from stillcal.replay.blind_test.hidden.kind import HiddenKind
from stillcal.replay.blind_test.hidden.near_shapes import NEAR_SHAPES
from stillcal.replay.blind_test.hidden.off_catalogue import OFF_CATALOGUE
from stillcal.replay.blind_test.hidden.off_catalogue_reserve import RESERVE
from stillcal.replay.blind_test.power.sizing import NAMES
from stillcal.replay.blind_test.simulations.scaled import EFFECTS
from stillcal.replay.blind_test.simulations.scaled import SHARES as SIMULATION_SHARES
from stillcal.replay.blind_test.world.grounds import GROUNDS
from stillcal.replay.blind_test.world.noise import FAMILIES

SHARES = {
    "null": 0.30,
    "decoy": 0.10,
    "single": 0.36,
    "pair": 0.06,
    "near_shape": 0.06,
    "off_catalogue": 0.12,
}
"""Share of each kind among the trials."""

BESIDE = {"reserve": 0.12, "simulated": 0.3, "phone_file": 0.04}
"""Cases beside the trials, per trial, each only where it is asked for."""

HIDDEN: dict[str, HiddenKind] = {**OFF_CATALOGUE, **RESERVE, **NEAR_SHAPES}
"""All hidden kinds by name."""

DECOYS = ("thermometer", "heartbeat", "quantisation", "location")
LADDER = (2.0, 4.0, 6.0, 8.0, 12.0, 20.0)
"""Values of d' for single effects, from invisible to obvious."""

CLEAR = (10.0, 16.0, 25.0)
"""Values of d' for pairs and for effects outside the catalogue: of what names leave of these."""

GIVEN = (40.0, 60.0, 80.0)
"""Values of d' where a simulation is given, which is to be told apart from half of it."""

WRITTEN_BACK = (
    "accel_bias_temperature", "gyro_bias_temperature", "gyro_g_sensitivity", "accel_nonlinearity",
    "accel_charging_bias", "noise_level", "accel_gyro_time_offset", "clock_skew",
)  # fmt: skip
"""Effects that a phone file lacks before it is written back."""

FULL_EVERY = 50
"""One case in this many is one hour long; the others are shorter."""

FIRM = 0.5
"""Share of the nulls that lie on something firm; the others lie on everything else in turn."""

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


@dataclass(frozen=True, slots=True)
class Design:
    """The design of a case. names: of the effects, or of the variant; d_prime: of each effect.

    ground: what the phone lies on. share: of the effect that a given simulation has; reverse: whether only it
    has the effect.
    """

    kind: str
    family: str
    maker: str
    names: tuple[str, ...]
    d_prime: float
    full_length: bool
    ground: str = "firm"
    share: float | None = None
    reverse: bool = False


VARIANTS: dict[str, list[tuple[str, ...]]] = {
    "null": [()],
    "decoy": [(d,) for d in DECOYS],
    "single": [(n,) for n in NAMES],
    "pair": [*PAIRS],
    "near_shape": [(n,) for n in NEAR_SHAPES],
    "off_catalogue": [(n,) for n in OFF_CATALOGUE],
    "reserve": [(n,) for n in RESERVE],
    "simulated": [(n,) for n in EFFECTS],
    "phone_file": [(n,) for n in WRITTEN_BACK],
}
"""What there is to hide, by kind of case."""


def planned(trials: int, seed: int, beside: Collection[str] = (), *, recordings: bool = True) -> list[Design]:
    """Return the designs of all trials in random order, those of kinds `beside` them in addition.

    recordings: whether the trials themselves are planned, or only what is beside them.
    """
    designs = _trials(trials, seed) if recordings else []
    for kind in beside:
        rng = np.random.default_rng([seed, 2, list(BESIDE).index(kind)])
        designs += _of_kind(kind, max(round(trials * BESIDE[kind]), 1), rng)
    return [designs[i] for i in np.random.default_rng([seed, 3]).permutation(len(designs))]


def _trials(trials: int, seed: int) -> list[Design]:
    rng = np.random.default_rng([seed, 0])
    counts = {kind: max(round(trials * share), 1) for kind, share in SHARES.items()}
    counts["null"] = max(trials - sum(n for k, n in counts.items() if k != "null"), 1)
    designs = [d for kind, count in counts.items() for d in _of_kind(kind, count, rng)]
    return [designs[i] for i in rng.permutation(len(designs))][:trials]


def _of_kind(kind: str, count: int, rng: np.random.Generator) -> list[Design]:
    variants = VARIANTS[kind]
    names = cycle([variants[i] for i in rng.permutation(len(variants))])
    grounds = cycle(rng.permutation([g for g in GROUNDS if g != "firm"]).tolist())
    share = _simulators_share(kind)
    ladder = LADDER if kind == "single" else GIVEN if kind in ("simulated", "phone_file") else CLEAR
    relations = cycle([*((s, False) for s in SIMULATION_SHARES), (1.0, True)])
    designs = []
    for i in range(count):
        chosen = next(names)
        ground = next(grounds) if kind == "null" and rng.random() >= FIRM else "firm"
        can = _simulator_can(chosen, ground)
        maker = "simulator" if can and rng.random() < share else "examiner"
        full = i % FULL_EVERY == FULL_EVERY - 1
        design = Design(
            kind, FAMILIES[i % len(FAMILIES)], maker, chosen, float(rng.choice(ladder)), full, ground
        )
        if kind == "simulated":
            # The numbers of effects and of relations have no common divisor: in time each meets each.
            how_much, reverse = next(relations)
            design = replace(design, share=how_much, reverse=reverse, full_length=False)
        designs.append(design)
    return designs


def _simulator_can(names: Sequence[str], ground: str) -> bool:
    """Return whether the simulated phone can play a case."""
    return ground in simulated.GROUNDS and all(
        n in simulated.CAN or n in (*simulated.DECOYS, *EFFECTS) or (n in HIDDEN and not HIDDEN[n].vivid)
        for n in names
    )


def _simulators_share(kind: str) -> float:
    """Return the share of the cases that the simulated phone can play which go to it, to make half of all."""
    grounds = [g for g in GROUNDS if g != "firm"] if kind == "null" else []
    able = [_simulator_can(v, "firm") for v in VARIANTS[kind]]
    possible = sum(able) / len(able)
    if grounds:
        moving = sum(_simulator_can((), g) for g in grounds) / len(grounds)
        possible = FIRM * possible + (1.0 - FIRM) * moving
    return min(0.5 / possible, 1.0)
