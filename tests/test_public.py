"""The public interface: `from stillcal import load, calibrate, apply, diagnose, simulate`."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import stillcal
from stillcal.calib_core.arrays import frozen
from stillcal.daemon.cli.main import cli

SAMPLE = "sample:lab"
SAMPLES = Path(str(files("stillcal.config"))) / "samples"


@pytest.fixture(scope="module")
def sample() -> stillcal.Recording:
    return stillcal.load(SAMPLE)


@pytest.fixture(scope="module")
def calibration(sample: stillcal.Recording) -> stillcal.Calibration:
    return stillcal.calibrate(sample)


@pytest.fixture(scope="module")
def diagnosis(sample: stillcal.Recording) -> stillcal.Diagnosis:
    return stillcal.diagnose(sample)


@pytest.fixture(scope="module")
def truth() -> dict[str, Any]:
    return json.loads((SAMPLES / "lab.truth.json").read_text())


def columns(recording: stillcal.Recording) -> dict[str, Any]:
    """Return a recording of shared time stamps as the columns of a table."""
    accel, gyro = recording.accelerometer, recording.gyroscope
    table = {"t": accel.t, "temperature": accel.temperature, "t_arrival": accel.t_arrival}
    table |= dict(zip(("ax", "ay", "az"), accel.xyz.T, strict=True))
    return table | dict(zip(("gx", "gy", "gz"), gyro.xyz.T, strict=True))


def forces(recording: stillcal.Recording) -> stillcal.Recording:
    """Return what its accelerometer recorded: what is judged so takes a fifth of the time."""
    return stillcal.load({name: own for name, own in columns(recording).items() if name[0] != "g"})


def loaded_by(statement: str) -> set[str]:
    """Return the top-level packages that a fresh interpreter has after a statement."""
    return set(printed_by(f"{statement}\nimport sys\nprint(*{{n.split('.')[0] for n in sys.modules}})"))


def printed_by(code: str) -> list[str]:
    """Run code in a fresh interpreter; return the words that it printed."""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return ran.stdout.split()


def test_importing_stillcal_alone_is_light() -> None:
    """The daemon imports the package too, and must not hold what only Python's users need."""
    assert not loaded_by("import stillcal") & {"numpy", "scipy", "msgspec", "click", "rich"}
    assert "numpy" in loaded_by("import stillcal; stillcal.load")  # the same measure sees it where it is


def test_the_daemon_imports_no_more_than_it_needs() -> None:
    """It runs for months: no scipy, nothing of the public interface, of replay or of the diagnosis."""
    names = printed_by("import sys, stillcal.daemon.app\nprint(*sys.modules)")
    ours = [name for name in names if name.startswith("stillcal.")]
    above = ("stillcal.api", "stillcal.replay", "stillcal.calib_core.diagnosis")
    assert [name for name in ours if name.startswith(above)] == []
    others = {name.split(".")[0] for name in names} - set(sys.stdlib_module_names)
    others = {name for name in others if not name.startswith(("_", "__editable__"))}
    assert others <= {"stillcal", "numpy", "serial", "msgspec", "click", "asyncvarlink", "typing_extensions"}


def test_names_are_listed_and_others_refused() -> None:
    assert {"load", "calibrate", "apply", "diagnose", "simulate", "__version__"} <= set(dir(stillcal))
    assert stillcal.__version__.split(".")[0].isdigit()
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        stillcal.calibrat  # type: ignore[attr-defined]  # noqa: B018 - the access is the test


def test_the_sample_is_what_its_files_say(sample: stillcal.Recording, tmp_path: Path) -> None:
    """The rounding of a value may differ by one step between machines."""
    out = tmp_path / "lab.csv.gz"
    words = ["simulate", SAMPLES / "lab.scenario.toml", "--phone", SAMPLES / "lab.phone.toml", "--seed", "1"]
    CliRunner().invoke(cli, [str(w) for w in [*words, "--out", out]], catch_exceptions=False)
    anew = stillcal.load(out)
    assert anew.accelerometer.t == pytest.approx(sample.accelerometer.t, abs=1e-9)
    assert np.abs(anew.accelerometer.xyz - sample.accelerometer.xyz).max() <= 0.0026
    assert np.abs(anew.gyroscope.xyz - sample.gyroscope.xyz).max() <= 0.00051
    assert (SAMPLES / "lab.csv.gz").stat().st_size < 300_000


def test_a_calibration_finds_the_true_errors(
    calibration: stillcal.Calibration, truth: dict[str, Any]
) -> None:
    """Within 0.2 mg and 0.05 %: the sample's bias wanders by 0.1 mg while its rests are taken."""
    part, true = calibration.accelerometer, truth["accelerometer"]
    assert part.bias == pytest.approx(true["bias"], abs=0.002)
    assert part.scale == pytest.approx(np.array(true["scale"]), abs=0.0005)


@pytest.fixture(scope="module")
def steady_phone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample's phone with white noise only: a bias that wanders is none that an interval could hold."""
    text = (SAMPLES / "lab.phone.toml").read_text().split("[[effect]]")[0]
    path = tmp_path_factory.mktemp("phone") / "steady.toml"
    path.write_text(re.sub("^flicker.*$", "", text, flags=re.MULTILINE))
    return path


def test_intervals_hold_the_true_values(steady_phone: Path, truth: dict[str, Any]) -> None:
    """Of 96 intervals of 95 %, at least 84: fewer come by chance once in 1,000."""
    held, wide = [], []
    for seed in range(4):
        made = stillcal.simulate(SAMPLES / "lab.scenario.toml", phone=steady_phone, seed=seed)
        found = stillcal.calibrate(made)
        for part, name in ((found.accelerometer, "accelerometer"), (found.gyroscope, "gyroscope")):
            for what in ("bias", "scale"):
                low, high = getattr(part, f"{what}_interval")
                true = np.array(truth[name][what])
                held += list(((low < true) & (true < high)).ravel())
                wide += list(((high - low) / np.abs(np.array(truth[name][what])).max()).ravel())
    assert len(held) == 96
    assert sum(held) >= 84
    assert max(wide) < 0.06  # of the largest element: intervals that say something


def test_a_parameter_that_was_not_fitted_has_no_interval(steady_phone: Path, tmp_path: Path) -> None:
    """Seven attitudes support six parameters, and the gyroscope's bias only."""
    scenario = tmp_path / "seven.toml"
    scenario.write_text('[[segment]]\nactivity = "poses"\ncount = 7\nrest_s = [20.0, 20.0]\n')
    found = stillcal.calibrate(stillcal.simulate(scenario, phone=steady_phone), watch="continuous")
    off = ~np.eye(3, dtype=bool)
    assert (found.accelerometer.parameters, found.gyroscope.parameters) == (6, 3)
    assert np.isnan(found.accelerometer.scale_interval[:, off]).all()
    assert np.isfinite(found.accelerometer.scale_interval[:, ~off]).all()
    assert np.isnan(found.gyroscope.scale_interval).all()
    assert np.isfinite(found.gyroscope.bias_interval).all()
    assert found.missing


def test_a_simulated_phone_from_end_to_end() -> None:
    recording = stillcal.simulate("lab", seed=1)
    calibration = stillcal.calibrate(recording)
    force = stillcal.apply(recording, calibration).accelerometer.xyz
    before = np.median(np.abs(np.linalg.norm(recording.accelerometer.xyz, axis=1) - calibration.gravity))
    after = np.median(np.abs(np.linalg.norm(force, axis=1) - calibration.gravity))
    assert after < 0.1 * before
    assert stillcal.diagnose(recording).verdict == "match"


@pytest.mark.slow
def test_python_and_the_commands_give_the_same_numbers(
    sample: stillcal.Recording,
    calibration: stillcal.Calibration,
    diagnosis: stillcal.Diagnosis,
    tmp_path: Path,
) -> None:
    store, out = tmp_path / "store.json", tmp_path / "true.csv"
    for words in (["replay", SAMPLE, "--store", store], ["apply", SAMPLE, "--store", store, "--out", out]):
        CliRunner().invoke(cli, [str(w) for w in [*words, "--quiet"]], catch_exceptions=False)
    assert stillcal.Calibration.read(store).record.id == calibration.record.id
    written, applied = stillcal.load(out), stillcal.apply(sample, calibration)
    assert np.array_equal(written.accelerometer.xyz, applied.accelerometer.xyz)
    assert np.array_equal(written.gyroscope.xyz, applied.gyroscope.xyz)
    told = CliRunner().invoke(cli, ["diagnose", SAMPLE, "--json", "-"], catch_exceptions=False).stdout
    assert json.loads(told) == diagnosis.as_dict()


def test_what_was_saved_reads_back(
    sample: stillcal.Recording, calibration: stillcal.Calibration, tmp_path: Path
) -> None:
    sample.save(tmp_path / "copy.csv.gz")
    copy = stillcal.load(tmp_path / "copy.csv.gz")
    assert np.array_equal(copy.gyroscope.xyz, sample.gyroscope.xyz)
    assert (copy.events, copy.claims) == (sample.events, sample.claims)
    calibration.save(tmp_path / "store.json")
    back = stillcal.Calibration.read(tmp_path / "store.json")
    assert back.as_dict()["accelerometer"] == calibration.as_dict()["accelerometer"]
    true = stillcal.apply(copy, tmp_path / "store.json")
    assert np.array_equal(true.accelerometer.xyz, stillcal.apply(sample, calibration).accelerometer.xyz)


def test_arrays_and_tables_give_what_the_file_gives(
    sample: stillcal.Recording, calibration: stillcal.Calibration
) -> None:
    accel, gyro = sample.accelerometer, sample.gyroscope
    place = [{"t": 0.0, "event": "location", "latitude": 52.2, "longitude": 0.12, "altitude": 20.0}]
    arrays = stillcal.load(
        t=accel.t,
        accelerometer=accel.xyz,
        gyroscope=gyro.xyz,
        gyroscope_t=gyro.t,
        temperature=accel.temperature,
        events=place,
    )
    table = stillcal.load(columns(sample), events=place, claims={"nominal_rate_hz": 50.0}, name="table")
    for recording in (arrays, table):
        assert stillcal.calibrate(recording).record.id == calibration.record.id
    assert np.array_equal(table.gyroscope.temperature, gyro.temperature)
    assert table.claims.nominal_rate_hz == 50.0


def test_a_data_frame_is_a_table(sample: stillcal.Recording, calibration: stillcal.Calibration) -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(columns(sample))
    place = [{"t": 0.0, "event": "location", "latitude": 52.2, "longitude": 0.12, "altitude": 20.0}]
    assert stillcal.calibrate(stillcal.load(frame, events=place)).record.id == calibration.record.id


def test_what_the_engine_warns_of_is_kept(
    sample: stillcal.Recording, calibration: stillcal.Calibration, tmp_path: Path
) -> None:
    assert calibration.warnings == [] and "warning" not in repr(calibration)
    place = [{"t": 0.0, "event": "location", "latitude": 52.2, "longitude": 0.12, "altitude": 9e4}]
    (said,) = (warned := stillcal.calibrate(stillcal.load(columns(sample), events=place))).warnings
    assert "location not used: altitude 90000.0 m" in said and said in repr(warned)
    warned.save(tmp_path / "store.json")
    assert stillcal.Calibration.read(tmp_path / "store.json").warnings == []


def test_an_empty_cell_is_no_sample(sample: stillcal.Recording) -> None:
    """Every other row lacks the gyroscope; temperatures that are unknown are those of the row before."""
    table = {name: column.copy() for name, column in columns(sample).items()}
    for name in ("gx", "gy", "gz", "temperature"):
        table[name][1::2] = np.nan
    recording = stillcal.load(table)
    assert np.array_equal(recording.gyroscope.t, sample.gyroscope.t[::2])
    assert np.array_equal(
        recording.accelerometer.temperature[1::2], table["temperature"][: -(len(table["t"]) % 2) or None : 2]
    )


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no t": ({"ax": [0.0], "ay": [0.0], "az": [9.8]}, "no column of time stamps found"),
    "half a gyroscope": ({"t": [0.0], "ax": [0.0], "ay": [0.0], "az": [9.8], "gx": [0.0]}, "no column 'gy'"),
    "text": ({"t": ["now", "then"], "ax": [0.0] * 2, "ay": [0.0] * 2, "az": [9.8] * 2}, "is not a number"),
    "one sample": ({"t": [0.0], "ax": [0.0], "ay": [0.0], "az": [9.8]}, "holds one accelerometer sample"),
    "unequal columns": (
        {"t": [0.0, 0.1], "ax": [0.0], "ay": [0.0], "az": [9.8]},
        "column 'ax' has 1 rows and 't' 2",
    ),
    "backwards": ({"t": [1.0, 0.0], "ax": [0.0] * 2, "ay": [0.0] * 2, "az": [9.8] * 2}, "runs backwards"),
    "in g": (
        {
            "t": np.arange(300) / 100,
            **{n: np.full(300, v) for n, v in (("ax", 0.0), ("ay", 0.0), ("az", 1.0))},
        },
        "it seems to be g",
    ),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_table_that_cannot_be_used_is_refused_in_one_line(fault: str) -> None:
    table, said = BAD[fault]
    with pytest.raises(stillcal.UserError, match=said) as refused:
        stillcal.load(table, name="mine")
    assert str(refused.value).startswith("mine")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("one", [SAMPLE, Path("other.csv"), {"t": [0.0]}])
def test_one_witness_without_a_list_is_refused(one: Any, sample: stillcal.Recording) -> None:
    for witness in (one, sample):
        with pytest.raises(TypeError, match="witnesses are recordings in a list"):
            stillcal.diagnose(sample, witnesses=witness)


def test_other_faults_are_refused_too(sample: stillcal.Recording, tmp_path: Path) -> None:
    with pytest.raises(stillcal.UserError, match="no such sample; give one of sample:lab"):
        stillcal.load("sample:nothing")
    with pytest.raises(stillcal.UserError, match=r"none\.csv"):
        stillcal.load(tmp_path / "none.csv")
    with pytest.raises(TypeError, match="needs a path"):
        stillcal.load(t=[0.0])
    for source in (np.zeros((3, 3)), 5):
        with pytest.raises(TypeError, match=r"takes a path, .* is none of them"):
            stillcal.load(source)
    with pytest.raises(stillcal.UserError, match=r"shape \(2, 2\)"):
        stillcal.load(t=[0.0, 0.1], accelerometer=[[0.0, 9.8], [0.0, 9.8]])
    with pytest.raises(stillcal.UserError, match="not an event"):
        stillcal.load(columns(sample), events=[{"t": 0.0, "event": "charging", "on": "perhaps"}])
    with pytest.raises(stillcal.UserError, match=r"91\.0 is out of range"):
        stillcal.load(
            columns(sample), events=[{"t": 0.0, "event": "location", "latitude": 91, "longitude": 0}]
        )
    with pytest.raises(ValueError, match=r"let it end in \.csv"):
        sample.save(tmp_path / "copy.txt")
    with pytest.raises(stillcal.UserError, match="has no calibration"):
        stillcal.apply(sample, tmp_path / "none.json")
    with pytest.raises(ValueError, match="no such file, and not one of"):
        stillcal.simulate("nowhere")


def test_too_little_is_refused_and_what_is_missing_is_said(sample: stillcal.Recording) -> None:
    short = stillcal.load(t=sample.accelerometer.t[:900], accelerometer=sample.accelerometer.xyz[:900])
    with pytest.raises(stillcal.NotSupported, match="no calibration") as refused:
        stillcal.calibrate(short)
    assert refused.value.missing
    with pytest.raises(stillcal.NotSupported, match="at least 200"):
        stillcal.diagnose(
            stillcal.load(t=np.arange(50) / 50, accelerometer=np.tile([0.0, 0.1, 9.8], (50, 1)))
        )


def test_results_show_themselves(
    sample: stillcal.Recording, calibration: stillcal.Calibration, diagnosis: stillcal.Diagnosis
) -> None:
    for result in (sample, calibration, diagnosis):
        assert result._repr_html_().startswith("<table>")
    assert "17,409 samples" in repr(sample)
    assert "Accelerometer, 9 parameters" in repr(calibration)
    assert "gyroscope's bias with temperature" in repr(diagnosis)
    html = stillcal.Diagnosis({**diagnosis.answer, "recording": "<b>&"})._repr_html_()
    assert "&lt;b&gt;&amp;" in html
    assert "<b>" not in html


@pytest.mark.slow
def test_a_phone_and_a_simulation_can_be_given(sample: stillcal.Recording) -> None:
    """The phone that made the sample has the effect; another recording of it does not differ."""
    own = stillcal.diagnose(sample, phone=SAMPLES / "lab.phone.toml")
    assert "gyro_bias_temperature" not in [f["effect"] for f in own.findings]
    again = stillcal.simulate(SAMPLES / "lab.scenario.toml", phone=SAMPLES / "lab.phone.toml", seed=2)
    judged = stillcal.diagnose(forces(sample), simulated=forces(again))
    assert judged.answer["schema"] == 2 and "accel_bias" not in [f["effect"] for f in judged.findings]
    assert "accel_bias" in [a["effect"] for a in judged.answer["agreed"]]
    assert "checks possible" in repr(judged)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"paired": True}, "paired goes with simulated"),
        ({"phone": "typical", "simulated": "sample:lab"}, "simulated and phone exclude each other"),
        ({"phone": "typical", "witnesses": ["sample:lab"]}, "witness is for the built-in simulation"),
        (
            {"witnesses": ["sample:lab"], "covariates": {"load": [1.0]}},
            "witness does not go with covariate",
        ),
    ],
)
def test_what_excludes_each_other_is_refused(given: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=f"^{why}"):
        stillcal.diagnose("sample:lab", **given)


@pytest.mark.slow
def test_a_paired_simulation_can_be_given_that_differs_by_a_number_alone() -> None:
    sample = stillcal.load("sample:lab", stop=150.0)
    force = sample.accelerometer
    shifted = replace(sample, accelerometer=replace(force, xyz=frozen(force.xyz + np.array([0.2, 0.0, 0.0]))))
    (found,) = stillcal.diagnose(shifted, simulated=sample, paired=True).findings
    assert found["effect"] == "accel_bias"


def test_python_m_stillcal_is_the_command() -> None:
    called = [sys.executable, "-m", "stillcal", "--version"]
    ran = subprocess.run(called, capture_output=True, text=True, check=True)
    assert ran.stdout == f"stillcal, version {stillcal.__version__}\n"
