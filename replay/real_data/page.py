"""The page of the three tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from stillcal.replay.real_data import optical_reference as optical
from stillcal.replay.real_data.injection import STRENGTHS
from stillcal.replay.real_data.sources import Source
from stillcal.replay.real_data.tables import Finding, Injected, Row, agreement, tally
from stillcal.replay.real_data.withheld_thermometer import Withheld

_PAGE = """# The diagnosis on other people's recordings

Made by `python -m stillcal.replay.real_data $STILLCAL_DATA`; [data.md](data.md) says where the recordings
come from. Nothing is tuned to them: each goes through the path of `stillcal diagnose`, without claims of a
maker, since none came with them.

## What is found in each

{found}

Evidence is in the words of `diagnose --json`: root mean square of what was predicted before and after, gain
of the log score in nats, both on data left out. "Found again" says whether the same name comes out of
either half of the recording alone, and of other recordings of the same device. A verdict of *adequate* over
a recording in which little could be checked says little; the last column says what could not be.

### Beside optical truth

{optical}

### Phones on a table

{still}

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


def page(
    recordings: Sequence[Source],
    rows: Sequence[Row],
    rests: Sequence[tuple[str, str, list[Finding]]],
    hidden: Sequence[tuple[Source, Withheld | None]],
    results: Sequence[Injected],
) -> str:
    """Return the page's text."""
    device = {s.name: s.device for s in recordings}
    own = [r for r in rows if not r.name.startswith("hhar_still/")]
    still = [r for r in rows if r.name.startswith("hhar_still/")]
    return _PAGE.format(
        found=_findings_table(own, device),
        optical=_optical(recordings, rows),
        still=_still(still),
        rests=_table(
            ("table", "verdict", "found"),
            [(name, verdict, "; ".join(map(described, f)) or "-") for name, verdict, f in rests],
        ),
        withheld=_withheld(hidden),
        strengths=", ".join(f"{s:.2g}" for s in STRENGTHS),
        injected=_injected(results),
        misnamed=_misnamed(results),
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


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
        limits = "; ".join(r.limits) or "-"
        if not r.findings:
            lines.append((r.name, f"{r.seconds:.0f}", r.verdict, "nothing", "-", "-", limits))
        for i, f in enumerate(r.findings):
            e = f["evidence"]
            lines.append(
                (
                    r.name if i == 0 else "",
                    f"{r.seconds:.0f}" if i == 0 else "",
                    r.verdict.replace("_", " ") if i == 0 else "",
                    described(f),
                    f"{e['heldout_rmse_before']:.3g} -> {e['heldout_rmse_after']:.3g}, "
                    f"{e['heldout_log_score_gain']:.0f} nats, {e['folds']} folds",
                    agreement(r, f, sisters),
                    limits if i == 0 else "",
                )
            )
    return _table(("recording", "s", "verdict", "found", "held out", "found again", "not checked"), lines)


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
    return _OPTICAL + _table((*head, "squares' share", "`gyro_nonlinearity` found"), lines)


def _still(rows: Sequence[Row]) -> str:
    if not rows:
        return "(not there)"
    verdicts = Counter(r.verdict.replace("_", " ") for r in rows)
    by_effect: dict[str, list[Row]] = {}
    for r in rows:
        for effect in sorted({f["effect"] for f in r.findings}):
            by_effect.setdefault(effect, []).append(r)
    lines = []
    for effect, those in sorted(by_effect.items(), key=lambda item: -len(item[1])):
        models = Counter(r.name.split("/")[1] for r in those)
        both = sum(all(h is not None and any(n == effect for n, _ in h) for h in r.halves) for r in those)
        model_counts = ", ".join(f"{m} {n}" for m, n in models.most_common(6))
        lines.append((f"`{effect}`", str(len(those)), str(both), model_counts))
    verdict_counts = ", ".join(f"{v} {n}" for v, n in verdicts.most_common())
    return (
        f"{len(rows)} recordings of Stisen et al. 2015, mostly 70 s each, accelerometer only:"
        f" {verdict_counts}.\nTheir stamps are those of arrival: jitter"
        " is delivery's, and so may be what looks dropped.\n\n"
        + _table(("found", "recordings", "in both halves too", "models (recordings)"), lines)
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
    return _table(head, lines)


def _injected(results: Sequence[Injected]) -> str:
    counted = tally(results)
    effects = list(dict.fromkeys(r.effect for r in results))
    kinds = ("right", "set", "unknown", "other", "nothing")

    def cell(effect: str, strength: float) -> str:
        counts = counted.get((effect, strength), Counter())
        return ", ".join(f"{k} {counts[k]}" for k in kinds if counts[k]) or "-"

    head = ("effect", "hosts", *(f"strength {s:.2g}" for s in STRENGTHS))
    hosts = {e: len({r.recording for r in results if r.effect == e}) for e in effects}
    return _table(head, [(f"`{e}`", str(hosts[e]), *(cell(e, s) for s in STRENGTHS)) for e in effects])


def _misnamed(results: Sequence[Injected]) -> str:
    extra = Counter((r.effect, name) for r in results for name in r.extra)
    if not extra:
        return "No other name was given beside."
    return (
        "Other names given beside or instead: "
        + ", ".join(f"`{name}` for {effect} ({n})" for (effect, name), n in extra.most_common())
        + "."
    )
