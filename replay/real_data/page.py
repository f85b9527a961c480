"""The page of the three tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillcal.replay.real_data import optical_reference as optical
from stillcal.replay.real_data.injection import STRENGTHS
from stillcal.replay.real_data.sound_phones import Judged, Unlike
from stillcal.replay.real_data.sources import Source
from stillcal.replay.real_data.tables import Finding, Injected, Row, agreement, tally
from stillcal.replay.real_data.withheld_thermometer import Withheld
from stillcal.replay.studies.claim import table

_PAGE = """# The diagnosis on other people's recordings

*For people who ask what the diagnosis finds on real devices.*

Made by `python -m stillcal.replay.real_data $STILLCAL_DATA`; [data.md](data.md) says where the recordings
come from. Nothing is tuned to them: each goes through the path of `stillcal diagnose`, without claims of a
maker, since none came with them.

## What is found in each

{found}

Every finding has its probability, and what it gains in log score on data left out, nats (of what is counted
or timed, none is computed). "Found again" says whether the same name comes out of either half of the
recording alone, and of other recordings of the same device. A *match* where little could be looked for says
little: the third column tells of how many effects the recording could show. That is few where a phone lies in
one attitude, or has no thermometer.

### Beside optical truth

{optical}

### Phones on a table

{still}

### One half against the other

{halves}

### Tables of rests (ESGI'95)

{rests}

## The thermometer withheld

{withheld}

The curve is the one that all channels share most of, made without the temperature. "By chance" is the part
of the temperature's own circular shifts that correlate as well; other recordings' temperatures, stretched to
this one's length, are the second control. A curve that rises steadily correlates with all that rises.

## Effects injected into real recordings

Right: named alone. Set: named as a member of a set that the recording cannot separate. Counted beyond what
the untouched twin of the recording says. Strengths are {strengths} times the size in
`replay/real_data/injection.py`.

{injected}

{misnamed}
"""


@dataclass(frozen=True, slots=True)
class Shown:
    """What the page shows.

    rests: name, verdict, findings of tables of rests; still: phones on a table, judged by what others show;
    unlike: those of them whose halves differ.
    """

    recordings: Sequence[Source]
    rows: Sequence[Row]
    rests: Sequence[tuple[str, str, list[Finding]]]
    hidden: Sequence[tuple[Source, Withheld | None]]
    results: Sequence[Injected]
    still: Sequence[Judged]
    unlike: Sequence[Unlike]


def page(shown: Shown) -> str:
    """Return the page's text."""
    rows = shown.rows
    device = {s.name: s.device for s in shown.recordings}
    return _PAGE.format(
        found=_findings_table(rows, device),
        optical=_optical(shown.recordings, rows),
        still=_still(shown.still),
        halves=_halves(shown.unlike, len(shown.still)),
        rests=table(
            ("table", "verdict", "found"),
            [(name, verdict, "; ".join(map(described, f)) or "-") for name, verdict, f in shown.rests],
        ),
        withheld=_withheld(shown.hidden),
        strengths=", ".join(f"{s:.2g}" for s in STRENGTHS),
        injected=_injected(shown.results),
        misnamed=_misnamed(shown.results),
    )


def described(finding: Finding) -> str:
    """Return a finding in a few words: name, axes, parameters."""
    values = ", ".join(f"{k} {_number(p['value'])} {p['unit']}" for k, p in finding["parameters"].items())
    where = " ".join([finding["sensor"], *finding["axes"]])
    indistinguishable = [a["effect"] for a in finding["alternatives"] if a["indistinguishable"]]
    return f"`{finding['effect']}` ({where}): {values}" + (
        f"; or {', '.join(indistinguishable)}" if indistinguishable else ""
    )


def _number(value: Any) -> str:
    shown = np.array2string(np.asarray(value), separator=", ", formatter={"float_kind": lambda x: f"{x:.3g}"})
    return shown.replace("\n", "")


def _findings_table(rows: Sequence[Row], device: dict[str, str]) -> str:
    lines = []
    for r in rows:
        sisters = [s for s in rows if s is not r and device[s.name] == device[r.name]]
        own = (
            r.name,
            f"{r.seconds:.0f} s, {r.rate_hz:.0f} Hz",
            f"{r.compared} of {r.compared + r.not_compared}",
        )
        verdict = r.verdict.replace("_", " ")
        if not r.findings:
            lines.append((*own, verdict, "nothing", "", "", ""))
        for f in r.findings:
            gain = f["evidence"].get("heldout_log_score_gain")
            first = f is r.findings[0]
            lines.append(
                (
                    *(own if first else ("", "", "")),
                    verdict if first else "",
                    described(f),
                    f"{f['probability']:.4f}",
                    "" if gain is None else f"{gain:.3g}",
                    agreement(r, f, sisters),
                )
            )
    head = (
        "recording",
        "length, rate",
        "effects looked for",
        "verdict",
        "found",
        "probability",
        "gain, nats",
    )
    return table((*head, "found again"), lines)


_OPTICAL = """\
Over every second the gyroscope's turn is held against the cameras': what is left, degrees rms. Squares of
the rate are what `gyro_nonlinearity` is; their share of what is left is all that cameras leave room for. Of
noise, values and stamps cameras say nothing.

"""


def _optical(recordings: Sequence[Source], rows: Sequence[Row]) -> str:
    """Say what cameras saw of gyroscopes, where there were cameras."""
    effects_found = {r.name: {f["effect"] for f in r.findings} for r in rows}
    lines = []
    for source in recordings:
        if (s := optical.compare_with_cameras(source)) is not None:
            found_here = "yes" if "gyro_nonlinearity" in effects_found.get(source.name, set()) else "no"
            share = 1.0 - (s.squares / s.affine) ** 2
            rms = [f"{x:.3f}" for x in (s.raw, s.affine, s.squares)]
            lines.append((source.name, str(s.seconds), *rms, f"{share:.1%}", found_here))
    if not lines:
        return "(no recording with cameras is there)"
    head = ("recording", "s seen", "as it is", "bias, scale, misalignment off", "squares off too")
    return _OPTICAL + table((*head, "squares' share", "`gyro_nonlinearity` found"), lines)


def _still(answers: Sequence[Judged]) -> str:
    if not answers:
        return "(not there)"
    alarmed = [a for a in answers if a.findings]
    devices = {(a.recording.model, a.recording.device) for a in answers}
    lines = []
    for effect, count in Counter(f.effect for a in alarmed for f in a.findings).most_common():
        again = sum(f.effect == effect for a in alarmed for f in a.confirmed)
        models = Counter(a.recording.model for a in alarmed if any(f.effect == effect for f in a.findings))
        lines.append(
            (f"`{effect}`", str(count), str(again), ", ".join(f"{m} {n}" for m, n in models.most_common()))
        )
    share = f"{len(alarmed) / len(answers):.0%}".replace("%", " %")
    return (
        f"{len(alarmed)} of {len(answers)} recordings ({share}) have a finding, of {len(devices)} phones and"
        " watches (Stisen et al. 2015;\naccelerometer only, mostly 70 s each). Each device is judged by what"
        " others commonly show. This alone:\n"
        "`python -m stillcal.replay.real_data.sound_phones $STILLCAL_DATA/hhar_still --verbose`.\n\n"
        + table(("found", "findings", "in both halves too", "recordings by model"), lines)
    )


def _halves(unlike: Sequence[Unlike], count: int) -> str:
    """Say how many of `count` recordings of phones on a table differ from half to half."""
    if not count:
        return "(not there)"
    lines = []
    for effect, times in Counter(d.effect for _, found in unlike for d in found).most_common():
        models = Counter(one.model for one, found in unlike if any(d.effect == effect for d in found))
        lines.append((f"`{effect}`", str(times), ", ".join(f"{m} {n}" for m, n in models.most_common())))
    share = f"{len(unlike) / count:.0%}".replace("%", " %")
    return (
        f"{len(unlike)} of the same {count} recordings ({share}) have a difference where the first half"
        " is held\nagainst the second as a simulation of it: one sensor, one place, half a minute later."
        " This alone:\n"
        "`python -m stillcal.replay.real_data.sound_phones $STILLCAL_DATA/hhar_still --halves`.\n\n"
        + table(("difference", "times", "recordings by model"), lines)
    )


def _withheld(hidden: Sequence[tuple[Source, Withheld | None]]) -> str:
    lines = []
    for source, w in hidden:
        if w is None:
            lines.append((source.name, "-", "-", "-", "-", "-", "too little lies still"))
            continue
        others = ", ".join(f"{o:+.2f}" for o in w.others) or "-"
        verdict = (
            "recovered"
            if w.chance < 0.05 and abs(w.correlation) > max(map(abs, w.others), default=0)
            else "not shown"
        )
        lines.append(
            (w.name, str(w.bins), f"{w.span:.2f}", f"{100 * w.share:.0f} %", f"{w.correlation:+.2f}",
             f"{100 * w.chance:.0f} %; others {others}", verdict)
        )  # fmt: skip
    head = ("recording", "still bins", "span, K", "curve's share", "correlation", "by chance", "verdict")
    return table(head, lines)


def _injected(results: Sequence[Injected]) -> str:
    counted = tally(results)
    effects = list(dict.fromkeys(r.effect for r in results))
    kinds = ("right", "set", "unknown", "other", "nothing")

    def cell(effect: str, strength: float) -> str:
        counts = counted.get((effect, strength), Counter())
        return ", ".join(f"{k} {counts[k]}" for k in kinds if counts[k]) or "-"

    head = ("effect", "hosts", *(f"strength {s:.2g}" for s in STRENGTHS))
    hosts = {e: len({r.recording for r in results if r.effect == e}) for e in effects}
    return table(head, [(f"`{e}`", str(hosts[e]), *(cell(e, s) for s in STRENGTHS)) for e in effects])


def _misnamed(results: Sequence[Injected]) -> str:
    extra = Counter((r.effect, name) for r in results for name in r.extra)
    if not extra:
        return "No other name was given beside."
    return (
        "Other names given beside or instead: "
        + ", ".join(f"`{name}` for {effect} ({n})" for (effect, name), n in extra.most_common())
        + "."
    )
