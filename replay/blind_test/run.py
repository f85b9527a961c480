"""The whole blind test: make, commit, answer with every solver, reveal, score."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from stillcal.replay.blind_test.answer import SOLVERS, answer_all, answerable
from stillcal.replay.blind_test.keys import Key
from stillcal.replay.blind_test.make import Manifest, make
from stillcal.replay.blind_test.marking import GIVEN_A_SIMULATION, Mark
from stillcal.replay.blind_test.reveal import open_keys, read_marks, to_leave_out
from stillcal.replay.blind_test.score_lines import Line
from stillcal.replay.blind_test.scores import Score, compared, scored

LEFT_OUT_SHARE = 0.05
"""Share of the trials that are diagnosed again with their catalogue entry removed."""

Tick = Callable[[str, int, int], None]
"""Is called with the stage of the work, the number done and the number in all."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result of a blind test. holds: whether all required scores are reached. marks: of the diagnosis."""

    scores: list[Score]
    comparison: list[Line]
    holds: bool
    marks: list[Mark]


def prove(
    folder: Path,
    trials: int,
    seed: int,
    *,
    jobs: int = 1,
    beside: Collection[str] = (),
    trials_too: bool = True,
    tick: Tick = lambda stage, done, of: None,
) -> Verdict:
    """Run the blind test in `folder` (new or empty); keys are moved there only after all answers.

    beside: kinds of case in addition to the trials. Raises as `make`, `answer_all` and `open_keys` do.
    """
    recordings, sealed = folder / "recordings", folder / "keys"
    with tempfile.TemporaryDirectory() as withheld:
        manifest = make(
            recordings,
            Path(withheld) / "keys",
            trials,
            seed,
            jobs=jobs,
            beside=beside,
            trials_too=trials_too,
            tick=lambda done, of: tick("making", done, of),
        )
        for solver in SOLVERS:
            names = answerable(recordings, manifest.seals, solver)
            show_answers = _progress_of(tick, solver, len(names))
            answer_all(recordings, folder / solver, names, solver, jobs=jobs, tick=show_answers)
        shutil.move(Path(withheld) / "keys", sealed)
    keys = open_keys(manifest, sealed)
    left_out = _answers_without_entry(folder, manifest, keys, jobs, tick)
    return judged(keys, {solver: folder / solver for solver in SOLVERS}, left_out)


def _progress_of(tick: Tick, stage: str, of: int) -> Callable[[int], None]:
    return lambda done: tick(stage, done, of)


def _answers_without_entry(
    folder: Path, manifest: Manifest, keys: dict[str, Key], jobs: int, tick: Tick
) -> list[Mark]:
    """Return the marks of some clear cases, diagnosed with a catalogue that lacks their effect."""
    chosen = to_leave_out(keys, max(round(LEFT_OUT_SHARE * len(manifest.seals)), 1))
    items = [f"{name}={effect}" for name, effect in chosen.items()]
    out = folder / "diagnosis_entry_removed"
    answer_all(
        folder / "recordings", out, items, jobs=jobs, tick=lambda n: tick("entry removed", n, len(items))
    )
    return read_marks({name: keys[name] for name in chosen}, out)


def judged(keys: dict[str, Key], answers: dict[str, Path], left_out: list[Mark] | None = None) -> Verdict:
    """Return the scores of folders of answers, by solver; the required scores are for the first one.

    A solver that answered no given simulation, as the baselines, is not asked about these.
    """
    first = next(iter(answers))
    alone = {name: key for name, key in keys.items() if key.kind not in GIVEN_A_SIMULATION}
    given = keys.keys() - alone.keys()
    marks = {
        solver: read_marks(keys if any((folder / f"{n}.json").is_file() for n in given) else alone, folder)
        for solver, folder in answers.items()
    }
    scores = [scored(s, m, left_out if s == first else None) for s, m in marks.items()]
    # Where only given simulations were judged there is nothing that the baselines could have answered.
    comparison = compared(scores) if alone else []
    bars = [line.holds for line in (*scores[0].lines, *comparison) if line.holds is not None]
    return Verdict(scores, comparison, all(bars), marks[first])
