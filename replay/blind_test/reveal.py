"""Revealing a blind test: keys are checked against the manifest's seals, answers against the keys."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stillcal.replay.blind_test.answer import read_answers
from stillcal.replay.blind_test.keys import Key, opened
from stillcal.replay.blind_test.make import ChallengeError, Manifest
from stillcal.replay.blind_test.marking import Mark, marked
from stillcal.replay.blind_test.scores import NAMING_D


def open_keys(manifest: Manifest, keys: Path) -> dict[str, Key]:
    """Open all keys of a manifest. Raises ChallengeError on a missing key, SealError on a changed one."""
    opened_keys = {}
    for name, seal in manifest.seals.items():
        path = keys / f"{name}.key"
        if not path.is_file():
            raise ChallengeError(f"{path}: not found; name the folder of the blind test's keys")
        opened_keys[name] = opened(path.read_bytes(), seal, path.name)
    return opened_keys


def marks_of(keys: Mapping[str, Key], answers: Mapping[str, dict[str, Any]]) -> list[Mark]:
    """Return the marks of all answers; a recording without an answer counts as a failed one."""
    nothing: dict[str, Any] = {"verdict": "failed", "findings": []}
    return [marked(name, key, answers.get(name, nothing)) for name, key in keys.items()]


def read_marks(keys: Mapping[str, Key], answers: Path) -> list[Mark]:
    """Read a folder of answers and mark them."""
    return marks_of(keys, read_answers(answers, list(keys)))


def to_leave_out(keys: Mapping[str, Key], most: int) -> dict[str, str]:
    """Return at most `most` recordings with one clear effect, with the catalogue entry to remove for each."""
    clear = {
        name: key.effects[0].effect
        for name, key in keys.items()
        if key.kind == "single" and (key.effects[0].d_prime or 0.0) >= NAMING_D
    }
    return dict(list(clear.items())[:most])
