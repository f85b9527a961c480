"""What a study says, how it is kept, the page, and the command."""

import importlib
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

import stillcal
from stillcal.replay.commands.evaluate import evaluate_command
from stillcal.replay.studies import methods, page
from stillcal.replay.studies import registry as studies
from stillcal.replay.studies.claim import Cause, Claim, Evidence, Study, Verdict, agreement, holds, table

DOCS = Path(__file__).parents[3] / "docs"


def a_study(name: str = "laboratory") -> Study:
    claim = Claim(
        "ESGI'95",
        "2.4",
        "s1 | s2",
        "0.3",
        "0.4",
        "its tables",
        Verdict.DIFFERS,
        "off by 0.1",
        evidence=Evidence.PRINTED,
    )
    return Study(name, "A title", (claim,), "### Detail\n\nwords", ("a.png",), 7)


def test_agreement_is_judged_by_the_tolerance() -> None:
    assert agreement(3.14, 3.15, 0.01 + 1e-12) is Verdict.REPRODUCED
    assert agreement(3.14, 3.16, 0.01) is Verdict.DIFFERS
    assert agreement(3.14, float("nan"), 0.01) is Verdict.DIFFERS
    assert (holds(True), holds(False)) == (Verdict.REPRODUCED, Verdict.DIFFERS)


def test_what_is_kept_comes_back(tmp_path: Path) -> None:
    page.kept_at(tmp_path, "laboratory").write_bytes(page.encoded(a_study()))
    assert page.kept(tmp_path) == [a_study()]


def test_page_has_every_claim_and_the_command_of_each_section() -> None:
    text = page.page([a_study()])
    row = "| 2.4 | s1 \\| s2 | 0.3 | 0.4 | **differs** | the paper's own numbers | [laboratory](#a-title) |"
    assert row in text
    assert "- A: its tables" in text
    assert "| 2.4: s1 \\| s2 | A | off by 0.1 |" in text
    assert "`stillcal evaluate laboratory --seed 7`" in text


def test_page_says_why_a_figure_differs_and_only_then() -> None:
    """Without a cause it says that none is known, so that silence is not taken for an explanation."""
    study = a_study()
    claim = study.claims[0]
    assert "- *s1 | s2* (2.4): not known; nothing was tried." in page.page([study])
    shown, missed = Cause("rounding, 0.1", shown=True), Cause("rounding, 0.1", shown=False)
    told, tried = (replace(study, claims=(replace(claim, cause=cause),)) for cause in (shown, missed))
    assert "- *s1 | s2* (2.4): tested: rounding, 0.1." in page.page([told])
    assert "- *s1 | s2* (2.4): not known; tried: rounding, 0.1." in page.page([tried])
    agrees = replace(study, claims=(replace(claim, cause=shown, verdict=Verdict.REPRODUCED),))
    assert "rounding" not in page.page([agrees])


def test_the_page_counts_the_causes_that_a_run_showed() -> None:
    """One that was tried and is not it, and one that nobody looked for, count as not known."""
    claim = a_study().claims[0]
    shown, missed = Cause("rounding, 0.1", shown=True), Cause("rounding, 0.1", shown=False)
    causes = (shown, shown, shown, missed, None)
    claims = [replace(claim, cause=cause) for cause in causes]
    claims.append(replace(claim, cause=causes[0], verdict=Verdict.REPRODUCED))
    text = " ".join(page.page([replace(a_study(), claims=tuple(claims))]).split())
    assert "Of the 5 figures that differ, 3 have a cause that a run showed; that of the other 2" in text


def test_every_difference_on_the_page_says_what_was_run() -> None:
    for claim in (claim for study in page.kept(DOCS / page.FOLDER) for claim in study.claims):
        if claim.verdict is Verdict.DIFFERS:
            assert claim.cause is not None, claim.claim
            assert any(c.isdigit() for c in claim.why_it_differs), f"{claim.claim}: no figure is in the cause"


def test_the_tally_counts_by_kind_and_paper_what_could_be_tested() -> None:
    one = a_study().claims[0]
    claims = [
        one,
        replace(one, verdict=Verdict.REPRODUCED, evidence=Evidence.REAL, source="Stisen 2015"),
        replace(one, verdict=Verdict.OPEN, evidence=Evidence.REAL, source="Stisen 2015"),
        replace(one, verdict=Verdict.UNTESTED, evidence=Evidence.NONE),
    ]
    lines = page.tally(claims).splitlines()
    assert lines[0] == "| evidence | ESGI'95 | Stisen 2015 | all |"
    assert "| real recordings | - | 1 / 0 / 1 | 1 / 0 / 1 |" in lines
    assert "| the paper's own numbers | 0 / 1 / 0 | - | 0 / 1 / 0 |" in lines
    assert lines[-1] == "| all | 0 / 1 / 0 | 1 / 0 / 1 | 1 / 1 / 1 |"


def test_every_headline_is_one_claim_of_the_page_and_takes_one_line() -> None:
    claims = [claim for study in page.kept(DOCS / page.FOLDER) for claim in study.claims]
    found = page.headlines(claims)
    assert [row for row, _ in found] == [row for rows in page.SUMMARY.values() for row in rows]
    assert len(found) <= 24, "more than a screen"
    for row, claim in found:
        assert len(row.words) + len(claim.paper) + len(claim.brief or claim.ours) <= 97, claim
        assert claim.verdict in {Verdict.REPRODUCED, Verdict.DIFFERS}, claim


def test_the_summary_has_both_figures_beside_the_verdict() -> None:
    begins = page.SUMMARY["ESGI'95"][0]
    claim = replace(a_study().claims[0], claim=begins.begins + " of the fit")
    text = page.page([replace(a_study(), claims=(claim,))])
    row = f"| [{begins.words}](#a-title) | 0.3 | 0.4 | **differs** | printed |"
    assert f"| **ESGI'95** |  |  |  |  |\n{row}" in text


def test_the_readme_gives_the_tally_by_kind() -> None:
    claims = [claim for study in page.kept(DOCS / page.FOLDER) for claim in study.claims]
    wanted = page.by_kind(claims)
    assert wanted in (DOCS.parent / "README.md").read_text(), f"README.md should have\n\n{wanted}"


def test_the_tally_by_kind_leaves_out_what_could_not_be_tested() -> None:
    one = a_study().claims[0]
    claims = [one, replace(one, verdict=Verdict.OPEN), replace(one, verdict=Verdict.UNTESTED)]
    assert page.by_kind(claims).splitlines()[2:] == ["| the paper's own numbers | 0 | 1 | 1 |"]


def test_claims_on_the_page_are_read_at_a_glance_and_name_their_evidence() -> None:
    for claim in (claim for study in page.kept(DOCS / page.FOLDER) for claim in study.claims):
        lengths = len(claim.claim), len(claim.paper), len(claim.ours)
        assert all(n <= most for n, most in zip(lengths, (100, 60, 100), strict=True)), claim
        assert (claim.evidence is Evidence.NONE) == (claim.verdict is Verdict.UNTESTED), claim
        assert claim.verdict is not Verdict.DIFFERS or claim.because, claim


def test_the_page_in_the_documents_is_what_was_kept_and_whole() -> None:
    """Nothing on it is written by hand, no study is missing, and every figure is there and shown."""
    folder = DOCS / page.FOLDER
    kept = page.kept(folder)
    assert [study.name for study in kept] == list(studies.STUDIES)
    text = (DOCS / page.PAGE).read_text()
    assert text == page.page(kept)
    assert "--data`)" not in text  # a study that was run without the recordings
    assert "(--data)" not in text
    figures = {figure for study in kept for figure in study.figures}
    assert figures == {file.name for file in folder.glob("*.png")}
    assert all(f"({page.FOLDER}/{figure})" in text for figure in figures)


def test_the_page_names_every_method_that_the_studies_keep() -> None:
    folder = Path(methods.__file__).parent
    assert set(page.METHODS) == {file.stem for file in folder.glob("*.py")} - {"__init__"}


def test_the_example_of_the_methods_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's own lines, on a simulated walk of two minutes with a faultless phone."""
    scenario = tmp_path / "walk.toml"
    scenario.write_text('description = "a walk"\n[[segment]]\nactivity = "walk"\nduration_s = 120.0\n')
    stillcal.simulate(scenario, phone="ideal").save(tmp_path / "walk.csv")
    monkeypatch.chdir(tmp_path)
    code = page.EXAMPLE.split("```python")[1].split("```")[0]
    assert code.strip() in (DOCS / page.PAGE).read_text()
    names: dict[str, object] = {}
    exec(code, names)
    assert 150 < names["steps"].start.size < 300  # type: ignore[attr-defined]  # two a second, and stops


def test_every_method_is_documented_with_its_source() -> None:
    papers = ("Collin", "Grammenos", "ESGI", "Stisen")
    for name in page.METHODS:
        module = importlib.import_module(f"stillcal.replay.studies.methods.{name}")
        assert any(paper in (module.__doc__ or "") for paper in papers), name
        own = [
            value
            for key, value in vars(module).items()
            if not key.startswith("_") and getattr(value, "__module__", "") == module.__name__
        ]
        assert own, name
        assert all(value.__doc__ for value in own if callable(value)), name


def test_table_has_a_row_a_line() -> None:
    assert table(("a", "b"), [("1", "2")]).splitlines() == ["| a | b |", "| --- | --- |", "| 1 | 2 |"]


@pytest.mark.parametrize("name", studies.STUDIES)
def test_every_study_can_be_found_and_says_what_it_is(name: str) -> None:
    assert len(studies.title(name)) > 10


def test_command_writes_the_page_and_runs_again(tmp_path: Path) -> None:
    for _ in range(2):
        result = CliRunner().invoke(evaluate_command, ["laboratory", "--out", str(tmp_path)])
        assert result.exit_code == 0, result.output
    text = (tmp_path / "evaluation.md").read_text()
    assert "dataset 1, positions 1-20: parameters" in text
    assert (tmp_path / "evaluation" / "laboratory.json").is_file()


@pytest.mark.slow
def test_two_processes_write_the_page_that_one_writes(tmp_path: Path) -> None:
    pages = []
    for jobs in ("1", "2"):
        out = tmp_path / jobs
        asked = ["laboratory", "grades", "--jobs", jobs, "--out", str(out)]
        result = CliRunner().invoke(evaluate_command, asked)
        assert result.exit_code == 0, result.output
        assert "of processor" in result.output.splitlines()[-1]
        pages.append((out / "evaluation.md").read_text())
    assert pages[0] == pages[1]


def test_unknown_study_is_refused_by_name(tmp_path: Path) -> None:
    result = CliRunner().invoke(evaluate_command, ["gyre", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "no study is named gyre: choose among " in result.output
    assert not list(tmp_path.iterdir())


def test_a_missing_library_is_named_with_its_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stillcal.replay.commands.evaluate.NEEDED", {"no_such_module": "no-such-package"})
    result = CliRunner().invoke(evaluate_command, ["laboratory", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "no-such-package not installed: pip install '.[evaluation]'" in result.output


def test_an_installed_package_says_where_the_studies_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wheel does not hold the studies."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    result = CliRunner().invoke(evaluate_command, ["--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "the studies come with the source" in result.output
    assert not list(tmp_path.iterdir())


def test_a_damaged_result_is_named_with_its_remedy(tmp_path: Path) -> None:
    folder = tmp_path / "evaluation"
    folder.mkdir()
    (folder / "allan.json").write_text('{"name": "allan"')
    result = CliRunner().invoke(evaluate_command, ["laboratory", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "allan.json: not a study's result" in result.output
    assert "stillcal evaluate allan" in result.output


def test_recordings_that_are_not_there_are_named_with_a_remedy(tmp_path: Path) -> None:
    """A folder without any writes nothing; one without those of a study names the file."""
    empty, some, out = tmp_path / "empty", tmp_path / "some", tmp_path / "out"
    empty.mkdir()
    (some / "hhar").mkdir(parents=True)
    for data, named in ((empty, "none of hhar, hhar_still"), (some, "still_accel.npz is missing")):
        result = CliRunner().invoke(evaluate_command, ["smoothing", "--data", str(data), "--out", str(out)])
        assert result.exit_code == 2
        assert named in " ".join(result.output.split())
        assert "docs/data.md lists the recordings" in " ".join(result.output.split())
        assert not list(tmp_path.rglob("*.json"))
        assert data is some or not out.exists()
