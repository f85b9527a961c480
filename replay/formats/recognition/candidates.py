"""Which files and folders may be recordings: by their content, as TRACE is recognised, and not by name."""

from __future__ import annotations

from pathlib import Path

from stillcal.replay.formats.claims import claims_text, written_by_stillcal
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs.ros import FOLDER_INDEX
from stillcal.replay.formats.logs.sample_folder import sample_folder
from stillcal.replay.formats.recognition.header import looks_like_a_table
from stillcal.replay.formats.recognition.magic import JSON, TEXT, ForeignError, kind_of
from stillcal.replay.formats.recognition.phone_export import EXPORTED_FILES
from stillcal.replay.formats.sources import Source, source_of
from stillcal.replay.formats.tables.plain import plain_text
from stillcal.replay.formats.tables.text import text_head

_EVENTS = ".events.jsonl"
_WHOLE = (FOLDER_INDEX, *EXPORTED_FILES)
"""Files that make their folder one recording."""


def may_be_recording(path: Path) -> bool:
    """Whether a file is of a kind that is read. Its samples are not looked at, so reading it may still fail.

    Texts without a table are none, nor are empty ones, what lies beside a recording, and what stillcal wrote
    as JSON.
    """
    if path.name.endswith(_EVENTS):
        return False
    try:
        source = source_of(path)
        kind = kind_of(source)
        if kind == TEXT:
            return bool(source.head().strip()) and looks_like_a_table(_lines(source))
        return kind != JSON or (claims_text(path) is None and not written_by_stillcal(path))
    except ForeignError:
        return False
    except TraceError:
        return True  # it cannot be read, and the attempt says why


def _lines(source: Source) -> list[str]:
    return text_head(plain_text(source)).split("\n")


def is_one_recording(folder: Path) -> bool:
    """Whether a folder as a whole is a recording: an app's export, a ROS 2 bag, a file for each sample."""
    if any((folder / name).is_file() for name in _WHOLE):
        return True
    try:
        return sample_folder(folder) is not None
    except TraceError:
        return True  # it is one, and reading it says what is wrong with it
