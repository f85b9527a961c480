"""Figures: what they are drawn from, what they say, and that each kind of file is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from stillcal.calib_core.accelerometer.observability import places, sphere
from stillcal.calib_core.accelerometer.parameters import BIAS
from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord, StateRecord
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.cli.main import cli
from stillcal.replay.plots import allan, attitudes, history, residuals, style
from stillcal.replay.plots.drawing import draw_figure
from stillcal.replay.plots.inputs import Material, Moment, Stretch, even, longest, rests_of


def plotted(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["plot", *map(str, arguments)])


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that supports a calibration, and its store."""
    folder = tmp_path_factory.mktemp("lab")
    done = CliRunner().invoke(
        cli, ["simulate", "lab", "--out", str(folder / "lab.csv"), "--seed", "1", "--quiet"]
    )
    assert done.exit_code == 0, done.output
    arguments = ["replay", str(folder / "lab.csv"), "--store", str(folder / "store.json"), "--quiet"]
    assert CliRunner().invoke(cli, arguments).exit_code == 0
    return folder


def rest(t_start: float, t_end: float, up: tuple[float, float, float] = (0.0, 0.0, 9.8)) -> RestState:
    sd = np.full(3, 1e-3)
    return RestState(t_start, t_end, 100, np.array(up), sd, sd, 1e-3)


def record(number: float) -> CalibrationRecord:
    """A calibration whose x bias is `number` hundredths of a m/s^2, each bias known to 1e-3."""
    part = AccelerometerRecord(
        scale=np.eye(3),
        bias=np.array([0.01 * number, 0.0, 0.0]),
        parameters=6,
        names=BIAS,
        covariance=1e-6 * np.eye(3),
        gravity=9.8,
    )
    return CalibrationRecord(accelerometer=part)


# From data to what is drawn


def test_the_flat_sphere_keeps_areas_and_fills_the_disc() -> None:
    up = sphere(20_000)
    radius = np.linalg.norm(attitudes.flat(up), axis=1)
    assert radius.max() <= 1.0 + 1e-12
    for share in (0.1, 0.5, 0.9):  # of a half's area lies within sqrt(share) of its middle
        assert np.mean(radius**2 <= share) == pytest.approx(share, abs=0.005)


def test_rests_are_shown_by_their_norms() -> None:
    rests = rests_of([rest(0, 10), rest(10, 30, (9.9, 0.0, 0.0))], None, 9.8)
    assert rests.t.tolist() == [5.0, 20.0] and not rests.calibrated
    np.testing.assert_allclose(rests.before, [0.0, 0.1], atol=1e-12)
    np.testing.assert_allclose(rests.uncertainty, 1e-3)


def test_rests_that_follow_on_one_another_and_lie_alike_are_one_stretch() -> None:
    alike = [rest(0, 10), rest(10.2, 20), rest(20.5, 30)]
    assert longest(alike) == (0, 30)
    assert longest([*alike, rest(40, 65)]) == (0, 30)
    assert longest([rest(0, 10), rest(10.2, 20, (9.8, 0.0, 0.0))]) == (0, 10)
    assert longest([]) is None


def test_only_an_even_run_is_averaged() -> None:
    t = np.r_[np.arange(2000) / 50.0, 45.0 + np.arange(3000) / 50.0]
    stretch = even(Samples.checked(Sensor.ACCELEROMETER, t, np.ones((5000, 3))))
    assert stretch is not None and len(stretch.xyz) == 3000
    assert stretch.rate == pytest.approx(50.0) and stretch.t_start == 45.0
    assert even(Samples.checked(Sensor.ACCELEROMETER, t[:900], np.ones((900, 3)))) is None


def test_the_curve_shows_the_noise_that_is_there() -> None:
    """White noise of 100 µg/√Hz, so 100 µg at 1 s."""
    density = 100e-6 * 9.80665
    xyz = np.random.default_rng(1).normal(0, density * np.sqrt(50.0), (20_000, 3))
    made = style.figure(2, 1)
    allan.draw(
        made, Material("x", rests_of([], None, 9.8), (), (Stretch(Sensor.ACCELEROMETER, xyz, 50.0, 0.0),))
    )
    (axis,) = made.axes
    shown = [float(label.split()[1]) for label in axis.get_legend_handles_labels()[1]]
    assert shown == pytest.approx([100.0] * 3, rel=0.03)


def test_history_is_the_change_from_the_last_with_its_interval() -> None:
    moments = tuple(Moment("replaced", 3600.0 * k, record(k)) for k in (1, 2, 5))
    made = style.figure(2, 2)
    history.draw(made, Material("x", rests_of([], None, 9.8), (*moments, Moment("rejected", 9e3, record(9)))))
    taken, turned_down = made.axes[0].containers[0], made.axes[0].containers[3]
    x, y = taken[0].get_data()
    np.testing.assert_allclose(x, [1, 2, 5], atol=0.06)  # the axes stand beside each other
    np.testing.assert_allclose(y, 1000 / 9.80665 * np.array([-0.04, -0.03, 0.0]), atol=1e-9)
    np.testing.assert_allclose(turned_down[0].get_data()[1], 1000 / 9.80665 * 0.04)
    low, high = taken[2][0].get_segments()[0][:, 1]
    assert high - low == pytest.approx(2 * 1.96 * 1000 / 9.80665 * 1e-3)


def test_without_a_calibration_attitudes_are_drawn_and_the_rest_is_refused() -> None:
    states = [
        StateRecord(t_start=0, t_end=1, n=9, specific_force=9.8 * up, force_uncertainty=np.full(3, 1e-3))
        for up in places()[:4]
    ]
    material = Material("x", rests_of(states, None, 9.8))
    for draw in (residuals.draw, history.draw, allan.draw):
        with pytest.raises(NotSupported):
            draw(style.figure(), material)
    made, left_out = draw_figure("all", material)
    assert len(left_out) == 3 and "4 rests in 4 attitudes" in made.subfigs[0].get_suptitle()


# The command


@pytest.mark.parametrize(("what", "ending"), [("attitudes", "svg"), ("residuals", "pdf"), ("all", "png")])
def test_a_recording_gives_every_figure(lab: Path, tmp_path: Path, what: str, ending: str) -> None:
    out = tmp_path / f"figure.{ending}"
    result = plotted(lab / "lab.csv", "--what", what, "--out", out)
    assert result.exit_code == 0 and "left out" not in result.output, result.output
    begins = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[ending]
    assert out.read_bytes().startswith(begins)


def test_a_store_gives_all_but_noise(lab: Path, tmp_path: Path) -> None:
    result = plotted(lab / "store.json", "--out", tmp_path / "s.png")
    assert result.exit_code == 0 and "figure allan left out" in result.output
    assert plotted(lab / "store.json", "--out", tmp_path / "a.png", "--what", "allan").exit_code == 3
    assert not (tmp_path / "a.png").exists()


def test_what_cannot_be_is_one_line(lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for arguments, said in (
        ((lab / "lab.csv", "--out", tmp_path / "x.gif"), ".png, .svg, .pdf"),
        ((lab / "lab.csv", "--out", tmp_path / "none" / "x.png"), "not a writable folder"),
    ):
        result = plotted(*arguments)
        assert result.exit_code == 2 and said in result.output
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    result = plotted(lab / "lab.csv", "--out", tmp_path / "x.png")
    assert result.exit_code == 2 and ".[report]" in result.output
