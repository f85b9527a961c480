"""Mutate the core with cosmic-ray and count how many mutants its tests kill: `make mutants`.

Each group of `targets.toml` is copied, mutated one place at a time, and run against its own test files.
A sample of places is drawn by a fixed seed, or all are taken. Survivors that `docs/mutants.md` explains are
marked as known. The exit status is 1 where a group kills less than 85 % of its mutants.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import itertools
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the tests; before numpy is first imported

import pytest
from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import mutate_code, use_mutation
from cosmic_ray.plugins import get_operator, operator_names

for library in (
    "hypothesis.strategies",
    "msgspec",
    "numpy",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.signal",
    "scipy.spatial.transform",
    "scipy.stats",
):
    importlib.import_module(library)  # once, here, and not in the fork of every mutant

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "mutants.md"
WANTED = 0.85
SLOWER = 5.0  # times as long as without a mutant: the tests are taken to hang, and the mutant for killed

# What replaces what. Of cosmic-ray's 150 operators those that mostly raise a TypeError on floats and arrays
# (shifts, `is` for `==`) are left out: any test would kill them, and the share killed would flatter.
ARITHMETIC = {
    "Add": ("Sub",),
    "Sub": ("Add",),
    "Mul": ("Div",),
    "Div": ("Mul",),
    "FloorDiv": ("Mul", "Div"),
    "Mod": ("Mul",),
    "Pow": ("Mul",),
    "BitAnd": ("BitOr",),
    "BitOr": ("BitAnd",),
    "BitXor": ("BitAnd",),
    "LShift": ("RShift",),
    "RShift": ("LShift",),
}
COMPARISON = {  # the line moved to its other side, and the sides exchanged
    "Lt": ("LtE", "GtE"),
    "LtE": ("Lt", "Gt"),
    "Gt": ("GtE", "LtE"),
    "GtE": ("Gt", "Lt"),
    "Eq": ("NotEq",),
    "NotEq": ("Eq",),
    "Is": ("IsNot",),
    "IsNot": ("Is",),
    "In": ("NotIn",),
    "NotIn": ("In",),
}
UNARY = {"USub": ("UAdd",), "Delete": ("Not", "Invert")}
OTHERS = {
    "AddNot",
    "ExceptionReplacer",
    "NumberReplacer",
    "RemoveDecorator",
    "ReplaceAndWithOr",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "ReplaceFalseWithTrue",
    "ReplaceOrWithAnd",
    "ReplaceTrueWithFalse",
    "ZeroIterationForLoop",
}
TABLES = {
    "ReplaceBinaryOperator": ARITHMETIC,
    "ReplaceComparisonOperator": COMPARISON,
    "ReplaceUnaryOperator": UNARY,
}


@dataclass(frozen=True)
class Change:
    """One change of one place, as cosmic-ray counts them."""

    module: str
    operator: str
    occurrence: int
    start: tuple[int, int]
    end: tuple[int, int]

    @property
    def place(self) -> tuple[str, str, tuple[int, int]]:
        """Where it is and of what kind, however the place is changed."""
        return self.module, self.operator.split("_")[0], self.start


@dataclass(frozen=True)
class Mutant:
    """A change that makes a difference to Python. before, after: the line without and with it."""

    change: Change
    before: str
    after: str


@dataclass
class Outcome:
    """What became of a group: its mutants tried, the survivors, the time a run takes without a mutant."""

    name: str
    tried: int
    places: int
    survivors: list[Mutant]
    plain_s: float


def changes(module: str) -> Iterator[Change]:
    """Yield all changes of a module that are worth a run."""
    syntax, notes = get_ast_from_path(Path(module)), _silent(Path(module).read_text())
    for name in filter(_worthwhile, operator_names()):
        operator = get_operator(name)()
        positions = (p for node in ast_nodes(syntax) for p in operator.mutation_positions(node))
        for occurrence, (start, end) in enumerate(positions):
            if not any(a <= start and end <= z for a, z in notes):
                yield Change(module, name, occurrence, start, end)


def mutant(change: Change) -> Mutant | None:
    """Return the mutant, or None where it is the same to Python, or no Python."""
    text = Path(change.module).read_text()
    try:
        changed = mutate_code(text, get_operator(change.operator)(), change.occurrence)
        if changed is None or ast.dump(ast.parse(text)) == ast.dump(ast.parse(changed)):
            return None
    except (SyntaxError, AttributeError):  # the latter: cosmic-ray replaces single exceptions, not tuples
        return None
    pairs = zip(text.splitlines(), changed.splitlines(), strict=False)
    before, after = next((a.strip(), b.strip()) for a, b in pairs if a != b)
    return None if before == "*," else Mutant(change, before, after)  # where keyword arguments begin


def _worthwhile(name: str) -> bool:
    plain = name.rsplit("/", maxsplit=1)[-1]
    family, _, pair = plain.partition("_")
    old, _, new = pair.partition("_")
    return plain in OTHERS or new in TABLES.get(family, {}).get(old, ())


def _silent(text: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return the places that no test can or need notice.

    Those are type annotations, which are not evaluated; `Literal[...]`; how a dataclass is made (frozen,
    slots); and `strict=True` of a zip, which guards against slips and changes nothing where there is none.
    """
    found: list[ast.expr | None] = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.arg | ast.AnnAssign):
            found.append(node.annotation)
        elif isinstance(node, ast.FunctionDef):
            found.append(node.returns)
        elif isinstance(node, ast.ClassDef):
            found += [k.value for d in node.decorator_list if isinstance(d, ast.Call) for k in d.keywords]
        elif isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name):
            found.append(node if node.value.id == "Literal" else None)
        elif isinstance(node, ast.keyword) and node.arg == "strict":
            found.append(node.value)
    return [
        ((n.lineno, n.col_offset), (n.end_lineno or 0, n.end_col_offset or 0)) for n in found if n is not None
    ]


def chosen(everything: list[Change], number: int | None, seed: int) -> list[Mutant]:
    """Draw `number` places and one change of each; all changes of all places where it is None."""
    if number is None:
        return [m for m in map(mutant, everything) if m is not None]
    places: dict[tuple[str, str, tuple[int, int]], list[Change]] = {}
    for change in everything:
        places.setdefault(change.place, []).append(change)
    rng = random.Random(seed)
    order = rng.sample(sorted(places), len(places))
    drawn = (mutant(rng.choice(places[place])) for place in order)
    return list(itertools.islice((m for m in drawn if m is not None), number))


def judge(name: str, modules: list[str], tests: list[str], number: int | None, seed: int) -> Outcome:
    """Run the tests of a group against its mutants, in a copy of the tree."""
    with tempfile.TemporaryDirectory(prefix="stillcal-mutants-") as folder:
        _copy_tree(Path(folder))
        os.chdir(folder)
        os.environ["PYTHONPATH"] = folder  # programs that tests start import the copy too
        everything = [change for module in modules for change in changes(module)]
        drawn = chosen(everything, number, seed)
        begun = time.perf_counter()
        if not _passes(tests, math.inf):
            raise RuntimeError(f"{name}: its tests fail without any mutant: {' '.join(tests)}")
        took = time.perf_counter() - begun
        survivors = [m for m in drawn if _survives(m, tests, SLOWER * took + 10.0)]
        os.chdir(ROOT)
        return Outcome(name, len(drawn), len({c.place for c in everything}), survivors, took)


def _copy_tree(to: Path) -> None:
    """Copy what git knows and what is new, links as links."""
    listed = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.run(listed, capture_output=True, text=True, check=True).stdout.split("\0"):
        source = ROOT / name
        if name and (source.is_file() or source.is_symlink()):
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, to / name, follow_symlinks=False)


def _survives(mutant: Mutant, tests: list[str], limit_s: float) -> bool:
    change = mutant.change
    operator = get_operator(change.operator)()
    with use_mutation(Path(change.module), operator, change.occurrence):
        return _passes(tests, limit_s)


def _passes(tests: list[str], limit_s: float) -> bool:
    """Run tests in a fork, which has all libraries imported and nothing of this tree; False if it hangs.

    cosmic-ray would start Python anew for each mutant and spend most of its time on importing scipy.
    """
    child = os.fork()
    if child == 0:
        os.setsid()
        sys.dont_write_bytecode = True  # or a mutant's bytecode could be taken for the next one's
        sys.path.insert(0, str(Path.cwd()))
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nowhere, stream)
        os._exit(pytest.main(["-q", "-x", "-p", "no:cacheprovider", "--hypothesis-seed=0", *tests]))
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status) == 0
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def main() -> int:
    """Read the arguments, run the groups two at a time, print a table and the survivors."""
    targets = tomllib.loads((Path(__file__).parent / "targets.toml").read_text())
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__.split("\n", 1)[0])
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"of {', '.join(targets)}; all by default")
    parser.add_argument("--number", type=int, default=40, help="places drawn in each group (40)")
    parser.add_argument("--all", action="store_true", help="every change of every place: takes hours")
    parser.add_argument("--seed", type=int, default=1, help="of the draw (1)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="groups at a time")
    parser.add_argument("--json", type=Path, help="write the outcome to this file")
    options = parser.parse_args()
    unknown = set(options.groups) - set(targets)
    if unknown:
        parser.error(f"no such group: {', '.join(sorted(unknown))}")
    names = options.groups or list(targets)
    number = None if options.all else options.number
    known = PAGE.read_text() if PAGE.is_file() else ""
    outcomes = []
    with ProcessPoolExecutor(options.jobs) as pool:
        waiting = [
            pool.submit(judge, name, **targets[name], number=number, seed=options.seed) for name in names
        ]
        for future in as_completed(waiting):
            outcomes.append(future.result())
            _show(outcomes[-1], known)
    if options.json:
        options.json.write_text(json.dumps([asdict(outcome) for outcome in outcomes], indent=1))
    return int(any(len(o.survivors) > (1.0 - WANTED) * o.tried for o in outcomes))


def _show(outcome: Outcome, known: str) -> None:
    killed = outcome.tried - len(outcome.survivors)
    share = killed / max(outcome.tried, 1)
    print(
        f"{outcome.name}: {killed} of {outcome.tried} killed ({share:.0%}),"
        f" of {outcome.places} places; {outcome.plain_s:.0f} s a run",
        flush=True,
    )
    for m in sorted(outcome.survivors, key=lambda m: (m.change.module, m.change.start)):
        listed = "known" if f"`{m.after}`" in known else "NEW"
        print(
            f"  {listed} {m.change.module}:{m.change.start[0]}\n    - {m.before}\n    + {m.after}", flush=True
        )


if __name__ == "__main__":
    sys.exit(main())
