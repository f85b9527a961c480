"""A simulation's own configuration, corrected by findings."""

from __future__ import annotations

import json
import tomllib
import xml.etree.ElementTree as ET
from typing import Any

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.errors import UserError
from stillcal.replay.export.fix.fixers import FIXERS, fixed_for
from stillcal.replay.phone.phone import Phone


def finding(
    effect: str,
    sensor: str,
    values: dict[str, tuple[Any, Any]],
    relation: str = "too_small",
    axes: str = "xyz",
    **more: Any,
) -> dict[str, Any]:
    """A finding of JSON schema 2; values: parameter to the recording's and the simulation's."""
    pairs = {k: (np.asarray(a, float), np.asarray(b, float)) for k, (a, b) in values.items()}
    return {
        "effect": effect,
        "sensor": sensor,
        "axes": list(axes),
        "relation": relation,
        "parameters": {k: {"value": a.tolist()} for k, (a, _) in pairs.items()},
        "simulated": {k: {"value": b.tolist()} for k, (_, b) in pairs.items()},
        "difference": {k: {"value": (a - b).tolist()} for k, (a, b) in pairs.items()},
        **more,
    }


BIAS = finding("gyro_bias", "gyro", {"bias": ([0.03, 0.5, 0.02], [0.01, 0.1, 0.0])}, axes="xz")
WHITE = finding("noise_level", "accel", {"density": ([4e-3, 2e-3, 3e-3], [2e-3, 2e-3, 2e-3])})
SLOW = finding("gyro_slow_noise", "gyro", {"allan_deviation_100s": ([3e-5] * 3, [1e-5] * 3)})
AGREED = {"effect": "noise_level", "sensor": "gyro", "parameters": {"density": {"value": [2e-4] * 3}}}
SLOW_ALONE = float(np.sqrt(3e-5**2 - 2e-4**2 / 200.0))
"""The Allan deviation at 100 s of SLOW without white noise, whose one-sided density is 2e-4."""
RATE = finding("sample_rate", "timing", {"rate": (200.0, 100.0)}, axes="")
SLOPE = finding(
    "gyro_bias_temperature",
    "gyro",
    {"slope": ([2e-4, 0.0, -1e-4], [0.0, 0.0, 0.0])},
    "lacking",
    reference={"temperature_c": 35.0},
)
SCALE = finding("gyro_scale", "gyro", {"scale": (np.diag([-0.02, 0.0, 0.01]), np.zeros((3, 3)))}, "lacking")
MATRIX = finding("gyro_g_sensitivity", "gyro", {"matrix": (np.eye(3) * 1e-4, np.zeros((3, 3)))}, "lacking")
UNKNOWN = finding("unknown", "gyro", {}, "lacking")
ALL = [BIAS, WHITE, SLOW, RATE, SLOPE, SCALE, MATRIX, UNKNOWN]


def fixed(tool: str, text: str | None, *findings: dict[str, Any]) -> Any:
    return fixed_for(tool, text, {"findings": list(findings), "agreed": [AGREED]})


PHONE = """# my phone
[heat]
reference_c = 25.0  # as in the chamber

[gyro]
rate_hz = 100.0
bias = [0.001, 0.002, 0.003]  # measured in May

[accel]
[accel.noise]
white = 0.002

[[effect]]
# from the datasheet
name = "gyro_g_sensitivity"
matrix = [[0.0001, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
"""


def test_a_phone_file_keeps_its_comments_and_takes_every_effect_but_the_unknown() -> None:
    made = fixed("phone", PHONE, *ALL)
    phone = msgspec.convert(tomllib.loads(made.text), type=Phone)
    for kept in ("# my phone", "# as in the chamber", "# measured in May", "# from the datasheet"):
        assert kept in made.text
    assert [line.partition(":")[0] for line in made.not_held] == ["unknown (gyroscope)"]
    assert phone.gyro is not None
    # The bias counts at 25 degC; slope and bias of the findings count at 35: 10 K less of the slope.
    np.testing.assert_allclose(phone.gyro.bias, [0.001 + 0.02 - 2e-3, 0.002, 0.003 + 0.02 + 1e-3])
    assert phone.gyro.rate_hz == 200.0
    assert phone.accel.noise.white == (0.004, 0.002, 0.003)
    slope, matrix = (next(e for e in phone.effects if e.name == f["effect"]) for f in (SLOPE, MATRIX))
    assert slope.slope == (2e-4, 0.0, -1e-4)  # type: ignore[attr-defined]
    np.testing.assert_allclose(np.diag(matrix.matrix), [2e-4, 1e-4, 1e-4])  # type: ignore[attr-defined]
    np.testing.assert_allclose(phone.gyro.scale, np.diag([1.0 / 0.98, 1.0, 1.0 / 1.01]), rtol=1e-9)


@pytest.mark.parametrize("relation", ["lacking", "superfluous"])
def test_a_curve_in_temperature_is_put_into_a_phone_about_its_own_reference(relation: str) -> None:
    """It was refused for want of a setting, which the file has. Bias and curve together count at 35 degC."""
    curve = {"slope": [2e-4, 0.0, -1e-4], "quadratic": [1e-6, 0.0, 2e-6], "cubic": [0.0, 0.0, 3e-8]}
    text = "[heat]\nreference_c = 25.0\n\n[gyro]\nbias = [0.001, 0.002, 0.003]\n"
    lacking = {k: (v, [0.0] * 3) for k, v in curve.items()}
    put = finding("gyro_bias_temperature", "gyro", lacking, "lacking", reference={"temperature_c": 35.0})
    made = fixed("phone", text, put)
    if relation == "superfluous":
        own = {k: ([0.0] * 3, v) for k, v in curve.items()}
        gone = finding(put["effect"], "gyro", own, relation, reference=put["reference"])
        made = fixed("phone", made.text, gone)
    assert made.not_held == []
    phone = msgspec.convert(tomllib.loads(made.text), type=Phone)
    assert phone.gyro is not None
    for at in (10.0, 35.0, 50.0):
        bias = np.array(phone.gyro.bias)
        for effect in phone.effects:
            for p, name in enumerate(curve, start=1):
                bias += np.array(getattr(effect, name)) * (at - 25.0) ** p
        put_in = sum(np.array(c) * (at - 35.0) ** p for p, c in enumerate(curve.values(), start=1))
        wanted = np.array([0.001, 0.002, 0.003]) + (put_in if relation == "lacking" else 0.0)
        np.testing.assert_allclose(bias, wanted, atol=1e-8)


def test_a_phone_file_that_is_not_plain_is_written_anew_and_says_so() -> None:
    made = fixed("phone", "gyro = {bias = [0.001, 0.0, 0.0]}  # mine\n", BIAS)
    phone = msgspec.convert(tomllib.loads(made.text), type=Phone)
    assert phone.gyro is not None and phone.gyro.bias[0] == pytest.approx(0.021)
    assert any("comments are lost" in line for line in made.changed)


@pytest.mark.parametrize(("rate_hz", "cutoff_hz"), [(90.0, 44.0), (88.0, None)])
def test_a_low_pass_stays_while_it_is_below_half_of_the_new_rate(
    rate_hz: float, cutoff_hz: float | None
) -> None:
    text = "[accel]\ncutoff_hz = 44.0\n\n[gyro]\n"
    made = fixed("phone", text, finding("sample_rate", "timing", {"rate": (rate_hz, 100.0)}, axes=""))
    phone = msgspec.convert(tomllib.loads(made.text), type=Phone)
    assert (phone.accel.rate_hz, phone.accel.cutoff_hz) == (rate_hz, cutoff_hz)


def test_what_the_recording_does_not_have_is_taken_out_of_a_phone() -> None:
    gone = finding(
        "gyro_g_sensitivity", "gyro", {"matrix": (np.zeros((3, 3)), np.eye(3) * 1e-4)}, "superfluous"
    )
    gone["parameters"] = {}
    made = fixed("phone", PHONE, gone)
    assert "gyro_g_sensitivity" not in made.text
    assert "# measured in May" in made.text


LINES = """[[effect]]
name = "vibration_tone"
frequency = 17.3
amplitude = [0.0, 0.0, 0.004]

[[effect]]
name = "vibration_tone"
frequency = 40.0
amplitude = [0.0, 0.001, 0.0]
"""


@pytest.mark.parametrize(
    ("relation", "recorded", "simulated", "left"),
    [
        ("lacking", (31.7, 0.003), None, {17.3: 0.004, 31.7: 0.003, 40.0: 0.001}),
        ("too_small", (17.31, 0.006), (17.3, 0.004), {17.31: 0.006, 40.0: 0.001}),
        ("superfluous", None, (40.0, 0.001), {17.3: 0.004}),
    ],
)
def test_each_line_of_a_phone_is_one_of_its_own(
    relation: str,
    recorded: tuple[float, float] | None,
    simulated: tuple[float, float] | None,
    left: dict[float, float],
) -> None:
    """A second line is put beside the first, not over it, and one that goes leaves the other."""
    axis = "y" if relation == "superfluous" else "z"
    frequency, size = zip(recorded or (0.0, 0.0), simulated or (0.0, 0.0), strict=True)
    amplitudes = tuple([a if x == axis else 0.0 for x in "xyz"] for a in size)
    values = {"frequency": frequency, "amplitude": amplitudes}
    found = finding("vibration_tone", "accel", values, relation, axis)
    absent = {"lacking": ("simulated", "difference"), "superfluous": ("parameters", "difference")}
    for side in absent.get(relation, ("difference",)):
        found[side].pop("frequency")
    found["parameters"] = found["parameters"] if recorded else {}
    made = fixed("phone", LINES, found)
    phone = msgspec.convert(tomllib.loads(made.text), type=Phone)
    assert {e.frequency: max(e.amplitude) for e in phone.effects} == pytest.approx(left)  # type: ignore[attr-defined, union-attr]


@pytest.mark.parametrize(("upper", "held"), [(1.0, True), (0.5, False)])
def test_a_line_that_may_last_all_along_is_put_in_whole(upper: float, held: bool) -> None:
    """It was put in, and counted as left out for want of a setting of its part of the recording."""
    values = {"frequency": (12.0, 0.0), "amplitude": ([0.0, 0.0, 0.02], [0.0] * 3), "fraction": (0.9, 0.0)}
    found = finding("vibration_tone", "accel", values, "lacking", "z")
    found["parameters"]["fraction"]["ci95"] = [0.2, upper]
    for name in ("frequency", "fraction"):
        found["difference"].pop(name)
    made = fixed("phone", PHONE, found)
    assert "amplitude = [0.0, 0.0, 0.02]" in made.text
    assert made.left_out == ([] if held else ["vibration_tone"])


@pytest.mark.parametrize("settled", [0.0, 1.0])
def test_a_settling_leaves_the_phones_bias_where_the_finding_counts_from(settled: float) -> None:
    """A phone file's bias is that of the start."""
    values = {"amplitude": ([0.002, 0.0, 0.0], [0.0] * 3), "tau_s": (300.0, 300.0)}
    found = finding("gyro_warmup", "gyro", values, "lacking", "x", reference={"settled": settled})
    before = msgspec.convert(tomllib.loads(PHONE), type=Phone)
    after = msgspec.convert(tomllib.loads(fixed("phone", PHONE, found).text), type=Phone)
    assert before.gyro is not None and after.gyro is not None
    moved = np.subtract(after.gyro.bias, before.gyro.bias)
    np.testing.assert_allclose(moved, [-0.002 * settled, 0.0, 0.0], atol=1e-12)


def test_what_rests_on_an_assumption_is_put_into_no_configuration() -> None:
    """A simulation at one temperature, without a thermometer, may have the slope that it does not show."""
    made = fixed("phone", PHONE, SLOPE | {"assumption": "the temperature is not known"})
    assert made.text == PHONE and made.left_out == ["gyro_bias_temperature"]


SDF = """<?xml version="1.0"?>
<!-- before -->
<sdf version="1.9"><model name="m"><link name="l">
  <sensor name="imu" type="imu">
    <update_rate>100</update_rate>
    <imu>
      <linear_acceleration>
        <x><noise type="gaussian"><mean>0.1</mean><stddev>0.02</stddev></noise></x> <!-- keep > -->
        <y><noise type="gaussian"><mean>0</mean><stddev>0.02</stddev></noise></y>
        <z><noise type="none"/></z>
      </linear_acceleration>
    </imu>
  </sensor>
</link></model></sdf>
"""


def test_gazebo_is_changed_in_place() -> None:
    made = fixed("gazebo", SDF, *ALL)
    imu = ET.fromstring(made.text).find(".//imu")
    assert imu is not None
    assert "<!-- before -->" in made.text and "<!-- keep > -->" in made.text
    for axis, ratio in (("x", 2.0), ("y", 1.0)):
        # Twice the rate: root two more in a sample, beside the density's own ratio.
        assert float(imu.findtext(f"linear_acceleration/{axis}/noise/stddev") or 0) == pytest.approx(
            0.02 * np.sqrt(2.0) * ratio
        )
    z = imu.find("linear_acceleration/z/noise")
    assert z is not None and z.get("type") == "gaussian"
    assert float(z.findtext("stddev") or 0) == pytest.approx(3e-3 * np.sqrt(100.0))
    assert float(imu.findtext("angular_velocity/x/noise/mean") or 0) == pytest.approx(0.02)
    assert imu.findtext("angular_velocity/y/noise/mean") is None
    # The Allan variance at a tenth of its correlation time of a Gauss-Markov process of unit variance.
    unit = 20.0 * (1.0 - 5.0 * (3.0 - 4.0 * np.exp(-0.1) + np.exp(-0.2)))
    driving, tau = (
        float(imu.findtext(f"angular_velocity/y/noise/dynamic_bias_{name}") or 0)
        for name in ("stddev", "correlation_time")
    )
    assert tau == 1000.0 and driving * np.sqrt(tau / 2.0 * unit) == pytest.approx(SLOW_ALONE)
    assert {line.partition(":")[0] for line in made.not_held} == {
        "gyro_bias_temperature",
        "gyro_scale",
        "gyro_g_sensitivity",
        "unknown (gyroscope)",
    }


def test_where_there_is_no_temperature_the_bias_is_that_at_the_recordings_mean() -> None:
    at = SLOPE | {"reference": {"temperature_c": 25.0, "mean_temperature_c": 30.0}}
    made = fixed("gazebo", SDF, at)
    imu = ET.fromstring(made.text).find(".//imu")
    assert imu is not None
    means = [float(imu.findtext(f"angular_velocity/{axis}/noise/mean") or 0.0) for axis in "xyz"]
    assert means == pytest.approx([5.0 * 2e-4, 0.0, 5.0 * -1e-4])
    assert made.left_out == ["gyro_bias_temperature"] and "30.0 degC" in made.not_held[0]


def test_airsim_multiplies_its_own_values_and_keeps_other_settings() -> None:
    text = json.dumps({"SimMode": "Car", "Vehicles": {"A": {"Sensors": {"I": {"SensorType": 2, "x": 1}}}}})
    value = json.loads(fixed("airsim", text, WHITE, SLOW, BIAS).text)
    imu = value["Vehicles"]["A"]["Sensors"]["I"]
    assert (value["SimMode"], imu["x"]) == ("Car", 1)
    assert imu["VelocityRandomWalk"] == pytest.approx(0.24 * np.sqrt((16 + 4 + 9) / 12))
    walk = np.deg2rad(imu["GyroBiasStability"] / 3600.0) / np.sqrt(500.0)  # AirSim's own Tau
    assert walk * np.sqrt(100.0 / 3.0) == pytest.approx(SLOW_ALONE)


def test_kalibr_changes_its_lines_only() -> None:
    text = "rostopic: /i\nupdate_rate: 100.0 # Hz\naccelerometer_noise_density: 1.0e-3   # mine\n"
    made = fixed("kalibr", text, WHITE, RATE, SLOW)
    assert "update_rate: 200 # Hz\n" in made.text
    assert f"accelerometer_noise_density: {1e-3 * np.sqrt(29 / 12):.10g}   # mine\n" in made.text
    assert made.not_held == ["gyro_slow_noise: there is no gyroscope_random_walk in it"]


WITH_WALKS = pytest.mark.parametrize(
    ("tool", "text", "written", "unit"),
    [
        ("kalibr", "gyroscope_random_walk: 1.0e-6\n", "gyroscope_random_walk: ", 1.0),
        (
            "imusensor",
            "a = imuSensor();\na.Gyroscope.RandomWalk = [1e-6 1e-6 1e-6];\n",
            "Walk = [",
            np.sqrt(2.0),
        ),
        ("phone", "[gyro.noise]\nrandom_walk = 1e-6\n", "random_walk = [", 1.0),
    ],
)
"""Files with a random walk of their own: what stands before it, and what it has to be multiplied by."""


@WITH_WALKS
def test_slow_noise_is_written_as_the_walk_that_the_recording_has_beside_its_white_noise(
    tool: str, text: str, written: str, unit: float
) -> None:
    """The file's own walk is hidden by white noise in what was compared; multiplied by how many times larger
    that is in the recording, it was as much too small."""
    made = fixed(tool, text, SLOW)
    value = float(made.text.partition(written)[2].split()[0].strip(",]"))
    assert value * unit * np.sqrt(100.0 / 3.0) == pytest.approx(SLOW_ALONE)


@pytest.mark.parametrize("tool", FIXERS)
def test_slow_noise_beside_an_unknown_white_noise_is_not_written(tool: str) -> None:
    fresh = fixed(tool, None, SLOW).text
    made = fixed_for(tool, fresh, {"findings": [SLOW]})
    assert not made.changed
    assert made.not_held == ["gyro_slow_noise: how much of its Allan deviation is white noise is not known"]


@pytest.mark.parametrize("tool", FIXERS)
def test_where_the_recording_has_white_noise_only_slow_noise_is_taken_out(tool: str) -> None:
    """kalibr accepts no file without slow noise."""
    less = finding("gyro_slow_noise", "gyro", {"allan_deviation_100s": ([1e-5] * 3, [3e-5] * 3)}, "too_large")
    fresh = fixed(tool, None, SLOW).text
    made = fixed(tool, fresh, less)
    if tool == "kalibr":
        assert made.not_held == [
            "gyro_slow_noise: the recording shows none, and kalibr wants a random walk above 0"
        ]
    else:
        assert not made.not_held
        assert fixed(tool, made.text, SLOW).text == fixed(tool, fresh, SLOW).text != made.text


@WITH_WALKS
def test_a_random_walk_is_written_as_it_was_found(tool: str, text: str, written: str, unit: float) -> None:
    """kalibr and the others held none: only slow noise of no certain kind was written."""
    walk = finding("gyro_bias_random_walk", "gyro", {"density": ([5e-6] * 3, [2e-6] * 3)})
    made = fixed(tool, text, walk)
    assert float(made.text.partition(written)[2].split()[0].strip(",]")) * unit == pytest.approx(5e-6)
    assert not made.not_held


OF_EFFECT = '[[effect]]\nname = "gyro_bias_random_walk"\ndensity = [2e-6, 2e-6, 2e-6]\n'
OWN_WALK = "[gyro.noise]\nrandom_walk = 3e-6\n\n"


@pytest.mark.parametrize("text", ["", OF_EFFECT, OWN_WALK + OF_EFFECT])
def test_a_phone_without_a_walk_of_its_own_or_with_one_as_an_effect_gets_the_effect(text: str) -> None:
    """Walks are added in power: 4e-6 beside the phone's own 3e-6 is what a recording of 5e-6 has."""
    simulated = [2.4e-6 if text else 0.0] * 3
    walk = finding("gyro_bias_random_walk", "gyro", {"density": ([5e-6] * 3, simulated)})
    made = fixed("phone", text, walk)
    (effect,) = tomllib.loads(made.text)["effect"]
    assert effect["density"] == pytest.approx([4e-6 if OWN_WALK in text else 5e-6] * 3)
    assert ("random_walk = 3e-6" in made.text) == (OWN_WALK in text)


def test_a_superfluous_walk_of_the_phone_s_own_is_taken_out_on_its_axes() -> None:
    walk = finding("gyro_bias_random_walk", "gyro", {"density": ([0.0] * 3, [3e-6] * 3)}, "superfluous", "xz")
    made = fixed("phone", OWN_WALK, {**walk, "parameters": {}})
    assert tomllib.loads(made.text)["gyro"]["noise"]["random_walk"] == [0.0, 3e-6, 0.0]


def test_a_density_of_a_walk_is_no_white_noise_beside_slow_noise() -> None:
    walk = finding("gyro_bias_random_walk", "gyro", {"density": ([5e-6] * 3, [2e-6] * 3)})
    made = fixed_for("kalibr", "gyroscope_random_walk: 1.0e-6\n", {"findings": [SLOW, walk]})
    assert made.not_held == ["gyro_slow_noise: how much of its Allan deviation is white noise is not known"]


def test_imusensor_s_bias_instability_is_slow_noise_that_is_left() -> None:
    text = "a = imuSensor();\na.Gyroscope.BiasInstability = 1e-5;\n"
    made = fixed("imusensor", text, SLOW)
    assert not made.changed and "BiasInstability" in made.not_held[0]


def test_gnss_ins_sim_changes_the_numbers_of_its_dictionary_only() -> None:
    text = (
        "import numpy as np\nD = 3  # mine\nimu_err = {'gyro_b': np.array([0.0, 0.0, 0.0]),  # bias\n"
        "  'gyro_arw': np.array([0.25, 0.25, 0.25]) * 1.0, 'accel_b': [0, 0, 0],\n"
        "  'accel_vrw': np.array([0.03]*3), 'gyro_b_stability': np.array([3.5, 3.5, 3.5]),\n"
        "  'gyro_b_corr': [100.0, 100.0, 100.0]}\n"
    )
    made = fixed("gnss-ins-sim", text, BIAS, WHITE, SLOW)
    names: dict[str, Any] = {}
    exec(made.text, names)
    np.testing.assert_allclose(np.deg2rad(names["imu_err"]["gyro_b"]) / 3600.0, [0.02, 0.0, 0.02], atol=1e-12)
    # The Allan variance at one correlation time of a Gauss-Markov process is e^-1 (4 - e^-1) - 1 = 0.336.
    spread = np.deg2rad(names["imu_err"]["gyro_b_stability"]) / 3600.0
    np.testing.assert_allclose(spread * np.sqrt(np.exp(-1.0) * (4.0 - np.exp(-1.0)) - 1.0), SLOW_ALONE)
    assert "# mine" in made.text and "# bias" in made.text
    assert made.not_held == [
        "noise_level (accelerometer): accel_vrw is [0.03] * 3, which is not made of plain numbers"
    ]


def test_imusensor_changes_its_properties_in_its_own_units() -> None:
    text = (
        "% mine\nimu = imuSensor('accel-gyro', 'SampleRate', 100);\n"
        "imu.Gyroscope.ConstantBias = 0.001; % all\n"
        "imu.Accelerometer.NoiseDensity = [2e-3 2e-3 2e-3];\nx = 1;\n"
    )
    made = fixed("imusensor", text, *ALL)
    assert "imu.Gyroscope.ConstantBias = [0.019 0.001 0.022]; % all\n" in made.text
    assert "imu.Gyroscope.TemperatureBias = [0.0002 0.0 -0.0001];\n" in made.text
    assert "imu.Accelerometer.NoiseDensity = [0.004 0.002 0.003];\n" in made.text
    assert "'SampleRate', 200.0)" in made.text and made.text.endswith("x = 1;\n")


@pytest.mark.parametrize("end_of_row", ["; ", "\n  "])
def test_imusensor_s_matrix_is_read_again_after_it_was_written(end_of_row: str) -> None:
    """Its rows end with the character that ends the assignment: it was read up to there, and refused."""
    once = fixed("imusensor", None, SCALE)
    twice = fixed("imusensor", once.text.replace("; ", end_of_row), SCALE)
    assert not twice.not_held
    [line] = [line for line in twice.text.splitlines() if "AxesMisalignment" in line]
    assert twice.text.count("\n") == once.text.count("\n")
    rows = [row.split() for row in line.partition("[")[2].partition("]")[0].split(";")]
    gain = np.diag([1.0 / 0.98, 1.0, 1.0 / 1.01])
    np.testing.assert_allclose(np.array(rows, float), 100.0 * gain**2, rtol=1e-9)


@pytest.mark.parametrize("tool", FIXERS)
def test_nothing_found_changes_nothing_and_a_new_file_can_be_read_back(tool: str) -> None:
    fresh = fixed(tool, None, *ALL)
    assert fresh.changed
    again = fixed(tool, fresh.text)
    assert not again.changed and not again.not_held
    assert tool == "airsim" or again.text == fresh.text


@pytest.mark.parametrize("tool", FIXERS)
def test_noise_of_one_axis_is_put_where_noise_is(tool: str) -> None:
    odd = finding("noise_unequal_axes", "accel", {"density": ([4e-3] * 3, [2e-3] * 3)}, axes="x")
    made = [fixed(tool, None, RATE, one) for one in (odd, {**odd, "effect": "noise_level"})]
    assert made[0].text == made[1].text != fixed(tool, None, RATE).text


@pytest.mark.parametrize("tool", [t for t in FIXERS if t != "kalibr"])
@pytest.mark.parametrize("text", ["", "<a>", "[1]", "a = {", "<sdf/>", "\x00"])
def test_what_is_not_the_tool_s_is_refused(tool: str, text: str) -> None:
    if (tool, text) == ("phone", ""):
        return  # an empty phone file is an ideal phone
    with pytest.raises(UserError):
        fixed(tool, text, BIAS)


SILENT = finding("noise_level", "accel", {"density": ([2e-3] * 3, [1e-12] * 3)}, "lacking")


@pytest.mark.parametrize(
    ("tool", "text", "wanted"),
    [
        ("phone", "[accel.noise]\nwhite = 1e-9\n", "white = [0.002, 0.002, 0.002]"),
        ("gazebo", SDF, f"<stddev>{2e-3 * np.sqrt(50.0):.10g}</stddev></noise></x>"),
        ("airsim", "{}", f'"VelocityRandomWalk": {2e-3 / np.sqrt(2.0) / 9.80665e-3:.10g}'),
        ("gnss-ins-sim", None, f"'accel_vrw': np.array([{2e-3 / np.sqrt(2.0) * 60.0:.10g}"),
        ("imusensor", None, "imu.Accelerometer.NoiseDensity = [0.002 0.002 0.002];"),
        ("kalibr", "accelerometer_noise_density: 1e-9\n", f"{2e-3 / np.sqrt(2.0):.10g}\n"),
    ],
)
def test_a_simulation_without_noise_gets_the_recordings_own(tool: str, text: str | None, wanted: str) -> None:
    """There is nothing to multiply, and each tool states a density in its own way."""
    assert wanted in fixed(tool, text, SILENT).text


SUPERFLUOUS = finding(
    "gyro_bias", "gyro", {"bias": ([1e-5, 0.0, 0.0], [0.0101, 0.0, 0.0])}, "superfluous", "x"
)


@pytest.mark.parametrize(
    ("tool", "text", "wanted"),
    [
        ("phone", "[gyro]\nbias = [0.01, 0.5, 0.0]\n", "bias = [0.0, 0.5, 0.0]"),
        ("imusensor", "a = imuSensor();\na.Gyroscope.ConstantBias = [0.01 0.5 0];\n", "= [0.0 0.5 0.0];"),
        (
            "gnss-ins-sim",
            "e = {'gyro_b': [2000.0, 5, 0], 'accel_b': 0}",
            "'gyro_b': np.array([0.0, 5.0, 0.0])",
        ),
    ],
)
def test_what_is_superfluous_is_taken_out_to_the_last_bit(tool: str, text: str, wanted: str) -> None:
    assert wanted in fixed(tool, text, SUPERFLUOUS).text


@pytest.mark.parametrize("tool", ["phone", "gazebo", "imusensor", "gnss-ins-sim"])
def test_what_is_not_in_the_configuration_cannot_be_taken_out_of_it(tool: str) -> None:
    made = fixed(tool, None, SUPERFLUOUS)
    assert not made.changed
    assert "from elsewhere" in made.not_held[0]


def test_a_superfluous_slope_leaves_the_bias_at_the_findings_temperature_as_it_was() -> None:
    text = (
        "[heat]\nreference_c = 25.0\n[gyro]\nbias = [0.01, 0.0, 0.0]\n"
        '[[effect]]\nname = "gyro_bias_temperature"\nslope = [0.0002, 0.0, 0.0]\n'
    )
    slope = finding(
        "gyro_bias_temperature", "gyro", {"slope": ([0.0] * 3, [0.00021, 0, 0])}, "superfluous", "x"
    )
    made = fixed("phone", text, {**slope, "reference": {"temperature_c": 35.0}})
    phone = msgspec.convert(tomllib.loads(made.text), type=Phone)
    assert phone.effects == () and phone.gyro is not None
    assert phone.gyro.bias[0] == pytest.approx(0.01 + 10.0 * 0.0002)


def test_imusensor_s_accelerometer_has_the_other_sign_in_its_slope_and_what_follows_from_it() -> None:
    slope = finding(
        "accel_bias_temperature", "accel", {"slope": ([0.01, 0.0, 0.0], [0.0, 0.0, 0.0])}, "lacking"
    )
    made = fixed("imusensor", None, {**slope, "reference": {"temperature_c": 35.0}})
    assert "imu.Accelerometer.TemperatureBias = [-0.01 " in made.text
    assert "imu.Accelerometer.ConstantBias = [0.1 " in made.text


@pytest.mark.parametrize(
    ("effect", "sensor", "table", "field", "parameter"),
    [
        ("timestamp_jitter", "timing", "clock", "jitter_s", "sigma"),
        ("dropped_samples", "timing", "clock", "drop_fraction", "fraction"),
        ("accel_gyro_time_offset", "timing", "clock", "gyro_delay_s", "delay"),
        ("clock_skew", "timing", "clock", "skew", "relative"),
        ("bandwidth", "gyro", "gyro", "cutoff_hz", "cutoff"),
    ],
)
def test_what_a_phone_has_as_a_setting_is_changed_there(
    effect: str, sensor: str, table: str, field: str, parameter: str
) -> None:
    """Beside it, an effect of that name would add to it, and it could not be taken out."""
    text = f"[{table}]\n{field} = 0.01\n"
    for relation, after in (("too_small", 0.02), ("superfluous", None if field == "cutoff_hz" else 0.0)):
        change = finding(effect, sensor, {parameter: (0.02, 0.01)}, relation, axes="")
        done = fixed("phone", text, change)
        phone = msgspec.convert(tomllib.loads(done.text), type=Phone)
        assert getattr(getattr(phone, table), field) == after
        assert not phone.effects and done.changed[0].startswith(f"{table}.{field}: 0.01")
    done = fixed("phone", None, finding(effect, sensor, {parameter: (0.02, 0.0)}, "lacking", axes=""))
    assert [e.name for e in msgspec.convert(tomllib.loads(done.text), type=Phone).effects] == [effect]
