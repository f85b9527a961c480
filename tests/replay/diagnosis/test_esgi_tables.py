"""Tables of rests that state no uncertainty are diagnosed, such as the three that ship with the project."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.effects.timed import Step
from stillcal.calib_core.diagnosis.inference.likelihood import reduce_residuals
from stillcal.calib_core.diagnosis.inference.noise_models import families
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.screen import screened
from stillcal.calib_core.diagnosis.slow.search import proposals
from stillcal.calib_core.static.rest import RestState
from stillcal.replay.diagnosis.rest_table import diagnose_rests, rest_bins, told_of_temperatures
from stillcal.replay.formats.rest_table import read_rest_table


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_published_table_is_diagnosed(number: int) -> None:
    with as_file(files("stillcal.config") / "esgi" / f"dataset{number}.csv") as path:
        rests = read_rest_table(path)
    answer = diagnose_rests(rests, "table")
    names = {f["effect"] for f in answer["findings"]}
    assert names <= {"accel_nonlinearity", "unknown"}
    (norm, *_) = by_sensor(rest_bins(rests), 9.80665)[0].views
    for family in families(norm):
        assert np.isfinite(family.rotation).all() and (family.diagonals > 0.0).all()


def test_rates_printed_with_all_their_digits_are_not_taken_as_known_to_the_last(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    up = rng.normal(size=(24, 3))
    force = 9.80665 * up / np.linalg.norm(up, axis=1, keepdims=True) + rng.normal(size=(24, 3)) * 3e-4
    rate = np.array([0.01, -0.02, 0.005]) + rng.normal(size=(24, 3)) * 5e-5
    table = tmp_path / "rests.csv"
    rows = np.column_stack([30.0 * np.arange(24), force, rate])
    np.savetxt(table, rows, delimiter=",", header="t,ax,ay,az,gx,gy,gz", comments="")
    assert diagnose_rests(read_rest_table(table), "rests.csv")["findings"] == []


def rest(at: float, temperature: float | None = None) -> RestState:
    sd = np.full(3, 1e-3)
    force = np.array([0.0, 0.0, 9.8])
    return RestState(at, at + 20.0, 1, force, sd, sd, 1e-3, temperature=temperature)


def test_rows_may_stand_in_any_order_and_share_a_time() -> None:
    """Rows out of order ended the diagnosis with an error in a filter over time."""
    rests = [rest(60.0 * (i // 2), temperature=20.0 + i) for i in range(24)]
    mixed = rest_bins([rests[i] for i in np.random.default_rng(4).permutation(24)])
    assert mixed.temperature is not None and (np.diff(mixed.t) > 0.0).all()
    np.testing.assert_allclose(mixed.t, rest_bins(rests).t, atol=0.01)
    assert set(mixed.temperature[:2]) == {20.0, 21.0}


def few_digits(jump: float) -> list[RestState]:
    """Return 40 rests with rates of three digits: z keeps to two codes and jumps at 675 s, x and y to one."""
    rng = np.random.default_rng(6)
    up = rng.normal(size=(40, 3))
    force = 9.80665 * up / np.linalg.norm(up, axis=1, keepdims=True) + rng.normal(size=(40, 3)) * 3e-4
    at = np.arange(40)
    rate = np.array([0.0102, -0.0204, 0.0045]) + rng.normal(size=(40, 3)) * 1e-5
    rate[:, 2] += 6e-5 * np.sin(at / 4.0) + jump * (at > 22)
    sd = np.full(3, 1e-3 / 12**0.5)
    return [
        structs.replace(rest(30.0 * i), specific_force=f, rate=w, rate_uncertainty=sd)
        for i, (f, w) in enumerate(zip(force, np.round(rate, 3), strict=True))
    ]


def test_rates_of_few_digits_that_go_from_one_code_to_the_next_are_rounding() -> None:
    """A bias that wanders across the border between two codes was an effect with two levels in time."""
    assert diagnose_rests(few_digits(0.0), "rests.csv")["findings"] == []


def test_axes_that_keep_to_one_code_do_not_hide_a_step_of_the_other() -> None:
    """Curves were scaled by what is left of such an axis, 1e-34 of its noise; others were lost beside it."""
    made = by_sensor(rest_bins(few_digits(0.01)), 9.80665)[1]
    empty = reduce_residuals(made)
    tried = [h.grid["t_start"] for h in screened(made, [Step("gyro")], empty, [])]
    assert np.abs(np.array(tried) - 683.0).min() < 15.0


@pytest.mark.parametrize(("rows", "known"), [(20, lambda i: i not in {4, 11}), (48, lambda i: i % 3 == 0)])
def test_rows_without_a_temperature_do_not_cost_that_of_the_others(
    rows: int, known: Callable[[int], bool]
) -> None:
    """With two rows of three empty, a bias that followed temperature had a period in time."""
    rng = np.random.default_rng(8)
    up = rng.normal(size=(rows, 3))
    force = 9.80665 * up / np.linalg.norm(up, axis=1, keepdims=True) + rng.normal(size=(rows, 3)) * 1e-4
    warm = 20.0 + 9.0 * np.sin(np.arange(rows))
    kelvin = [float(w) if known(i) else None for i, w in enumerate(warm)]
    rests = [
        structs.replace(rest(60.0 * i, t), specific_force=f + np.array([0.0, 0.0, 0.004 * (w - 20.0)]))
        for i, (t, f, w) in enumerate(zip(kelvin, force, warm, strict=True))
    ]
    assert [f["effect"] for f in diagnose_rests(rests, "rests.csv")["findings"]] == ["accel_bias_temperature"]


@pytest.mark.parametrize(
    ("known", "said"),
    [(24, []), (13, ["11 of 24 rests have no temperature: these are left out"]), (5, ["not used"]), (0, [])],
)
def test_what_is_made_of_missing_temperatures_is_said(known: int, said: list[str]) -> None:
    """Two rows of three were left out without a word, and 'no temperature' was said of a table with some."""
    rests = [rest(60.0 * i, temperature=20.0 + i if i < known else None) for i in range(24)]
    notes = told_of_temperatures(rests)
    assert len(notes) == len(said) and all(part in note for part, note in zip(said, notes, strict=True))


def test_a_large_slope_over_temperature_is_the_point_of_a_second_search() -> None:
    """Residuals are linear in small errors; about nothing found the slope is off by its interval."""
    rng = np.random.default_rng(12)
    up = rng.normal(size=(24, 3))
    warm = 25.0 + 45.0 * np.sin(np.arange(24) / 4.0)
    slope = np.array([0.005, -0.003, 0.004])
    force = 9.80665 * up / np.linalg.norm(up, axis=1, keepdims=True) + rng.normal(size=(24, 3)) * 1e-4
    force += np.outer(warm - 25.0, slope)
    rests = [
        structs.replace(rest(60.0 * i, float(t)), specific_force=f)
        for i, (t, f) in enumerate(zip(warm, force, strict=True))
    ]
    (found,) = diagnose_rests(rests, "rests.csv")["findings"]
    assert found["effect"] == "accel_bias_temperature"
    np.testing.assert_allclose(found["parameters"]["slope"]["value"], slope, atol=1e-5)


@pytest.mark.parametrize(("rows", "most"), [(24, 7), (34, 12), (40, 15), (46, 18)])
def test_no_free_curve_goes_through_all_of_a_few_rests(rows: int, most: int) -> None:
    """Of temperature one had 18 numbers for 24 rests, and went before a slope or step that was there."""
    up = np.random.default_rng(7).normal(size=(rows, 3))
    force = 9.80665 * up / np.linalg.norm(up, axis=1, keepdims=True)
    rests = [structs.replace(rest(240.0 * i, 20.0 + i), specific_force=own) for i, own in enumerate(force)]
    (residuals,) = by_sensor(rest_bins(rests), 9.80665)
    found = proposals(residuals, effects_of("accel"))
    free = [h.sizes.size for h in found if h.effect.name == "unknown"]
    assert 0 < max(free) <= most
    assert {"accel_bias_temperature", "accel_nonlinearity"} <= {h.effect.name for h in found}
    assert max(h.sizes.size for h in found if h.effect.name != "unknown") == 9, "names have their curves"


@pytest.mark.parametrize("lasts", [1.0, 240.0])
def test_a_step_is_tried_evenly_in_time_and_midway_in_a_pause(lasts: float) -> None:
    """A row of a second had a part of it by chance: it was not put right, or what was found had no name."""
    moments = by_sensor(rest_bins([rest(240.0 * i, 20.0) for i in range(24)]), 9.80665)[0].moments
    moments = replace(moments, duration=np.full(24, lasts))
    made = np.array([grid["t_start"] for grid in Step("accel").finer(moments, {"t_start": 2760.0})])
    away = np.abs(np.subtract.outer(made, moments.t[:-1] + 120.0)).min(axis=1)
    np.testing.assert_allclose(away if lasts == 1.0 else np.diff(made) - 10.0, 0.0, atol=1e-9)


def warmed(celsius: Array) -> Bins:
    """Return the bins of rests a minute apart with these temperatures."""
    return rest_bins([rest(60.0 * i, float(c)) for i, c in enumerate(celsius)])


def test_temperatures_in_whole_kelvins_are_those_of_a_smooth_course() -> None:
    """A bias that followed the temperature seemed to follow its past, where the rounding is averaged out."""
    truth = 23.0 + 3.0 * np.sin(np.arange(100) / 20.0)
    found = warmed(np.round(truth)).temperature
    assert found is not None and (found - truth).std() < (np.round(truth) - truth).std() / 3.0


def test_temperatures_that_a_chamber_was_set_to_stay() -> None:
    steps = np.repeat([25.0, 15.0, 5.0, 15.0, 25.0, 35.0], 8)
    np.testing.assert_array_equal(warmed(steps).temperature, steps)


def test_rates_printed_in_degrees_have_the_rounding_of_degrees() -> None:
    rates = np.radians(np.round(np.random.default_rng(2).normal(0.4, 0.05, (20, 3)), 2))
    bins = rest_bins([structs.replace(rest(30.0 * i), rate=rate) for i, rate in enumerate(rates)])
    np.testing.assert_allclose(bins.rate_rounding, np.radians(0.01) / 12**0.5)
