"""What a file is by its first bytes."""

from __future__ import annotations

import codecs
import re

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.sources import Source
from stillcal.replay.formats.tables.plain import UTF16

ULOG, DATAFLASH, AXIVITY = "PX4 ULog", "ArduPilot DataFlash", "Axivity CWA"
ROS1, ROS2, MCAP = "ROS 1 bag", "ROS 2 bag", "MCAP"
PARQUET, HDF5, MATLAB, NPY, ZIP = "Parquet", "HDF5", "MATLAB", "NumPy", "zip"
JSON = "JSON"
ECHO = "rostopic echo"
TEXT = "text"

STARTS = {
    b"ULog\x01\x12\x35": ULOG,
    b"\xa3\x95\x80": DATAFLASH,
    b"MD": AXIVITY,
    b"#ROSBAG V2.0": ROS1,
    b"SQLite format 3\0": ROS2,
    b"\x89MCAP0\r\n": MCAP,
    b"PAR1": PARQUET,
    b"\x89HDF\r\n\x1a\n": HDF5,
    b"MATLAB 5.0": MATLAB,
    b"MATLAB 7.3": HDF5,
    b"\x93NUMPY": NPY,
    b"PK\x03\x04": ZIP,
    b"PK\x05\x06": ZIP,
}
"""How the files of each kind begin."""

_BLACKBOX = "a Betaflight blackbox log"
_FOREIGN = {
    b"%PDF": "a PDF document",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive",
    b"Rar!": "a RAR archive",
    b"\x1f\x9d": "a compressed file (.Z)",
    b"BZh": "a bzip2 file",
    b"\xfd7zXZ": "an xz file",
    b"\x28\xb5\x2f\xfd": "a zstd file",
    b"\xd0\xcf\x11\xe0": "an old Excel or Word document",
    b"\x7fELF": "a program",
    b"#ROSBAG": "a ROS bag older than version 2.0",
    b"H Product:Blackbox": _BLACKBOX,
    b"<": "HTML or XML",
}
"""What people give by mistake, or what is not read yet, with the name to call it by."""

_JSON = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:\{\s*[\"}]|\[\s*[\[{\]])")
"""How JSON begins that can hold records. A line in brackets begins the preamble of a text table too."""

_ECHO_END = re.compile(rb"^---\s*$", re.MULTILINE)
_ECHO_FIELD = re.compile(rb"^(\w+):\s*\n[ \t]+\w+:", re.MULTILINE)
"""Messages that are printed one after another, with `---` between: two have the same first field."""

_PACKED = ("archive", "bzip2", "xz file", "zstd", "compressed")
_REMEDIES = {
    _BLACKBOX: "decode it with blackbox_decode --save-headers and give the CSV",
}


class ForeignError(TraceError):
    """A file is of a kind that is not read."""


def kind_of(source: Source) -> str:
    """Return the kind of a file by its content, TEXT where nothing speaks against it.

    Raises ForeignError where it is of no kind that is read, TraceError where it cannot be read.
    """
    head = source.head()
    for start, kind in STARTS.items():
        if head.startswith(start) and (kind != AXIVITY or b"\0" in head or b"\xff" in head):
            return kind
    for start, name in _FOREIGN.items():
        if head.startswith(start):
            packed = any(word in name for word in _PACKED)
            usual = "unpack it and give what is in it" if packed else "export the recording as CSV"
            remedy = _REMEDIES.get(name, usual)
            raise ForeignError(source.path, f"is {name}, not a recording that can be read", remedy)
    if _JSON.match(head):
        return JSON
    if _is_echo(_in_utf8(head)):
        return ECHO
    if b"\0" in head and not head.startswith(UTF16):
        what = "is not a text file, and no binary format that is known"
        remedy = "give one of the formats in docs/formats.md, or text in UTF-8"
        raise ForeignError(source.path, what, remedy)
    return TEXT


def _is_echo(head: bytes) -> bool:
    """Whether a text begins with printed messages, among which a tool's own lines may be."""
    fields = [found[1] for part in _ECHO_END.split(head) if (found := _ECHO_FIELD.search(part))]
    return len(fields) > 1 and fields[0] == fields[1]


def _in_utf8(head: bytes) -> bytes:
    """Return how a text begins, in UTF-8 and without the mark of its encoding."""
    wide = head.startswith(UTF16)
    return head.decode("utf-16", "ignore").encode() if wide else head.removeprefix(codecs.BOM_UTF8)
