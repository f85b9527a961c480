"""Settings: defaults documented and equal, and errors that name line, key and what is allowed."""

from __future__ import annotations

import dataclasses
import io
import re
import tomllib
from functools import reduce
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

import stillcal.config
from stillcal.calib_core.codec import plain
from stillcal.daemon.app_launch import LaunchOptions
from stillcal.daemon.settings import (
    FIXED,
    Settings,
    SettingsError,
    line_of,
    load_settings,
    parse_settings,
    store_path,
)
from stillcal.daemon.store.store import StoreSettings

DEFAULT = Path(stillcal.config.__file__).with_name("default.toml")
UNSET = re.compile(r"^# (?=\w+ = \S+ +# \S+: )", re.MULTILINE)


def knobs(value: dict, *above: str) -> dict[tuple[str, ...], object]:
    """Flatten nested tables into {path: value}."""
    flat = {}
    for key, item in value.items():
        one = {(*above, key): tuple(item) if isinstance(item, list) else item}
        flat |= knobs(item, *above, key) if isinstance(item, dict) else one
    return flat


def parts() -> tuple[str, str]:
    """Return the file's settings for users, and the rarely needed ones with their comment signs taken off."""
    common, rare = DEFAULT.read_text().split("# Rarely needed.")
    return common, "\n".join(re.findall(r"^# (\[.*|\w+ = .*)$", rare, re.MULTILINE))


def is_fixed(key: tuple[str, ...]) -> bool:
    return any(key[: len(fixed)] == fixed for fixed in FIXED)


def test_the_default_file_names_every_setting_once_with_the_default_of_the_code():
    from_code = {key: value for key, value in knobs(plain(Settings())).items() if not is_fixed(key)}
    gravity = ("engine", "schedule", "gravity")
    assert from_code.pop(gravity) is None
    common, rare = (knobs(tomllib.loads(text)) for text in parts())
    assert not common.keys() & rare.keys()
    assert common | rare == from_code
    assert gravity in knobs(tomllib.loads(UNSET.sub("", parts()[0])))


def test_settings_of_the_file_can_be_given():
    for text in (UNSET.sub("", parts()[0]), parts()[1]):
        assert parse_settings(text) is not None


def test_a_user_meets_few_settings_first():
    assert len(re.findall(r"^(?:# )?\w+ = ", parts()[0], re.MULTILINE)) <= 15


def text_of(key: tuple[str, ...], value: str) -> str:
    return f"[{'.'.join(key[:-1])}]\n{key[-1]} = {value}\n"


def test_what_is_fixed_may_be_repeated_but_not_changed():
    """A file made from an older default.toml, which named all of them, is still read."""
    defaults = knobs(plain(Settings()))
    fixed = {key: value for key, value in defaults.items() if is_fixed(key)}
    assert len(fixed) == 17
    for key, value in fixed.items():
        text = repr(value) if not isinstance(value, str) else f'"{value}"'
        assert parse_settings(text_of(key, text)) == Settings()
        other = '"probe"' if isinstance(value, str) else repr(type(value)(value * 2 or 1))
        with pytest.raises(SettingsError, match=r"is no setting any more \(.+\): remove it$"):
            parse_settings(text_of(key, other))


def test_every_fixed_name_is_a_field():
    for key in FIXED:
        assert reduce(getattr, key, Settings()) is not None


def test_the_default_file_loads_as_the_defaults():
    assert load_settings(DEFAULT) == load_settings(None) == Settings()


def test_every_knob_has_a_comment_that_begins_with_its_unit():
    assigned = re.findall(r"^(?:# )?(\w+) = [^#\n]*(.*)$", "\n".join(parts()), re.MULTILINE)
    bare = [key for key, comment in assigned if not re.fullmatch(r"# \S[^:]*: .{10,}", comment)]
    assert bare == []


def test_what_a_file_does_not_mention_keeps_its_default():
    settings = parse_settings("[store]\nhistory = 5\n")
    assert settings == dataclasses.replace(Settings(), store=StoreSettings(history=5))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[store]\nmode = 0o777", r"^c\.toml:2: \[store\] mode = 0o777: must be 0o600 or 0o640$"),
        (
            "[store]\n# one\nhistroy = 3",
            r"^c\.toml:3: \[store\] histroy is not a setting: did you mean history\?$",
        ),
        ("\n[stroe]\n", r"^c\.toml:2: stroe is not a section: did you mean store\?$"),
        ("[zzzzzz]\n", r"known are .*store.*log"),
        ("store = 5", r"^c\.toml:1: store = 5: must be a table, \[store\]$"),
        ("[[store]]\nmode = 3", r"^c\.toml:1: store = .*: must be a table"),
        ("[log]\nlevel = 'loud'", r"^c\.toml:2: \[log\] level = 'loud': must be one of 'debug', 'info'"),
        (
            "[engine.detector]\nmode = 'skan'",
            r"^c\.toml:2: .* mode = 'skan': must be one of 'scan', 'probe'$",
        ),
        ("[source]\nbaud = 'fast'", r"^c\.toml:2: \[source\] baud = 'fast': must be int$"),
        ("[source]\nbaud = true", r"^c\.toml:2: .* must be int$"),
        ("[source]\nbaud = 3", r"^c\.toml:2: \[source\] baud = 3: must be within 1200\.\.4000000$"),
        ("source.baud = 3", r"^c\.toml:1: \[source\] baud = 3"),
        ("store = {mode = 3}", r"^c\.toml:1: \[store\] mode"),
        ("[log]\n[store]\n'mode' = 3", r"^c\.toml:3: \[store\] mode"),
        ("[log]\nlevel", r"^c\.toml:2: not TOML: "),
        ("[log", r"^c\.toml:1: not TOML: "),
        (
            "[engine.schedule]\ncheck_interval_s = -5",
            r"^c\.toml:2: \[engine\.schedule\] check_interval_s = -5",
        ),
        ("[engine.schedule]\nreview_interval_s = 1e-9", r"^c\.toml:2: .* must be within 1\.\.1e\+09 s$"),
        ("[engine.schedule]\nreview_interval_s = 0.999", r"^c\.toml:2: .* must be within 1\.\.1e\+09 s$"),
        ("[engine.schedule]\nreview_interval_s = nan", r"^c\.toml:2: .* = nan: must be a number$"),
        (
            "[engine]\nshedule = {}",
            r"^c\.toml:2: \[engine\] shedule is not a setting: did you mean schedule\?$",
        ),
    ],
)
def test_an_error_names_line_key_and_remedy(text, message):
    with pytest.raises(SettingsError, match=message):
        parse_settings(text, "c.toml")


def test_whole_numbers_do_for_seconds():
    assert parse_settings("[engine.schedule]\ncheck_interval_s = 60").engine.schedule.check_interval_s == 60.0


@given(st.text(max_size=60))
def test_no_text_gets_through_as_anything_but_settings_or_a_refusal(text):
    try:
        assert isinstance(parse_settings(text), Settings)
    except SettingsError as error:
        assert str(error).startswith("settings")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "No such file"),
        (lambda path: path.mkdir(), "not a regular file"),
        (lambda path: path.write_bytes(b"\xff\xfe"), "not UTF-8"),
    ],
)
def test_a_file_that_cannot_be_read_is_named(tmp_path, make, message):
    make(tmp_path / "c.toml")
    with pytest.raises(SettingsError, match=rf"c\.toml: {message}"):
        load_settings(tmp_path / "c.toml")


def test_settings_from_standard_input_hold_until_the_daemon_ends(monkeypatch):
    """At SIGHUP they cannot be read again: an empty input had been taken for all defaults."""
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(b'[source]\nport = "tty"\n')))
    given = LaunchOptions(Path("-"))
    assert given.settings().source.port == "tty"
    with pytest.raises(SettingsError, match="standard input can be read only once"):
        given.settings_again()


def test_the_line_is_that_of_the_key_in_its_own_table():
    text = "[a]\nx = 1\n\n[b]\nx = 2\n"
    assert line_of(text, ("b", "x")) == 5
    assert line_of(text, ("b", "y")) == 4
    assert line_of(text, ("c",)) is None


@pytest.mark.parametrize(
    ("path", "environ", "found"),
    [
        ("/here/s.json", {"STATE_DIRECTORY": "/var/lib/stillcal"}, "/here/s.json"),
        ("", {"STATE_DIRECTORY": "/var/lib/stillcal:/var/lib/other"}, "/var/lib/stillcal/store.json"),
        ("", {"HOME": "/home/u"}, "/home/u/.local/state/stillcal/store.json"),
        ("", {"HOME": "/home/u", "XDG_STATE_HOME": "/x"}, "/x/stillcal/store.json"),
    ],
)
def test_the_store_is_found_where_settings_or_system_say(path, environ, found):
    assert str(store_path(StoreSettings(path=path), environ)) == found
