"""The page, the summary and the command: what a person sees."""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.cli.main import cli
from stillcal.replay.diagnosis.diagnose import diagnose_recording
from stillcal.replay.diagnosis.report.figures import drawing
from stillcal.replay.diagnosis.report.page import _title
from stillcal.replay.diagnosis.rest_table import diagnose_rests
from stillcal.replay.diagnosis.words.summary import LINES, summary
from stillcal.replay.formats.rest_table import read_rest_table
from stillcal.replay.formats.trace import Recording
from stillcal.replay.formats.writer import TraceWriter
from tests.support.report_days import THERMAL, phone_with, recorded

Maker = Callable[..., Recording]
Writer = Callable[[Recording, str], Path]


class Seen(HTMLParser):
    """Collects tags, what they refer to, and pictures without words."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.wordless = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        told = dict(attrs)
        self.tags.append(tag)
        self.addresses += [value or "" for key, value in attrs if key in ("src", "href")]
        self.wordless += tag == "img" and not told.get("alt")


def run(*arguments: str | Path) -> str:
    result = CliRunner().invoke(cli, ["diagnose", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.slow
def test_one_page_says_all_and_needs_nothing_else(recording: Maker, written: Writer, tmp_path: Path) -> None:
    trace = written(recording(THERMAL), "a<b>&c.csv")
    out = {name: tmp_path / name for name in ("r.html", "d.json", "p.toml")}
    said = run(trace, "--report", out["r.html"], "--json", out["d.json"], "--phone-out", out["p.toml"])
    page = out["r.html"].read_text()
    seen = Seen()
    seen.feed(page)
    assert seen.tags.count("h1") == 1 and seen.tags.count("h2") >= 3 and seen.tags.count("img") >= 4
    assert seen.wordless == 0
    assert all(address.startswith(("data:image/svg+xml;base64,", "#")) for address in seen.addresses)
    assert "<b>&c" not in page and "a&lt;b&gt;&amp;c.csv" in page
    assert "@import" not in page and "url(" not in page
    answer = json.loads(out["d.json"].read_text())
    assert answer["verdict"] == "identified"
    assert answer["fit"]["p_before"] < 1e-6 and answer["fit"]["p_after"] > 0.01
    (one,) = answer["findings"]
    assert one["relation"] == "lacking" and one["simulated"]["slope"]["value"] == [0.0, 0.0, 0.0]
    assert one["difference"]["slope"] == one["parameters"]["slope"]
    assert len(said.splitlines()) <= LINES and "accelerometer's bias with temperature" in said
    scenario = tmp_path / "s.toml"
    scenario.write_text('[[segment]]\nactivity = "table"\nduration_s = 60.0\n')
    made = ["simulate", str(scenario), "--phone", str(out["p.toml"]), "--out", str(tmp_path / "again.csv")]
    assert CliRunner().invoke(cli, made).exit_code == 0


def test_lines_and_steps_are_told_apart_by_their_titles() -> None:
    finding = {
        "effect": "vibration_tone",
        "sensor": "accel",
        "axes": ["x"],
        "relation": "superfluous",
        "where": {"t_start": 800.0},
        "simulated": {"frequency": {"value": 17.3, "unit": "Hz"}},
    }
    assert _title(finding).endswith(" on x, 17.3 Hz")
    step = {"effect": "accel_bias_step", "relation": "lacking", "parameters": {}}
    assert _title(finding | step).endswith(" on x, at 800 s")


def test_a_legend_lies_on_no_curve_however_it_runs() -> None:
    """Three curves that fill all of the axes; the legend is beyond them and still within the figure."""
    with drawing() as (figure, axes, _):
        for label in ("recorded", "residual", "cross-validated prediction"):
            axes.plot([0.0, 1.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 1.0, 0.0], label=label)
    legend = axes.get_legend()
    assert legend is not None
    place = legend.get_window_extent()
    assert place.y0 >= axes.get_window_extent().y1
    assert place.x0 >= 0.0 and place.x1 <= figure.bbox.x1 and place.y1 <= figure.bbox.y1


def test_a_sound_phone_matches_and_says_how_small_an_effect_it_would_have_shown(
    recording: Maker, written: Writer
) -> None:
    answer = json.loads(run(written(recording(), "real.csv"), "--json", "-"))
    assert answer["verdict"] == "match" and answer["findings"] == [] and answer["agreed"] == []
    assert answer["fit"]["p_before"] > 0.01
    least = {(s["effect"], s["parameter"]): s["smallest_seen_90"] for s in answer["sensitivity"]}
    assert 0.0 < least["accel_bias_temperature", "slope"] < 1e-3
    looked_for = {(s["effect"], s["sensor"]) for s in answer["sensitivity"]}
    assert looked_for & {(n["effect"], n["sensor"]) for n in answer["not_compared"]} == set()


def test_nothing_is_written_over_what_is_read(recording: Maker, written: Writer, tmp_path: Path) -> None:
    trace = written(recording(), "walk.csv")
    for wrong in (
        ["--json", tmp_path / "walk.json"],
        ["--report", tmp_path / "walk.csv"],
        ["--phone-out", tmp_path / "walk.txt"],
        ["--phone", "no such phone"],
    ):
        result = CliRunner().invoke(cli, ["diagnose", str(trace), *map(str, wrong)])
        assert result.exit_code == 2, wrong
    assert not list(tmp_path.glob("*.html")) and not list(tmp_path.glob("*.toml"))


def test_a_recording_without_stillness_is_not_judged(recording: Maker) -> None:
    real = recording()
    rng = np.random.default_rng(0)
    up = rng.normal(size=(2000, 3))  # turned elsewhere every second
    up *= 9.81 / np.linalg.norm(up, axis=1, keepdims=True)
    t = real.accelerometer.t
    turning = up[(t - t[0]).astype(int)] + rng.normal(0.0, 0.01, (t.size, 3))
    samples = Samples.checked(Sensor.ACCELEROMETER, t, turning)
    answer = diagnose_recording(Recording(samples, None, [], real.claims, []), "shaken.csv")
    why = {n["effect"]: n["reason"] for n in answer["not_compared"]}
    assert why["accel_bias_drift"] == "the phone never lies still for long enough"
    assert why["gyro_bias_temperature"] == "no gyroscope"
    assert answer["verdict"] == "not_judged"
    assert re.search(r"Not judged: .* \(\d+ of \d+ checks possible\)", summary(answer)[0])


def test_a_table_of_rests_is_judged_by_norms_and_says_what_it_cannot_show(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    up = rng.normal(size=(60, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    g = 9.80665
    for quadratic, verdict in ((0.0, "not_judged"), (4e-3, "not_judged")):
        force = g * up * (1.0 + quadratic * g * up * [1, 0, 0]) + rng.normal(0.0, 1e-3, up.shape)
        rows = [
            "ax,ay,az,sax,say,saz",
            *(",".join(f"{v:.6f}" for v in [*f, 1e-3, 1e-3, 1e-3]) for f in force),
        ]
        table = tmp_path / "rests.csv"
        table.write_text("\n".join(rows) + "\n")
        answer = diagnose_rests(read_rest_table(table), "rests.csv")
        assert answer["verdict"] == verdict
        why = {n["effect"]: n["reason"] for n in answer["not_compared"]}
        assert why["accel_bias_drift"] == "the table's rows have no time"
        assert why["timestamp_jitter"] == "a table of rests has no samples"
        assert [f["effect"] for f in answer["findings"]] == ["accel_nonlinearity"] * bool(quadratic)
    table.write_text("\n".join(rows[:4]) + "\n")
    result = CliRunner().invoke(cli, ["diagnose", str(table), "--format", "rest"])
    assert result.exit_code == 3 and "at least 7" in result.output


@pytest.mark.slow
def test_an_accelerometer_alone_has_a_page(written: Writer, tmp_path: Path) -> None:
    alone = msgspec.structs.replace(phone_with(THERMAL), gyro=None)
    made = recorded(alone, 3)
    with TraceWriter(tmp_path / "a.csv", gyroscope=False, temperature=True, claims=made.claims) as writer:
        writer.write(made.accelerometer, None, tuple(made.events))
    said = run(tmp_path / "a.csv", "--report", tmp_path / "a.html")
    assert "accelerometer's bias with temperature" in said
    assert "no gyroscope" in (tmp_path / "a.html").read_text()


def test_a_real_recording_has_a_page(data_dir: Path, tmp_path: Path) -> None:
    real = data_dir / "mikoff" / "imu0.log"
    said = run(real, "--format", "mikoff", "--report", tmp_path / "r.html")
    assert said.startswith("imu0.log against the built-in simulation: ")
    assert (tmp_path / "r.html").stat().st_size < 3_000_000


def test_stamps_in_milliseconds_are_refused_in_one_line(recording: Maker, tmp_path: Path) -> None:
    real = recording()
    t, force = real.accelerometer.t[:3000], real.accelerometer.xyz[:3000]
    rows = [f"{1000.0 * s:.3f},{x:.5f},{y:.5f},{z:.5f}" for s, (x, y, z) in zip(t, force, strict=True)]
    trace = tmp_path / "ms.csv"
    trace.write_text("\n".join(["t,ax,ay,az", *rows]) + "\n")
    result = CliRunner().invoke(cli, ["diagnose", str(trace), "--json", str(tmp_path / "d.json")])
    assert isinstance(result.exception, ValueError) and "time stamps step by 40" in str(result.exception)
    assert not (tmp_path / "d.json").exists()


def test_a_report_without_matplotlib_is_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name, *more: None if name == "matplotlib" else found(name, *more)
    )
    words = ["diagnose", "sample:lab", "--report", str(tmp_path / "lab.html")]
    with pytest.raises(UserError, match=r"need matplotlib: pip install '\.\[report\]'"):
        CliRunner().invoke(cli, words, catch_exceptions=False)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("arguments", [["--report", "page.txt"], ["--format", "rest", "--phone", "typical"]])
def test_what_cannot_be_is_refused_before_any_work(arguments: list[str], tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["diagnose", str(tmp_path / "none.csv"), *arguments])
    assert result.exit_code == 2 and "Traceback" not in result.output
