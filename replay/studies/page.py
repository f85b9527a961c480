"""The page of all studies, from what each left: NAME.json beside the figures, evaluation.md above them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from string import ascii_uppercase
from typing import NamedTuple

import msgspec

from stillcal.replay.studies.claim import Claim, Evidence, Study, Verdict, table
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


class Headline(NamedTuple):
    """A row of the summary. begins: how the claim begins; words: what the summary calls it, in brief."""

    begins: str
    words: str


SUMMARY = {
    "Grammenos 2018": (
        Headline("calibration lowers the MSE to the aggregate: walk", "traces more alike: MSE, walk"),
        Headline("gain by the method: stairs up against walk", "gain in accuracy: up / walk"),
        Headline("gain by the method: stairs down against stairs up", "the same: stairs down / up"),
        Headline("similar activities, calibrated: accuracy of neural", "accuracy, networks"),
        Headline("similar activities, calibrated: accuracy of the SVM", "accuracy, SVM"),
        Headline("overhead on an app", "overhead on an app"),
        Headline("first calibration within one day", "first calibration within a day"),
        Headline("fewer than 10 positions", "fewer than 10 positions needed"),
    ),
    "ESGI'95": (
        Headline("dataset 1, positions 1-20: parameters", "parameters of the fit, dataset 1"),
        Headline("dataset 1: maximum", "its largest error, %"),
        Headline("largest error by non-orthogonality", "non-orthogonality: error, m/s²"),
        Headline("non-orthogonality of up to 2 %", "2 % of it is serious"),
    ),
    "Collin 2019": (
        Headline("white noise falls", "Allan deviation, white noise"),
        Headline("consumer sensors cannot navigate", "consumer sensors navigate alone"),
        Headline("1 % of accelerometer scale, length from variance", "1 % of scale: step length"),
        Headline("six activities, our features", "motion modes misclassified"),
    ),
    "Stisen 2015": (
        Headline("range of mean deviations", "devices at rest: off from g"),
        Headline("average F1 falls", "heterogeneity impairs: F1"),
        Headline("frequency features suffer", "frequency features suffer most"),
        Headline("ECDF features are the ones", "ECDF features are to be taken"),
        Headline("training within the cluster against", "training within a cluster, F1"),
        Headline("a model never trained on costs less", "unknown model against user"),
        Headline("interpolation, SVM on frequency", "interpolation, unknown model, F1"),
    ),
}
"""The rows of the summary, by paper: what its abstract and conclusions claim or rest on."""

_HEAD = """# What the papers claim, and what comes out here

*For readers of the papers.*

{claims} claims of four papers beside our figures, made by `stillcal evaluate` (extra `evaluation`). Every
verdict is computed. *Reproduced*: our figure lies within a tolerance that is given with its reason.
*Differs*: it lies outside; the study says why, by a run that tested it, or that the cause is not known and
what was tried. *Left open by the paper*: we measured something that the paper does not claim, so nothing is
reproduced. *Cannot be tested here*: the data that it needs are not to be had. What
[stands in for a paper's own data](#what-stands-in-for-what) is said below the tables.

A claim about a way of testing is judged by the paper's own way. Stisen et al. test motion that their
recognisers were trained on through another device; what holds so, and not on *other windows*, whose motion
nobody was trained on, is *reproduced*, and its cell says "not on other windows" with the figure: a finding of
ours.

{papers}

## Tally by kind of evidence

Each cell: reproduced / differs / left open by the paper. Not in the table: {untested} claims that cannot be
tested here. Of the {differ} figures that differ, {found} have a cause that a run showed; that of the other
{unknown} is not known.

{tally}

- *Real recordings*: recordings of real devices, alone.
- *Semi-synthetic*: real activity (one phone) carried through the measured errors and noise of real devices.
- *Simulation*: simulated phones or random draws. It shows that the methods behave as the paper says, and
  nothing about real sensors.
- *Theory*: a derivation, checked numerically. *Arithmetic*: counted, timed or computed from given numbers.
- *The paper's own numbers*: figures that the paper prints, used as data.

## Summary by paper

The claims of each paper's abstract and conclusions and the results that these rest on, where they can be
tested here; of the chapter (Collin 2019), which concludes from no results of its own, one or two of each
part. Rows were chosen by what the papers say, not by what came out. Figures are cut short here: each claim
leads to its study, and the tables below have all of it.

{summary}

{details}

## What stands in for what

The activity recordings of Grammenos et al. are not to be had, and those of Stisen et al. (HHAR: nine people,
twelve devices in motion) not whole: of them there are the first 10,000 rows of each sensor of one phone and
one watch, whose wearer stands and sits (`hhar`). There is the still experiment (`hhar_still`): real phones
and watches at rest on up to six faces, of which a device's errors, noise, rate and stamps are measured.
Activity is that of thirty people with one Galaxy S II at the waist (`ucihar`). Where a claim is about many
devices in motion, that activity is carried through the measured devices, and the evidence is
*semi-synthetic*: one phone's walk stands behind all of them, nothing above 20 Hz is in it, and nobody rides a
bicycle or loads a phone with other work. Where nothing was recorded at all the phone is simulated
([phone.md](phone.md)). Where the recordings come from: [data.md](data.md).

## Where the papers' methods are

What a user needs is in the product: the accelerometer's fit, the gyroscope's fit, rests, the rolling mean,
gravity by place and the quality check are `stillcal.calib_core` ([api.md](api.md)). Methods that only the
studies need are the package `stillcal.replay.studies.methods`. They are kept with the studies: documented and
tested there, and imported from Python in a checkout. The wheel leaves them out, and they may change with the
studies:

{methods}

{example}

The studies are the package `stillcal.replay.studies`. It lies inside `replay` because all it does is feed
recordings and simulated phones through the product, as the rest of `replay` does, and nothing of the product
imports it.
"""

EVIDENCE = {Evidence.REAL: "real", Evidence.PRINTED: "printed"}
"""Kinds of evidence whose names are too long for the summary."""

METHODS = {
    "coning": "coning errors of a gyroscope's rates (Collin 2019, 4.2, Eq. 26-27)",
    "device_faces": "the six-face calibration of every device of the still experiment (`hhar_still`)",
    "esgi": "a fit of the angles between the sensor's axes (ESGI'95, section 2)",
    "motion_modes": "features of motion and Bayes' rule on them (Collin 2019, 4.1 and 4.2)",
    "navigation": "strapdown navigation, headings and dead reckoning by steps (Collin 2019, 3.1 and 3.4)",
    "step_template": "steps by a template: correlation, dynamic time warping (Collin 2019, 3.2)",
    "steps": "step detection and step length from the norm of the force (Collin 2019, 3.2 and 3.3)",
}
"""Modules of `stillcal.replay.studies.methods` and what each offers."""

EXAMPLE = """Steps of a walk, and where they lead, from a recording with both sensors:

```python
import numpy as np
import stillcal
from stillcal.replay.studies.methods.navigation import dead_reckoning, headings, step_headings, up_in_body
from stillcal.replay.studies.methods.steps import detect_steps, patterns, step_length

walk = stillcal.load("walk.csv")
force, rate = walk.accelerometer, walk.gyroscope
steps = detect_steps(force.t, force.xyz, gravity=9.81)
length = step_length(patterns(steps, 9.81)[:, 1], factor=0.5, exponent=0.25)
forces = np.column_stack([np.interp(rate.t, force.t, axis) for axis in force.xyz.T])
up = up_in_body(rate.t, rate.xyz, forces, span=10.0)
heading = step_headings(rate.t, headings(rate.t, (rate.xyz * up).sum(axis=1)), steps.start, steps.end)
print(dead_reckoning(length, heading)[-1])  # m, from the first step
```"""
"""How the methods are used; a test runs it."""

_NO_DATA = ("", "-", "none")
"""What claims without data say of them."""

_COMMAND = "stillcal evaluate {name} --seed {seed}"

_SECTION = """## {title}

`{command}`

{text}

### How each claim of {name} was judged

{judged}
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
    claims = [claim for study in studies for claim in study.claims]
    differ, explained = sum(c.verdict is Verdict.DIFFERS for c in claims), sum(c.explained for c in claims)
    head = _HEAD.format(
        claims=len(claims),
        papers="\n".join(f"- {source}: {title}." for source, title in PAPERS.items()),
        differ=differ,
        found=explained,
        unknown=differ - explained,
        untested=sum(c.verdict is Verdict.UNTESTED for c in claims),
        tally=tally(claims),
        summary=_summary(studies),
        details="\n\n".join(_details(source, studies) for source in PAPERS if _has(source, claims)),
        example=EXAMPLE,
        methods="\n".join(f"- `{name}`: {words}." for name, words in METHODS.items()),
    )
    sections = [
        _SECTION.format(
            title=s.title,
            command=_COMMAND.format(name=s.name, seed=s.seed),
            text=s.text.strip(),
            name=f"`{s.name}`",
            judged=_judged(s),
        )
        for s in studies
    ]
    return _spaced("\n".join([head, *sections]))


def _spaced(text: str) -> str:
    """Put the space before each per cent sign, which Python's own format of shares leaves out."""
    return re.sub(r"(?<=\d)%", " %", text)


def tally(claims: list[Claim]) -> str:
    """Count the claims that could be tested: one row a kind of evidence, one column a paper, and all."""
    tested = [c for c in claims if c.verdict is not Verdict.UNTESTED]
    papers = [source for source in PAPERS if _has(source, claims)]
    rows = [
        (
            str(kind),
            *(_cell([c for c in tested if c.evidence is kind and c.source == p]) for p in papers),
            _cell([c for c in tested if c.evidence is kind]),
        )
        for kind in Evidence
        if kind is not Evidence.NONE
    ]
    total = ("all", *(_cell([c for c in tested if c.source == p]) for p in papers), _cell(tested))
    return table(("evidence", *papers, "all"), [*rows, total])


def by_kind(claims: list[Claim]) -> str:
    """Count the claims that could be tested by kind of evidence alone, for other pages."""
    rows = []
    for kind in Evidence:
        own = [c for c in claims if c.evidence is kind and c.verdict is not Verdict.UNTESTED]
        if own:
            rows.append((str(kind), *_cell(own).split(" / ")))
    return table(("evidence", "as published", "differs", "left open by the paper"), rows)


def _has(source: str, claims: list[Claim]) -> bool:
    return any(c.source == source for c in claims)


def _cell(claims: list[Claim]) -> str:
    number = [
        sum(c.verdict is v for c in claims) for v in (Verdict.REPRODUCED, Verdict.DIFFERS, Verdict.OPEN)
    ]
    return " / ".join(map(str, number)) if claims else "-"


def headlines(claims: list[Claim]) -> list[tuple[Headline, Claim]]:
    """Return the rows of the summary with their claims, in its order."""
    return [
        (headline, c)
        for source, rows in SUMMARY.items()
        for headline in rows
        for c in claims
        if c.source == source and c.claim.startswith(headline.begins)
    ]


def _summary(studies: list[Study]) -> str:
    """Return one table with the headline claims by paper, each with a link to its study."""
    found = {claim: study for study in studies for claim in study.claims}
    rows: list[tuple[str, ...]] = []
    source = ""
    for row, c in headlines(list(found)):
        if c.source != source:
            source = c.source
            rows.append((f"**{source}**", "", "", "", ""))
        link = f"[{row.words}](#{_anchor(found[c].title)})"
        rows.append(
            (link, c.paper, c.brief or c.ours, _verdict(c), EVIDENCE.get(c.evidence, str(c.evidence)))
        )
    return table(("claim", "the paper", "ours", "verdict", "evidence"), rows)


def _details(source: str, studies: list[Study]) -> str:
    """Return the table of all claims of a paper, each with a link to its study's section."""
    rows = [
        (c.where, c.claim, c.paper, c.ours, _verdict(c), str(c.evidence), f"[{s.name}](#{_anchor(s.title)})")
        for s in studies
        for c in s.claims
        if c.source == source
    ]
    head = ("where", "claim", "paper", "ours", "verdict", "evidence", "study")
    return f"## All claims: {source}\n\n{table(head, rows)}"


def _judged(study: Study) -> str:
    """Return what a study's claims were judged by, in their order: data by letter, tolerance, cause."""
    sources = list(dict.fromkeys(c.data for c in study.claims if c.data not in _NO_DATA))
    letters = {data: ascii_uppercase[k] for k, data in enumerate(sources)}
    legend = "\n".join(f"- {letter}: {data}" for data, letter in letters.items())
    rows = [(f"{c.where}: {c.claim}", letters.get(c.data, "-"), c.because) for c in study.claims]
    causes = [f"- *{c.claim}* ({c.where}): {c.why_it_differs}." for c in study.claims if c.why_it_differs]
    parts = [
        f"Data:\n\n{legend}" if legend else "",
        table(("claim", "data", "tolerance, or what is missing"), rows),
        "Why figures differ, with the run that tested it:\n\n" + "\n".join(causes) if causes else "",
    ]
    return "\n\n".join(part for part in parts if part)


def _verdict(claim: Claim) -> str:
    return f"**{claim.verdict}**" if claim.verdict is Verdict.DIFFERS else str(claim.verdict)


def _anchor(title: str) -> str:
    """Return the anchor that GitHub gives to a heading."""
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c in "-_")
