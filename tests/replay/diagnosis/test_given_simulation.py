"""A given simulation is judged: what it lacks, has half of, has, has twice of, and has alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.model.records import Alternative
from stillcal.calib_core.diagnosis.slow.findings import slow_statements
from stillcal.calib_core.errors import NotSupported, UserError
from stillcal.calib_core.gravity import STANDARD
from stillcal.daemon.cli.main import cli
from stillcal.replay.diagnosis.given_simulation import answered, judge_examined, judge_simulation
from stillcal.replay.diagnosis.judged import Judged, examined
from stillcal.replay.diagnosis.report.page import page
from stillcal.replay.formats.trace import Recording
from stillcal.replay.formats.writer import TraceWriter
from stillcal.replay.phone.phone import Phone
from tests.support import report_days
from tests.support.report_days import PART_S, TONE, phone_with

SLOPE = np.array([0.006, 0.0, -0.005])

SHORT_S, BRIEF_S = 200.0, 90.0
"""s, of the four parts of most recordings here, and of those that are only passed through a command or whose
noise is clear at once. What takes longer to show has the length of the report's days."""


def named(recording: Recording, name: str) -> Recording:
    """Name a recording, and leave its gyroscope out: most of what is tested here is the accelerometer's."""
    return replace(recording, name=name, gyroscope=None)


def thermal(share: float) -> dict[str, Any]:
    return {"name": "accel_bias_temperature", "slope": (share * SLOPE).tolist()}


def changed(phone: Phone, sensor: str, **values: Any) -> Phone:
    settings = msgspec.structs.replace(getattr(phone, sensor), **values)
    return msgspec.structs.replace(phone, **{sensor: settings})


recorded = partial(report_days.recorded, part_s=SHORT_S)


@cache
def real(share: float = 1.0, part_s: float = SHORT_S) -> Recording:
    effects = [thermal(share)] if share else []
    return named(recorded(phone_with(*effects), 3, part_s=part_s), "real.csv")


@cache
def simulated(share: float, part_s: float = SHORT_S) -> Recording:
    effects = [thermal(share)] if share else []
    return named(recorded(phone_with(*effects), 8, part_s=part_s), "sim.csv")


examination = cache(examined)


@cache
def judged(recording: Recording, simulation: Recording) -> Judged:
    """Judge as `judge_simulation` does, each recording examined once for all tests."""
    return judge_examined(recording, examination(recording), simulation, examination(simulation))


def answer(recording: Recording, simulation: Recording) -> dict[str, Any]:
    return judged(recording, simulation).answer


def compared(recording: Recording, simulation: Recording) -> dict[str, Any]:
    """Return the answer before the differences are put into the simulation, which would be examined again."""
    names, exams = (recording.name, simulation.name), (examination(recording), examination(simulation))
    return answered(compare(*exams, names), None, *exams, names)


def effects(said: Mapping[str, Any]) -> set[str]:
    return {f["effect"] for f in said["findings"]}


def only(said: Mapping[str, Any]) -> dict[str, Any]:
    (finding,) = said["findings"]
    return finding


def holds(parameter: Mapping[str, Any], truth: np.ndarray) -> bool:
    """Whether truth lies within one and a half times each 95 % interval (1 miss in 300 by chance)."""
    low, high = np.asarray(parameter["ci95"]).T
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    return bool((np.abs(truth - middle) < 1.5 * half).all())


@pytest.mark.slow
@pytest.mark.parametrize(("share", "relation"), [(0.5, "too_small"), (1.5, "too_large")])
def test_a_share_of_an_effect_is_told_with_what_is_missing(share: float, relation: str) -> None:
    finding = only(compared(real(), simulated(share)))
    assert (finding["effect"], finding["relation"]) == ("accel_bias_temperature", relation)
    assert holds(finding["difference"]["slope"], (1.0 - share) * SLOPE)
    assert holds(finding["parameters"]["slope"], SLOPE)
    assert holds(finding["simulated"]["slope"], share * SLOPE)
    assert 0.95 < finding["probability"] < 0.98 and "sim.csv" in finding["statement"]


@pytest.mark.parametrize(
    ("of_recording", "foretold", "indistinguishable"),
    [
        pytest.param(False, 1.0, True, marks=pytest.mark.slow),
        pytest.param(True, 1.0, True, marks=pytest.mark.slow),
        (True, 1e6, False),
    ],
)
def test_what_may_be_the_effect_that_the_other_one_names_is_compared_as_that(
    of_recording: bool, foretold: float, indistinguishable: bool
) -> None:
    """A curve without a name beside it left its size unknown in SIM, which had it and was told it has not."""
    exams = [examination(real()), examination(simulated(1.5))]
    own = exams[not of_recording]
    (residuals,) = own.sensors
    (nameless,) = slow_statements(residuals, without=["accel_bias_temperature"])
    may_be = (Alternative("accel_bias_temperature", foretold, indistinguishable),)
    finding = replace(nameless.finding, effect="unknown", alternatives=may_be)
    exams[not of_recording] = replace(own, statements=[replace(nameless, finding=finding)])
    (found,) = compare(*exams, ("real.csv", "sim.csv")).discrepancies
    assert (found.effect, found.relation) == ("accel_bias_temperature", "too_large")


@pytest.mark.slow
def test_what_only_the_simulation_has_is_superfluous() -> None:
    finding = only(compared(real(0.0), simulated(1.0)))
    assert (finding["effect"], finding["relation"]) == ("accel_bias_temperature", "superfluous")
    assert holds(finding["difference"]["slope"], -SLOPE)


@pytest.mark.slow
def test_a_simulation_that_has_the_effect_agrees() -> None:
    said = answer(real(), simulated(1.0))
    assert said["verdict"] == "match" and said["findings"] == []
    assert "accel_bias_temperature" in {a["effect"] for a in said["agreed"]}
    assert said["fit"]["p_before"] > 0.01


@pytest.mark.slow
def test_a_bias_that_differs_for_another_reason_is_stated_at_the_recordings_mean_temperature() -> None:
    """It was stated where the lines of both come nearest to each other, 17 K colder than any reading."""
    bias = (SLOPE * 12.0 + np.array([0.0, 0.05, 0.0])).tolist()
    real = named(recorded(changed(phone_with(thermal(1.0)), "accel", bias=bias), 3), "real.csv")
    said = compared(real, simulated(0.0))
    found = {f["effect"]: f for f in said["findings"]}
    assert set(found) == {"accel_bias", "accel_bias_temperature"}
    bins = examination(real).bins
    assert bins.temperature is not None
    for one in found.values():
        assert one["reference"]["temperature_c"] == pytest.approx(bins.temperature.mean())
    mean = found["accel_bias_temperature"]["reference"]["mean_temperature_c"]
    assert mean == pytest.approx(bins.temperature.mean())


@pytest.mark.slow
def test_a_step_that_the_recording_alone_has_makes_no_bias_besides() -> None:
    """The levels before and after it were averaged, and the mean was another bias than the simulation has."""
    steady, simulation = real(0.0), simulated(0.0)
    still = steady.accelerometer
    force = np.array(still.xyz)
    force[still.t > 500.0, 2] += 334 * STANDARD / 8192.0  # 0.4 m/s^2, in whole steps of the values
    finding = only(compared(replace(steady, accelerometer=replace(still, xyz=frozen(force))), simulation))
    assert (finding["effect"], finding["relation"]) == ("accel_bias_step", "lacking")


@pytest.mark.slow
def test_a_simulation_at_one_temperature_is_compared_at_that_one() -> None:
    """It was compared at the recording's mean, where it never was: its bias was falsely another one."""
    still = phone_with(thermal(1.0))
    kept = msgspec.structs.replace(still, heat=msgspec.structs.replace(still.heat, charge_k=0.0, use_k=0.0))
    at_one = named(recorded(kept, 8), "sim.csv")
    bins = examination(at_one).bins
    assert bins.temperature is not None and np.ptp(bins.temperature) < 0.3
    said = answer(real(), at_one)
    assert (said["verdict"], said["findings"]) == ("match", [])
    assert "accel_bias" in {a["effect"] for a in said["agreed"]}


@pytest.mark.slow
def test_a_time_constant_that_the_simulation_has_not_is_the_recordings_with_its_interval() -> None:
    """The amplitude was that at a coarse grid point, and nothing told the time constant."""
    settling = {"name": "accel_warmup", "amplitude": [0.05, -0.03, 0.0], "tau_s": 170.0}
    real = named(report_days.recorded(phone_with(settling), 3), "real.csv")
    finding = only(compared(real, simulated(0.0, PART_S)))
    assert (finding["effect"], finding["relation"]) == ("accel_warmup", "lacking")
    assert finding["reference"]["tau_s"] == pytest.approx(finding["parameters"]["tau_s"]["value"], rel=0.1)
    low, high = finding["parameters"]["tau_s"]["ci95"]
    assert low < 170.0 < high and "time constant" in finding["statement"]
    assert holds(finding["difference"]["amplitude"], np.array(settling["amplitude"]))


@pytest.mark.slow
def test_a_bias_that_settles_to_that_of_the_simulation_is_one_finding() -> None:
    """Counted from the start, its amplitude was told a second time, as a constant bias."""
    amplitude = np.array([0.05, -0.03, 0.0])
    settling = {"name": "accel_warmup", "amplitude": amplitude.tolist(), "tau_s": 170.0}
    phone, plain = phone_with(settling), np.asarray(phone_with().accel.bias)
    high = changed(phone, "accel", bias=tuple((plain - amplitude).tolist()))
    real = named(report_days.recorded(high, 3), "real.csv")
    said = answer(real, simulated(0.0, PART_S))
    finding = only(said)
    assert (finding["effect"], finding["relation"]) == ("accel_warmup", "lacking")
    assert finding["reference"]["settled"] == 1.0 and "bias(settled) - amplitude" in finding["equation"]
    assert holds(finding["difference"]["amplitude"], amplitude)
    assert said["verdict"] == "identified" and said["fit"]["p_after"] > 0.5


@pytest.mark.slow
def test_a_gyroscopes_scale_that_follows_temperature_is_one_finding() -> None:
    """Its constant part was told as a second one, at a temperature that nobody named."""
    warm = {"name": "gyro_scale_temperature", "slope": [2e-3, 0.0, 0.0]}
    said = compared(recorded(phone_with(warm), 3), recorded(phone_with(), 8))
    assert effects(said) == {"gyro_scale_temperature"}


@pytest.mark.slow
def test_flicker_beyond_what_a_phone_may_have_is_slow_noise_and_nothing_besides() -> None:
    """What has no name was told too, of the same wander."""
    noise = msgspec.structs.replace(phone_with().accel.noise, flicker=0.008)
    real = named(recorded(changed(phone_with(), "accel", noise=noise), 3), "real.csv")
    assert "nothing that was recorded" in {s.finding.where.driver for s in examination(real).statements}
    finding = only(compared(real, simulated(0.0)))
    assert (finding["effect"], finding["relation"]) == ("accel_slow_noise", "too_small")


def coarse(recording: Recording, step: float = 0.012) -> Recording:
    """Round the values to steps of more than two standard deviations of their noise."""
    xyz = frozen(np.rint(recording.accelerometer.xyz / step) * step)
    return replace(recording, accelerometer=replace(recording.accelerometer, xyz=xyz))


@pytest.mark.slow
def test_the_corrected_simulation_passes_though_its_values_came_in_steps() -> None:
    """What is added lies between the steps: the noise of rounding must not count as the sensor's then."""
    said = answer(coarse(real()), coarse(simulated(0.0)))
    assert said["verdict"] == "identified"
    assert said["fit"]["p_before"] < 1e-6 and said["fit"]["p_after"] > 0.01
    assert said["fit"]["not_put_in"] == []


@pytest.mark.slow
def test_a_line_that_the_simulation_lacks_is_put_into_it() -> None:
    said = answer(named(recorded(phone_with(TONE), 3), "real.csv"), simulated(0.0))
    assert [(f["effect"], f["relation"]) for f in said["findings"]] == [("vibration_tone", "lacking")]
    assert said["verdict"] == "identified" and said["fit"]["not_put_in"] == []
    assert said["fit"]["p_before"] < 1e-6 and said["fit"]["p_after"] > 0.01


@pytest.mark.slow
def test_a_line_that_only_the_simulation_has_is_superfluous() -> None:
    said = compared(real(0.0), named(recorded(phone_with(TONE), 5), "sim.csv"))
    assert [(f["effect"], f["relation"]) for f in said["findings"]] == [("vibration_tone", "superfluous")]


@pytest.mark.slow
def test_constants_and_noise_that_differ_are_told_in_their_own_units() -> None:
    phone = phone_with()
    bias = (np.asarray(phone.accel.bias) + np.array([0.1, 0.0, 0.0])).tolist()
    noise = msgspec.structs.replace(phone.accel.noise, white=2.0 * 0.00147)
    other = named(recorded(changed(phone, "accel", bias=bias, noise=noise), 8), "sim.csv")
    found = {f["effect"]: f for f in compared(real(0.0), other)["findings"]}
    assert set(found) == {"accel_bias", "noise_level"}
    assert found["accel_bias"]["axes"] == ["x"] and found["accel_bias"]["relation"] == "too_large"
    assert holds(found["accel_bias"]["difference"]["bias"], np.array([-0.1, 0.0, 0.0]))
    assert found["noise_level"]["relation"] == "too_large"
    assert found["noise_level"]["difference"]["ratio"]["value"] == pytest.approx([0.5] * 3, rel=0.05)


@cache
def odd(ratio: float, seed: int, name: str) -> Recording:
    """A recording of a phone whose y axis has `ratio` times the others' noise."""
    phone = phone_with()
    noise = msgspec.structs.replace(phone.accel.noise, white=(0.00147, 0.00147 * ratio, 0.00147))
    return named(recorded(changed(phone, "accel", noise=noise), seed), name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratios", "relation"),
    [
        ((2.0, 1.0), "lacking"),
        ((2.0, 1.4), "too_small"),
        ((1.4, 2.0), "too_large"),
        ((1.0, 2.0), "superfluous"),
        ((0.5, 0.75), "too_small"),
    ],
)
def test_one_axis_that_is_noisier_is_told_as_such(ratios: tuple[float, float], relation: str) -> None:
    said = compared(odd(ratios[0], 3, "real.csv"), odd(ratios[1], 8, "sim.csv"))
    finding = only(said)
    assert (finding["effect"], finding["relation"]) == ("noise_unequal_axes", relation)
    assert finding["axes"] == ["y"] and said["fit"]["p_before"] < 1e-6
    for side, ratio in zip(("parameters", "simulated"), ratios, strict=True):
        assert finding[side]["ratio"]["value"] == pytest.approx([1.0, ratio, 1.0], rel=0.1)
    assert finding["difference"]["ratio"]["value"][1] == pytest.approx(ratios[0] - ratios[1], abs=0.15)


@pytest.mark.slow
def test_an_axis_that_is_as_noisy_in_both_agrees() -> None:
    said = answer(odd(2.0, 3, "real.csv"), odd(2.0, 8, "sim.csv"))
    assert {"noise_level", "noise_unequal_axes"} <= {a["effect"] for a in said["agreed"]}
    assert said["findings"] == []


@pytest.mark.slow
def test_another_rate_is_one_finding_and_nothing_else() -> None:
    phone = phone_with()
    fast = changed(changed(phone, "accel", rate_hz=50.0), "gyro", rate_hz=50.0)
    said = answer(real(0.0), named(recorded(fast, 8, fast), "sim.csv"))
    finding = only(said)
    assert said["fit"]["not_put_in"] == ["sample_rate"]
    assert min(said["fit"]["p_before"], said["fit"]["p_after"]) > 0.01, "neither counts what cannot be put in"
    assert (finding["effect"], finding["relation"]) == ("sample_rate", "too_large")
    assert finding["difference"]["rate"]["value"] == pytest.approx(-25.0, abs=0.01)


@pytest.mark.slow
def test_a_simulation_without_noise_lacks_it() -> None:
    phone = phone_with()
    quiet = type(phone.accel.noise)()
    silent = changed(changed(phone, "accel", noise=quiet, lsb=0.0), "gyro", noise=quiet, lsb=0.0)
    made = (recorded(one, seed, part_s=BRIEF_S) for one, seed in ((phone, 3), (silent, 8)))
    found = compared(*made)["findings"]
    lacking = {(f["effect"], f["sensor"]): f for f in found if f["relation"] == "lacking"}
    assert {("noise_level", "accel"), ("noise_level", "gyro")} <= lacking.keys()
    level = lacking["noise_level", "gyro"]
    assert level["simulated"]["density"]["value"] == [0.0] * 3 and "ratio" not in level["difference"]


def blind(recording: Recording) -> Recording:
    return replace(recording, accelerometer=replace(recording.accelerometer, temperature=None))


@pytest.mark.slow
def test_a_steady_simulation_without_a_thermometer_lacks_what_follows_temperature() -> None:
    said = answer(real(1.0, PART_S), blind(simulated(0.0, PART_S)))
    finding = only(said)
    assert (finding["effect"], finding["relation"]) == ("accel_bias_temperature", "lacking")
    assert (
        holds(finding["difference"]["slope"], SLOPE)
        and "temperature of sim.csv is not known" in finding["statement"]
    )
    assert said["verdict"] == "identified" and said["fit"]["not_put_in"] == []
    assert finding["assumption"] in finding["statement"]


@pytest.mark.slow
def test_what_cannot_be_compared_is_said_with_its_reason() -> None:
    said = compared(replace(recorded(phone_with(thermal(1.0)), 3), name="real.csv"), blind(simulated(1.0)))
    reasons = {(n["effect"], n["sensor"]): n["reason"] for n in said["not_compared"]}
    assert reasons["gyro_bias", "gyro"] == "sim.csv: no gyroscope"
    assert reasons["accel_bias_temperature", "accel"] == "sim.csv: no temperature"
    assert effects(said) == set(), "what follows a temperature that was not logged is no difference"


@pytest.mark.slow
def test_a_simulation_that_never_lies_still_is_not_judged() -> None:
    whole = simulated(0.0)
    rng = np.random.default_rng(1)
    shaken = replace(
        whole.accelerometer, xyz=whole.accelerometer.xyz + rng.normal(0.0, 3.0, whole.accelerometer.xyz.shape)
    )
    said = answer(real(0.0), replace(whole, accelerometer=shaken, gyroscope=None))
    assert said["verdict"] == "not_judged"


@pytest.mark.slow
def test_every_quantity_says_how_small_a_difference_it_would_have_shown() -> None:
    rows = answer(real(0.0), simulated(0.0))["sensitivity"]
    least = {(r["effect"], r["parameter"]): r["smallest_seen_90"] for r in rows}
    assert 0.0 < least["accel_bias", "bias"] < 0.05
    assert 0.0 < least["noise_level", "density"] < 0.0015


def test_too_short_a_simulation_is_refused_by_name() -> None:
    short = simulated(0.0)
    cut = replace(short, accelerometer=short.accelerometer.between(0.0, 5.0), gyroscope=None)
    stages: list[str] = []
    with pytest.raises(NotSupported, match=r"sim\.csv"):
        judge_simulation(real(0.0), cut, lambda stage, _done: stages.append(stage))
    assert stages == [], "before the recording is examined, which takes long"


def test_the_command_blames_the_recording_that_is_too_short(tmp_path: Path) -> None:
    long, short = tmp_path / "real.csv", tmp_path / "sim.csv"
    for path, count in ((long, 4000), (short, 60)):
        rows = [f"{0.02 * i:.2f},0.0,0.0,{9.8 + 0.001 * (i % 7)}" for i in range(count)]
        path.write_text("\n".join(["t,ax,ay,az", *rows]) + "\n")
    done = run(long, "--simulated", short)
    assert done.exit_code == 3
    assert done.output.startswith("stillcal: too little data: sim.csv: ") and "real.csv" not in done.output
    alone = run(short)
    assert (alone.exit_code, alone.output) == (3, done.output), "the file is named once"


@pytest.mark.slow
def test_what_is_compared_is_stated_agreed_or_undecided() -> None:
    phone = phone_with()
    for x in (0.004, 0.008, 0.012):  # m/s^2: one of them lies between agreement and a difference
        bias = (np.asarray(phone.accel.bias) + np.array([x, 0.0, 0.0])).tolist()
        said = compared(real(0.0), named(recorded(changed(phone, "accel", bias=bias), 8), "sim.csv"))
        told = {(r["effect"], r["sensor"]) for k in ("findings", "agreed", "not_compared") for r in said[k]}
        assert {("accel_bias", "accel"), ("accel_scale", "accel"), ("noise_level", "accel")} <= told


@pytest.mark.slow
def test_the_page_shows_both_files_and_every_finding() -> None:
    pytest.importorskip("matplotlib")
    drawn = page(judged(real(), simulated(0.5)))
    assert "real.csv against sim.csv" in drawn and "Differences found, all identified" in drawn
    assert (
        "is too small in sim.csv" in drawn
        and "that it differs from that of sim.csv" in drawn
        and drawn.count("<svg") + drawn.count("svg+xml") >= 1
    )
    assert "25 Hz" in drawn and "http" not in drawn.replace("http://www.w3.org", "")


@pytest.fixture
def written(tmp_path: Path) -> Callable[[Recording, str], Path]:
    def write(recording: Recording, name: str) -> Path:
        path = tmp_path / name
        with TraceWriter(path, temperature=True, arrival=True, claims=recording.claims) as writer:
            writer.write(recording.accelerometer, recording.gyroscope, tuple(recording.events))
        return path

    return write


def run(*words: Any) -> Any:
    return CliRunner().invoke(cli, ["diagnose", *map(str, words)])


def test_the_command_judges_and_fails_where_it_is_asked_to(written: Any, tmp_path: Path) -> None:
    trace, other = written(real(), "real.csv"), written(simulated(0.0), "sim.csv")
    out = tmp_path / "answer.json"
    done = run(trace, "--simulated", other, "--json", out, "--fail-on", "identified")
    assert done.exit_code == 5, done.output
    assert "sim.csv lacks the change of the accelerometer's bias with temperature" in done.output
    said = json.loads(out.read_text())
    assert (said["schema"], said["recording"], said["simulation"]) == (2, "real.csv", "sim.csv")
    told = compared(real(), simulated(0.0))["findings"]
    assert [f["statement"] for f in said["findings"]] == [f["statement"] for f in told]


def test_a_recording_given_as_its_own_simulation_is_said_so(written: Any) -> None:
    trace = written(real(0.0, BRIEF_S), "real.csv")
    done = run(trace, "--simulated", trace)
    assert done.exit_code == 0
    assert "real.csv holds the very samples of real.csv: it is compared with itself" in done.stderr


def test_the_remedy_for_a_simulation_names_its_own_option(written: Any, tmp_path: Path) -> None:
    (tmp_path / "sim.csv").write_text("hello\nworld\n")
    done = run(written(real(0.0), "real.csv"), "--simulated", tmp_path / "sim.csv")
    assert "column map given as --simulated-format" in str(done.exception)


def test_only_a_part_of_the_simulation_is_judged_where_it_is_asked_for(written: Any) -> None:
    """Too short a part is refused with what is missing, which the whole is not."""
    trace, other = written(real(0.0), "real.csv"), written(simulated(0.0), "sim.csv")
    done = run(trace, "--simulated", other, "--simulated-from", 60, "--simulated-to", 65)
    assert done.exit_code == 3
    assert "sim.csv" in done.output and "too little data" in done.output


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--simulated", "nowhere.csv"], "nowhere.csv"),
        (["--simulated-sensor", "1"], "-sensor, -gyro, -from and -to go with --simulated"),
        (
            ["--simulated", "sim.csv", "--simulated-from", "5", "--simulated-to", "5"],
            "--simulated-to 5 is not",
        ),
        (["--paired"], "--paired goes with --simulated"),
        (["--witness", "x.csv", "--phone", "typical"], "leave out --simulated and --phone"),
        (["--witness", "x.csv", "--phone-out", "p.toml"], "--witness does not go with --phone-out"),
        (["--witness", "x", "--witness", "y", "--witness-sensor", "1"], "give one sensor for each witness"),
        (["--simulated", "sim.csv", "--phone", "typical"], "--simulated and --phone exclude each other"),
        (
            ["--simulated", "sim.csv", "--phone-out", "p.toml"],
            "--simulated and --phone-out exclude each other",
        ),
        (["--fail-on", "bad"], "bad"),
    ],
)
def test_bad_input_is_one_line(words: list[str], says: str, written: Any, tmp_path: Path) -> None:
    trace = written(real(0.0), "real.csv")
    done = run(trace, *words)
    assert done.exit_code == 2 or isinstance(done.exception, UserError)  # `main` makes one line of it
    assert says in f"{done.output}{done.exception}" and "Traceback" not in done.output
    assert sorted(p.suffix for p in tmp_path.iterdir()) == sorted(p.suffix for p in trace.parent.iterdir())
