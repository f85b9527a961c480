"""`stillcal query`: ask a running daemon over its socket, as any varlink client may.

The protocol is simple: JSON messages, each ended by a zero byte. It is written out here, because
importing a varlink library would take longer than the answer.
"""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import msgspec

from stillcal.daemon.cli.exits import BAD_INPUT, NO_DAEMON, REFUSED, TOO_LITTLE
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import socket_option
from stillcal.daemon.system.printable import printable
from stillcal.daemon.system.requirements import LOCAL_SOCKET, require
from stillcal.daemon.varlink.address import NAME, answering_path

TIMEOUT_S = 10.0
"""Longest wait for an answer, s: most take milliseconds, a full calibration takes seconds."""

STREAMS = ("Monitor", "Record", "Stream")
"""Methods that answer until they are interrupted."""


WIDTH = 24
"""Characters of the column of names; the longest, slow_rotation_deg_per_h, has 23."""


class NoDaemonError(OSError):
    """No daemon answers at the socket."""


@click.command(
    "query",
    epilog=examples(
        "stillcal query",
        "stillcal query GetStatus",
        "stillcal query GetHistory '{\"limit\": 5}' --json",
        "stillcal query Monitor",
        "stillcal query org.varlink.service.GetInfo",
    ),
)
@click.argument("method", default="GetCalibration")
@click.argument("parameters", default="{}")
@socket_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON, one object per line.")
def query_command(method: str, parameters: str, path: str, as_json: bool) -> None:
    """Ask a running daemon.

    METHOD is GetCalibration (the default), GetStatus, GetStillness, GetHistory, GetEnergy,
    Correct, Monitor, Stream and Record (until interrupted), Calibrate, ZeroNow, Rollback or Reload; or any
    method by its full name. PARAMETERS is a JSON object. Exit codes: 1 refused by the daemon, 2 bad input,
    3 no calibration yet, 4 no daemon.
    """
    where = answering_path(path)
    try:
        for reply in replies(where, _question(method, parameters)):
            if "error" in reply:
                _exit_with_error(str(reply["error"]), reply.get("parameters") or {})
            _print(reply.get("parameters") or {}, as_json)
    except NoDaemonError as error:
        click.echo(
            f"stillcal: no daemon answers on {where} ({error}): start one with `stillcal run`", err=True
        )
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
        except OSError as error:
            raise NoDaemonError(error.strerror or str(error)) from error


def _messages(line: socket.socket) -> Iterator[dict[str, Any]]:
    """Yield the replies up to the last one."""
    buffer = bytearray()
    while True:
        while (end := buffer.find(0)) >= 0:
            reply: dict[str, Any] = msgspec.json.decode(bytes(buffer[:end]))
            del buffer[: end + 1]
            yield reply
            if not reply.get("continues"):
                return
        data = line.recv(65_536)
        if not data:
            raise ConnectionResetError("the daemon closed the connection")
        buffer += data


def _question(method: str, parameters: str) -> dict[str, Any]:
    try:
        arguments = msgspec.json.decode(parameters)
    except msgspec.MsgspecError as error:
        raise click.UsageError(f"PARAMETERS is not JSON: {error}") from error
    if not isinstance(arguments, dict):
        raise click.UsageError(
            f"PARAMETERS is {parameters}: must be a JSON object, such as '{{\"limit\": 5}}'"
        )
    name = method if "." in method else f"{NAME}.{method}"
    more = {"more": True} if method.rpartition(".")[2] in STREAMS else {}
    return {"method": name, "parameters": arguments, **more}


def _exit_with_error(error: str, parameters: dict[str, Any]) -> None:
    """Print in one line why the daemon refused, and exit with the code for it."""
    name = error.rpartition(".")[2]
    if name == "MethodNotFound":
        method = parameters.get("method", "")
        raise click.UsageError(printable(f"no method {method}: `stillcal query --help` lists the methods"))
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
    inner = next(iter(answer.values())) if len(answer) == 1 else answer
    click.echo("\n".join(_lines(inner)))


def _lines(value: Any, indent: str = "") -> Iterator[str]:
    """Yield a value as indented lines; a list of records has one line for each."""
    if isinstance(value, dict):
        for key, item in value.items():
            if isinstance(item, dict) or (isinstance(item, list) and any(isinstance(i, list) for i in item)):
                yield f"{indent}{key}"
                yield from _lines(item, indent + "  ")
            else:
                yield f"{indent}{key:<{WIDTH}} {_text(item)}"
    elif isinstance(value, list):
        for item in value:
            yield indent + _row(item)
    else:
        yield from (indent + printable(line) for line in str(value).split("\n"))


def _row(item: Any) -> str:
    if not isinstance(item, dict):
        return _text(item)
    return "  ".join(f"{key} {_text(value)}" for key, value in item.items() if not isinstance(value, dict))


def _text(value: Any) -> str:
    if isinstance(value, list):
        return "  ".join(_text(item) for item in value) or "-"
    if value is None or value == "":
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else printable(str(value))
