"""The page of all studies, from what each left: NAME.json beside the figures, evaluation.md above them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec

from stillcal.replay.studies.claim import Claim, Study, Verdict, table
from stillcal.replay.studies.registry import STUDIES

FOLDER = "evaluation"
PAGE = "evaluation.md"

PAPERS = {
    "Grammenos 2018": (
        "A. Grammenos, C. Mascolo, J. Crowcroft, *You Are Sensing, but Are You Biased?*, IMWUT 2(1), 2018"
    ),
    "ESGI'95": "I. Georgieva et al., *Laboratory calibration of a MEMS accelerometer sensor*, ESGI'95, 2013",
    "Collin 2019": "J. Collin et al., *Inertial Sensors and Their Applications*, 2019",
    "Stisen 2015": "A. Stisen et al., *Smart Devices are Different*, SenSys 2015",
}

_HEAD = """# What the papers claim, and what comes out here

Made by `stillcal evaluate` (extra `evaluation`); each row names the command that makes it anew, with the
seed that it was drawn with. Every verdict is computed: *reproduced* where our figure is within the tolerance
that the column *why* gives, *differs* otherwise, *cannot be tested here* where the data it needs are not to
be had.

{papers}

{counts}

{claims}

## What stands in for what

The activity recordings of Grammenos et al. are not to be had, and those of Stisen et al. (HHAR: nine people,
twelve devices in motion) not whole: of them there are the first 10,000 rows of each sensor of one phone and
one watch, whose wearer stands and sits (`hhar`). There is the still experiment (`hhar_still`): real phones
and watches at rest on up to six faces, of which a device's errors, noise, rate and stamps are measured.
Activity is that of thirty people with one Galaxy S II at the waist (`ucihar`). Where a claim is of many
devices in motion, that activity is carried through the measured devices, and the row says *semi-synthetic*:
one phone's walk stands behind all of them, nothing above 20 Hz is in it, and nobody rides a bicycle or loads
a phone with other work. Where nothing was recorded at all the phone is simulated ([phone.md](phone.md)).
Where the recordings come from: [data.md](data.md).

The studies are the package `stillcal.replay.studies`. It lies inside `replay` because all it does is feed
recordings and simulated phones through the product, as the rest of `replay` does, and nothing of the product
imports it.
"""

_COMMAND = "stillcal evaluate {name} --seed {seed}"

_SECTION = """## {title}

`{command}`

{text}
"""


class KeptError(ValueError):
    """A kept result that cannot be read."""


def encoded(study: Study) -> bytes:
    """Return a study's result as it is kept, in `kept_at`."""
    return msgspec.json.format(msgspec.json.encode(study), indent=1) + b"\n"


def kept_at(folder: Path, name: str) -> Path:
    """Return where a study's result is kept, beside its figures."""
    return folder / f"{name}.json"


def kept(folder: Path, names: Iterable[str] = STUDIES) -> list[Study]:
    """Read the results that were kept, in the order of `names`; those never run are left out.

    Raises KeptError naming the file and the remedy.
    """
    return [_read(kept_at(folder, name), name) for name in names if kept_at(folder, name).is_file()]


def _read(path: Path, name: str) -> Study:
    try:
        return msgspec.json.decode(path.read_bytes(), type=Study)
    except msgspec.MsgspecError as error:
        remedy = f"run `stillcal evaluate {name}` anew, or delete it"
        raise KeptError(f"{path}: not a study's result ({error}): {remedy}") from error


def page(studies: list[Study]) -> str:
    """Write all studies as one page of Markdown."""
    head = _HEAD.format(
        papers="\n".join(f"- {source}: {title}." for source, title in PAPERS.items()),
        counts=_counts([claim for study in studies for claim in study.claims]),
        claims=_claims(studies),
    )
    sections = [
        _SECTION.format(title=s.title, command=_COMMAND.format(name=s.name, seed=s.seed), text=s.text.strip())
        for s in studies
    ]
    return "\n".join([head, *sections])


def _counts(claims: list[Claim]) -> str:
    number = {verdict: sum(c.verdict == verdict for c in claims) for verdict in Verdict}
    return f"{len(claims)} claims: " + ", ".join(f"{n} {verdict}" for verdict, n in number.items()) + "."


def _claims(studies: list[Study]) -> str:
    rows = [
        (
            f"{c.source}, {c.where}",
            c.claim,
            c.paper,
            c.ours,
            c.data,
            f"**{c.verdict}**" if c.verdict is Verdict.DIFFERS else str(c.verdict),
            c.because,
            f"`{_COMMAND.format(name=s.name, seed=s.seed)}`",
        )
        for s in studies
        for c in s.claims
    ]
    return table(("where", "claim", "paper", "ours", "data", "verdict", "why", "command"), rows)
