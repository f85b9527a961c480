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
    (found,) = find(str(laid(tmp_path, name))).recordings
    assert found.owner(claimed) == owner
    assert found.name == name


def test_a_pattern_takes_what_fits_and_names_it_from_where_it_begins(tmp_path: Path) -> None:
    folder = laid(tmp_path, "a/1.csv", "a/b/2.csv", "a/3.txt", "a/.hidden.csv")
    assert [f.name for f in find(f"{folder}/a/**/*.csv").recordings] == ["1.csv", "b/2.csv"]
    assert [f.name for f in find(f"{folder}/*/3.txt").recordings] == ["a/3.txt"]


STARTS = {".ulg": b"ULog\x01\x125", ".BIN": b"\xa3\x95\x80", ".parquet": b"PAR1", ".mcap": b"\x89MCAP0\r\n"}
ROWS = b"0.00 0.1 0.2 9.8\n0.01 0.1 0.2 9.8\n"
RECORDS = b'{"t": 0.0, "acc": [0.1, 0.2, 9.8]}\n{"t": 0.01, "acc": [0.1, 0.2, 9.8]}\n'


def test_files_are_recordings_by_their_content_whatever_they_are_called(tmp_path: Path) -> None:
    folder = laid(tmp_path, "a/1.csv", "a/2.log")
    contents = {f"b/{i}{ending}": start for i, (ending, start) in enumerate(STARTS.items())}
    contents |= {"c/session": ROWS, "c/walk.json": RECORDS, "c/walk.txt": b"", "d/walk.csv": ROWS}
    others = {
        "d/walk.json": b'{"device": "Nexus"}',
        "d/walk.events.jsonl": b"",
        "d/store.json": b'{"schema": 1}',
        "d/notes.txt": b"a walk in the park\n",
        "d/photo.jpg": b"\xff\xd8\xff",
    }
    for name, start in (contents | others).items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(start)
    listing = find(str(folder))
    taken = {"a/1.csv", "a/2.log", *contents} - {"c/walk.txt"}
    assert [f.name for f in listing.recordings] == sorted(taken)
    assert listing.passed_over == ["c/walk.txt", "d/notes.txt", "d/photo.jpg", "d/store.json"]
    assert [f.name for f in find(f"{folder}/d/*.txt").recordings] == ["notes.txt"]  # as the pattern says


def test_an_exported_folder_is_one_recording(tmp_path: Path) -> None:
    walk = tuple(f"c/walk/{name}" for name in ("Accelerometer.csv", "Gyroscope.csv", "meta/device.csv"))
    results = ("results/recordings.parquet", "results/parts/1.findings.parquet")
    folder = laid(tmp_path, *walk, "c/bag/metadata.yaml", *results)
    drive = folder / "c" / "drive" / "oxts"
    (drive / "data").mkdir(parents=True)
    (drive / "timestamps.txt").write_text("2011-09-26 13:02:25.964389445\n")
    (drive / "data" / "0000000000.txt").write_text(" ".join(["1"] * 30))
    (_, _, exported) = found = find(str(folder)).recordings
    assert [f.name for f in found] == ["c/bag", "c/drive", "c/walk"]
    assert len(exported.files) == 3
    assert exported.owner(None) == ("c", "c/walk")
    assert [f.name for f in find(f"{folder}/c/*").recordings] == ["bag", "drive", "walk"]
    assert [f.name for f in find(str(folder / "c" / "walk")).recordings] == ["walk"]


@pytest.mark.parametrize(
    ("names", "form"),
    [(("Phones_accelerometer.csv", "Phones_gyroscope.csv"), "hhar"), (("acc_1.csv", "gyr_1.csv"), "auto")],
)
def test_the_gyroscopes_own_file_is_no_recording_of_its_own(
    names: tuple[str, str], form: str, tmp_path: Path
) -> None:
    (found,) = find(str(laid(tmp_path, *names)), form).recordings
    assert [f.name for f in found.files] == list(names)


def test_what_belongs_to_a_recording_changes_it(tmp_path: Path) -> None:
    (before,) = find(str(laid(tmp_path, "walk.csv"))).recordings
    (tmp_path / "walk.json").write_text("{}")
    (after,) = find(str(tmp_path)).recordings
    assert before.stat != after.stat


def test_nothing_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(NoRecordingsError, match="no recording below"):
        find(str(tmp_path))
    with pytest.raises(NoRecordingsError, match="no file or folder"):
        find(str(tmp_path / "nowhere"))
    with pytest.raises(NoRecordingsError, match="no file matches"):
        find(f"{tmp_path}/*.csv")
