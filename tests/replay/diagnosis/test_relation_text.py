"""The sentence about a difference is true of the numbers that it shows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.records import Discrepancy
from stillcal.calib_core.diagnosis.effects.catalogue import named_effects
from stillcal.calib_core.diagnosis.effects.described import DESCRIBED
from stillcal.calib_core.diagnosis.effects.followed import driver_of
from stillcal.calib_core.diagnosis.model.records import NAME as SENSORS
from stillcal.calib_core.diagnosis.model.records import (
    Departure,
    Evidence,
    Finding,
    Parameter,
    Where,
    only_unknown,
)
from stillcal.calib_core.diagnosis.noise.coloured_noise import DRIVER as COLOURED
from stillcal.replay.diagnosis.answer import _finding
from stillcal.replay.diagnosis.words.names import BUILT_IN
from stillcal.replay.diagnosis.words.relation_text import shown_of, statement, told_of_sensor, with_interval


def told(
    effect: str, relation: str, axes: list[str], *, either: bool = False, **parts: tuple[Any, Any, str]
) -> str:
    """Return the statement of parts given as recorded, simulated, unit, each with an interval of a tenth.

    either: whether it is not known which of the two has it.
    """

    def parameter(value: Any, unit: str) -> dict[str, Any]:
        value = np.asarray(value, dtype=np.float64)
        half = 0.05 * np.abs(value).max()
        ci = np.stack([value - half, value + half], axis=-1)
        return {"value": value.tolist(), "ci95": ci.tolist(), "unit": unit}

    finding = {
        "effect": effect,
        "sensor": effect.partition("_")[0],
        "axes": axes,
        "relation": relation,
        "alternatives": [],
        "parameters": {k: parameter(r, u) for k, (r, s, u) in parts.items()},
        "simulated": {k: parameter(s, u) for k, (r, s, u) in parts.items()},
        "difference": {k: parameter(np.subtract(r, s), u) for k, (r, s, u) in parts.items()},
        **({"of_either": True} if either else {}),
    }
    return statement(finding, ("real.csv", "sim.csv"))


def test_of_what_may_be_of_either_it_is_said_how_to_make_both_agree() -> None:
    text = told("accel_gyro_time_offset", "lacking", [], either=True, delay=(0.012, 0.0, "s"))
    assert text.startswith("real.csv and sim.csv differ by the delay between the sensors: 12.0")
    assert text.endswith("clearly more than the other. Added to sim.csv, it makes both agree.")


@pytest.mark.parametrize(
    ("recorded", "simulated", "says"),
    [
        ([2.0, 0.0, -4.0], [1.0, 0.0, -2.0], "is too small in sim.csv"),
        ([2.0, 0.0, -4.0], [4.0, 0.0, -8.0], "is too large in sim.csv"),
        ([2.0, 0.0, -4.0], [-2.0, 0.0, 4.0], "has the opposite sign in sim.csv"),
        ([88.0, 0.0, -100.0], [5.0, 0.0, 8.0], "has other values in sim.csv"),
        ([2.0, 0.0, -4.0], [1.0, 0.0, -8.0], "has other values in sim.csv"),
    ],
)
def test_the_word_holds_for_every_number_shown(
    recorded: list[float], simulated: list[float], says: str
) -> None:
    relation = "too_large" if "too large" in says else "too_small"
    assert says in told("gyro_bias", relation, ["x", "z"], bias=(recorded, simulated, "deg/s"))


def test_a_sentence_does_not_contradict_the_relation() -> None:
    """The relation is that of all numbers together, of which a sentence shows some."""
    text = told("gyro_bias", "too_large", ["x"], bias=([2.0, 0.0, 0.0], [1.0, 9.0, 0.0], "deg/s"))
    assert "has other values in sim.csv" in text


def test_both_sides_are_given_in_one_unit() -> None:
    text = told("gyro_bias_temperature", "too_small", ["x"], slope=([2e-4] * 3, [1e-4] * 3, "rad/s/K"))
    assert "x 0.00573 ± 0.00029 " in text and "x 0.01146 ± 0.00057 " in text and "deg/h" not in text


def test_of_a_matrix_the_elements_that_differ_are_shown_of_both() -> None:
    recorded, simulated = np.diag([-0.2, 0.0, 3.0]), np.diag([-1.0, 0.0, 0.5])
    text = told("gyro_scale", "too_small", ["z"], scale=(recorded.tolist(), simulated.tolist(), "1"))
    assert "x by x -100.0 ± 5.0 " in text and "x by x -20 ± 15 " in text
    assert "z by z 50.0 ± 5.0 " in text and "z by z 300 ± 15 " in text
    assert "y by y" not in text and "(2 of 9 elements)" in text


def test_what_to_change_is_said_with_its_unit() -> None:
    """Gravity is unknown to 0.2 % in each of both, so scales overlap however sure their ratios are."""
    text = told("accel_scale", "too_small", ["x"], scale=([1.0, 0.0, 0.0], [0.99, 0.0, 0.0], "1"))
    assert "Change it by x 1.000 ± 0.050 %." in text
    text = told("accel_scale", "too_small", ["x"], scale=([1.0, 0.0, 0.0], [0.5, 0.0, 0.0], "1"))
    assert "; real.csv has scale x 100.0 ± 5.0 %. Change it by x 50.0 ± 2.5 %." in text


def test_what_is_superfluous_is_named_in_plain_words() -> None:
    text = told("held_samples", "superfluous", [], fraction=([0.0], [0.2], "1"))
    assert text.startswith("sim.csv has what real.csv does not show: samples that repeat the one before, ")
    assert text.endswith("Take it out.")


def test_constants_of_a_pair_are_told_by_how_they_differ() -> None:
    text = told("gyro_bias", "lacking", ["z"], bias=([0.0, 0.0, 0.5], [0.0, 0.0, 0.0], "deg/s"))
    assert (
        text
        == "The gyroscope bias of real.csv differs from that of sim.csv by z 0.500 ± 0.025 deg/s. Add it."
    )


def test_a_matrix_without_a_clear_element_shows_its_largest() -> None:
    recorded = np.diag([0.0, 0.0, 0.06])
    text = told("gyro_scale", "too_small", ["z"], scale=(recorded.tolist(), np.zeros((3, 3)).tolist(), "1"))
    assert "z by z 6.00 ± 0.30 " in text and "(1 of 9 elements)" in text


def test_of_a_matrix_a_sure_element_is_shown_though_unsure_ones_are_larger() -> None:
    recorded, half = np.zeros((3, 3)), np.full((3, 3), 0.02)
    recorded[:, 2], recorded[2, 0], half[2, 0] = 0.013, 0.012, 0.002
    scale = {"value": recorded, "ci95": np.stack([recorded - half, recorded + half], 2)}
    assert shown_of({"difference": {"scale": scale}}, "scale", ["x", "y", "z"]) == [6]


@pytest.mark.parametrize(("half", "told_so"), [(4e-3, True), (5e-4, False)])
def test_sizes_that_are_sure_only_together_say_so(half: float, told_so: bool) -> None:
    value = [1e-3, 2e-4, -2e-4]
    sizes = {"value": value, "ci95": [[v - half, v + half] for v in value], "unit": "1/(m/s^2)"}
    finding = {
        "effect": "accel_nonlinearity",
        "sensor": "accel",
        "axes": ["x"],
        "relation": "lacking",
        "alternatives": [],
        "parameters": {"quadratic": sizes},
        "simulated": {},
        "difference": {"quadratic": sizes},
    }
    said = statement(finding, ("real.csv", "sim.csv"))
    assert ("it may be nothing, but not on all of them together" in said) == told_so
    sure = {"value": value, "ci95": [[v - 1e-5, v + 1e-5] for v in value], "unit": "1/(m/s^2)"}
    finding["parameters"] = finding["difference"] = {"quadratic": sizes, "cubic": sure}
    said = statement(finding, ("real.csv", "sim.csv"))
    assert "not on all of them together" not in said, "one parameter is sure by itself"


def test_the_part_that_differs_is_shown_with_its_pairs_of_axes() -> None:
    scale, misalignment = [0.1, 0.1, 0.1], [0.0, 2.0, 0.0]
    text = told(
        "accel_scale",
        "too_small",
        ["y"],
        scale=(scale, scale, "1"),
        misalignment=(misalignment, [0.0] * 3, "rad"),
    )
    assert "misalignment" in text and "xz 2" in text
    assert "correction" in text


def test_a_number_without_a_unit_has_its_name() -> None:
    text = told("accel_heavy", "lacking", [], ratio=([3.6], [0.0], "1"))
    assert "ratio 3.6" in text


@pytest.mark.parametrize(("ratio", "told_so"), [(1.42, True), (1.8, False)])
def test_a_ratio_of_the_root_of_two_may_be_a_convention(ratio: float, told_so: bool) -> None:
    finding = {
        "effect": "noise_level",
        "sensor": "gyro",
        "axes": [],
        "relation": "too_small",
        "alternatives": [],
        "parameters": {"ratio": {"value": ratio, "unit": "1"}},
        "simulated": {"ratio": {"value": 1.0, "unit": "1"}},
        "difference": {},
    }
    assert ("two-sided" in statement(finding, ("real.csv", BUILT_IN))) == told_so
    assert "two-sided" not in statement(finding, ("real.csv", "sim.csv"))


def test_a_bias_names_the_temperature_that_it_holds_at() -> None:
    finding = {
        "effect": "accel_bias",
        "sensor": "accel",
        "axes": ["x"],
        "relation": "lacking",
        "alternatives": [],
        "where": {"driver": "nothing"},
        "parameters": {"bias": {"value": [0.1, 0.0, 0.0], "unit": "m/s^2"}},
        "simulated": {},
        "difference": {},
    }
    warm = finding | {"reference": {"temperature_c": 31.24}}
    assert "The numbers hold at 31.2 °C." in statement(warm, ("real.csv", "sim.csv"))
    assert "°C" not in statement(finding, ("real.csv", "sim.csv"))
    slope = {
        "effect": "accel_bias_temperature",
        "parameters": {"slope": {"value": [0.1] * 3, "unit": "mg/K"}},
    }
    assert "It adds nothing at 31.2 °C." in statement(warm | slope, ("real.csv", "sim.csv"))
    of_column = {
        "effect": "accel_bias_load",
        "where": {"driver": driver_of("load")},
        "reference": {"load": 0.512345},
    }
    assert "It adds nothing where load is 0.5123." in statement(
        warm | slope | of_column, ("real.csv", "sim.csv")
    )


def test_a_step_says_when_it_comes() -> None:
    finding = {
        "effect": "accel_bias_step",
        "sensor": "accel",
        "axes": ["x"],
        "relation": "lacking",
        "alternatives": [],
        "where": {"t_start": 800.0, "t_end": 1500.0, "driver": "time"},
        "parameters": {"step": {"value": [0.1, 0.0, 0.0], "unit": "m/s^2"}},
        "simulated": {},
        "difference": {},
    }
    assert statement(finding, ("real.csv", "sim.csv")).endswith(" It comes at 800 s.")


def test_a_time_constant_is_called_one() -> None:
    text = told("gyro_warmup", "lacking", ["x"], amplitude=([2.0] * 3, [0.0] * 3, "rad/s"),
                tau_s=([300.0], [0.0], "s"))  # fmt: skip
    assert "time constant 300 " in text and "tau" not in text


def test_what_has_no_name_is_told_with_axes_time_and_size() -> None:
    finding = {
        "effect": "unknown",
        "sensor": "accel",
        "axes": ["y"],
        "relation": "lacking",
        "alternatives": [],
        "where": {"t_start": 0.0, "t_end": 830.8, "driver": "own force in a stretch of time"},
        "parameters": {"gain": {"value": [0.0, -0.003, 0.0], "ci95": [[-0.0033, -0.0027]] * 3, "unit": "1"}},
        "simulated": {},
        "difference": {},
    }  # fmt: skip
    said = statement(finding, ("real.csv", BUILT_IN))
    assert ", on y from 0 to 831 s, gain y -0.300 ± 0.030 %; it follows own force" in said
    observed = statement(finding, ("real.csv", BUILT_IN), "Its gain depends on the weather.")
    assert ", gain y -0.300 ± 0.030 %. Its gain depends on the weather. The built-in" in observed
    # Gravity's norm sees one direction a rest: all three axes together are sure, and none of them by itself.
    loose = {"step": {"value": [0.006, 0.03, -0.028], "ci95": [[-0.01, 0.022], [-0.01, 0.07], [-0.07, 0.014]],
                      "unit": "m/s^2"}}  # fmt: skip
    text = statement(finding | {"parameters": loose}, ("real.csv", BUILT_IN))
    assert "(accelerometer), from 0 to 831 s, step up to 3.06 mg (the axes are not told apart);" in text
    many = {"amplitude": {"value": (0.01 * np.eye(3)).tolist(), "unit": "rad/s"}}
    assert "amplitude up to 0.573 deg/s;" in statement(finding | {"parameters": many}, ("real.csv", BUILT_IN))


@pytest.mark.parametrize("relation", ["too_small", "too_large"])
def test_what_has_no_name_in_either_is_told_with_both_sizes(relation: str) -> None:
    sides = {
        side: {
            "amplitude": {"value": [size, 0.0, 0.0], "ci95": [[0.9 * size, 1.1 * size]] * 3, "unit": "rad/s"}
        }
        for side, size in (("parameters", 0.02), ("simulated", 0.01))
    }
    where = {"t_start": 0.0, "t_end": 60.0, "driver": "a vibration that comes and goes"}
    finding = {
        "effect": "unknown", "sensor": "gyro", "axes": ["x"], "relation": relation, "alternatives": [],
        "where": where, "difference": {}, **sides,
    }  # fmt: skip
    said = statement(finding, ("real.csv", "sim.csv"))
    assert said.endswith("comes and goes. sim.csv shows it too, amplitude x 0.573 ± 0.057 deg/s.")
    assert "does not show it" not in said


@pytest.mark.parametrize(
    ("said", "told"), [("The x axis is stuck at 0.3.", True), (only_unknown("(accel)", "samples"), False)]
)
def test_what_was_observed_of_something_nameless_is_told_with_it(said: str, told: bool) -> None:
    where = Where(0.0, 60.0, (0.0, 0.0), "samples")
    own = Finding("unknown", "accel", ["x"], where, {}, Evidence(30.0), [], said)
    one = Discrepancy("unknown", "accel", ["x"], where, "lacking", 1.0, 30.0, recorded=own)
    text = _finding(one, ("real.csv", BUILT_IN), {}, None)["statement"]
    assert (said in text) == told and ("it follows samples" in text) != told


def test_what_is_no_number_to_add_has_no_difference() -> None:
    """A matrix of exchanged axes that the simulation alone has was to be added with the other sign."""
    where = Where(0.0, 60.0, (0.0, 0.0), "samples")
    sizes = {
        "exchange": Parameter([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], None, "1"),
        "size": Parameter(2.0, None, "1"),
    }
    own = Finding("axis_exchange", "gyro", ["x"], where, sizes, Evidence(30.0), [], "")
    one = Discrepancy("axis_exchange", "gyro", ["x"], where, "superfluous", 1.0, 30.0, simulated=own)
    told = _finding(one, ("real.csv", "sim.csv"), {}, None)
    assert set(told["simulated"]) == set(sizes)
    assert told["difference"] == {"size": {"value": -2.0, "unit": "1"}}


def test_a_daemons_user_is_told_of_the_sensor_and_of_no_simulation() -> None:
    def of_sensor(effect: str, sensor: str, **more: Any) -> str:
        finding: dict[str, Any] = {
            "effect": effect,
            "sensor": sensor,
            "axes": ["x"],
            "where": {"driver": "time since start"},
            "alternatives": [],
            "parameters": {"size": {"value": 2e-3, "unit": "rad/s", "ci95": [1.9e-3, 2.1e-3]}},
            "simulated": {},
            "difference": {},
        }
        told = told_of_sensor(finding | more)
        assert told["size"] in told["statement"] and told["statement"].endswith(".")
        return told["statement"]

    named = [(e.name, e.sensor) for e in named_effects()]
    for effect, sensor in (*named, *((effect, "gyro") for effect in DESCRIBED)):
        text = of_sensor(effect, sensor)
        assert text.startswith(f"The {SENSORS[sensor]}") and "simulation" not in text and "{" not in text
    assert of_sensor("gyro_warmup", "gyro").startswith(
        "The gyroscope's bias settles after the start of the re"
    )
    assert "it follows time since start" in of_sensor("unknown", "gyro")
    assert of_sensor("gyro_warmup", "gyro", assumption="So it is.").endswith(" So it is.")


def test_a_form_that_is_not_kept_is_told_with_its_part_and_its_probability() -> None:
    where = Where(0.0, 1.0, (0.0, 0.05), "charging")
    sizes = {"step": Parameter([1e-3, 0.0, 0.0], [[9e-4, 2e-3]] * 3, "rad/s")}
    for departure in (None, Departure(9.0, 0.31, "not all at once")):
        found = Finding("gyro_charging_bias", "gyro", ["x"], where, sizes, Evidence(30.0), [], "", departure)
        one = Discrepancy("gyro_charging_bias", "gyro", ["x"], where, "lacking", 0.99, 30.0, recorded=found)
        said = _finding(one, ("real.csv", BUILT_IN), {}, None)
        assert ("the effect goes not all at once, which makes 31 % of its size" in said["statement"]) == bool(
            departure
        )
        assert ("departure" in said) == bool(departure)
        assert departure is None or said["departure"]["probability"] > 0.99


def test_exchanged_axes_are_told_with_when_and_that_they_may_be_the_other_sensors() -> None:
    finding = {
        "effect": "axis_exchange",
        "sensor": "gyro",
        "axes": ["x"],
        "relation": "lacking",
        "where": {"t_start": 10.0, "t_end": 90.0, "driver": "rate of turn"},
        "alternatives": [],
        "parameters": {"miss": {"value": 1.2, "unit": "rad"}},
        "simulated": {},
        "difference": {},
    }
    text = statement(finding, ("real.csv", "sim.csv"))
    assert "from 10 to 90 s" in text and text.endswith("an exchange of the other sensor's axes.")


def test_exchanged_axes_are_told_by_what_puts_them_right() -> None:
    exchange: list[list[float]] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    finding = {
        "effect": "axis_exchange",
        "sensor": "gyro",
        "axes": ["x", "y"],
        "relation": "lacking",
        "alternatives": [],
        "where": {"t_start": 20.0, "t_end": 300.0},
        "parameters": {"miss": {"value": 1.2, "unit": "rad"}, "exchange": {"value": exchange, "unit": "1"}},
        "simulated": {},
        "difference": {},
    }
    text = statement(finding, ("real.csv", "sim.csv"))
    assert "exchange undone by x = -y, y = x. Add it." in text and "elements" not in text


@pytest.mark.parametrize(
    ("fraction", "start", "says"),
    [
        (0.25, 600.0, " It lasts from 600 to 900 s."),
        (0.9, -0.01, " It lasts from 0 to 900 s."),
        (1.0, 0.0, ""),
    ],
)
def test_a_vibration_of_a_part_of_the_recording_says_when(fraction: float, start: float, says: str) -> None:
    finding = {
        "effect": "vibration_tone",
        "sensor": "accel",
        "axes": ["z"],
        "relation": "lacking",
        "alternatives": [],
        "where": {"t_start": start, "t_end": 900.0, "driver": "time"},
        "parameters": {"fraction": {"value": fraction, "unit": "1"}},
        "simulated": {},
        "difference": {},
    }
    text = statement(finding, ("real.csv", BUILT_IN))
    assert text.endswith(says) and ("It lasts" in text) == bool(says)


def test_a_sentence_after_a_parenthesis_begins_with_a_capital() -> None:
    finding = {
        "effect": "unknown",
        "sensor": "accel",
        "axes": ["x"],
        "relation": "lacking",
        "alternatives": [],
        "where": {"t_start": 0.0, "t_end": 300.0, "driver": "time"},
        "parameters": {},
        "simulated": {},
        "difference": {},
    }
    text = statement(finding, ("real.csv", BUILT_IN), "It is seen. (Or its alias is.)")
    assert text.endswith("(Or its alias is.) The built-in simulation does not show it.")


@pytest.mark.parametrize(
    ("low", "high", "shown", "says"),
    [
        (0.9, 1.1, [0, 1, 2], "1.00 ± 0.10 s on each axis"),
        (0.5, 2.0, [0, 1, 2], "1.00 (0.500 to 2.00) s on each axis"),
        (0.5, 2.0, [1], "y 1.00 (0.500 to 2.00) s"),
        (0.8, 1.4, [0], "x 1.00 (0.800 to 1.40) s"),
        (0.8, 1.28, [0], "x 1.00 ± 0.24 s"),
    ],
)
def test_one_number_for_all_axes_is_said_once_and_a_lopsided_interval_by_its_ends(
    low: float, high: float, shown: list[int], says: str
) -> None:
    assert with_interval("size", {"value": [1.0] * 3, "ci95": [[low, high]] * 3, "unit": "s"}, shown) == says


@pytest.mark.parametrize("interval", [{}, {"ci95": [[1.0, 1.0]] * 3}])
def test_a_number_without_an_interval_is_said_alone(interval: dict[str, Any]) -> None:
    assert with_interval("size", {"value": [1.0] * 3, "unit": "s", **interval}, [1]) == "y 1.00 s"


def test_elements_of_a_matrix_are_shown_that_are_beyond_their_errors() -> None:
    """An error is half of a 95 % interval over 1.96; 2.6 of them are enough."""
    values, errors = np.arange(1.0, 10.0), np.full(9, 4.5 / 2.6)
    ends = np.stack([values - 1.96 * errors, values + 1.96 * errors], axis=1)
    matrix = {"value": values.tolist(), "ci95": ends.tolist(), "unit": "1"}
    assert shown_of({"parameters": {"matrix": matrix}}, "matrix", []) == [6, 7, 8]
    few = {"value": [0.0, 0.0, 1.0, 5.0, 6.0, 0.0, 0.0, 0.0, 0.0], "ci95": ends.tolist(), "unit": "1"}
    assert shown_of({"parameters": {"matrix": few}}, "matrix", []) == [3, 4]


def test_numbers_that_differ_between_axes_are_given_for_each() -> None:
    parameter = {"value": [1.0, 1.0, 2.0], "ci95": [[0.9, 1.1], [0.9, 1.1], [1.9, 2.1]], "unit": "s"}
    assert with_interval("size", parameter, [0, 1, 2]) == "x 1.00 ± 0.10 s, y 1.00 ± 0.10 s, z 2.00 ± 0.10 s"
    angles = {"value": [0.01] * 3, "ci95": [[0.009, 0.011]] * 3, "unit": "rad"}
    assert with_interval("misalignment", angles, [0, 1, 2]).startswith("xy 10.0 ± 1.0 mrad, xz 10.0")


def test_the_band_of_what_both_have_is_told() -> None:
    finding = {
        "effect": "unknown",
        "sensor": "gyro",
        "axes": ["x", "y", "z"],
        "relation": "too_small",
        "where": {"t_start": 0.0, "t_end": 60.0, "band_hz": [15.0, 22.0], "driver": COLOURED},
        "parameters": {"ratio": {"value": 15.1, "ci95": [14.5, 15.7], "unit": "1"}},
        "simulated": {"ratio": {"value": 4.2, "ci95": [4.0, 4.4], "unit": "1"}},
        "evidence": {"posterior_probability": 0.97},
        "alternatives": [],
        "difference": {"ratio": {"value": 10.9, "ci95": [10.3, 11.5], "unit": "1"}},
    }
    assert f"it follows {COLOURED}, 15 to 22 Hz." in statement(finding, ("a.csv", "b.csv"))
