"""The summary of a fleet as one HTML page that loads no other file."""

from __future__ import annotations

from html import escape

from stillcal.replay.diagnosis.report import tables
from stillcal.replay.diagnosis.report.page import document
from stillcal.replay.fleet.summary.report import Report
from stillcal.replay.fleet.summary.sections import Section, sections


def fleet_page(report: Report, name: str) -> str:
    """Return the page's HTML. name: what the fleet is called."""
    shown = list(sections(report))
    worse = len({c.device for c in report.changes if c.worse})
    counts = ", ".join(f"{n} {status}" for status, n in report.recordings.items()) or "no recordings"
    verdict = f"{worse or 'None'} of {report.compared} devices got worse."
    if not report.compared:
        verdict = "No device has two recordings to compare."
    kind = "unidentified" if worse else "match" if report.compared else "not_judged"
    parts = [
        f"<h1>Fleet {escape(name)}</h1>",
        f'<p class="verdict {kind}"><strong>{verdict}</strong> Recordings: {escape(counts)}.</p>',
        f"<nav><ul>{''.join(map(_link, enumerate(shown)))}</ul></nav>",
        *map(_section, enumerate(shown)),
        _limits(report.limits),
        "<footer>Made by <code>stillcal fleet-report</code>. docs/fleet.md describes the method.</footer>",
    ]
    return document(f"Fleet {escape(name)}", parts)


def _link(numbered: tuple[int, Section]) -> str:
    number, section = numbered
    return f'<li><a href="#s{number}">{escape(section.title)}</a></li>'


def _section(numbered: tuple[int, Section]) -> str:
    number, section = numbered
    rows = [tuple(map(escape, row)) for row in section.rows]
    return (
        f'<h2 id="s{number}">{escape(section.title)}</h2><p>{escape(section.about)}</p>'
        f"{tables.table(section.heads, rows)}"
    )


def _limits(limits: list[str]) -> str:
    if not limits:
        return ""
    return f"<h2>What this fleet cannot show</h2><ul>{''.join(f'<li>{escape(x)}</li>' for x in limits)}</ul>"
