"""`stillcal query`: ask a running daemon over its socket, as any varlink client may.

The protocol is simple: JSON messages, each ended by a zero byte. It is written out here, because
importing a varlink library would take longer than the answer.
"""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import msgspec

from stillcal.daemon.cli.answer_text import lines
from stillcal.daemon.cli.exits import BAD_INPUT, NO_DAEMON, REFUSED, TOO_LITTLE
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import socket_option
from stillcal.daemon.system.printable import is_utf8, printable
from stillcal.daemon.system.requirements import LOCAL_SOCKET, require
from stillcal.daemon.varlink.address import NAME, answering_path

TIMEOUT_S = 10.0
"""Longest wait for an answer, s: most take milliseconds, a full calibration takes seconds."""

STREAMS = ("Monitor", "Record", "Stream")
"""Methods that answer until they are interrupted."""

SIGNS = {"?": "? may be left out", "[]": "[] is a list", "[][]": "[][] a list of rows [x, y, z]"}
"""What the signs of Varlink's types mean."""

NO_METHOD = ("MethodNotFound", "InterfaceNotFound", "ProtocolViolation")
"""Errors of a question whose method is not there; the last one where its name can be none of a method."""

MEANT = {
    "temperature_c": "degrees Celsius, such as 25",
    "limit": "a whole number from 0 on, such as 5",
    "sensor": "accelerometer or gyroscope",
    "samples": "rows of three numbers, 1000 at most, such as [[0.1,0.2,9.8]]",
    "force": "as many rows of three numbers as there are samples",
    "smooth_hz": "the sampling rate in Hz, such as 50",
    "batch_s": "0 to 1 seconds between two answers, such as 0.1",
    "stop": "true or false",
    "sparing": "true or false",
}
"""What parameters may be, in words: their type alone does not say which numbers are allowed."""

LONGEST_VALUE = 40
"""Characters of a wrong value that a message repeats."""

TEXTS = ("to", "sensor")
"""Parameters that are texts, also where they look like a number, as a calibration's id may."""


class NoDaemonError(OSError):
    """No daemon answers at the socket; the message says why, and what to do."""

    def __init__(self, path: Path, error: Exception) -> None:
        if isinstance(error, PermissionError):
            what = (
                f"you may not connect to {path}: log in as a member of its group {_group(path)}, or let every"
                " user in (install-service --all-users)"
            )
        else:
            why = getattr(error, "strerror", None) or str(error)
            what = f"no daemon answers on {path} ({why}): start one with `stillcal run`"
        super().__init__(what)


def _group(path: Path) -> str:
    """Return the name of the group of a socket, or how to find it."""
    try:
        return path.group()
    except (OSError, KeyError, NotImplementedError):  # a group without a name
        return f"(`ls -ld {path}` names it)"


@click.command(
    "query",
    epilog=examples(
        "stillcal query",
        "stillcal query GetStatus",
        "stillcal query GetHistory limit=5",
        "stillcal query GetCalibration temperature_c=35 --json",
        "stillcal query Correct sensor=gyroscope 'samples=[[0.01,-0.02,0.005]]'",
        "stillcal query Monitor",
        "stillcal query org.varlink.service.GetInfo",
    ),
)
@click.argument("method", default="GetCalibration")
@click.argument("parameters", metavar="[NAME=VALUE]...", nargs=-1)
@socket_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON, one object per line.")
def query_command(method: str, parameters: tuple[str, ...], path: str, as_json: bool) -> None:
    """Ask a running daemon.

    METHOD is GetCalibration (the default), GetStatus, GetStillness, GetHistory, GetEnergy, GetFindings,
    GetFaces, Correct, Monitor, Stream and Record (until interrupted), Calibrate, ZeroNow, LayFaces, Rollback
    or Reload; or any method by its full name. A VALUE is JSON or plain text; one JSON object, or '-' for one
    on standard input, may stand in place of all NAME=VALUE. Tables show at most 32 rows, --json all. Exit
    codes: 1 refused by the daemon, 2 bad input, 3 no calibration yet, 4 no daemon.
    """
    where = answering_path(path)
    for word in (method, *parameters):
        if not is_utf8(word):
            raise click.UsageError(f"{word!a}: is no UTF-8 text")
    try:
        question = _question(method, parameters)
        for reply in replies(where, question):
            if "error" in reply:
                exit_with_error(str(reply["error"]), reply.get("parameters") or {}, where, question)
            _print(reply.get("parameters") or {}, as_json)
    except NoDaemonError as error:
        click.echo(f"stillcal: {error}", err=True)
        sys.exit(NO_DAEMON)


def replies(path: Path, question: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Ask over the socket at `path` and yield the replies.

    Raises NoDaemonError where nobody answers, and UnsupportedError where there are no local sockets.
    """
    require("a conversation with the daemon", LOCAL_SOCKET)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
        line.settimeout(TIMEOUT_S)
        try:
            line.connect(str(path))
            line.sendall(msgspec.json.encode(question) + b"\0")
            line.settimeout(None if question.get("more") else TIMEOUT_S)
            yield from _messages(line)
        except (OSError, msgspec.MsgspecError) as error:
            raise NoDaemonError(path, error) from error


def _messages(line: socket.socket) -> Iterator[dict[str, Any]]:
    """Yield the replies up to the last one."""
    buffer = bytearray()
    while True:
        while (end := buffer.find(0)) >= 0:
            reply = msgspec.json.decode(bytes(buffer[:end]), type=dict[str, Any])
            del buffer[: end + 1]
            yield reply
            if not reply.get("continues"):
                return
        data = line.recv(65_536)
        if not data:
            raise ConnectionResetError("the daemon closed the connection")
        buffer += data


def _question(method: str, parameters: Sequence[str]) -> dict[str, Any]:
    name = method if "." in method else f"{NAME}.{method}"
    more = {"more": True} if method.rpartition(".")[2] in STREAMS else {}
    return {"method": name, "parameters": _arguments(parameters), **more}


def _arguments(parameters: Sequence[str]) -> dict[str, Any]:
    """Return the parameters, from NAME=VALUE each or from one JSON object. Raises UsageError."""
    if len(parameters) == 1 and (parameters[0] == "-" or parameters[0].lstrip().startswith(("{", "["))):
        return _object(sys.stdin.read() if parameters[0] == "-" else parameters[0])
    pairs = [parameter.partition("=") for parameter in parameters]
    for name, equals, _ in pairs:
        if not (equals and name.isidentifier()):
            raise click.UsageError(f"{name!r} is no NAME=VALUE, such as limit=5, and no JSON object")
    return {name: value if name in TEXTS else _value(value) for name, _, value in pairs}


def _object(text: str) -> dict[str, Any]:
    try:
        arguments = msgspec.json.decode(text)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise click.UsageError(f"the parameters are not JSON: {error}") from error
    if not isinstance(arguments, dict):
        raise click.UsageError(
            f"the parameters are {text.strip()}: must be a JSON object, such as '{{\"limit\": 5}}'"
        )
    return arguments


def _value(text: str) -> Any:
    """Return what a VALUE stands for: JSON, else the text itself."""
    try:
        return msgspec.json.decode(text)
    except (msgspec.MsgspecError, RecursionError):
        return text


def _methods(where: Path) -> dict[str, str]:
    """Return how each method of the daemon is called, by its name, from the daemon's own description."""
    asked = {
        "method": "org.varlink.service.GetInterfaceDescription",
        "parameters": {"interface": NAME},
    }
    reply = next(replies(where, asked))
    description = str((reply.get("parameters") or {}).get("description", ""))
    lines_of_methods = (line for line in description.splitlines() if line.startswith("method "))
    calls = [line.removeprefix("method ").partition(" -> ")[0] for line in lines_of_methods]
    return {call.partition("(")[0]: call for call in calls}


def _misfit(name: str, given: dict[str, Any], shape: str) -> str:
    """Say what is wrong with a parameter, and what the method of this shape expects."""
    known = f"({name}: " in shape or f", {name}: " in shape
    if not known:
        what = f"no parameter is called {name}"
    elif name in given:
        value = json.dumps(given[name], ensure_ascii=False)
        value = value if len(value) <= LONGEST_VALUE else f"{value[:LONGEST_VALUE]}..."
        meant = f"; give {MEANT[name]}" if name in MEANT else ""
        what = f"{name} cannot be {value}{meant}"
    else:
        what = f"{name} is missing"
    signs = [words for sign, words in SIGNS.items() if sign in shape]
    return f"{what}; expected: {shape}" + (f" ({'; '.join(signs)})" if signs else "")


def exit_with_error(error: str, parameters: dict[str, Any], where: Path, question: Mapping[str, Any]) -> None:
    """Print in one line why the daemon refused, and exit with the code for it."""
    name, method = error.rpartition(".")[2], question["method"].removeprefix(f"{NAME}.")
    if name in NO_METHOD:
        known = ", ".join(_methods(where))
        raise click.UsageError(
            printable(f"no method {method!r}: give one of {known}, or another's full name")
        )
    if name == "InvalidParameter" and (shape := _methods(where).get(method)):
        wrong = str(parameters.get("parameter", "a parameter"))
        raise click.UsageError(printable(_misfit(wrong, question["parameters"], shape)))
    missing = ", ".join(parameters.get("missing") or [])
    facts = [str(parameters.get("reason") or ""), f"needed: {missing}" if missing else ""]
    other = [f"{key} {value}" for key, value in parameters.items() if key not in ("reason", "missing")]
    detail = "; ".join(fact for fact in (*facts, *other) if fact)
    click.echo(printable(f"stillcal: {name}{f': {detail}' if detail else ''}"), err=True)
    codes = {"NotCalibrated": TOO_LITTLE, "InvalidParameter": BAD_INPUT}
    sys.exit(codes.get(name, REFUSED))


def _print(answer: dict[str, Any], as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps(answer))
        return
    if not answer:
        click.echo("done")
        return
    inner = next(iter(answer.values())) if len(answer) == 1 else answer
    click.echo("\n".join(lines(inner)))
