"""The search reduces hypotheses in batches: what a batch takes, and that their size changes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.effects.catalogue import effects_in, named_effects
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature, ScaleTemperature
from stillcal.calib_core.diagnosis.effects.unknown import unknown_effects
from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.slow import search
from tests.calib_core.diagnosis.slow.test_findings import day_of
from tests.support.diagnosis import nulls

MOST_MB = 64.0
"""A sixth of what the self-diagnosis of the daemon may take in all (`diagnosis.memory_mib`)."""


def gyroscope() -> SensorResiduals:
    """Return a gyroscope's residuals with a thermometer, a charger, and the Earth's rate in all axes."""
    rng = np.random.default_rng(5)
    return by_sensor(nulls.bins_of(rng, nulls.schedule(rng), "flicker"), nulls.G)[1]


def test_a_batch_of_hypotheses_takes_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    reduce, taken = search.reduce_residuals, []

    def measured(*args: object, **how: object) -> list[Reduced]:
        made = reduce(*args, **how)  # type: ignore[arg-type]
        taken.append(sum(block.nbytes for view in made for block in view.blocks) / 1e6)
        return made

    monkeypatch.setattr(search, "reduce_residuals", measured)
    residuals = gyroscope()
    assert residuals.shared is not None
    search.compete(residuals, search.proposals(residuals, effects_in(residuals)))
    assert max(taken) < MOST_MB


def test_the_size_of_a_batch_changes_no_score(monkeypatch: pytest.MonkeyPatch) -> None:
    residuals = gyroscope()
    some = search.proposals(residuals, effects_in(residuals))[::4]
    found = []
    for together in (search.COLUMNS, 10_000):
        monkeypatch.setattr(search, "COLUMNS", together)
        found.append([(s.hypothesis.grid, s.score) for s in search.compete(residuals, some)])
    assert [grid for grid, _ in found[0]] == [grid for grid, _ in found[1]]
    np.testing.assert_allclose([s for _, s in found[0]], [s for _, s in found[1]], rtol=1e-9, atol=1e-9)


def test_a_form_that_is_found_first_is_chosen_again_beside_what_is_found_later() -> None:
    """A slope of the bias that was found as a parabola, beside the scale's, is a straight line."""
    rng, day = day_of(5)
    warm = day.temperature - day.temperature.mean()
    error = np.outer(warm, [0.02, -0.01, 0.015]) + nulls.G * day.up * np.outer(warm, [1e-3, 6e-4, -8e-4])
    residuals = by_sensor(nulls.bins_of(rng, day, "white", accel_error=error), nulls.G)[0]
    line, curve = (BiasTemperature("accel", degree) for degree in (1, 2))
    own = {h.effect: h for e in (line, curve, ScaleTemperature("accel")) for h in residuals.hypotheses(e)}
    bias = {s.hypothesis.effect: s for s in search.compete(residuals, [own[line], own[curve]])}
    (scale,) = search.compete(residuals, [h for e, h in own.items() if e not in bias], [own[curve]])
    steps = [search.Step(bias[curve], (bias[line],)), search.Step(scale, ())]
    assert search.forms_anew(residuals, steps)[0].winner.hypothesis.effect is line
    assert search.forms_anew(residuals, steps[:1]) == steps[:1], "alone it was chosen so"


def test_two_effects_that_hide_each_other_are_found_together() -> None:
    """A step is noise to a nonlinearity and the reverse: alone, each scores less than the threshold."""
    rng = np.random.default_rng(4)
    rest = np.repeat(np.arange(40), 25)
    rest[np.arange(1000) % 25 >= 20] = -1
    up = nulls.random_attitudes(rng, 40)[rest]
    t, same = np.arange(1000.0), np.zeros(1000)
    error = 4e-4 * (nulls.G * up) ** 2 * [1.0, -1.0, 0.0] + np.outer(t >= 433.0, [0.05, 0.0, 0.04])
    day = nulls.Day(t, rest, up, same + 25.0, same)
    bins = nulls.bins_of(rng, day, "white", accel_error=error, thermometer=False, charger=False)
    residuals = by_sensor(bins, nulls.G)[0]
    effects = effects_in(residuals)
    assert search.ranking(residuals, effects)[0].score < thresholds.SCORE
    found = {s.winner.hypothesis.effect.name for s in search.forward(residuals, effects)}
    assert found == {"accel_nonlinearity", "accel_bias_step"}


@pytest.mark.parametrize(
    ("first", "second", "named", "stated"),
    [(9.0, 9.0, True, True), (9.0, 4.2, True, False), (3.9, 9.0, True, False), (9.0, 9.0, False, False)],
)
def test_either_of_a_pair_has_a_name_and_passes_beside_the_other(
    monkeypatch: pytest.MonkeyPatch, first: float, second: float, named: bool, stated: bool
) -> None:
    """The second was chosen beside each of three, which it pays for: a score of 4.2 is below 4 + log10(3)."""

    def scored(effect: Effect, score: float) -> search.Scored:
        nothing: Any = None
        return search.Scored(Hypothesis(effect, {}, ()), nothing, score, score)

    names = {e.name: e for e in named_effects() if e.sensor == "accel"}
    one, *others = names.values()
    ranked = [scored(effect, 3.0) for effect in (one, *others[:2])]
    beside = others[2] if named else unknown_effects("accel")[0]
    monkeypatch.setattr(search, "ranking", lambda *_: [scored(beside, second)])
    monkeypatch.setattr(search, "proposals", lambda *_: [])
    monkeypatch.setattr(search, "compete", lambda *_: [scored(one, first)])
    nothing: Any = None
    found = search.of_hidden_pair(nothing, ranked, [beside], [], thresholds.SCORE)
    assert (found is not None) == stated


def test_of_each_likely_name_the_best_form_is_tried_for_a_pair_best_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What passes beside the first makes a pair with it, and is not tried again as the first of the same."""
    nothing: Any = None

    def scored(effect: Effect, value: float) -> search.Scored:
        return search.Scored(Hypothesis(effect, {}, ()), nothing, value, value)

    line, curve, cubic = (BiasTemperature("accel", degree) for degree in (1, 2, 3))
    names = {e.name: e for e in named_effects() if e.sensor == "accel" and e.name != line.name}
    step, scale, drift = (names[f"accel_{n}"] for n in ("bias_step", "scale_temperature", "bias_drift"))
    scores = [(unknown_effects("accel")[0], 3.8), (curve, 3.5), (line, 3.0), (step, 2.0), (scale, 1.5)]
    ranked = [scored(effect, value) for effect, value in [*scores, (cubic, 1.2), (drift, 0.9)]]
    tried: list[Effect] = []

    def beside(_: object, __: object, found: list[Hypothesis]) -> list[search.Scored]:
        tried.append(found[-1].effect)
        return [scored(step, 9.0)] if found[-1].effect is curve else []

    monkeypatch.setattr(search, "ranking", beside)
    monkeypatch.setattr(search, "proposals", lambda *_: [])
    monkeypatch.setattr(search, "compete", lambda *_: [scored(curve, 9.0)])
    found = search.of_hidden_pair(nothing, ranked, list(names.values()), [], thresholds.SCORE)
    assert found is not None and found.winner.hypothesis.effect is curve
    assert tried == [curve, scale]
