"""Which files are recordings, and whose they are by where they lie."""

from __future__ import annotations

from pathlib import Path

import pytest

from stillcal.replay.fleet.discovery import NoRecordingsError, find


def laid(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("t,ax,ay,az\n")
    return folder


@pytest.mark.parametrize(
    ("name", "claimed", "owner"),
    [
        ("Nexus/phone-1/walk.csv", None, ("Nexus", "Nexus/phone-1")),
        ("Nexus/phone-1/walk.csv", "LG Nexus 4", ("LG Nexus 4", "Nexus/phone-1")),
        ("Nexus/walk.csv.gz", None, ("Nexus", "Nexus/walk")),
        ("phone-1/walk.csv", "LG Nexus 4", ("LG Nexus 4", "phone-1")),
        ("walk.csv", None, ("unknown", "walk")),
        ("walk.csv", "LG Nexus 4", ("LG Nexus 4", "walk")),
    ],
)
def test_model_and_device_by_folders_and_claims(
    name: str, claimed: str | None, owner: tuple[str, str], tmp_path: Path
) -> None:
    (found,) = find(str(laid(tmp_path, name)))
    assert found.owner(claimed) == owner
    assert found.name == name


def test_a_pattern_takes_what_fits_and_names_it_from_where_it_begins(tmp_path: Path) -> None:
    folder = laid(tmp_path, "a/1.csv", "a/b/2.csv", "a/3.txt", "a/.hidden.csv")
    assert [f.name for f in find(f"{folder}/a/**/*.csv")] == ["1.csv", "b/2.csv"]
    assert [f.name for f in find(f"{folder}/*/3.txt")] == ["a/3.txt"]


def test_every_format_is_found_and_an_exported_folder_is_one_recording(tmp_path: Path) -> None:
    logs = ("a/1.csv", "a/2.ulg", "a/3.BIN", "b/4.parquet", "b/5.zip", "b/6.mcap")
    walk = tuple(f"c/walk/{name}" for name in ("Accelerometer.csv", "Gyroscope.csv", "meta/device.csv"))
    results = ("results/recordings.parquet", "results/parts/1.findings.parquet")
    folder = laid(tmp_path, *logs, *walk, "c/bag/metadata.yaml", "a/notes.txt", *results)
    found = find(str(folder), "auto")
    assert [f.name for f in found] == sorted([*logs, "c/bag", "c/walk"])
    exported = found[-1]
    assert len(exported.files) == 3
    assert exported.owner(None) == ("c", "c/walk")
    assert [f.name for f in find(f"{folder}/c/*", "auto")] == ["bag", "walk"]
    assert [f.name for f in find(str(folder / "c" / "walk"), "auto")] == ["walk"]
    assert [f.name for f in find(str(folder / "a"), "csv")] == ["1.csv"]


def test_the_gyroscopes_own_file_is_no_recording_of_its_own(tmp_path: Path) -> None:
    folder = laid(tmp_path, "Phones_accelerometer.csv", "Phones_gyroscope.csv")
    (found,) = find(str(folder), "hhar")
    assert [f.name for f in found.files] == ["Phones_accelerometer.csv", "Phones_gyroscope.csv"]


def test_what_belongs_to_a_recording_changes_it(tmp_path: Path) -> None:
    (before,) = find(str(laid(tmp_path, "walk.csv")))
    (tmp_path / "walk.json").write_text("{}")
    (after,) = find(str(tmp_path))
    assert before.stat != after.stat


def test_nothing_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(NoRecordingsError, match=r"no \.csv or \.csv\.gz below"):
        find(str(tmp_path))
    with pytest.raises(NoRecordingsError, match="no file or folder"):
        find(str(tmp_path / "nowhere"))
    with pytest.raises(NoRecordingsError, match="no file matches"):
        find(f"{tmp_path}/*.csv")
