"""Commit, answer, reveal as commands; the fence round the answering process; the baselines."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from stillcal.replay.blind_test import answer as answering
from stillcal.replay.blind_test import baselines
from stillcal.replay.blind_test import run as proof
from stillcal.replay.blind_test.cases import make_case
from stillcal.replay.blind_test.designs import Design
from stillcal.replay.blind_test.make import make, write_recording
from stillcal.replay.commands.blind_test import challenge_group, prove_command
from stillcal.replay.formats.trace import read_all


@pytest.fixture(scope="module")
def challenge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("challenge")
    make(folder / "recordings", folder / "keys", 5, 2)
    return folder


def test_the_commands_from_end_to_end(challenge: Path, tmp_path: Path) -> None:
    runner, recordings = CliRunner(), str(challenge / "recordings")
    out, told = tmp_path / "bic", tmp_path / "scores.json"
    done = runner.invoke(
        challenge_group, ["answer", recordings, "--out", str(out), "--solver", "affine_coloured_bic"]
    )
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in out.iterdir()) == [f"r{i:04d}.json" for i in range(1, 6)]
    done = runner.invoke(
        challenge_group,
        ["reveal", recordings, "--keys", str(challenge / "keys"), "--answers", str(out), "--json", str(told)],
    )
    assert done.exit_code == 1 and "Not all required scores are reached" in done.output
    scores = json.loads(told.read_bytes())
    assert scores["schema"] == 1 and scores["holds"] is False and len(scores["marks"]) == 5


def test_keys_of_ones_own_are_sealed_and_scored(challenge: Path, tmp_path: Path) -> None:
    runner, keys, answers = CliRunner(), tmp_path / "keys", tmp_path / "answers"
    recordings = tmp_path / "recordings"
    for folder in (keys, answers, recordings):
        folder.mkdir()
    (recordings / "r7.csv").write_bytes((challenge / "recordings" / "r0001.csv").read_bytes())
    (keys / "r7.json").write_text('{"kind": "null"}')
    (answers / "r7.json").write_text('{"schema": 1, "verdict": "match", "findings": []}')
    arguments = [str(recordings), "--keys", str(keys)]
    assert runner.invoke(challenge_group, ["commit", *arguments]).exit_code == 0
    again = runner.invoke(challenge_group, ["commit", *arguments])
    assert again.exit_code == 2 and "sealed already" in again.output
    done = runner.invoke(challenge_group, ["reveal", *arguments, "--answers", str(answers), "--json", "-"])
    assert done.exit_code == 1
    assert json.loads(done.stdout)["marks"][0]["kind"] == "null"


def test_a_changed_key_is_found_out(challenge: Path, tmp_path: Path) -> None:
    for path in (challenge / "keys").iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes().replace(b'"family":"', b'"family":"a'))
    done = CliRunner().invoke(
        challenge_group,
        ["reveal", str(challenge / "recordings"), "--keys", str(tmp_path), "--answers", str(tmp_path)],
    )
    assert done.exit_code == 2 and "not the one the manifest commits to" in done.output


@pytest.mark.parametrize(
    "arguments", [["answer", "nowhere", "--out", "x"], ["make", ".", "--keys", "k", "--trials", "1"]]
)
def test_refusals_are_one_line(arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    done = CliRunner().invoke(challenge_group, arguments)
    assert done.exit_code == 2 and done.output.startswith("stillcal: ") and done.output.count("\n") == 1


def test_the_answering_process_cannot_open_a_key(challenge: Path, tmp_path: Path) -> None:
    key = next((challenge / "keys").iterdir())
    code = f"""
import sys
from pathlib import Path
from stillcal.replay.blind_test import answer as answering
answering.run("affine_coloured_bic", Path({str(tmp_path)!r}), ["r0001"])
assert not [m for m in sys.modules if m.rpartition(".")[2] in ("cases", "keys", "make")]
open({str(key)!r}).read()
"""
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        cwd=challenge / "recordings",
        capture_output=True,
        text=True,
        check=False,
    )
    assert "may read its recordings only" in done.stderr and done.returncode != 0
    assert json.loads((tmp_path / "r0001.json").read_bytes())["verdict"] in ("match", "identified")


def test_the_diagnosis_finds_its_code_in_the_answering_process(challenge: Path, tmp_path: Path) -> None:
    """It may open no file but its recordings and its own code, whichever layer that is in."""
    whole = (challenge / "recordings" / "r0001.csv").read_text().splitlines(keepends=True)
    recordings, out = tmp_path / "recordings", tmp_path / "out"
    recordings.mkdir()
    (recordings / "r0001.csv").write_text("".join(whole[:4000]))
    answering.answer_all(recordings, out, ["r0001"])
    answer = answering.read_answers(out, ["r0001"])["r0001"]
    assert answer["verdict"] != "failed", answer["why"]


def test_a_solver_that_breaks_answers_failed(tmp_path: Path) -> None:
    (tmp_path / "r0001.csv").write_text("t,ax,ay,az\n0,0,0,nan\n")
    assert answering.answer_one(tmp_path, "r0001")["verdict"] == "failed"
    assert "why" in answering.answer_one(tmp_path, "r0001")


def test_a_process_that_dies_is_an_error(
    challenge: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(answering.AnswerError, match="failed: no word"):
        answering.answer_all(challenge / "recordings", tmp_path / "out", ["r0001"])


def test_the_whole_proof_leaves_keys_only_after_the_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(proof, "SOLVERS", ("affine_coloured_bic", "sparse_regression"))
    monkeypatch.setattr(proof, "_answers_without_entry", lambda *_: [])
    stages: dict[str, bool] = {}

    def tick(stage: str, done: int, of: int) -> None:
        stages[stage] = (tmp_path / "keys").exists()

    verdict = proof.prove(tmp_path, 5, 4, tick=tick)
    assert stages == {"making": False, "affine_coloured_bic": False, "sparse_regression": False}
    assert len(verdict.marks) == 5 and [s.solver for s in verdict.scores] == list(proof.SOLVERS)


def test_prove_says_what_it_is() -> None:
    done = CliRunner().invoke(prove_command, ["--help"])
    assert done.exit_code == 0 and "hide effects, seal the keys, diagnose, reveal" in done.output


@pytest.mark.parametrize("solver", ["affine_coloured_bic", "sparse_regression"])
def test_the_baselines_find_a_plain_effect_in_white_noise(solver: str, tmp_path: Path) -> None:
    """They are to be beaten, not to be made of straw."""
    design = Design("single", "white", "examiner", ("gyro_bias_temperature",), 2000.0, False)
    case = make_case(design, 11, 3)
    key = case.key
    write_recording(tmp_path / "r.csv", case.recording)
    answer = baselines.SOLVERS[solver](read_all(tmp_path / "r.csv"), "r.csv")
    named = {f["effect"]: f for f in answer["findings"]}
    assert "gyro_bias_temperature" in named
    if solver == "affine_coloured_bic":
        told = named["gyro_bias_temperature"]["parameters"]["slope"]["value"]
        assert told == pytest.approx(key.effects[0].parameters["slope"], rel=0.3, abs=3e-5), (
            "the Earth turns 7e-5 rad/s while it warms by a few K"
        )
    assert msgspec.json.encode(answer)
