"""`diagnose --fix-for`: the file on disk."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from stillcal.daemon.cli.main import cli
from stillcal.replay.commands.fix_for import Correction
from tests.replay.export.test_fix import BIAS, MATRIX

YAML = "rostopic: /imu0\nupdate_rate: 100.0\n"
PHONE = "# mine\n[gyro]\nbias = [0.0, 0.0, 0.0]\n"


def test_the_old_file_is_kept_under_a_name_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "phone.toml"
    path.write_text(PHONE)
    for _ in range(2):
        Correction("phone", path).write({"findings": [BIAS]})
    assert (tmp_path / "phone.toml.bak").read_text() == PHONE
    assert "bias = [0.02, 0.0, 0.02]" in (tmp_path / "phone.toml.bak2").read_text()
    assert "bias = [0.04, 0.0, 0.04]" in path.read_text()
    assert path.read_text().startswith("# mine\n")


def test_what_cannot_be_held_is_said_and_leaves_the_file_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "imu.yaml"
    path.write_text(YAML)
    Correction("kalibr", path).write({"findings": [BIAS, MATRIX]})
    said = capsys.readouterr()
    assert "nothing to change" in said.out
    assert "cannot hold gyro_bias: it has no setting for this" in said.err
    assert "cannot hold gyro_g_sensitivity" in said.err
    assert [p.name for p in tmp_path.iterdir()] == ["imu.yaml"]
    assert path.read_text() == YAML


def test_a_file_of_another_kind_is_refused_before_anything_is_diagnosed(tmp_path: Path) -> None:
    path = tmp_path / "model.sdf"
    path.write_text("<sdf/>")
    words = ["diagnose", "sample:lab", "--phone", "typical", "--fix-for", "gazebo", str(path)]
    result = CliRunner().invoke(cli, words)
    assert str(result.exception) == f"{path}: holds 0 <imu> elements: expected one"
    assert path.read_text() == "<sdf/>"


def test_the_recording_itself_is_never_corrected(tmp_path: Path) -> None:
    trace = tmp_path / "real.csv"
    trace.write_text("t,ax,ay,az\n0,0,0,9.8\n")
    words = ["diagnose", str(trace), "--phone", "typical", "--fix-for", "phone", str(trace)]
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 2
    assert "is read by this command" in result.output


def test_without_a_simulation_there_is_nothing_to_correct(tmp_path: Path) -> None:
    """What the recording has beside an ideal sensor must not be added to a file that may have it already."""
    result = CliRunner().invoke(
        cli, ["diagnose", "sample:lab", "--fix-for", "phone", str(tmp_path / "p.toml")]
    )
    assert result.exit_code == 2
    assert "give it as --simulated SIM or --phone PHONE" in result.output
    assert not (tmp_path / "p.toml").exists()


def test_a_configuration_that_does_not_exist_is_refused_and_not_made(tmp_path: Path) -> None:
    path = tmp_path / "nosuch.sdf"
    words = ["diagnose", "sample:lab", "--phone", "typical", "--fix-for", "gazebo", str(path)]
    result = CliRunner().invoke(cli, words)
    assert str(result.exception) == (
        f"{path}: no such file; give the gazebo configuration that the simulation was made with"
    )
    assert not path.exists()


def test_a_new_phone_file_begins_with_the_phone_that_is_judged(tmp_path: Path) -> None:
    path = tmp_path / "new.toml"
    Correction("phone", path, PHONE).write({"findings": [BIAS]})
    assert "bias = [0.02, 0.0, 0.02]" in path.read_text()
