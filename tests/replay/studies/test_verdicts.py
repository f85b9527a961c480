"""Every rule of a verdict from both sides: made-up scores that it accepts, and the nearest that it does not.

A row is a study's own function from scores to a claim; `_at` picks one where the function makes several.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.claim import Claim, Verdict
from stillcal.replay.studies.collin2019 import (
    grades,
    inertial_navigation,
    mode_sequences,
    pedestrian_tables,
)
from stillcal.replay.studies.collin2019.motion_features import Motion
from stillcal.replay.studies.esgi95 import best_attitudes, laboratory, nonorthogonality, repeats
from stillcal.replay.studies.esgi95.published import Row
from stillcal.replay.studies.grammenos2018 import (
    classes,
    gravity,
    gyroscope_bias,
    homogeneity,
    minimisation,
    people,
    power,
    quality_check,
    stationary_states,
)
from stillcal.replay.studies.grammenos2018.first_fits import FirstFits
from stillcal.replay.studies.grammenos2018.slices import WAYS, Accuracy

RNG = np.random.default_rng(0)


class Rule(NamedTuple):
    """A rule and what stands on either side of its line: arguments that hold, and lists that do not."""

    name: str
    claim: Callable[..., Claim]
    holds: tuple[Any, ...]
    fails: list[tuple[Any, ...]]


def _at(number: int, claims: Callable[..., Any], *given: Any) -> Claim:
    return tuple(claims(*given))[number]


def life(attitudes: int = 20, calibrated_at: float = 3600.0) -> people.Life:
    """Return a day with so many attitudes."""
    return people.Life(200, attitudes, 3600.0, calibrated_at, 7, np.nan)


def days(attitudes: tuple[int, int]) -> tuple[list[people.Life], dict[float, Array]]:
    """Return ten days between two numbers of attitudes, and probes of them."""
    return [life(n) for n in np.linspace(*attitudes, 10).round().astype(int)], {60.0: np.array([[12, 5]])}


def fewest(eleven: int, thirteen: int, nine: int = 0) -> dict[str, Array]:
    """Return with how many attitudes ten phones are calibrated: so many of them with 9, 11 and 13."""
    own = np.array([9.0] * nine + [11.0] * (eleven - nine) + [13.0] * (thirteen - eleven))
    every = np.concatenate((own, np.full(10 - own.size, 30.0)))
    return {"everyday": every, "unchecked": every, "random": every}


def first_day(eleven: int, thirteen: int) -> Claim:
    return people._day(fewest(eleven, thirteen), (0.5, 0.5), [5], np.ones((3, 2)))


def overhead(engine: float) -> Claim:
    """Return the claim for an engine that takes so many s a day, the correction nothing."""
    return power._overhead(power.Day(engine, 0.05, 200, 1000), power.Times(0.0, 0.0, 0.0, 0.0))


def costs(fitted: float, judged: float) -> gravity.Costs:
    """Return what the default g leaves over what the local one does, of three phones."""
    return gravity.Costs(np.ones((3, 1)) * (fitted, 1.0), np.ones((3, 1)) * (judged, 1.0), np.ones((3, 2)))


def lived(first: float, checked: float) -> dict[str, quality_check.Days]:
    """Return days whose rates are off by so much, by the first calibration and by that kept up."""
    t, none = np.arange(48.0) * 3600.0, np.empty(0)
    own = quality_check.Days(
        t, np.ones((48, 1)) * (9.0, first, checked), np.ones((48, 3)), 1, none, none, none
    )
    return dict.fromkeys((quality_check.DRIFTING, *quality_check.PHONES), own)


def mended(hours: int) -> Claim:
    """Return the claim where the norm is halved after so many hours, ten rests' median, a rest an hour."""
    t, none = np.arange(200.0) * 3600.0, np.empty(0)
    norm = np.tile([0.3, 0.1, 0.1], (200, 1))
    norm[t >= quality_check.STEP_AT + 3600.0 * hours - 5 * 3600.0, 2] = 0.01
    own = quality_check.Days(t, norm, norm, 1, none, none, none)
    return quality_check._found(own, own)


def turns(without: float, mean: float, own: float) -> tuple[Array, list[gyroscope_bias.Result]]:
    """Return held-out angles of three recordings: by Eq. 10, one bias and each turn's own."""
    angles = (1.0, without, mean, own)
    results = [gyroscope_bias.Result("r", 9, 0.02, 0.01, angles, (1.0, 0.1))] * 3
    return np.array([angles] * 3), results


def real_gyroscopes(deg_h: float) -> Claim:
    by_axis = float(np.radians(deg_h / 3600.0))
    return gyroscope_bias._grade([gyroscope_bias.Result("r", 9, 0.02, by_axis, (1.0,) * 4, (1.0, 0.1))] * 3)


def minimised(rank: tuple[int, int] = (9, 9), damped: float = 1.0) -> minimisation.Found:
    """Return a minimisation with this rank of 9 and of 12 parameters, and this order when damped."""
    three = np.ones((3, 3))
    counts = {delta: np.full(3, 9) for delta in minimisation.DAMPINGS}
    return minimisation.Found(
        rank=np.array([rank] * 3),
        turning=0.0,
        norm=three,
        tilt=three,
        order=np.full(3, 2.0),
        damped=np.full(3, damped),
        ratio=np.full(3, 0.25),
        gauss_newton=np.full(3, 0.01),
        ours=np.full(3, 4),
        iterations=counts,
        runs={},
    )


def printed(*agrees: bool) -> list[Row]:
    return [Row(f"dataset 1, positions 1-20: s{k}", "1", 1.0, 0.0, own) for k, own in enumerate(agrees)]


def choices(worst: str) -> tuple[dict[str, Array], Array]:
    """Return six choices of positions, one of which lies all but in a plane."""
    spread = best_attitudes.icosahedron()
    flat = spread * (1.0, 1.0, 0.2)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    names = [f"dataset {n}, positions {own}" for n in (1, 2, 3) for own in ("1-20", "3-23")]
    return {n: flat if n == worst else spread for n in names}, best_attitudes.information(spread)


def windows(alone: tuple[float, ...], then: tuple[float, ...], *, sure: bool) -> mode_sequences.Errors:
    """Return the errors of people with a hundred windows, so many wrong each alone and in sequence.

    sure: whether the windows judged wrongly are judged with as much confidence as the others.
    """

    def posterior(shares: tuple[float, ...]) -> Array:
        wrong = np.concatenate([np.arange(100) < round(100 * share) for share in shares])
        return np.where(wrong[:, None], [0.01, 0.99] if sure else [0.4, 0.6], [0.99, 0.01])

    size = 100 * len(alone)
    person, true = np.repeat(np.arange(len(alone)), 100), np.zeros(size, dtype=int)
    motion = Motion(np.zeros((size, 1)), true, person, np.zeros(size))
    judged = mode_sequences.Judged(motion, np.arange(2), posterior(alone), posterior(then))
    return mode_sequences.errors(judged)


def curves(consumer: float, tactical: float) -> dict[str, tuple[Array, Array, Array, Array]]:
    """Return position errors after a minute, m."""
    t, at = np.array([0.0, 120.0]), {"navigation": 1.0, "tactical": tactical, "consumer": consumer}
    return {grade: (t, *(np.full(2, error),) * 3) for grade, error in at.items()}


def gains(stairs: float, walking: float) -> dict[tuple[tuple[str, str], str], Accuracy]:
    """Return what the method gains, points, on the two stairs and on walking against them."""
    scatter = 0.002 * np.array([-1.0, 1.0] * 5)

    def own(gain: float) -> Accuracy:
        values = np.full((10, len(WAYS)), 0.8)
        values[:, WAYS.index(classes.METHOD)] += 0.01 * gain + scatter
        return Accuracy(values, np.zeros(len(WAYS)))

    level = {pair: stairs if pair == classes.PAIRS[2] else walking for pair in classes.PAIRS}
    return {(pair, name): own(level[pair]) for pair in classes.PAIRS for name in classes.LEARNERS}


def detected(right: float) -> tuple[dict[str, stationary_states.Found], dict[str, list[bool]]]:
    own = stationary_states.Found(90.0, 16.0, right, 0.0, 0.0, 0.2, 0.01)
    names = [f"Algorithm 1, start {name}" for name in stationary_states.STARTS]
    return dict.fromkeys((*names, "detector, probing"), own), {n: [True] for n in stationary_states.STARTS}


def sitting(after: float) -> homogeneity.Homogeneity:
    return homogeneity.Homogeneity(*(np.ones((6, 1)) * (1.0, 1.0, 1.0, after),) * 4)


REST = homogeneity.Rest(np.ones((6, 3)), 0.1 * np.ones((6, 3)), np.ones((6, 2)), 1)


TABLE_4, TABLE_3 = (1.8, 3.141), (330.0, 497.0, 432.0)
"""The consumer's figures, and times in s."""

SPREAD = nonorthogonality.FIG3_ANGLES[None]
HALF = np.abs(repeats.PRINTED_X)
RULES = [
    Rule("a day's first calibration", first_day, (6, 6), [(5, 6), (5, 5)]),
    Rule("a day's states", lambda at: people._states(*days(at)), ((11, 13),), [((12, 20),), ((5, 12),)]),
    Rule("fewer than ten positions", lambda n: people._enough(fewest(n, n, n)), (6,), [(5,)]),
    Rule(
        "operations",
        lambda n: power._operations({"apply": {"additions": 9, "multiplications": n}}),
        (9,),
        [(10,), (8,)],
    ),
    Rule("overhead", overhead, (0.04 * 86400 * power.IMU_MA / power.CORE_MA,), [(0.06 * 86400 / 250.0,)]),
    Rule("a fit's time", power._fit, (9.9,), [(10.0,)]),
    Rule("g fitted", lambda r: gravity._fitted(costs(r, 1.0)), (2.1,), [(1.9,)]),
    Rule(
        "g judged", lambda r: gravity._judged(costs(1.0, r), np.empty((0, 2))), (67.0,), [(30.0,), (110.0,)]
    ),
    Rule("zeroing", lambda *r: _at(0, quality_check._zero, lived(*r)), (2.0, 1.0), [(2.0, 1.1)]),
    Rule("degradation", mended, (20,), [(30,)]),
    Rule("Eq. 10", lambda *a: gyroscope_bias._bias(*turns(*a)), (1.09, 1.0, 1.0), [(1.2, 1.0, 1.0)]),
    Rule(
        "methods with a bias",
        lambda *a: gyroscope_bias._methods(*turns(*a)),
        (1.0, 0.95, 0.95),
        [(1.0, 0.8, 1.0), (1.0, 1.0, 0.8)],
    ),
    Rule("a gyroscope's grade", real_gyroscopes, (3000.0,), [(3300.0,), (300.0,)]),
    Rule("a grade", lambda v: grades._consumer("x", 1.0, np.full(5, v)), (3.0,), [(3.3,), (0.3,)]),
    Rule(
        "twelve parameters",
        lambda *r: minimisation._twelve(minimised(r), "d"),  # type: ignore[arg-type]
        (9, 12),
        [(9, 9), (8, 12)],
    ),
    Rule(
        "quadratic", lambda o: _at(0, minimisation._convergence, minimised(damped=o), "d"), (1.6,), [(1.4,)]
    ),
    Rule("figures", lambda *a: laboratory._claim("d: parameters", printed(*a)), (True,) * 3, [(True, False)]),
    Rule(
        "offsets",
        lambda gt: laboratory.offsets(np.array([0.4, 0.4, -1.2]), np.array(gt)),
        ((-0.3, 0.1, 0.1),),
        [((0.5, 0.1, 0.1),), ((0.3, 0.1, -1.3),)],
    ),
    Rule(
        "the worst positions",
        lambda worst: best_attitudes._paper_claim(*choices(worst)),
        ("dataset 3, positions 3-23",),
        [("dataset 3, positions 1-20",)],
    ),
    Rule("like positions", best_attitudes._upright_claim, (0.98, 0.5), [(0.98, 0.48)]),
    Rule("2 % off", lambda *g: _at(0, nonorthogonality._worth_claims, [], list(g)), (2.0, 3.0), [(1.9, 3.0)]),
    Rule(
        "angles estimated",
        lambda off: nonorthogonality._angles_claim(SPREAD + np.array([0.0, 0.0, off])),
        (0.009,),
        [(0.011,), (-0.011,)],
    ),
    Rule(
        "standard deviations",
        lambda x, y: repeats._small_claim(repeats.Scatter(x * HALF, y * np.abs(repeats.PRINTED_Y))),
        (0.4, 0.4),
        [(0.6, 0.4), (0.4, 0.6)],
    ),
    Rule(
        "sequences",
        lambda *w: mode_sequences._sequence(windows(*w, sure=True)),
        ((0.5, 0.4), (0.2, 0.2)),
        [((0.5, 0.4), (0.5, 0.4)), ((0.5, 0.4), (0.2, 0.7))],
    ),
    Rule(
        "windows not judged",
        lambda sure: mode_sequences._partial(windows((0.5, 0.4), (0.5, 0.4), sure=sure)),
        (False,),
        [(True,)],
    ),
    Rule(
        "Table 4",
        lambda *e: _at(1, pedestrian_tables._table4_claims, 2, e),
        TABLE_4,
        [(1.8, 3.15), (1.8, 3.13)],
    ),
    Rule(
        "Table 3",
        lambda *t: _at(0, pedestrian_tables._table3_claims, 2, t),
        TABLE_3,
        [(334.0, 497.0, 432.0), (326.0, 497.0, 432.0)],
    ),
    Rule(
        "integration",
        lambda *e: inertial_navigation._grade_claim(curves(*e)),
        (110.0, 90.0),
        [(90.0, 20.0), (200.0, 110.0), (110.0, 0.5)],
    ),
    Rule(
        "steps",
        lambda error, steps: inertial_navigation._steps_claim(curves(error, 1.0)["consumer"], steps),
        (50.0, 40.0),
        [(50.0, 60.0)],
    ),
    Rule(
        "stairs",
        lambda *g: classes._stairs(gains(*g), "d"),
        (3.0, 1.0),
        [(1.0, 1.0), (1.0, 3.0)],
    ),
    Rule("states", lambda r: _at(0, stationary_states._claims, *detected(r)), (0.96,), [(0.94,)]),
    Rule(
        "real rests",
        lambda p: stationary_states._real((np.full(5, p), np.ones(5))),
        (0.91,),
        [(0.89,)],
    ),
    Rule("sitting", lambda a: homogeneity._rest(REST, sitting(a), "d", RNG), (1.05,), [(0.85,), (1.15,)]),
]


@pytest.mark.parametrize("rule", RULES, ids=[rule.name for rule in RULES])
def test_a_verdict_turns_at_its_line(rule: Rule) -> None:
    assert rule.claim(*rule.holds).verdict is Verdict.REPRODUCED
    assert [rule.claim(*given).verdict for given in rule.fails] == [Verdict.DIFFERS] * len(rule.fails)


def test_what_follows_a_setting_or_a_printed_figure_is_left_open() -> None:
    """Processor time is not power; a share of time follows pauses; figures are not tested by themselves."""
    day = power.Day(1.0, 0.05, 200, 1000)
    done = {name: {"additions": 9} for name in ("apply", "Kalman", "gain fixed")}
    hand = repeats.Scatter(repeats.PRINTED_SD_X, repeats.PRINTED_SD_Y)
    claims = [
        *power._kalman(done, power.Times(1.0, 20.0, 0.5, 1.0)),
        power._probing(day, day),
        stationary_states._claims(*detected(1.0))[2],
        repeats._simulated_claim(hand, 1e-3),
        repeats._real_claim({"phone": hand}),
        people._iterations([life()] * 3),
        people._own([FirstFits(11, 1.0, 0.97, 0)] * 2, 100),
        _at(1, minimisation._convergence, minimised(), "d"),
    ]
    assert {claim.verdict for claim in claims} == {Verdict.OPEN}
