"""KITTI's folders with a file for each sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import Recording, read_all
from tests.support.log_files import DATA, as_folder, as_zip

N = 400


def kitti_files(folder: str = "") -> dict[str, str]:
    """Return the files of a drive: 30 numbers a sample, as KITTI's dataformat.txt orders them."""
    files = {}
    for i, (_, *values) in enumerate(DATA[:N].tolist()):
        row = [49.0, 8.4, 116.0, 0.03, 0.01, -2.6, -6.8, -11.2, 13.1, -0.1, 0.0]
        row += [*values[:3], 0.1, 0.2, 9.6, *values[3:], 0.01, 0.02, 0.03, 0.05, 0.1, 4, 11, 5, 5, 6]
        files[f"{folder}data/{i:010d}.txt"] = " ".join(map(repr, row)) + "\n"
    stamps = (f"2011-09-26 13:02:{25 + i // 100}.{i % 100:02d}0000000" for i in range(N))
    files[f"{folder}timestamps.txt"] = "\n".join(stamps) + "\n"
    files[f"{folder}dataformat.txt"] = "ay:    acceleration in z, i.e. in direction of vehicle top (m/s^2)\n"
    return files


def assert_same(recording: Recording) -> None:
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.accelerometer.xyz, DATA[:N, 1:4])
    np.testing.assert_array_equal(recording.gyroscope.xyz, DATA[:N, 4:])
    np.testing.assert_allclose(recording.accelerometer.t - 1317042145.0, np.arange(N) / 100, atol=1e-6)


@pytest.mark.parametrize("folder", ["", "oxts/"])
@pytest.mark.parametrize("pack", [as_folder, as_zip])
def test_a_drive_is_read(tmp_path: Path, pack, folder: str) -> None:
    others = {"image_00/timestamps.txt": "2011-09-26 13:02:25.0\n", "image_00/data/0000000000.png": "no text"}
    assert_same(read_all(pack(tmp_path, kitti_files(folder) | (others if folder else {}))))


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    path = as_folder(tmp_path, kitti_files("oxts/"))
    sample = path / "oxts/data/0000000007.txt"
    sample.write_text("49.0 8.4")
    with pytest.raises(TraceError, match=r"0000000007\.txt: holds 2 numbers instead of 30"):
        read_all(path)
    sample.unlink()
    with pytest.raises(TraceError, match=r"timestamps\.txt: has 400 time stamps for 399 samples"):
        read_all(path)
    stamps = path / "oxts/timestamps.txt"
    stamps.write_text(stamps.read_text().replace("2011-09-26 13:02:25.010000000", "soon"))
    with pytest.raises(TraceError, match=r"timestamps\.txt:2: holds 'soon', which is not a date"):
        read_all(path)
